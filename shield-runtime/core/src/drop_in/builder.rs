//! A drop-in shield, field by field.

use std::time::Duration;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{AbortRule, Error, Learner, ResetTask, Result, Spaces, SuccessCritic};

use super::DropIn;
use crate::{
    agent::Agent,
    critic::Critic,
    cycle::{CycleParts, CycleSettings, Memory, ResetCycle},
    experience::{AgentRole, Experience},
    settings::{AttemptLength, Endings, ProjectionConfig, Updates},
    shield::{LadderParts, RuleTree},
};

/// What the reset agent learns from, and when.
pub struct Learning {
    /// Where its transitions go.
    pub experience: Experience,
    /// Transitions of one update.
    pub batch: usize,
    /// Updates after each step of which it learns.
    pub updates_per_step: usize,
    /// It learns after every n-th step only; 0 counts as 1.
    pub update_every: u64,
    /// Whether it learns from every step, or from its own only.
    pub updates: Updates,
    /// How attempts end for its values.
    pub endings: Endings,
    /// How much of a hard reset's cost it loses.
    pub cost_weight: f32,
    /// Of its batches and bootstrap masks.
    pub seed: u64,
}

impl Learning {
    /// One update after every step, with the usual endings.
    pub fn new(experience: Experience, batch: usize, seed: u64) -> Self {
        let (updates, endings) = (Updates::Both, Endings::default());
        let (updates_per_step, update_every) = (1, 1);
        Self { experience, batch, updates_per_step, update_every, updates, endings, cost_weight: 0.0, seed }
    }
}

/// Describes a [`DropIn`]; what is not said has the defaults of an experiment, but nothing is let through in a warm-up.
pub struct DropInBuilder {
    spaces: Spaces,
    reset_agent: Box<dyn Learner>,
    success_critic: Option<Box<dyn SuccessCritic>>,
    reset_task: Option<Box<dyn ResetTask>>,
    calibration_resets: u32,
    ladder: LadderParts,
    learning: Option<Learning>,
    settings: CycleSettings,
}

impl DropInBuilder {
    pub(super) fn new(spaces: Spaces, reset_agent: Box<dyn Learner>) -> Self {
        Self {
            spaces,
            reset_agent,
            success_critic: None,
            reset_task: None,
            calibration_resets: 0,
            ladder: LadderParts::default(),
            learning: None,
            settings: CycleSettings {
                explores: false,
                values_attempts: false,
                stores_forward: false,
                ..CycleSettings::default()
            },
        }
    }

    /// Says what "reset" means; without one, every [`DropIn::observe`] must.
    #[must_use]
    pub fn reset_task(mut self, task: Box<dyn ResetTask>) -> Self {
        self.reset_task = Some(task);
        self
    }

    /// Estimates how likely an action can be undone, for rules that need it. It learns if the reset agent [does](Self::learning), from an
    /// experience [with what it needs](Experience::with_undo).
    #[must_use]
    pub fn success_critic(mut self, critic: Box<dyn SuccessCritic>) -> Self {
        self.success_critic = Some(critic);
        self
    }

    /// One more rule, or rules composed; all must allow an action.
    #[must_use]
    pub fn rules(mut self, rules: RuleTree) -> Self {
        self.ladder.rules.push(rules);
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
        self.ladder.projection = Some(projection);
        self
    }

    /// A decision that takes longer is an abort.
    #[must_use]
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.ladder.deadline = Some(deadline);
        self
    }

    /// What the buffer holds after an abort where the reset agent's action is not usable, and while a hard reset is awaited. Default: the
    /// action of the space that is nearest to 0.
    #[must_use]
    pub fn fallback_action(mut self, action: Vec<f32>) -> Self {
        self.ladder.fallback_action = Some(action);
        self
    }

    /// Steps at the beginning during which rules that need learned values are not asked, for a reset agent that has learned nothing yet.
    /// Default: 0.
    #[must_use]
    pub fn warm_up_steps(mut self, steps: u64) -> Self {
        self.ladder.warm_up_steps = steps;
        self
    }

    /// Further starts that the reset task is to be shown before the first step ([`DropIn::calibration_resets`]). Default: 0.
    #[must_use]
    pub fn calibration_resets(mut self, number: u32) -> Self {
        self.calibration_resets = number;
        self
    }

    /// Failed attempts in a row after which a hard reset is needed (default 1); `None`: never.
    #[must_use]
    pub fn reset_attempts(mut self, limit: Option<u32>) -> Self {
        self.settings.reset_attempts = limit;
        self
    }

    /// Steps after which an attempt that has not seen the reset set has failed. Default: 500.
    #[must_use]
    pub fn attempt_length(mut self, steps: u64) -> Self {
        (self.settings.episode_length, self.settings.attempt_length) = (steps, AttemptLength::Episode);
        self
    }

    /// As [`attempt_length`](Self::attempt_length), but an attempt has failed sooner where others succeeded in fewer steps
    /// ([`AttemptLength::Adaptive`]).
    #[must_use]
    pub fn attempt_length_at_most(mut self, steps: u64) -> Self {
        (self.settings.episode_length, self.settings.attempt_length) = (steps, AttemptLength::Adaptive);
        self
    }

    /// Whether an attempt ends as soon as the reset set is reached. Default: true.
    #[must_use]
    pub fn stop_on_reset(mut self, stops: bool) -> Self {
        self.settings.stop_on_reset = stops;
        self
    }

    /// Lets the reset agent explore and learn. Default: it acts as well as it can.
    #[must_use]
    pub fn learning(mut self, learning: Learning) -> Self {
        self.learning = Some(learning);
        self
    }

    /// The shield.
    ///
    /// # Errors
    /// There is no rule; something does not fit the spaces or the rules; a number is 0 that must not be.
    pub fn build(self) -> Result<DropIn> {
        let Self { spaces, reset_agent, mut settings, learning, .. } = self;
        if self.ladder.rules.is_empty() {
            return Err(Error::invalid_config("a shield without any rule would never abort"));
        }
        if settings.reset_attempts == Some(0) || settings.episode_length == 0 {
            return Err(Error::invalid_config(
                "there is at least one attempt to reset, of at least one step",
            ));
        }
        let critic = self.success_critic.as_ref().map(|critic| critic.info());
        let ladder = self.ladder.build(&spaces, &*reset_agent, critic)?;
        let (mut batch, mut seed, mut memory) = (0, 0, None);
        if let Some(learning) = learning {
            if self.success_critic.is_some() && !learning.experience.keeps_undo() {
                return Err(Error::invalid_config(
                    "the success critic would learn nothing: make the experience `with_undo`",
                ));
            }
            let Learning { updates_per_step, update_every, updates, endings, cost_weight, .. } = learning;
            settings =
                CycleSettings { updates_per_step, update_every, updates, endings, cost_weight, ..settings };
            settings.explores = true;
            (batch, seed) = (learning.batch, learning.seed);
            let masks = Pcg64::seed_from_u64(seed.wrapping_add(1));
            memory = Some(Memory { experience: learning.experience, masks });
        }
        let lengths = [spaces.observation_len(), spaces.action_len()];
        let sampler = Pcg64::seed_from_u64(seed);
        let reset = Agent::new(AgentRole::Reset, reset_agent, batch, &spaces, sampler);
        let sampler = Pcg64::seed_from_u64(seed.wrapping_add(2));
        let success = self.success_critic.map(|critic| Critic::new(critic, batch, &spaces, sampler));
        let parts = CycleParts { forward: None, reset: Some(reset), success, ladder: Some(ladder), memory };
        DropIn::new(ResetCycle::new(settings, parts, lengths), self.reset_task)?
            .with_calibration_resets(self.calibration_resets)
    }
}
