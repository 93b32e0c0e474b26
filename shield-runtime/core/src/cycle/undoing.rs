//! What belongs to undo probabilities: how attempts ended, what was expected of them, and aborts with nothing to undo.

use serde::{Deserialize, Serialize};
use shield_api::{ActMode, ObservedAttempt, Result, StepOutcome, metrics::report};

use super::{CycleParts, Memory, ResetCycle};
use crate::{
    decision::Cause,
    events::{AttemptOutcome, EpisodeEnd, EpisodeEvent, Tally},
    experience::{AgentRole, Attempt},
    settings::{AttemptLength, Mode},
};

/// Aborts with nothing to undo in a row, after which the reset agent takes over all the same: no step is made meanwhile.
pub const MOST_IDLE_ABORTS: u32 = 10;

/// What happened since the reset set was last reached.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct SinceReset {
    /// Something may have to be undone.
    pub has_moved: bool,
    /// An abort had nothing to undo, and nothing was decided since.
    pub stays: bool,
    /// Such aborts in a row.
    idle_aborts: u32,
    /// The number of the last forward step, if nothing was executed after it.
    before: Option<u64>,
    /// The number of this attempt's first step into the reset set.
    reached: Option<u64>,
    /// What the success critic expected at the start of this attempt.
    pub predicted: Option<f32>,
}

impl SinceReset {
    /// Notes a step, which a memory stored under this number. After an abort with nothing to undo, a caller may execute what stood in for the
    /// rejected action: within the reset set, nothing is to be undone still.
    pub fn note(&mut self, turn: AgentRole, number: Option<u64>, outcome: &StepOutcome) {
        self.has_moved |= !self.stays || !outcome.in_reset_set || outcome.terminated;
        self.idle_aborts = 0;
        let Some(number) = number else { return };
        match turn {
            AgentRole::Forward => self.before = Some(number),
            AgentRole::Reset if outcome.in_reset_set && !outcome.terminated => {
                self.reached.get_or_insert(number);
            }
            AgentRole::Reset => {}
        }
    }
}

impl ResetCycle {
    /// Whether an abort now would have nothing to undo: no action was executed since the reset set was reached. Only rules that measure
    /// against that state make a difference of it.
    pub fn has_nothing_to_undo(&self) -> bool {
        let SinceReset { has_moved, idle_aborts, .. } = self.since_reset;
        let measures = self.parts.ladder.as_ref().is_some_and(|ladder| ladder.needs().undo_probabilities());
        measures && !has_moved && idle_aborts < MOST_IDLE_ABORTS && self.turn == AgentRole::Forward
    }

    /// Ends a forward episode by an abort that has nothing to undo: it costs neither an attempt nor a hard reset, and the forward agent
    /// proposes again. To the rules it is an attempt that succeeded, so that one that rejects everything at the start gives way in time.
    pub(super) fn stay(&mut self, cause: Cause) -> EpisodeEvent {
        self.since_reset.stays = true;
        self.since_reset.idle_aborts += 1;
        if !cause.is_failure() {
            self.tell_rules(true);
        }
        let tally = self.episode.take().unwrap_or_default();
        EpisodeEvent::of_forward(&tally, EpisodeEnd::Abort)
    }

    /// The step that was observed last, if it stood in for an action that was aborted with nothing to undo, and there is nothing to undo
    /// still: as an attempt of one step, which no rule hears of.
    pub(crate) fn stood_in(&self, outcome: &StepOutcome) -> Option<EpisodeEvent> {
        let SinceReset { has_moved, stays, .. } = self.since_reset;
        let is_still_there = stays && !has_moved && self.hard_reset_due.is_none();
        let mut tally = Tally::default();
        tally += outcome;
        let stood_in = EpisodeEvent::of_forward(&tally, EpisodeEnd::ResetSet);
        is_still_there.then_some(EpisodeEvent { role: AgentRole::Reset, has_reset: true, ..stood_in })
    }

    /// The next decision is measured against its own state.
    pub(super) fn begin_to_measure(&mut self) {
        if let Some(ladder) = &mut self.parts.ladder {
            ladder.begin_cycle();
        }
    }

    fn tell_rules(&mut self, succeeded: bool) {
        let Some(ladder) = &mut self.parts.ladder else { return };
        let attempt = ObservedAttempt { step: self.counters.steps, succeeded };
        self.metrics.collect(|| ladder.observe_attempt(&attempt));
    }

    /// Notes the outcome of the episode that ends, if it has one: an attempt that was not cut short, or a forward episode in which the
    /// environment ended, which is an attempt that failed before its first step. Without a shield, nobody attempts anything then.
    pub(super) fn note_outcome(
        &mut self,
        tally: &Tally,
        end: EpisodeEnd,
        has_reset: bool,
    ) -> Option<AttemptOutcome> {
        let is_shielded = self.settings.mode == Mode::Shielded;
        let length = match self.turn {
            // What is executed while a hard reset is awaited belongs to no episode.
            _ if self.hard_reset_due.is_some() => return None,
            AgentRole::Reset if !end.is_cut() && end != EpisodeEnd::WorkerLost => tally.length,
            AgentRole::Forward if is_shielded && end == EpisodeEnd::Terminated => 0,
            _ => return None,
        };
        if let Some(Memory { experience, .. }) = &mut self.parts.memory {
            let end_number = experience.next_number();
            experience.note_attempt(Attempt {
                before: self.since_reset.before,
                first: end_number.saturating_sub(length),
                end: end_number,
                reached: self.since_reset.reached,
                succeeded: has_reset,
                terminated: end == EpisodeEnd::Terminated,
            });
        }
        (self.since_reset.before, self.since_reset.reached) = (None, None);
        self.tell_rules(has_reset);
        if has_reset {
            self.begin_to_measure();
        }
        Some(if has_reset { AttemptOutcome::Succeeded } else { AttemptOutcome::Failed })
    }

    /// Notes how long the episode was that ends, since the next attempt is measured by it.
    pub(super) fn note_length(&mut self, role: AgentRole, length: u64, end: EpisodeEnd, has_reset: bool) {
        match role {
            AgentRole::Forward => self.attempts.note_forward(length),
            AgentRole::Reset if has_reset && !end.is_cut() => self.attempts.note_success(length),
            AgentRole::Reset if end == EpisodeEnd::TimeLimit => self.attempts.note_time_out(),
            AgentRole::Reset => {}
        }
        if self.settings.attempt_length == AttemptLength::Adaptive {
            let length = self.attempt_length() as f64;
            self.metrics.collect(|| report("attempt_length", length));
        }
    }

    /// At the start of an attempt: what the reset agent's values and the success critic expect of its greedy action. Only reports depend on
    /// it. A critic that fails is left to the shield, which asks it for decisions. Returns whether `action` holds the greedy action.
    ///
    /// # Errors
    /// The start [is to be valued](super::CycleSettings::values_attempts), and the reset agent failed.
    pub(super) fn look_ahead(&mut self, observation: &[f32]) -> Result<bool> {
        let CycleParts { reset: Some(reset), success, .. } = &mut self.parts else { return Ok(false) };
        let Some(episode @ Tally { length: 0, .. }) = &mut self.episode else { return Ok(false) };
        // A reset controller has no values.
        let is_valued = self.settings.values_attempts && reset.learns();
        if !is_valued && success.is_none() {
            return Ok(false);
        }
        let (members, reset) = (reset.info().members, reset.learner());
        let asked = reset.act(observation, ActMode::Greedy, &mut self.action);
        if is_valued {
            asked.clone()?;
            self.values.resize(members, 0.0);
            reset.q_values(observation, &self.action, &mut self.values)?;
            episode.reset_value = Some(mean(&self.values));
        }
        if let (Some(success), Ok(())) = (success, &asked) {
            self.values.resize(success.info().members, 0.0);
            let expected = success.critic().probabilities(observation, &self.action, &mut self.values);
            let probability = expected.ok().map(|()| mean(&self.values));
            self.since_reset.predicted = probability.filter(|mean| (0.0..=1.0).contains(mean));
        }
        Ok(asked.is_ok())
    }
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}
