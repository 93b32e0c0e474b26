//! Tests that every learner for a box of actions passes, beside those of `conformance.rs`; included in the same way.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{ActMode, Batch, Host, Learner, Plugin, PluginConfig, Setup, Space, Spaces};

use actor_critic::{Noise, Normaliser, Policy, PolicyAgent};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::conformance::{
    OBSERVATION, SIZE, Settings, Subject, Transitions, act, config, learner, saved, train, values,
};
use super::gradients::{Inside, Networks, compare, enlarged, state};

/// The state of such a learner, as it is saved.
#[derive(Clone, Serialize, Deserialize)]
pub struct State<P> {
    pub actor: Networks,
    pub critics: Networks,
    pub noise: Noise,
    pub normaliser: Option<Normaliser>,
    pub rng: Pcg64,
    pub policy: P,
}

/// An action of [`spaces`] as the networks see it.
pub fn to_unit(action: &[f32]) -> [f32; 2] {
    [action[0] / 2.0, 2.0 * action[1] - 1.0]
}

/// A learner under test: what the others of its kind have otherwise.
pub trait Continuous: Learner + Plugin {
    /// How its state begins.
    const MAGIC: &'static [u8];
    /// How many networks one member consists of; its value is their smallest.
    const NETWORKS: usize;
    /// What is saved of its policy; `()` of a deterministic one.
    type Policy: Clone + Serialize + DeserializeOwned;
    /// As [`Subject::small`], of the fields that the others have with another default or not at all.
    fn own_small() -> Settings {
        Settings::new()
    }
    /// As [`Inside::plain`].
    fn plain() -> Settings {
        Settings::new()
    }
    /// As [`Subject::changes`], of the fields that the others have with another default or not at all.
    fn own_changes() -> Settings;
    /// As [`Subject::impossible`], of the fields that the others do not have.
    fn own_impossible() -> Settings {
        Settings::new()
    }
    /// As [`Subject::refused`].
    fn own_refused() -> &'static [&'static str] {
        &[]
    }
    /// As [`Inside::network_value`].
    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32;
}

/// [`Continuous::network_value`] where the networks are those of `actor-critic`.
pub fn network_value<P: Policy>(
    agent: &mut PolicyAgent<P>,
    network: usize,
    observation: &[f32],
    action: &[f32],
) -> f32 {
    let mut critic = agent.critics.member(network);
    critic.observe(observation);
    critic.values(&to_unit(action))[0]
}

/// Those settings that the learner has.
fn known<L: Plugin>(settings: Settings) -> Settings {
    let is_known = |name: &str| L::Config::FIELDS.iter().any(|field| field.name == name);
    settings.into_iter().filter(|(name, _)| is_known(name)).collect()
}

impl<L: Continuous> Subject for L {
    fn small() -> Settings {
        let mut small = L::own_small();
        small.extend(known::<L>(vec![
            ("critics", "3"),
            ("actor_hidden", "[20, 15]"),
            ("critic_hidden", "[20, 15]"),
            ("random_steps", "1"),
            ("final_sigma", "Some(0.02)"),
            ("sigma_steps", "7"),
        ]));
        small
    }

    fn changes() -> Settings {
        let mut changes = vec![
            ("critics", "4"),
            ("actor_hidden", "[20, 16]"),
            ("critic_hidden", "[20]"),
            ("action_layer", "0"),
            ("activation", "Relu"),
            ("initialisation", "FanIn"),
            ("layer_norm", "true"),
            ("dropout", "0.3"),
            ("weight_decay", "0.5"),
            ("actor_rate", "2e-3"),
            ("critic_rate", "3e-3"),
            ("discount", "0.9"),
            ("tau", "0.5"),
            ("noise", "OrnsteinUhlenbeck(theta: 0.5)"),
            ("sigma", "0.3"),
            ("final_sigma", "Some(0.05)"),
            ("sigma_steps", "5"),
            ("random_steps", "2"),
            ("initial_value", "Some(4.0)"),
            ("gradient_clip", "Some(1e-8)"),
            ("normalise_observations", "true"),
            ("valuation", "Half"),
        ];
        changes.extend(L::own_changes());
        changes
    }

    fn impossible() -> Settings {
        let mut impossible = vec![
            ("critics", "0"),
            ("actor_hidden", "[]"),
            ("critic_hidden", "[5, 0]"),
            ("actor_rate", "0.0"),
            ("critic_rate", "NaN"),
            ("discount", "1.5"),
            ("tau", "0.0"),
            ("tau", "1.5"),
            ("sigma", "-1.0"),
            ("final_sigma", "Some(NaN)"),
            ("noise", "OrnsteinUhlenbeck(theta: 2.0)"),
            ("initial_value", "Some(inf)"),
            ("gradient_clip", "Some(0.0)"),
            ("dropout", "1.0"),
            ("weight_decay", "-0.1"),
        ];
        impossible.extend(L::own_impossible());
        known::<L>(impossible)
    }

    fn refused() -> &'static [&'static str] {
        L::own_refused()
    }

    fn spaces() -> Spaces {
        spaces()
    }

    fn impossible_actions() -> Vec<Space> {
        vec![Space::Discrete { n: 4 }, Space::unbounded(2)]
    }
}

impl<L: Continuous> Inside for L {
    type State = State<L::Policy>;
    const MAGIC: &'static [u8] = <L as Continuous>::MAGIC;
    const NETWORKS: usize = <L as Continuous>::NETWORKS;

    fn plain() -> Settings {
        <L as Continuous>::plain()
    }

    fn critics(state: &mut Self::State) -> &mut Networks {
        &mut state.critics
    }

    fn actor(state: &mut Self::State) -> Option<&mut Networks> {
        Some(&mut state.actor)
    }

    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
        Continuous::network_value(self, network, observation, action)
    }

    fn next_value(&mut self, member: usize, observation: &[f32]) -> f32 {
        let mut action = [0.0; 2];
        self.act(observation, ActMode::Greedy, &mut action).unwrap();
        let networks = member * <L as Continuous>::NETWORKS..(member + 1) * <L as Continuous>::NETWORKS;
        let values = networks.map(|network| Continuous::network_value(self, network, observation, &action));
        values.fold(f32::INFINITY, f32::min)
    }
}

/// Observations without bounds; a box of actions that is neither symmetric nor square.
pub fn spaces() -> Spaces {
    let action = Space::Box { low: vec![-2.0, 0.0], high: vec![2.0, 1.0] };
    Spaces { observation: Space::unbounded(3), action }
}

pub fn actions_stay_in_their_box_whatever_the_noise<L: Subject>() {
    let mut learner: L = learner(&[("sigma", "5.0"), ("final_sigma", "None"), ("random_steps", "50")]);
    let actions: Vec<_> = (0..200).map(|_| act(&mut learner, ActMode::Explore)).collect();
    for action in &actions {
        spaces().action.check_action(action).unwrap();
    }
    let is_inside = |action: &&Vec<f32>| action[0].abs() < 2.0 && action[1] > 0.0 && action[1] < 1.0;
    assert_eq!(actions[..50].iter().filter(is_inside).count(), 50, "uniform actions reach the whole box");
    assert!(actions[50..].iter().filter(is_inside).count() < 50, "loud noise reaches the bounds");
}

pub fn gradients_match_finite_differences_of_the_values<L: Subject>() {
    let mut learner: L = learner(&[("critic_rate", "1e-2")]);
    (0..60).for_each(|_| train(&mut learner, 0..1));
    let (observation, action) = ([0.3, -0.2, 0.7], [0.5, 0.6]);
    let (mut plain, mut valued, mut gradients) = ([0.0; 3], [0.0; 3], [0.0; 6]);
    learner.q_values(&observation, &action, &mut plain).unwrap();
    learner.q_gradients(&observation, &action, &mut valued, &mut gradients).unwrap();
    assert_eq!(plain, valued);
    assert!(gradients.iter().any(|x| x.abs() > 0.05), "{gradients:?}");
    for dimension in 0..action.len() {
        const H: f32 = 0.02;
        let mut at = |shift: f32| {
            let (mut moved, mut values) = (action, [0.0; 3]);
            moved[dimension] += shift;
            learner.q_values(&observation, &moved, &mut values).unwrap();
            values
        };
        let (above, below) = (at(H), at(-H));
        for member in 0..3 {
            let expected = (above[member] - below[member]) / (2.0 * H);
            let found = gradients[member * action.len() + dimension];
            assert!((found - expected).abs() < 2e-3 + 0.01 * expected.abs(), "{found} against {expected}");
        }
    }
}

/// One step, reward −(a − 0.3)²: the value has its maximum at 0.3, and the actor must find it.
pub fn the_learner_finds_the_best_action_of_one_step<L: Subject>() {
    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
    let config = config::<L>(&[("actor_rate", "3e-3"), ("critic_rate", "1e-2")]);
    let setup = Setup::with_spaces(1, 1, Host::silent(), spaces);
    let mut learner = L::create(L::Config::parse(&config).unwrap(), &setup).unwrap();
    let mut rng = Pcg64::seed_from_u64(2);
    for _ in 0..600 {
        let actions: [f32; 32] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        learner
            .update(&Batch {
                size: 32,
                observations: &[1.0; 32],
                actions: &actions,
                rewards: &actions.map(|a| -(a - 0.3).powi(2)),
                next_observations: &[1.0; 32],
                continuations: &[0.0; 32],
                masks: &[1.0; 96],
            })
            .unwrap();
    }
    let mut action = [9.0];
    learner.act(&[1.0], ActMode::Greedy, &mut action).unwrap();
    assert!((action[0] - 0.3).abs() < 0.1, "{action:?}");
    let mut values = [9.0; 3];
    learner.q_values(&[1.0], &[-0.7], &mut values).unwrap();
    assert!(values.iter().all(|value| (value + 1.0).abs() < 0.2), "{values:?} instead of −1");
}

pub fn half_precision_values_are_close_follow_the_weights_and_allocate_nothing<L: Subject>() {
    let settings = [("initial_value", "Some(20.0)"), ("critic_rate", "1e-2"), ("initialisation", "FanIn")];
    let mut full: L = learner(&settings);
    let mut half: L = learner(&[&settings[..], &[("valuation", "Half")]].concat());
    for round in 0..3 {
        let (expected, found) = (values(&mut full), values(&mut half));
        assert_ne!(expected, found);
        for (expected, found) in expected.iter().zip(&found) {
            assert!((expected - found).abs() < 2e-3 * expected.abs().max(1.0), "{found} against {expected}");
        }
        for learner in [&mut full, &mut half] {
            train(learner, 10 * round..10 * round + 10);
        }
    }
    let trained = values(&mut half);
    half.load(&saved(&learner::<L>(&settings))).unwrap();
    assert_ne!(trained, values(&mut half), "the copies are those of the weights before");
    let mut out = [0.0; 3];
    let counted = allocation_counter::measure(|| half.q_values(&OBSERVATION, &[1.0; 2], &mut out).unwrap());
    assert_eq!(counted.count_total, 0);
}

/// The actor ascends the mean over the batch and over the members, of a pair its first network.
pub fn the_gradient_of_the_actor_is_that_of_the_ensembles_mean<L: Inside>() {
    let (mut learner, start) = enlarged::<L>();
    let transitions = Transitions::random::<L>(3, 1);
    learner.update(&transitions.batch()).unwrap();
    let mut after = state(&learner);
    let found = L::actor(&mut after).unwrap().first_gradient();
    compare(
        &mut learner,
        &start,
        |state| L::actor(state).unwrap(),
        &found,
        |learner, _| {
            let mut sum = 0.0;
            for observation in transitions.observations.chunks_exact(3) {
                let mut action = vec![0.0; L::spaces().action_len()];
                learner.act(observation, ActMode::Greedy, &mut action).unwrap();
                for member in 0..3 {
                    sum += f64::from(learner.network_value(member * L::NETWORKS, observation, &action));
                }
            }
            -sum / (3 * SIZE) as f64
        },
    );
}

/// A test for each function of this file.
macro_rules! continuous_tests {
    ($learner:ty) => {
        stochastic_tests!($learner);
        conformance_tests! { $learner, continuous:
            actions_stay_in_their_box_whatever_the_noise,
            the_gradient_of_the_actor_is_that_of_the_ensembles_mean,
        }
        conformance_tests! { $learner, gradients:
            the_gradient_of_the_critics_is_that_of_their_loss,
        }
    };
}

/// Those that hold for a stochastic policy as well.
macro_rules! stochastic_tests {
    ($learner:ty) => {
        conformance_tests! { $learner, continuous:
            gradients_match_finite_differences_of_the_values,
            the_learner_finds_the_best_action_of_one_step,
            half_precision_values_are_close_follow_the_weights_and_allocate_nothing,
        }
        conformance_tests! { $learner, gradients:
            n_critics_learn_what_n_single_ones_would,
        }
    };
}
