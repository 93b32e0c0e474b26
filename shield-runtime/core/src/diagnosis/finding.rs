//! What can be wrong around a shield, in words: what was seen, and which setting changes it.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Something that keeps the shield from helping, with the figures that show it. Its [`Display`](fmt::Display) says what was seen and what to do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Finding {
    /// Too few of the last starts count as reset.
    StartsOutside {
        /// Starts that count as reset.
        inside: u32,
        /// Starts that were looked at.
        starts: u32,
    },
    /// Nobody can be asked about the starts; no state that followed one counts as reset, and no attempt succeeded.
    StartsUnlikely {
        /// Starts without such a state.
        starts: u32,
        /// Attempts without success.
        attempts: u32,
    },
    /// Nearly every state that the agent reached counts as reset.
    EveryStateInside {
        /// States that count as reset.
        inside: u64,
        /// States that were looked at.
        states: u64,
    },
    /// Attempts in a row that failed.
    NoSuccess {
        /// How many.
        attempts: u32,
        /// Of these, attempts in which the environment terminated.
        ended: u32,
        /// The steps that they took.
        steps: u64,
        /// Whether an attempt before them succeeded.
        has_succeeded: bool,
    },
    /// The rules rejected every action.
    NothingAllowed {
        /// Rejected actions in a row.
        decisions: u32,
        /// The steps meanwhile.
        steps: u64,
    },
    /// Hard resets that the caller asked for although none was due.
    ResetsRequested {
        /// How many.
        requested: u32,
        /// All hard resets.
        hard_resets: u32,
    },
    /// Hard resets because the environment ended its episode by itself, without having terminated.
    ResetsTruncated {
        /// How many.
        truncated: u32,
        /// All hard resets.
        hard_resets: u32,
        /// Steps between two hard resets, on average.
        mean_steps: f64,
    },
    /// Forward episodes that ended because the environment terminated.
    EpisodesTerminate {
        /// How many.
        terminated: u32,
        /// Forward episodes that were looked at.
        episodes: u32,
        /// Their mean length.
        mean_length: f64,
    },
    /// More attempts fail than the user accepts.
    RiskExceeded {
        /// Attempts that failed.
        failures: u32,
        /// Of these, ends of the environment, in an attempt or before one.
        ended: u32,
        /// Attempts that were looked at.
        attempts: u32,
        /// The accepted share.
        accepted: f64,
    },
    /// Attempts succeed, but take most of the steps.
    SlowReturn {
        /// Attempts that succeeded.
        successes: u32,
        /// Attempts that were looked at.
        attempts: u32,
        /// Mean length of an attempt.
        attempt_length: f64,
        /// Forward steps for each attempt.
        forward_length: f64,
    },
}

/// The share of steps that the task should have: the aim by which "most of the steps" is explained.
const GOOD_SHARE: f64 = 0.6;

impl Finding {
    /// How many kinds there are.
    pub const KINDS: usize = 10;

    /// Its name, which stays.
    pub fn name(&self) -> &'static str {
        match self {
            Self::StartsOutside { .. } => "starts-outside",
            Self::StartsUnlikely { .. } => "starts-unlikely",
            Self::EveryStateInside { .. } => "every-state-inside",
            Self::NoSuccess { .. } => "no-success",
            Self::NothingAllowed { .. } => "nothing-allowed",
            Self::ResetsRequested { .. } => "resets-requested",
            Self::ResetsTruncated { .. } => "resets-truncated",
            Self::EpisodesTerminate { .. } => "episodes-terminate",
            Self::RiskExceeded { .. } => "risk-exceeded",
            Self::SlowReturn { .. } => "slow-return",
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::StartsOutside { inside, starts } => write!(
                f,
                "only {inside} of the last {starts} starts count as reset, so an attempt fails even where it comes back to a start. \
                 Widen the reset set: the reset task \"calibrated-start\" does so from its 20th start on, so reset the environment that often \
                 at the beginning; raise `reset_task.config.radius` of \"near-start\"; let `in_reset_set` hold at the starts"
            ),
            Self::StartsUnlikely { starts, attempts } => write!(
                f,
                "none of the first states after {starts} starts counts as reset, and none of {attempts} attempts got there: probably the \
                 starts themselves do not count as reset. Name the reset task \"calibrated-start\", or widen the reset set that the \
                 environment brings"
            ),
            Self::EveryStateInside { inside, states } => write!(
                f,
                "{inside} of {states} states that the agent reached count as reset: nothing has to be undone, and the shield changes nothing. \
                 Narrow the reset set (`in_reset_set`, `reset_reward`, or `reset_task.config`: a smaller `radius` of \"near-start\" or \
                 `least_radius` of \"calibrated-start\"); where the agent does stay so near to its starts, no shield is needed"
            ),
            Self::NoSuccess { attempts, ended, steps, has_succeeded } => {
                write!(f, "the last {attempts} attempts to reset had no success in {steps} steps")?;
                f.write_str(if has_succeeded { "" } else { ", nor did any before" })?;
                if 2 * ended > attempts {
                    return write!(
                        f,
                        ": in {ended} of them the environment terminated. Do not let it terminate where it could go on (in Gymnasium often \
                         `terminate_when_unhealthy=False`), or use a reset agent that does not end it (`reset`)"
                    );
                }
                f.write_str(
                    ". If that goes on: give attempts more time (`episode_length`), widen the reset set (`reset_task`, `in_reset_set`), \
                     or use a reset agent that learns faster (`reset`, `experience.updates_per_step`) or needs not learn",
                )
            }
            Self::NothingAllowed { decisions, steps } => write!(
                f,
                "the rules rejected each of the last {decisions} proposed actions, over {steps} steps: the agent does not act any more. \
                 Accept a larger risk (`accepted_risk` of \"undo-probability\", a lower `q_min` of \"ensemble-threshold\"), or see to it \
                 that attempts succeed"
            ),
            Self::ResetsRequested { requested, hard_resets } => write!(
                f,
                "{requested} of {hard_resets} hard resets were asked for although none was due, by `reset(seed=…)`, `reset(options=…)` or \
                 the like: the reset agent got no chance to undo. Give a seed to the first reset only"
            ),
            Self::ResetsTruncated { truncated, hard_resets, mean_steps } => write!(
                f,
                "{truncated} of {hard_resets} hard resets came because the environment ended its episode by a clock of its own, every \
                 {mean_steps:.0} steps: no reset agent can go on from there. Take the clock out of the environment and set `episode_length`; \
                 a `TimeLimit` of Gymnasium is taken out for you"
            ),
            Self::EpisodesTerminate { terminated, episodes, mean_length } => write!(
                f,
                "{terminated} of the last {episodes} forward episodes ended because the environment terminated, after {mean_length:.0} steps on \
                 average: then nothing can be undone, and each costs a hard reset. If the environment could go on, do not let it terminate \
                 (in Gymnasium often `terminate_when_unhealthy=False`); else lower `accepted_risk`, so that the reset agent takes over earlier"
            ),
            Self::RiskExceeded { failures, ended, attempts, accepted } => {
                write!(
                    f,
                    "{failures} of the last {attempts} attempts failed ({:.0}%), but the accepted risk is {:.0}%. ",
                    percent(f64::from(failures) / f64::from(attempts.max(1))),
                    percent(accepted)
                )?;
                f.write_str(if 2 * ended > failures {
                    "Most of them because the environment terminated: let the critic learn more \
                     (`experience.updates_per_step`), raise `initial_threshold`, or do not let the environment terminate where it could go on"
                } else {
                    "The threshold cannot make up for a reset agent that fails from states near the start: give attempts more time \
                     (`episode_length`), let it learn more (`experience.updates_per_step`), or accept more (`accepted_risk`)"
                })
            }
            Self::SlowReturn { successes, attempts, attempt_length, forward_length } => write!(
                f,
                "{successes} of the last {attempts} attempts succeeded, but an attempt takes {attempt_length:.0} steps and the task gets \
                 {forward_length:.0} before each: {:.0}% of the steps. For {:.0}% an attempt may take at most {:.0} steps: a better reset agent \
                 (`reset`), a wider reset set (`reset_task`), or a larger `accepted_risk`, with which episodes last longer",
                percent(forward_length / (forward_length + attempt_length)),
                percent(GOOD_SHARE),
                forward_length * (1.0 - GOOD_SHARE) / GOOD_SHARE
            ),
        }
    }
}

fn percent(share: f64) -> f64 {
    100.0 * share
}
