//! The shield in somebody else's loop: what the doors for Python, C and Rust share.
//!
//! The caller proposes, executes and reports; the shield decides, keeps the reset agent's experience, lets it learn, and counts. Where
//! the caller's environment stands on its own, [`Shielded`](crate::shielded::Shielded) is the loop around this.

mod figures;
mod state;

pub use figures::EpisodeLog;
pub use state::{DropInState, RestoreError};

use rand_pcg::Pcg64;
use shield_api::{Error, Phase, ResetSignal, ResetTask, Result, Spaces, check_finite, check_length};

use self::figures::Figures;
use crate::{
    decision::{Cause, Decision},
    experience::{AgentRole, AgentShare, Experience, Transition},
    record::Counters,
    settings::{Endings, Updates},
    shield::Shield,
};

/// What the reset agent learns from, and when.
pub struct Learning {
    /// Where its transitions go.
    pub experience: Experience,
    /// Updates after each step of which it learns.
    pub updates_per_step: usize,
    /// Whether it learns from every step, or from its own only.
    pub updates: Updates,
    /// How reset episodes end for its values.
    pub endings: Endings,
    /// How much of a hard reset's cost it loses.
    pub cost_weight: f32,
    /// Draws the bootstrap masks.
    pub masks: Pcg64,
}

impl Learning {
    /// Learns from every step, with the usual endings.
    pub fn new(experience: Experience, updates_per_step: usize, masks: Pcg64) -> Self {
        let (updates, endings) = (Updates::Both, Endings::default());
        Self { experience, updates_per_step, updates, endings, cost_weight: 0.0, masks }
    }
}

/// A shield, what "reset" means, and what the reset agent learns.
///
/// Each step: [`filter`](Self::filter) the proposed action, execute what is then in the buffer, [`observe`](Self::observe) where it led. An
/// aborted action has given way to the reset agent's, which is in charge from then on, as [`phase`](Self::phase) says, until its episode is over.
/// When [`needs_hard_reset`](Self::needs_hard_reset), nothing may move until [`hard_reset_done`](Self::hard_reset_done).
pub struct DropIn {
    shield: Shield,
    task: Option<Box<dyn ResetTask>>,
    learning: Option<Learning>,
    hard_reset_cost: f64,
    counters: Counters,
    figures: Figures,
    /// In which the last action was decided, and what it became.
    observation: Vec<f32>,
    executed: Vec<f32>,
    /// An action was decided, and where it led was not yet observed.
    is_deciding: bool,
    is_placed: bool,
    /// Something may have to be undone.
    has_moved: bool,
    is_in_forward_episode: bool,
    reset_successes: u64,
}

impl DropIn {
    /// Puts a shield into a loop. Without a `task`, every [`observe`](Self::observe) must say what "reset" means.
    pub fn new(shield: Shield, task: Option<Box<dyn ResetTask>>) -> Self {
        let (observation, action) = (shield.spaces().observation_len(), shield.spaces().action_len());
        Self {
            shield,
            task,
            learning: None,
            hard_reset_cost: 1.0,
            counters: Counters::default(),
            figures: Figures::default(),
            observation: vec![0.0; observation],
            executed: vec![0.0; action],
            is_deciding: false,
            is_placed: false,
            has_moved: false,
            is_in_forward_episode: false,
            reset_successes: 0,
        }
    }

    /// Lets the reset agent learn.
    #[must_use]
    pub fn learning(mut self, learning: Learning) -> Self {
        self.learning = Some(learning);
        self
    }

    /// What a hard reset costs. Default: 1.
    #[must_use]
    pub fn hard_reset_cost(mut self, cost: f64) -> Self {
        self.hard_reset_cost = cost;
        self
    }

    /// Everything is at its start, where `observation` is seen: before the first step, and after each hard reset.
    ///
    /// # Errors
    /// The observation is not one, or the reset task failed. Then a hard reset is still needed.
    pub fn hard_reset_done(&mut self, observation: &[f32]) -> Result<()> {
        self.shield.require_hard_reset();
        check_finite("the observation after a reset", observation, self.observation.len())?;
        if let Some(task) = &mut self.task {
            self.shield.metrics().collect(|| task.observe_start(observation))?;
        }
        if self.is_placed {
            self.counters.hard_resets += 1;
            self.counters.hard_reset_cost += self.hard_reset_cost;
            if let Some(Learning { experience, cost_weight, .. }) = &mut self.learning {
                experience.charge_last(AgentRole::Reset, *cost_weight * self.hard_reset_cost as f32);
            }
        }
        self.shield.hard_reset_done();
        (self.is_placed, self.has_moved, self.is_deciding) = (true, false, false);
        self.is_in_forward_episode = false;
        self.figures.episode_is_over(&self.counters, None)
    }

    /// Decides on `action`, which afterwards holds what may be executed: the proposed action, a projected one, or the reset agent's. The
    /// first observation of all is taken for a start.
    ///
    /// # Errors
    /// A length is wrong, the shield is out of service, or the reset task failed: `action` holds the fallback action.
    pub fn filter(&mut self, observation: &[f32], action: &mut [f32]) -> Result<Decision> {
        if !self.is_placed
            && !self.needs_hard_reset()
            && check_finite("", observation, self.observation.len()).is_ok()
            && let Err(error) = self.hard_reset_done(observation)
        {
            self.shield.refuse(Cause::AwaitsHardReset, action);
            return Err(error);
        }
        // A rule that is told of such a decision would rightly refuse for ever.
        let lengths = check_length("the observation", observation, self.observation.len())
            .and_then(|()| check_length("the action", action, self.executed.len()));
        if let Err(error) = lengths {
            self.shield.refuse(Cause::InvalidAction, action);
            return Err(error);
        }
        let is_forward = self.shield.phase() == Phase::Forward;
        let metrics = self.shield.metrics().clone();
        let decision = metrics.collect(|| self.shield.filter(observation, action));
        if is_forward {
            self.count(decision);
        } else {
            let has_failed = decision.abort().is_some_and(|abort| abort.cause.is_failure());
            self.counters.failed_closed += u64::from(has_failed);
        }
        if self.shield.is_broken() {
            return Err(Error::failed(format!(
                "the shield cannot decide any more: {}",
                self.shield.reason()
            )));
        }
        self.is_deciding = true;
        self.observation.copy_from_slice(observation);
        self.executed.copy_from_slice(action);
        Ok(decision)
    }

    fn count(&mut self, decision: Decision) {
        let awaits = |cause| cause == Cause::AwaitsHardReset;
        if decision.abort().is_some_and(|abort| awaits(abort.cause)) {
            return;
        }
        if !self.is_in_forward_episode {
            self.is_in_forward_episode = true;
            self.counters.forward_episodes += 1;
        }
        self.counters.warm_up_decisions += u64::from(decision == Decision::WarmUp);
        self.counters.projections += u64::from(decision.projection().is_some());
        if let Some(abort) = decision.abort() {
            self.counters.early_aborts += 1;
            self.counters.failed_closed += u64::from(abort.cause.is_failure());
            self.counters.reset_episodes += 1;
            self.is_in_forward_episode = false;
        }
    }

    /// What was in the buffer after [`filter`](Self::filter) was executed and led to `next_observation`: it is stored, and the reset agent
    /// learns. `signal` says what "reset" means, where no task does. `terminated`: the environment cannot go on, a hard reset is needed.
    ///
    /// # Errors
    /// Nothing was decided, a number is not finite or of the wrong length, the reset task or the learner failed, or the event file cannot be written.
    /// A hard reset is needed then: what was executed is not in the experience.
    pub fn observe(
        &mut self,
        next_observation: &[f32],
        signal: Option<ResetSignal>,
        terminated: bool,
    ) -> Result<()> {
        let observed = self.take_note(next_observation, signal, terminated);
        if observed.is_err() {
            self.shield.require_hard_reset();
        }
        observed
    }

    fn take_note(
        &mut self,
        next_observation: &[f32],
        signal: Option<ResetSignal>,
        terminated: bool,
    ) -> Result<()> {
        if !std::mem::take(&mut self.is_deciding) {
            return Err(Error::failed("nothing was decided: `filter` comes before each `observe`"));
        }
        check_finite("the observation after a step", next_observation, self.observation.len())?;
        let signal = self.signal(next_observation, signal)?;
        let in_charge = self.shield.phase();
        self.counters.steps += 1;
        self.counters.forward_steps += u64::from(in_charge == Phase::Forward);
        self.has_moved = true;
        let ended = self.shield.step_done(signal.in_reset_set);
        self.remember(next_observation, signal, terminated, ended == Some(false));
        self.learn(in_charge)?;
        if terminated {
            self.shield.require_hard_reset();
        }
        self.figures.step(in_charge, signal.reward);
        if let Some(has_reset) = ended {
            self.reset_successes += u64::from(has_reset);
            self.has_moved = !has_reset;
            // Another attempt may have begun at once.
            self.counters.reset_episodes += u64::from(self.shield.phase() == Phase::Reset);
            self.figures.episode_is_over(&self.counters, Some(has_reset))?;
        }
        Ok(())
    }

    fn signal(&mut self, next_observation: &[f32], given: Option<ResetSignal>) -> Result<ResetSignal> {
        let signal = match (&mut self.task, given) {
            (Some(task), None) => {
                let evaluate = || task.evaluate(&self.observation, &self.executed, next_observation);
                self.shield.metrics().collect(evaluate)?
            }
            (None, Some(signal)) => signal,
            (None, None) => {
                return Err(Error::failed(
                    "nothing says what \"reset\" means: name a `reset_task`, or give reward and reset set with each step",
                ));
            }
            (Some(_), Some(_)) => {
                return Err(Error::failed(
                    "a reset task already says what \"reset\" means; with reward and reset set of yours, leave it out",
                ));
            }
        };
        check_finite("the reset reward", &[signal.reward], 1)?;
        Ok(signal)
    }

    fn remember(&mut self, next: &[f32], signal: ResetSignal, terminated: bool, has_failed: bool) {
        let Some(Learning { experience, endings, masks, .. }) = &mut self.learning else { return };
        let continues = endings.reset_continues(signal.in_reset_set, terminated, has_failed);
        let transition = Transition {
            observation: &self.observation,
            action: &self.executed,
            next_observation: next,
            forward: None,
            reset: Some(AgentShare { reward: signal.reward, continues }),
        };
        experience.push(&transition, masks);
    }

    fn learn(&mut self, in_charge: Phase) -> Result<()> {
        let Some(Learning { experience, updates, updates_per_step, .. }) = &self.learning else {
            return Ok(());
        };
        if *updates_per_step > 0 && (in_charge == Phase::Reset || *updates == Updates::Both) {
            self.shield.learn(experience, *updates_per_step)?;
            self.figures.take(self.shield.metrics());
        }
        Ok(())
    }

    /// Hands over to the reset agent although nothing was aborted: the task is done, or its time is up. Returns whether it is in charge: not
    /// if nothing was done since the last success, nor if a hard reset is needed.
    pub fn begin_reset(&mut self) -> bool {
        if self.phase() == Phase::Forward && self.has_moved && !self.needs_hard_reset() {
            self.shield.begin_reset();
            self.counters.reset_episodes += 1;
        }
        self.is_in_forward_episode = false;
        self.phase() == Phase::Reset
    }

    /// Nobody knows where the environment stands, or it cannot go on.
    pub fn require_hard_reset(&mut self) {
        self.shield.require_hard_reset();
    }

    /// Who is in charge of the next step.
    pub fn phase(&self) -> Phase {
        self.shield.phase()
    }

    /// Whether [`hard_reset_done`](Self::hard_reset_done) must come next: the reset agent has given up, or the environment has ended.
    pub fn needs_hard_reset(&self) -> bool {
        self.shield.needs_hard_reset()
    }

    /// Whether a start was ever observed.
    pub fn is_placed(&self) -> bool {
        self.is_placed
    }

    /// The spaces of the environment.
    pub fn spaces(&self) -> &Spaces {
        self.shield.spaces()
    }

    /// The shield.
    pub fn shield(&self) -> &Shield {
        &self.shield
    }

    /// Everything that was counted; what only an environment plugin knows stays 0.
    pub fn counters(&self) -> Counters {
        Counters { exploration_replaced: self.shield.exploration_replaced(), ..self.counters }
    }

    /// Mean of the reset ensemble's values of the action that was proposed last; NaN if no rule needed them.
    pub fn reset_value(&self) -> f32 {
        let values = &self.shield.judgement().values;
        values.iter().sum::<f32>() / values.len() as f32
    }

    /// Counts and the learner's figures by name, in a stable order. A figure is the mean over the episode so far, or over the last one.
    pub fn metrics(&self, take: &mut impl FnMut(&str, f64)) {
        let counters = self.counters();
        for (name, count) in [
            ("steps", counters.steps),
            ("forward_steps", counters.forward_steps),
            ("forward_episodes", counters.forward_episodes),
            ("reset_episodes", counters.reset_episodes),
            ("reset_successes", self.reset_successes),
            ("early_aborts", counters.early_aborts),
            ("failed_closed", counters.failed_closed),
            ("projections", counters.projections),
            ("warm_up_decisions", counters.warm_up_decisions),
            ("exploration_replaced", counters.exploration_replaced),
            ("hard_resets", counters.hard_resets),
        ] {
            take(name, count as f64);
        }
        take("hard_reset_cost", counters.hard_reset_cost);
        self.figures.each(take);
    }
}
