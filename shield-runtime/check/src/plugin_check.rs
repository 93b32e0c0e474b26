//! What must hold of every plugin, as a list: `shield plugin check` runs each of it in a process of its own.

mod candidate;
mod draw;
mod kinds;
mod probe;
mod success_critic;

use shield_api::{AbortRule, Checkpoint, Learner, Policy, ResetTask, SuccessCritic};

pub use candidate::Candidate;
pub(crate) use draw::{Draw, DrawnBatch};
use probe::{Finding, Probe};

use crate::{allocations_ffi, environment_check};
use shield_host::plugin::Kind;

/// A check of plugins of one kind.
#[derive(Clone, Copy)]
pub struct Check {
    /// Short, for a table and for `--only`.
    pub name: &'static str,
    /// What must hold.
    pub rule: &'static str,
    run: Run,
}

#[derive(Clone, Copy)]
enum Run {
    Any(fn(&Candidate<'_>) -> Finding),
    Environment(fn(&environment_check::Subject<'_>) -> Finding),
    Probe(Question),
}

/// What is asked of every kind but the environment, which has checks of its own.
#[derive(Clone, Copy)]
enum Question {
    Answers,
    Seed,
    Threads,
    State,
    ForeignState,
    BadNumbers,
    Instances,
    Memory,
    Speed,
}

/// The checks that need nothing but the file and its configuration.
const OF_ALL: &[Check] = &[
    Check {
        name: "scan",
        rule: "the manifest is read in under 100 ms, without executing anything",
        run: Run::Any(|candidate| candidate.scan()),
    },
    Check {
        name: "load",
        rule: "the library loads with all its symbols, and an instance can be made",
        run: Run::Any(|candidate| candidate.load()),
    },
    Check {
        name: "manifest",
        rule: "it says what it is, and its fields and defaults make an instance",
        run: Run::Any(|candidate| candidate.manifest()),
    },
    Check {
        name: "unknown-field",
        rule: "a configuration with an unknown field, or that is not RON, is refused",
        run: Run::Any(|candidate| candidate.unknown_field()),
    },
];

const OF_KINDS: &[Check] = &[
    Check {
        name: "answers",
        rule: "answers are finite and lie in their spaces; nothing is written outside of the buffers",
        run: Run::Probe(Question::Answers),
    },
    Check {
        name: "seed",
        rule: "the same seed and the same questions give the same answers, bit for bit",
        run: Run::Probe(Question::Seed),
    },
    Check {
        name: "threads",
        rule: "the answers do not depend on the number of threads",
        run: Run::Probe(Question::Threads),
    },
    Check {
        name: "state",
        rule: "a saved state, loaded into another instance, continues bit for bit",
        run: Run::Probe(Question::State),
    },
    Check {
        name: "foreign-state",
        rule: "bytes that are not a state are refused, and nothing changes",
        run: Run::Probe(Question::ForeignState),
    },
    Check {
        name: "bad-numbers",
        rule: "NaN and ±∞ are refused, never answered or allowed, and nothing changes",
        run: Run::Probe(Question::BadNumbers),
    },
    Check {
        name: "instances",
        rule: "instances on several threads at once do not disturb each other",
        run: Run::Probe(Question::Instances),
    },
    Check {
        name: "memory",
        rule: "1,000 instances, made and ended, leave no memory behind",
        run: Run::Probe(Question::Memory),
    },
    Check { name: "speed", rule: "what one round of calls takes", run: Run::Probe(Question::Speed) },
];

/// Every check of a kind, quick ones first.
pub fn checks(kind: Kind) -> Vec<Check> {
    let own: Vec<Check> = match kind {
        Kind::Environment => {
            let of_environments = environment_check::CHECKS.iter();
            let run = |check: &environment_check::Check| Run::Environment(check.run);
            of_environments
                .map(|check| Check { name: check.name, rule: check.rule, run: run(check) })
                .collect()
        }
        Kind::SuccessCritic => [OF_KINDS, success_critic::CHECKS].concat(),
        _ => OF_KINDS.to_vec(),
    };
    [OF_ALL, &own].concat()
}

impl Check {
    /// Runs the check in this process. What the plugin does to the process, it does to the caller.
    ///
    /// # Errors
    /// A sentence that says what does not hold.
    pub fn run(&self, candidate: &Candidate<'_>) -> Finding {
        match self.run {
            Run::Any(run) => run(candidate),
            Run::Environment(run) => {
                let make = || candidate.environment();
                run(&environment_check::Subject {
                    make: &make,
                    is_deterministic: candidate.manifest.deterministic,
                    seed: candidate.seed,
                    allocations: allocations_ffi::counter(),
                })
            }
            Run::Probe(question) => probed(candidate, question),
        }
    }
}

fn probed(candidate: &Candidate<'_>, question: Question) -> Finding {
    let spaces = &candidate.spaces()?;
    let (seed, is_deterministic) = (candidate.seed, candidate.manifest.deterministic);
    macro_rules! ask {
        ($kind:ty, $make:ident, $round:expr, $refusals:expr) => {{
            let make =
                |seed, threads| -> Result<Box<$kind>, String> { candidate.$make(spaces, seed, threads) };
            let (round, refusals) = ($round, $refusals);
            answer(&Probe::<$kind> { make: &make, round, refusals, spaces, seed, is_deterministic }, question)
        }};
    }
    match candidate.kind {
        Kind::Learner => ask!(dyn Learner, learner, kinds::learner_round, kinds::learner_refusals),
        Kind::Policy => ask!(dyn Policy, policy, kinds::policy_round, kinds::policy_refusals),
        Kind::AbortRule => ask!(dyn AbortRule, abort_rule, kinds::rule_round, kinds::rule_refusals),
        Kind::ResetTask => {
            ask!(dyn ResetTask, reset_task, kinds::reset_task_round, kinds::reset_task_refusals)
        }
        Kind::SuccessCritic => {
            ask!(dyn SuccessCritic, success_critic, success_critic::round, success_critic::refusals)
        }
        Kind::Environment => Err("an environment has checks of its own".into()),
    }
}

fn answer<T: Checkpoint + ?Sized>(probe: &Probe<'_, T>, question: Question) -> Finding {
    match question {
        Question::Answers => probe.answers(),
        Question::Seed => probe.seed(),
        Question::Threads => probe.threads(),
        Question::State => probe.state(),
        Question::ForeignState => probe.foreign_state(),
        Question::BadNumbers => probe.bad_numbers(),
        Question::Instances => probe.instances(),
        Question::Memory => environment_check::leaves_no_memory(&|| probe.short_life()),
        Question::Speed => probe.speed(),
    }
}
