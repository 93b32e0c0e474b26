//! What an agent has beside its networks: scales, exploration, the last batch.

use rand::RngExt;
use rand_pcg::Pcg64;

use crate::{
    ActionScale, AgentSettings, Error, Noise, Normaliser, check_finite_output,
    checks::{check_argument, check_length},
};

/// Scales, exploration and the memory that is kept between calls. Whoever computes the networks, this is the same.
#[derive(Debug)]
pub struct Body {
    /// The last batch.
    pub buffers: Buffers,
    /// The generator of everything random after the weights.
    pub rng: Pcg64,
    /// Between the actions' box and [-1, 1].
    pub scale: ActionScale,
    /// Statistics of the observations, where these are normalised.
    pub normaliser: Option<Normaliser>,
    /// Exploration noise.
    pub noise: Noise,
    random_steps: u64,
    observation_len: usize,
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
    /// One observation, for everything that is not an update.
    pub observation: Vec<f32>,
    /// One action in [-1, 1], likewise.
    pub action: Vec<f32>,
}

impl Body {
    /// Of an agent with these settings, whose weights are drawn.
    pub fn new(settings: &AgentSettings<'_>, rng: Pcg64) -> Self {
        let observation_len = settings.observation_len;
        Self {
            buffers: Buffers::default(),
            rng,
            scale: settings.scale.clone(),
            normaliser: settings.normalise_observations.then(|| Normaliser::new(observation_len)),
            noise: Noise::new(settings.noise, settings.sigma, settings.scale.len()),
            random_steps: settings.random_steps,
            observation_len,
        }
    }

    /// How many values an observation has.
    pub fn observation_len(&self) -> usize {
        self.observation_len
    }

    /// Writes an action in its box: that of `policy`, which is given the observation as the networks see it and the place for an action
    /// in [-1, 1]; exploring, a uniform or a disturbed one. Otherwise no random number is drawn.
    ///
    /// # Errors
    /// A wrong length or a value that is not finite; the policy's; [`Error::OutputNotFinite`].
    pub fn act(
        &mut self,
        observation: &[f32],
        explores: bool,
        action: &mut [f32],
        policy: impl FnOnce(&[f32], &mut [f32]) -> Result<(), Error>,
    ) -> Result<(), Error> {
        if !self.begin_action(observation, explores, action)? {
            policy(&self.buffers.observation, &mut self.buffers.action)?;
            if explores {
                self.noise.disturb(&mut self.buffers.action, &mut self.rng);
            }
        }
        self.end_action(action)
    }

    /// Takes in the observation, and draws a uniform action into the buffers if it is one of the first exploring ones. Returns whether it did:
    /// if not, the action is still to be chosen.
    ///
    /// # Errors
    /// A wrong length or a value that is not finite.
    pub(crate) fn begin_action(
        &mut self,
        observation: &[f32],
        explores: bool,
        action: &[f32],
    ) -> Result<bool, Error> {
        check_argument("observation", observation, self.observation_len)?;
        check_length("action", action, self.scale.len())?;
        self.buffers.action.resize(action.len(), 0.0);
        let is_uniform = explores && self.noise.step() < self.random_steps;
        if is_uniform {
            self.noise.skip();
            self.buffers.action.fill_with(|| self.rng.random_range(-1.0..=1.0));
        } else {
            Normaliser::take_rows(self.normaliser.as_ref(), observation, &mut self.buffers.observation);
        }
        Ok(is_uniform)
    }

    /// Writes the action of the buffers in its box.
    ///
    /// # Errors
    /// [`Error::OutputNotFinite`].
    pub(crate) fn end_action(&self, action: &mut [f32]) -> Result<(), Error> {
        check_finite_output("the actor's output", &self.buffers.action)?;
        self.scale.from_unit(&self.buffers.action, action);
        Ok(())
    }

    /// Takes in one observation and one action, scaled.
    ///
    /// # Errors
    /// A wrong length or a value that is not finite.
    pub fn take_one(&mut self, observation: &[f32], action: &[f32]) -> Result<(), Error> {
        check_argument("observation", observation, self.observation_len)?;
        check_argument("action", action, self.scale.len())?;
        Normaliser::take_rows(self.normaliser.as_ref(), observation, &mut self.buffers.observation);
        self.buffers.action.resize(action.len(), 0.0);
        self.scale.to_unit(action, &mut self.buffers.action);
        Ok(())
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
}
