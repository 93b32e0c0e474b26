//! The joint loop, field by field: each setting changes what a scripted run does.

#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "../common/mod.rs"]
mod common;
mod deciding;
mod evaluations;
mod learning;
mod resets;

use common::{PIT, Rule};
use shield_api::{AbortRule, RuleVerdict};

/// Rejects actions that lead into the pit.
fn no_pit() -> Vec<Box<dyn AbortRule>> {
    vec![Rule::judging(|context| {
        let falls = context.observation[0] >= (PIT - 1) as f32 && context.proposed[0] > 0.0;
        Ok(RuleVerdict::from_safe(!falls, context.observation[0]))
    })]
}
