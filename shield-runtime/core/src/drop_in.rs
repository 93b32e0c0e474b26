//! The shield in somebody else's loop: what the doors for Python, C and Rust share.
//!
//! The caller proposes, executes and reports; the [reset cycle](crate::cycle) decides, stores, learns and counts. Where the caller has an
//! environment that can be stepped, [`Shielded`](crate::shielded::Shielded) is the loop around this.

mod builder;
mod calibration;
mod frozen;
mod looking;
mod metrics;
mod observing;
mod state;

pub use builder::{DropInBuilder, Learning};
pub use frozen::Frozen;
pub use metrics::EpisodeLog;
pub use observing::DropInObserver;
pub use state::{DropInState, RestoreError};

use shield_api::{
    Error, Learner, Phase, ResetSignal, ResetTask, Result, Spaces, StepOutcome, check_finite, check_length,
};

use self::metrics::EpisodeMetrics;
use crate::{
    cycle::{HardResetDue, ResetCycle},
    decision::{Cause, Decision},
    experience::AgentRole,
    shield::write_safe,
};

/// A shield, what "reset" means, and what the reset agent learns.
///
/// Each step: [`filter`](Self::filter) the proposed action, execute what is then in the buffer, [`observe`](Self::observe) where it led. An
/// aborted action has given way to the reset agent's, which is in charge from then on, as [`phase`](Self::phase) says, until its attempt is
/// over. When [`needs_hard_reset`](Self::needs_hard_reset), nothing may move until [`hard_reset_done`](Self::hard_reset_done).
///
/// ```
/// use shield_api::{ActMode, Batch, Checkpoint, Learner, LearnerInfo, ResetSignal, Result, Space, Spaces};
/// use shield_core::{decision::Decision, drop_in::DropIn};
/// # use shield_api::{AbortRule, Needs, Reason, RuleContext, RuleVerdict};
/// # struct Home;
/// # impl Checkpoint for Home {}
/// # impl Learner for Home {
/// #     fn info(&self) -> LearnerInfo { LearnerInfo { members: 1, discount: 0.99 } }
/// #     fn act(&mut self, observation: &[f32], _: ActMode, action: &mut [f32]) -> Result<()> {
/// #         action[0] = (-observation[0]).clamp(-1.0, 1.0);
/// #         Ok(())
/// #     }
/// #     fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
/// #         values[0] = 1.0 - (observation[0] + action[0]).abs();
/// #         Ok(())
/// #     }
/// #     fn update(&mut self, _: &Batch<'_>) -> Result<()> { Ok(()) }
/// # }
/// # struct AtLeast(f32);
/// # impl Checkpoint for AtLeast {}
/// # impl AbortRule for AtLeast {
/// #     fn needs(&self) -> Needs { Needs { values: true, ..Needs::default() } }
/// #     fn evaluate(&self, context: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
/// #         Ok(RuleVerdict::from_safe(context.values[0] >= self.0, context.values[0]))
/// #     }
/// # }
/// # fn main() -> Result<()> {
/// // `Home` is a learner that walks back to 0, `AtLeast` a rule; plugins are found by `plugin::Registry`.
/// let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
/// let mut shield = DropIn::builder(spaces, Box::new(Home)).rule(Box::new(AtLeast(0.25))).build()?;
///
/// let mut position = 0.0_f32;
/// for _ in 0..20 {
///     let mut action = [0.5]; // What the policy proposes: ever further away.
///     match shield.filter(&[position], &mut action)? {
///         Decision::Abort(_) => println!("too far from home: {}", shield.reason()),
///         Decision::Resetting => println!("on the way back"),
///         _ => println!("allowed"),
///     }
///     position += action[0]; // The robot moves.
///     let home = ResetSignal { reward: 1.0 - position.abs(), in_reset_set: position.abs() < 0.1 };
///     shield.observe(&[position], Some(home), false)?;
///     if shield.needs_hard_reset() {
///         position = 0.0; // A person carries it home.
///         shield.hard_reset_done(&[position])?;
///     }
///     assert!(position <= 1.0);
/// }
/// # Ok(())
/// # }
/// ```
pub struct DropIn {
    cycle: ResetCycle,
    task: Option<Box<dyn ResetTask>>,
    /// Starts that the task is still to be shown before the first step.
    calibration_resets: u32,
    metrics: EpisodeMetrics,
    observer: Option<Box<dyn DropInObserver>>,
    /// It is lent to another environment: nothing learns, and nobody is told of anything.
    is_frozen: bool,
}

impl DropIn {
    /// Begins to describe a shield for an environment with these spaces, and the agent that undoes: a learner, or a
    /// [`Controller`](crate::controller::Controller) around a policy or a function that is given.
    pub fn builder(spaces: Spaces, reset_agent: Box<dyn Learner>) -> DropInBuilder {
        DropInBuilder::new(spaces, reset_agent)
    }

    /// Puts a cycle with a ladder and a reset agent into a loop. Without a `task`, every [`observe`](Self::observe) must say what "reset" means.
    ///
    /// # Errors
    /// The cycle has no ladder or no reset agent.
    pub fn new(cycle: ResetCycle, task: Option<Box<dyn ResetTask>>) -> Result<Self> {
        let (Some(_), Some(_)) = (&cycle.parts().ladder, &cycle.parts().reset) else {
            return Err(Error::invalid_argument("a shield needs rules and a reset agent"));
        };
        Ok(Self {
            cycle,
            task,
            calibration_resets: 0,
            metrics: EpisodeMetrics::default(),
            observer: None,
            is_frozen: false,
        })
    }

    /// Everything is at its start, where `observation` is seen: before the first step, and after each hard reset.
    ///
    /// # Errors
    /// The observation is invalid, or the reset task failed. Then a hard reset is still needed.
    pub fn hard_reset_done(&mut self, observation: &[f32]) -> Result<()> {
        self.hard_reset_done_at(observation, None)
    }

    /// As [`hard_reset_done`](Self::hard_reset_done), where the caller says whether this start counts as reset, as in the signals of
    /// [`observe`](Self::observe). Only [`findings`](Self::findings) depend on it.
    ///
    /// # Errors
    /// As for [`hard_reset_done`](Self::hard_reset_done).
    pub fn hard_reset_done_at(&mut self, observation: &[f32], is_inside: Option<bool>) -> Result<()> {
        self.cut(self.cycle.hard_reset_due().unwrap_or(HardResetDue::Requested));
        check_finite("the observation after a reset", observation, self.spaces().observation_len())?;
        if let Some(task) = self.task.as_mut().filter(|_| !self.is_frozen) {
            self.cycle.metrics().collect(|| task.observe_start(observation))?;
        }
        if self.cycle.is_placed() {
            self.cycle.count_hard_reset(1.0, true);
            self.report_hard_reset();
        }
        self.cycle.placed();
        if let Some(is_inside) = is_inside {
            self.cycle.note_start(is_inside);
        }
        self.metrics.episode_is_over(self.cycle.counters(), None)
    }

    /// Decides on `action`, which afterwards holds what may be executed: the proposed action, a projected one, or the reset agent's. The
    /// first observation of all is taken for a start.
    ///
    /// # Errors
    /// A length is wrong, the shield is out of service, or the reset task failed: `action` holds the fallback action.
    pub fn filter(&mut self, observation: &[f32], action: &mut [f32]) -> Result<Decision> {
        let metrics = self.cycle.metrics().clone();
        let decided = metrics.collect(|| self.decide(observation, action));
        write_safe(self.cycle.action(), action);
        let decision = decided?;
        if self.cycle.is_broken() {
            let reason = self.reason();
            return Err(Error::failed(format!("the shield cannot decide any more: {reason}")));
        }
        Ok(decision)
    }

    fn decide(&mut self, observation: &[f32], action: &[f32]) -> Result<Decision> {
        if !self.is_placed()
            && !self.needs_hard_reset()
            && check_finite("", observation, self.spaces().observation_len()).is_ok()
            && let Err(error) = self.hard_reset_done(observation)
        {
            self.cycle.refuse(Cause::AwaitsHardReset);
            return Err(error);
        }
        // A rule that is told of such a decision would rightly refuse for ever.
        let lengths = check_length("the observation", observation, self.spaces().observation_len())
            .and_then(|()| check_length("the action", action, self.spaces().action_len()));
        if let Err(error) = lengths {
            self.cycle.refuse(Cause::InvalidAction);
            return Err(error);
        }
        if self.cycle.turn() == AgentRole::Reset {
            return Ok(self.act_to_reset(observation));
        }
        self.cycle.take_proposal(action);
        if self.cycle.hard_reset_due().is_none() {
            self.cycle.begin_episode();
        }
        let is_judged = self.cycle.hard_reset_due().is_none() && !self.cycle.is_broken();
        let decision = self.cycle.decide(observation);
        if is_judged {
            self.report(AgentRole::Forward, decision);
        }
        let is_intervention = self.cycle.hard_reset_due().is_none() && !self.cycle.is_broken();
        if let Some(abort) = decision.abort().filter(|_| is_intervention) {
            let episode = self.cycle.finish_aborted(abort.cause);
            self.report_episode(&episode);
            if self.cycle.turn() == AgentRole::Reset {
                self.cycle.begin_episode();
            }
        }
        Ok(decision)
    }

    /// The reset agent acts; one that fails has given way to the fallback action.
    fn act_to_reset(&mut self, observation: &[f32]) -> Decision {
        match self.cycle.act_to_reset(observation) {
            Ok(decided) => {
                if let Some(decision) = decided {
                    self.report(AgentRole::Reset, decision);
                }
                self.cycle.forget_reason();
                Decision::Resetting
            }
            Err(error) => {
                let decision = self.cycle.reset_failed(&error);
                self.report(AgentRole::Reset, decision);
                decision
            }
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
        self.observe_and_count(next_observation, signal, terminated, false)
    }

    /// As [`observe`](Self::observe), where the caller knows irreversible states: entries into them are counted, and nothing else follows.
    ///
    /// # Errors
    /// As for [`observe`](Self::observe).
    pub fn observe_and_count(
        &mut self,
        next_observation: &[f32],
        signal: Option<ResetSignal>,
        terminated: bool,
        irreversible: bool,
    ) -> Result<()> {
        let outcome = self.signal(next_observation, signal).map(|signal| StepOutcome {
            // What an environment shows that has ended may be its start: nothing was reached, and nothing is earned by it.
            reset_reward: if terminated { signal.reward.min(0.0) } else { signal.reward },
            in_reset_set: signal.in_reset_set && !terminated,
            terminated,
            irreversible,
            ..StepOutcome::default()
        });
        self.conclude(next_observation, outcome)
    }

    /// Tells of the reward of the forward step that was just executed, beside the one that an abort gives: where aborting pays, an agent learns to be
    /// aborted. Only [`findings`](Self::findings) depend on it.
    pub fn note_reward(&mut self, reward: f64, abort_reward: f64) {
        self.cycle.note_reward(reward, abort_reward);
    }

    /// As [`observe`](Self::observe), for an environment of the interface, which says what "reset" means itself.
    pub fn observe_outcome(&mut self, next_observation: &[f32], outcome: &StepOutcome) -> Result<()> {
        self.conclude(next_observation, Ok(*outcome))
    }

    fn conclude(&mut self, next_observation: &[f32], outcome: Result<StepOutcome>) -> Result<()> {
        let concluded = outcome.and_then(|outcome| self.take_note(next_observation, &outcome));
        if concluded.is_err() {
            self.cut(HardResetDue::Lost);
        }
        concluded
    }

    fn take_note(&mut self, next_observation: &[f32], outcome: &StepOutcome) -> Result<()> {
        let in_charge = self.phase();
        let end = self.cycle.observe(next_observation, outcome)?;
        self.take_metrics();
        self.metrics.step(in_charge, outcome.reset_reward);
        if let Some(episode) = self.cycle.stood_in(outcome) {
            self.report_episode(&episode);
        }
        let Some(end) = end else { return Ok(()) };
        let attempt = self.cycle.finish(end);
        self.report_episode(&attempt);
        if in_charge == Phase::Reset {
            if self.phase() == Phase::Reset && !self.needs_hard_reset() {
                // Another attempt begins at once.
                self.cycle.begin_episode();
            }
            self.metrics.episode_is_over(self.cycle.counters(), Some(attempt.has_reset))?;
        }
        Ok(())
    }

    fn signal(&mut self, next_observation: &[f32], given: Option<ResetSignal>) -> Result<ResetSignal> {
        check_finite("the observation after a step", next_observation, self.spaces().observation_len())?;
        let signal = match (&mut self.task, given) {
            (Some(task), None) => {
                let (observation, action) = (self.cycle.observation(), self.cycle.action());
                self.cycle.metrics().collect(|| task.evaluate(observation, action, next_observation))?
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

    /// Hands over to the reset agent although nothing was aborted: the task is done, or its time is up. Returns whether it is in charge: not
    /// if nothing was done since the last success, nor if a hard reset is needed.
    pub fn begin_reset(&mut self) -> bool {
        if let Some(episode) = self.cycle.begin_reset() {
            self.report_episode(&episode);
        }
        let is_in_charge = self.cycle.turn() == AgentRole::Reset;
        if is_in_charge {
            self.cycle.begin_episode();
        }
        is_in_charge
    }

    /// Nothing may move before a hard reset.
    pub fn require_hard_reset(&mut self, cause: HardResetDue) {
        self.cut(cause);
    }
}
