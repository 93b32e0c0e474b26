//! An environment behind a shield: any agent that acts in it is shielded and need not know.

use shield_api::{Environment, EnvironmentSpec, Phase, ResetTask, Result, StepOutcome};

use crate::{
    cycle::HardResetDue,
    decision::Decision,
    drop_in::DropIn,
    world::{Stepped, World},
};

/// How a step leaves the episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepEnd {
    /// The episode goes on.
    Continues,
    /// The environment cannot go on: the value of its last state is 0.
    Terminated,
    /// The episode ends, and the value of its last state counts: the action was aborted.
    Truncated,
}

/// What came of a step.
#[derive(Debug, Clone, Copy)]
pub struct ShieldedStep<'a> {
    /// Rewards and flags; of an aborted action, which was not executed, no reward and no flag.
    pub outcome: StepOutcome,
    /// Whether the episode goes on.
    pub end: StepEnd,
    /// What the shield decided.
    pub decision: Decision,
    /// Why the action was rejected, for a person; empty if it was not.
    pub reason: &'a str,
}

/// An environment behind a shield.
///
/// A step whose action is aborted is not executed: it is `Truncated`, and the observation is as before. `reset` then lets the reset agent
/// undo what was done; the environment itself is reset only at the beginning and when the reset agent has given up.
pub struct Shielded<E> {
    world: World<E>,
    inside: DropIn,
    action: Vec<f32>,
}

impl<E: Environment> Shielded<E> {
    /// Puts `shield` around an environment, whose reset reward and reset set `reset_task` replaces if it is given. The shield's attempts must be
    /// given the environment's length, if they are to have it.
    ///
    /// # Errors
    /// Neither the environment nor a task says what "reset" means, or the spaces are impossible.
    pub fn new(environment: E, reset_task: Option<Box<dyn ResetTask>>, shield: DropIn) -> Result<Self> {
        let world = World::around(Box::new(environment), reset_task)?;
        let action = vec![0.0; world.spec().spaces.action_len()];
        Ok(Self { world, inside: shield, action })
    }

    /// The environment's own, with a reset reward in any case.
    pub fn spec(&self) -> EnvironmentSpec {
        EnvironmentSpec { brings_reset_reward: true, ..self.world.spec().clone() }
    }

    /// The shield.
    pub fn shield(&self) -> &DropIn {
        &self.inside
    }

    /// Times that the environment inside was reset, the first time excluded.
    pub fn hard_resets(&self) -> u64 {
        self.inside.counters().hard_resets
    }

    /// Begins an episode: the reset agent undoes what was done; where it has given up, and at the beginning, the environment is reset.
    ///
    /// # Errors
    /// The environment, the shield or a plugin of it failed.
    pub fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        if self.inside.is_placed() {
            self.inside.begin_reset();
            while self.inside.phase() == Phase::Reset {
                self.inside.filter(self.world.observation(), &mut self.action)?;
                self.execute()?;
            }
        }
        if !self.inside.is_placed() || self.inside.needs_hard_reset() {
            self.place(None, seed)?;
        }
        observation.copy_from_slice(self.world.observation());
        Ok(())
    }

    /// A hard reset to one of [`starts`](Self::starts), which is counted.
    ///
    /// # Errors
    /// The environment or the reset task failed.
    pub fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.place(Some(start), seed)?;
        observation.copy_from_slice(self.world.observation());
        Ok(())
    }

    /// Names of the environment's other starts.
    pub fn starts(&self) -> Vec<String> {
        self.world.starts()
    }

    /// Executes the action, as proposed or altered, if the shield allows it.
    ///
    /// # Errors
    /// A length is wrong, or the environment, the shield or a plugin of it failed.
    pub fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<ShieldedStep<'_>> {
        shield_api::check_length("action", action, self.action.len())?;
        self.action.copy_from_slice(action);
        let decision = self.inside.filter(self.world.observation(), &mut self.action)?;
        let (outcome, end) = match decision {
            Decision::Abort(_) | Decision::Resetting => (StepOutcome::default(), StepEnd::Truncated),
            Decision::Allow | Decision::WarmUp | Decision::Project(_) => {
                let outcome = self.execute()?;
                (outcome, if outcome.terminated { StepEnd::Terminated } else { StepEnd::Continues })
            }
        };
        observation.copy_from_slice(self.world.observation());
        Ok(ShieldedStep { outcome, end, decision, reason: self.inside.reason() })
    }

    /// Executes the action in the buffer.
    fn execute(&mut self) -> Result<StepOutcome> {
        let stepped = self
            .world
            .step(&self.action)
            .inspect_err(|_| self.inside.require_hard_reset(HardResetDue::Lost))?;
        let Stepped::Made(outcome) = stepped else {
            self.inside.require_hard_reset(HardResetDue::Lost);
            return Ok(StepOutcome { terminated: true, ..StepOutcome::default() });
        };
        self.inside.observe_outcome(self.world.next_observation(), &outcome)?;
        self.world.advance();
        Ok(outcome)
    }

    fn place(&mut self, start: Option<&str>, seed: u64) -> Result<()> {
        for number in 1..=u64::from(self.inside.calibration_resets()) {
            self.world.hard_reset(start, seed.wrapping_add(number))?;
            self.inside.observe_start(self.world.observation())?;
        }
        self.inside.require_hard_reset(self.inside.hard_reset_due().unwrap_or(HardResetDue::Requested));
        self.world.hard_reset(start, seed)?;
        self.inside.hard_reset_done(self.world.observation())
    }
}
