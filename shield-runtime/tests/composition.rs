//! Rules under `All` and `Any`, soft rules, and discrete actions: what is allowed, and what is executed instead.
#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use common::Rule;
use shield_api::{
    AbortRule, ActMode, Batch, Checkpoint, Error, Learner, LearnerInfo, Needs, Reason, Result, Rows,
    RuleContext, RuleVerdict, Space, Spaces,
};
use shield_runtime::{
    decision::{Cause, Decision, ProjectionKind},
    experiment::{ProjectionConfig, QpConfig},
    shield::{Agents, Ladder, LadderSettings, Moment, RuleTree},
};

/// Values an action by a table; acts at the origin.
struct Table(Vec<f32>);

impl Checkpoint for Table {}

impl Learner for Table {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: 1, discount: 0.99 }
    }

    fn act(&mut self, _: &[f32], _: ActMode, action: &mut [f32]) -> Result<()> {
        action.fill(0.0);
        Ok(())
    }

    fn q_values(&mut self, _: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        let value = self.0.get(action[0] as usize).copied();
        values[0] = value.ok_or_else(|| Error::failed("not in the table"))?;
        Ok(())
    }

    fn update(&mut self, _: &Batch<'_>) -> Result<()> {
        Ok(())
    }
}

/// A third party's rule: row · a ≤ bound, for an action or the last of several lies.
struct Half {
    row: [f32; 2],
    bound: f32,
    fails: bool,
}

impl Checkpoint for Half {}

impl AbortRule for Half {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        use std::fmt::Write;
        if self.fails {
            return Err(Error::failed("out of order"));
        }
        let side = self.row[0] * context.proposed[0] + self.row[1] * context.proposed[1];
        write!(reason, "{side} is above {}", self.bound).unwrap();
        Ok(RuleVerdict::from_safe(side <= self.bound, side))
    }

    fn linearise(&self, _: &RuleContext<'_>, _: &[f32], rows: &mut dyn Rows) -> Result<()> {
        rows.push(&self.row, self.bound)
    }
}

fn half(row: [f32; 2], bound: f32) -> Box<dyn AbortRule> {
    Box::new(Half { row, bound, fails: false })
}

fn rule(row: [f32; 2], bound: f32) -> RuleTree {
    RuleTree::Rule(half(row, bound))
}

fn ladder(rules: RuleTree, action: Space, projection: Option<ProjectionConfig>) -> Ladder {
    let fallback_action = vec![0.0; action.action_len()];
    let spaces = Spaces { observation: Space::unbounded(1), action };
    let settings = LadderSettings { spaces, warm_up_steps: 0, fallback_action };
    let ladder = Ladder::new(rules, &Table(vec![1.0]), settings).unwrap();
    match projection {
        Some(projection) => ladder.with_projection(projection).unwrap(),
        None => ladder,
    }
}

const MOMENT: Moment<'static> = Moment { step: 0, observation: &[0.0], previous: None };

fn decide(rules: RuleTree, projection: Option<ProjectionConfig>) -> (Decision, [f32; 2], String) {
    let mut ladder = ladder(rules, Space::uniform(2, -1.0, 1.0), projection);
    let mut action = [0.5, 0.5];
    let agents = Agents { reset: &mut Table(vec![1.0]), forward: None, success: None };
    let decision = ladder.filter(agents, &MOMENT, &mut action);
    (decision, action, ladder.reason().to_owned())
}

fn qp() -> Option<ProjectionConfig> {
    Some(ProjectionConfig::Qp(QpConfig::default()))
}

fn assert_near(found: [f32; 2], expected: [f32; 2]) {
    let is_near = found.iter().zip(&expected).all(|(one, other)| (one - other).abs() < 1e-4);
    assert!(is_near, "{found:?} is not {expected:?}");
}

#[test]
fn one_branch_of_any_is_enough() {
    let any = |first, second| RuleTree::Any(vec![rule([1.0, 0.0], first), rule([0.0, 1.0], second)]);
    assert_eq!(decide(any(0.6, 0.0), None).0, Decision::Allow);
    assert_eq!(decide(any(0.0, 0.6), None).0, Decision::Allow);
    let (decision, _, reason) = decide(any(0.0, 0.1), None);
    assert_eq!(decision.abort().map(|abort| (abort.rule, abort.score)), Some((Some(0), 0.5)));
    assert_eq!(reason, "0.5 is above 0; 0.5 is above 0.1");
    let both = RuleTree::All(vec![any(0.6, 0.6), rule([1.0, 1.0], 0.9)]);
    assert_eq!(decide(both, None).0.abort().unwrap().rule, Some(2));
}

#[test]
fn a_failing_branch_aborts_whatever_the_others_allow() {
    for order in [0, 1] {
        let failing: Box<dyn AbortRule> = Box::new(Half { row: [0.0; 2], bound: 1.0, fails: true });
        let mut branches = vec![RuleTree::Rule(failing), rule([1.0, 0.0], 1.0)];
        branches.rotate_left(order);
        let (decision, _, reason) = decide(RuleTree::Any(branches), qp());
        let abort = decision.abort().unwrap();
        assert_eq!((abort.cause, abort.rule), (Cause::RuleFailed, Some(order)));
        assert_eq!(reason, "out of order");
    }
    let not_a_number = Rule::judging(|_| Ok(RuleVerdict::from_safe(false, f32::NAN)));
    let branches = vec![rule([1.0, 0.0], 1.0), RuleTree::Rule(not_a_number)];
    assert_eq!(decide(RuleTree::Any(branches), None).0.abort().unwrap().cause, Cause::RuleFailed);
}

#[test]
fn the_projection_goes_to_the_nearest_branch() {
    let any = |first, second| RuleTree::Any(vec![rule([1.0, 0.0], first), rule([0.0, 1.0], second)]);
    assert_near(decide(any(0.2, -0.5), qp()).1, [0.2, 0.5]);
    assert_near(decide(any(-0.5, 0.2), qp()).1, [0.5, 0.2]);
    // What stands beside `Any` is kept in each branch.
    let with = RuleTree::All(vec![any(0.2, 0.25), rule([1.0, 1.0], 0.6)]);
    assert_near(decide(with, qp()).1, [0.35, 0.25]);
    // A branch that no action keeps does not spoil the other.
    let (decision, action, _) = decide(any(-2.0, 0.2), qp());
    assert_eq!(decision.projection().map(|found| found.iterations), Some(1));
    assert_near(action, [0.5, 0.2]);
    assert_eq!(decide(any(-2.0, -2.0), qp()).0.abort().unwrap().cause, Cause::Infeasible);
}

/// A rule that allows what its rows do not: rows may be more careful than the rule.
struct Careful(Half);

impl Checkpoint for Careful {}

impl AbortRule for Careful {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn evaluate(&self, context: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
        Ok(RuleVerdict::from_safe(context.proposed != [0.5, 0.5], 0.0))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        self.0.linearise(context, gradients, rows)
    }
}

#[test]
fn contradictory_soft_rows_give_way_by_priority() {
    let careful = |sign: f32| -> Box<dyn AbortRule> {
        Box::new(Careful(Half { row: [sign, 0.0], bound: -0.5, fails: false }))
    };
    let hard = RuleTree::All(vec![RuleTree::Rule(careful(1.0)), RuleTree::Rule(careful(-1.0))]);
    assert_eq!(decide(hard, qp()).0.abort().unwrap().cause, Cause::Infeasible);
    // a ≤ −0.5 and a ≥ 0.5: the one of the higher priority is nearly kept, the other gives way.
    let soft = |first, second| {
        RuleTree::All(vec![RuleTree::soft(first, careful(1.0)), RuleTree::soft(second, careful(-1.0))])
    };
    assert!(decide(soft(1e6, 1.0), qp()).1[0] < -0.49);
    // minimise (a − 0.5)²/2 + p (a + 0.5)²/2: a = (1 − p) / 2 / (1 + p).
    assert_near(decide(soft(3.0, 1e-6), qp()).1, [-0.25, 0.5]);
    // Soft rows soften no rule.
    let (decision, _, _) = decide(RuleTree::soft(1.0, half([1.0, 0.0], 0.0)), qp());
    assert_eq!(decision.abort().unwrap().cause, Cause::StillRejected);
    for priority in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let settings = LadderSettings {
            spaces: Spaces { observation: Space::unbounded(1), action: Space::uniform(2, -1.0, 1.0) },
            warm_up_steps: 0,
            fallback_action: vec![0.0; 2],
        };
        let tree = RuleTree::soft(priority, half([1.0, 0.0], 0.0));
        assert!(Ladder::new(tree, &Table(vec![1.0]), settings).is_err(), "{priority}");
    }
}

/// Four discrete actions with these forward values, of which the rule allows those with a reset value of 0.5 or more.
fn best(forward: [f32; 4], reset: [f32; 4]) -> (Decision, f32) {
    let rules = RuleTree::Rule(Rule::below(0.5));
    let mut ladder = ladder(rules, Space::Discrete { n: 4 }, Some(ProjectionConfig::Best));
    let (mut reset, mut forward) = (Table(reset.to_vec()), Table(forward.to_vec()));
    let mut action = [3.0];
    let agents = Agents { reset: &mut reset, forward: Some(&mut forward), success: None };
    (ladder.filter(agents, &MOMENT, &mut action), action[0])
}

#[test]
fn a_discrete_action_is_projected_to_the_best_allowed_one() {
    let (decision, action) = best([1.0, 5.0, 4.0, 9.0], [1.0, 0.0, 1.0, 0.0]);
    assert_eq!((decision.projection().unwrap().kind, action), (ProjectionKind::Best, 2.0));
    assert_eq!(best([4.0, 4.0, 4.0, 9.0], [0.0, 1.0, 1.0, 0.0]).1, 1.0, "of equal ones the first");
    let none = best([1.0; 4], [0.0; 4]);
    assert_eq!((none.0.abort().unwrap().cause, none.1), (Cause::StillRejected, 0.0));
    assert_eq!(best([f32::NAN; 4], [1.0, 1.0, 1.0, 0.0]).0.abort().unwrap().cause, Cause::ValuesFailed);

    let rules = RuleTree::Rule(Rule::below(0.5));
    let mut ladder = ladder(rules, Space::Discrete { n: 4 }, Some(ProjectionConfig::Best));
    let agents = Agents { reset: &mut Table(vec![1.0, 1.0, 1.0, 0.0]), forward: None, success: None };
    assert_eq!(
        ladder.filter(agents, &MOMENT, &mut [3.0]).abort().unwrap().cause,
        Cause::ValuesFailed,
        "a policy values nothing"
    );
}

#[test]
fn a_rule_judges_a_projected_action_by_its_own_forward_values() {
    let needs = Needs { forward_values: true, ..Needs::default() };
    let judge = Box::new(|context: &RuleContext<'_>| {
        Ok(RuleVerdict::from_safe(context.forward_values[0] < 5.0, context.forward_values[0]))
    });
    let tree = RuleTree::Rule(Box::new(Rule { needs, judge }));
    let mut ladder = ladder(tree, Space::Discrete { n: 4 }, Some(ProjectionConfig::Replace));
    let agents = Agents {
        reset: &mut Table(vec![1.0; 4]),
        forward: Some(&mut Table(vec![1.0, 2.0, 3.0, 9.0])),
        success: None,
    };
    let mut action = [3.0];
    assert!(ladder.filter(agents, &MOMENT, &mut action).projection().is_some());
    assert_eq!((action, ladder.judgement().forward_values.as_slice()), ([0.0], &[9.0][..]));
}
