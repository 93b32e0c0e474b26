//! The joint loop: forward and reset agent take turns (Algorithm 1 of the paper).

mod decide;
mod parts;
mod state;

pub use parts::{LoopSettings, Participants};

use std::sync::atomic::AtomicBool;

use rand::Rng;
use shield_api::StepOutcome;

use self::state::Start;
use crate::{
    agent::{Agent, ForwardAgent},
    evaluation::Evaluator,
    experience::{AgentRole, AgentShare, Experience, Transition},
    experiment::{BetweenAttempts, Mode, Updates},
    loop_state::LoopRandomness,
    observer::Observer,
    plugin,
    record::{Counters, EpisodeEnd, EpisodeRecord, HardReset, Tally},
    shield::{Attempts, Ladder},
    world::{Stepped, World},
};

/// One run of the joint loop.
pub struct JointLoop<'a> {
    settings: LoopSettings,
    world: World,
    forward: Option<ForwardAgent>,
    reset: Option<Agent>,
    shield: Option<Ladder>,
    evaluator: Option<Evaluator>,
    experience: Experience,
    randomness: LoopRandomness,
    observer: &'a mut dyn Observer,
    stop: &'a AtomicBool,
    counters: Counters,
    attempts: Attempts,
    was_irreversible: bool,
    has_previous: bool,
    last_evaluation: Option<u64>,
    start: Start,
    /// Whose episode it is, or the next one.
    turn: AgentRole,
    is_interrupted: bool,
    /// Steps before the last checkpoint; `None` before the first.
    last_checkpoint: Option<u64>,
    proposed: Vec<f32>,
    action: Vec<f32>,
    previous: Vec<f32>,
    /// The environment's state before a decision that is recorded with it.
    state: Vec<u8>,
    values: Vec<f32>,
}

impl<'a> JointLoop<'a> {
    /// Prepares a run; `stop` ends it before the next step.
    pub fn new(
        settings: LoopSettings,
        participants: Participants,
        randomness: LoopRandomness,
        observer: &'a mut dyn Observer,
        stop: &'a AtomicBool,
    ) -> Self {
        let Participants { world, forward, reset, shield, evaluator, experience } = participants;
        let action = vec![0.0; world.spec().spaces.action_len()];
        Self {
            attempts: Attempts::new(settings.reset_attempts),
            proposed: action.clone(),
            previous: action.clone(),
            action,
            settings,
            world,
            forward,
            reset,
            shield,
            evaluator,
            experience,
            randomness,
            observer,
            stop,
            counters: Counters::default(),
            was_irreversible: false,
            has_previous: false,
            state: Vec::new(),
            values: Vec::new(),
            last_evaluation: None,
            start: Start::New,
            turn: AgentRole::Forward,
            is_interrupted: false,
            last_checkpoint: None,
        }
    }

    /// The forward agent as the run leaves it.
    pub fn into_forward(self) -> Option<ForwardAgent> {
        self.forward
    }

    /// What the run has counted so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Runs until the steps are used up or `stop` is set; returns whether it was stopped.
    ///
    /// # Errors
    /// A plugin or the observer failed. Nothing was executed that was not decided before.
    pub fn run(&mut self) -> anyhow::Result<bool> {
        match self.start {
            Start::New => self.place()?,
            Start::HardReset => self.lose_the_world()?,
            Start::Within(..) => {}
            Start::Finished => return Ok(false),
        }
        while !self.is_over() {
            self.turn = match (&self.settings.mode, self.turn) {
                (Mode::Shielded, AgentRole::Forward) => self.forward_turn()?,
                (Mode::Shielded, AgentRole::Reset) => self.reset_turn()?,
                (Mode::StatusQuo, _) => {
                    let episode = self.forward_episode()?;
                    self.close(episode, !episode.end.is_cut())?;
                    AgentRole::Forward
                }
                (Mode::ForwardOnly, _) => {
                    let episode = self.forward_episode()?;
                    self.close(episode, episode.end.needs_hard_reset())?;
                    AgentRole::Forward
                }
                (Mode::ResetOnly { .. }, _) => {
                    let episode = self.reset_episode()?;
                    self.close(episode, !episode.end.is_cut())?;
                    AgentRole::Reset
                }
            };
        }
        if self.is_interrupted {
            return Ok(true);
        }
        let has_evaluated = self.last_evaluation == Some(self.counters.steps);
        if self.settings.evaluate_every.is_some() && !has_evaluated {
            self.evaluate()?;
        }
        self.keep_finished()?;
        Ok(false)
    }

    /// The first half of a turn of Algorithm 1: a forward episode. Returns whose turn is next.
    fn forward_turn(&mut self) -> anyhow::Result<AgentRole> {
        let episode = self.forward_episode()?;
        let is_terminated = episode.end.needs_hard_reset();
        self.close(episode, is_terminated)?;
        Ok(if is_terminated { AgentRole::Forward } else { AgentRole::Reset })
    }

    /// The second half: an attempt to undo it. Returns whose turn is next.
    fn reset_turn(&mut self) -> anyhow::Result<AgentRole> {
        let attempt = self.reset_episode()?;
        if attempt.end.is_cut() {
            self.close(attempt, false)?;
            return Ok(AgentRole::Reset);
        }
        let has_given_up = self.attempts.record(attempt.has_reset);
        let needs_hard_reset = attempt.end.needs_hard_reset() || has_given_up;
        self.close(attempt, needs_hard_reset)?;
        let tries_again = !attempt.has_reset && self.settings.between_attempts == BetweenAttempts::Reset;
        Ok(if tries_again && !needs_hard_reset { AgentRole::Reset } else { AgentRole::Forward })
    }

    fn forward_episode(&mut self) -> anyhow::Result<EpisodeRecord> {
        let mut tally = self.begin(AgentRole::Forward)?;
        loop {
            if self.pause(AgentRole::Forward, &tally)? {
                return Ok(record(AgentRole::Forward, &tally, EpisodeEnd::Interrupted, false));
            }
            if let Some(abort) = self.propose()? {
                self.counters.early_aborts += 1;
                self.counters.failed_closed += u64::from(abort.cause.is_failure());
                self.tell_of_abort(abort);
                return Ok(record(AgentRole::Forward, &tally, EpisodeEnd::Abort, false));
            }
            let Stepped::Made(outcome) = self.world.step(&self.action)? else {
                return Ok(self.lost(AgentRole::Forward, &tally));
            };
            tally += &outcome;
            self.counters.forward_steps += 1;
            self.remember(&outcome, false);
            self.learn(AgentRole::Forward)?;
            if let Some(end) = self.step_is_over(&outcome, &tally)? {
                return Ok(record(AgentRole::Forward, &tally, end, false));
            }
        }
    }

    fn reset_episode(&mut self) -> anyhow::Result<EpisodeRecord> {
        let mut tally = self.begin(AgentRole::Reset)?;
        loop {
            if self.pause(AgentRole::Reset, &tally)? {
                return Ok(record(AgentRole::Reset, &tally, EpisodeEnd::Interrupted, false));
            }
            self.act_to_reset()?;
            let Stepped::Made(outcome) = self.world.step(&self.action)? else {
                return Ok(self.lost(AgentRole::Reset, &tally));
            };
            tally += &outcome;
            let has_reset =
                self.settings.reset_test.is_passed(tally.visited_reset_set, tally.is_in_reset_set);
            let has_failed = self.is_last(&tally) && !has_reset;
            self.remember(&outcome, has_failed);
            self.learn(AgentRole::Reset)?;
            let over = self.step_is_over(&outcome, &tally)?;
            let stops = self.settings.stop_on_reset && outcome.in_reset_set && !outcome.terminated;
            if stops {
                return Ok(record(AgentRole::Reset, &tally, EpisodeEnd::ResetSet, has_reset));
            }
            if let Some(end) = over {
                return Ok(record(AgentRole::Reset, &tally, end, has_reset));
            }
        }
    }

    /// Begins an episode, or goes on with the one that was under way when the run was stopped.
    fn begin(&mut self, role: AgentRole) -> anyhow::Result<Tally> {
        if let Start::Within(tally) = std::mem::replace(&mut self.start, Start::New) {
            return Ok(tally);
        }
        let mut tally = Tally::default();
        match role {
            AgentRole::Forward => self.counters.forward_episodes += 1,
            AgentRole::Reset => {
                self.counters.reset_episodes += 1;
                tally.reset_value = Some(self.reset_value()?);
            }
        }
        Ok(tally)
    }

    fn is_last(&self, tally: &Tally) -> bool {
        tally.length >= self.world.spec().episode_length as u64
    }

    /// The episode ends without the step that lost the world: nobody knows where it led.
    fn lost(&mut self, role: AgentRole, tally: &Tally) -> EpisodeRecord {
        self.counters.worker_restarts += 1;
        record(role, tally, EpisodeEnd::WorkerLost, false)
    }

    /// Stores the step for both agents. `has_failed`: it was the last one of a failed reset episode.
    fn remember(&mut self, outcome: &StepOutcome, has_failed: bool) {
        let StepOutcome { in_reset_set, terminated, .. } = *outcome;
        let transition = Transition {
            observation: self.world.observation(),
            action: &self.action,
            next_observation: self.world.next_observation(),
            forward: Some(AgentShare { reward: outcome.forward_reward, continues: !outcome.terminated }),
            reset: Some(AgentShare {
                reward: outcome.reset_reward,
                continues: self.settings.endings.reset_continues(in_reset_set, terminated, has_failed),
            }),
        };
        self.experience.push(&transition, &mut self.randomness.masks);
        self.world.advance();
        self.previous.copy_from_slice(&self.action);
        self.has_previous = true;
        self.counters.steps += 1;
        self.counters.lifetime_return += f64::from(outcome.forward_reward);
        self.counters.irreversible_entries += u64::from(outcome.irreversible && !self.was_irreversible);
        self.was_irreversible = outcome.irreversible;
    }

    fn learn(&mut self, in_charge: AgentRole) -> anyhow::Result<()> {
        let updates = self.settings.updates_per_step;
        let learns = |role| in_charge == role || self.settings.updates == Updates::Both;
        if let Some(forward) = self.forward.as_mut().filter(|_| learns(AgentRole::Forward)) {
            forward.learn(&self.experience, updates)?;
        }
        if let Some(reset) = self.reset.as_mut().filter(|_| learns(AgentRole::Reset)) {
            reset.learn(&self.experience, updates)?;
        }
        Ok(())
    }

    /// What follows every step: evaluation, and whether the episode ends for a reason that both phases share.
    fn step_is_over(&mut self, outcome: &StepOutcome, tally: &Tally) -> anyhow::Result<Option<EpisodeEnd>> {
        if self.settings.evaluate_every.is_some_and(|every| self.counters.steps.is_multiple_of(every)) {
            self.evaluate()?;
        }
        self.observer.on_step(&self.counters)?;
        Ok(if outcome.terminated {
            Some(EpisodeEnd::Terminated)
        } else if self.is_last(tally) {
            Some(EpisodeEnd::TimeLimit)
        } else {
            self.is_over().then_some(EpisodeEnd::Budget)
        })
    }

    fn evaluate(&mut self) -> anyhow::Result<()> {
        self.last_evaluation = Some(self.counters.steps);
        let Some(evaluator) = &mut self.evaluator else { return Ok(()) };
        let reset = self.reset.as_mut().map(Agent::learner);
        let record = evaluator.run(self.counters.steps, self.forward.as_mut(), reset)?;
        self.observer.on_evaluation(&record, &self.counters)
    }

    /// Ends an episode: the report, and the hard reset that may follow it.
    fn close(&mut self, mut episode: EpisodeRecord, hard_reset: bool) -> anyhow::Result<()> {
        if hard_reset {
            // A lost world has no state to ask, and its end is not the reset agent's doing.
            let is_lost = episode.end == EpisodeEnd::WorkerLost;
            let (kind, cost) = if is_lost { (None, 1.0) } else { self.world.hard_reset_due()? };
            let cost = cost * self.settings.hard_reset_cost;
            self.attempts.clear();
            self.counters.hard_resets += 1;
            self.counters.hard_reset_cost += cost;
            if !is_lost {
                self.experience.charge_last(AgentRole::Reset, self.settings.cost_weight * cost as f32);
            }
            episode.hard_reset = Some(HardReset { kind, cost });
        }
        self.observer.on_episode(&episode, &self.counters)?;
        let (step, observer) = (self.counters.steps, &mut self.observer);
        let mut taken = Ok(());
        plugin::drain_metrics(&mut |name, mean| {
            if taken.is_ok() {
                taken = observer.on_metric(step, name, mean);
            }
        });
        taken?;
        if hard_reset { self.place() } else { Ok(()) }
    }

    /// A hard reset, to the start that the mode names.
    fn place(&mut self) -> anyhow::Result<()> {
        let start = match &self.settings.mode {
            Mode::ResetOnly { start } => start.as_deref(),
            Mode::Shielded | Mode::StatusQuo | Mode::ForwardOnly => None,
        };
        self.world.hard_reset(start, self.randomness.resets.next_u64())?;
        self.was_irreversible = false;
        self.has_previous = false;
        Ok(())
    }

    fn is_over(&self) -> bool {
        self.counters.steps >= self.settings.steps || self.is_interrupted
    }
}

fn record(role: AgentRole, tally: &Tally, end: EpisodeEnd, has_reset: bool) -> EpisodeRecord {
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
