//! A shield, field by field.

use std::time::Duration;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{AbortRule, Error, Learner, Result, Spaces};

use super::{Ladder, LadderSettings, ResetSettings, RuleTree, Shield, nearest_to_zero};
use crate::{agent::Agent, experience::AgentRole, settings::ProjectionConfig};

/// Describes a [`Shield`]; what is not said has the defaults of an experiment, but nothing is let through in a warm-up.
pub struct ShieldBuilder {
    spaces: Spaces,
    reset_agent: Box<dyn Learner>,
    rules: Vec<RuleTree>,
    projection: Option<ProjectionConfig>,
    deadline: Option<Duration>,
    fallback_action: Option<Vec<f32>>,
    warm_up_steps: u64,
    resets: ResetSettings,
    batch: usize,
    seed: u64,
}

impl ShieldBuilder {
    pub(super) fn new(spaces: Spaces, reset_agent: Box<dyn Learner>) -> Self {
        Self {
            spaces,
            reset_agent,
            rules: Vec::new(),
            projection: None,
            deadline: None,
            fallback_action: None,
            warm_up_steps: 0,
            resets: ResetSettings::default(),
            batch: 0,
            seed: 0,
        }
    }

    /// One more rule, or rules composed; all must allow an action.
    #[must_use]
    pub fn rules(mut self, rules: RuleTree) -> Self {
        self.rules.push(rules);
        self
    }

    /// One more rule.
    #[must_use]
    pub fn rule(self, rule: Box<dyn AbortRule>) -> Self {
        self.rules(RuleTree::Rule(rule))
    }

    /// What is tried with a rejected action before it is aborted.
    #[must_use]
    pub fn projection(mut self, projection: ProjectionConfig) -> Self {
        self.projection = Some(projection);
        self
    }

    /// A decision that takes longer is an abort.
    #[must_use]
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = Some(deadline);
        self
    }

    /// What the buffer holds after an abort where the reset agent's action is not usable, and while a hard reset is awaited. Default: the
    /// action of the space that is nearest to 0.
    #[must_use]
    pub fn fallback_action(mut self, action: Vec<f32>) -> Self {
        self.fallback_action = Some(action);
        self
    }

    /// Steps at the beginning during which nothing is aborted, for a reset agent that has learned nothing yet. Default: 0.
    #[must_use]
    pub fn warm_up_steps(mut self, steps: u64) -> Self {
        self.warm_up_steps = steps;
        self
    }

    /// Failed reset episodes in a row after which a hard reset is needed (default 1); `None`: never.
    #[must_use]
    pub fn reset_attempts(mut self, limit: Option<u32>) -> Self {
        self.resets.attempts = limit;
        self
    }

    /// Steps after which a reset episode that has not seen the reset set has failed. Default: 500.
    #[must_use]
    pub fn episode_length(mut self, steps: u64) -> Self {
        self.resets.episode_length = steps;
        self
    }

    /// Whether a reset episode ends as soon as the reset set is reached. Default: true.
    #[must_use]
    pub fn stop_on_reset(mut self, stops: bool) -> Self {
        self.resets.stop_on_reset = stops;
        self
    }

    /// Lets the reset agent explore, and learn from batches of this size where it is asked to. Default: it acts as well as it can.
    #[must_use]
    pub fn learning(mut self, batch: usize, seed: u64) -> Self {
        (self.batch, self.seed) = (batch, seed);
        self
    }

    /// The shield.
    ///
    /// # Errors
    /// There is no rule; something does not fit the spaces or the rules; a number is 0 that must not be.
    pub fn build(self) -> Result<Shield> {
        if self.rules.is_empty() {
            return Err(Error::invalid_config("a shield without any rule would never abort"));
        }
        if self.resets.attempts == Some(0) || self.resets.episode_length == 0 {
            return Err(Error::invalid_config(
                "there is at least one attempt to reset, of at least one step",
            ));
        }
        let fallback_action = self.fallback_action.unwrap_or_else(|| nearest_to_zero(&self.spaces.action));
        let (spaces, warm_up_steps) = (self.spaces.clone(), self.warm_up_steps);
        let settings = LadderSettings { spaces, warm_up_steps, fallback_action };
        let mut ladder = Ladder::new(RuleTree::All(self.rules), &*self.reset_agent, settings)?;
        if let Some(projection) = self.projection {
            ladder = ladder.with_projection(projection)?;
        }
        if let Some(deadline) = self.deadline {
            ladder = ladder.with_deadline(deadline);
        }
        let sampler = Pcg64::seed_from_u64(self.seed);
        let reset_agent = Agent::new(AgentRole::Reset, self.reset_agent, self.batch, &self.spaces, sampler);
        Ok(Shield::new(ladder, reset_agent, self.resets, self.batch > 0))
    }
}
