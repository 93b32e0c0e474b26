//! What a run writes down and a plugin receives of an experiment.

use super::*;

/// A plugin that was built with 1.0.0 reads one form of `Some(…)` in the whole text, not both beside one another.
#[test]
fn a_configuration_reaches_a_plugin_in_the_form_that_all_since_1_0_read() {
    #[derive(Debug, serde::Deserialize)]
    struct Settings {
        one: Option<Limits>,
        other: Option<Limits>,
        third: Option<(u8, u8)>,
    }
    #[derive(Debug, serde::Deserialize)]
    struct Limits {
        low: f32,
    }
    let config = r#"(one: Some(low: 1), other: Some((low: 2)), third: Some(3, 4))"#;
    let text = SMALL.replace('@', &format!(", reset: (plugin: \"r\", config: {config})"));
    let variant = only(&file(&text), &["reset.config.one=Some(low: 5)"]);
    let reset = variant.experiment.reset.as_ref().unwrap().choice();
    let Settings { one, other, third } = ron::from_str(self::config(reset)).unwrap();
    assert_eq!((one.unwrap().low, other.unwrap().low, third), (5.0, 2.0, Some((3, 4))));
    assert!(
        only(&file(&text), &[])
            .resolved_ron(0, &|_| Vec::new())
            .contains("config: (one: Some((low: 1)), other: Some((low: 2)), third: Some((3, 4)))")
    );
}

#[test]
fn the_resolved_configuration_is_complete_and_can_be_run_again() {
    let fields = |id: &str| -> Vec<(String, String)> {
        let fields: &[(&str, &str)] = match id {
            "ddpg" => &[("critics", "20"), ("hidden", "[400, 300]"), ("gamma", "0.99"), ("bad", "vec![]")],
            _ => &[],
        };
        fields.iter().map(|(name, default)| ((*name).to_owned(), (*default).to_owned())).collect()
    };
    let variant = &file(EXAMPLE).variants(&sets(&["reset.config.critics=5"]), None).unwrap()[2];
    let resolved = variant.resolved_ron(3, &fields);
    assert_eq!(resolved, RESOLVED);
    let again = only(&file(&resolved), &[]);
    assert_eq!(again.experiment.seeds, [3]);
    assert_eq!(
        again.resolved_ron(3, &fields).lines().skip(1).collect::<Vec<_>>(),
        RESOLVED.lines().skip(1).collect::<Vec<_>>()
    );
}

const RESOLVED: &str = r#"// cliff-cheetah, variant q_min-5, seed 3
Experiment(
    name: "cliff-cheetah",
    steps: 1000000,
    seeds: [3],
    mode: Shielded,
    environment: (plugin: "mujoco/cliff-cheetah", path: None, config: (horizon: 500)),
    forward: Learner(
        plugin: "ddpg",
        path: None,
        config: (critics: 20, hidden: [400, 300], gamma: 0.99),
    ),
    reset: (plugin: "ddpg", path: None, config: (critics: 5, hidden: [400, 300], gamma: 0.99)),
    shield: (
        rules: [
            (
                plugin: "ensemble-threshold",
                path: None,
                config: (q_min: 5.0, combine: Pessimistic),
            ),
        ],
        success_critic: None,
        projection: Qp(margin: 0.5, max_iterations: 3, trust_region: None, weights: None),
        deadline_us: None,
        reset_attempts: 1,
        reset_test: AnyVisited,
        between_attempts: Forward,
        stop_on_reset: true,
        attempt_length: Episode,
        warm_up_steps: 1000,
        shield_exploration: false,
        on_abort: Nothing,
        fallback_action: None,
    ),
    reset_task: None,
    calibration_resets: 0,
    experience: (
        capacity: 1000000,
        observations: Floats,
        batch: 64,
        updates_per_step: 1,
        reset_updates_per_step: None,
        update_every: 1,
        updates: Active,
        bootstrap_probability: 1.0,
        on_reset_success: Bootstrap,
        on_reset_failure: Bootstrap,
        abort_lifetime: None,
        failure_share: 0.5,
        success_share: 0.125,
        outcome_half_life: 15.0,
        cost_weight: 0.0,
    ),
    evaluation: (
        every: 10000,
        episodes: 10,
        agent: Forward,
        start: None,
        shielded: true,
        solved_at: 1.0,
    ),
    checkpoint: (every: 10000),
    record: (decisions: 1, states_every: 0),
    hard_reset_cost: 1.0,
    threads: 2,
)
"#;
