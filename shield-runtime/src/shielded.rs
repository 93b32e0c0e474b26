//! An environment around an environment: whoever acts in it is shielded and need not know.

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{Checkpoint, Environment, EnvironmentSpec, Phase, ResetTask, Result, StepOutcome};

use crate::{
    decision::Decision,
    experience::{AgentShare, Experience, Transition},
    shield::Shield,
    world::{Stepped, World},
};

/// What the reset agent learns while a [`Shielded`] environment is used.
pub struct Learning {
    /// Where its transitions go.
    pub experience: Experience,
    /// Updates after each step of either agent.
    pub updates_per_step: usize,
}

/// An environment behind a shield.
///
/// A step whose action is aborted is not executed: its outcome says `terminated`, with no reward, and the observation is as before. `reset` then
/// lets the reset agent undo what was done; the environment itself is reset only at the beginning and when the reset agent has given up.
/// With [`learning`](Self::learning), the reset agent learns from every step.
///
/// `spec`, starts and observations are those of the environment inside. Its state cannot be saved.
pub struct Shielded<E> {
    world: World<E>,
    shield: Shield,
    learning: Option<Learning>,
    masks: Pcg64,
    action: Vec<f32>,
    last_decision: Option<Decision>,
    is_placed: bool,
    must_be_placed: bool,
    hard_resets: u64,
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
        Ok(Self {
            world,
            shield,
            learning: None,
            masks: Pcg64::seed_from_u64(0),
            action,
            last_decision: None,
            is_placed: false,
            must_be_placed: false,
            hard_resets: 0,
        })
    }

    /// Lets the reset agent learn; `seed` draws its bootstrap masks.
    #[must_use]
    pub fn learning(mut self, learning: Learning, seed: u64) -> Self {
        self.learning = Some(learning);
        self.masks = Pcg64::seed_from_u64(seed);
        self
    }

    /// What the shield said of the last action.
    pub fn last_decision(&self) -> Option<Decision> {
        self.last_decision
    }

    /// The shield.
    pub fn shield(&self) -> &Shield {
        &self.shield
    }

    /// Times that the environment inside was reset, the first time excluded.
    pub fn hard_resets(&self) -> u64 {
        self.hard_resets
    }

    /// Executes the action in the buffer.
    fn execute(&mut self) -> Result<StepOutcome> {
        let Stepped::Made(outcome) = self.world.step(&self.action)? else {
            self.must_be_placed = true;
            return Ok(StepOutcome { terminated: true, ..StepOutcome::default() });
        };
        if let Some(Learning { experience, updates_per_step }) = &mut self.learning {
            let transition = Transition {
                observation: self.world.observation(),
                action: &self.action,
                next_observation: self.world.next_observation(),
                forward: None,
                reset: Some(AgentShare { reward: outcome.reset_reward, continues: !outcome.terminated }),
            };
            experience.push(&transition, &mut self.masks);
            self.shield.learn(experience, *updates_per_step)?;
        }
        self.world.advance();
        self.shield.step_done(outcome.in_reset_set);
        self.must_be_placed |= outcome.terminated;
        Ok(outcome)
    }

    /// Lets the reset agent act until its episode ends.
    fn undo(&mut self) -> Result<()> {
        self.shield.begin_reset();
        while self.shield.phase() == Phase::Reset && !self.must_be_placed {
            self.shield.filter(self.world.observation(), &mut self.action);
            self.execute()?;
        }
        Ok(())
    }

    fn place(&mut self, start: Option<&str>, seed: u64) -> Result<()> {
        self.world.hard_reset(start, seed)?;
        self.hard_resets += u64::from(self.is_placed);
        (self.is_placed, self.must_be_placed) = (true, false);
        self.shield.hard_reset_done();
        Ok(())
    }
}

impl<E: Environment> Checkpoint for Shielded<E> {}

impl<E: Environment> Environment for Shielded<E> {
    fn spec(&self) -> EnvironmentSpec {
        EnvironmentSpec { brings_reset_reward: true, ..self.world.spec().clone() }
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        if self.is_placed && !self.must_be_placed {
            self.undo()?;
        }
        if !self.is_placed || self.must_be_placed || self.shield.needs_hard_reset() {
            self.place(None, seed)?;
        }
        observation.copy_from_slice(self.world.observation());
        Ok(())
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        shield_api::check_length("action", action, self.action.len())?;
        self.action.copy_from_slice(action);
        let decision = self.shield.filter(self.world.observation(), &mut self.action);
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
