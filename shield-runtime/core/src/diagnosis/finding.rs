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
    /// Attempts, whether they succeed or not, take nearly all steps.
    FewForwardSteps {
        /// Steps of the forward agent.
        forward: u32,
        /// Steps that were looked at.
        steps: u32,
        /// Attempts that ended in them.
        attempts: u32,
        /// Of these, attempts that succeeded.
        successes: u32,
        /// Of these, attempts in which the environment terminated.
        ended: u32,
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
    /// Most steps of the agent are worth less to it than an abort.
    AbortsPay {
        /// Rewards below that of an abort.
        below: u32,
        /// Rewards that were looked at.
        rewards: u32,
        /// Their mean.
        mean: f64,
        /// The reward of an abort.
        abort_reward: f64,
    },
}

/// A finding, when it was made, and whether it still holds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// As it was when it was made.
    pub finding: Finding,
    /// Environment steps before.
    pub step: u64,
    /// It holds no more: what was wrong has passed.
    pub is_over: bool,
}

/// What to do where attempts succeed and take too long.
const SOONER_BACK: &str = "If that goes on: make the reset set easier to reach (`in_reset_set` or `reset_task`: let it hold wherever the task can begin anew), give \
     a reset agent that knows the way (`reset_policy`, `reset`), or accept a larger risk (`accepted_risk`), with which episodes last longer";
/// What to do where the environment ends attempts.
const GO_ON: &str = "If that goes on: do not let it terminate where it could go on (in Gymnasium often \
     `terminate_when_unhealthy=False`), or give a reset agent that does not end it (`reset_policy`, `reset`); where a hard reset costs \
     little, train without a shield";
/// What to do where attempts run out of time.
const BETTER_AGENT: &str = "If that goes on: let episodes be shorter, so that there is less to undo and the reset agent gets more attempts; \
     widen the reset set (`in_reset_set`, `reset_task`); give an agent that knows the way (`reset_policy`, `reset`), or more time to attempts that \
     need it (`shield.attempt_length`)";

/// The share of steps that the task should have: the aim by which "most of the steps" is explained.
const GOOD_SHARE: f64 = 0.6;

impl Finding {
    /// How many kinds there are.
    pub const KINDS: usize = 12;

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
            Self::FewForwardSteps { .. } => "few-forward-steps",
            Self::SlowReturn { .. } => "slow-return",
            Self::AbortsPay { .. } => "aborts-pay",
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
                    return write!(f, ": in {ended} of them the environment terminated. {GO_ON}");
                }
                write!(f, ". {BETTER_AGENT}")
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
                 (in Gymnasium often `terminate_when_unhealthy=False`); else lower `accepted_risk`, so that the reset agent takes over earlier. \
                 Where a hard reset costs little, train without a shield"
            ),
            Self::RiskExceeded { failures, ended, attempts, accepted } => {
                write!(
                    f,
                    "{failures} of the last {attempts} attempts failed ({:.0}%), but the accepted risk is {:.0}%. ",
                    percent(f64::from(failures) / f64::from(attempts.max(1))),
                    percent(accepted)
                )?;
                if 2 * ended > failures {
                    write!(f, "Most of them because the environment terminated. {GO_ON}")
                } else {
                    write!(
                        f,
                        "No threshold makes up for a reset agent that fails from states near the start. {BETTER_AGENT}"
                    )
                }
            }
            Self::FewForwardSteps { forward, steps, attempts, successes, ended } => {
                write!(
                    f,
                    "only {forward} of the last {steps} steps were those of the task; the others were spent on attempts to reset, \
                     {successes} of {attempts} with success. "
                )?;
                f.write_str(if 2 * successes >= attempts && attempts > 0 {
                    SOONER_BACK
                } else if 2 * ended > attempts {
                    GO_ON
                } else {
                    BETTER_AGENT
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
            Self::AbortsPay { below, rewards, mean, abort_reward } => write!(
                f,
                "{below} of the last {rewards} rewards were below {abort_reward}, which an aborted step gives: to end an episode by an abort pays, \
                 and an agent that learns will seek it. Set `abort_reward` to what the rest of an episode costs: the mean reward of a step \
                 was {mean:.3}"
            ),
        }
    }
}

fn percent(share: f64) -> f64 {
    100.0 * share
}
