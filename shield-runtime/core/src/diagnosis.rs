//! What keeps a shield from helping, found while it runs.
//!
//! The [reset cycle](crate::cycle) tells of every start, decision, step and episode; each [`Finding`] is given once. Counting allocates
//! nothing, and decides nothing: a diagnosis never changes a run.

mod finding;
mod forward_share;
mod rewards;
#[cfg(test)]
mod tests;

pub use finding::{Finding, Found};
use forward_share::ForwardShare;
use rewards::Rewards;

use serde::{Deserialize, Serialize};
use shield_api::{StepOutcome, metrics::Metrics};

use crate::{
    cycle::HardResetDue,
    events::{EpisodeEnd, Tally},
    experience::AgentRole,
};

/// Of so many starts most must lie outside: where each lies inside with probability 0.95, fewer than half of five do in one case of a thousand.
const FEWEST_STARTS: u32 = 5;
/// The last starts that are looked at: what was learned of earlier ones has moved the reset set since.
const MOST_STARTS: u32 = 10;
/// States after a start that are looked at where nobody can be asked about the start: few, for a policy leaves the reset set on purpose.
const STATES_AFTER_START: u32 = 3;
/// Attempts that must have failed before starts are suspected: of a few, an untrained reset agent fails each.
const SUSPECT_ATTEMPTS: u32 = 3;
/// Forward states before it is said that all lie in the reset set: several episodes of most environments, and a quarter of what a user should wait.
const FEWEST_STATES: u64 = 500;
/// The share of them from which the shield has nothing to do: fewer than one state in a hundred is left to be undone.
const NEARLY_ALL: f64 = 0.99;
/// Attempts in a row that must fail: at an accepted risk of 0.05 they do by chance in one case of 10¹³.
const FAILED_ATTEMPTS: u32 = 10;
/// With a larger accepted risk, so many that chance explains less than this.
const CHANCE: f64 = 1e-6;
/// Long attempts are told of sooner: three of them, if they took so many steps in all that the user would wait for thousands more.
const LONG_ATTEMPTS: (u32, u64) = (3, 1_500);
/// Steps of attempts, the present one included, after which it is told that none has ever succeeded.
const NEVER_BACK: u64 = 900;
/// This share of the forward agent's states in the reset set shows that it can be reached: an attempt will come there too.
const SOME: f64 = 0.01;
/// Steps without an allowed action, and the rejected actions that must lie in them: twice the usual length of an attempt.
const NOTHING_ALLOWED: (u64, u32) = (1_000, 3);
/// Hard resets of one cause before it is said that it is the usual one.
const FEWEST_RESETS: u32 = 5;
/// Forward episodes that are looked at together.
const EPISODES: u32 = 20;
/// Of these, how many must terminate: four of five.
const TERMINATED_EPISODES: u32 = 16;
/// Before so many steps an untrained shield prevents nothing yet, a reset task knows few starts, and no judgement on either is fair.
const SETTLED_STEPS: u64 = 1_000;
/// The last attempts over which the realised risk is taken, all of which must be there: fewer say too little about a risk of 0.05.
const RISK_WINDOW: u32 = 40;
/// So many standard deviations of a share of attempts above the accepted one are no chance.
const DEVIATIONS: f64 = 3.0;
/// Attempts that are looked at together for the time that they take, in at least [`SETTLED_STEPS`].
const ATTEMPTS: u32 = 20;
/// Nearly always: the share of attempts that succeed.
const USUAL_SUCCESS: f64 = 0.9;
/// The share of forward steps below which attempts take most of the steps.
const HALF: f64 = 0.5;

/// Why a hard reset is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
enum ResetCause {
    /// Failed attempts, a terminated environment, a lost one.
    Due,
    /// The environment ended its episode by itself.
    Truncated,
    /// The caller wanted it.
    Requested,
}

/// Counts what happens around a shield, and concludes what is wrong.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Diagnosis {
    found: [Option<Found>; Finding::KINDS],
    steps: u64,
    starts: Starts,
    forward_states: u64,
    forward_inside: u64,
    attempts: Attempts,
    rejected: Rejected,
    resets: Resets,
    episodes: Episodes,
    share: Share,
    forward_share: ForwardShare,
    rewards: Rewards,
    accepted_risk: Option<f64>,
}

/// Whether starts count as reset.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Starts {
    /// The last of which it is known, as bits; 1 is inside.
    recent: u16,
    known: u32,
    /// States since the last start.
    states: u32,
    /// Starts after which no state was inside.
    left_at_once: u32,
    /// Some state after a start was.
    is_reached: bool,
}

/// How attempts ended.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Attempts {
    /// The last ones as bits; 1 is a failure.
    recent: u128,
    /// The same; 1 is an end of the environment.
    recent_ends: u128,
    ended: u32,
    successes: u32,
    failed_in_a_row: u32,
    /// Of these, ends of the environment.
    ended_in_a_row: u32,
    failed_steps: u64,
    /// Steps of the one under way.
    present_steps: u64,
}

/// Rejected actions since the last allowed one.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Rejected {
    decisions: u32,
    since: u64,
}

/// Hard resets by their cause.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Resets {
    cause: Option<ResetCause>,
    total: u32,
    truncated: u32,
    requested: u32,
    steps: u64,
}

/// The present group of forward episodes.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Episodes {
    count: u32,
    terminated: u32,
    steps: u64,
}

/// The present group of attempts.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct Share {
    attempts: u32,
    successes: u32,
    attempt_steps: u64,
    forward_steps: u64,
    /// The group before took most of its steps for attempts.
    was_slow: bool,
}

impl Diagnosis {
    /// Everything that was found, the earliest first.
    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.found().map(|found| &found.finding)
    }

    /// The same, with when it was found and whether it still holds.
    pub fn found(&self) -> impl Iterator<Item = &Found> {
        self.found.iter().flatten()
    }

    /// Whether a finding of this kind was made before.
    fn knows(&self, finding: &Finding) -> bool {
        self.findings().any(|known| known.name() == finding.name())
    }

    /// Takes note of whether this holds; it is found once.
    fn note(&mut self, holds: bool, finding: Finding) {
        let is_same = |known: &&mut Found| known.finding.name() == finding.name();
        if let Some(known) = self.found.iter_mut().flatten().find(is_same) {
            known.is_over = !holds;
        } else if holds && let Some(free) = self.found.iter_mut().find(|place| place.is_none()) {
            *free = Some(Found { finding, step: self.steps, is_over: false });
        }
    }

    /// Everything is at its start. `is_first`: no hard reset led there.
    pub(crate) fn placed(&mut self, is_first: bool) {
        let cause = self.resets.cause.take().unwrap_or(ResetCause::Requested);
        self.starts.states = 0;
        if is_first {
            return;
        }
        let resets = &mut self.resets;
        resets.total += 1;
        resets.truncated += u32::from(cause == ResetCause::Truncated);
        resets.requested += u32::from(cause == ResetCause::Requested);
        let Resets { total, truncated, requested, steps, .. } = *resets;
        let is_usual = |count: u32| count >= FEWEST_RESETS && 2 * count > total;
        self.note(is_usual(requested), Finding::ResetsRequested { requested, hard_resets: total });
        let mean_steps = steps as f64 / f64::from(total);
        self.note(
            is_usual(truncated),
            Finding::ResetsTruncated { truncated, hard_resets: total, mean_steps },
        );
    }

    /// A hard reset is due, and was not before. `is_own`: the cycle says so; else the caller.
    pub(crate) fn hard_reset_due(&mut self, cause: HardResetDue, is_own: bool) {
        let cause = match cause {
            HardResetDue::Requested => ResetCause::Requested,
            HardResetDue::Terminated if !is_own => ResetCause::Truncated,
            HardResetDue::CycleOver | HardResetDue::Terminated | HardResetDue::Lost => ResetCause::Due,
        };
        self.resets.cause.get_or_insert(cause);
    }

    /// Whether the last start counts as reset.
    pub(crate) fn start(&mut self, is_inside: bool) {
        let starts = &mut self.starts;
        starts.recent = starts.recent << 1 | u16::from(is_inside);
        starts.known += 1;
        let seen = starts.known.min(MOST_STARTS);
        let inside = (starts.recent & ((1 << seen) - 1)).count_ones();
        let holds = seen >= FEWEST_STARTS && 2 * inside < seen && self.steps >= SETTLED_STEPS;
        self.note(holds, Finding::StartsOutside { inside, starts: seen });
    }

    /// The rules decided on an action of the forward agent.
    pub(crate) fn decided(&mut self, is_allowed: bool) {
        if is_allowed {
            self.rejected = Rejected { decisions: 0, since: self.steps };
        } else {
            self.rejected.decisions += 1;
        }
        let Rejected { decisions, since } = self.rejected;
        let steps = self.steps - since;
        let holds = steps >= NOTHING_ALLOWED.0 && decisions >= NOTHING_ALLOWED.1;
        self.note(holds, Finding::NothingAllowed { decisions, steps });
    }

    /// A step was made. What the rules and the reset task say of themselves is looked up in `metrics`.
    pub(crate) fn step(&mut self, role: AgentRole, outcome: &StepOutcome, metrics: &Metrics) {
        self.steps += 1;
        self.resets.steps += 1;
        if self.accepted_risk.is_none() {
            self.accepted_risk = metrics.waiting("accepted_risk");
        }
        if self.starts.states == 0
            && let Some(inside) = metrics.waiting("start_inside")
        {
            self.start(inside > 0.5);
        }
        if self.starts.states < STATES_AFTER_START {
            self.starts.states += 1;
            self.starts.is_reached |= outcome.in_reset_set;
            self.starts.left_at_once += u32::from(self.starts.states == STATES_AFTER_START);
        }
        if let Some((holds, finding)) = self.forward_share.step(role, self.steps) {
            let is_news = self.forward_share.is_first_look();
            self.note(holds && (is_news || self.knows(&finding)), finding);
        }
        if role == AgentRole::Reset {
            self.attempts.present_steps += 1;
            let Attempts { failed_in_a_row, ended_in_a_row: ended, failed_steps, present_steps, .. } =
                self.attempts;
            // It may be a long one, and a user need not wait for its end.
            if self.never_came_back() {
                let (attempts, steps) = (failed_in_a_row + 1, failed_steps + present_steps);
                self.note(true, Finding::NoSuccess { attempts, ended, steps, has_succeeded: false });
            }
        } else {
            self.share.forward_steps += 1;
            self.forward_states += 1;
            self.forward_inside += u64::from(outcome.in_reset_set);
            let (inside, states) = (self.forward_inside, self.forward_states);
            let holds = states >= FEWEST_STATES && inside as f64 >= NEARLY_ALL * states as f64;
            self.note(holds, Finding::EveryStateInside { inside, states });
        }
    }

    /// An episode ended, and was not cut short.
    pub(crate) fn episode(&mut self, role: AgentRole, tally: &Tally, end: EpisodeEnd, has_reset: bool) {
        match role {
            AgentRole::Forward if tally.length > 0 => self.forward_episode(tally.length, end),
            AgentRole::Reset if end != EpisodeEnd::WorkerLost => {
                self.attempt(tally.length, has_reset, end == EpisodeEnd::Terminated)
            }
            _ => {}
        }
    }

    fn forward_episode(&mut self, length: u64, end: EpisodeEnd) {
        let has_terminated = end == EpisodeEnd::Terminated;
        if has_terminated {
            self.outcome(false, true);
        }
        self.episodes.count += 1;
        self.episodes.terminated += u32::from(has_terminated);
        self.episodes.steps += length;
        let Episodes { count, terminated, steps } = self.episodes;
        if count < EPISODES {
            return;
        }
        self.episodes = Episodes::default();
        let mean_length = steps as f64 / f64::from(count);
        let holds = terminated >= TERMINATED_EPISODES && self.steps >= SETTLED_STEPS;
        self.note(holds, Finding::EpisodesTerminate { terminated, episodes: count, mean_length });
    }

    fn attempt(&mut self, length: u64, has_reset: bool, is_end: bool) {
        self.outcome(has_reset, is_end);
        let attempts = &mut self.attempts;
        attempts.present_steps = 0;
        if has_reset {
            attempts.successes += 1;
            (attempts.failed_in_a_row, attempts.ended_in_a_row, attempts.failed_steps) = (0, 0, 0);
        } else {
            attempts.failed_in_a_row += 1;
            attempts.ended_in_a_row += u32::from(is_end);
            attempts.failed_steps += length;
        }
        let Attempts {
            failed_in_a_row: failed, ended_in_a_row: ended, failed_steps: steps, successes, ..
        } = *attempts;
        let is_long = failed >= LONG_ATTEMPTS.0 && steps >= LONG_ATTEMPTS.1;
        let is_striking = failed >= self.most_failures() || is_long || self.never_came_back();
        let holds = self.steps >= SETTLED_STEPS && is_striking;
        self.note(holds, Finding::NoSuccess { attempts: failed, ended, steps, has_succeeded: successes > 0 });
        let Starts { known, is_reached, left_at_once, .. } = self.starts;
        let is_suspect = known == 0 && !is_reached && left_at_once >= FEWEST_STARTS;
        let holds = is_suspect && successes == 0 && failed >= SUSPECT_ATTEMPTS && self.steps >= SETTLED_STEPS;
        self.note(holds, Finding::StartsUnlikely { starts: left_at_once, attempts: failed });
        self.note_share(length, has_reset);
        self.forward_share.attempt(has_reset, is_end);
    }

    /// No attempt has ever succeeded, those that there were, the present one included, took long, and the task does not lead there by chance.
    fn never_came_back(&self) -> bool {
        let Attempts { successes, failed_steps, present_steps, .. } = self.attempts;
        let is_long = successes == 0 && failed_steps + present_steps >= NEVER_BACK;
        let is_out_of_reach = (self.forward_inside as f64) < SOME * self.forward_states as f64;
        self.steps >= SETTLED_STEPS && is_long && is_out_of_reach
    }

    /// Failures in a row that chance does not explain.
    fn most_failures(&self) -> u32 {
        let by_chance = self.accepted_risk.map_or(0.0, |risk| (CHANCE.ln() / risk.ln()).ceil());
        FAILED_ATTEMPTS.max(by_chance as u32)
    }

    /// An attempt ended, or the environment did before one could begin.
    fn outcome(&mut self, has_reset: bool, is_end: bool) {
        let attempts = &mut self.attempts;
        attempts.recent = attempts.recent << 1 | u128::from(!has_reset);
        attempts.recent_ends = attempts.recent_ends << 1 | u128::from(is_end);
        attempts.ended = attempts.ended.saturating_add(1);
        let known = attempts.ended.min(RISK_WINDOW);
        let of_last = |bits: u128| (bits & ((1 << known) - 1)).count_ones();
        let (failures, ended) = (of_last(attempts.recent), of_last(attempts.recent_ends));
        let is_fair = known == RISK_WINDOW && self.steps >= SETTLED_STEPS;
        let Some(accepted) = self.accepted_risk.filter(|_| is_fair) else { return };
        let deviation = (accepted * (1.0 - accepted) / f64::from(known)).sqrt();
        let holds = f64::from(failures) / f64::from(known) > accepted + DEVIATIONS * deviation;
        self.note(holds, Finding::RiskExceeded { failures, ended, attempts: known, accepted });
    }

    fn note_share(&mut self, length: u64, has_reset: bool) {
        let share = &mut self.share;
        share.attempts += 1;
        share.successes += u32::from(has_reset);
        share.attempt_steps += length;
        let Share { attempts, successes, attempt_steps, forward_steps, was_slow } = *share;
        let steps = attempt_steps + forward_steps;
        if attempts < ATTEMPTS || steps < SETTLED_STEPS {
            return;
        }
        let is_slow = f64::from(successes) >= USUAL_SUCCESS * f64::from(attempts)
            && (forward_steps as f64) < HALF * steps as f64;
        *share = Share { was_slow: is_slow, ..Share::default() };
        // Twice in a row: a reset agent that learns becomes faster.
        let [attempt_length, forward_length] =
            [attempt_steps, forward_steps].map(|steps| steps as f64 / f64::from(attempts));
        let finding = Finding::SlowReturn { successes, attempts, attempt_length, forward_length };
        self.note(is_slow && was_slow, finding);
    }
}
