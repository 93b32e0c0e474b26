//! A squashed Gaussian policy with a learned temperature (Haarnoja et al. 2018b, "Soft Actor-Critic Algorithms and Applications").
//!
//! The network gives a mean μ and a logarithm of the deviation σ per dimension: u = μ + σ ε with ε from N(0, 1), a = tanh u, and
//! log π(a|s) = Σ (−ε²/2 − log σ − log √(2π) − log(1 − a²)), in the units of [-1, 1]. With ε given, ∂a/∂u = 1 − a² and
//! ∂log π/∂u = 2a; so ∂L/∂μ = ∂L/∂u and ∂L/∂log σ = σ ε ∂L/∂u − ∂L/∂log π.

use std::f32::consts::{LN_2, TAU};

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::{
    Adam, AgentSettings, Architecture, CriticStep, Error, Noise, Policy, PolicyAgent, Real, adam::Slices,
};

/// Bounds of log σ; beyond them its gradient is 0 (the authors' code, Stable-Baselines3 and SBX: −20 and 2).
pub const LOG_DEVIATION: [f32; 2] = [-20.0, 2.0];

/// A squashed Gaussian, and how much its entropy weighs beside the values.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Gaussian {
    temperature: Temperature,
    /// Actions in the batch's states.
    #[serde(skip)]
    pub now: Draws,
    /// Actions in the states that followed.
    #[serde(skip)]
    pub next: Draws,
}

/// What is drawn for a batch, and how likely it was.
#[derive(Debug, Clone, Default)]
pub struct Draws {
    /// ε: `rows × action_len`.
    pub noise: Vec<f32>,
    /// log π(a|s) of each row, in the units of [-1, 1].
    pub log_probabilities: Vec<f32>,
}

/// log α with its optimiser's state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Temperature {
    log: [f32; 1],
    first: [f32; 1],
    second: [f32; 1],
    steps: u64,
}

/// What every learner with such a policy consists of.
pub type SoftAgent = PolicyAgent<Gaussian>;

/// What one member needs and returns in an update of critics and actor.
#[derive(Debug, Clone, Default)]
pub struct SoftStep {
    /// The critic's own part.
    pub critic: CriticStep,
    /// Of the member's networks, at the policy's actions.
    pub policy: SmallestGradients,
}

/// Per row, ∂Q/∂a of the network whose value is smallest.
#[derive(Debug, Clone, Default)]
pub struct SmallestGradients {
    /// `rows × action_len`.
    pub gradients: Vec<f32>,
    /// The smallest values so far.
    pub(crate) values: Vec<f32>,
    /// Those of one network.
    pub(crate) own: Vec<f32>,
    /// Which of them are the smallest.
    pub(crate) is_smallest: Vec<bool>,
}

impl Gaussian {
    /// α, the weight of the entropy.
    pub fn temperature(&self) -> f32 {
        self.temperature.log[0].exp()
    }
}

impl Policy for Gaussian {
    fn new(settings: &AgentSettings<'_>) -> Self {
        let log = [settings.initial_temperature.ln()];
        let temperature = Temperature { log, first: [0.0], second: [0.0], steps: 0 };
        Self { temperature, now: Draws::default(), next: Draws::default() }
    }

    fn architecture(settings: &AgentSettings<'_>) -> Result<Architecture, Error> {
        let AgentSettings { observation_len, scale, actor_hidden, activation, .. } = settings;
        Architecture::gaussian(*observation_len, scale.len(), actor_hidden, *activation)
    }

    fn act(&self, outputs: &[f32], explores: Option<(&mut Noise, &mut Pcg64)>, unit: &mut [f32]) {
        let (means, logs) = outputs.split_at(unit.len());
        match explores {
            None => unit.iter_mut().zip(means).for_each(|(action, mean)| *action = Real::tanh(*mean)),
            Some((noise, rng)) => {
                noise.skip();
                for ((action, mean), log) in unit.iter_mut().zip(means).zip(logs) {
                    let draw: f32 = rng.sample(StandardNormal);
                    *action = Real::tanh(mean + deviation(*log) * draw);
                }
            }
        }
    }

    fn check(&self) -> Result<(), Error> {
        let Temperature { log, first, second, .. } = &self.temperature;
        let is_finite = [log, first, second].iter().all(|value| value[0].is_finite());
        if is_finite { Ok(()) } else { Err(Error::StateNotFinite) }
    }

    fn restore(&mut self, saved: Self) {
        self.temperature = saved.temperature;
    }
}

/// σ from the network's output. NaN stays NaN.
fn deviation(log: f32) -> f32 {
    log.clamp(LOG_DEVIATION[0], LOG_DEVIATION[1]).exp()
}

/// log(1 − tanh² u) = 2 (log 2 − u − log(1 + exp(−2u))), which neither cancels nor overflows.
fn log_slope(u: f32) -> f32 {
    let size = u.abs();
    2.0 * (LN_2 - size - (-2.0 * size).exp().ln_1p())
}

impl Draws {
    fn draw(&mut self, length: usize, rng: &mut Pcg64) {
        self.noise.resize(length, 0.0);
        self.noise.fill_with(|| rng.sample(StandardNormal));
    }

    /// Writes the actions (`rows × action_len`) that the noise makes of the outputs (`rows × 2 action_len`).
    fn squash(&mut self, outputs: &[f32], action_len: usize, actions: &mut [f32]) {
        self.log_probabilities.clear();
        let rows = outputs.chunks_exact(2 * action_len).zip(self.noise.chunks_exact(action_len));
        for ((outputs, noise), actions) in rows.zip(actions.chunks_exact_mut(action_len)) {
            let (means, logs) = outputs.split_at(action_len);
            let mut log_probability = -0.5 * action_len as f32 * TAU.ln();
            for (index, action) in actions.iter_mut().enumerate() {
                let (log, draw) = (logs[index].clamp(LOG_DEVIATION[0], LOG_DEVIATION[1]), noise[index]);
                let u = means[index] + log.exp() * draw;
                *action = Real::tanh(u);
                log_probability -= 0.5 * draw * draw + log + log_slope(u);
            }
            self.log_probabilities.push(log_probability);
        }
    }
}

impl SoftAgent {
    /// Draws the noise of the batch's actions, next ones first.
    pub fn draw_noise(&mut self) {
        let length = self.body.buffers.actions.len();
        self.policy.next.draw(length, &mut self.body.rng);
        self.policy.now.draw(length, &mut self.body.rng);
    }

    /// Writes a' from π(·|s') of the batch, with the noise that was drawn, into the buffers.
    pub fn choose_next_actions(&mut self) {
        let (buffers, action_len) = (&mut self.body.buffers, self.body.scale.len());
        let mut actor = self.actor.member(0);
        actor.observe(&buffers.next_observations);
        self.policy.next.squash(actor.values(&[]), action_len, &mut buffers.next_actions);
    }

    /// Writes a from π(·|s) of the batch, with the noise that was drawn, into the buffers. To be called before [`ascend`](Self::ascend).
    pub fn choose_policy_actions(&mut self) {
        let (buffers, action_len) = (&mut self.body.buffers, self.body.scale.len());
        let mut actor = self.actor.member(0);
        let outputs = actor.learn(&buffers.observations, &[]);
        self.policy.now.squash(outputs, action_len, &mut buffers.policy_actions);
    }

    /// A step of the actor down the mean of α log π(a|s) − Q(s, a) over the batch and the members, given the members' gradients at the
    /// policy's actions. Returns the norm of the actor's gradient before it was clipped.
    ///
    /// # Errors
    /// [`Error::GradientNotFinite`]; the actor has taken no step then.
    pub fn ascend(&mut self, steps: &[SoftStep], optimiser: &Adam, clip: Option<f32>) -> Result<f32, Error> {
        let action_len = self.action_len();
        let rows = self.body.buffers.observations.len() / self.observation_len();
        let share = 1.0 / (rows * steps.len()) as f32;
        let entropy_share = self.policy.temperature() / rows as f32;
        let mut actor = self.actor.member(0);
        let (outputs, gradients) = actor.outputs();
        let actions = self.body.buffers.policy_actions.chunks_exact(action_len);
        let drawn = actions.zip(self.policy.now.noise.chunks_exact(action_len)).enumerate();
        let networks = outputs.chunks_exact(2 * action_len).zip(gradients.chunks_exact_mut(2 * action_len));
        for ((row, (actions, noise)), (outputs, gradients)) in drawn.zip(networks) {
            for (index, (action, draw)) in actions.iter().zip(noise).enumerate() {
                let place = row * action_len + index;
                let ascent: f32 = steps.iter().map(|step| step.policy.gradients[place]).sum();
                let slope = (1.0 - action * action) * -share * ascent + entropy_share * 2.0 * action;
                let log = outputs[action_len + index];
                let moves = (LOG_DEVIATION[0]..=LOG_DEVIATION[1]).contains(&log);
                gradients[index] = slope;
                gradients[action_len + index] =
                    if moves { slope * log.exp() * draw - entropy_share } else { 0.0 };
            }
        }
        self.step_actor(optimiser, clip, 1.0)
    }

    /// A step of log α down −log α (mean log π(a|s) + `target_entropy`), with the batch's actions. That is the gradient of Stable-Baselines3
    /// and SBX; the paper's is α times as long, which Adam hardly sees. Without a target, the entropy aims at minus the number of an action's
    /// values (Haarnoja et al. 2018b).
    ///
    /// # Errors
    /// [`Error::GradientNotFinite`]; nothing has changed then.
    pub fn adjust_temperature(&mut self, target_entropy: Option<f32>, optimiser: &Adam) -> Result<(), Error> {
        let target_entropy = target_entropy.unwrap_or(-(self.body.scale.len() as f32));
        let Gaussian { temperature, now, .. } = &mut self.policy;
        let mean = now.log_probabilities.iter().sum::<f32>() / now.log_probabilities.len() as f32;
        let gradient = -(mean + target_entropy);
        if !gradient.is_finite() {
            return Err(Error::GradientNotFinite(gradient));
        }
        let Temperature { log, first, second, steps } = temperature;
        *steps += 1;
        let targets = &mut [0.0];
        optimiser.apply(Slices { weights: log, targets, first, second }, &[gradient], *steps, 0.0);
        Ok(())
    }

    /// The policy's entropy in the batch's states, estimated from its actions, in the units of [-1, 1].
    pub fn entropy(&self) -> f64 {
        let draws = &self.policy.now.log_probabilities;
        -draws.iter().map(|value| f64::from(*value)).sum::<f64>() / draws.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_density_of_a_squashed_gaussian_is_that_of_the_definition() {
        let mut draws = Draws { noise: vec![0.3, -1.2], log_probabilities: Vec::new() };
        let mut actions = [9.0; 2];
        draws.squash(&[0.4, -0.9, -0.5, 0.2], 2, &mut actions);
        let mut expected = 0.0_f64;
        for (index, (mean, log)) in [(0.4_f64, -0.5_f64), (-0.9, 0.2)].into_iter().enumerate() {
            let draw = f64::from(draws.noise[index]);
            let action = (mean + log.exp() * draw).tanh();
            assert!((f64::from(actions[index]) - action).abs() < 1e-6);
            expected -=
                0.5 * draw * draw + log + 0.5 * std::f64::consts::TAU.ln() + (1.0 - action * action).ln();
        }
        assert!((f64::from(draws.log_probabilities[0]) - expected).abs() < 1e-5);
    }

    #[test]
    fn far_outputs_keep_densities_finite_and_nan_stays_nan() {
        for u in [-80.0_f32, -3.0, 0.0, 3.0, 80.0] {
            let exact = 2.0
                * (std::f64::consts::LN_2 - f64::from(u.abs()) - (-2.0 * f64::from(u.abs())).exp().ln_1p());
            assert!((f64::from(log_slope(u)) - exact).abs() < 1e-4, "{u}");
        }
        assert!(log_slope(f32::NAN).is_nan() && deviation(f32::NAN).is_nan());
        assert_eq!((deviation(9.0), deviation(-90.0)), (2.0_f32.exp(), (-20.0_f32).exp()));
    }
}
