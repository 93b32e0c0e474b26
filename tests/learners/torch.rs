//! Twelve updates of a learner, held against those of torch: `torch_reference.py` beside this file, whose formulas are repeated here.
//! Included as `conformance.rs` is.
#![allow(dead_code, reason = "noise is for stochastic policies")]

use std::collections::BTreeMap;

use rand_pcg::Pcg64;
use serde::Deserialize;
use shield_api::{Batch, Host, PluginConfig, Setup};

use super::conformance::{SIZE, Settings, Subject};
use super::continuous::{Continuous, State};
use super::gradients::{put, state};

/// What torch found.
#[derive(Deserialize)]
pub struct Reference {
    critics: Vec<f32>,
    targets: Option<Vec<f32>>,
    actor: Vec<f32>,
    /// log α, of a policy that has it.
    pub log_temperature: Option<f32>,
}

/// A batch, and the noise of the policy's actions in the states that followed and in its own.
pub struct Given<'a> {
    pub batch: Batch<'a>,
    pub noise: [Vec<f32>; 2],
}

fn number(index: usize, seed: u64) -> f64 {
    let mixed = (index as u64 * 2_654_435_761 + seed * 40_503 + 12_345) % 4_294_967_296;
    (mixed / 128 % 2000) as f64 / 1000.0 - 1.0
}

fn numbers(length: usize, seed: u64) -> Vec<f32> {
    (0..length).map(|index| number(index, seed) as f32).collect()
}

/// Settings of the reference.
fn settings(own: &[(&'static str, &'static str)]) -> String {
    let mut fields: Settings = vec![
        ("critics", "1"),
        ("actor_hidden", "[8, 6]"),
        ("critic_hidden", "[8, 6]"),
        ("activation", "Relu"),
        ("actor_rate", "1e-3"),
        ("critic_rate", "1e-3"),
        ("loss", "Squared"),
    ];
    fields.extend(own);
    let fields: Vec<String> = fields.iter().map(|(name, value)| format!("{name}: {value}")).collect();
    format!("({})", fields.join(", "))
}

/// Replaces the affine parts of networks with `layers` of (inputs, outputs, values of normalisations that follow) by the formula.
fn fill(weights: &mut [f32], first_seed: u64, layers: &[(usize, usize, usize)]) {
    let length: usize = layers.iter().map(|(inputs, outputs, rest)| (inputs + 1) * outputs + rest).sum();
    for (network, weights) in weights.chunks_exact_mut(length).enumerate() {
        let (mut place, mut drawn) = (0, 0);
        for (inputs, outputs, rest) in layers {
            for weight in &mut weights[place..place + (inputs + 1) * outputs] {
                *weight = (0.5 * f64::from(number(drawn, first_seed + network as u64) as f32)) as f32;
                drawn += 1;
            }
            place += (inputs + 1) * outputs + rest;
        }
    }
}

/// Repeats the case `name`, in which the action enters a critic at layer `join`, with `update`, and returns the learner and what else torch found.
pub fn check<L>(
    name: &str,
    own: &[(&'static str, &'static str)],
    join: usize,
    mut update: impl FnMut(&mut L, &L::Config, &Given<'_>),
) -> (L, Reference)
where
    L: Continuous + Subject,
{
    let mut all: BTreeMap<String, Reference> =
        serde_json::from_str(include_str!("torch_reference.json")).unwrap();
    let expected = all.remove(name).unwrap();
    let setup = Setup::with_spaces(5, 1, Host::silent(), L::spaces());
    let mut learner = L::create(L::Config::parse(&settings(own)).unwrap(), &setup).unwrap();
    let config = L::Config::parse(&settings(own)).unwrap();

    let mut start: State<L::Policy> = state(&learner);
    let outputs = if expected.log_temperature.is_some() { 4 } else { 2 };
    let (layer_norm, batch_renorm) = (name.ends_with("regularised"), name == "crossq");
    let renorm = |inputs: usize| if batch_renorm { 4 * inputs } else { 0 };
    let norm = |outputs: usize| if layer_norm { 2 * outputs } else { 0 };
    let inputs = if join == 0 { [5, 8, 6] } else { [3, 10, 6] };
    let critic = [
        (inputs[0], 8, norm(8) + renorm(inputs[0])),
        (inputs[1], 6, norm(6) + renorm(inputs[1])),
        (inputs[2], 1, renorm(inputs[2])),
    ];
    let actor = [(3, 8, renorm(3)), (8, 6, renorm(8)), (6, outputs, renorm(6))];
    fill(&mut start.critics.weights, 1, &critic);
    fill(&mut start.actor.weights, 9, &actor);
    start.critics.targets.clone_from(&start.critics.weights);
    start.actor.targets.clone_from(&start.actor.weights);
    start.rng = Pcg64::new(1, 2);
    put(&mut learner, &start);

    for step in 0..12 {
        let seed = 10 * step;
        let to_box = |unit: Vec<f32>| -> Vec<f32> {
            unit.chunks_exact(2).flat_map(|a| [2.0 * a[0], 0.5 * a[1] + 0.5]).collect()
        };
        let batch = Batch {
            size: SIZE,
            observations: &numbers(3 * SIZE, seed + 1),
            actions: &to_box(numbers(2 * SIZE, seed + 2)),
            rewards: &numbers(SIZE, seed + 3),
            next_observations: &numbers(3 * SIZE, seed + 4),
            continuations: &std::array::from_fn::<f32, SIZE, _>(|row| f32::from(row != 2)),
            masks: &[1.0; SIZE],
        };
        let noise = [numbers(2 * SIZE, seed + 5), numbers(2 * SIZE, seed + 6)];
        update(&mut learner, &config, &Given { batch, noise });
    }
    let found: State<L::Policy> = state(&learner);
    close("critics", &found.critics.weights, &expected.critics, &start.critics.weights);
    close("actor", &found.actor.weights, &expected.actor, &start.actor.weights);
    if let Some(targets) = &expected.targets {
        close("target critics", &found.critics.targets, targets, &start.critics.targets);
    }
    (learner, expected)
}

fn close(what: &str, found: &[f32], expected: &[f32], start: &[f32]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let largest = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(largest(start, expected) > 1e-4, "{what}: nothing was learned");
    let error = largest(found, expected);
    assert!(error < 1e-5, "{what}: {error:e}");
}
