//! Keeping the state of a loop, and going on from it.

use std::sync::atomic::Ordering;

use shield_api::{Error, check_length};

use super::{JointLoop, Participants};
use crate::{
    agent::{Agent, ForwardAgent},
    evaluation::Evaluator,
    experience::AgentRole,
    loop_state::LoopState,
    observer::{Occasion, Snapshot},
    plugin,
    record::Tally,
    shield::{restore_rules, save_rules},
};

/// Where a loop begins.
#[derive(Debug, Clone, Copy)]
pub(super) enum Start {
    /// With the first placing, which is not counted.
    New,
    /// Within an episode.
    Within(Tally),
    /// With a counted hard reset: something was lost.
    HardReset,
    /// Nothing is left to be done.
    Finished,
}

impl Participants {
    /// Gives both agents and the rules what they had learned; the world stays as it is.
    ///
    /// # Errors
    /// A plugin refuses its state.
    pub fn restore_agents(&mut self, state: &LoopState) -> shield_api::Result<()> {
        if let (Some(forward), Some(state)) = (&mut self.forward, &state.forward) {
            of_plugin("forward", forward.restore(state))?;
        }
        if let (Some(reset), Some(state)) = (&mut self.reset, &state.reset) {
            of_plugin("reset", reset.restore(state))?;
        }
        of_plugin("shield.rules", restore_rules(self.shield.as_mut(), &state.rules))
    }

    /// Gives everyone the state of a run. Those who refused must not be used any more.
    ///
    /// # Errors
    /// A plugin refuses its state, or the state is of another run.
    pub fn restore(&mut self, state: &LoopState) -> shield_api::Result<()> {
        let is_complete = (self.forward.is_some(), self.reset.is_some(), self.evaluator.is_some())
            == (state.forward.is_some(), state.reset.is_some(), state.evaluator.is_some());
        if !is_complete {
            return Err(Error::invalid_argument("it is the state of a run with other agents"));
        }
        if let Some(previous) = &state.previous {
            check_length("the saved action", previous, self.world.spec().spaces.action_len())?;
        }
        self.restore_agents(state)?;
        of_plugin("environment", self.world.restore(&state.world))?;
        match (&mut self.evaluator, &state.evaluator) {
            (Some(evaluator), Some(state)) => of_plugin("evaluation", evaluator.restore(state)),
            _ => Ok(()),
        }
    }
}

/// Says which field of the experiment names the plugin that refuses its state.
fn of_plugin(field: &str, restored: shield_api::Result<()>) -> shield_api::Result<()> {
    restored.map_err(|error| Error::new(error.kind(), format!("`{field}`: {error}")))
}

impl JointLoop<'_> {
    /// Goes on from the `state` that [`Participants::restore`] gave to the participants; their experience must be that of the same moment.
    /// Where a plugin could not save its state, the loop goes on from a counted hard reset.
    pub fn go_on(&mut self, state: &LoopState) {
        if let Some(previous) = &state.previous {
            self.previous.copy_from_slice(previous);
        }
        plugin::restore_metrics(&state.metrics);
        self.randomness = state.randomness.clone();
        self.has_previous = state.previous.is_some();
        self.counters = state.counters;
        self.attempts.restore(state.failed_attempts);
        self.was_irreversible = state.was_irreversible;
        self.last_evaluation = state.last_evaluation;
        self.last_checkpoint = Some(state.counters.steps);
        self.start = if state.is_finished {
            Start::Finished
        } else if state.unsaved().is_empty() {
            self.turn = state.turn;
            Start::Within(state.tally)
        } else {
            Start::HardReset
        };
    }

    /// Something was lost when the run was stopped: it goes on from a hard reset, which counts.
    pub(super) fn lose_the_world(&mut self) -> anyhow::Result<()> {
        // The world's state is not known, so neither is what kind of hard reset it needs.
        self.counters.hard_resets += 1;
        self.counters.hard_reset_cost += self.settings.hard_reset_cost;
        self.attempts.clear();
        self.place()
    }

    /// Between two steps of `role`'s episode: keeps the state where that is due. Returns whether the run was stopped here.
    pub(super) fn pause(&mut self, role: AgentRole, tally: &Tally) -> anyhow::Result<bool> {
        let is_stopped = self.stop.load(Ordering::Relaxed);
        if let Some(every) = self.settings.checkpoint_every
            && self.last_checkpoint != Some(self.counters.steps)
        {
            // The first is due before the first step: from then on, a run that is killed can go on. A stop changes nothing about a
            // checkpoint that is due in every run.
            if self.counters.steps.is_multiple_of(every) {
                self.keep(Occasion::Periodic, role, tally)?;
            } else if is_stopped {
                self.keep(Occasion::Interrupted, role, tally)?;
            }
        }
        self.is_interrupted |= is_stopped;
        Ok(is_stopped)
    }

    /// After the last step and the last evaluation.
    pub(super) fn keep_finished(&mut self) -> anyhow::Result<()> {
        match self.settings.checkpoint_every {
            Some(_) => self.keep(Occasion::Finished, self.turn, &Tally::default()),
            None => Ok(()),
        }
    }

    fn keep(&mut self, occasion: Occasion, turn: AgentRole, tally: &Tally) -> anyhow::Result<()> {
        self.last_checkpoint = Some(self.counters.steps);
        let state = LoopState {
            counters: self.counters,
            is_finished: occasion == Occasion::Finished,
            turn,
            tally: *tally,
            failed_attempts: self.attempts.failed(),
            was_irreversible: self.was_irreversible,
            previous: self.has_previous.then(|| self.previous.clone()),
            last_evaluation: self.last_evaluation,
            randomness: self.randomness.clone(),
            world: self.world.save()?,
            forward: self.forward.as_ref().map(ForwardAgent::save).transpose()?,
            reset: self.reset.as_ref().map(Agent::save).transpose()?,
            rules: save_rules(self.shield.as_mut())?,
            evaluator: self.evaluator.as_mut().map(Evaluator::save).transpose()?,
            metrics: plugin::save_metrics(),
        };
        self.observer.on_checkpoint(&Snapshot { occasion, state: &state, experience: &self.experience })
    }
}
