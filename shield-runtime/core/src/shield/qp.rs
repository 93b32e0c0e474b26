//! The nearest action that keeps the rules' linear rows, by quadratic programs.

use std::panic::{AssertUnwindSafe, catch_unwind};

use shield_api::{Error, Result};

use super::{
    explanation::Explanation,
    jury::Jury,
    rejected::{Failure, Rejected},
    rows::RowBuffer,
    solver::{self, Outcome, Program, Solver},
};
use crate::{
    decision::{Cause, Projection, ProjectionKind},
    settings::QpConfig,
};

/// Sequential linearisation: the nearest action that keeps the rules' rows, judged by its true values, and again from there. Of rules under
/// `Any` each branch is a program of its own, and the nearest action wins.
///
/// A program is written in y = √weight · (a − a₀), so that its objective is ½ ‖y‖².
pub(super) struct Qp {
    solver: Box<dyn Solver>,
    max_iterations: u32,
    /// Sets of rules that are enough together.
    programs: Vec<Vec<usize>>,
    /// √weight of each dimension.
    stretch: Vec<f64>,
    low: Vec<f32>,
    high: Vec<f32>,
    /// How far each dimension may move.
    reach: Vec<f64>,
    gradients: Vec<f32>,
    /// The same of the undo probabilities.
    undo_gradients: Vec<f32>,
    rows: RowBuffer,
    /// Bounds of y: those of the action, then those of the slacks.
    lower: Vec<f64>,
    upper: Vec<f64>,
    y: Vec<f64>,
    candidate: Vec<f32>,
}

impl Qp {
    pub fn new(
        config: QpConfig,
        low: &[f32],
        high: &[f32],
        [members, critic_members]: [usize; 2],
        jury: &Jury,
    ) -> Result<Self> {
        let width = low.len();
        let weights = config.weights.unwrap_or_else(|| vec![1.0; width]);
        if weights.len() != width {
            let given = weights.len();
            let message = format!("{given} weights are given, but actions have {width} dimensions");
            return Err(Error::invalid_config(message).in_field("weights"));
        }
        let share = f64::from(config.trust_region.unwrap_or(f32::INFINITY));
        let ranges = low.iter().zip(high).map(|(low, high)| f64::from(*high) - f64::from(*low));
        let reach: Vec<f64> =
            ranges.map(|range| if range == 0.0 { 0.0 } else { share * range / 2.0 }).collect();
        if config.trust_region.is_some() && reach.iter().any(|reach| !reach.is_finite()) {
            let message = "a trust region is a share of the action's range, which has no bounds here";
            return Err(Error::invalid_config(message).in_field("trust_region"));
        }
        let stretch: Vec<f64> = weights.into_iter().map(|weight| f64::from(weight).sqrt()).collect();
        let slacks = jury.priorities().count();
        Ok(Self {
            solver: solver::standard(),
            max_iterations: config.max_iterations,
            programs: jury.programs()?,
            rows: RowBuffer::new(
                config.margin,
                stretch.iter().map(|stretch| stretch.recip()).collect(),
                slacks,
            ),
            stretch,
            low: low.to_vec(),
            high: high.to_vec(),
            reach,
            gradients: vec![f32::NAN; members * width],
            undo_gradients: vec![f32::NAN; critic_members * width],
            lower: vec![0.0; width + slacks],
            upper: vec![f64::INFINITY; width + slacks],
            y: vec![0.0; width + slacks],
            candidate: vec![0.0; width],
        })
    }

    pub fn set_solver(&mut self, solver: Box<dyn Solver>) {
        self.solver = solver;
    }

    pub fn find(&mut self, mut rejected: Rejected<'_, '_>, found: &mut [f32]) -> Result<Projection, Failure> {
        self.enclose(rejected.proposed);
        let mut nearest: Option<(f32, u32)> = None;
        let mut failure: Option<Failure> = None;
        for program in 0..self.programs.len() {
            match self.solve_program(program, &mut rejected) {
                Ok(iterations) => {
                    let distance = self.distance(rejected.proposed);
                    if nearest.is_none_or(|(least, _)| distance < least) {
                        nearest = Some((distance, iterations));
                        found.copy_from_slice(&self.candidate);
                    }
                }
                Err(new) if failure.as_ref().is_none_or(|(cause, _)| !cause.is_failure()) => {
                    failure = Some(new)
                }
                Err(_) => {}
            }
        }
        match (nearest, failure) {
            (Some((distance, iterations)), _) => {
                let rejection = rejected.rejection;
                Ok(Projection { kind: ProjectionKind::Qp, iterations, distance, rejection })
            }
            (None, Some(failure)) => Err(failure),
            (None, None) => unreachable!("there is at least one program"),
        }
    }

    /// Looks for a candidate that keeps one set of rules to first order, and that all rules together allow; returns the linearisations.
    fn solve_program(&mut self, program: usize, rejected: &mut Rejected<'_, '_>) -> Result<u32, Failure> {
        let Rejected { jury, agents, moment, proposed, clock, .. } = rejected;
        self.candidate.copy_from_slice(proposed);
        let mut why = Explanation::new();
        for iterations in 1..=self.max_iterations {
            if clock.is_late() {
                return Err((Cause::Deadline, "no time is left".into()));
            }
            self.rows.start(proposed);
            jury.differentiate(agents, moment, &self.candidate, &mut self.gradients)
                .and_then(|()| {
                    let gradients = &mut self.undo_gradients;
                    jury.differentiate_probabilities(agents, moment, &self.candidate, gradients)
                })
                .map_err(|error| (Cause::GradientsFailed, error.to_string()))?;
            let (rules, gradients) = (&self.programs[program], [&self.gradients[..], &self.undo_gradients]);
            jury.linearise(rules, moment, &self.candidate, gradients, &mut self.rows)
                .map_err(|(cause, error)| (cause, error.to_string()))?;
            self.step(proposed)?;
            match jury.judge(agents, moment, &self.candidate, &mut why) {
                Ok(()) => return Ok(iterations),
                Err(abort) if abort.cause == Cause::Rejected => {}
                Err(abort) => return Err((abort.cause, why.text().to_owned())),
            }
        }
        let times = self.max_iterations;
        Err((Cause::StillRejected, format!("after {times} linearisations {}", why.text())))
    }

    /// The box of y around the proposed action: the action space and the trust region.
    fn enclose(&mut self, proposed: &[f32]) {
        for (index, value) in proposed.iter().copied().map(f64::from).enumerate() {
            let (reach, stretch) = (self.reach[index], self.stretch[index]);
            self.lower[index] = (f64::from(self.low[index]) - value).max(-reach) * stretch;
            self.upper[index] = (f64::from(self.high[index]) - value).min(reach) * stretch;
        }
    }

    /// Solves the program of the present rows and writes its action.
    fn step(&mut self, proposed: &[f32]) -> Result<(), Failure> {
        if let Some(refused) = &self.rows.refused {
            return Err((Cause::RowsFailed, refused.to_string()));
        }
        if self.rows.is_impossible {
            return Err((Cause::Infeasible, "a row fails that no action changes".into()));
        }
        let program = Program {
            rows: &self.rows.coefficients,
            bounds: &self.rows.bounds,
            lower: &self.lower,
            upper: &self.upper,
        };
        // Whatever a solver forgets to write is no action.
        self.y.fill(f64::NAN);
        let (solver, y) = (&mut self.solver, &mut self.y);
        let outcome = catch_unwind(AssertUnwindSafe(|| solver.solve(&program, y)))
            .map_err(|_| (Cause::SolverPanicked, "the solver panicked".into()))?;
        match outcome {
            Outcome::Solved => {}
            Outcome::Infeasible => return Err((Cause::Infeasible, "no action keeps all rows".into())),
            Outcome::NotConverged => {
                return Err((Cause::NotConverged, "the solver found no solution".into()));
            }
        }
        for (value, (lower, upper)) in y.iter_mut().zip(self.lower.iter().zip(&self.upper)) {
            // Not `f64::max`, which would turn NaN into a bound.
            *value = value.clamp(*lower, *upper);
        }
        if !program.keeps_rows(y) {
            return Err((Cause::NotConverged, "the solver's solution does not keep the rows".into()));
        }
        for (index, value) in self.candidate.iter_mut().enumerate() {
            let target = (f64::from(proposed[index]) + self.y[index] / self.stretch[index]) as f32;
            *value = target.clamp(self.low[index], self.high[index]);
        }
        match self.candidate.iter().all(|value| value.is_finite()) {
            true => Ok(()),
            false => Err((Cause::NotConverged, "the solution is beyond every finite action".into())),
        }
    }

    /// √ Σ weight · movement² of the candidate.
    fn distance(&self, proposed: &[f32]) -> f32 {
        let moved = self.candidate.iter().zip(proposed).map(|(new, old)| f64::from(*new) - f64::from(*old));
        let squared = moved.zip(&self.stretch).map(|(step, stretch)| (step * stretch).powi(2));
        squared.sum::<f64>().sqrt() as f32
    }
}
