//! The projection's solvers against independent ones, on many random programs: ill-conditioned, degenerate and infeasible ones too.
//!
//! `cargo xtask test --long` tries a million of them.
#![allow(clippy::unwrap_used, reason = "a test")]

use ndarray::{Array1, Array2};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use shield_api::{
    AbortRule, ActMode, Batch, Checkpoint, Learner, LearnerInfo, Needs, Reason, Result, Rows, RuleContext,
    RuleVerdict, Space, Spaces,
};
use shield_runtime::{
    experiment::{ProjectionConfig, QpConfig},
    shield::{
        Agents, Ladder, LadderSettings, Moment, RuleTree,
        solver::{InteriorPoint, OneRow, Outcome, Program, Solver, Staged},
    },
};

/// Programs per property test.
const PROGRAMS: u64 = 20_000;

/// So many programs, or as many as `cargo xtask test --long` asks for.
fn programs(usual: u64) -> u64 {
    std::env::var("SHIELD_TEST_PROGRAMS").map_or(usual, |number| number.parse().unwrap())
}

/// A program that owns its figures.
#[derive(Debug, Clone, Default)]
struct Owned {
    rows: Vec<f64>,
    bounds: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl Owned {
    fn program(&self) -> Program<'_> {
        Program { rows: &self.rows, bounds: &self.bounds, lower: &self.lower, upper: &self.upper }
    }

    fn push(&mut self, row: &[f64], bound: f64) {
        let norm = row.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
        if norm > 0.0 {
            self.rows.extend(row.iter().map(|slope| slope / norm));
            self.bounds.push(bound);
        }
    }

    /// Every constraint, the box's too, as (coefficients, bound).
    fn constraints(&self) -> Vec<(Vec<f64>, f64)> {
        let (program, width) = (self.program(), self.lower.len());
        let rows = (0..self.bounds.len()).map(|index| (program.row(index).to_vec(), self.bounds[index]));
        let sides = (0..width).flat_map(|dimension| {
            [(1.0, self.upper[dimension]), (-1.0, -self.lower[dimension])].map(|(sign, bound)| {
                let mut row = vec![0.0; width];
                row[dimension] = sign;
                (row, bound)
            })
        });
        rows.chain(sides.filter(|(_, bound)| bound.is_finite())).collect()
    }

    fn random(random: &mut Pcg64, widths: std::ops::RangeInclusive<usize>, most_rows: usize) -> Self {
        let width = random.random_range(widths);
        let mut program = Self::default();
        for _ in 0..width {
            let half = match random.random_range(0..8) {
                0 => 0.0,
                1 => f64::INFINITY,
                _ => 2.0,
            };
            program.lower.push(-half * random.random::<f64>());
            program.upper.push(half * random.random::<f64>());
        }
        // ∞ · 0 is no bound.
        program.lower.iter_mut().chain(&mut program.upper).for_each(|bound| {
            if bound.is_nan() {
                *bound = 0.0;
            }
        });
        let is_ill = random.random_bool(0.2);
        let stretch: Vec<f64> = (0..width)
            .map(|_| if is_ill { 10f64.powf(random.random_range(-4.0..4.0)) } else { 1.0 })
            .collect();
        let mut row = vec![0.0; width];
        for _ in 0..random.random_range(0..=most_rows) {
            match random.random_range(0..10) {
                // The same again, its opposite, or a neighbour, from the row before.
                0 => {}
                1 => row.iter_mut().for_each(|slope| *slope = -*slope),
                2 => row[0] += 1e-6,
                3 => {
                    row.fill(0.0);
                    row[random.random_range(0..width)] = 1.0;
                }
                _ => {
                    for (slope, stretch) in row.iter_mut().zip(&stretch) {
                        let normal: f64 = StandardNormal.sample(random);
                        *slope = normal * stretch;
                    }
                }
            }
            let normal: f64 = StandardNormal.sample(random);
            let bound = match random.random_range(0..6) {
                0 => 0.0,
                1 => normal.abs() * 0.1,
                _ => normal * 0.4 + 0.4,
            };
            program.push(&row, bound);
        }
        program
    }
}

/// As the host does it: clamped, and a solution outside the rows is none.
fn solve(solver: &mut dyn Solver, program: &Owned) -> (Outcome, Vec<f64>) {
    let mut y = vec![f64::NAN; program.lower.len()];
    let outcome = solver.solve(&program.program(), &mut y);
    for (value, (lower, upper)) in y.iter_mut().zip(program.lower.iter().zip(&program.upper)) {
        *value = value.clamp(*lower, *upper);
    }
    let is_kept = outcome != Outcome::Solved || program.program().keeps_rows(&y);
    (if is_kept { outcome } else { Outcome::NotConverged }, y)
}

fn norm(y: &[f64]) -> f64 {
    y.iter().map(|value| value * value).sum::<f64>().sqrt()
}

/// By how much the worst constraint fails; negative inside.
fn violation(constraints: &[(Vec<f64>, f64)], y: &[f64]) -> f64 {
    let excess = |(row, bound): &(Vec<f64>, f64)| {
        row.iter().zip(y).map(|(slope, value)| slope * value).sum::<f64>() - bound
    };
    constraints.iter().map(excess).fold(f64::NEG_INFINITY, f64::max)
}

/// The least-distance problem by non-negative least squares (Lawson and Hanson 1974, chapter 23), with another author's solver. `None` where
/// it finds nothing that keeps the constraints.
fn least_distance(program: &Owned) -> Option<Vec<f64>> {
    let (constraints, width) = (program.constraints(), program.lower.len());
    if constraints.is_empty() {
        return Some(vec![0.0; width]);
    }
    // G y ≥ h with G = −rows and h = −bounds; E = [Gᵀ; hᵀ], f = (0, …, 0, 1).
    let matrix = Array2::from_shape_fn((width + 1, constraints.len()), |(line, constraint)| {
        let (row, bound) = &constraints[constraint];
        if line < width { -row[line] } else { -bound }
    });
    let mut target = Array1::zeros(width + 1);
    target[width] = 1.0;
    // On some degenerate programs that crate gives up with a panic.
    let solved = std::panic::catch_unwind(|| nnls::nnls(matrix.view(), target.view()));
    let (multipliers, _) = solved.ok()?;
    let residual = matrix.dot(&multipliers) - target;
    let y: Vec<f64> = (0..width).map(|index| -residual[index] / residual[width]).collect();
    let is_solution = y.iter().all(|value| value.is_finite()) && violation(&constraints, &y) < 1e-9;
    is_solution.then_some(y)
}

/// The best of everything that can be a solution in two dimensions: the origin, its foot on each line, every crossing of two lines.
fn brute_force(program: &Owned) -> Option<Vec<f64>> {
    let constraints = program.constraints();
    let mut candidates = vec![vec![0.0, 0.0]];
    for (index, (one, bound)) in constraints.iter().enumerate() {
        candidates.push(vec![one[0] * bound, one[1] * bound]);
        for (other, other_bound) in &constraints[..index] {
            let determinant = one[0] * other[1] - one[1] * other[0];
            if determinant.abs() > 1e-12 {
                candidates.push(vec![
                    (bound * other[1] - one[1] * other_bound) / determinant,
                    (one[0] * other_bound - bound * other[0]) / determinant,
                ]);
            }
        }
    }
    candidates.retain(|y| violation(&constraints, y) < 1e-9);
    candidates.into_iter().min_by(|left, right| norm(left).total_cmp(&norm(right)))
}

/// What many programs came to.
#[derive(Debug, Default)]
struct Tally {
    solved: u64,
    infeasible: u64,
    not_converged: u64,
    compared: u64,
    /// Nearer than the oracle's, which the tolerance of the rows allows.
    nearer: u64,
    /// Called infeasible or given up, although the oracle has a solution.
    missed: u64,
}

/// Counts one program; panics where a solution breaks a constraint, or is not the nearest.
fn compare(
    tally: &mut Tally,
    case: u64,
    program: &Owned,
    found: &(Outcome, Vec<f64>),
    oracle: Option<Vec<f64>>,
) {
    let (outcome, y) = found;
    if *outcome != Outcome::Solved {
        tally.missed += u64::from(oracle.is_some());
        match outcome {
            Outcome::Infeasible => tally.infeasible += 1,
            _ => tally.not_converged += 1,
        }
        return;
    }
    tally.solved += 1;
    let excess = violation(&program.constraints(), y);
    assert!(excess < 1e-6, "program {case} is violated by {excess}: {program:?}, {y:?}");
    if let Some(nearest) = oracle {
        tally.compared += 1;
        let (distance, expected) = (norm(y), norm(&nearest));
        let error = (distance - expected) / expected.max(1.0);
        assert!(error < 1e-5, "program {case}: distance {distance}, not {expected}: {program:?}");
        // Between rows that are almost parallel, what a row may be exceeded by is a long way.
        tally.nearer += u64::from(error < -1e-5);
    }
}

#[test]
fn solutions_keep_every_row_and_are_the_nearest() {
    let programs = programs(PROGRAMS);
    let mut random = Pcg64::seed_from_u64(1);
    let mut solver = Staged::new(InteriorPoint::default());
    let mut tally = Tally::default();
    for case in 0..programs {
        let program = Owned::random(&mut random, 1..=12, 40);
        compare(&mut tally, case, &program, &solve(&mut solver, &program), least_distance(&program));
    }
    // Enough of each kind that the test says something; and hardly a solution is missed.
    let Tally { solved, infeasible, not_converged, compared, missed, nearer } = tally;
    assert!(nearer * 100_000 <= compared, "{tally:?}");
    assert!(compared > programs / 10 && infeasible > programs / 10, "{tally:?}");
    assert!(missed * 100_000 <= solved && not_converged * 40 <= solved + infeasible, "{tally:?}");
}

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

#[test]
fn solutions_in_the_plane_match_brute_force() {
    let mut random = Pcg64::seed_from_u64(2);
    let mut solver = Staged::new(InteriorPoint::default());
    let mut tally = Tally::default();
    for case in 0..PROGRAMS {
        let program = Owned::random(&mut random, 2..=2, 8);
        compare(&mut tally, case, &program, &solve(&mut solver, &program), brute_force(&program));
    }
    assert!(tally.compared > PROGRAMS / 4 && tally.infeasible > PROGRAMS / 20, "{tally:?}");
    assert!(tally.missed * 500 <= tally.solved && tally.nearer * 5_000 <= tally.compared, "{tally:?}");
}

#[test]
fn the_closed_form_of_one_row_matches_the_interior_point() {
    let mut random = Pcg64::seed_from_u64(3);
    let (mut closed, mut interior) = (OneRow::default(), InteriorPoint::default());
    let (mut solved, mut infeasible) = (0, 0);
    for case in 0..PROGRAMS / 4 {
        let mut program = Owned::random(&mut random, 1..=12, 1);
        while program.bounds.is_empty() {
            program = Owned::random(&mut random, 1..=12, 1);
        }
        let (exact, iterated) = (solve(&mut closed, &program), solve(&mut interior, &program));
        match (exact.0, iterated.0) {
            (Outcome::Solved, Outcome::Solved) => {
                solved += 1;
                let (distance, expected) = (norm(&exact.1), norm(&iterated.1));
                // The iterated one may be a little nearer, by the tolerance of the row.
                let error = (distance - expected) / expected.max(1.0);
                assert!((-1e-4..1e-5).contains(&error), "program {case}: {program:?} {exact:?} {iterated:?}");
            }
            (one, other) => {
                infeasible += u64::from(one == Outcome::Infeasible);
                // Beside the boundary of what is feasible the iterated solution may say something else.
                assert!(
                    one == other || other == Outcome::NotConverged,
                    "program {case}: {program:?} {exact:?} {iterated:?}"
                );
            }
        }
    }
    assert!(
        solved > PROGRAMS / 8 && infeasible > PROGRAMS / 1000,
        "{solved} solved, {infeasible} infeasible"
    );
}

#[test]
fn a_kept_workspace_gives_the_solutions_of_a_fresh_one() {
    let mut random = Pcg64::seed_from_u64(4);
    let mut kept = InteriorPoint::default();
    for case in 0..500 {
        // Three programs of one shape in a row, then another shape.
        let rows = 2 + case / 3 % 5;
        let mut program = Owned { lower: vec![-1.0; 3], upper: vec![1.0; 3], ..Owned::default() };
        if case / 15 % 2 == 1 {
            program.upper[1] = f64::INFINITY;
        }
        for _ in 0..rows {
            let row: Vec<f64> = (0..3).map(|_| random.random_range(-1.0..1.0)).collect();
            program.push(&row, random.random_range(-0.4..0.2));
        }
        let (again, fresh) = (solve(&mut kept, &program), solve(&mut InteriorPoint::default(), &program));
        assert_eq!(again.0, fresh.0, "program {case}: {program:?}");
        if fresh.0 == Outcome::Solved {
            let apart: f64 = again.1.iter().zip(&fresh.1).map(|(one, other)| (one - other).abs()).sum();
            assert!(apart < 1e-5, "program {case}: {again:?}, {fresh:?}");
        }
    }
}

#[test]
fn earlier_programs_change_no_bit_of_a_solution() {
    let mut random = Pcg64::seed_from_u64(11);
    let mut kept = InteriorPoint::default();
    for index in 0..PROGRAMS / 20 {
        // Mostly of one shape, so that the workspace is used again.
        let mut program = Owned { lower: vec![-1.0; 3], upper: vec![1.0; 3], ..Owned::default() };
        for _ in 0..if index % 50 == 0 { 3 } else { 2 } {
            let row: Vec<f64> = (0..3).map(|_| StandardNormal.sample(&mut random)).collect();
            program.push(&row, -10f64.powf(random.random_range(-3.0..0.0)));
        }
        let (mut after_others, mut alone) = ([0.0; 3], [0.0; 3]);
        let outcomes = [
            kept.solve(&program.program(), &mut after_others),
            InteriorPoint::default().solve(&program.program(), &mut alone),
        ];
        assert_eq!(outcomes[0], outcomes[1], "{program:?}");
        assert_eq!(after_others.map(f64::to_bits), alone.map(f64::to_bits), "{program:?}");
    }
}
