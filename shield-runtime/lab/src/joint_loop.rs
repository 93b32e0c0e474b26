//! The joint loop: forward and reset agent take turns (Algorithm 1 of the paper), as the [reset cycle](shield_core::cycle) says.

mod decide;
mod parts;
mod state;

pub use parts::{LoopParts, LoopSettings};

use std::sync::atomic::{AtomicBool, Ordering};

use rand::Rng;
use rand_pcg::Pcg64;

use self::state::Start;
use crate::{
    evaluation::Evaluator,
    observer::{Observer, Occasion, Scene, Step},
};
use shield_core::{
    cycle::{CycleParts, HardResetDue, ResetCycle},
    diagnosis::Found,
    events::{Counters, EpisodeEnd, EpisodeEvent, HardReset},
    experience::AgentRole,
    world::{Stepped, World},
};

/// One run of the joint loop.
pub struct JointLoop<'a> {
    settings: LoopSettings,
    cycle: ResetCycle,
    world: World,
    evaluator: Option<Evaluator>,
    /// Seeds of hard resets.
    resets: Pcg64,
    observer: &'a mut dyn Observer,
    stop: &'a AtomicBool,
    last_evaluation: Option<u64>,
    start: Start,
    is_interrupted: bool,
    /// Steps before the last checkpoint; `None` before the first.
    last_checkpoint: Option<u64>,
    /// The environment's state before a decision that is recorded with it.
    state: Vec<u8>,
}

impl<'a> JointLoop<'a> {
    /// A loop before its first step; `stop` ends it before the next one.
    pub fn new(parts: LoopParts, observer: &'a mut dyn Observer, stop: &'a AtomicBool) -> Self {
        let LoopParts { settings, world, agents, evaluator, resets } = parts;
        let spec = world.spec();
        let lengths = [spec.spaces.observation_len(), spec.spaces.action_len()];
        let mut cycle = settings.cycle.clone();
        cycle.forward_length = Some(spec.episode_length as u64);
        cycle.episode_length = spec.episode_length as u64;
        Self {
            settings,
            cycle: ResetCycle::new(cycle, agents, lengths),
            world,
            evaluator,
            resets,
            observer,
            stop,
            last_evaluation: None,
            start: Start::New,
            is_interrupted: false,
            last_checkpoint: None,
            state: Vec::new(),
        }
    }

    /// The world and the agents as the run leaves them.
    pub fn into_parts(self) -> (World, CycleParts) {
        (self.world, self.cycle.into_parts())
    }

    /// What the run has counted so far.
    pub fn counters(&self) -> &Counters {
        self.cycle.counters()
    }

    /// What kept the shield from helping so far, the earliest first.
    pub fn findings(&self) -> impl Iterator<Item = &Found> {
        self.cycle.diagnosis().found()
    }

    /// Runs until the steps are used up or `stop` is set; returns whether it was stopped.
    ///
    /// # Errors
    /// A plugin or the observer failed. Nothing was executed that was not decided before.
    pub fn run(&mut self) -> anyhow::Result<bool> {
        let metrics = self.cycle.metrics().clone();
        metrics.collect(|| self.take_turns())
    }

    fn take_turns(&mut self) -> anyhow::Result<bool> {
        match self.start {
            Start::New => {
                self.calibrate()?;
                self.place()?;
            }
            Start::HardReset => self.lose_the_world()?,
            Start::Within => {}
            Start::Finished => return Ok(false),
        }
        while !self.is_over() {
            let end = self.step()?;
            if let Some(episode) = end {
                self.close(episode)?;
            }
        }
        if self.is_interrupted {
            return Ok(true);
        }
        let has_evaluated = self.last_evaluation == Some(self.counters().steps);
        if self.settings.evaluate_every.is_some() && !has_evaluated {
            self.evaluate()?;
        }
        self.keep_finished()?;
        Ok(false)
    }

    /// One step of the episode under way, or of the next one. Returns the episode that ends with it.
    fn step(&mut self) -> anyhow::Result<Option<EpisodeEvent>> {
        self.cycle.begin_episode();
        if self.pause()? {
            return Ok(Some(self.cycle.finish(EpisodeEnd::Interrupted)));
        }
        let rejection = match self.cycle.turn() {
            AgentRole::Forward => self.propose()?,
            AgentRole::Reset => self.act_to_reset()?,
        };
        if let Some(rejection) = rejection {
            return Ok(Some(self.cycle.finish_aborted(rejection.cause)));
        }
        let Stepped::Made(outcome) = self.world.step(self.cycle.action())? else {
            return Ok(Some(self.cycle.finish(EpisodeEnd::WorkerLost)));
        };
        let role = self.cycle.turn();
        let end = self.cycle.observe(self.world.next_observation(), &outcome)?;
        self.world.advance();
        if self.settings.evaluate_every.is_some_and(|every| self.counters().steps.is_multiple_of(every)) {
            self.evaluate()?;
        }
        let (last, reset) = self.cycle.last();
        let step = Step {
            counters: last.counters,
            role,
            observation: last.observation,
            action: last.action,
            outcome: &outcome,
        };
        self.observer.on_step(&step, &mut Scene { world: &mut self.world, reset })?;
        let end = end.or_else(|| self.is_over().then_some(EpisodeEnd::Budget));
        Ok(end.map(|end| self.cycle.finish(end)))
    }

    fn evaluate(&mut self) -> anyhow::Result<()> {
        let steps = self.counters().steps;
        self.last_evaluation = Some(steps);
        let Some(evaluator) = &mut self.evaluator else { return Ok(()) };
        let record = evaluator.run(steps, self.cycle.agents())?;
        self.observer.on_evaluation(&record, self.cycle.counters())
    }

    /// After an episode: the report, and the hard reset that may follow it.
    fn close(&mut self, mut episode: EpisodeEvent) -> anyhow::Result<()> {
        let due = self.cycle.hard_reset_due();
        if let Some(due) = due {
            // A lost world has no state to ask, and its end is not the reset agent's doing.
            let is_lost = due == HardResetDue::Lost;
            let (kind, cost) = if is_lost { (None, 1.0) } else { self.world.hard_reset_due()? };
            let cost = self.cycle.count_hard_reset(cost, !is_lost);
            episode.hard_reset = Some(HardReset { kind, cost });
        }
        self.observer.on_episode(&episode, self.cycle.counters())?;
        let (step, observer) = (self.counters().steps, &mut self.observer);
        let mut taken = Ok(());
        self.cycle.metrics().drain(&mut |name, mean| {
            if taken.is_ok() {
                taken = observer.on_metric(step, name, mean);
            }
        });
        taken?;
        if due.is_some() { self.place() } else { Ok(()) }
    }

    /// Shows the reset task some starts, and those of the evaluation the same. Nothing is counted.
    fn calibrate(&mut self) -> anyhow::Result<()> {
        for _ in 0..self.settings.calibration_resets {
            let seed = self.resets.next_u64();
            self.world.hard_reset(self.settings.start(), seed)?;
            self.evaluator.as_mut().map_or(Ok(()), |evaluator| evaluator.show_start(seed))?;
        }
        // What the task says of these starts is not said of the first one.
        self.cycle.metrics().drain(&mut |_, _| {});
        Ok(())
    }

    /// A hard reset, to the start that the mode names.
    fn place(&mut self) -> anyhow::Result<()> {
        self.world.hard_reset(self.settings.start(), self.resets.next_u64())?;
        self.cycle.placed();
        Ok(())
    }

    /// Between two steps: keeps the state where that is due. Returns whether the run was stopped here.
    fn pause(&mut self) -> anyhow::Result<bool> {
        let is_stopped = self.stop.load(Ordering::Relaxed);
        let steps = self.counters().steps;
        if let Some(every) = self.settings.checkpoint_every
            && self.last_checkpoint != Some(steps)
        {
            // The first is due before the first step: from then on, a run that is killed can go on. A stop changes nothing about a
            // checkpoint that is due in every run.
            if steps.is_multiple_of(every) {
                self.keep(Occasion::Periodic)?;
            } else if is_stopped {
                self.keep(Occasion::Interrupted)?;
            }
        }
        self.is_interrupted |= is_stopped;
        Ok(is_stopped)
    }

    fn is_over(&self) -> bool {
        self.counters().steps >= self.settings.steps || self.is_interrupted
    }
}
