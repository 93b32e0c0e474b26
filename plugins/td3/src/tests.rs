use learner_kit::AgentConfig;
use shield_api::{ActMode, Learner};

use conformance::{SIZE, Settings, Transitions, act, learner, train, values};

use crate::{Td3, Td3Config};

#[macro_use]
#[path = "../../../tests/learners/conformance.rs"]
mod conformance;
#[macro_use]
#[path = "../../../tests/learners/continuous.rs"]
mod continuous;
#[path = "../../../tests/learners/gradients.rs"]
mod gradients;
#[path = "../../../tests/learners/reference.rs"]
mod reference;
#[path = "../../../tests/learners/torch.rs"]
mod torch;

impl continuous::Continuous for Td3 {
    const MAGIC: &'static [u8] = Td3Config::MAGIC;
    const NETWORKS: usize = 2;
    type Policy = ();

    fn plain() -> Settings {
        vec![("target_sigma", "0.0"), ("policy_delay", "1")]
    }

    fn own_changes() -> Settings {
        vec![("policy_delay", "3"), ("target_sigma", "0.1"), ("target_clip", "0.1"), ("loss", "Huber")]
    }

    fn own_impossible() -> Settings {
        vec![("policy_delay", "0"), ("target_sigma", "-0.1"), ("target_clip", "NaN")]
    }

    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
        continuous::network_value(&mut self.agent, network, observation, action)
    }
}

conformance_tests!(Td3);
continuous_tests!(Td3);

/// What the twins' target networks say of a batch's next states and the given actions, pair by pair.
fn target_values(learner: &mut Td3, transitions: &Transitions, actions: &[f32]) -> Vec<Vec<f32>> {
    let critics = &mut learner.agent.critics;
    (0..critics.members())
        .map(|network| {
            critics.member(network).target_values(&transitions.next_observations, actions).to_vec()
        })
        .collect()
}

#[test]
fn targets_come_from_the_smaller_twin() {
    let mut learner: Td3 = learner(&[("target_sigma", "0.0"), ("discount", "0.5"), ("tau", "0.5")]);
    train(&mut learner, 0..20);
    let transitions = Transitions::random::<Td3>(3, 99);
    let actions = {
        let mut actor = learner.agent.actor.member(0);
        actor.target_values(&transitions.next_observations, &[]).to_vec()
    };
    let next_values = target_values(&mut learner, &transitions, &actions);
    learner.update(&transitions.batch()).unwrap();
    let mut smaller_twins = [0; 2];
    for (pair, step) in learner.update.steps.iter().enumerate() {
        for (row, target) in step.critic.targets.iter().enumerate() {
            let twins = [next_values[2 * pair][row], next_values[2 * pair + 1][row]];
            let least = twins[0].min(twins[1]);
            smaller_twins[usize::from(least == twins[1])] += 1;
            let expected = transitions.rewards[row] + 0.5 * transitions.continuations[row] * least;
            assert!((target - expected).abs() < 1e-6);
        }
    }
    assert!(smaller_twins.iter().all(|count| *count > 0), "one twin is always smaller: {smaller_twins:?}");
}

#[test]
fn a_value_comes_from_the_smaller_twin() {
    let mut learner: Td3 = learner(&[("critic_rate", "1e-2")]);
    train(&mut learner, 0..20);
    let found = values(&mut learner);
    // The action (1, 1) of the box in [-1, 1].
    let twins: Vec<f32> = (0..6)
        .map(|network| {
            let mut critic = learner.agent.critics.member(network);
            critic.observe(&[0.3, -0.2, 0.7]);
            critic.values(&[0.5, 1.0])[0]
        })
        .collect();
    for (pair, value) in found.into_iter().enumerate() {
        assert_ne!(twins[2 * pair], twins[2 * pair + 1]);
        assert_eq!(value, twins[2 * pair].min(twins[2 * pair + 1]));
    }
}

#[test]
fn the_actor_and_all_targets_move_at_every_delayed_update_only() {
    let mut learner: Td3 = learner(&[("policy_delay", "3"), ("tau", "0.5")]);
    let transitions = Transitions::random::<Td3>(3, 1);
    let seen = |learner: &mut Td3| {
        let greedy = act(learner, ActMode::Greedy);
        let policy = learner.agent.actor.member(0).target_values(&[0.3, -0.2, 0.7], &[]).to_vec();
        (greedy, policy, target_values(learner, &transitions, &[0.5; 2 * SIZE]))
    };
    let mut before = seen(&mut learner);
    for update in 1..=9 {
        let old_values = values(&mut learner);
        train(&mut learner, update..update + 1);
        assert_ne!(old_values, values(&mut learner), "the critics learn in every update");
        let after = seen(&mut learner);
        if update % 3 == 0 {
            assert!(before.0 != after.0 && before.1 != after.1, "update {update}");
            assert!(before.2.iter().zip(&after.2).all(|(before, after)| before != after), "update {update}");
        } else {
            assert_eq!(before, after, "update {update}");
        }
        before = after;
    }
}

#[test]
fn target_noise_changes_what_is_learned_and_can_be_switched_off() {
    let learned = |sigma: &str, clip: &str| {
        let mut learner: Td3 = learner(&[("target_sigma", sigma), ("target_clip", clip)]);
        train(&mut learner, 0..4);
        values(&mut learner)
    };
    assert_eq!(learned("0.0", "0.5"), learned("5.0", "0.0"));
    assert_ne!(learned("0.0", "0.5"), learned("0.2", "0.5"));
}

#[test]
fn the_same_seed_learns_the_same_weights() {
    reference::the_same_seed_learns_the_same_weights::<Td3>();
}

#[test]
fn twelve_updates_equal_those_of_torch() {
    let plain = &[("action_layer", "0"), ("target_sigma", "0.0"), ("policy_delay", "1")];
    torch::check::<Td3>("td3", plain, 0, |learner, _, given| learner.update(&given.batch).unwrap());
    let regularised = &[
        ("action_layer", "0"),
        ("target_sigma", "0.0"),
        ("policy_delay", "1"),
        ("layer_norm", "true"),
        ("weight_decay", "0.1"),
    ];
    torch::check::<Td3>("td3-regularised", regularised, 0, |learner, _, given| {
        learner.update(&given.batch).unwrap();
    });
}
