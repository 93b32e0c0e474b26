//! The shield: decides before every action whether it could be undone, and lets the reset agent take over where it could not.
//!
//! Allow, else project, else abort. Whatever goes wrong on the way to a verdict aborts: a number that is not finite, a wrong length, a
//! plugin or solver that fails, a missed deadline. [`Ladder`] alone decides; [`Shield`] owns the reset agent too and keeps count of its
//! attempts. The joint loop uses the ladder and the counting; a program of one's own uses the shield, or [`Shielded`](crate::shielded::Shielded).

mod attempt;
mod attempts;
mod builder;
mod clock;
mod explanation;
mod jury;
mod ladder;
mod moment;
mod projection;
mod qp;
mod rows;
mod rules;
mod setup;
pub mod solver;
mod state;

pub use attempts::{Attempts, ResetSettings};
pub use builder::ShieldBuilder;
pub use jury::Judgement;
pub use ladder::{Ladder, LadderSettings, write_safe};
pub use moment::{Agents, Moment};
pub use rules::RuleTree;
pub(crate) use setup::nearest_to_zero;
pub(crate) use state::{ShieldState, restore_rules, save_rules};

use shield_api::{ActMode, Phase, Spaces, metrics::Metrics};

use crate::{
    agent::Agent,
    decision::{Cause, Decision},
    experience::Experience,
    settings::BetweenAttempts,
};

/// A shield with its reset agent, for a program that drives the robot itself.
///
/// Before every step call [`filter`](Self::filter), execute what is then in the buffer, and report it with [`step_done`](Self::step_done).
/// While the reset agent is in charge, `filter` writes its action. When it has given up, [`needs_hard_reset`](Self::needs_hard_reset) says so:
/// nothing may move until a person has put everything back and [`hard_reset_done`](Self::hard_reset_done) is called.
///
/// ```
/// use shield_api::{ActMode, Batch, Checkpoint, Learner, LearnerInfo, Result, Space, Spaces};
/// use shield_runtime::{decision::Decision, shield::Shield};
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
/// let mut shield = Shield::builder(spaces, Box::new(Home)).rule(Box::new(AtLeast(0.25))).build()?;
///
/// let mut position = 0.0;
/// for _ in 0..20 {
///     let mut action = [0.5]; // What the policy proposes: ever further away.
///     match shield.filter(&[position], &mut action) {
///         Decision::Abort(_) => println!("too far from home: {}", shield.reason()),
///         Decision::Resetting => println!("on the way back"),
///         _ => println!("allowed"),
///     }
///     position += action[0]; // The robot moves.
///     shield.step_done(position.abs() < 0.1);
///     if shield.needs_hard_reset() {
///         position = 0.0; // A person carries it home.
///         shield.hard_reset_done();
///     }
///     assert!(position <= 1.0);
/// }
/// # Ok(())
/// # }
/// ```
pub struct Shield {
    ladder: Ladder,
    reset_agent: Agent,
    attempts: Attempts,
    settings: ResetSettings,
    explores: bool,
    exploration_replaced: u64,
    phase: Phase,
    steps: u64,
    /// Steps of the present reset episode, and whether it saw the reset set.
    reset_steps: u64,
    has_visited: bool,
    needs_hard_reset: bool,
    has_previous: bool,
    previous: Vec<f32>,
}

impl Shield {
    /// Begins to describe a shield for an environment with these spaces, and the agent that undoes.
    pub fn builder(spaces: Spaces, reset_agent: Box<dyn shield_api::Learner>) -> ShieldBuilder {
        ShieldBuilder::new(spaces, reset_agent)
    }

    /// A shield that decides by `ladder` and undoes by `reset_agent`, which explores if it is to learn.
    pub fn new(ladder: Ladder, reset_agent: Agent, settings: ResetSettings, explores: bool) -> Self {
        let previous = vec![0.0; ladder.settings.spaces.action_len()];
        Self {
            ladder,
            reset_agent,
            attempts: Attempts::new(settings.attempts),
            settings,
            explores,
            exploration_replaced: 0,
            phase: Phase::Forward,
            steps: 0,
            reset_steps: 0,
            has_visited: false,
            needs_hard_reset: false,
            has_previous: false,
            previous,
        }
    }

    /// The spaces of the environment.
    pub fn spaces(&self) -> &Spaces {
        &self.ladder.settings.spaces
    }

    /// What a buffer holds where nothing better can be executed.
    pub fn fallback_action(&self) -> &[f32] {
        &self.ladder.settings.fallback_action
    }

    /// Decides on `action`, which afterwards holds what may be executed: the proposed action, a projected one, or the reset agent's. After an
    /// abort the reset agent is in charge, until [`step_done`](Self::step_done) ends its episode.
    pub fn filter(&mut self, observation: &[f32], action: &mut [f32]) -> Decision {
        let moment =
            Moment { step: self.steps, observation, previous: self.has_previous.then_some(&self.previous) };
        let agents = Agents { reset: self.reset_agent.learner(), forward: None };
        let decision = if self.needs_hard_reset {
            self.ladder.refuse(Cause::AwaitsHardReset, action)
        } else if self.phase == Phase::Forward {
            self.ladder.filter(agents, &moment, action)
        } else {
            let mode = if self.explores { ActMode::Explore } else { ActMode::Greedy };
            match agents
                .reset
                .act(observation, mode, action)
                .and_then(|()| self.ladder.check(&moment, action))
            {
                Ok(()) if self.explores && self.settings.shield_exploration => {
                    let is_replaced = self.ladder.guard(agents, &moment, action).abort().is_some();
                    self.exploration_replaced += u64::from(is_replaced);
                    Decision::Resetting
                }
                Ok(()) => Decision::Resetting,
                Err(error) => self.ladder.reset_failed(&error, action),
            }
        };
        if decision == Decision::Resetting {
            self.ladder.why.forget();
        }
        if decision.abort().is_some() && self.phase == Phase::Forward && !self.needs_hard_reset {
            self.begin_reset();
        }
        let length = self.previous.len().min(action.len());
        self.previous[..length].copy_from_slice(&action[..length]);
        decision
    }

    /// The executed action led to a state, which is in the reset set or not. Ends the reset agent's episode where that is due; then says
    /// whether it has succeeded.
    pub fn step_done(&mut self, in_reset_set: bool) -> Option<bool> {
        self.steps += 1;
        self.has_previous = true;
        if self.phase == Phase::Forward {
            return None;
        }
        self.reset_steps += 1;
        self.has_visited |= in_reset_set;
        let is_over =
            (self.settings.stop_on_reset && in_reset_set) || self.reset_steps >= self.settings.episode_length;
        if !is_over {
            return None;
        }
        let has_reset = self.settings.test.is_passed(self.has_visited, in_reset_set);
        self.needs_hard_reset = self.attempts.record(has_reset);
        let tries_again = !has_reset && self.settings.between_attempts == BetweenAttempts::Reset;
        if tries_again && !self.needs_hard_reset {
            self.begin_reset();
        } else {
            self.phase = Phase::Forward;
        }
        Some(has_reset)
    }

    /// Hands over to the reset agent although nothing was aborted: the task is done, or its time is up.
    pub fn begin_reset(&mut self) {
        self.phase = Phase::Reset;
        (self.reset_steps, self.has_visited) = (0, false);
    }

    /// Who is in charge of the next step.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether the reset agent has given up: until [`hard_reset_done`](Self::hard_reset_done) every action is aborted.
    pub fn needs_hard_reset(&self) -> bool {
        self.needs_hard_reset
    }

    /// An abort without anyone being asked; the buffer holds the fallback action.
    pub fn refuse(&mut self, cause: Cause, action: &mut [f32]) -> Decision {
        self.ladder.refuse(cause, action)
    }

    /// The reset agent cannot help: the environment has ended, or its state is not known.
    pub fn require_hard_reset(&mut self) {
        (self.needs_hard_reset, self.phase) = (true, Phase::Forward);
    }

    /// Everything is back at its start.
    pub fn hard_reset_done(&mut self) {
        self.attempts.clear();
        (self.needs_hard_reset, self.has_previous, self.phase) = (false, false, Phase::Forward);
    }

    /// Why the last action was rejected, for a person; empty if it was not.
    pub fn reason(&self) -> &str {
        self.ladder.reason()
    }

    /// What the rules were told of the last proposed action, and what they compared.
    pub fn judgement(&self) -> &Judgement {
        self.ladder.judgement()
    }

    /// Exploratory actions of the reset agent that gave way to its greedy one, because the rules rejected them.
    pub fn exploration_replaced(&self) -> u64 {
        self.exploration_replaced
    }

    /// Whether a plugin that the shield needs is out of service: from now on everything is aborted.
    pub fn is_broken(&self) -> bool {
        self.ladder.is_broken()
    }

    /// What the reset agent reports while it learns.
    pub fn metrics(&self) -> &Metrics {
        self.reset_agent.metrics()
    }

    /// Lets the reset agent learn from what happened.
    ///
    /// # Errors
    /// The learner failed.
    pub fn learn(&mut self, experience: &Experience, updates: usize) -> shield_api::Result<()> {
        self.reset_agent.learn(experience, updates)
    }
}
