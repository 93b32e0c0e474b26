//! A success critic and a rule of which each test says what they answer, and which keep what they are told.

use std::sync::{Arc, Mutex};

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{
    AbortRule, AttemptBatch, Checkpoint, Needs, ObservedAttempt, Reason, Result, RuleContext, RuleVerdict,
    SuccessCritic, SuccessCriticInfo,
};
use shield_runtime::{
    critic::Critic,
    experience::{Experience, UndoSettings},
};

use super::spaces;

/// Everything is drawn alike, both members learn from it, and no outcome fades.
pub const ALIKE: UndoSettings = UndoSettings {
    bootstrap_probability: 1.0,
    failure_share: 0.0,
    success_share: 0.0,
    outcome_half_life: f64::INFINITY,
};

/// One row of a batch for a success critic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lesson {
    pub observation: f32,
    pub action: f32,
    pub next_observation: f32,
    pub next_action: f32,
    pub success: f32,
    pub continuation: f32,
    pub outcome: f32,
    pub weight: f32,
    pub masks: [f32; 2],
}

impl Lesson {
    pub fn all(batch: &AttemptBatch<'_>) -> Vec<Self> {
        (0..batch.size)
            .map(|row| Self {
                observation: batch.observations[row],
                action: batch.actions[row],
                next_observation: batch.next_observations[row],
                next_action: batch.next_actions[row],
                success: batch.successes[row],
                continuation: batch.continuations[row],
                outcome: batch.outcomes[row],
                weight: batch.outcome_weights[row],
                masks: [batch.masks[row * 2], batch.masks[row * 2 + 1]],
            })
            .collect()
    }
}

pub type Lessons = Arc<Mutex<Vec<Lesson>>>;

type Estimate = Box<dyn FnMut(f32, f32) -> f32 + Send>;

/// Two members that agree.
pub struct Odds {
    estimate: Estimate,
    pub lessons: Lessons,
    /// Its state.
    pub updates: Arc<Mutex<u64>>,
}

impl Odds {
    pub fn of(estimate: impl FnMut(f32, f32) -> f32 + Send + 'static) -> Self {
        Self { estimate: Box::new(estimate), lessons: Lessons::default(), updates: Arc::default() }
    }

    /// With batches of one row.
    pub fn taught(self) -> Critic {
        Critic::new(Box::new(self), 1, &spaces(), Pcg64::seed_from_u64(4))
    }
}

impl Checkpoint for Odds {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.extend(self.updates.lock().unwrap().to_le_bytes());
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        *self.updates.lock().unwrap() = u64::from_le_bytes(bytes.try_into().unwrap());
        Ok(())
    }
}

impl SuccessCritic for Odds {
    fn info(&self) -> SuccessCriticInfo {
        SuccessCriticInfo { members: 2 }
    }

    fn probabilities(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
    ) -> Result<()> {
        probabilities.fill((self.estimate)(observation[0], action[0]));
        Ok(())
    }

    fn update(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        self.lessons.lock().unwrap().extend(Lesson::all(batch));
        *self.updates.lock().unwrap() += 1;
        Ok(())
    }
}

/// What a [`Witness`] was told.
#[derive(Debug, Default)]
pub struct Testimony {
    pub attempts: Vec<ObservedAttempt>,
    /// Of each decision: the first member's estimate at the start.
    pub starts: Vec<f32>,
}

type Opinion = Box<dyn Fn(&RuleContext<'_>) -> bool + Send>;

/// A rule that needs undo probabilities. Its state is how many attempts it was told of.
pub struct Witness {
    allows: Opinion,
    pub testimony: Arc<Mutex<Testimony>>,
}

impl Witness {
    pub fn allowing(allows: impl Fn(&RuleContext<'_>) -> bool + Send + 'static) -> Self {
        Self { allows: Box::new(allows), testimony: Arc::default() }
    }
}

impl Checkpoint for Witness {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.push(self.testimony.lock().unwrap().attempts.len() as u8);
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let attempt = ObservedAttempt { step: 0, succeeded: true };
        self.testimony.lock().unwrap().attempts = vec![attempt; usize::from(bytes[0])];
        Ok(())
    }
}

impl AbortRule for Witness {
    fn needs(&self) -> Needs {
        Needs { probabilities: true, greedy_probabilities: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
        self.testimony.lock().unwrap().starts.push(context.start_probabilities[0]);
        Ok(RuleVerdict::from_safe((self.allows)(context), context.probabilities[0]))
    }

    fn observe_attempt(&mut self, attempt: &ObservedAttempt) -> Result<()> {
        self.testimony.lock().unwrap().attempts.push(*attempt);
        Ok(())
    }
}

/// Whether each attempt succeeded of which a rule was told, and the steps before it.
pub fn told(testimony: &Mutex<Testimony>) -> Vec<(u64, bool)> {
    testimony.lock().unwrap().attempts.iter().map(|attempt| (attempt.step, attempt.succeeded)).collect()
}

/// A memory for a success critic with two members.
pub fn memory(capacity: usize, settings: UndoSettings) -> Experience {
    Experience::new(capacity, &spaces(), [1, 1], 1.0).and_then(|memory| memory.with_undo(settings)).unwrap()
}
