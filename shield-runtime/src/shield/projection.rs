//! What is tried with a rejected action before it is aborted.

use std::panic::{AssertUnwindSafe, catch_unwind};

use shield_api::{ActMode, Learner, Result, Space};

use super::{
    Moment,
    clock::Clock,
    explanation::Explanation,
    jury::Jury,
    rows::RowBuffer,
    solver::{InteriorPoint, Outcome, Program, Solver, Staged},
};
use crate::{
    decision::{Abort, Cause, Projection, ProjectionKind},
    experiment::{ProjectionConfig, QpConfig},
};

/// A rejected action and whom to ask about another one.
pub(super) struct Attempt<'a> {
    pub jury: &'a mut Jury,
    pub reset_agent: &'a mut dyn Learner,
    pub moment: &'a Moment<'a>,
    pub proposed: &'a [f32],
    pub rejection: Abort,
    pub clock: Clock,
}

/// Why there is no other action: the cause, and what there is to say about it.
pub(super) type Failure = (Cause, String);

/// Finds another action.
pub(super) enum Projector {
    Qp(Box<Qp>),
    Replace,
}

impl Projector {
    pub fn new(config: ProjectionConfig, action_space: &Space, members: usize) -> Result<Self> {
        Ok(match config {
            ProjectionConfig::Qp(config) => Self::Qp(Box::new(Qp::new(config, action_space, members)?)),
            ProjectionConfig::Replace => Self::Replace,
        })
    }

    /// Writes an action that every rule allows into `found`.
    pub fn find(&mut self, attempt: Attempt<'_>, found: &mut [f32]) -> Result<Projection, Failure> {
        match self {
            Self::Qp(qp) => qp.find(attempt, found),
            Self::Replace => replace(attempt, found),
        }
    }
}

/// The reset agent's greedy action, if every rule allows it: it knows best how to undo, and a step of it keeps the episode alive.
fn replace(attempt: Attempt<'_>, found: &mut [f32]) -> Result<Projection, Failure> {
    let Attempt { jury, reset_agent, moment, proposed, rejection, .. } = attempt;
    reset_agent
        .act(moment.observation, ActMode::Greedy, found)
        .map_err(|error| (Cause::ValuesFailed, error.to_string()))?;
    let mut why = Explanation::new();
    jury.judge(reset_agent, moment, found, &mut why).map_err(|abort| match abort.cause {
        Cause::Rejected => (Cause::StillRejected, why.text().to_owned()),
        cause => (cause, why.text().to_owned()),
    })?;
    let squared = found.iter().zip(proposed).map(|(new, old)| (f64::from(*new) - f64::from(*old)).powi(2));
    let distance = squared.sum::<f64>().sqrt() as f32;
    Ok(Projection { kind: ProjectionKind::Replace, iterations: 0, distance, rejection })
}

/// Sequential linearisation: the nearest action that keeps the rules' rows, judged by its true values, and again from there.
///
/// The program is written in y = √weight · (a − a₀), so that its objective is ½ ‖y‖².
pub(super) struct Qp {
    solver: Box<dyn Solver>,
    max_iterations: u32,
    weights: Vec<f64>,
    low: Vec<f32>,
    high: Vec<f32>,
    /// How far each dimension may move.
    reach: Vec<f64>,
    gradients: Vec<f32>,
    rows: RowBuffer,
    lower: Vec<f64>,
    upper: Vec<f64>,
    y: Vec<f64>,
}

impl Qp {
    fn new(config: QpConfig, action_space: &Space, members: usize) -> Result<Self> {
        let Space::Box { low, high } = action_space else {
            return Err(shield_api::Error::invalid_config(
                "the environment's actions are discrete, so that none is near another: `Qp` needs a box; `Replace` works here",
            ));
        };
        let width = low.len();
        let weights = config.weights.unwrap_or_else(|| vec![1.0; width]);
        if weights.len() != width {
            let given = weights.len();
            return Err(shield_api::Error::invalid_config(format!(
                "{given} weights are given, but actions have {width} dimensions"
            )));
        }
        let share = f64::from(config.trust_region.unwrap_or(f32::INFINITY));
        let ranges = low.iter().zip(high).map(|(low, high)| f64::from(*high) - f64::from(*low));
        let reach: Vec<f64> =
            ranges.map(|range| if range == 0.0 { 0.0 } else { share * range / 2.0 }).collect();
        if config.trust_region.is_some() && reach.iter().any(|reach| !reach.is_finite()) {
            return Err(shield_api::Error::invalid_config(
                "a trust region is a share of the action's range, which has no bounds here",
            ));
        }
        let weights: Vec<f64> = weights.into_iter().map(f64::from).collect();
        let scale = weights.iter().map(|weight| weight.sqrt().recip()).collect();
        Ok(Self {
            solver: Box::new(Staged::new(InteriorPoint::default())),
            max_iterations: config.max_iterations,
            rows: RowBuffer::new(config.margin, scale),
            weights,
            low: low.clone(),
            high: high.clone(),
            reach,
            gradients: vec![f32::NAN; members * width],
            lower: vec![0.0; width],
            upper: vec![0.0; width],
            y: vec![0.0; width],
        })
    }

    pub fn set_solver(&mut self, solver: Box<dyn Solver>) {
        self.solver = solver;
    }

    fn find(&mut self, attempt: Attempt<'_>, found: &mut [f32]) -> Result<Projection, Failure> {
        let Attempt { jury, reset_agent, moment, proposed, rejection, clock } = attempt;
        self.enclose(proposed);
        found.copy_from_slice(proposed);
        let mut why = Explanation::new();
        for iterations in 1..=self.max_iterations {
            if clock.is_late() {
                return Err((Cause::Deadline, "no time is left".into()));
            }
            self.rows.start(proposed);
            jury.linearise(reset_agent, moment, found, &mut self.gradients, &mut self.rows)
                .map_err(|(cause, error)| (cause, error.to_string()))?;
            self.step(proposed, found)?;
            match jury.judge(reset_agent, moment, found, &mut why) {
                Ok(()) => {
                    let distance = self.distance(proposed, found);
                    return Ok(Projection { kind: ProjectionKind::Qp, iterations, distance, rejection });
                }
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
            let (reach, stretch) = (self.reach[index], self.weights[index].sqrt());
            self.lower[index] = (f64::from(self.low[index]) - value).max(-reach) * stretch;
            self.upper[index] = (f64::from(self.high[index]) - value).min(reach) * stretch;
        }
    }

    /// Solves the program of the present rows and writes its action.
    fn step(&mut self, proposed: &[f32], found: &mut [f32]) -> Result<(), Failure> {
        if let Some(refused) = &self.rows.refused {
            return Err((Cause::RowsFailed, refused.to_string()));
        }
        if self.rows.is_impossible {
            return Err((Cause::Infeasible, "a row fails that no action changes".into()));
        }
        let rows = &self.rows;
        let program = Program {
            rows: &rows.coefficients,
            bounds: &rows.bounds,
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
        for (index, value) in found.iter_mut().enumerate() {
            let step = self.y[index] / self.weights[index].sqrt();
            let target = (f64::from(proposed[index]) + step) as f32;
            *value = target.clamp(self.low[index], self.high[index]);
        }
        match found.iter().all(|value| value.is_finite()) {
            true => Ok(()),
            false => Err((Cause::NotConverged, "the solution is beyond every finite action".into())),
        }
    }

    /// √ Σ weight · movement².
    fn distance(&self, proposed: &[f32], found: &[f32]) -> f32 {
        let moved = found.iter().zip(proposed).map(|(new, old)| f64::from(*new) - f64::from(*old));
        moved.zip(&self.weights).map(|(step, weight)| weight * step * step).sum::<f64>().sqrt() as f32
    }
}
