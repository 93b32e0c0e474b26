//! What happened between the decisions of a run, as its rules heard of it.

use std::{collections::HashMap, path::Path, vec::IntoIter};

use anyhow::Result;
use shield_api::ObservedAttempt;

use crate::run::attempts::read_episodes;
use shield_core::{cycle::MOST_IDLE_ABORTS, decision::Decision, events::AttemptOutcome, shield::Ladder};
use shield_decisions::DecisionRow;

/// The attempts of a run that are still to be told, and where its reset cycles began.
#[derive(Default)]
pub(super) struct History {
    attempts: IntoIter<ObservedAttempt>,
    /// Steps at which nothing had to be undone, and how often the world was put back there: each time, aborts are counted anew.
    starts: HashMap<u64, u32>,
    /// The last step at which an abort had nothing to undo, and how many such aborts there were.
    idle: (u64, u32),
}

impl History {
    /// From the episodes of the run.
    pub fn read(run: &Path) -> Result<Self> {
        let mut attempts = Vec::new();
        let mut starts = HashMap::from([(0, 1)]);
        for episode in read_episodes(run)? {
            let succeeded = episode.attempt == Some(AttemptOutcome::Succeeded);
            let times = [episode.has_reset, episode.hard_reset].into_iter().map(u32::from).sum::<u32>();
            if times > 0 {
                *starts.entry(episode.step).or_default() += times;
            }
            attempts.extend(episode.attempt.map(|_| ObservedAttempt { step: episode.step, succeeded }));
        }
        Ok(Self { attempts: attempts.into_iter(), starts, idle: (0, 0) })
    }

    /// Tells the rules of every attempt that had ended when a decision was made after so many steps.
    pub fn tell_until(&mut self, step: u64, ladder: &mut Ladder) {
        while let Some(attempt) = self.attempts.as_slice().first().filter(|attempt| attempt.step <= step) {
            ladder.observe_attempt(attempt);
            self.attempts.next();
        }
    }

    /// Takes note of what is decided on the action of a row. To the rules, an abort with nothing to undo is an attempt that succeeded, as in
    /// the reset cycle: whether there is one depends on the rules that are replayed, not on the run. Where the run projected the action, the
    /// episode went on.
    pub fn note(&mut self, row: &DecisionRow, decision: Decision, ladder: &mut Ladder) {
        let Decision::Abort(abort) = decision else { return };
        let step = row.step;
        let Some(times) = self.starts.get(&step).filter(|_| row.verdict != "project") else { return };
        if self.idle.0 != step {
            self.idle = (step, 0);
        }
        if self.idle.1 < MOST_IDLE_ABORTS * times {
            self.idle.1 += 1;
            if !abort.cause.is_failure() {
                ladder.observe_attempt(&ObservedAttempt { step, succeeded: true });
            }
        }
    }
}
