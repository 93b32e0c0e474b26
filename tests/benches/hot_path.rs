//! What a step costs: the filter with 20 critics against their bare valuation, and the environment against raw `mj_step`.

use std::{fs, hint::black_box};

use criterion::{Criterion, criterion_group, criterion_main};
use mujoco_rs::prelude::{MjData, MjModel};
use shield_api::{Environment, Learner, Setup};
use shield_runtime::{
    plugin::{LoadedEnvironment, LoadedLearner, Registry, SearchPath, Selection, host},
    shield::{Agents, Ladder, LadderSettings, Moment, RuleTree},
};
use shield_tests::{plugins_folder, workspace};

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
                        .filter(Agents { reset: &mut agent, forward: None }, black_box(&moment), &mut action)
                        .abort()
                        .is_none()
                )
            });
        });
    }
    group.finish();
}

/// A control step through the plugin against the same substeps of MuJoCo alone.
fn step(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("half-cheetah on a plane, 5 substeps");
    let robot = fs::read_to_string(workspace().join("envs/mujoco/src/half_cheetah.xml")).expect("a model");
    let plane = r#"<worldbody><geom type="plane" size="40 40 40" conaffinity="1"/></worldbody></mujoco>"#;
    let model = MjModel::from_xml_string(&robot.replace("</mujoco>", plane)).expect("a model");
    let mut data = MjData::new(&model);
    // Both fall from the same state and begin anew after 100 control steps, so that they meet the same contacts.
    let mut steps = 0_u32;
    group.bench_function("raw mj_step", |bencher| {
        bencher.iter(|| {
            steps += 1;
            if steps.is_multiple_of(100) {
                data.reset();
            }
            for _ in 0..5 {
                data.step();
            }
        });
    });
    let mut cheetah = registry()
        .environment(&Selection::new("mujoco/half-cheetah"), "(start_noise: 0.0)", &Setup::new(0, 1, host()))
        .expect("an environment");
    let mut observation = vec![0.0; cheetah.spec().spaces.observation_len()];
    cheetah.reset(0, &mut observation).expect("a reset");
    let action = vec![0.0; cheetah.spec().spaces.action_len()];
    let mut steps = 0_u32;
    group.bench_function("through the plugin", |bencher| {
        bencher.iter(|| {
            steps += 1;
            if steps.is_multiple_of(100) {
                cheetah.reset(0, &mut observation).expect("a reset");
            }
            cheetah.step(black_box(&action), &mut observation)
        });
    });
    group.finish();

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

criterion_group!(benches, filter, step);
criterion_main!(benches);
