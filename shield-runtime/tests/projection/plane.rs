//! An agent over two dimensions, a rule about its value, and a shield of both.

use std::{
    fmt::Write,
    sync::{Arc, Mutex},
    thread,
    time::Duration,
};

use shield_api::{
    AbortRule, ActMode, Batch, Checkpoint, Error, Learner, LearnerInfo, Needs, ObservedDecision, Reason,
    Result, Rows, RuleContext, RuleVerdict, Space, Spaces,
};
use shield_runtime::{
    decision::{Cause, Decision},
    experiment::{ProjectionConfig, QpConfig},
    shield::{Agents, Ladder, LadderSettings, Moment, RuleTree},
};

pub const BAD: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];

/// What the reset agent does, and so what the buffer holds after an abort.
pub const SAFE: [f32; 2] = [-0.75, -0.75];

pub const PROPOSED: [f32; 2] = [0.5, 0.5];

pub type Value = fn(&[f32]) -> f32;

pub type Gradient = fn(&[f32]) -> [f32; 2];

/// One member over two dimensions.
pub struct Plane {
    pub value: Value,
    pub gradient: Option<Gradient>,
}

impl Plane {
    /// Q = −a₀ − a₁.
    pub fn linear() -> Self {
        Self { value: |action| -action[0] - action[1], gradient: Some(|_| [-1.0, -1.0]) }
    }
}

impl Checkpoint for Plane {}

impl Learner for Plane {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: 1, discount: 0.99 }
    }

    fn act(&mut self, _: &[f32], _: ActMode, action: &mut [f32]) -> Result<()> {
        action.copy_from_slice(&SAFE);
        Ok(())
    }

    fn q_values(&mut self, _: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        values[0] = (self.value)(action);
        Ok(())
    }

    fn q_gradients(
        &mut self,
        _: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        let gradient = self.gradient.ok_or_else(|| Error::failed("no gradients today"))?;
        values[0] = (self.value)(action);
        gradients.copy_from_slice(&gradient(action));
        Ok(())
    }

    fn update(&mut self, _: &Batch<'_>) -> Result<()> {
        Ok(())
    }
}

/// The rows that a rule pushes, from the gradients and the threshold.
pub type Pushes = fn(&RuleContext<'_>, &[f32], f32, &mut dyn Rows) -> Result<()>;

/// Of each decision, whether it was an abort, and the action.
type Told = Arc<Mutex<Vec<(bool, Vec<f32>)>>>;

/// A third party's rule: the value must reach a threshold. `pushes` may tell lies.
pub struct Reach {
    pub threshold: f32,
    pub pushes: Pushes,
    pub told: Told,
    pub is_slow_to_note: bool,
}

impl Reach {
    pub fn new(threshold: f32) -> Self {
        Self { threshold, pushes: honest, told: Arc::default(), is_slow_to_note: false }
    }
}

/// Q(a₀) + g·(a − a₀) ≥ threshold.
fn honest(context: &RuleContext<'_>, gradients: &[f32], threshold: f32, rows: &mut dyn Rows) -> Result<()> {
    let here: f32 = gradients.iter().zip(context.proposed).map(|(slope, action)| slope * action).sum();
    let row: Vec<f32> = gradients.iter().map(|slope| -slope).collect();
    rows.push(&row, context.values[0] - here - threshold)
}

impl Checkpoint for Reach {}

impl AbortRule for Reach {
    fn needs(&self) -> Needs {
        Needs { values: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        let value = context.values[0];
        write!(reason, "{value} does not reach {}", self.threshold).unwrap();
        Ok(RuleVerdict::from_safe(value >= self.threshold, value))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        (self.pushes)(context, gradients, self.threshold, rows)
    }

    fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        if self.is_slow_to_note {
            thread::sleep(Duration::from_millis(5));
        }
        self.told.lock().unwrap().push((decision.aborted, decision.action.to_vec()));
        Ok(())
    }
}

pub fn qp(config: QpConfig) -> ProjectionConfig {
    ProjectionConfig::Qp(config)
}

pub fn settings(action: Space) -> LadderSettings {
    let fallback_action = vec![0.0; action.action_len()];
    let spaces = Spaces { observation: Space::unbounded(1), action };
    LadderSettings { spaces, warm_up_steps: 0, fallback_action }
}

pub fn shield(rule: impl AbortRule + 'static, agent: &Plane, projection: ProjectionConfig) -> Ladder {
    let settings = settings(Space::uniform(2, -1.0, 1.0));
    Ladder::new(RuleTree::Rule(Box::new(rule)), agent, settings).unwrap().with_projection(projection).unwrap()
}

pub fn only(reset: &mut Plane) -> Agents<'_> {
    Agents { reset, forward: None, success: None }
}

pub fn moment() -> Moment<'static> {
    Moment { step: 0, observation: &[0.0], previous: None }
}

pub fn filter(shield: &mut Ladder, agent: &mut Plane) -> (Decision, [f32; 2]) {
    let mut action = PROPOSED;
    let decision = shield.filter(only(agent), &moment(), &mut action);
    (decision, action)
}

pub fn decide(rule: Reach, mut agent: Plane, projection: ProjectionConfig) -> (Decision, [f32; 2]) {
    let mut shield = shield(rule, &agent, projection);
    filter(&mut shield, &mut agent)
}

/// Aborts under this cause, and the buffer is safe.
pub fn assert_aborts((decision, action): (Decision, [f32; 2]), cause: Cause) {
    assert_eq!(decision.abort().map(|abort| abort.cause), Some(cause));
    assert_eq!(action, SAFE, "after {cause}");
}
