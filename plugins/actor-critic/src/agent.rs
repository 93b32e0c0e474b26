//! What every learner with a deterministic policy consists of (DDPG, TD3). How it learns is its own.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::{
    ActionScale, Activation, Adam, Architecture, CriticStep, Ensemble, EnsembleState, Error, Noise,
    NoiseProcess, Normaliser, Schedule, check_finite_output,
    checks::{check_argument, check_length},
    read_state, write_state,
};

/// How an [`Agent`] is made.
#[derive(Debug, Clone)]
pub struct AgentSettings<'a> {
    /// How many values an observation has.
    pub observation_len: usize,
    /// The actions' box.
    pub scale: ActionScale,
    /// Hidden layers of the actor.
    pub actor_hidden: &'a [usize],
    /// Hidden layers of a critic.
    pub critic_hidden: &'a [usize],
    /// What follows the hidden layers of both.
    pub activation: Activation,
    /// How many values the ensemble gives.
    pub members: usize,
    /// Of how many networks a member consists; its value is their smallest.
    pub networks_per_member: usize,
    /// Added to the critics' untrained values.
    pub initial_value: Option<f32>,
    /// Whether observations are scaled by their running statistics.
    pub normalise_observations: bool,
    /// Exploration noise.
    pub noise: NoiseProcess,
    /// Its size, where half the range of an action is 1.
    pub sigma: Schedule,
    /// Exploring actions that are uniform, at the beginning.
    pub random_steps: u64,
    /// How many threads the critics may use.
    pub threads: usize,
    /// Seed of the weights and of the exploration.
    pub seed: u64,
}

/// An actor, an ensemble of critics, exploration, scales, and the memory that is kept between calls.
#[derive(Debug)]
pub struct Agent {
    /// π, with its target network π'.
    pub actor: Ensemble<f32>,
    /// Q₁ … Qₙ, with their target networks; a member's networks are successive. They see actions scaled to [-1, 1].
    pub critics: Ensemble<f32>,
    /// The last batch.
    pub buffers: Buffers,
    /// The generator of everything random after the weights.
    pub rng: Pcg64,
    scale: ActionScale,
    normaliser: Option<Normaliser>,
    noise: Noise,
    random_steps: u64,
    networks_per_member: usize,
    valuations: Vec<Valuation>,
}

/// A batch as the networks see it, and the policy's actions for it. Row-major; exactly as long as the batch.
#[derive(Debug, Default)]
pub struct Buffers {
    /// States.
    pub observations: Vec<f32>,
    /// States that followed.
    pub next_observations: Vec<f32>,
    /// Executed actions in [-1, 1].
    pub actions: Vec<f32>,
    /// π(s).
    pub policy_actions: Vec<f32>,
    /// π'(s').
    pub next_actions: Vec<f32>,
    /// One observation and one action in [-1, 1], for everything that is not an update.
    observation: Vec<f32>,
    action: Vec<f32>,
}

/// One member's value of one (s, a), and its gradient with respect to the action.
#[derive(Debug, Clone)]
struct Valuation {
    value: f32,
    /// Of an earlier action where it was not asked for.
    gradient: Vec<f32>,
}

/// What one member needs and returns in an update of critics and actor.
#[derive(Debug, Clone, Default)]
pub struct PolicyStep {
    /// The critic's own part.
    pub critic: CriticStep,
    /// ∂Q/∂a at the policy's actions.
    pub action_gradients: Vec<f32>,
}

#[derive(Serialize)]
struct StateView<'a> {
    actor: &'a EnsembleState<f32>,
    critics: &'a EnsembleState<f32>,
    noise: &'a Noise,
    normaliser: &'a Option<Normaliser>,
    rng: &'a Pcg64,
}

#[derive(Deserialize)]
struct State {
    actor: EnsembleState<f32>,
    critics: EnsembleState<f32>,
    noise: Noise,
    normaliser: Option<Normaliser>,
    rng: Pcg64,
}

impl Agent {
    /// Draws the initial weights.
    ///
    /// # Errors
    /// Networks that cannot be built, an empty ensemble, or threads that could not be started.
    pub fn new(settings: AgentSettings<'_>) -> Result<Self, Error> {
        let AgentSettings { observation_len, activation, members, networks_per_member, .. } = settings;
        let action_len = settings.scale.len();
        let mut rng = Pcg64::seed_from_u64(settings.seed);
        let actor = Architecture::actor(observation_len, action_len, settings.actor_hidden, activation)?;
        let actor = Ensemble::new(actor, 1, 1, &mut rng)?;
        let critic = Architecture::critic(observation_len, action_len, settings.critic_hidden, activation)?;
        // One thread per member at most: its networks are worked on by the same.
        let threads = settings.threads.min(members);
        let mut critics = Ensemble::new(critic, members * networks_per_member, threads, &mut rng)?;
        if let Some(value) = settings.initial_value {
            critics.raise_outputs(value);
        }
        Ok(Self {
            actor,
            critics,
            buffers: Buffers::default(),
            rng,
            scale: settings.scale,
            normaliser: settings.normalise_observations.then(|| Normaliser::new(observation_len)),
            noise: Noise::new(settings.noise, settings.sigma, action_len),
            random_steps: settings.random_steps,
            networks_per_member,
            valuations: vec![Valuation { value: 0.0, gradient: vec![0.0; action_len] }; members],
        })
    }

    /// How many values an observation has.
    pub fn observation_len(&self) -> usize {
        self.critics.architecture().observation_len()
    }

    /// How many values an action has.
    pub fn action_len(&self) -> usize {
        self.scale.len()
    }

    /// Writes the policy's action in its box; exploring, a uniform or a disturbed one. Otherwise no random number is drawn.
    ///
    /// # Errors
    /// A wrong length or a value that is not finite; [`Error::OutputNotFinite`].
    pub fn act(&mut self, observation: &[f32], explores: bool, action: &mut [f32]) -> Result<(), Error> {
        check_argument("observation", observation, self.observation_len())?;
        check_length("action", action, self.action_len())?;
        let unit = &mut self.buffers.action;
        unit.resize(action.len(), 0.0);
        if explores && self.noise.step() < self.random_steps {
            self.noise.skip();
            unit.fill_with(|| self.rng.random_range(-1.0..=1.0));
        } else {
            Normaliser::take_rows(self.normaliser.as_ref(), observation, &mut self.buffers.observation);
            let mut actor = self.actor.member(0);
            actor.observe(&self.buffers.observation);
            unit.copy_from_slice(actor.values(&[]));
            if explores {
                self.noise.disturb(unit, &mut self.rng);
            }
        }
        check_finite_output("the actor's output", unit)?;
        self.scale.from_unit(unit, action);
        Ok(())
    }

    /// Writes each member's value of one (s, a), and where asked for its gradient with respect to the action
    /// (`members × action_len`), which is that of the network whose value is smallest.
    ///
    /// # Errors
    /// A wrong length or a value that is not finite; [`Error::OutputNotFinite`].
    pub fn value(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: Option<&mut [f32]>,
    ) -> Result<(), Error> {
        check_argument("observation", observation, self.observation_len())?;
        check_argument("action", action, self.action_len())?;
        check_length("values", values, self.valuations.len())?;
        let with_gradients = gradients.is_some();
        if let Some(gradients) = &gradients {
            check_length("gradients", gradients, self.valuations.len() * self.action_len())?;
        }
        let (buffers, scale) = (&mut self.buffers, &self.scale);
        Normaliser::take_rows(self.normaliser.as_ref(), observation, &mut buffers.observation);
        buffers.action.resize(action.len(), 0.0);
        scale.to_unit(action, &mut buffers.action);
        self.critics.for_each_group(self.networks_per_member, &mut self.valuations, |group, valuation| {
            valuation.value = f32::INFINITY;
            for network in 0..group.size() {
                let mut critic = group.member(network);
                critic.observe(&buffers.observation);
                let value = critic.values(&buffers.action)[0];
                // Once there, NaN stays: no comparison with it is true.
                if value < valuation.value || value.is_nan() {
                    valuation.value = value;
                    if with_gradients {
                        critic.action_gradients(&mut valuation.gradient);
                    }
                }
            }
        });
        for (value, valuation) in values.iter_mut().zip(&self.valuations) {
            *value = valuation.value;
        }
        check_finite_output("the values", values)?;
        let Some(gradients) = gradients else { return Ok(()) };
        for (gradient, valuation) in gradients.chunks_exact_mut(scale.len()).zip(&self.valuations) {
            gradient.copy_from_slice(&valuation.gradient);
            scale.gradient_to_box(gradient);
        }
        check_finite_output("the gradients", gradients)
    }

    /// Takes in a batch, scaled; the observations' statistics take it in first.
    pub fn take_batch(&mut self, observations: &[f32], actions: &[f32], next_observations: &[f32]) {
        if let Some(normaliser) = &mut self.normaliser {
            normaliser.observe(observations);
        }
        let (buffers, normaliser) = (&mut self.buffers, self.normaliser.as_ref());
        Normaliser::take_rows(normaliser, observations, &mut buffers.observations);
        Normaliser::take_rows(normaliser, next_observations, &mut buffers.next_observations);
        for rows in [&mut buffers.actions, &mut buffers.policy_actions, &mut buffers.next_actions] {
            rows.resize(actions.len(), 0.0);
        }
        self.scale.to_unit(actions, &mut buffers.actions);
    }

    /// Writes π'(s') of the batch into the buffers.
    pub fn choose_next_actions(&mut self) {
        let mut actor = self.actor.member(0);
        let actions = actor.target_values(&self.buffers.next_observations, &[]);
        self.buffers.next_actions.copy_from_slice(actions);
    }

    /// Writes π(s) of the batch into the buffers. To be called before [`ascend`](Self::ascend).
    pub fn choose_policy_actions(&mut self) {
        let mut actor = self.actor.member(0);
        actor.observe(&self.buffers.observations);
        self.buffers.policy_actions.copy_from_slice(actor.values(&[]));
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
        let rows = self.buffers.observations.len() / self.observation_len();
        let share = 1.0 / (rows * steps.len()) as f32;
        let mut actor = self.actor.member(0);
        let (_, gradients) = actor.outputs();
        gradients.fill(0.0);
        for step in steps {
            for (gradient, ascent) in gradients.iter_mut().zip(&step.action_gradients) {
                *gradient -= share * ascent;
            }
        }
        actor.backward(&self.buffers.observations, &[]);
        let norm = actor.gradient_norm();
        if !norm.is_finite() {
            return Err(Error::GradientNotFinite(norm));
        }
        actor.clipped_step(clip, optimiser, tau);
        self.actor.count_step();
        Ok(norm)
    }

    /// Appends everything that must be kept to continue exactly.
    ///
    /// # Errors
    /// [`Error::ForeignState`] if it cannot be written.
    pub fn save(&self, magic: &[u8], bytes: &mut Vec<u8>) -> Result<(), Error> {
        let view = StateView {
            actor: self.actor.state(),
            critics: self.critics.state(),
            noise: &self.noise,
            normaliser: &self.normaliser,
            rng: &self.rng,
        };
        write_state(magic, &view, bytes)
    }

    /// Continues from what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// Anything that is not the state of such an agent; nothing has changed then.
    pub fn load(&mut self, magic: &[u8], bytes: &[u8]) -> Result<(), Error> {
        let state: State = read_state(magic, bytes)?;
        if state.noise.dimensions() != self.noise.dimensions() {
            return Err(Error::ForeignState("its noise has another number of dimensions".into()));
        }
        Normaliser::check_alike(self.normaliser.as_ref(), state.normaliser.as_ref())?;
        self.actor.check_state(&state.actor)?;
        self.critics.restore(state.critics)?;
        self.actor.restore(state.actor)?;
        self.noise.continue_from(state.noise);
        self.normaliser = state.normaliser;
        self.rng = state.rng;
        Ok(())
    }
}
