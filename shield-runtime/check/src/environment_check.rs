//! What must hold of every environment, as a list: `shield env check` and the tests run the same checks.

mod checks;
mod guarded;
mod rollout;

use shield_api::Environment;

pub use checks::leaves_no_memory;
pub(crate) use guarded::{Guarded, bits};
pub use rollout::random_action;

/// An environment to be checked.
pub struct Subject<'a> {
    /// Makes a new instance. Every instance has the same configuration.
    pub make: &'a (dyn Fn() -> Result<Box<dyn Environment>, String> + Sync),
    /// Its manifest says that the same seed gives the same behaviour.
    pub is_deterministic: bool,
    /// Seed of starts and actions.
    pub seed: u64,
    /// None where the program cannot count.
    pub allocations: Option<&'a CountAllocations>,
}

/// Runs the closure and says how often this thread allocated meanwhile.
pub type CountAllocations = dyn Fn(&mut dyn FnMut()) -> u64;

/// What a check that did not fail says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// It holds; what was seen.
    Passed(String),
    /// It cannot be told; why.
    Skipped(String),
}

/// A check.
pub struct Check {
    /// Short, for a table.
    pub name: &'static str,
    /// What must hold.
    pub rule: &'static str,
    /// `Err` says what does not hold.
    pub run: fn(&Subject<'_>) -> Result<Verdict, String>,
}

/// Every check, quick ones first.
pub const CHECKS: &[Check] = &[
    Check {
        name: "spaces",
        rule: "the spaces can exist, actions have bounds, and observations lie in theirs",
        run: checks::spaces,
    },
    Check {
        name: "finite",
        rule: "every observation and reward of random episodes is finite",
        run: checks::finite,
    },
    Check {
        name: "guards",
        rule: "nothing is written outside of the observation, nor into the action",
        run: checks::guards,
    },
    Check { name: "reset-reward", rule: "the reset reward lies in [0, 1]", run: checks::reset_reward },
    Check {
        name: "seed",
        rule: "the same seed and actions give the same episodes, bit for bit, in any instance",
        run: checks::seed,
    },
    Check {
        name: "state",
        rule: "a saved state, loaded into another instance, continues bit for bit",
        run: checks::state,
    },
    Check {
        name: "foreign-state",
        rule: "bytes that are not a state are refused, and nothing changes",
        run: checks::foreign_state,
    },
    Check {
        name: "reset-set",
        rule: "a hard reset leads into the reset set, and never to an irreversible state",
        run: checks::reset_set,
    },
    Check { name: "starts", rule: "every named start can be reached, no other", run: checks::starts },
    Check {
        name: "bad-actions",
        rule: "an action of the wrong length, NaN or infinite is an error, and nothing changes",
        run: checks::bad_actions,
    },
    Check {
        name: "instances",
        rule: "instances on several threads at once do not disturb each other",
        run: checks::instances,
    },
    Check {
        name: "picture",
        rule: "a picture can be drawn, shows the state, and changes nothing",
        run: checks::picture,
    },
    Check { name: "allocations", rule: "a step allocates nothing", run: checks::allocations },
    Check {
        name: "memory",
        rule: "1,000 instances, made and ended, leave no memory behind",
        run: checks::memory,
    },
];
