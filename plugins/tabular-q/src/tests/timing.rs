//! A measurement for the README; nothing that can fail.

use super::*;

#[test]
#[ignore = "a measurement: run with --release --nocapture"]
fn how_long_it_takes() {
    const STATES: usize = 25;
    let setup = setup(0, Space::Discrete { n: STATES }, Space::Discrete { n: 4 });
    let mut learner = TabularQ::create(TabularQConfig::default(), &setup).unwrap();
    let mut observations = vec![0.0; 16 * STATES];
    (0..16).for_each(|row| observations[row * STATES + row] = 1.0);
    let batch = Batch {
        size: 16,
        observations: &observations,
        actions: &[1.0; 16],
        rewards: &[0.5; 16],
        next_observations: &observations,
        continuations: &[1.0; 16],
        masks: &[1.0; 80],
    };
    let start = std::time::Instant::now();
    (0..100_000).for_each(|_| learner.update(&batch).unwrap());
    println!("update, 25 states, 5 members, batch 16: {:?}", start.elapsed() / 100_000);
    let start = std::time::Instant::now();
    let mut action = [0.0];
    (0..100_000).for_each(|_| learner.act(&observations[..STATES], ActMode::Explore, &mut action).unwrap());
    println!("act: {:?}", start.elapsed() / 100_000);
}
