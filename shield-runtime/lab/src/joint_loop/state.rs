//! Keeping the state of a loop, and going on from it.

use super::{JointLoop, LoopParts};
use crate::{
    evaluation::Evaluator,
    loop_state::{LoopRandomness, LoopState},
    observer::{Occasion, Snapshot},
};
use shield_api::{Error, check_length};
use shield_core::cycle::{CycleParts, LearnedState, Memory, of_plugin};

/// Where a loop begins.
#[derive(Debug, Clone, Copy)]
pub(super) enum Start {
    /// With the first placing, which is not counted.
    New,
    /// Within an episode.
    Within,
    /// With a counted hard reset: something was lost.
    HardReset,
    /// Nothing is left to be done.
    Finished,
}

impl LoopParts {
    /// Gives both agents and the rules what they had learned; the world stays as it is.
    ///
    /// # Errors
    /// A plugin refuses its state.
    pub fn restore_agents(&mut self, state: &LoopState) -> shield_api::Result<()> {
        self.agents.restore(&state.learned)?;
        self.agents.restore_undo(&state.undo)
    }

    /// Gives everyone the state of a run. Those who refused must not be used any more.
    ///
    /// # Errors
    /// A plugin refuses its state, or the state is of another run.
    pub fn restore(&mut self, state: &LoopState) -> shield_api::Result<()> {
        let CycleParts { forward, reset, success, .. } = &self.agents;
        let LearnedState { forward: saved_forward, reset: saved_reset, .. } = &state.learned;
        let is_complete = [forward.is_some(), reset.is_some(), success.is_some(), self.evaluator.is_some()]
            == [
                saved_forward.is_some(),
                saved_reset.is_some(),
                state.undo.critic.is_some(),
                state.evaluator.is_some(),
            ];
        if !is_complete {
            return Err(Error::invalid_argument("it is the state of a run with other agents"));
        }
        if let Some(previous) = state.cycle.previous() {
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

impl JointLoop<'_> {
    /// Goes on from the `state` that [`LoopParts::restore`] gave to its parts; their experience must be that of the same moment.
    /// Where a plugin could not save its state, the loop goes on from a counted hard reset.
    pub fn go_on(&mut self, state: &LoopState) {
        self.cycle.metrics().restore(&state.metrics);
        let LoopRandomness { resets, masks } = state.randomness.clone();
        self.resets = resets;
        if let Some(memory) = &mut self.cycle.parts_mut().memory {
            memory.masks = masks;
        }
        self.cycle.restore_counts(state.counters, 0);
        self.last_evaluation = state.last_evaluation;
        self.last_checkpoint = Some(state.counters.steps);
        self.cycle.go_on(&state.cycle);
        self.cycle.go_on_undoing(&state.undo);
        self.start = if state.is_finished {
            Start::Finished
        } else if state.unsaved().is_empty() {
            Start::Within
        } else {
            Start::HardReset
        };
    }

    /// Something was lost when the run was stopped: it goes on from a hard reset, which counts.
    pub(super) fn lose_the_world(&mut self) -> anyhow::Result<()> {
        // The world's state is not known, so neither is what kind of hard reset it needs.
        self.cycle.count_hard_reset(1.0, false);
        self.place()
    }

    /// After the last step and the last evaluation.
    pub(super) fn keep_finished(&mut self) -> anyhow::Result<()> {
        match self.settings.checkpoint_every {
            Some(_) => self.keep(Occasion::Finished),
            None => Ok(()),
        }
    }

    pub(super) fn keep(&mut self, occasion: Occasion) -> anyhow::Result<()> {
        self.last_checkpoint = Some(self.counters().steps);
        let learned = self.cycle.parts_mut().save()?;
        let (cycle, undo) = (self.cycle.save(), self.cycle.save_undo()?);
        let Some(Memory { experience, masks }) = &self.cycle.parts().memory else { return Ok(()) };
        let randomness = LoopRandomness { resets: self.resets.clone(), masks: masks.clone() };
        let state = LoopState {
            counters: *self.cycle.counters(),
            is_finished: occasion == Occasion::Finished,
            cycle,
            last_evaluation: self.last_evaluation,
            randomness,
            world: self.world.save()?,
            learned,
            evaluator: self.evaluator.as_mut().map(Evaluator::save).transpose()?,
            metrics: self.cycle.metrics().save(),
            undo,
        };
        self.observer.on_checkpoint(&Snapshot { occasion, state: &state, experience })
    }
}
