//! Whole decisions over random rows.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    AbortRule, ActMode, Batch, Checkpoint, Learner, LearnerInfo, Needs, Reason, Result, Rows, RuleContext,
    RuleVerdict, Space, Spaces,
};
use shield_runtime::{
    experiment::{ProjectionConfig, QpConfig},
    shield::{Agents, Ladder, LadderSettings, Moment, RuleTree},
};

use crate::{PROGRAMS, programs, random_program::Owned};

/// A third party's rule: every row holds, to the last bit.
struct Polytope(Vec<(Vec<f32>, f32)>);

impl Polytope {
    /// By how much the worst row fails; negative inside.
    fn excess(&self, action: &[f32]) -> f64 {
        let excess = |(row, bound): &(Vec<f32>, f32)| {
            row.iter().zip(action).map(|(slope, value)| f64::from(*slope) * f64::from(*value)).sum::<f64>()
                - f64::from(*bound)
        };
        self.0.iter().map(excess).fold(f64::NEG_INFINITY, f64::max)
    }
}

impl Checkpoint for Polytope {}

impl AbortRule for Polytope {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn evaluate(&self, context: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
        let excess = self.excess(context.proposed) as f32;
        Ok(RuleVerdict::from_safe(excess <= 0.0, excess))
    }

    fn linearise(&self, _: &RuleContext<'_>, _: &[f32], rows: &mut dyn Rows) -> Result<()> {
        self.0.iter().try_for_each(|(row, bound)| rows.push(row, *bound))
    }
}

/// Does nothing well.
struct Idle;

impl Checkpoint for Idle {}

impl Learner for Idle {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: 1, discount: 0.99 }
    }

    fn act(&mut self, _: &[f32], _: ActMode, action: &mut [f32]) -> Result<()> {
        action.fill(0.0);
        Ok(())
    }

    fn q_values(&mut self, _: &[f32], _: &[f32], _: &mut [f32]) -> Result<()> {
        Ok(())
    }

    fn update(&mut self, _: &Batch<'_>) -> Result<()> {
        Ok(())
    }
}

/// Whole decisions: what is executed keeps every row, and the action space, whatever the solver makes of the program.
#[test]
fn projected_actions_are_allowed_by_the_rules() {
    let decisions = programs(PROGRAMS / 4);
    let mut random = Pcg64::seed_from_u64(5);
    let (mut projected, mut aborted) = (0, 0);
    for case in 0..decisions {
        let program = Owned::random(&mut random, 1..=12, 40);
        let width = program.lower.len();
        let rows: Vec<_> = (0..program.bounds.len())
            .map(|index| {
                let row = program.program().row(index).iter().map(|slope| *slope as f32).collect();
                (row, program.bounds[index] as f32)
            })
            .collect();
        let polytope = Polytope(rows.clone());
        let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(width, -1.0, 1.0) };
        let settings = LadderSettings { spaces, warm_up_steps: 0, fallback_action: vec![0.0; width] };
        let mut ladder = Ladder::new(RuleTree::Rule(Box::new(polytope)), &Idle, settings)
            .and_then(|ladder| ladder.with_projection(ProjectionConfig::Qp(QpConfig::default())))
            .unwrap();
        let mut action: Vec<f32> = (0..width).map(|_| random.random_range(-1.0..=1.0)).collect();
        let moment = Moment { step: 0, observation: &[0.0], previous: None };
        let decision =
            ladder.filter(Agents { reset: &mut Idle, forward: None, success: None }, &moment, &mut action);
        assert!(action.iter().all(|value| (-1.0..=1.0).contains(value)), "decision {case}: {action:?}");
        match decision.abort() {
            None => assert!(Polytope(rows).excess(&action) <= 0.0, "decision {case}: {program:?} {action:?}"),
            Some(_) => aborted += 1,
        }
        projected += u64::from(decision.projection().is_some());
    }
    assert!(projected > decisions / 5 && aborted > decisions / 5, "{projected} projected, {aborted} aborted");
}
