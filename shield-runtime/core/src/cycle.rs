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

mod settings;
mod state;

pub use settings::CycleSettings;
pub use state::{CycleState, LearnedState};
pub use state::{restore_rules, save_rules};

use rand_pcg::Pcg64;
use shield_api::{ActMode, Error, ErrorKind, Learner, Result, StepOutcome, metrics::Metrics};

use crate::{
    agent::{Agent, ForwardAgent},
    decision::{Cause, Decision},
    experience::{AgentRole, AgentShare, Experience, Transition},
    record::{Counters, EpisodeEnd, EpisodeRecord, Tally},
    settings::{BetweenAttempts, Mode, Updates},
    shield::{Agents, Ladder, Moment},
};

/// Who takes part in a cycle.
#[derive(Default)]
pub struct CycleParts {
    /// Does the task; `None` where the caller does, or in `ResetOnly`.
    pub forward: Option<ForwardAgent>,
    /// Undoes it; `None` in `StatusQuo` and `ForwardOnly`.
    pub reset: Option<Agent>,
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
}

impl HardResetDue {
    /// Its name for other languages.
    pub fn name(self) -> &'static str {
        match self {
            Self::CycleOver => "cycle_over",
            Self::Terminated => "terminated",
            Self::Lost => "lost",
        }
    }
}

/// The last decision, to be reported.
#[derive(Clone, Copy)]
pub struct Deliberation<'a> {
    /// Everything that was counted.
    pub counters: &'a Counters,
    /// In which the action was decided.
    pub observation: &'a [f32],
    /// What was proposed; NaN where the forward agent failed.
    pub proposed: &'a [f32],
    /// The action that was executed before; `None` after a hard reset. Once a step is observed, it is that step's.
    pub previous: Option<&'a [f32]>,
    /// What may be executed.
    pub action: &'a [f32],
    /// What decided; `None` in all modes but `Shielded`.
    pub ladder: Option<&'a Ladder>,
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
    hard_reset_due: Option<HardResetDue>,
    /// A start was observed.
    is_placed: bool,
    /// Something may have to be undone.
    has_moved: bool,
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
}

impl ResetCycle {
    /// A cycle before the first start, for observations and actions of these lengths.
    pub fn new(
        settings: CycleSettings,
        mut parts: CycleParts,
        [observation_len, action_len]: [usize; 2],
    ) -> Self {
        let (action, metrics) = (vec![0.0; action_len], Metrics::default());
        parts.forward.iter_mut().for_each(|forward| forward.report_to(&metrics));
        parts.reset.iter_mut().for_each(|reset| reset.report_to(&metrics));
        Self {
            metrics,
            turn: first_turn(&settings.mode),
            settings,
            parts,
            counters: Counters::default(),
            reset_successes: 0,
            failed_attempts: 0,
            episode: None,
            hard_reset_due: None,
            is_placed: false,
            has_moved: false,
            was_irreversible: false,
            is_pending: false,
            failure: None,
            observation: vec![0.0; observation_len],
            proposed: action.clone(),
            previous: action.clone(),
            action,
            has_previous: false,
            values: Vec::new(),
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

    /// Notes the mean of the reset ensemble's values of its greedy action at the start of an attempt.
    ///
    /// # Errors
    /// There is no reset agent, or it failed.
    pub fn value_start(&mut self, observation: &[f32]) -> Result<()> {
        let reset = self.parts.reset.as_mut().ok_or_else(no_reset_agent)?;
        self.values.resize(reset.info().members, 0.0);
        reset.learner().act(observation, ActMode::Greedy, &mut self.action)?;
        reset.learner().q_values(observation, &self.action, &mut self.values)?;
        let mean = self.values.iter().sum::<f32>() / self.values.len() as f32;
        if let Some(episode) = &mut self.episode {
            episode.reset_value = Some(mean);
        }
        Ok(())
    }

    /// The forward agent proposes an action. If it fails where a shield decides, [`decide`](Self::decide) aborts.
    ///
    /// # Errors
    /// There is no forward agent, it panicked, or it failed where no shield could abort.
    pub fn propose(&mut self, observation: &[f32]) -> Result<()> {
        let CycleParts { forward, ladder, .. } = &mut self.parts;
        let forward = forward.as_mut().ok_or_else(|| Error::failed("there is no forward agent"))?;
        self.failure = forward.act(observation, ActMode::Explore, &mut self.action).err();
        match &self.failure {
            None => {}
            // A panicked plugin never acts again; any other failure may pass, and must not be executed meanwhile.
            Some(error) if ladder.is_none() || error.kind() == ErrorKind::Panicked => {
                return Err(error.clone());
            }
            Some(_) => self.action.fill(f32::NAN),
        }
        self.proposed.copy_from_slice(&self.action);
        Ok(())
    }

    /// The caller proposes an action, of the right length.
    pub fn take_proposal(&mut self, action: &[f32]) {
        self.failure = None;
        self.proposed.copy_from_slice(action);
        self.action.copy_from_slice(action);
    }

    /// Decides on the proposed action; [`action`](Self::action) is then what may be executed. An abort ends the forward episode, and the
    /// reset agent's turn comes.
    pub fn decide(&mut self, observation: &[f32]) -> Decision {
        self.observation.copy_from_slice(observation);
        self.is_pending = true;
        let CycleParts { forward, reset, ladder, .. } = &mut self.parts;
        let (Some(ladder), Some(reset)) = (ladder, reset) else { return Decision::Allow };
        if self.hard_reset_due.is_some() {
            return ladder.refuse(Cause::AwaitsHardReset, &mut self.action);
        }
        let moment = Moment {
            step: self.counters.steps,
            observation,
            previous: self.has_previous.then_some(&self.previous),
        };
        let forward = forward.as_mut().and_then(ForwardAgent::learner);
        let agents = Agents { reset: reset.learner(), forward };
        let decision = match self.failure.take() {
            Some(error) => ladder.forward_failed(agents, &moment, &error, &mut self.action),
            None => ladder.filter(agents, &moment, &mut self.action),
        };
        self.is_pending = !ladder.is_broken();
        self.count(decision);
        decision
    }

    fn count(&mut self, decision: Decision) {
        self.counters.warm_up_decisions += u64::from(decision == Decision::WarmUp);
        self.counters.projections += u64::from(decision.projection().is_some());
        // A shield that cannot decide any more has not aborted: it has ended.
        let Some(abort) = decision.abort().filter(|_| !self.is_broken()) else { return };
        self.counters.early_aborts += 1;
        self.counters.failed_closed += u64::from(abort.cause.is_failure());
    }

    /// The reset agent acts; where its exploration is shielded, a rejected action gives way to its greedy one, and the decision says so.
    ///
    /// # Errors
    /// There is no reset agent, or it gave no action of the action space.
    pub fn act_to_reset(&mut self, observation: &[f32]) -> Result<Option<Decision>> {
        self.observation.copy_from_slice(observation);
        self.is_pending = true;
        let CycleParts { forward, reset, ladder, .. } = &mut self.parts;
        let reset = reset.as_mut().ok_or_else(no_reset_agent)?;
        let mode = if self.settings.explores { ActMode::Explore } else { ActMode::Greedy };
        reset.learner().act(observation, mode, &mut self.action)?;
        let Some(ladder) = ladder else { return Ok(None) };
        self.proposed.copy_from_slice(&self.action);
        let moment = Moment {
            step: self.counters.steps,
            observation,
            previous: self.has_previous.then_some(&self.previous),
        };
        if !(self.settings.explores && self.settings.shield_exploration) {
            return ladder.check(&moment, &self.action).map(|()| None);
        }
        let forward = forward.as_mut().and_then(ForwardAgent::learner);
        let decision = ladder.guard(Agents { reset: reset.learner(), forward }, &moment, &mut self.action);
        self.counters.exploration_replaced += u64::from(decision.abort().is_some());
        Ok(Some(decision))
    }

    /// As [`act_to_reset`](Self::act_to_reset), for a caller who executes whatever [`action`](Self::action) holds: a reset agent that fails has
    /// given way to the fallback action.
    pub fn act_to_reset_or_refuse(&mut self, observation: &[f32]) -> Decision {
        let acted = self.act_to_reset(observation);
        let Some(ladder) = &mut self.parts.ladder else { return Decision::Resetting };
        match acted {
            Ok(_) => {
                ladder.forget_reason();
                Decision::Resetting
            }
            Err(error) => {
                self.counters.failed_closed += 1;
                ladder.reset_failed(&error, &mut self.action)
            }
        }
    }

    /// Refuses an action without asking anybody; [`action`](Self::action) is then the fallback action.
    pub fn refuse(&mut self, cause: Cause) -> Decision {
        self.is_pending = false;
        match &mut self.parts.ladder {
            Some(ladder) => ladder.refuse(cause, &mut self.action),
            None => Decision::Allow,
        }
    }

    /// The action of [`decide`](Self::decide) or [`act_to_reset`](Self::act_to_reset) was executed and led to `next_observation`: stores the
    /// step and lets the agents learn. Returns why the episode ends, if it does.
    ///
    /// # Errors
    /// Nothing was decided, or a learner failed.
    pub fn observe(&mut self, next_observation: &[f32], outcome: &StepOutcome) -> Result<Option<EpisodeEnd>> {
        if !std::mem::take(&mut self.is_pending) {
            return Err(Error::failed("nothing was decided: each step begins with a decision"));
        }
        let mut tally = self.episode.unwrap_or_default();
        tally += outcome;
        // A caller may also report what came of a fallback action, outside of any episode.
        self.episode = self.episode.map(|_| tally);
        self.has_moved = true;
        self.counters.forward_steps += u64::from(self.turn == AgentRole::Forward);
        let has_failed =
            self.turn == AgentRole::Reset && self.is_last(&tally) && !self.passes_reset_test(&tally);
        self.store(next_observation, outcome, has_failed);
        self.learn()?;
        Ok(self.end_of(&tally, outcome))
    }

    fn end_of(&self, tally: &Tally, outcome: &StepOutcome) -> Option<EpisodeEnd> {
        let is_attempt = self.turn == AgentRole::Reset;
        if outcome.terminated {
            Some(EpisodeEnd::Terminated)
        } else if is_attempt && self.settings.stop_on_reset && outcome.in_reset_set {
            Some(EpisodeEnd::ResetSet)
        } else {
            self.is_last(tally).then_some(EpisodeEnd::TimeLimit)
        }
    }

    fn is_last(&self, tally: &Tally) -> bool {
        let limit = match self.turn {
            AgentRole::Forward => self.settings.forward_length,
            AgentRole::Reset => Some(self.settings.attempt_length),
        };
        limit.is_some_and(|limit| tally.length >= limit)
    }

    fn passes_reset_test(&self, tally: &Tally) -> bool {
        self.settings.reset_test.is_passed(tally.visited_reset_set, tally.is_in_reset_set)
    }

    /// Stores the step for both agents. `has_failed`: it was the last one of a failed attempt.
    fn store(&mut self, next_observation: &[f32], outcome: &StepOutcome, has_failed: bool) {
        let StepOutcome { in_reset_set, terminated, .. } = *outcome;
        if let Some(Memory { experience, masks }) = &mut self.parts.memory {
            let forward = AgentShare { reward: outcome.forward_reward, continues: !terminated };
            let reset = AgentShare {
                reward: outcome.reset_reward,
                continues: self.settings.endings.reset_continues(in_reset_set, terminated, has_failed),
            };
            let transition = Transition {
                observation: &self.observation,
                action: &self.action,
                next_observation,
                forward: self.settings.stores_forward.then_some(forward),
                reset: Some(reset),
            };
            experience.push(&transition, masks);
        }
        self.previous.copy_from_slice(&self.action);
        self.has_previous = true;
        self.counters.steps += 1;
        self.counters.lifetime_return += f64::from(outcome.forward_reward);
        self.counters.irreversible_entries += u64::from(outcome.irreversible && !self.was_irreversible);
        self.was_irreversible = outcome.irreversible;
    }

    fn learn(&mut self) -> Result<()> {
        let CycleSettings { updates, updates_per_step, .. } = self.settings;
        let learns = |role| self.turn == role || updates == Updates::Both;
        let CycleParts { forward, reset, memory: Some(Memory { experience, .. }), .. } = &mut self.parts
        else {
            return Ok(());
        };
        if let Some(forward) = forward.as_mut().filter(|_| learns(AgentRole::Forward)) {
            forward.learn(experience, updates_per_step)?;
        }
        if let Some(reset) = reset.as_mut().filter(|_| learns(AgentRole::Reset)) {
            reset.learn(experience, updates_per_step)?;
        }
        Ok(())
    }

    /// Lets the forward agent learn from the action that a rule rejected. What failed is not the fault of its action.
    fn store_abort(&mut self, cause: Cause) {
        let Some(reward) = self.settings.on_abort.reward().filter(|_| !cause.is_failure()) else { return };
        let Some(Memory { experience, masks }) = &mut self.parts.memory else { return };
        let transition = Transition {
            observation: &self.observation,
            action: &self.proposed,
            next_observation: &self.observation,
            forward: Some(AgentShare { reward, continues: false }),
            reset: None,
        };
        experience.push(&transition, masks);
    }

    /// Ends the forward episode because of an abort for this cause; the reset agent's turn comes.
    pub fn finish_aborted(&mut self, cause: Cause) -> EpisodeRecord {
        self.store_abort(cause);
        self.finish(EpisodeEnd::Abort)
    }

    /// Ends the present episode: whose turn is next, and whether a hard reset comes first.
    pub fn finish(&mut self, end: EpisodeEnd) -> EpisodeRecord {
        let tally = self.episode.take().unwrap_or_default();
        let role = self.turn;
        let is_known = !matches!(end, EpisodeEnd::Interrupted | EpisodeEnd::WorkerLost);
        let has_reset = role == AgentRole::Reset && is_known && self.passes_reset_test(&tally);
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
            self.require_hard_reset(cause);
        }
        EpisodeRecord {
            role,
            length: tally.length,
            forward_return: tally.forward_return,
            reset_return: tally.reset_return,
            success: tally.success,
            end,
            has_reset,
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
        self.has_moved &= !has_reset;
        let tries_again = !has_reset && self.settings.between_attempts == BetweenAttempts::Reset;
        self.turn = if tries_again { AgentRole::Reset } else { AgentRole::Forward };
        self.settings.reset_attempts.is_some_and(|limit| self.failed_attempts >= limit)
    }

    /// Hands over to the reset agent although nothing was aborted: the task is done. Returns whether it is in charge: not if nothing was
    /// done since the last success, nor if a hard reset is due.
    pub fn begin_reset(&mut self) -> bool {
        if self.turn == AgentRole::Forward {
            if self.has_moved && self.hard_reset_due.is_none() {
                self.finish(EpisodeEnd::TimeLimit);
            }
            self.episode = None;
        }
        self.turn == AgentRole::Reset
    }

    /// Nothing may move before a hard reset.
    pub fn require_hard_reset(&mut self, cause: HardResetDue) {
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
        self.is_placed = true;
        (self.has_moved, self.was_irreversible) = (false, false);
        (self.has_previous, self.is_pending) = (false, false);
    }
}

/// What can be asked.
impl ResetCycle {
    /// Whose episode it is, or the next one.
    pub fn turn(&self) -> AgentRole {
        self.turn
    }

    /// Why nothing may move before a hard reset, if that is so.
    pub fn hard_reset_due(&self) -> Option<HardResetDue> {
        self.hard_reset_due
    }

    /// Whether a start was ever observed.
    pub fn is_placed(&self) -> bool {
        self.is_placed
    }

    /// Steps of the present episode.
    pub fn episode_length(&self) -> u64 {
        self.episode.map_or(0, |episode| episode.length)
    }

    /// Everything that was counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Attempts that reached the reset set.
    pub fn reset_successes(&self) -> u64 {
        self.reset_successes
    }

    /// What may be executed.
    pub fn action(&self) -> &[f32] {
        &self.action
    }

    /// What decides; `None` in all modes but `Shielded`.
    pub fn ladder(&self) -> Option<&Ladder> {
        self.parts.ladder.as_ref()
    }

    /// Whether a plugin that the shield needs is out of service: from now on everything is aborted.
    pub fn is_broken(&self) -> bool {
        self.parts.ladder.as_ref().is_some_and(Ladder::is_broken)
    }

    /// What the plugins have reported, each name of an agent's preceded by its role, such as `reset/critic_loss`.
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// What the agents learn from.
    pub fn experience(&self) -> Option<&Experience> {
        self.parts.memory.as_ref().map(|memory| &memory.experience)
    }

    /// The last decision, beside the agent that values actions.
    pub fn last(&mut self) -> (Deliberation<'_>, Option<&mut dyn Learner>) {
        let CycleParts { reset, ladder, .. } = &mut self.parts;
        let deliberation = Deliberation {
            counters: &self.counters,
            observation: &self.observation,
            proposed: &self.proposed,
            previous: self.has_previous.then_some(&self.previous),
            action: &self.action,
            ladder: ladder.as_ref(),
        };
        (deliberation, reset.as_mut().map(Agent::learner))
    }

    /// Both agents.
    pub fn agents(&mut self) -> (Option<&mut ForwardAgent>, Option<&mut dyn Learner>) {
        (self.parts.forward.as_mut(), self.parts.reset.as_mut().map(Agent::learner))
    }

    /// Who takes part.
    pub fn parts(&self) -> &CycleParts {
        &self.parts
    }

    /// The same, when the cycle has come to its end.
    pub fn into_parts(self) -> CycleParts {
        self.parts
    }

    /// What it does.
    pub fn settings(&self) -> &CycleSettings {
        &self.settings
    }
}

fn first_turn(mode: &Mode) -> AgentRole {
    match mode {
        Mode::Shielded | Mode::StatusQuo | Mode::ForwardOnly => AgentRole::Forward,
        Mode::ResetOnly { .. } => AgentRole::Reset,
    }
}

fn no_reset_agent() -> Error {
    Error::failed("there is no reset agent")
}
