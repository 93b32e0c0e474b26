//! The reset cycle: Algorithm 1 of the paper as a state machine.
//!
//! A forward episode, then attempts to undo it, and a hard reset where too many of them fail. The cycle knows whose turn it is, asks the
//! shield, stores what happened, lets the agents learn, and counts. It neither steps nor resets an environment: the joint loop, the
//! drop-in and every door to other languages do that, and keep no state of their own about the cycle.
//!
//! One step: [`begin_episode`](ResetCycle::begin_episode), then [`propose`](ResetCycle::propose) and [`decide`](ResetCycle::decide), or
//! [`act_to_reset`](ResetCycle::act_to_reset) in an attempt; execute [`action`](ResetCycle::action); report where it led with
//! [`observe`](ResetCycle::observe), and [`finish`](ResetCycle::finish) the episode that it ends. Where
//! [`hard_reset_due`](ResetCycle::hard_reset_due), nothing moves until [`placed`](ResetCycle::placed).

mod attempts;
mod deciding;
mod frozen;
mod learning;
mod looking;
mod settings;
mod state;
mod undoing;

pub use looking::{Deliberation, Evaluated};
pub use settings::CycleSettings;
pub use state::{CycleState, LearnedState, UndoState, of_plugin, restore_rules, save_rules};
pub use undoing::MOST_IDLE_ABORTS;

use rand_pcg::Pcg64;
use shield_api::{Error, metrics::Metrics};

use self::{attempts::AttemptLengths, undoing::SinceReset};
use crate::{
    agent::{Agent, ForwardAgent},
    critic::Critic,
    decision::Cause,
    diagnosis::Diagnosis,
    events::{Counters, EpisodeEnd, EpisodeEvent, Tally},
    experience::{AgentRole, Experience},
    settings::{BetweenAttempts, Mode},
    shield::Ladder,
};

/// Who takes part in a cycle.
#[derive(Default)]
pub struct CycleParts {
    /// Does the task; `None` where the caller does, or in `ResetOnly`.
    pub forward: Option<ForwardAgent>,
    /// Undoes it; `None` in `StatusQuo` and `ForwardOnly`.
    pub reset: Option<Agent>,
    /// Estimates how likely that succeeds; `None` where no rule asks for it.
    pub success: Option<Critic>,
    /// Decides on forward actions; `None` in all modes but `Shielded`.
    pub ladder: Option<Ladder>,
    /// What the agents learn from; `None` where nobody learns.
    pub memory: Option<Memory>,
}

/// The experience of both agents.
pub struct Memory {
    /// The transitions.
    pub experience: Experience,
    /// Draws the bootstrap masks.
    pub masks: Pcg64,
}

/// Why nothing may move before a hard reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HardResetDue {
    /// The episodes of this mode, or too many failed attempts, end with one.
    CycleOver,
    /// The environment cannot go on.
    Terminated,
    /// Where the environment stands is not known.
    Lost,
    /// The caller wants one although none was due.
    Requested,
}

impl HardResetDue {
    /// Its name for other languages.
    pub fn name(self) -> &'static str {
        match self {
            Self::CycleOver => "cycle_over",
            Self::Terminated => "terminated",
            Self::Lost => "lost",
            Self::Requested => "requested",
        }
    }
}

/// Whose turn it is, and everything that follows a step.
pub struct ResetCycle {
    settings: CycleSettings,
    parts: CycleParts,
    counters: Counters,
    /// Attempts that reached the reset set.
    reset_successes: u64,
    /// Failed attempts since the last success or hard reset.
    failed_attempts: u32,
    /// Whose episode it is, or the next one.
    turn: AgentRole,
    /// The present episode; `None` between two.
    episode: Option<Tally>,
    /// How long the next attempt may be.
    attempts: AttemptLengths,
    hard_reset_due: Option<HardResetDue>,
    /// A start was observed.
    is_placed: bool,
    since_reset: SinceReset,
    was_irreversible: bool,
    /// An action was decided, and where it led is not known yet.
    is_pending: bool,
    /// Why the forward agent gave no action.
    failure: Option<Error>,
    /// In which the last action was decided.
    observation: Vec<f32>,
    proposed: Vec<f32>,
    action: Vec<f32>,
    previous: Vec<f32>,
    has_previous: bool,
    values: Vec<f32>,
    /// What the plugins have reported.
    metrics: Metrics,
    /// What keeps the shield from helping.
    diagnosis: Diagnosis,
}

impl ResetCycle {
    /// A cycle before the first start, for observations and actions of these lengths.
    pub fn new(
        mut settings: CycleSettings,
        mut parts: CycleParts,
        [observation_len, action_len]: [usize; 2],
    ) -> Self {
        let (action, metrics) = (vec![0.0; action_len], Metrics::default());
        settings.explores &= parts.reset.as_ref().is_none_or(Agent::learns);
        parts.forward.iter_mut().for_each(|forward| forward.report_to(&metrics));
        parts.reset.iter_mut().for_each(|reset| reset.report_to(&metrics));
        parts.success.iter_mut().for_each(|success| success.report_to(&metrics));
        Self {
            metrics,
            turn: first_turn(&settings.mode),
            settings,
            parts,
            counters: Counters::default(),
            reset_successes: 0,
            failed_attempts: 0,
            episode: None,
            attempts: AttemptLengths::default(),
            hard_reset_due: None,
            is_placed: false,
            since_reset: SinceReset::default(),
            was_irreversible: false,
            is_pending: false,
            failure: None,
            observation: vec![0.0; observation_len],
            proposed: action.clone(),
            previous: action.clone(),
            action,
            has_previous: false,
            values: Vec::new(),
            diagnosis: Diagnosis::default(),
        }
    }

    /// Begins an episode of the agent whose turn it is, unless one is under way. Returns whether it began one.
    pub fn begin_episode(&mut self) -> bool {
        if self.episode.is_some() {
            return false;
        }
        self.episode = Some(Tally::default());
        match self.turn {
            AgentRole::Forward => self.counters.forward_episodes += 1,
            AgentRole::Reset => self.counters.reset_episodes += 1,
        }
        true
    }

    /// Ends the forward episode because of an abort for this cause. The reset agent's turn comes, unless there is
    /// [nothing to undo](Self::has_nothing_to_undo).
    pub fn finish_aborted(&mut self, cause: Cause) -> EpisodeEvent {
        self.store_abort(cause);
        if self.has_nothing_to_undo() { self.stay(cause) } else { self.finish(EpisodeEnd::Abort) }
    }

    /// Ends the present episode: whose turn is next, and whether a hard reset comes first.
    pub fn finish(&mut self, end: EpisodeEnd) -> EpisodeEvent {
        let tally = self.episode.take().unwrap_or_default();
        let role = self.turn;
        let is_unknown = matches!(end, EpisodeEnd::Interrupted | EpisodeEnd::WorkerLost);
        // What an environment shows that has ended may be its start.
        let is_success = role == AgentRole::Reset && !is_unknown && end != EpisodeEnd::Terminated;
        let has_reset = is_success && self.passes_reset_test(&tally);
        let attempt = self.note_outcome(&tally, end, has_reset);
        self.note_length(role, tally.length, end, has_reset);
        if !end.is_cut() && self.is_shielded() {
            self.diagnosis.episode(role, &tally, end, has_reset);
        }
        self.counters.worker_restarts += u64::from(end == EpisodeEnd::WorkerLost);
        let is_over = match (&self.settings.mode, role) {
            (Mode::Shielded, AgentRole::Reset) => self.close_attempt(end, has_reset),
            (Mode::Shielded, AgentRole::Forward) => {
                self.turn = AgentRole::Reset;
                false
            }
            (Mode::ForwardOnly, _) => false,
            (Mode::StatusQuo | Mode::ResetOnly { .. }, _) => !end.is_cut(),
        };
        let cause = match end {
            EpisodeEnd::Terminated => Some(HardResetDue::Terminated),
            EpisodeEnd::WorkerLost => Some(HardResetDue::Lost),
            _ => is_over.then_some(HardResetDue::CycleOver),
        };
        if let Some(cause) = cause {
            self.diagnosis.hard_reset_due(cause, true);
            self.require_hard_reset(cause);
        }
        EpisodeEvent {
            role,
            undo_probability: if role == AgentRole::Reset { self.since_reset.predicted.take() } else { None },
            length: tally.length,
            forward_return: tally.forward_return,
            reset_return: tally.reset_return,
            success: tally.success,
            end,
            has_reset,
            attempt,
            reset_value: tally.reset_value,
            hard_reset: None,
        }
    }

    /// Counts an attempt, and passes the turn on. Returns whether the reset agent has given up.
    fn close_attempt(&mut self, end: EpisodeEnd, has_reset: bool) -> bool {
        if end.is_cut() {
            return false;
        }
        self.failed_attempts = if has_reset { 0 } else { self.failed_attempts + 1 };
        self.reset_successes += u64::from(has_reset);
        self.since_reset.has_moved &= !has_reset;
        let tries_again = !has_reset && self.settings.between_attempts == BetweenAttempts::Reset;
        self.turn = if tries_again { AgentRole::Reset } else { AgentRole::Forward };
        self.settings.reset_attempts.is_some_and(|limit| self.failed_attempts >= limit)
    }

    /// Hands over to the reset agent although nothing was aborted: the task is done. Returns the forward episode that ends. The
    /// reset agent's turn does not come if nothing was done since the last success, nor if a hard reset is due.
    pub fn begin_reset(&mut self) -> Option<EpisodeEvent> {
        if self.turn != AgentRole::Forward {
            return None;
        }
        let is_due = self.since_reset.has_moved && self.hard_reset_due.is_none();
        let ended = is_due.then(|| self.finish(EpisodeEnd::TimeLimit));
        self.episode = None;
        ended
    }

    /// The episode under way, as if it were cut short now; `None` before its first step.
    pub fn interrupted(&self) -> Option<EpisodeEvent> {
        let tally = self.episode.filter(|tally| tally.length > 0)?;
        let cut = EpisodeEvent::of_forward(&tally, EpisodeEnd::Interrupted);
        Some(EpisodeEvent { role: self.turn, ..cut })
    }

    /// Nothing may move before a hard reset.
    pub fn require_hard_reset(&mut self, cause: HardResetDue) {
        self.diagnosis.hard_reset_due(cause, false);
        self.hard_reset_due = Some(cause);
        self.is_pending = false;
        self.turn = first_turn(&self.settings.mode);
        self.episode = None;
    }

    /// Counts a hard reset. `cost` is that of its kind; `is_earned`: the reset agent's doing, from which it learns.
    pub fn count_hard_reset(&mut self, cost: f64, is_earned: bool) -> f64 {
        let cost = cost * self.settings.hard_reset_cost;
        self.counters.hard_resets += 1;
        self.counters.hard_reset_cost += cost;
        if let (Some(memory), true) = (&mut self.parts.memory, is_earned) {
            memory.experience.charge_last(AgentRole::Reset, self.settings.cost_weight * cost as f32);
        }
        cost
    }

    /// Everything is at its start.
    pub fn placed(&mut self) {
        self.failed_attempts = 0;
        self.hard_reset_due = None;
        self.turn = first_turn(&self.settings.mode);
        self.episode = None;
        if self.is_shielded() {
            self.diagnosis.placed(!self.is_placed);
        }
        self.is_placed = true;
        (self.since_reset, self.was_irreversible) = (SinceReset::default(), false);
        self.begin_to_measure();
        (self.has_previous, self.is_pending) = (false, false);
    }
}

impl ResetCycle {
    /// What keeps the shield from helping, as far as it was found.
    pub fn diagnosis(&self) -> &Diagnosis {
        &self.diagnosis
    }

    /// Whether the start at which everything was placed last counts as reset, where the caller knows.
    pub fn note_start(&mut self, is_inside: bool) {
        self.diagnosis.start(is_inside);
    }

    /// The reward of a forward step, and the one that an abort gives, where the caller knows them.
    pub fn note_reward(&mut self, reward: f64, abort_reward: f64) {
        self.diagnosis.reward(reward, abort_reward);
    }

    fn is_shielded(&self) -> bool {
        self.parts.ladder.is_some()
    }
}

fn first_turn(mode: &Mode) -> AgentRole {
    match mode {
        Mode::Shielded | Mode::StatusQuo | Mode::ForwardOnly => AgentRole::Forward,
        Mode::ResetOnly { .. } => AgentRole::Reset,
    }
}
