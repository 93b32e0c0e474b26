//! What can be asked of a drop-in.

use shield_api::{Phase, Spaces};

use super::DropIn;
use crate::{
    cycle::HardResetDue,
    diagnosis::Finding,
    events::Counters,
    experience::AgentRole,
    shield::{Judgement, Ladder},
};

impl DropIn {
    /// Who is in charge of the next step.
    pub fn phase(&self) -> Phase {
        match self.cycle.turn() {
            AgentRole::Forward => Phase::Forward,
            AgentRole::Reset => Phase::Reset,
        }
    }

    /// Whether [`hard_reset_done`](Self::hard_reset_done) must come next: the reset agent has given up, or the environment has ended.
    pub fn needs_hard_reset(&self) -> bool {
        self.hard_reset_due().is_some()
    }

    /// Why nothing may move before a hard reset, if that is so.
    pub fn hard_reset_due(&self) -> Option<HardResetDue> {
        self.cycle.hard_reset_due()
    }

    /// Whether a start was ever observed.
    pub fn is_placed(&self) -> bool {
        self.cycle.is_placed()
    }

    /// Steps of the present episode.
    pub fn episode_length(&self) -> u64 {
        self.cycle.episode_length()
    }

    /// The spaces of the environment.
    pub fn spaces(&self) -> &Spaces {
        self.ladder().spaces()
    }

    /// What a buffer holds where nothing better can be executed.
    pub fn fallback_action(&self) -> &[f32] {
        self.ladder().fallback_action()
    }

    /// Why the last action was rejected, for a person; empty if it was not.
    pub fn reason(&self) -> &str {
        self.ladder().reason()
    }

    /// What the rules were told of the last proposed action, and what they compared.
    pub fn judgement(&self) -> &Judgement {
        self.ladder().judgement()
    }

    fn ladder(&self) -> &Ladder {
        self.cycle.ladder().expect("`new` refuses a cycle without a ladder")
    }

    /// Everything that was counted; what only an environment plugin knows stays 0.
    pub fn counters(&self) -> &Counters {
        self.cycle.counters()
    }

    /// What keeps the shield from helping, as far as it was found, the earliest first: each once, with what was seen and what to do. They only
    /// grow in number, so that a caller tells a person of those beyond the ones that it knows.
    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.cycle.diagnosis().findings()
    }

    /// Mean of the reset ensemble's values of the action that was proposed last; NaN if no rule needed them.
    pub fn reset_value(&self) -> f32 {
        mean(&self.judgement().values)
    }

    /// Mean of the success critic's estimates that the action that was proposed last can be undone; NaN if no rule needed them.
    pub fn undo_probability(&self) -> f32 {
        mean(&self.judgement().probabilities)
    }

    /// Counts and the learner's figures by name, in a stable order. A figure is the mean over the episode so far, or over the last one.
    pub fn metrics(&self, take: &mut impl FnMut(&str, f64)) {
        let counters = self.counters();
        for (name, count) in [
            ("steps", counters.steps),
            ("forward_steps", counters.forward_steps),
            ("forward_episodes", counters.forward_episodes),
            ("reset_episodes", counters.reset_episodes),
            ("reset_successes", self.cycle.reset_successes()),
            ("early_aborts", counters.early_aborts),
            ("failed_closed", counters.failed_closed),
            ("projections", counters.projections),
            ("warm_up_decisions", counters.warm_up_decisions),
            ("exploration_replaced", counters.exploration_replaced),
            ("hard_resets", counters.hard_resets),
        ] {
            take(name, count as f64);
        }
        take("hard_reset_cost", counters.hard_reset_cost);
        self.metrics.each(take);
    }
}

fn mean(numbers: &[f32]) -> f32 {
    numbers.iter().sum::<f32>() / numbers.len() as f32
}
