//! What one update does, held against the definition: its gradients against finite differences of its losses, and n critics against n
//! single ones. Included as `conformance.rs` is.

use actor_critic::{read_state, write_state};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::conformance::{SIZE, Settings, Subject, Transitions, learner, saved, train};

/// Half the distance of a finite difference.
const H: f32 = 5e-3;

/// The state of some networks, as it is saved.
#[derive(Clone, Serialize, Deserialize)]
pub struct Networks {
    pub weights: Vec<f32>,
    pub targets: Vec<f32>,
    pub first_moments: Vec<f32>,
    pub second_moments: Vec<f32>,
    pub steps: u64,
}

impl Networks {
    /// As if trained: an untrained last layer is nearly zero, and with it every other gradient. Target networks are the same.
    fn enlarge(&mut self) {
        for (index, weight) in self.weights.iter_mut().enumerate() {
            *weight = ((index * 7919 % 1000) as f32 / 1000.0 - 0.5) * 0.9;
        }
        self.targets.clone_from(&self.weights);
    }

    /// One of `count` equal runs of networks.
    fn part(&self, index: usize, count: usize) -> Self {
        let part = |values: &[f32]| values.chunks_exact(values.len() / count).nth(index).unwrap().to_vec();
        Self {
            weights: part(&self.weights),
            targets: part(&self.targets),
            first_moments: part(&self.first_moments),
            second_moments: part(&self.second_moments),
            steps: self.steps,
        }
    }

    /// The gradient of the first step ever: Adam's first moment is (1 − β₁) g then.
    pub fn first_gradient(&self) -> Vec<f32> {
        assert_eq!(self.steps, 1);
        self.first_moments.iter().map(|moment| moment / 0.1).collect()
    }
}

/// A learner that can be looked into.
pub trait Inside: Subject {
    /// Its state, as it is saved.
    type State: Clone + Serialize + DeserializeOwned;
    /// How the state begins.
    const MAGIC: &'static [u8];
    /// How many networks one member consists of.
    const NETWORKS: usize;
    /// Settings with which an update draws no random number and teaches every network.
    fn plain() -> Settings;
    /// The Q-networks of a state.
    fn critics(state: &mut Self::State) -> &mut Networks;
    /// The actor of a state, if there is one.
    fn actor(state: &mut Self::State) -> Option<&mut Networks>;
    /// A network's value of one (s, a).
    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32;
    /// The value of the next state from which a member learns, where the target networks equal the networks.
    fn next_value(&mut self, member: usize, observation: &[f32]) -> f32;
}

/// The learner's state.
pub fn state<L: Inside>(learner: &L) -> L::State {
    read_state(L::MAGIC, &saved(learner)).unwrap()
}

/// Gives the learner a state.
pub fn put<L: Inside>(learner: &mut L, state: &L::State) {
    let mut bytes = Vec::new();
    write_state(L::MAGIC, state, &mut bytes).unwrap();
    learner.load(&bytes).unwrap();
}

/// A learner as if trained, before its first update, and its state.
pub fn enlarged<L: Inside>() -> (L, L::State) {
    let mut settings = L::plain();
    settings.push(("loss", "Squared"));
    let mut learner: L = learner(&settings);
    let mut start = state(&learner);
    L::critics(&mut start).enlarge();
    if let Some(actor) = L::actor(&mut start) {
        actor.enlarge();
    }
    put(&mut learner, &start);
    (learner, start)
}

/// Central differences of `f` in every fifth of the weights that `networks` finds, against `found`.
pub fn compare<L: Inside>(
    learner: &mut L,
    start: &L::State,
    networks: impl Fn(&mut L::State) -> &mut Networks,
    found: &[f32],
    mut f: impl FnMut(&mut L, usize) -> f64,
) {
    let largest = found.iter().fold(0.0_f32, |largest, x| largest.max(x.abs()));
    assert!(largest > 0.01, "nothing to compare");
    for index in (0..found.len()).step_by(5) {
        let mut at = |shift: f32| {
            let mut moved = start.clone();
            networks(&mut moved).weights[index] += shift;
            put(learner, &moved);
            f(learner, index)
        };
        let expected = ((at(H) - at(-H)) / f64::from(2.0 * H)) as f32;
        let error = (found[index] - expected).abs();
        assert!(
            error < 2e-3 * largest + 1e-2 * expected.abs(),
            "{index}: {} against {expected}",
            found[index]
        );
    }
}

pub fn the_gradient_of_the_critics_is_that_of_their_loss<L: Inside>() {
    let (mut learner, start) = enlarged::<L>();
    let transitions = Transitions::random::<L>(3, 1);
    let batch = transitions.batch();
    let discount = learner.info().discount;
    let observation = |rows: &[f32], row: usize| rows[row * 3..(row + 1) * 3].to_vec();
    let targets: Vec<Vec<f32>> = (0..3)
        .map(|member| {
            let target = |row: usize| {
                let next = learner.next_value(member, &observation(batch.next_observations, row));
                batch.rewards[row] + discount * batch.continuations[row] * next
            };
            (0..SIZE).map(target).collect()
        })
        .collect();
    learner.update(&batch).unwrap();
    let mut after = state(&learner);
    let found = L::critics(&mut after).first_gradient();
    let length = found.len() / (3 * L::NETWORKS);
    let action_len = batch.actions.len() / SIZE;
    compare(&mut learner, &start, L::critics, &found, |learner, index| {
        let (network, member) = (index / length, index / length / L::NETWORKS);
        let (mut loss, mut rows) = (0.0, 0.0);
        for row in (0..SIZE).filter(|row| batch.masks[row * 3 + member] == 1.0) {
            let action = &batch.actions[row * action_len..(row + 1) * action_len];
            let value = learner.network_value(network, &observation(batch.observations, row), action);
            loss += 0.5 * f64::from(value - targets[member][row]).powi(2);
            rows += 1.0;
        }
        loss / rows
    });
}

pub fn n_critics_learn_what_n_single_ones_would<L: Inside>() {
    let mut together: L = learner(&[]);
    train(&mut together, 0..5);
    let before = state(&together);
    let transitions = Transitions::random::<L>(3, 9);
    together.update(&transitions.batch()).unwrap();
    let mut after = state(&together);
    for member in 0..3 {
        let mut alone: L = learner(&[(L::changes()[0].0, "1")]);
        let mut own = before.clone();
        *L::critics(&mut own) = L::critics(&mut own).part(member, 3);
        put(&mut alone, &own);
        let masks = transitions.masks.iter().skip(member).step_by(3).copied().collect();
        alone.update(&Transitions { masks, ..Transitions::random::<L>(3, 9) }.batch()).unwrap();
        let (found, expected) =
            (L::critics(&mut state(&alone)).clone(), L::critics(&mut after).part(member, 3));
        assert!(found.weights == expected.weights, "weights of member {member}");
        assert!(found.targets == expected.targets, "target weights of member {member}");
        assert!(found.second_moments == expected.second_moments, "moments of member {member}");
    }
}
