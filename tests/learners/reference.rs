//! What `ddpg` and `td3` compute, for `ddpg-torch` and `td3-torch` to be compared with: `cargo xtask test --torch` lets the former write
//! their states before and after some updates, and the latter repeat these. Included as `conformance.rs` is.
#![allow(dead_code, reason = "one side writes, the other compares")]

use std::{
    env, fs,
    path::{Path, PathBuf},
};

use super::conformance::{learner, saved, train};
use super::gradients::{Inside, state};

/// Updates between the two states.
const UPDATES: u64 = 12;
/// Names the folder of the files with the states.
const FOLDER: &str = "SHIELD_REFERENCE_FOLDER";

/// The files with the states of the learner whose magic line this is.
fn files(folder: &Path, magic: &[u8]) -> [PathBuf; 2] {
    let name = String::from_utf8_lossy(magic).trim().replace('/', "-");
    ["before", "after"].map(|moment| folder.join(format!("{name}.{moment}")))
}

/// The states before and after the updates.
fn states<L: Inside>() -> [Vec<u8>; 2] {
    let mut learner: L = learner(&[("normalise_observations", "true")]);
    let before = saved(&learner);
    train(&mut learner, 0..UPDATES);
    [before, saved(&learner)]
}

/// Writes both states too, if a folder is named.
pub fn the_same_seed_learns_the_same_weights<L: Inside>() {
    let states = states::<L>();
    assert!(states == self::states::<L>());
    if let Some(folder) = env::var_os(FOLDER) {
        for (file, state) in files(Path::new(&folder), L::MAGIC).iter().zip(&states) {
            fs::write(file, state).unwrap();
        }
    }
}

/// Starts with the weights and the state of the reference, and ends with its state but for rounding.
pub fn the_updates_match_the_reference<L: Inside>() {
    let mut repeated: L = learner(&[("normalise_observations", "true")]);
    let folder = env::var_os(FOLDER).expect("`cargo xtask test --torch` names a folder");
    let [before, after] = files(Path::new(&folder), L::MAGIC);
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
