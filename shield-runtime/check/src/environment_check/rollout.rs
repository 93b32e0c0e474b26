//! Random episodes, recorded to the bit.

use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{Environment, EnvironmentSpec, Space, StepOutcome};

use super::Subject;

/// Steps of a recorded rollout.
pub const STEPS: usize = 300;

/// Uniform in the space; an interval without an end reaches 2 far, one without both is [−1, 1].
pub fn random_action(space: &Space, rng: &mut impl Rng) -> Vec<f32> {
    let interval = |low: f32, high: f32| match (low.is_finite(), high.is_finite()) {
        (true, true) => low..=high,
        (true, false) => low..=low + 2.0,
        (false, true) => high - 2.0..=high,
        (false, false) => -1.0..=1.0,
    };
    match space {
        Space::Discrete { n } => vec![rng.random_range(0..*n) as f32],
        Space::Box { low, high } => {
            low.iter().zip(high).map(|(low, high)| rng.random_range(interval(*low, *high))).collect()
        }
    }
}

/// An instance with its buffer and its source of actions and seeds.
pub struct Rollout {
    pub environment: Box<dyn Environment>,
    pub spec: EnvironmentSpec,
    pub observation: Vec<f32>,
    rng: Pcg64,
    left: usize,
}

impl Rollout {
    pub fn new(subject: &Subject<'_>) -> Result<Self, String> {
        let environment = (subject.make)()?;
        let spec = environment.spec();
        let observation = vec![f32::NAN; spec.spaces.observation_len()];
        Ok(Self { environment, spec, observation, rng: Pcg64::seed_from_u64(subject.seed), left: 0 })
    }

    pub fn reset(&mut self, seed: u64) -> Result<(), String> {
        self.left = self.spec.episode_length;
        self.environment
            .reset(seed, &mut self.observation)
            .map_err(|error| format!("a reset with seed {seed} fails: {error}"))
    }

    pub fn step(&mut self, action: &[f32]) -> Result<StepOutcome, String> {
        self.environment
            .step(action, &mut self.observation)
            .map_err(|error| format!("a step with the action {action:?} fails: {error}"))
    }

    /// The next random action; at the end of an episode a hard reset comes first.
    pub fn act(&mut self) -> Result<Vec<f32>, String> {
        if self.left == 0 {
            let seed = self.rng.next_u64();
            self.reset(seed)?;
        }
        self.left -= 1;
        Ok(random_action(&self.spec.spaces.action, &mut self.rng))
    }

    /// One random step.
    pub fn advance(&mut self) -> Result<StepOutcome, String> {
        let action = self.act()?;
        let outcome = self.step(&action)?;
        if outcome.terminated {
            self.left = 0;
        }
        Ok(outcome)
    }

    /// Everything seen in so many random steps, as bits.
    pub fn record(&mut self, steps: usize) -> Result<Vec<u32>, String> {
        let mut bits = Vec::new();
        for _ in 0..steps {
            let outcome = self.advance()?;
            bits.extend(self.observation.iter().map(|value| value.to_bits()));
            bits.extend([outcome.forward_reward.to_bits(), outcome.reset_reward.to_bits()]);
            let flags = [outcome.in_reset_set, outcome.terminated, outcome.success, outcome.irreversible];
            bits.extend(flags.map(u32::from));
        }
        Ok(bits)
    }

    /// An action that is allowed and does little: the nearest to zero, or the first of several.
    pub fn idle(&self) -> Vec<f32> {
        let mut action = vec![0.0; self.spec.spaces.action_len()];
        self.spec.spaces.action.clamp(&mut action);
        action
    }
}
