//! What `ddpg` and `td3` compute, for `ddpg-torch` and `td3-torch` to be compared with: `cargo xtask test --torch` lets the former write
//! their states before and after some updates, and the latter repeat these. Included as `conformance.rs` is.
#![allow(dead_code, reason = "one side writes, the other compares")]

use std::{env, fs, path::PathBuf};

use super::conformance::{learner, saved, train};
use super::gradients::{Inside, state};

/// Updates between the two states.
const UPDATES: u64 = 12;

/// The files with the states of the learner whose magic line this is.
fn files(magic: &[u8]) -> [PathBuf; 2] {
    let folder = env::var_os("SHIELD_REFERENCE_FOLDER").expect("`cargo xtask test --torch` names a folder");
    let name = String::from_utf8_lossy(magic).trim().replace('/', "-");
    ["before", "after"].map(|moment| PathBuf::from(&folder).join(format!("{name}.{moment}")))
}

/// Writes both states.
pub fn a_reference_is_written<L: Inside>() {
    let mut learner: L = learner(&[("normalise_observations", "true")]);
    let [before, after] = files(L::MAGIC);
    fs::write(before, saved(&learner)).unwrap();
    train(&mut learner, 0..UPDATES);
    fs::write(after, saved(&learner)).unwrap();
}

/// Starts with the weights and the state of the reference, and ends with its state but for rounding.
pub fn the_reference_computes_something_else<L: Inside>() {
    let mut repeated: L = learner(&[("normalise_observations", "true")]);
    let [before, after] = files(L::MAGIC);
    let before = fs::read(before).unwrap();
    assert!(saved(&repeated) == before, "the same seed draws other weights");
    train(&mut repeated, 0..UPDATES);
    let mut expected: L = learner(&[("normalise_observations", "true")]);
    expected.load(&fs::read(after).unwrap()).unwrap();
    let (mut found, mut expected) = (state(&repeated), state(&expected));
    let pairs = [
        (L::critics(&mut found).clone(), L::critics(&mut expected).clone()),
        (L::actor(&mut found).unwrap().clone(), L::actor(&mut expected).unwrap().clone()),
    ];
    for (found, expected) in pairs {
        assert_eq!(found.steps, expected.steps);
        let moved = found.weights.iter().zip(&found.targets).any(|(weight, target)| weight != target);
        assert!(moved, "nothing was learned");
        for (found, expected) in [(found.weights, expected.weights), (found.targets, expected.targets)] {
            let largest = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            // A step of Adam is 1e-3 long at first, whatever the size of the gradient.
            assert!(largest < 2e-5, "{largest}");
        }
    }
}
