use shield_api::{Checkpoint, ErrorKind, Host, PluginConfig, Space, Spaces};

use super::*;

/// Numbers in [−1, 1), the same in every run.
struct Draw(u64);

impl Draw {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    fn around(&mut self, centre: [f32; 2], width: [f32; 2]) -> [f32; 2] {
        [centre[0] + width[0] * self.next(), centre[1] + width[1] * self.next()]
    }
}

fn create(config: &str) -> Result<CalibratedStart> {
    let spaces = Spaces { observation: Space::unbounded(2), action: Space::uniform(1, -1.0, 1.0) };
    CalibratedStart::create(Config::parse(config).unwrap(), &Setup::with_spaces(0, 1, Host::silent(), spaces))
}

fn signal(task: &mut CalibratedStart, next: [f32; 2]) -> ResetSignal {
    task.evaluate(&[0.0, 0.0], &[0.0], &next).unwrap()
}

fn ignore(_: ResetSignal) {}

/// A task that has seen starts and 2,000 steps, each uniform around a centre.
fn seen(config: &str, starts: usize, starts_width: [f32; 2], experience_width: [f32; 2]) -> CalibratedStart {
    seen_by(&mut Draw(1), config, starts, starts_width, experience_width)
}

fn seen_by(
    draw: &mut Draw,
    config: &str,
    starts: usize,
    starts_width: [f32; 2],
    experience_width: [f32; 2],
) -> CalibratedStart {
    let mut task = create(config).unwrap();
    (0..starts).for_each(|_| task.observe_start(&draw.around([5.0, 0.0], starts_width)).unwrap());
    (0..2_000).for_each(|_| ignore(signal(&mut task, draw.around([5.0, 0.0], experience_width))));
    task
}

fn share_inside(task: &mut CalibratedStart, width: [f32; 2]) -> f64 {
    let mut draw = Draw(77);
    let inside = |_: &usize| signal(task, draw.around([5.0, 0.0], width)).in_reset_set;
    (0..2_000).filter(inside).count() as f64 / 2_000.0
}

#[test]
fn evaluating_before_the_first_start_is_an_error_that_leaves_no_trace() {
    let mut task = create("()").unwrap();
    let error = task.evaluate(&[0.0, 0.0], &[0.0], &[0.0, 0.0]).unwrap_err();
    assert!(error.message().contains("no start was observed yet"), "{error}");
    assert_eq!(task.memory, create("()").unwrap().memory);
}

#[test]
fn fresh_starts_are_inside_as_often_as_asked() {
    // The starts fill a tenth of the space, so that the radius is their own.
    for coverage in [0.8, 0.95] {
        let config = format!("(coverage: {coverage}, least_radius: 0.0)");
        let shares = (0..12).map(|seed| {
            let mut task = seen_by(&mut Draw(seed), &config, 100, [0.3, 0.3], [1.0, 1.0]);
            assert!(task.calibration.starts_inside.unwrap() >= coverage);
            share_inside(&mut task, [0.3, 0.3])
        });
        let mean = shares.sum::<f64>() / 12.0;
        assert!((mean - coverage).abs() < 0.03, "{mean} of fresh starts are inside, not {coverage}");
    }
}

#[test]
fn most_of_the_experience_is_outside() {
    let mut task = seen("()", 100, [0.01, 0.01], [1.0, 1.0]);
    let share = share_inside(&mut task, [1.0, 1.0]);
    assert!(share > 0.0 && share < 0.07, "{share} of the experience is inside");
    assert!(task.calibration.experience_inside.unwrap() <= 0.05);
}

#[test]
fn the_unit_of_a_dimension_does_not_matter() {
    let mut metres = seen("()", 40, [0.1, 0.1], [1.0, 1.0]);
    let mut millimetres = seen("()", 40, [0.1, 100.0], [1.0, 1000.0]);
    let mut draw = Draw(3);
    for _ in 0..500 {
        let [x, y] = draw.around([5.0, 0.0], [1.0, 1.0]);
        let (one, other) = (signal(&mut metres, [x, y]), signal(&mut millimetres, [x, 1000.0 * y]));
        assert!(
            one.in_reset_set == other.in_reset_set && (one.reward - other.reward).abs() < 1e-4,
            "{one:?} {other:?}"
        );
    }
}

#[test]
fn a_dimension_that_the_starts_fill_does_not_matter_within_them_but_beyond() {
    let mut task = seen("()", 100, [1.0, 0.0], [1.0, 1.0]);
    for x in [4.1, 4.6, 5.0, 5.5, 5.9] {
        assert!(signal(&mut task, [x, 0.0]).in_reset_set, "{x}");
        assert!(!signal(&mut task, [x, 0.9]).in_reset_set, "{x}");
    }
    assert!(!signal(&mut task, [7.0, 0.0]).in_reset_set);
}

#[test]
fn a_dimension_that_never_varied_does_not_count_until_it_does() {
    let mut task = seen("()", 100, [0.1, 0.0], [1.0, 0.0]);
    assert_eq!(task.calibration.dimensions(), 1);
    let (usual, new) = (signal(&mut task, [5.0, 0.0]), signal(&mut task, [5.0, 0.1]));
    assert_eq!(usual, ResetSignal { reward: 1.0, in_reset_set: true });
    assert!(!new.in_reset_set && (new.reward - 0.05).abs() < 1e-6, "{new:?}");
}

#[test]
fn states_between_two_places_of_starts_are_outside() {
    let mut task = create("()").unwrap();
    let mut draw = Draw(9);
    for index in 0..100 {
        let centre = if index % 2 == 0 { -1.0 } else { 1.0 };
        task.observe_start(&draw.around([centre, 0.0], [0.05, 0.05])).unwrap();
    }
    (0..2_000).for_each(|_| ignore(signal(&mut task, draw.around([0.0, 0.0], [1.5, 1.5]))));
    assert!(signal(&mut task, [1.0, 0.0]).in_reset_set && signal(&mut task, [-1.0, 0.0]).in_reset_set);
    assert!(!signal(&mut task, [0.0, 0.0]).in_reset_set);
}

#[test]
fn one_start_without_experience_is_the_whole_set() {
    let mut task = create("()").unwrap();
    task.observe_start(&[1.0, 2.0]).unwrap();
    assert!(signal(&mut task, [1.0, 2.0]).in_reset_set);
    assert!(!signal(&mut task, [1.0, 2.1]).in_reset_set);
}

#[test]
fn few_starts_get_the_least_radius() {
    // 19 starts are the fewest whose largest distance covers 95%.
    for (starts, is_enough) in [(1, false), (18, false), (19, true)] {
        let strict = seen("(least_radius: 0.0)", starts, [0.3, 0.3], [1.0, 1.0]);
        assert_eq!(strict.calibration.radius > 0.0, is_enough, "{starts} starts");
        assert!(seen("()", starts, [0.3, 0.3], [1.0, 1.0]).calibration.radius > 0.0);
    }
}

#[test]
fn the_least_radius_yields_where_experience_is_near_the_starts() {
    let near = seen("()", 100, [0.01, 0.01], [1.0, 1.0]);
    assert!(near.calibration.radius < 0.35 && near.calibration.experience_inside.unwrap() <= 0.05);
    let (mut far, mut draw) = (create("()").unwrap(), Draw(1));
    (0..100).for_each(|_| far.observe_start(&draw.around([9.0, 0.0], [0.01, 0.01])).unwrap());
    (0..2_000).for_each(|_| ignore(signal(&mut far, draw.around([5.0, 0.0], [1.0, 1.0]))));
    assert!((far.calibration.radius - f64::from(0.35f32)).abs() < 1e-9, "{}", far.calibration.radius);
}

#[test]
fn the_reward_falls_over_the_whole_range_of_the_experience() {
    let mut task = seen("()", 100, [0.01, 0.01], [1.0, 1.0]);
    let rewards = [0.0, 0.25, 0.5, 0.75, 1.0, 1e30].map(|d| signal(&mut task, [5.0 + d, d]).reward);
    assert!(rewards.windows(2).all(|pair| pair[0] > pair[1]), "{rewards:?}");
    assert!(rewards[0] == 1.0 && rewards[4] > 0.01 && rewards[4] < 0.1 && rewards[5] == 0.0, "{rewards:?}");
}

#[test]
fn a_few_explosions_do_not_move_the_spread() {
    let calm = seen("()", 100, [0.1, 0.1], [1.0, 1.0]);
    let (mut task, mut draw) = (create("()").unwrap(), Draw(1));
    (0..100).for_each(|_| task.observe_start(&draw.around([5.0, 0.0], [0.1, 0.1])).unwrap());
    for step in 0..2_000 {
        let wild = if step % 1_000 == 0 { 1e12 } else { 1.0 };
        signal(&mut task, draw.around([5.0, 0.0], [wild, wild]));
    }
    let ratio = task.calibration.scales[0].per_unit / calm.calibration.scales[0].per_unit;
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
}

#[test]
fn after_the_last_start_and_step_that_count_nothing_moves_any_more() {
    let mut task = seen("(starts: 20)", 20, [0.1, 0.1], [1.0, 1.0]);
    let (memory, calibration) = (task.memory.clone(), task.calibration.clone());
    let mut draw = Draw(5);
    for _ in 0..3_000 {
        task.observe_start(&draw.around([50.0, 0.0], [9.0, 9.0])).unwrap();
        signal(&mut task, draw.around([50.0, 0.0], [9.0, 9.0]));
    }
    assert!(task.memory == memory && task.calibration == calibration);
    assert!(task.memory.samples().is_empty(), "what is final needs no samples");
}

#[test]
fn every_setting_changes_what_counts_as_reset() {
    let judged = |config: &str| {
        let mut task = seen(config, 100, [0.3, 0.3], [1.0, 1.0]);
        let mut draw = Draw(5);
        let rewards = (0..200).map(|_| signal(&mut task, draw.around([5.0, 0.0], [1.0, 1.0])).reward);
        rewards.collect::<Vec<_>>()
    };
    let usual = judged("()");
    for config in ["(coverage: 0.8)", "(starts: 30)", "(experience: 700)"] {
        assert!(judged(config) != usual, "{config} changes nothing");
    }
    assert!(judged("(starts: 10, least_radius: 0.01)") != judged("(starts: 10)"));
}

#[test]
fn invalid_settings_are_refused_by_name() {
    for (config, name) in [
        ("(coverage: 0.0)", "coverage"),
        ("(coverage: 1.0)", "coverage"),
        ("(coverage: NaN)", "coverage"),
        ("(starts: 0)", "starts"),
        ("(starts: 257)", "starts"),
        ("(experience: 0)", "experience"),
        ("(least_radius: -0.1)", "least_radius"),
        ("(least_radius: inf)", "least_radius"),
    ] {
        let error = create(config).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{config}");
        assert!(error.message().contains(name), "{config}: {error}");
    }
}

#[test]
fn truncated_and_non_finite_inputs_are_refused_and_change_nothing() {
    let mut task = seen("()", 3, [0.1, 0.1], [1.0, 1.0]);
    let before = task.memory.clone();
    for bad in [&[0.0][..], &[f32::NAN, 0.0], &[0.0, f32::INFINITY], &[]] {
        assert!(task.evaluate(&[0.0, 0.0], &[0.0], bad).is_err(), "{bad:?}");
        assert!(task.evaluate(bad, &[0.0], &[0.0, 0.0]).is_err(), "{bad:?}");
        assert!(task.observe_start(bad).is_err(), "{bad:?}");
    }
    for bad in [&[][..], &[f32::NAN], &[0.0, 0.0]] {
        assert!(task.evaluate(&[0.0, 0.0], bad, &[0.0, 0.0]).is_err(), "{bad:?}");
    }
    assert_eq!(task.memory, before);
}

#[test]
fn extreme_numbers_give_a_reward_within_its_bounds() {
    let mut task = create("()").unwrap();
    for value in [f32::MAX, f32::MIN_POSITIVE, 0.0, -f32::MAX, 1e-45] {
        task.observe_start(&[value, -value]).unwrap();
        for next in [[f32::MAX, 0.0], [1e-45, f32::MIN], [0.0, 0.0]] {
            let reward = signal(&mut task, next).reward;
            assert!((0.0..=1.0).contains(&reward), "{value} {next:?}: {reward}");
        }
    }
}

#[test]
fn a_restored_task_continues_as_the_saved_one_bit_for_bit() {
    for (starts, steps) in [(0, 0), (1, 0), (1, 1), (5, 77), (20, 100), (30, 2_000), (20, 2_000)] {
        let (mut saved, mut draw) = (create("(starts: 20)").unwrap(), Draw(starts * 7 + steps));
        (0..starts).for_each(|_| saved.observe_start(&draw.around([5.0, 0.0], [0.3, 0.1])).unwrap());
        (0..steps).for_each(|_| ignore(signal(&mut saved, draw.around([5.0, 0.0], [1.0, 1.0]))));
        let mut bytes = Vec::new();
        saved.save(&mut bytes).unwrap();
        let mut restored = create("(starts: 20)").unwrap();
        restored.load(&bytes).unwrap();
        for _ in 0..300 {
            let (start, next) = (draw.around([5.0, 0.0], [0.3, 0.1]), draw.around([5.0, 0.0], [1.0, 1.0]));
            let signals = [&mut saved, &mut restored].map(|task| {
                task.observe_start(&start).unwrap();
                signal(task, next)
            });
            assert_eq!(signals[0].reward.to_bits(), signals[1].reward.to_bits());
            assert_eq!(signals[0].in_reset_set, signals[1].in_reset_set);
        }
        let states = [&saved, &restored].map(|task| {
            let mut bytes = Vec::new();
            task.save(&mut bytes).unwrap();
            bytes
        });
        assert!(states[0] == states[1], "{starts} starts, {steps} steps");
    }
}

#[test]
fn foreign_bytes_are_refused_and_change_nothing() {
    let mut task = seen("()", 3, [0.1, 0.1], [1.0, 1.0]);
    let mut bytes = Vec::new();
    task.save(&mut bytes).unwrap();
    let (memory, calibration) = (task.memory.clone(), task.calibration.clone());
    let with = |at: usize, value: &[u8]| [&bytes[..at], value, &bytes[at + value.len()..]].concat();
    let nan = f64::NAN.to_le_bytes();
    let (radius, margin) = (bytes.len() - 64, bytes.len() - 56);
    for bad in [
        vec![],
        b"CST2".to_vec(),
        bytes[1..].to_vec(),
        [&bytes[..], &[0]].concat(),
        with(4, &4u64.to_le_bytes()),
        with(4, &u64::MAX.to_le_bytes()),
        with(12, &2_001u64.to_le_bytes()),
        with(12, &9u64.to_le_bytes()),
        with(28, &[2]),
        with(29, &f32::NAN.to_le_bytes()),
        with(radius, &nan),
        with(radius, &(-1.0f64).to_le_bytes()),
        with(margin, &0.0f64.to_le_bytes()),
        with(bytes.len() - 48, &2.0f64.to_le_bytes()),
        with(bytes.len() - 8, &nan),
    ] {
        assert!(task.load(&bad).is_err(), "{} bytes", bad.len());
        assert!(task.memory == memory && task.calibration == calibration);
    }
    for len in 0..bytes.len() {
        assert!(task.load(&bytes[..len]).is_err(), "{len} bytes");
    }
    assert!(create("(starts: 2)").unwrap().load(&bytes).is_err(), "more starts than it may keep");
}

#[test]
fn a_step_allocates_nothing() {
    let (mut task, mut draw) = (create("()").unwrap(), Draw(2));
    (0..100).for_each(|_| task.observe_start(&draw.around([5.0, 0.0], [0.3, 0.1])).unwrap());
    let counted = allocation_counter::measure(|| {
        (0..2_500).for_each(|_| ignore(signal(&mut task, draw.around([5.0, 0.0], [1.0, 1.0]))));
    });
    assert_eq!(counted.count_total, 0);
}
