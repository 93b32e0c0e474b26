use actor_critic::Normaliser;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{ActMode, Batch, ErrorKind, Host, Learner, Plugin, PluginConfig, Setup, Space, Spaces};

use conformance::{SIZE, Settings, Transitions, act, learner, train, values};

use crate::{Ddqn, DdqnConfig, learner::largest};

#[macro_use]
#[path = "../../../tests/learners/conformance.rs"]
mod conformance;
#[path = "../../../tests/learners/gradients.rs"]
mod gradients;

const ACTIONS: usize = 3;

impl conformance::Subject for Ddqn {
    fn small() -> Settings {
        vec![("members", "3"), ("hidden", "[20, 15]"), ("epsilon", "0.5"), ("epsilon_steps", "20")]
    }

    fn changes() -> Settings {
        vec![
            ("members", "4"),
            ("hidden", "[20]"),
            ("activation", "Tanh"),
            ("initialisation", "FanIn"),
            ("rate", "1e-3"),
            ("discount", "0.9"),
            ("tau", "0.5"),
            ("loss", "Squared"),
            ("epsilon", "1.0"),
            ("final_epsilon", "0.9"),
            ("epsilon_steps", "1000"),
            ("initial_value", "Some(4.0)"),
            ("gradient_clip", "Some(1e-8)"),
            ("normalise_observations", "true"),
        ]
    }

    fn impossible() -> Settings {
        vec![
            ("members", "0"),
            ("hidden", "[]"),
            ("hidden", "[5, 0]"),
            ("rate", "NaN"),
            ("discount", "-0.1"),
            ("tau", "0.0"),
            ("tau", "1.5"),
            ("epsilon", "1.1"),
            ("final_epsilon", "NaN"),
            ("initial_value", "Some(inf)"),
            ("gradient_clip", "Some(-1.0)"),
        ]
    }

    fn spaces() -> Spaces {
        Spaces { observation: Space::unbounded(3), action: Space::Discrete { n: ACTIONS } }
    }

    fn impossible_actions() -> Vec<Space> {
        vec![Space::uniform(2, -1.0, 1.0)]
    }
}

/// The state, as it is saved.
#[derive(Clone, Serialize, Deserialize)]
pub struct State {
    networks: gradients::Networks,
    normaliser: Option<Normaliser>,
    explored: u64,
    rng: Pcg64,
}

impl gradients::Inside for Ddqn {
    type State = State;
    const MAGIC: &'static [u8] = crate::checkpoint::MAGIC;
    const NETWORKS: usize = 1;

    fn plain() -> Settings {
        vec![("activation", "Tanh")]
    }

    fn critics(state: &mut State) -> &mut gradients::Networks {
        &mut state.networks
    }

    fn actor(_state: &mut State) -> Option<&mut gradients::Networks> {
        None
    }

    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
        let mut network = self.networks.member(network);
        network.observe(observation);
        network.values(&[])[action[0] as usize]
    }

    fn next_value(&mut self, member: usize, observation: &[f32]) -> f32 {
        let values = (0..ACTIONS).map(|action| self.network_value(member, observation, &[action as f32]));
        values.fold(f32::NEG_INFINITY, f32::max)
    }
}

conformance_tests! { Ddqn, gradients:
    the_gradient_of_the_critics_is_that_of_their_loss,
    n_critics_learn_what_n_single_ones_would,
}
conformance_tests!(Ddqn);

#[test]
fn the_network_chooses_the_action_and_its_target_network_values_it() {
    let mut learner: Ddqn = learner(&[("discount", "0.5"), ("rate", "1e-2"), ("tau", "0.01")]);
    train(&mut learner, 0..30);
    let transitions = Transitions::random::<Ddqn>(3, 99);
    let mut expected = Vec::new();
    let mut differently_chosen = 0;
    for index in 0..3 {
        let mut network = learner.networks.member(index);
        network.observe(&transitions.next_observations);
        let chosen: Vec<usize> = network.values(&[]).chunks(ACTIONS).map(largest).collect();
        let targets = network.target_values(&transitions.next_observations, &[]);
        for (row, next_values) in targets.chunks(ACTIONS).enumerate() {
            differently_chosen += usize::from(largest(next_values) != chosen[row]);
            let bootstrap = 0.5 * transitions.continuations[row] * next_values[chosen[row]];
            expected.push(transitions.rewards[row] + bootstrap);
        }
    }
    assert!(differently_chosen > 0, "nothing tells double Q-learning from the ordinary one");
    learner.update(&transitions.batch()).unwrap();
    let found: Vec<f32> = learner.steps.iter().flat_map(|step| step.critic.targets.clone()).collect();
    assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} {expected:?}");
}

#[test]
fn only_the_executed_action_has_a_gradient() {
    let mut learner: Ddqn = learner(&[]);
    let mut transitions = Transitions::random::<Ddqn>(3, 1);
    transitions.actions.fill(1.0);
    let biases = |learner: &mut Ddqn| -> Vec<f32> {
        let member = learner.networks.member(0);
        member.weights()[member.weights().len() - ACTIONS..].to_vec()
    };
    let before = biases(&mut learner);
    learner.update(&transitions.batch()).unwrap();
    let after = biases(&mut learner);
    assert_eq!((before[0], before[2]), (after[0], after[2]));
    assert_ne!(before[1], after[1]);
}

/// A corridor of four states, seen one-hot; moving right (2) from the last but one pays 1. Staying or moving left pays
/// nothing.
#[test]
fn the_learner_finds_the_way_through_a_corridor() {
    const STATES: usize = 4;
    let one_hot = |state: usize| (0..STATES).map(move |index| f32::from(index == state));
    let (mut observations, mut actions, mut rewards) = (Vec::new(), Vec::new(), Vec::new());
    let (mut next_observations, mut continuations) = (Vec::new(), Vec::new());
    for (state, action) in (0..STATES - 1).flat_map(|state| (0..ACTIONS).map(move |action| (state, action))) {
        let next = (state + action).saturating_sub(1);
        observations.extend(one_hot(state));
        actions.push(action as f32);
        rewards.push(f32::from(next == STATES - 1));
        next_observations.extend(one_hot(next));
        continuations.push(f32::from(next != STATES - 1));
    }
    let spaces =
        Spaces { observation: Space::Discrete { n: STATES }, action: Space::Discrete { n: ACTIONS } };
    let setup = Setup::with_spaces(1, 1, Host::silent(), spaces);
    let config = "(members: 3, hidden: [32, 32], rate: 3e-3, discount: 0.9, tau: 0.05)";
    let mut learner = Ddqn::create(DdqnConfig::parse(config).unwrap(), &setup).unwrap();
    let batch = Batch {
        size: actions.len(),
        observations: &observations,
        actions: &actions,
        rewards: &rewards,
        next_observations: &next_observations,
        continuations: &continuations,
        masks: &vec![1.0; actions.len() * 3],
    };
    (0..1000).for_each(|_| learner.update(&batch).unwrap());
    for state in 0..STATES - 1 {
        let observation: Vec<f32> = one_hot(state).collect();
        let (mut action, mut values) = ([9.0], [9.0; 3]);
        learner.act(&observation, ActMode::Greedy, &mut action).unwrap();
        assert_eq!(action, [2.0], "state {state}");
        learner.q_values(&observation, &[2.0], &mut values).unwrap();
        let expected = 0.9_f32.powi((STATES - 2 - state) as i32);
        assert!(values.iter().all(|value| (value - expected).abs() < 0.05), "{values:?} {expected}");
    }
}

#[test]
fn exploration_is_as_frequent_as_epsilon_says() {
    let settings = [("epsilon", "0.6"), ("final_epsilon", "0.15"), ("epsilon_steps", "10000")];
    let mut learner: Ddqn = learner(&settings);
    let greedy = act(&mut learner, ActMode::Greedy);
    let mut others = |steps: usize| {
        let count = (0..steps).filter(|_| act(&mut learner, ActMode::Explore) != greedy).count();
        count as f64 / steps as f64
    };
    // Two of three uniform actions differ from the greedy one.
    assert!((others(10_000) - 2.0 / 3.0 * 0.375).abs() < 0.02);
    assert!((others(10_000) - 2.0 / 3.0 * 0.15).abs() < 0.02);
}

#[test]
fn an_action_that_is_not_an_index_is_refused() {
    let mut learner: Ddqn = learner(&[]);
    for action in [0.5, 3.0, -1.0] {
        let error = learner.q_values(&[0.0; 3], &[action], &mut [0.0; 3]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument, "{action}");
        let mut transitions = Transitions::random::<Ddqn>(3, 1);
        transitions.actions[SIZE - 1] = action;
        assert_eq!(
            learner.update(&transitions.batch()).unwrap_err().kind(),
            ErrorKind::InvalidArgument,
            "{action}"
        );
    }
    assert_eq!(values(&mut learner).len(), 3);
    let mut gradients = [0.0; 3];
    let error = learner.q_gradients(&[0.0; 3], &[1.0], &mut [0.0; 3], &mut gradients).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
}
