//! What a projection costs beyond the valuations and gradients: decisions of a shield whose ensemble is free.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark")]

use std::{cell::Cell, hint::black_box, time::Instant};

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    AbortRule, ActMode, Batch, Checkpoint, Learner, LearnerInfo, Needs, Reason, Result, Rows, RuleContext,
    RuleVerdict, Space, Spaces,
};
use shield_runtime::{
    experiment::{ProjectionConfig, QpConfig},
    shield::{
        Agents, Ladder, LadderSettings, Moment,
        solver::{InteriorPoint, OneRow, Program, Solver, Staged},
    },
};

const WIDTH: usize = 7;

/// Members that are linear in the action: the cost of valuing is next to nothing.
struct Linear(Vec<f32>);

impl Checkpoint for Linear {}

impl Learner for Linear {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: self.0.len() / WIDTH, discount: 0.99 }
    }

    fn act(&mut self, _: &[f32], _: ActMode, action: &mut [f32]) -> Result<()> {
        action.fill(0.0);
        Ok(())
    }

    fn q_values(&mut self, _: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        for (value, slopes) in values.iter_mut().zip(self.0.chunks(WIDTH)) {
            *value = slopes.iter().zip(action).map(|(slope, action)| slope * action).sum();
        }
        Ok(())
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        gradients.copy_from_slice(&self.0);
        self.q_values(observation, action, values)
    }

    fn update(&mut self, _: &Batch<'_>) -> Result<()> {
        Ok(())
    }
}

/// Every member above 0: a row each.
struct Pessimistic;

impl Checkpoint for Pessimistic {}

impl AbortRule for Pessimistic {
    fn needs(&self) -> Needs {
        Needs { values: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
        let least = context.values.iter().copied().fold(f32::INFINITY, f32::min);
        Ok(RuleVerdict::from_safe(least >= 0.0, least))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        let mut row = [0.0; WIDTH];
        for slopes in gradients.chunks(WIDTH).take(context.values.len()) {
            row.iter_mut().zip(slopes).for_each(|(target, slope)| *target = -slope);
            rows.push(&row, 0.0)?;
        }
        Ok(())
    }
}

/// Allows only the third projected action, whatever its value: three linearisations a decision.
struct Hesitant(Cell<u32>);

impl Checkpoint for Hesitant {}

impl AbortRule for Hesitant {
    fn needs(&self) -> Needs {
        Needs { values: true, ..Needs::default() }
    }

    fn evaluate(&self, _: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
        self.0.set(self.0.get() + 1);
        Ok(RuleVerdict::from_safe(self.0.get().is_multiple_of(4), 0.0))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        Pessimistic.linearise(context, gradients, rows)
    }
}

/// Percentiles, which criterion does not give: 20 rows, three linearisations, another problem each time. The best of five decisions on one
/// problem leaves out what other programs on the machine cost.
fn percentiles(_: &mut Criterion) {
    let mut random = Pcg64::seed_from_u64(7);
    let (mut single, mut best) = (Vec::new(), Vec::new());
    let (first, _) = members(20, &mut random);
    let qp = ProjectionConfig::Qp(QpConfig::default());
    let mut shield = shield_over(Box::new(Hesitant(Cell::new(0))), &first, Some(qp));
    let moment = Moment { step: 0, observation: &[0.0], previous: None };
    for _ in 0..4_000 {
        let (mut agent, proposed) = members(20, &mut random);
        let mut times = Vec::new();
        for _ in 0..5 {
            let mut action = proposed.clone();
            let start = Instant::now();
            let decision = black_box(shield.filter(
                Agents { reset: &mut agent, forward: None, success: None },
                &moment,
                &mut action,
            ));
            if decision.projection().is_some_and(|projection| projection.iterations == 3) {
                times.push(start.elapsed());
            }
        }
        best.extend(times.iter().min());
        single.append(&mut times);
    }
    for (name, mut times) in [("each", single), ("best of five", best)] {
        times.sort_unstable();
        let at = |share: f64| times[(times.len() as f64 * share) as usize];
        let (p50, p99) = (at(0.5), at(0.99));
        println!("projected, 20 rows, 3 linearisations, {name}: p50 {p50:?}, p99 {p99:?}");
    }
}

fn shield_over(rule: Box<dyn AbortRule>, agent: &Linear, projection: Option<ProjectionConfig>) -> Ladder {
    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(WIDTH, -1.0, 1.0) };
    let settings = LadderSettings { spaces, warm_up_steps: 0, fallback_action: vec![0.0; WIDTH] };
    let shield = Ladder::new(vec![rule], agent, settings).unwrap();
    projection.into_iter().fold(shield, |shield, config| shield.with_projection(config).unwrap())
}

/// Slopes around a common direction, so that some action suits all members, and a proposal that suits few.
fn members(count: usize, random: &mut Pcg64) -> (Linear, Vec<f32>) {
    let common: Vec<f32> = (0..WIDTH).map(|_| random.random_range(-1.0..1.0)).collect();
    let slopes = (0..count).flat_map(|_| common.clone()).map(|slope| slope + random.random_range(-0.5..0.5));
    let proposed = common.iter().map(|slope| -0.5 * slope).collect();
    (Linear(slopes.collect()), proposed)
}

fn decisions(criterion: &mut Criterion) {
    for count in [1, 20] {
        let mut random = Pcg64::seed_from_u64(count);
        let (mut agent, proposed) = members(count as usize, &mut random);
        let mut projecting =
            shield_over(Box::new(Pessimistic), &agent, Some(ProjectionConfig::Qp(QpConfig::default())));
        let mut plain = shield_over(Box::new(Pessimistic), &agent, None);
        let moment = Moment { step: 0, observation: &[0.0], previous: None };
        let mut time = |name: &str, shield: &mut Ladder, action: &[f32]| {
            criterion.bench_function(&format!("{name}, {count} rows"), |bencher| {
                bencher.iter_batched_ref(
                    || action.to_vec(),
                    |action| {
                        black_box(shield.filter(
                            Agents { reset: &mut agent, forward: None, success: None },
                            &moment,
                            action,
                        ))
                    },
                    BatchSize::SmallInput,
                );
            });
        };
        time("allowed", &mut plain, &[0.0; WIDTH]);
        time("projected", &mut projecting, &proposed);
    }
}

fn solvers(criterion: &mut Criterion) {
    for count in [1, 5, 20] {
        let mut random = Pcg64::seed_from_u64(count as u64);
        let (agent, proposed) = members(count, &mut random);
        let mut rows = Vec::new();
        let mut bounds = Vec::new();
        for slopes in agent.0.chunks(WIDTH) {
            let norm = slopes.iter().map(|slope| slope * slope).sum::<f32>().sqrt();
            let here: f32 = slopes.iter().zip(&proposed).map(|(slope, action)| slope * action).sum();
            rows.extend(slopes.iter().map(|slope| f64::from(-slope / norm)));
            bounds.push(f64::from(here / norm));
        }
        let lower: Vec<f64> = proposed.iter().map(|action| f64::from(-1.0 - action)).collect();
        let upper: Vec<f64> = proposed.iter().map(|action| f64::from(1.0 - action)).collect();
        let program = Program { rows: &rows, bounds: &bounds, lower: &lower, upper: &upper };
        let mut y = vec![0.0; WIDTH];
        let mut time = |name: &str, solver: &mut dyn Solver| {
            criterion.bench_function(&format!("solver {name}, {count} rows"), |bencher| {
                bencher.iter(|| black_box(solver.solve(&program, &mut y)));
            });
        };
        time("interior point", &mut InteriorPoint::default());
        time("staged", &mut Staged::new(InteriorPoint::default()));
        if count == 1 {
            time("closed form", &mut OneRow::default());
        }
    }
}

criterion_group!(benches, percentiles, decisions, solvers);
criterion_main!(benches);
