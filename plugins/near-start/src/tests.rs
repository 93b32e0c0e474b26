use shield_api::{ErrorKind, Host, PluginConfig, Space, Spaces};

use super::*;

fn create(config: &str) -> Result<NearStart> {
    let spaces = Spaces { observation: Space::unbounded(2), action: Space::uniform(1, -1.0, 1.0) };
    NearStart::create(Config::parse(config).unwrap(), &Setup::with_spaces(0, 1, Host::silent(), spaces))
}

fn signal(task: &mut NearStart, next: [f32; 2]) -> ResetSignal {
    task.evaluate(&[0.0, 0.0], &[0.0], &next).unwrap()
}

#[test]
fn evaluating_before_the_first_start_is_an_error() {
    let mut task = create("()").unwrap();
    let error = task.evaluate(&[0.0, 0.0], &[0.0], &[0.0, 0.0]).unwrap_err();
    assert!(error.message().contains("no start was observed yet"), "{error}");
}

#[test]
fn the_target_is_the_mean_of_the_first_starts() {
    let mut task = create("(average_over: 2)").unwrap();
    for start in [[0.0, 2.0], [2.0, 4.0], [100.0, 100.0]] {
        task.observe_start(&start).unwrap();
    }
    assert_eq!(signal(&mut task, [1.0, 3.0]), ResetSignal { reward: 1.0, in_reset_set: true });
}

#[test]
fn observed_starts_do_not_move_a_given_target() {
    let mut task = create("(target: Some([1.0, 3.0]))").unwrap();
    task.observe_start(&[50.0, 50.0]).unwrap();
    assert!(signal(&mut task, [1.0, 3.0]).in_reset_set);
}

#[test]
fn the_reward_falls_beyond_the_radius_to_a_twentieth_at_the_margin() {
    let mut task = create("(target: Some([0.0, 0.0]), radius: 0.5, margin: 2.0)").unwrap();
    // In two dimensions with equal weights, (d, d) is at the distance d.
    let rewards = [0.0, 0.5, 1.0, 2.5, 1e30].map(|d| signal(&mut task, [d, d]).reward);
    assert_eq!((rewards[0], rewards[1]), (1.0, 1.0));
    assert!(rewards[2] < 1.0 && (rewards[3] - 0.05).abs() < 1e-6 && rewards[4] == 0.0, "{rewards:?}");
    assert!(signal(&mut task, [0.5, 0.5]).in_reset_set && !signal(&mut task, [0.51, 0.51]).in_reset_set);
}

#[test]
fn a_dimension_without_weight_is_ignored() {
    let mut task = create("(target: Some([0.0, 0.0]), weights: Some([1.0, 0.0]))").unwrap();
    assert!(signal(&mut task, [0.05, 1e6]).in_reset_set);
    assert!(!signal(&mut task, [0.2, 0.0]).in_reset_set);
}

#[test]
fn invalid_settings_are_refused_by_name() {
    for (config, name) in [
        ("(radius: -1.0)", "radius"),
        ("(radius: NaN)", "radius"),
        ("(margin: 0.0)", "margin"),
        ("(margin: inf)", "margin"),
        ("(average_over: 0)", "average_over"),
        ("(target: Some([1.0]))", "target"),
        ("(target: Some([1.0, NaN]))", "target"),
        ("(weights: Some([1.0]))", "weights"),
        ("(weights: Some([1.0, -1.0]))", "weights[1]"),
        ("(weights: Some([0.0, 0.0]))", "weights"),
    ] {
        let error = create(config).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{config}");
        assert!(error.message().contains(name), "{config}: {error}");
    }
}

#[test]
fn truncated_and_non_finite_observations_are_refused() {
    let mut task = create("(target: Some([0.0, 0.0]))").unwrap();
    for bad in [&[0.0][..], &[f32::NAN, 0.0], &[0.0, f32::INFINITY]] {
        assert!(task.evaluate(&[0.0, 0.0], &[0.0], bad).is_err(), "{bad:?}");
        assert!(task.observe_start(bad).is_err(), "{bad:?}");
    }
    assert!(task.evaluate(&[0.0], &[0.0], &[0.0, 0.0]).is_err());
    assert!(task.evaluate(&[0.0, 0.0], &[], &[0.0, 0.0]).is_err());
}

#[test]
fn a_restored_task_continues_as_the_saved_one() {
    let mut saved = create("()").unwrap();
    for start in [[0.1, 0.2], [0.3, 0.7]] {
        saved.observe_start(&start).unwrap();
    }
    let mut bytes = Vec::new();
    saved.save(&mut bytes).unwrap();
    let mut restored = create("()").unwrap();
    restored.load(&bytes).unwrap();
    for task in [&mut saved, &mut restored] {
        task.observe_start(&[0.9, 0.4]).unwrap();
    }
    assert_eq!(saved.starts, restored.starts);
}

#[test]
fn foreign_bytes_are_refused_and_change_nothing() {
    let mut task = create("()").unwrap();
    task.observe_start(&[0.5, 0.5]).unwrap();
    let mut bytes = Vec::new();
    task.save(&mut bytes).unwrap();
    let before = task.starts.clone();
    let with_nan = [&bytes[..12], &f64::NAN.to_le_bytes(), &f64::NAN.to_le_bytes()].concat();
    for bad in [&b""[..], b"NST2", &bytes[..20], &bytes[1..], &[&bytes[..], &[0]].concat(), &with_nan] {
        assert!(task.load(bad).is_err(), "{bad:?}");
        assert_eq!(task.starts, before);
    }
}
