//! What a step costs: the filter with 20 critics against their bare valuation, and the environment against raw `mj_step`.

use std::{
    fs,
    hint::black_box,
    time::{Duration, Instant},
};

use criterion::{Criterion, criterion_group, criterion_main};
use mujoco_rs::prelude::{MjData, MjModel};
use shield_api::{Environment, Learner, Setup, SuccessCritic};
use shield_runtime::{
    lanes::Lanes,
    plugin::{LoadedEnvironment, LoadedLearner, Registry, SearchPath, Selection, host},
    shield::{Agents, Ladder, LadderSettings, Moment, RuleTree},
    world::{Stepped, World},
};
use shield_tests::{plugins_folder, workspace};

/// Control steps of a round.
const EPISODE: u32 = 100;

fn registry() -> Registry {
    Registry::scan(&SearchPath::new([plugins_folder()]))
}

fn environment(id: &str) -> LoadedEnvironment {
    registry().environment(&Selection::new(id), "", &Setup::new(0, 1, host())).expect("an environment")
}

/// One allowed decision with 20 critics 400-300, and the valuation that it cannot do without.
fn filter(criterion: &mut Criterion) {
    let spaces = environment("mujoco/cliff-cheetah").spec().spaces;
    let mut group = criterion.benchmark_group("20 critics 400-300");
    for threads in [1, 2] {
        let setup = Setup::with_spaces(0, threads, host(), spaces.clone());
        let mut agent: LoadedLearner =
            registry().learner(&Selection::new("ddpg"), "", &setup).expect("a learner");
        let observation = vec![0.1; spaces.observation_len()];
        let mut action = vec![0.2; spaces.action_len()];
        let mut values = vec![0.0; agent.info().members];
        group.bench_function(format!("bare valuation, threads {threads}"), |bencher| {
            bencher.iter(|| agent.q_values(black_box(&observation), black_box(&action), &mut values));
        });
        let rule = registry()
            .abort_rule(&Selection::new("ensemble-threshold"), "(q_min: -1e6)", &setup)
            .expect("a rule");
        let fallback_action = vec![0.0; spaces.action_len()];
        let settings = LadderSettings { spaces: spaces.clone(), warm_up_steps: 0, fallback_action };
        let mut shield = Ladder::new(RuleTree::Rule(Box::new(rule)), &agent, settings).expect("a shield");
        let moment = Moment { step: 0, observation: &observation, previous: None };
        group.bench_function(format!("allowed decision, threads {threads}"), |bencher| {
            bencher.iter(|| {
                assert!(
                    shield
                        .filter(
                            Agents { reset: &mut agent, forward: None, success: None },
                            black_box(&moment),
                            &mut action
                        )
                        .abort()
                        .is_none()
                )
            });
        });
    }
    group.finish();
}

/// One allowed decision by undo probabilities with a success critic of 20 members, and the valuation that it cannot do without.
fn undo(criterion: &mut Criterion) {
    let spaces = environment("mujoco/cliff-cheetah").spec().spaces;
    let small = "(critics: 1, actor_hidden: [64, 64], critic_hidden: [64, 64])";
    let mut group = criterion.benchmark_group("success critic");
    for (size, hidden) in [("20 members 400-300", "[400, 300]"), ("20 members 64-64", "[64, 64]")] {
        let setup = Setup::with_spaces(0, 1, host(), spaces.clone());
        let mut agent = registry().learner(&Selection::new("ddpg"), small, &setup).expect("a learner");
        let config = format!("(members: 20, hidden: {hidden})");
        let mut critic =
            registry().success_critic(&Selection::new("success-critic"), &config, &setup).expect("a critic");
        let observation = vec![0.1; spaces.observation_len()];
        let mut action = vec![0.2; spaces.action_len()];
        let mut probabilities = vec![0.0; critic.info().members];
        let rule = registry()
            .abort_rule(&Selection::new("undo-probability"), "(initial_threshold: 0.0)", &setup)
            .expect("a rule");
        let fallback_action = vec![0.0; spaces.action_len()];
        let settings = LadderSettings { spaces: spaces.clone(), warm_up_steps: 0, fallback_action };
        let mut shield = Ladder::new(RuleTree::Rule(Box::new(rule)), &agent, settings)
            .expect("a shield")
            .with_success_critic(critic.info());
        let moment = Moment { step: 0, observation: &observation, previous: None };
        group.bench_function(format!("bare valuation, {size}"), |bencher| {
            bencher.iter(|| {
                critic.probabilities(black_box(&observation), black_box(&action), &mut probabilities)
            });
        });
        group.bench_function(format!("allowed decision, {size}"), |bencher| {
            bencher.iter(|| {
                let agents = Agents { reset: &mut agent, forward: None, success: Some(&mut critic) };
                assert!(shield.filter(agents, black_box(&moment), &mut action).abort().is_none());
            });
        });
    }
    group.finish();
}

/// The least time of a hundred control steps from the same start, of two ways that take turns: what else runs on the machine only slows
/// them, and slows both.
fn in_turn(rounds: u32, mut ways: [&mut dyn FnMut(); 2]) -> [Duration; 2] {
    let mut best = [Duration::MAX; 2];
    for _ in 0..rounds {
        for (way, best) in ways.iter_mut().zip(&mut best) {
            let begun = Instant::now();
            way();
            *best = begun.elapsed().min(*best);
        }
    }
    best
}

#[allow(clippy::print_stdout, reason = "a benchmark's result")]
fn report(what: &str, [base, other]: [Duration; 2]) {
    let ratio = other.as_secs_f64() / base.as_secs_f64();
    println!("{what}, taking turns, the best of each: {other:.2?} and {base:.2?}, ratio {ratio:.3}\n");
}

/// A control step through the plugin against the same substeps of MuJoCo alone, meeting the same contacts.
fn step(criterion: &mut Criterion) {
    let robot = fs::read_to_string(workspace().join("envs/mujoco/src/half_cheetah.xml")).expect("a model");
    let plane = r#"<worldbody><geom type="plane" size="40 40 40" conaffinity="1"/></worldbody></mujoco>"#;
    let model = MjModel::from_xml_string(&robot.replace("</mujoco>", plane)).expect("a model");
    let mut data = MjData::new(&model);
    let mut raw = || {
        data.reset();
        for _ in 0..5 * EPISODE {
            data.step();
        }
    };
    let mut cheetah = registry()
        .environment(&Selection::new("mujoco/half-cheetah"), "(start_noise: 0.0)", &Setup::new(0, 1, host()))
        .expect("an environment");
    let mut observation = vec![0.0; cheetah.spec().spaces.observation_len()];
    let action = vec![0.0; cheetah.spec().spaces.action_len()];
    let mut through_plugin = || {
        cheetah.reset(0, &mut observation).expect("a reset");
        for _ in 0..EPISODE {
            cheetah.step(black_box(&action), &mut observation).expect("a step");
        }
    };
    let mut group = criterion.benchmark_group("half-cheetah on a plane, 100 control steps of 5 substeps");
    group.bench_function("raw mj_step", |bencher| bencher.iter(&mut raw));
    group.bench_function("through the plugin", |bencher| bencher.iter(&mut through_plugin));
    group.finish();
    report("through the plugin against raw mj_step", in_turn(1_000, [&mut raw, &mut through_plugin]));

    let mut grid = environment("gridworld");
    let mut observation = vec![0.0; grid.spec().spaces.observation_len()];
    grid.reset(0, &mut observation).expect("a reset");
    let mut direction = 0_u8;
    criterion.bench_function("gridworld, a step through the plugin", |bencher| {
        bencher.iter(|| {
            direction = (direction + 1) % 4;
            grid.step(black_box(&[f32::from(direction)]), &mut observation)
        });
    });
}

/// A batch of walkers on one thread against the same on two.
fn batch(criterion: &mut Criterion) {
    const WORLDS: usize = 8;
    let made = |threads| {
        let world = |seed| {
            let mut world = World::new(Box::new(environment("mujoco/cliff-walker")), None).expect("a world");
            world.hard_reset(None, seed).expect("a reset");
            world
        };
        let mut batch = Lanes::new((0..WORLDS as u64).map(world).collect(), threads).expect("a batch");
        batch.lanes().iter_mut().for_each(|lane| lane.is_running = true);
        batch
    };
    let round = |batch: &mut Lanes| {
        for _ in 0..EPISODE {
            batch.step();
            for lane in batch.lanes() {
                assert!(matches!(lane.outcome(), Ok(Stepped::Made(_))));
                lane.world.advance();
            }
        }
        for lane in batch.lanes() {
            lane.world.hard_reset(None, 0).expect("a reset");
        }
    };
    let (mut one, mut two) = (made(1), made(2));
    let (mut on_one, mut on_two) = (|| round(&mut one), || round(&mut two));
    let mut group = criterion.benchmark_group("8 cliff-walkers, 100 control steps");
    group.sample_size(10);
    group.bench_function("1 thread", |bencher| bencher.iter(&mut on_one));
    group.bench_function("2 threads", |bencher| bencher.iter(&mut on_two));
    group.finish();
    report("2 threads against 1", in_turn(100, [&mut on_one, &mut on_two]));
}

criterion_group!(benches, filter, undo, step, batch);
criterion_main!(benches);
