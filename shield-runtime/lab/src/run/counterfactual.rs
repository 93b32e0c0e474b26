//! What would have come of an action, had it been executed: the sampled states, restored.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use shield_api::{ActMode, Learner};

use super::{folder::RunFolder, launch::restore};
use crate::joint_loop::LoopParts;
use shield_core::world::{Stepped, World};
use shield_decisions::read_decisions;
use shield_host::plugin::Registry;

/// What came of the sampled actions. Each is followed by the final reset policy alone: single-step counterfactuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counterfactual {
    /// Sampled actions that the run rejected.
    pub rejected: u64,
    /// Of these, actions that the final reset policy undoes: false aborts.
    pub rejected_but_undone: u64,
    /// Sampled actions that the run allowed.
    pub allowed: u64,
    /// Of these, actions that the final reset policy does not undo: missed.
    pub allowed_but_lost: u64,
}

/// For each decision that the run at `run` recorded with the environment's state (`record: (states_every: …)`): restores the state, executes the
/// proposed action, and lets the final reset policy, from the run's checkpoint, act until the reset set is reached or an episode is over.
/// `progress` hears how many were tried.
///
/// # Errors
/// The run has no checkpoint or no states; a plugin is missing or fails.
pub fn counterfactual(
    registry: &Registry,
    run: &Path,
    mut progress: impl FnMut(u64),
) -> Result<Counterfactual> {
    let restored = restore(registry, &RunFolder::at(run), &[])?;
    let LoopParts { mut world, agents, .. } = restored.parts;
    let mut reset = agents.reset.context("the run has no reset agent")?;
    world.hard_reset(None, restored.run.seed)?;
    restored.state.restore_reset_task(&mut world)?;
    let mut action = vec![0.0; world.spec().spaces.action_len()];
    let mut tried = Counterfactual::default();
    read_decisions(run, |row| {
        if row.state.is_empty() || !row.is_judged_forward() {
            return Ok(true);
        }
        world.restore_environment(&row.state, &row.observation)?;
        action.copy_from_slice(&row.proposed);
        let is_undone = can_be_undone(&mut world, reset.learner(), &mut action)?;
        if row.was_rejected() {
            tried.rejected += 1;
            tried.rejected_but_undone += u64::from(is_undone);
        } else {
            tried.allowed += 1;
            tried.allowed_but_lost += u64::from(!is_undone);
        }
        progress(tried.rejected + tried.allowed);
        Ok(true)
    })?;
    ensure!(
        tried.rejected + tried.allowed > 0,
        "{} has no decision with the environment's state: run it with `record: (states_every: 100)`",
        run.display()
    );
    Ok(tried)
}

/// Executes `action`, then what the reset agent thinks best.
fn can_be_undone(world: &mut World, reset: &mut dyn Learner, action: &mut [f32]) -> Result<bool> {
    for _ in 0..=world.spec().episode_length {
        let Stepped::Made(outcome) = world.step(action)? else {
            bail!("the environment's process was lost on the way");
        };
        world.advance();
        if outcome.in_reset_set || outcome.terminated {
            return Ok(outcome.in_reset_set && !outcome.terminated);
        }
        reset.act(world.observation(), ActMode::Greedy, action)?;
    }
    Ok(false)
}
