//! What each call of our learners and success critics costs, through the binary interface: with the sizes that their READMEs name.
//!
//! `cargo xtask bench --bench learners -- td3` measures one of them.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use shield_api::{ActMode, AttemptBatch, Batch, Learner, Setup, Space, Spaces, SuccessCritic};
use shield_runtime::plugin::{Registry, SearchPath, Selection, host};
use shield_tests::plugins_folder;

/// A learner or success critic, where it works and the size of its batches.
struct Case {
    id: &'static str,
    config: &'static str,
    threads: usize,
    spaces: Spaces,
    size: usize,
}

/// The transitions of a batch, the same on every run.
struct Transitions {
    observations: Vec<f32>,
    actions: Vec<f32>,
    rewards: Vec<f32>,
    ones: Vec<f32>,
    zeros: Vec<f32>,
}

impl Transitions {
    fn new(Case { spaces, size, .. }: &Case, members: usize) -> Self {
        let share = |index: usize| (index * 37 % 101) as f32 / 101.0;
        let observations = match &spaces.observation {
            Space::Discrete { n } => {
                (0..size * n).map(|index| f32::from(index % n == index / n % n)).collect()
            }
            Space::Box { low, .. } => (0..size * low.len()).map(share).collect(),
        };
        let actions = match &spaces.action {
            Space::Discrete { n } => (0..*size).map(|row| (row % n) as f32).collect(),
            Space::Box { low, .. } => (0..size * low.len()).map(share).collect(),
        };
        let rewards = (0..*size).map(share).collect();
        Self { observations, actions, rewards, ones: vec![1.0; size * members], zeros: vec![0.0; *size] }
    }

    /// As a success critic is given them: what is rewarded is how much the outcome counts.
    fn attempts(&self) -> AttemptBatch<'_> {
        let (size, none) = (self.rewards.len(), &self.zeros[..]);
        AttemptBatch {
            size,
            observations: &self.observations,
            actions: &self.actions,
            next_observations: &self.observations,
            next_actions: &self.actions,
            successes: none,
            continuations: &self.ones[..size],
            outcomes: &self.ones[..size],
            outcome_weights: &self.rewards,
            masks: &self.ones,
        }
    }

    fn batch(&self) -> Batch<'_> {
        Batch {
            size: self.rewards.len(),
            observations: &self.observations,
            actions: &self.actions,
            rewards: &self.rewards,
            next_observations: &self.observations,
            continuations: &self.ones[..self.rewards.len()],
            masks: &self.ones,
        }
    }
}

/// Measures every call.
fn measure(criterion: &mut Criterion, case: &Case) {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let setup = Setup::with_spaces(0, case.threads, host(), case.spaces.clone());
    let mut learner = registry.learner(&Selection::new(case.id), case.config, &setup).expect("a learner");
    let members = learner.info().members;
    let transitions = Transitions::new(case, members);
    let observation = &transitions.observations[..case.spaces.observation.observation_len()];
    let proposed = &transitions.actions[..case.spaces.action.action_len()];
    let mut action = proposed.to_vec();
    let (mut values, mut gradients) = (vec![0.0; members], vec![0.0; members * proposed.len()]);

    let mut group = criterion
        .benchmark_group(format!("{} {}, {members} members, threads {}", case.id, case.config, case.threads));
    group.bench_function(format!("update, batch {}", case.size), |bencher| {
        bencher.iter(|| learner.update(black_box(&transitions.batch())).expect("an update"));
    });
    for mode in [ActMode::Explore, ActMode::Greedy] {
        group.bench_function(format!("act, {mode:?}"), |bencher| {
            bencher.iter(|| learner.act(black_box(observation), mode, &mut action).expect("an action"));
        });
    }
    group.bench_function("q_values", |bencher| {
        bencher.iter(|| learner.q_values(black_box(observation), proposed, &mut values).expect("values"));
    });
    if matches!(case.spaces.action, Space::Box { .. }) {
        group.bench_function("q_gradients", |bencher| {
            bencher.iter(|| {
                let observation = black_box(observation);
                learner.q_gradients(observation, proposed, &mut values, &mut gradients).expect("gradients");
            });
        });
    }
    group.finish();
}

/// Measures every call of a success critic.
fn measure_critic(criterion: &mut Criterion, case: &Case) {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let setup = Setup::with_spaces(0, case.threads, host(), case.spaces.clone());
    let choice = Selection::new(case.id);
    let mut critic = registry.success_critic(&choice, case.config, &setup).expect("a critic");
    let members = critic.info().members;
    let transitions = Transitions::new(case, members);
    let observation = &transitions.observations[..case.spaces.observation.observation_len()];
    let action = &transitions.actions[..case.spaces.action.action_len()];
    let (mut values, mut gradients) = (vec![0.0; members], vec![0.0; members * action.len()]);

    let mut group = criterion.benchmark_group(format!("{}, {members} members", case.id));
    group.bench_function(format!("update, batch {}", case.size), |bencher| {
        bencher.iter(|| critic.update(black_box(&transitions.attempts())).expect("an update"));
    });
    group.bench_function("probabilities", |bencher| {
        bencher.iter(|| critic.probabilities(black_box(observation), action, &mut values).expect("values"));
    });
    if matches!(case.spaces.action, Space::Box { .. }) {
        group.bench_function("gradients", |bencher| {
            bencher.iter(|| {
                let observation = black_box(observation);
                critic.gradients(observation, action, &mut values, &mut gradients).expect("gradients");
            });
        });
    }
    group.finish();
}

/// The dimensions of the cheetah, with the reset agent's update for comparison: with its own networks, and with those of the critic.
fn success_critics(criterion: &mut Criterion) {
    let spaces = Spaces { observation: Space::unbounded(18), action: Space::uniform(6, -1.0, 1.0) };
    let case = |id, config| Case { id, config, threads: 1, spaces: spaces.clone(), size: 64 };
    measure_critic(criterion, &case("success-critic", ""));
    measure(criterion, &case("ddpg", "(random_steps: 0, actor_hidden: [64, 64], critic_hidden: [64, 64])"));
    let spaces = Spaces { observation: Space::Discrete { n: 25 }, action: Space::Discrete { n: 4 } };
    measure_critic(criterion, &Case { id: "tabular-success", config: "", threads: 1, spaces, size: 16 });
}

/// The dimensions of the cheetah. No first steps are drawn at random, so that `act` asks the network.
fn continuous(criterion: &mut Criterion) {
    let spaces = Spaces { observation: Space::unbounded(18), action: Space::uniform(6, -1.0, 1.0) };
    for id in ["ddpg", "td3"] {
        for threads in [1, 2] {
            measure(
                criterion,
                &Case { id, config: "(random_steps: 0)", threads, spaces: spaces.clone(), size: 64 },
            );
        }
    }
}

fn discrete(criterion: &mut Criterion) {
    let spaces = Spaces { observation: Space::unbounded(3), action: Space::Discrete { n: 3 } };
    measure(criterion, &Case { id: "ddqn", config: "", threads: 1, spaces, size: 8 });
    let spaces = Spaces { observation: Space::Discrete { n: 25 }, action: Space::Discrete { n: 4 } };
    measure(criterion, &Case { id: "tabular-q", config: "", threads: 1, spaces, size: 16 });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = continuous, discrete, success_critics
}
criterion_main!(benches);
