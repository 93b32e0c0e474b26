//! What other rules would have said of the decisions of a run.

mod history;

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use shield_api::{Needs, metrics::Metrics};

use self::history::History;
use super::recorded::Recorded;
use shield_core::{
    decision::Decision,
    shield::{GivenValues, Ladder, Moment},
};
use shield_decisions::{DecisionRow, read_decisions};
use shield_host::plugin::Registry;

/// Under this name the rule `undo-probability` reports its threshold.
const THRESHOLD: &str = "threshold";

/// What came of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Replay {
    /// Decisions on forward actions that were judged, those of the warm-up not among them.
    pub decisions: u64,
    /// Of these, actions that the rules reject.
    pub rejected: u64,
    /// Of these, actions that the rules reject because something fails.
    pub failed: u64,
    /// Actions that the run rejected, and these rules allow.
    pub newly_allowed: u64,
    /// Actions that the run allowed, and these rules reject.
    pub newly_rejected: u64,
    /// The mean of the threshold over these decisions, of a rule that moves it.
    pub mean_threshold: Option<f64>,
}

/// Lets the rules of `recorded` judge every forward decision that the folder `run` holds, through the plugins themselves. Nothing is
/// projected: what is counted is what the rules reject. Rules that hold a state hear of their own decisions. Rules that need undo
/// probabilities also hear how the attempts of the run ended: of attempts that were not made, nobody knows the end.
///
/// # Errors
/// Nothing was recorded; a plugin is missing; the rules need values that the run did not compute.
pub fn replay(registry: &Registry, recorded: &Recorded, run: &Path) -> Result<Replay> {
    let mut ladder = recorded.ladder(registry, run)?;
    let needs = ladder.needs();
    let mut history = if needs.undo_probabilities() { History::read(run)? } else { History::default() };
    let metrics = Metrics::default();
    let (mut replay, mut thresholds) = (Replay::default(), Vec::new());
    read_decisions(run, |row| {
        if row.phase != "forward" {
            return Ok(true);
        }
        history.tell_until(row.step, &mut ladder);
        // In the warm-up nothing is counted, but rules with a state hear of it.
        let is_counted = row.is_judged_forward();
        if is_counted {
            ensure_computed(needs, &row)?;
        }
        let decision = metrics.collect(|| judge(&mut ladder, &row));
        history.note(&row, decision, &mut ladder);
        if ladder.is_broken() {
            bail!("a rule fails: {}", ladder.reason());
        }
        if is_counted {
            replay.count(&row, decision);
        }
        metrics.drain(&mut |name, figure| {
            if is_counted && name == THRESHOLD {
                thresholds.push(figure);
            }
        });
        Ok(true)
    })
    .with_context(|| format!("{} cannot be replayed", run.display()))?;
    let sum: f64 = thresholds.iter().sum();
    replay.mean_threshold = (!thresholds.is_empty()).then(|| sum / thresholds.len() as f64);
    Ok(replay)
}

/// Refuses a decision of which nobody computed what the rules need.
fn ensure_computed(needs: Needs, row: &DecisionRow) -> Result<()> {
    let lacks = |is_needed: bool, figures: &[f32]| is_needed && figures.is_empty();
    ensure!(
        !lacks(needs.values, &row.values) && !lacks(needs.greedy_values, &row.greedy_values),
        "the rules need reset values that no rule of the run needed, so that they were not computed"
    );
    ensure!(
        !lacks(needs.probabilities, &row.probabilities)
            && !lacks(needs.any_greedy_probabilities(), &row.greedy_probabilities),
        "the rules need undo probabilities that no rule of the run needed, so that they were not computed"
    );
    Ok(())
}

fn judge(ladder: &mut Ladder, row: &DecisionRow) -> Decision {
    let has_previous = row.previous.iter().all(|value| value.is_finite());
    let moment = Moment {
        step: row.step,
        observation: &row.observation,
        previous: has_previous.then_some(&row.previous),
    };
    let given = GivenValues {
        values: &row.values,
        greedy_values: &row.greedy_values,
        forward_values: &row.forward_values,
        probabilities: &row.probabilities,
        greedy_probabilities: &row.greedy_probabilities,
        start_probabilities: &row.start_probabilities,
    };
    ladder.judge_given(&given, &moment, &row.proposed)
}

impl Replay {
    fn count(&mut self, row: &DecisionRow, decision: Decision) {
        self.decisions += 1;
        let Decision::Abort(abort) = decision else {
            self.newly_allowed += u64::from(row.was_rejected());
            return;
        };
        self.rejected += 1;
        self.failed += u64::from(abort.cause.is_failure());
        self.newly_rejected += u64::from(!row.was_rejected());
    }
}
