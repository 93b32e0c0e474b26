//! An environment around an environment: whoever acts in it is shielded and need not know.

use shield_api::{
    Checkpoint, Environment, EnvironmentSpec, Phase, ResetSignal, ResetTask, Result, StepOutcome,
};

use crate::{
    decision::Decision,
    drop_in::{DropIn, Learning},
    shield::Shield,
    world::{Stepped, World},
};

/// An environment behind a shield.
///
/// A step whose action is aborted is not executed: its outcome says `terminated`, with no reward, and the observation is as before. `reset` then
/// lets the reset agent undo what was done; the environment itself is reset only at the beginning and when the reset agent has given up.
/// With [`learning`](Self::learning), the reset agent learns meanwhile.
///
/// `spec`, starts and observations are those of the environment inside. Its state cannot be saved.
pub struct Shielded<E> {
    world: World<E>,
    inside: DropIn,
    action: Vec<f32>,
    last_decision: Option<Decision>,
}

impl<E: Environment> Shielded<E> {
    /// Puts `shield` around an environment, whose reset reward and reset set `reset_task` replaces if it is given. The shield's reset episodes
    /// must be given the environment's length, if they are to have it.
    ///
    /// # Errors
    /// Neither the environment nor a task says what "reset" means, or the spaces are impossible.
    pub fn new(environment: E, reset_task: Option<Box<dyn ResetTask>>, shield: Shield) -> Result<Self> {
        let world = World::around(Box::new(environment), reset_task)?;
        let action = vec![0.0; world.spec().spaces.action_len()];
        Ok(Self { world, inside: DropIn::new(shield, None), action, last_decision: None })
    }

    /// Lets the reset agent learn.
    #[must_use]
    pub fn learning(mut self, learning: Learning) -> Self {
        self.inside = self.inside.learning(learning);
        self
    }

    /// What the shield said of the last action.
    pub fn last_decision(&self) -> Option<Decision> {
        self.last_decision
    }

    /// The shield.
    pub fn shield(&self) -> &Shield {
        self.inside.shield()
    }

    /// Times that the environment inside was reset, the first time excluded.
    pub fn hard_resets(&self) -> u64 {
        self.inside.counters().hard_resets
    }

    /// Executes the action in the buffer.
    fn execute(&mut self) -> Result<StepOutcome> {
        let Stepped::Made(outcome) = self.world.step(&self.action)? else {
            self.inside.require_hard_reset();
            return Ok(StepOutcome { terminated: true, ..StepOutcome::default() });
        };
        let StepOutcome { reset_reward: reward, in_reset_set, terminated, .. } = outcome;
        let signal = ResetSignal { reward, in_reset_set };
        self.inside.observe(self.world.next_observation(), Some(signal), terminated)?;
        self.world.advance();
        Ok(outcome)
    }

    /// Lets the reset agent act until its episode ends.
    fn undo(&mut self) -> Result<()> {
        self.inside.begin_reset();
        while self.inside.phase() == Phase::Reset {
            self.inside.filter(self.world.observation(), &mut self.action)?;
            self.execute()?;
        }
        Ok(())
    }

    fn place(&mut self, start: Option<&str>, seed: u64) -> Result<()> {
        self.world.hard_reset(start, seed)?;
        self.inside.hard_reset_done(self.world.observation())
    }
}

impl<E: Environment> Checkpoint for Shielded<E> {}

impl<E: Environment> Environment for Shielded<E> {
    fn spec(&self) -> EnvironmentSpec {
        EnvironmentSpec { brings_reset_reward: true, ..self.world.spec().clone() }
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        if self.inside.is_placed() {
            self.undo()?;
        }
        if !self.inside.is_placed() || self.inside.needs_hard_reset() {
            self.place(None, seed)?;
        }
        observation.copy_from_slice(self.world.observation());
        Ok(())
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        shield_api::check_length("action", action, self.action.len())?;
        self.action.copy_from_slice(action);
        let decision = self.inside.filter(self.world.observation(), &mut self.action)?;
        self.last_decision = Some(decision);
        let outcome = match decision {
            Decision::Abort(_) | Decision::Resetting => {
                StepOutcome { terminated: true, ..StepOutcome::default() }
            }
            Decision::Allow | Decision::WarmUp | Decision::Project(_) => self.execute()?,
        };
        observation.copy_from_slice(self.world.observation());
        Ok(outcome)
    }

    fn starts(&self) -> Vec<String> {
        self.world.starts()
    }

    /// A hard reset, counted.
    fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.place(Some(start), seed)?;
        observation.copy_from_slice(self.world.observation());
        Ok(())
    }
}
