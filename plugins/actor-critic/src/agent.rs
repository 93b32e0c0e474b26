//! What every learner with an actor and critics consists of. How it learns is its own.

use rand::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    ActionScale, Activation, Adam, AgentState, Architecture, Ensemble, Error, Initialisation, Noise,
    NoiseProcess, Regularisation, Schedule, body::Body, check_finite_output, checks::check_length,
    read_state, write_state, write_tensors,
};

/// How an [`Agent`]'s critics value one (s, a).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Valuation {
    /// With the weights themselves.
    F32,
    /// With copies of the weights in 16 bits, each within 2⁻¹¹ of its size; see [`Ensemble::value_in_half`]. Gradients are in `f32`.
    Half,
}

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
    /// The hidden layer of a critic at which the action enters, from 0.
    pub action_layer: usize,
    /// What follows the hidden layers of both.
    pub activation: Activation,
    /// What a critic has beside its layers; of the actor, batch renormalisation alone is the same.
    pub regularisation: Regularisation,
    /// How the weights of both begin.
    pub initialisation: Initialisation,
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
    /// How one (s, a) is valued.
    pub valuation: Valuation,
    /// How much the entropy of a stochastic policy weighs at first, beside the values.
    pub initial_temperature: f32,
    /// How many threads the critics may use.
    pub threads: usize,
    /// Seed of the weights and of the exploration.
    pub seed: u64,
}

/// How the actor's outputs become actions. Its state is saved with the agent's.
pub trait Policy: Serialize + DeserializeOwned + Send + Sized + 'static {
    /// Of an agent with these settings.
    fn new(settings: &AgentSettings<'_>) -> Self;

    /// The shape of its network.
    ///
    /// # Errors
    /// [`Error::Shape`] for an empty layer or none.
    fn architecture(settings: &AgentSettings<'_>) -> Result<Architecture, Error>;

    /// Writes an action in [-1, 1] from the outputs for one observation: the greedy one, or an exploring one if noise and generator are given.
    fn act(&self, outputs: &[f32], explores: Option<(&mut Noise, &mut Pcg64)>, unit: &mut [f32]);

    /// Whether a saved one can be continued from.
    ///
    /// # Errors
    /// [`Error::StateNotFinite`].
    fn check(&self) -> Result<(), Error>;

    /// Continues from a saved one.
    fn restore(&mut self, saved: Self);
}

/// An actor, an ensemble of critics, exploration, scales, and the memory that is kept between calls.
#[derive(Debug)]
pub struct PolicyAgent<P> {
    /// π, with its target network π'.
    pub actor: Ensemble<f32>,
    /// Q₁ … Qₙ, with their target networks; a member's networks are successive. They see actions scaled to [-1, 1].
    pub critics: Ensemble<f32>,
    /// Everything that is no network.
    pub body: Body,
    /// What the actor's outputs say.
    pub policy: P,
    networks_per_member: usize,
    /// Per member.
    answers: Vec<Answer>,
    /// One value per network, where the values come from copies of the weights.
    half_values: Vec<f32>,
}

/// One member's value of one (s, a), and its gradient with respect to the action.
#[derive(Debug, Clone)]
struct Answer {
    value: f32,
    /// Of an earlier action where it was not asked for.
    gradient: Vec<f32>,
}

impl<P: Policy> PolicyAgent<P> {
    /// Draws the initial weights.
    ///
    /// # Errors
    /// Networks that cannot be built, an empty ensemble, or threads that could not be started.
    pub fn new(settings: AgentSettings<'_>) -> Result<Self, Error> {
        let AgentSettings {
            observation_len, activation, initialisation, members, networks_per_member, ..
        } = settings;
        let action_len = settings.scale.len();
        let mut rng = Pcg64::seed_from_u64(settings.seed);
        let regularisation = settings.regularisation;
        let batch_renorm = regularisation.batch_renorm;
        let actor =
            P::architecture(&settings)?.regularised(Regularisation { batch_renorm, ..Default::default() });
        let actor = Ensemble::new(actor, initialisation, 1, 1, &mut rng)?;
        let critic = Architecture::critic(
            observation_len,
            action_len,
            settings.critic_hidden,
            settings.action_layer,
            activation,
        )?
        .regularised(regularisation);
        // One thread per member at most: its networks are worked on by the same.
        let threads = settings.threads.min(members);
        let mut critics =
            Ensemble::new(critic, initialisation, members * networks_per_member, threads, &mut rng)?;
        if let Some(value) = settings.initial_value {
            critics.raise_outputs(value);
        }
        if regularisation.batch_renorm.is_some() {
            critics.keep_passes(networks_per_member);
        }
        if settings.valuation == Valuation::Half {
            critics.keep_halves();
        }
        Ok(Self {
            actor,
            critics,
            body: Body::new(&settings, rng),
            policy: P::new(&settings),
            networks_per_member,
            answers: vec![Answer { value: 0.0, gradient: vec![0.0; action_len] }; members],
            half_values: vec![0.0; members * networks_per_member],
        })
    }

    /// How many values an observation has.
    pub fn observation_len(&self) -> usize {
        self.critics.architecture().observation_len()
    }

    /// How many values an action has.
    pub fn action_len(&self) -> usize {
        self.body.scale.len()
    }

    /// Writes the policy's action in its box; exploring, a uniform one or one that the policy draws. Otherwise no random number is drawn.
    ///
    /// # Errors
    /// A wrong length or a value that is not finite; [`Error::OutputNotFinite`].
    pub fn act(&mut self, observation: &[f32], explores: bool, action: &mut [f32]) -> Result<(), Error> {
        if !self.body.begin_action(observation, explores, action)? {
            let Body { buffers, noise, rng, .. } = &mut self.body;
            let mut actor = self.actor.member(0);
            actor.observe(&buffers.observation);
            self.policy.act(actor.values(&[]), explores.then_some((noise, rng)), &mut buffers.action);
        }
        self.body.end_action(action)
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
        check_length("values", values, self.answers.len())?;
        let with_gradients = gradients.is_some();
        if let Some(gradients) = &gradients {
            check_length("gradients", gradients, self.answers.len() * self.action_len())?;
        }
        self.body.take_one(observation, action)?;
        let (buffers, scale) = (&self.body.buffers, &self.body.scale);
        let halves = &mut self.half_values;
        if !with_gradients && self.critics.value_in_half(&buffers.observation, &buffers.action, halves) {
            for (value, networks) in values.iter_mut().zip(halves.chunks_exact(self.networks_per_member)) {
                *value = networks.iter().copied().fold(f32::INFINITY, smaller);
            }
            return check_finite_output("the values", values);
        }
        self.critics.for_each_group(self.networks_per_member, &mut self.answers, |group, answer| {
            answer.value = f32::INFINITY;
            for network in 0..group.size() {
                let mut critic = group.member(network);
                critic.observe(&buffers.observation);
                let value = critic.values(&buffers.action)[0];
                // Once there, NaN stays: no comparison with it is true.
                if value < answer.value || value.is_nan() {
                    answer.value = value;
                    if with_gradients {
                        critic.action_gradients(&mut answer.gradient);
                    }
                }
            }
        });
        for (value, answer) in values.iter_mut().zip(&self.answers) {
            *value = answer.value;
        }
        check_finite_output("the values", values)?;
        let Some(gradients) = gradients else { return Ok(()) };
        for (gradient, answer) in gradients.chunks_exact_mut(scale.len()).zip(&self.answers) {
            gradient.copy_from_slice(&answer.gradient);
            scale.gradient_to_box(gradient);
        }
        check_finite_output("the gradients", gradients)
    }

    /// Begins an update: critics with dropout drop units until they have [counted a step](Ensemble::count_step).
    pub fn begin_update(&mut self) {
        self.critics.begin_update(&mut self.body.rng);
    }

    /// A step of the actor down the gradient in its outputs, for the batch's observations. Returns the norm of the gradient of the weights
    /// before it was clipped.
    ///
    /// # Errors
    /// [`Error::GradientNotFinite`]; the actor has taken no step then.
    pub(crate) fn step_actor(&mut self, optimiser: &Adam, clip: Option<f32>, tau: f64) -> Result<f32, Error> {
        let mut actor = self.actor.member(0);
        actor.backward(&self.body.buffers.observations, &[]);
        let norm = actor.gradient_norm();
        if !norm.is_finite() {
            return Err(Error::GradientNotFinite(norm));
        }
        actor.keep_statistics();
        actor.clipped_step(clip, optimiser, tau);
        self.actor.count_step();
        Ok(norm)
    }

    /// Appends all weights as a safetensors file: `actor`, `critics.i`, the same under `target_`, `action.low` and `action.high`,
    /// and where observations are normalised `observation.mean` and `observation.deviation`.
    ///
    /// # Errors
    /// [`Error::Tensors`].
    pub fn write_weights(&self, bytes: &mut Vec<u8>) -> Result<(), Error> {
        let mut tensors = self.actor.tensors("actor", true);
        tensors.extend(self.critics.tensors("critics", false));
        tensors.extend(self.body.scale.tensors());
        tensors.extend(self.body.normaliser.iter().flat_map(|normaliser| normaliser.tensors()));
        write_tensors(&tensors, bytes)
    }

    /// Appends everything that must be kept to continue exactly.
    ///
    /// # Errors
    /// [`Error::ForeignState`] if it cannot be written.
    pub fn save(&self, magic: &[u8], bytes: &mut Vec<u8>) -> Result<(), Error> {
        let state = self.body.state(self.actor.state(), self.critics.state());
        write_state(magic, &(state, &self.policy), bytes)
    }

    /// Continues from what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// Anything that is not the state of such an agent; nothing has changed then.
    pub fn load(&mut self, magic: &[u8], bytes: &[u8]) -> Result<(), Error> {
        let (state, policy): (AgentState<'static>, P) = read_state(magic, bytes)?;
        let AgentState { actor, critics, body } = state;
        self.body.check_state(&body)?;
        policy.check()?;
        self.actor.check_state(&actor)?;
        self.critics.restore(critics.into_owned())?;
        self.actor.restore(actor.into_owned())?;
        self.body.restore(body);
        self.policy.restore(policy);
        Ok(())
    }
}

/// The smaller of two values; NaN if one of them is, where `f32::min` would hide it.
pub fn smaller(a: f32, b: f32) -> f32 {
    if a < b || a.is_nan() { a } else { b }
}
