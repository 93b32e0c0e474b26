//! What each call of a plugin costs: time and allocations, through the binary interface, as a run pays for it.

mod calls;
mod meter;

use std::time::Duration;

use serde::Serialize;
use shield_api::Spaces;

use crate::plugin_check::{Candidate, Draw};
use meter::Meter;
use shield_host::plugin::Kind;

/// What is measured, and for how long.
#[derive(Debug, Clone)]
pub struct Settings {
    /// How long each function is called.
    pub time: Duration,
    /// The spaces in which the plugin works: the first usual ones that it accepts, if none are given. An environment brings its own.
    pub spaces: Option<Spaces>,
    /// Transitions in a batch of a learner's update.
    pub batch: usize,
    /// Members of the ensembles whose values a rule is shown.
    pub members: usize,
}

/// What one function costs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// The function.
    pub call: &'static str,
    /// How often it was called.
    pub calls: u64,
    /// Median time of a call, in nanoseconds.
    pub p50_ns: f64,
    /// Of a hundred calls, 99 take at most so long, in nanoseconds.
    pub p99_ns: f64,
    /// Allocations of a call, in the plugin and in every library that it links; `None` where this system does not let them be counted.
    pub allocations: Option<f64>,
}

/// Measures every function of the plugin that it supports. `tell` hears what is measured next.
///
/// # Errors
/// A sentence that says which call fails, or why no instance can be made.
pub fn bench(
    candidate: &Candidate<'_>,
    settings: &Settings,
    tell: &mut dyn FnMut(&str),
) -> Result<Vec<Measured>, String> {
    let mut meter = Meter::new(settings.time, tell);
    if candidate.kind == Kind::Environment {
        calls::environment(candidate, &mut meter)?;
        return Ok(meter.measured);
    }
    let spaces = settings.spaces.clone().map_or_else(|| candidate.spaces(), Ok)?;
    let draw = Draw::new(&spaces, candidate.seed);
    let mut bench = calls::Bench { candidate, settings, draw, meter };
    match candidate.kind {
        Kind::Environment => {}
        Kind::Learner => bench.learner()?,
        Kind::Policy => bench.policy()?,
        Kind::AbortRule => bench.abort_rule()?,
        Kind::ResetTask => bench.reset_task()?,
        Kind::SuccessCritic => bench.success_critic()?,
    }
    Ok(bench.meter.measured)
}
