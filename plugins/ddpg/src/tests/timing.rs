//! A measurement for the README; nothing that can fail.

use super::*;

#[test]
#[ignore = "a measurement: run with --release --nocapture --test-threads 1"]
fn how_long_it_takes() {
    const SIZE: usize = 64;
    let action = Space::uniform(6, -1.0, 1.0);
    let spaces = Spaces { observation: Space::unbounded(18), action };
    let mut rng = Pcg64::seed_from_u64(0);
    let mut floats = |length| (0..length).map(|_| rng.random_range(0.0..1.0)).collect::<Vec<f32>>();
    let (observations, actions, rewards) = (floats(SIZE * 18), floats(SIZE * 6), floats(SIZE));
    let batch = Batch {
        size: SIZE,
        observations: &observations,
        actions: &actions,
        rewards: &rewards,
        next_observations: &observations,
        continuations: &[1.0; SIZE],
        masks: &[1.0; SIZE * 20],
    };
    for threads in [1, 2] {
        let setup = Setup::with_spaces(0, threads, Host::silent(), spaces.clone());
        let config = DdpgConfig { random_steps: 0, ..DdpgConfig::default() };
        let mut learner = Ddpg::create(config, &setup).unwrap();
        let (mut values, mut gradients, mut action) = ([0.0; 20], [0.0; 120], [0.0; 6]);
        let mut report = |name: &str, repeats: usize, work: &mut dyn FnMut(&mut Ddpg)| {
            let mut times: Vec<_> = (0..repeats)
                .map(|_| {
                    let start = std::time::Instant::now();
                    work(&mut learner);
                    start.elapsed()
                })
                .collect();
            times.sort();
            println!("{name}, {threads} threads: median {:?}, best {:?}", times[repeats / 2], times[0]);
        };
        let (observation, proposed) = (&observations[..18], &actions[..6]);
        report("update", 200, &mut |learner| learner.update(&batch).unwrap());
        report("act", 2000, &mut |learner| {
            learner.act(observation, ActMode::Explore, &mut action).unwrap();
        });
        report("q_values", 2000, &mut |learner| {
            learner.q_values(observation, proposed, &mut values).unwrap();
        });
        report("q_gradients", 2000, &mut |learner| {
            learner.q_gradients(observation, proposed, &mut values, &mut gradients).unwrap();
        });
    }
}
