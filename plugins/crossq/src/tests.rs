use actor_critic::Gaussian;
use learner_kit::{AgentConfig, take_batch};
use shield_api::{Checkpoint, Host, Learner};

use conformance::{SIZE, Settings, Transitions, learner, train, values};
use continuous::State;

use crate::{Crossq, CrossqConfig};

#[macro_use]
#[path = "../../../tests/learners/conformance.rs"]
mod conformance;
#[macro_use]
#[path = "../../../tests/learners/continuous.rs"]
#[allow(dead_code, unused_macros, reason = "what holds for a deterministic policy is not asked")]
mod continuous;
#[path = "../../../tests/learners/gradients.rs"]
#[allow(dead_code, reason = "as above")]
mod gradients;
#[path = "../../../tests/learners/torch.rs"]
mod torch;

impl continuous::Continuous for Crossq {
    const MAGIC: &'static [u8] = CrossqConfig::MAGIC;
    const NETWORKS: usize = 2;
    type Policy = Gaussian;

    fn own_small() -> Settings {
        vec![
            ("activation", "Tanh"),
            ("initialisation", "Lillicrap"),
            ("action_layer", "1"),
            ("policy_delay", "1"),
            ("renorm_warm_up", "2"),
            ("initial_temperature", "0.02"),
        ]
    }

    fn own_changes() -> Settings {
        vec![
            ("temperature_rate", "1e-2"),
            ("initial_temperature", "0.5"),
            ("target_entropy", "Some(3.0)"),
            ("backup_entropy", "false"),
            ("policy_delay", "2"),
            ("beta1", "0.9"),
            ("renorm_momentum", "0.5"),
            ("renorm_warm_up", "4"),
            ("loss", "Huber"),
        ]
    }

    fn own_impossible() -> Settings {
        vec![
            ("temperature_rate", "-1e-3"),
            ("initial_temperature", "0.0"),
            ("target_entropy", "Some(NaN)"),
            ("policy_delay", "0"),
            ("beta1", "1.0"),
            ("renorm_momentum", "1.5"),
        ]
    }

    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
        continuous::network_value(&mut self.agent, network, observation, action)
    }
}

conformance_tests!(Crossq);
stochastic_tests!(Crossq);

/// Repeats a case of torch's, with its noise.
fn check_torch(name: &str, own: &[(&'static str, &'static str)], join: usize) {
    let (learner, expected) = torch::check::<Crossq>(name, own, join, |learner, config, given| {
        take_batch(&mut learner.agent.body, &given.batch, 1).unwrap();
        let [next, now] = &given.noise;
        learner.agent.policy.next.noise.clone_from(next);
        learner.agent.policy.now.noise.clone_from(now);
        let Crossq { agent, update, .. } = learner;
        update.learn_from_draws(config, agent, &given.batch, &Host::silent()).unwrap();
    });
    let found = learner.agent.policy.temperature().ln();
    let expected = expected.log_temperature.unwrap();
    assert!((found - expected).abs() < 1e-5, "{found} against {expected}");
    assert!((found - 0.5_f32.ln()).abs() > 1e-3, "the temperature has not moved");
}

#[test]
fn twelve_updates_equal_those_of_torch() {
    let own = [
        ("temperature_rate", "1e-3"),
        ("initial_temperature", "0.5"),
        ("renorm_momentum", "0.9"),
        ("renorm_warm_up", "2"),
    ];
    check_torch("crossq", &own, 0);
}

#[test]
fn the_actor_moves_at_every_delayed_update_only() {
    let mut learner: Crossq = learner(&[("policy_delay", "3")]);
    for update in 1..=6 {
        let before: State<Gaussian> = gradients::state(&learner);
        train(&mut learner, update..update + 1);
        let after: State<Gaussian> = gradients::state(&learner);
        assert_eq!(before.actor.weights != after.actor.weights, update % 3 == 0, "update {update}");
    }
}

#[test]
fn a_value_depends_on_the_running_statistics_and_not_on_the_last_batch() {
    let mut learner: Crossq = learner(&[]);
    train(&mut learner, 0..5);
    let before = values(&mut learner);
    assert_eq!(values(&mut learner), before);
    let mut other: Crossq = conformance::learner(&[]);
    other.load(&conformance::saved(&learner)).unwrap();
    assert_eq!(values(&mut other), before);
}

#[test]
fn values_count_later_entropy_only_if_they_shall() {
    let next_part = |settings: &[(&str, &str)]| {
        let mut learner: Crossq = learner(settings);
        let transitions = Transitions::random::<Crossq>(3, 1);
        learner.update(&transitions.batch()).unwrap();
        let targets = learner.update.steps[0].critic.targets.clone();
        (0..SIZE).map(|row| targets[row] - transitions.rewards[row]).collect::<Vec<f32>>()
    };
    let tiny = next_part(&[("initial_temperature", "1e-9")]);
    let without = next_part(&[("initial_temperature", "2.0"), ("backup_entropy", "false")]);
    let with = next_part(&[("initial_temperature", "2.0")]);
    assert_eq!(without[3], 0.0, "an episode ends there");
    for row in (0..SIZE).filter(|row| *row != 3) {
        assert!((tiny[row] - without[row]).abs() < 1e-6);
        assert!((with[row] - without[row]).abs() > 0.1);
    }
}
