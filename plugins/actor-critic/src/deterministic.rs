//! A policy whose action is the actor's output, disturbed where it explores (DDPG, TD3).

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::{Adam, AgentSettings, Architecture, CriticStep, Error, Noise, Policy, PolicyAgent};

/// π(s) is the network's output, which tanh keeps in [-1, 1].
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Deterministic;

/// What every learner with a deterministic policy consists of.
pub type Agent = PolicyAgent<Deterministic>;

/// What one member needs and returns in an update of critics and actor.
#[derive(Debug, Clone, Default)]
pub struct PolicyStep {
    /// The critic's own part.
    pub critic: CriticStep,
    /// ∂Q/∂a at the policy's actions.
    pub action_gradients: Vec<f32>,
}

impl Policy for Deterministic {
    fn new(_settings: &AgentSettings<'_>) -> Self {
        Self
    }

    fn architecture(settings: &AgentSettings<'_>) -> Result<Architecture, Error> {
        let AgentSettings { observation_len, scale, actor_hidden, activation, .. } = settings;
        Architecture::actor(*observation_len, scale.len(), actor_hidden, *activation)
    }

    fn act(&self, outputs: &[f32], explores: Option<(&mut Noise, &mut Pcg64)>, unit: &mut [f32]) {
        unit.copy_from_slice(outputs);
        if let Some((noise, rng)) = explores {
            noise.disturb(unit, rng);
        }
    }

    fn check(&self) -> Result<(), Error> {
        Ok(())
    }

    fn restore(&mut self, _saved: Self) {}
}

impl Agent {
    /// Writes π'(s') of the batch into the buffers.
    pub fn choose_next_actions(&mut self) {
        let mut actor = self.actor.member(0);
        let actions = actor.target_values(&self.body.buffers.next_observations, &[]);
        self.body.buffers.next_actions.copy_from_slice(actions);
    }

    /// Writes π(s) of the batch into the buffers. To be called before [`ascend`](Self::ascend).
    pub fn choose_policy_actions(&mut self) {
        let mut actor = self.actor.member(0);
        actor.observe(&self.body.buffers.observations);
        self.body.buffers.policy_actions.copy_from_slice(actor.values(&[]));
    }

    /// A step of the actor up the mean of the members' values over the batch, given their gradients at π(s). Returns the
    /// norm of the actor's gradient before it was clipped.
    ///
    /// # Errors
    /// [`Error::GradientNotFinite`]; the actor has taken no step then.
    pub fn ascend(
        &mut self,
        steps: &[PolicyStep],
        optimiser: &Adam,
        clip: Option<f32>,
        tau: f64,
    ) -> Result<f32, Error> {
        let rows = self.body.buffers.observations.len() / self.observation_len();
        let share = 1.0 / (rows * steps.len()) as f32;
        let mut actor = self.actor.member(0);
        let (_, gradients) = actor.outputs();
        gradients.fill(0.0);
        for step in steps {
            for (gradient, ascent) in gradients.iter_mut().zip(&step.action_gradients) {
                *gradient -= share * ascent;
            }
        }
        self.step_actor(optimiser, clip, tau)
    }
}
