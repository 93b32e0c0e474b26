//! Between allow and abort: what is executed instead of a rejected action, and that everything that goes wrong aborts.
#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use std::{sync::Arc, sync::Mutex, time::Duration};

use common::{Line, Scene, Scripted};
use shield_api::{
    AbortRule, ActMode, Batch, Checkpoint, Error, Learner, LearnerInfo, Needs, ObservedDecision, Reason,
    Result, Rows, RuleContext, RuleVerdict, Space, Spaces,
};
use shield_runtime::{
    decision::{Abort, Cause, Decision, Projection, ProjectionKind},
    events::{Counters, Intervention},
    experience::AgentRole,
    experiment::{ProjectionConfig, QpConfig},
    observer::{Observer, Scene as Stage},
    run::{Identity, Recorder, RunFolder},
    shield::{
        Agents, Ladder, LadderSettings, Moment, RuleTree,
        solver::{Outcome, Program, Solver},
    },
    world::World,
};

const BAD: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
/// What the reset agent does, and so what the buffer holds after an abort.
const SAFE: [f32; 2] = [-0.75, -0.75];
const PROPOSED: [f32; 2] = [0.5, 0.5];

type Value = fn(&[f32]) -> f32;
type Gradient = fn(&[f32]) -> [f32; 2];

/// One member over two dimensions.
struct Plane {
    value: Value,
    gradient: Option<Gradient>,
}

impl Plane {
    /// Q = −a₀ − a₁.
    fn linear() -> Self {
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

/// Of each decision, whether it was an abort, and the action.
type Told = Arc<Mutex<Vec<(bool, Vec<f32>)>>>;

/// A third party's rule: the value must reach a threshold. `pushes` may tell lies.
struct Reach {
    threshold: f32,
    pushes: fn(&RuleContext<'_>, &[f32], f32, &mut dyn Rows) -> Result<()>,
    told: Told,
    is_slow_to_note: bool,
}

impl Reach {
    fn new(threshold: f32) -> Self {
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
        use std::fmt::Write;
        let value = context.values[0];
        write!(reason, "{value} does not reach {}", self.threshold).unwrap();
        Ok(RuleVerdict::from_safe(value >= self.threshold, value))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        (self.pushes)(context, gradients, self.threshold, rows)
    }

    fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        if self.is_slow_to_note {
            std::thread::sleep(Duration::from_millis(5));
        }
        self.told.lock().unwrap().push((decision.aborted, decision.action.to_vec()));
        Ok(())
    }
}

fn qp(config: QpConfig) -> ProjectionConfig {
    ProjectionConfig::Qp(config)
}

fn settings(action: Space) -> LadderSettings {
    let fallback_action = vec![0.0; action.action_len()];
    let spaces = Spaces { observation: Space::unbounded(1), action };
    LadderSettings { spaces, warm_up_steps: 0, fallback_action }
}

fn shield(rule: impl AbortRule + 'static, agent: &Plane, projection: ProjectionConfig) -> Ladder {
    let settings = settings(Space::uniform(2, -1.0, 1.0));
    Ladder::new(RuleTree::Rule(Box::new(rule)), agent, settings).unwrap().with_projection(projection).unwrap()
}

fn only(reset: &mut Plane) -> Agents<'_> {
    Agents { reset, forward: None, success: None }
}

fn moment() -> Moment<'static> {
    Moment { step: 0, observation: &[0.0], previous: None }
}

fn filter(shield: &mut Ladder, agent: &mut Plane) -> (Decision, [f32; 2]) {
    let mut action = PROPOSED;
    let decision = shield.filter(only(agent), &moment(), &mut action);
    (decision, action)
}

fn decide(rule: Reach, mut agent: Plane, projection: ProjectionConfig) -> (Decision, [f32; 2]) {
    let mut shield = shield(rule, &agent, projection);
    filter(&mut shield, &mut agent)
}

/// The projected action under a configuration of the program.
fn projected(config: QpConfig) -> [f32; 2] {
    let (decision, action) = decide(Reach::new(0.0), Plane::linear(), qp(config));
    assert!(decision.projection().is_some(), "{decision:?}");
    action
}

fn assert_near(found: [f32; 2], expected: [f32; 2]) {
    let is_near = found.iter().zip(&expected).all(|(one, other)| (one - other).abs() < 1e-4);
    assert!(is_near, "{found:?} is not {expected:?}");
}

/// Aborts under this cause, and the buffer is safe.
fn assert_aborts((decision, action): (Decision, [f32; 2]), cause: Cause) {
    assert_eq!(decision.abort().map(|abort| abort.cause), Some(cause));
    assert_eq!(action, SAFE, "after {cause}");
}

#[test]
fn a_rule_of_a_third_party_is_projected_to_the_nearest_action() {
    let rule = Reach::new(0.0);
    let told = rule.told.clone();
    let mut agent = Plane::linear();
    let mut shield = shield(rule, &agent, qp(QpConfig::default()));
    let (decision, action) = filter(&mut shield, &mut agent);
    let projection = decision.projection().unwrap();
    assert_near(action, [0.0, 0.0]);
    assert_eq!((projection.kind, projection.iterations), (ProjectionKind::Qp, 1));
    assert!((projection.distance - 0.5f32.sqrt()).abs() < 1e-4);
    assert_eq!((projection.rejection.cause, projection.rejection.rule), (Cause::Rejected, Some(0)));
    assert_eq!(projection.rejection.score, -1.0);
    assert_eq!(shield.reason(), "-1 does not reach 0", "the reason is that of the proposed action");
    assert_eq!(*told.lock().unwrap(), [(false, action.to_vec())], "rules hear of what is executed");

    let mut exploration = PROPOSED;
    let decision = shield.guard(only(&mut agent), &moment(), &mut exploration);
    assert_aborts((decision, exploration), Cause::Rejected);
}

#[test]
fn every_field_of_the_program_changes_the_projection() {
    assert_near(projected(QpConfig::default()), [0.0, 0.0]);
    assert_near(projected(QpConfig { margin: 0.4, ..QpConfig::default() }), [-0.2, -0.2]);
    let weights = Some(vec![1.0, 3.0]);
    assert_near(projected(QpConfig { weights, ..QpConfig::default() }), [-0.25, 0.25]);
    // Half the range is 1: each dimension may move by 0.6, and 0.4 is not enough.
    let trust =
        |share| QpConfig { trust_region: Some(share), weights: Some(vec![1.0, 3.0]), ..QpConfig::default() };
    assert_near(projected(trust(0.6)), [-0.1, 0.1]);
    assert_aborts(decide(Reach::new(0.0), Plane::linear(), qp(trust(0.4))), Cause::Infeasible);
}

#[test]
fn a_curved_value_is_linearised_again() {
    // Q = −Σ (a³ + 0.2 a): from (0.5, 0.5), each linearisation ends outside, a little nearer.
    let curved = || Plane {
        value: |action| -action.iter().map(|value| value.powi(3) + 0.2 * value).sum::<f32>(),
        gradient: Some(|action| [0, 1].map(|index| -3.0 * action[index] * action[index] - 0.2)),
    };
    let with = |max_iterations, threshold| {
        decide(Reach::new(threshold), curved(), qp(QpConfig { max_iterations, ..QpConfig::default() }))
    };
    assert_aborts(with(1, -0.05), Cause::StillRejected);
    let (decision, action) = with(10, -0.05);
    let iterations = decision.projection().unwrap().iterations;
    assert!((2..=10).contains(&iterations), "{iterations}");
    assert!((curved().value)(&action) >= -0.05, "the true value decides: {action:?}");
}

#[test]
fn an_action_that_only_the_rows_allow_is_aborted() {
    // The gradient points the wrong way, so that rows and values contradict each other.
    let agent = Plane { gradient: Some(|_| [1.0, 1.0]), ..Plane::linear() };
    let once = QpConfig { max_iterations: 1, ..QpConfig::default() };
    assert_aborts(decide(Reach::new(-0.5), agent, qp(once)), Cause::StillRejected);
}

#[test]
fn non_finite_numbers_and_failing_agents_abort() {
    let mut gradients: Vec<(Option<Gradient>, Cause)> = vec![(None, Cause::GradientsFailed)];
    gradients.push((Some(|_| [f32::NAN, 1.0]), Cause::GradientsFailed));
    gradients.push((Some(|_| [1.0, f32::INFINITY]), Cause::GradientsFailed));
    gradients.push((Some(|_| [f32::NEG_INFINITY, 1.0]), Cause::GradientsFailed));
    gradients.push((Some(|_| [0.0, 0.0]), Cause::Infeasible));
    for (gradient, cause) in gradients {
        assert_aborts(
            decide(Reach::new(0.0), Plane { gradient, ..Plane::linear() }, qp(QpConfig::default())),
            cause,
        );
    }
    // The values of what was found fail, although those of the proposed action did not.
    let value: Value = |action| if action == PROPOSED { -1.0 } else { f32::NAN };
    assert_aborts(
        decide(Reach::new(0.0), Plane { value, ..Plane::linear() }, qp(QpConfig::default())),
        Cause::ValuesFailed,
    );
}

#[test]
fn unusable_rows_abort() {
    type Pushes = fn(&RuleContext<'_>, &[f32], f32, &mut dyn Rows) -> Result<()>;
    let mut table: Vec<(Pushes, Cause)> = vec![
        (|_, _, _, _| Err(Error::unsupported("linearising")), Cause::NotLinearisable),
        (|_, _, _, _| Err(Error::failed("no rows today")), Cause::RowsFailed),
        (|_, _, _, rows| rows.push(&[1.0], 0.0), Cause::RowsFailed),
        (|_, _, _, rows| rows.push(&[1.0, 0.0, 0.0], 0.0), Cause::RowsFailed),
        // A rule that overlooks the error.
        (|_, _, _, rows| rows.push(&[f32::NAN, 0.0], 0.0).or(Ok(())), Cause::RowsFailed),
        (|_, _, _, rows| rows.push(&[1.0, 0.0], -2.0), Cause::Infeasible),
        (
            |_, _, _, rows| rows.push(&[1.0, 0.0], -0.5).and_then(|()| rows.push(&[-1.0, 0.0], -0.5)),
            Cause::Infeasible,
        ),
        (
            |_, _, _, rows| {
                rows.push(&[1.0, 1.0], 0.0)?;
                rows.push(&[-1.0, 1.0], -0.1)?;
                rows.push(&[0.0, -1.0], -0.1)
            },
            Cause::Infeasible,
        ),
        (|_, _, _, rows| rows.push(&[0.0, 0.0], -0.1), Cause::Infeasible),
        (|_, _, _, rows| rows.push(&[1e-45, 0.0], -3e38), Cause::Infeasible),
        // Nothing is asked for, so that the rejected action itself is the nearest.
        (|_, _, _, _| Ok(()), Cause::StillRejected),
        (|_, _, _, rows| rows.push(&[0.0, 0.0], 0.1), Cause::StillRejected),
    ];
    table.push((|_, _, _, rows| rows.push(&[1.0, 0.0], f32::NAN), Cause::RowsFailed));
    table.push((|_, _, _, rows| rows.push(&[1.0, 0.0], f32::INFINITY), Cause::RowsFailed));
    table.push((|_, _, _, rows| rows.push(&[f32::INFINITY, 0.0], 0.0), Cause::RowsFailed));
    for (pushes, cause) in table {
        let rule = Reach { pushes, ..Reach::new(0.0) };
        assert_aborts(decide(rule, Plane::linear(), qp(QpConfig::default())), cause);
    }
}

/// A solver that does what it is told to.
struct Fake(fn(&Program<'_>, &mut [f64]) -> Outcome);

impl Solver for Fake {
    fn solve(&mut self, program: &Program<'_>, y: &mut [f64]) -> Outcome {
        (self.0)(program, y)
    }
}

#[test]
fn a_solver_that_fails_or_lies_leads_to_an_abort() {
    type Solve = fn(&Program<'_>, &mut [f64]) -> Outcome;
    let table: [(Solve, Cause); 7] = [
        (|_, _| panic!("the fake solver panics on purpose"), Cause::SolverPanicked),
        (|_, _| Outcome::NotConverged, Cause::NotConverged),
        (|_, _| Outcome::Infeasible, Cause::Infeasible),
        // It says that it solved, and wrote nothing, no number, nothing finite, or what breaks the row.
        (|_, _| Outcome::Solved, Cause::NotConverged),
        (
            |_, y| {
                y.fill(f64::NAN);
                Outcome::Solved
            },
            Cause::NotConverged,
        ),
        (
            |_, y| {
                y.fill(f64::INFINITY);
                Outcome::Solved
            },
            Cause::NotConverged,
        ),
        (
            |_, y| {
                y.fill(0.0);
                Outcome::Solved
            },
            Cause::NotConverged,
        ),
    ];
    for (solve, cause) in table {
        let mut agent = Plane::linear();
        let mut shield = shield(Reach::new(0.0), &agent, qp(QpConfig::default()))
            .with_solver(Box::new(Fake(solve)))
            .unwrap();
        assert_aborts(filter(&mut shield, &mut agent), cause);
        assert!(shield.reason().starts_with("-1 does not reach 0; not projected: "), "{}", shield.reason());
        // And once more: nothing is left behind that would let it pass.
        assert_aborts(filter(&mut shield, &mut agent), cause);
    }
    // Far outside the box, but in the right direction: it is brought back.
    let mut agent = Plane::linear();
    let far = Fake(|_, y| {
        y.fill(-1e9);
        Outcome::Solved
    });
    let mut shield =
        shield(Reach::new(0.0), &agent, qp(QpConfig::default())).with_solver(Box::new(far)).unwrap();
    assert_eq!(filter(&mut shield, &mut agent).1, [-1.0, -1.0]);
}

#[test]
fn the_reset_agents_action_replaces_a_rejected_one_if_the_rules_allow_it() {
    let (decision, action) = decide(Reach::new(0.0), Plane::linear(), ProjectionConfig::Replace);
    let projection = decision.projection().unwrap();
    assert_eq!((projection.kind, projection.iterations, action), (ProjectionKind::Replace, 0, SAFE));
    assert!((projection.distance - (2.0 * 1.25f32 * 1.25).sqrt()).abs() < 1e-5);
    // Its own value is 1.5.
    assert_aborts(decide(Reach::new(1.6), Plane::linear(), ProjectionConfig::Replace), Cause::StillRejected);
    let value: Value = |action| if action == SAFE { BAD[0] } else { -1.0 };
    let failing = Plane { value, ..Plane::linear() };
    assert_aborts(decide(Reach::new(0.0), failing, ProjectionConfig::Replace), Cause::ValuesFailed);
}

#[test]
fn a_projection_that_does_not_fit_the_action_space_is_refused() {
    let agent = Plane::linear();
    let build = |space: Space, config| {
        let shield = Ladder::new(RuleTree::Rule(Box::new(Reach::new(0.0))), &agent, settings(space)).unwrap();
        shield.with_projection(config).err().map(|error| error.message().to_owned())
    };
    let discrete = || Space::Discrete { n: 3 };
    assert!(build(discrete(), qp(QpConfig::default())).unwrap().contains("discrete"));
    assert_eq!(build(discrete(), ProjectionConfig::Replace), None);
    let weights = QpConfig { weights: Some(vec![1.0; 3]), ..QpConfig::default() };
    assert!(build(Space::uniform(2, -1.0, 1.0), qp(weights)).unwrap().contains("3 weights"));
    let endless = Space::uniform(2, f32::NEG_INFINITY, f32::INFINITY);
    let trust = QpConfig { trust_region: Some(0.5), ..QpConfig::default() };
    assert!(build(endless.clone(), qp(trust)).unwrap().contains("no bounds"));
    assert_eq!(build(endless, qp(QpConfig::default())), None);
}

#[test]
fn a_late_decision_aborts() {
    let slow: Value = |_| {
        std::thread::sleep(Duration::from_millis(5));
        1.0
    };
    let decide = |value, deadline| {
        let mut agent = Plane { value, ..Plane::linear() };
        let mut shield = shield(Reach::new(0.0), &agent, qp(QpConfig::default())).with_deadline(deadline);
        filter(&mut shield, &mut agent)
    };
    assert_aborts(decide(slow, Duration::from_millis(1)), Cause::Deadline);
    assert_eq!(decide(slow, Duration::from_secs(60)), (Decision::Allow, PROPOSED));
    // A rejection in time would be projected; late, it is not even tried.
    let slow_and_low: Value = |action| {
        std::thread::sleep(Duration::from_millis(5));
        -action[0] - action[1]
    };
    assert_aborts(decide(slow_and_low, Duration::from_millis(1)), Cause::Deadline);
    assert!(decide(slow_and_low, Duration::from_secs(60)).0.projection().is_some());
    // In time, but only until the rules have taken note of it.
    let dawdling = || Reach { told: Arc::default(), is_slow_to_note: true, ..Reach::new(-2.0) };
    let decide = |deadline| {
        let mut agent = Plane::linear();
        let mut shield = shield(dawdling(), &agent, qp(QpConfig::default())).with_deadline(deadline);
        filter(&mut shield, &mut agent)
    };
    assert_aborts(decide(Duration::from_millis(2)), Cause::Deadline);
    assert_eq!(decide(Duration::from_secs(60)).0, Decision::Allow);
}

#[test]
fn the_loop_executes_and_counts_the_projected_action() {
    // Rejects what leads right; the reset agent's own action, left, is allowed.
    let mut scene = Scene::new(6);
    scene.rules = vec![common::Rule::judging(|context| {
        Ok(RuleVerdict::from_safe(context.proposed[0] <= 0.0, context.proposed[0]))
    })];
    scene.reset = Some(Scripted::acting(|_, _| -0.5));
    scene.projection = Some(ProjectionConfig::Replace);
    let log = scene.line.log.clone();
    let (counters, notebook) = scene.run();
    assert_eq!((counters.projections, counters.early_aborts, counters.forward_steps), (6, 0, 6));
    assert!(log.lock().unwrap().iter().all(|(_, action)| *action == -0.5));
    let (_, proposed, executed, cause, _) = &notebook.interventions[0];
    assert_eq!((*proposed, *executed, cause.as_str()), (1.0, Some(-0.5), "rejected"));
}

#[test]
fn projections_are_in_the_results_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let identity = Identity { experiment: "e".into(), variant: "v".into(), seed: 0 };
    let run = RunFolder::new(folder.path(), &identity);
    run.create("()", "{}", false).unwrap();
    let mut recorder =
        Recorder::new(run.clone(), identity, vec!["r".into()], 1.0).unwrap().deterministic(false);
    let rejection = Abort { cause: Cause::Rejected, rule: Some(0), score: -1.0 };
    let projection = Projection { kind: ProjectionKind::Qp, iterations: 2, distance: 0.5, rejection };
    let row = Intervention {
        step: 7,
        role: AgentRole::Forward,
        proposed: &PROPOSED,
        executed: Some(&SAFE),
        abort: rejection,
        projection: Some(projection),
        reason: "too low",
    };
    let mut world = World::new(Box::new(Line::new()), None).unwrap();
    let mut stage = Stage { world: &mut world, reset: None };
    recorder.on_intervention(&row, &mut stage).unwrap();
    let infeasible = Abort { cause: Cause::Infeasible, ..rejection };
    recorder
        .on_intervention(
            &Intervention { abort: infeasible, projection: None, executed: None, ..row },
            &mut stage,
        )
        .unwrap();
    let counters = Counters { projections: 3, ..Counters::default() };
    let summary = recorder.finish(&counters, 10, None).unwrap();
    assert_eq!((summary.projections, summary.deterministic), (3, false));
    let table = std::fs::read_to_string(run.path().join("interventions.csv")).unwrap();
    let expected = "\
step,phase,verdict,cause,rule,score,reason,proposed,executed,solver_status,iterations,distance
7,forward,project,rejected,r,-1,too low,0.5 0.5,-0.75 -0.75,solved,2,0.5
7,forward,abort,infeasible,r,-1,too low,0.5 0.5,,infeasible,,
";
    assert_eq!(table, expected);
}
