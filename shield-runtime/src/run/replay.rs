//! What other rules would have said of the decisions of a run.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use shield_api::{ActMode, Batch, Checkpoint, Learner, LearnerInfo};

use super::{
    build::replay_ladder,
    decisions::{DecisionRow, read_decisions},
};
use crate::{
    decision::Decision,
    experiment::Variant,
    plugin::Registry,
    shield::{Agents, Ladder, Moment},
};

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

/// Says what was recorded. The values of the state are asked for first, by a greedy action.
struct Recording {
    info: LearnerInfo,
    values: Vec<f32>,
    greedy_values: Vec<f32>,
    is_greedy: bool,
}

impl Checkpoint for Recording {}

impl Learner for Recording {
    fn info(&self) -> LearnerInfo {
        self.info
    }

    fn act(&mut self, _: &[f32], _: ActMode, action: &mut [f32]) -> shield_api::Result<()> {
        self.is_greedy = true;
        action.fill(0.0);
        Ok(())
    }

    fn q_values(&mut self, _: &[f32], _: &[f32], values: &mut [f32]) -> shield_api::Result<()> {
        let recorded = if std::mem::take(&mut self.is_greedy) { &self.greedy_values } else { &self.values };
        shield_api::check_length("the recorded values", recorded, values.len())?;
        values.copy_from_slice(recorded);
        Ok(())
    }

    fn update(&mut self, _: &Batch<'_>) -> shield_api::Result<()> {
        Ok(())
    }
}

/// Lets the rules of `variant` judge every forward decision that the run at `run` recorded, through the plugins themselves. Nothing is
/// projected: what is counted is what the rules reject. Rules that hold a state hear of their own decisions.
///
/// # Errors
/// Nothing was recorded; a plugin is missing; the rules need values that the run did not compute.
pub fn replay(registry: &Registry, variant: &Variant, run: &Path) -> Result<Replay> {
    let (mut ladder, info) = replay_ladder(registry, variant)?;
    let needs = ladder.needs();
    let recording = |values, greedy_values| Recording { info, values, greedy_values, is_greedy: false };
    let (mut reset, mut forward) = (recording(Vec::new(), Vec::new()), recording(Vec::new(), Vec::new()));
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
        judge(&mut ladder, &mut reset, &mut forward, row, &mut replay);
        Ok(true)
    })
    .with_context(|| format!("{} cannot be replayed", run.display()))?;
    Ok(replay)
}

fn judge(
    ladder: &mut Ladder,
    reset: &mut Recording,
    forward: &mut Recording,
    row: DecisionRow,
    replay: &mut Replay,
) {
    let was_rejected = row.was_rejected();
    (reset.values, reset.greedy_values, reset.is_greedy) = (row.values, row.greedy_values, false);
    forward.info.members = row.forward_values.len();
    forward.values = row.forward_values;
    let has_previous = row.previous.iter().all(|value| value.is_finite());
    let moment = Moment {
        step: row.step,
        observation: &row.observation,
        previous: has_previous.then_some(&row.previous),
    };
    let has_forward = forward.info.members > 0;
    let forward = has_forward.then_some(forward as &mut dyn Learner);
    let mut action = row.proposed;
    let decision = ladder.filter(Agents { reset, forward }, &moment, &mut action);
    replay.decisions += 1;
    let Decision::Abort(abort) = decision else {
        replay.newly_allowed += u64::from(was_rejected);
        return;
    };
    replay.rejected += 1;
    replay.failed += u64::from(abort.cause.is_failure());
    replay.newly_rejected += u64::from(!was_rejected);
}
