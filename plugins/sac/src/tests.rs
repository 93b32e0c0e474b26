use actor_critic::Gaussian;
use learner_kit::{AgentConfig, take_batch};
use shield_api::{ActMode, Host, Learner};

use conformance::{SIZE, Settings, Transitions, act, learner, train, values};
use continuous::State;

use crate::{Sac, SacConfig};

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

impl continuous::Continuous for Sac {
    const MAGIC: &'static [u8] = SacConfig::MAGIC;
    const NETWORKS: usize = 2;
    type Policy = Gaussian;

    fn own_small() -> Settings {
        vec![
            ("activation", "Tanh"),
            ("initialisation", "Lillicrap"),
            ("action_layer", "1"),
            ("actor_rate", "1e-3"),
            ("critic_rate", "1e-3"),
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
            ("loss", "Huber"),
        ]
    }

    fn own_impossible() -> Settings {
        vec![
            ("temperature_rate", "-1e-3"),
            ("initial_temperature", "0.0"),
            ("target_entropy", "Some(NaN)"),
            ("policy_delay", "0"),
        ]
    }

    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
        continuous::network_value(&mut self.agent, network, observation, action)
    }
}

conformance_tests!(Sac);
stochastic_tests!(Sac);

/// Repeats a case of torch's, with its noise.
fn check_torch(name: &str, own: &[(&'static str, &'static str)], join: usize) {
    let (learner, expected) = torch::check::<Sac>(name, own, join, |learner, config, given| {
        take_batch(&mut learner.agent.body, &given.batch, 1).unwrap();
        let [next, now] = &given.noise;
        learner.agent.policy.next.noise.clone_from(next);
        learner.agent.policy.now.noise.clone_from(now);
        let Sac { agent, update, .. } = learner;
        update.learn_from_draws(config, agent, &given.batch, &Host::silent()).unwrap();
    });
    let found = learner.agent.policy.temperature().ln();
    let expected = expected.log_temperature.unwrap();
    assert!((found - expected).abs() < 1e-5, "{found} against {expected}");
    assert!((found - 0.5_f32.ln()).abs() > 1e-3, "the temperature has not moved");
}

#[test]
fn twelve_updates_equal_those_of_torch() {
    let own = [("temperature_rate", "1e-3"), ("initial_temperature", "0.5")];
    check_torch("sac", &own, 0);
    let regularised = [("action_layer", "1"), ("layer_norm", "true"), ("weight_decay", "0.1")];
    check_torch("sac-regularised", &[&own[..], &regularised].concat(), 1);
}

#[test]
fn exploring_actions_are_those_of_the_gaussian_inside_the_box() {
    let mut learner: Sac = learner(&[("random_steps", "0"), ("initialisation", "FanIn")]);
    let greedy = continuous::to_unit(&act(&mut learner, ActMode::Greedy)).map(f32::atanh);
    let drawn: Vec<[f32; 2]> = (0..4_000)
        .map(|_| {
            let action = act(&mut learner, ActMode::Explore);
            continuous::spaces().action.check_action(&action).unwrap();
            continuous::to_unit(&action).map(f32::atanh)
        })
        .collect();
    let mut actor = learner.agent.actor.member(0);
    actor.observe(&conformance::OBSERVATION);
    let outputs = actor.values(&[]).to_vec();
    for index in 0..2 {
        let mean = drawn.iter().map(|action| action[index]).sum::<f32>() / 4_000.0;
        let variance = drawn.iter().map(|action| (action[index] - mean).powi(2)).sum::<f32>() / 4_000.0;
        let deviation = outputs[2 + index].exp();
        assert!((greedy[index] - outputs[index]).abs() < 1e-4);
        assert!((mean - outputs[index]).abs() < 4.0 * deviation / 4_000_f32.sqrt(), "{mean}");
        assert!((variance.sqrt() / deviation - 1.0).abs() < 0.06, "{variance} against {deviation}");
    }
}

#[test]
fn the_temperature_rises_until_the_entropy_is_what_it_aims_at() {
    let temperature_after = |target: &str| {
        let mut learner: Sac = learner(&[("target_entropy", target), ("temperature_rate", "1e-2")]);
        train(&mut learner, 0..20);
        learner.agent.policy.temperature()
    };
    // The untrained policy's entropy is about 2 · 0.7.
    assert!(temperature_after("Some(4.0)") > 0.022);
    assert!(temperature_after("Some(-4.0)") < 0.018);
}

#[test]
fn the_actor_moves_at_every_delayed_update_only_and_the_targets_at_each() {
    let mut learner: Sac = learner(&[("policy_delay", "3"), ("tau", "0.5")]);
    for update in 1..=6 {
        let before: State<Gaussian> = gradients::state(&learner);
        train(&mut learner, update..update + 1);
        let after: State<Gaussian> = gradients::state(&learner);
        assert_eq!(before.actor.weights != after.actor.weights, update % 3 == 0, "update {update}");
        assert!(before.critics.targets != after.critics.targets);
    }
}

#[test]
fn values_count_later_entropy_only_if_they_shall() {
    let next_part = |settings: &[(&str, &str)]| {
        let mut learner: Sac = learner(settings);
        let transitions = Transitions::random::<Sac>(3, 1);
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

#[test]
fn a_value_is_that_of_the_smaller_twin() {
    let mut learner: Sac = learner(&[("critic_rate", "1e-2")]);
    train(&mut learner, 0..20);
    let found = values(&mut learner);
    for (pair, value) in found.into_iter().enumerate() {
        let twins = [2 * pair, 2 * pair + 1].map(|network| {
            continuous::network_value(&mut learner.agent, network, &[0.3, -0.2, 0.7], &[1.0, 1.0])
        });
        assert_eq!(value, twins[0].min(twins[1]));
    }
}
