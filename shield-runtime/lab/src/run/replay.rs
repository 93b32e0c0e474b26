//! What other rules would have said of the decisions of a run.

use std::path::Path;

use anyhow::{Context, Result, ensure};

use super::{
    build::replay_ladder,
    decisions::{DecisionRow, read_decisions},
};
use shield_config::experiment::Variant;
use shield_core::{
    decision::Decision,
    shield::{GivenValues, Ladder, Moment},
};
use shield_host::plugin::Registry;

/// What came of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
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
}

/// Lets the rules of `variant` judge every forward decision that the run at `run` recorded, through the plugins themselves. Nothing is
/// projected: what is counted is what the rules reject. Rules that hold a state hear of their own decisions.
///
/// # Errors
/// Nothing was recorded; a plugin is missing; the rules need values that the run did not compute.
pub fn replay(registry: &Registry, variant: &Variant, run: &Path) -> Result<Replay> {
    let mut ladder = replay_ladder(registry, variant)?;
    let needs = ladder.needs();
    let mut replay = Replay::default();
    read_decisions(run, |row| {
        if !row.is_judged_forward() {
            return Ok(true);
        }
        let lacks = |is_needed: bool, values: &[f32]| is_needed && values.is_empty();
        ensure!(
            !lacks(needs.values, &row.values) && !lacks(needs.greedy_values, &row.greedy_values),
            "the rules need reset values that no rule of the run needed, so that they were not computed"
        );
        judge(&mut ladder, &row, &mut replay);
        Ok(true)
    })
    .with_context(|| format!("{} cannot be replayed", run.display()))?;
    Ok(replay)
}

fn judge(ladder: &mut Ladder, row: &DecisionRow, replay: &mut Replay) {
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
        ..GivenValues::default()
    };
    let decision = ladder.judge_given(&given, &moment, &row.proposed);
    replay.decisions += 1;
    let Decision::Abort(abort) = decision else {
        replay.newly_allowed += u64::from(row.was_rejected());
        return;
    };
    replay.rejected += 1;
    replay.failed += u64::from(abort.cause.is_failure());
    replay.newly_rejected += u64::from(!row.was_rejected());
}
