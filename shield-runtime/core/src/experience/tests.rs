use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::Space;

use super::*;

fn spaces() -> Spaces {
    Spaces { observation: Space::unbounded(2), action: Space::uniform(1, -1.0, 1.0) }
}

fn push(experience: &mut Experience, value: f32, rng: &mut Pcg64) {
    experience.push(
        &Transition {
            observation: &[value, -value],
            action: &[value / 10.0],
            next_observation: &[value + 1.0, 0.0],
            forward: Some(AgentShare { reward: value, continues: true }),
            reset: Some(AgentShare { reward: -value, continues: value != 3.0 }),
            fate: Some(Fate::GoesOn),
        },
        rng,
    );
}

#[test]
fn each_agent_gets_its_own_reward_and_continuation() {
    let mut rng = Pcg64::seed_from_u64(0);
    let mut experience = Experience::new(10, &spaces(), [1, 1], 1.0).unwrap();
    push(&mut experience, 3.0, &mut rng);
    let mut buffers = BatchBuffers::new(4, &spaces(), 1);
    let forward = experience.sample(AgentRole::Forward, &mut buffers, &mut rng);
    assert_eq!((forward.rewards[0], forward.continuations[0]), (3.0, 1.0));
    assert_eq!((forward.observations, forward.actions[3]), (&[3.0, -3.0].repeat(4)[..], 0.3));
    let reset = experience.sample(AgentRole::Reset, &mut buffers, &mut rng);
    assert_eq!((reset.rewards[2], reset.continuations[2], reset.masks[2]), (-3.0, 0.0, 1.0));
}

#[test]
fn a_replay_buffer_without_room_is_refused() {
    for capacity in [usize::MAX, usize::MAX / 8] {
        assert!(Experience::new(capacity, &spaces(), [1, 1], 1.0).is_err());
    }
}

#[test]
fn a_full_replay_buffer_forgets_the_oldest_transitions() {
    let mut rng = Pcg64::seed_from_u64(1);
    let mut experience = Experience::new(3, &spaces(), [1, 1], 1.0).unwrap();
    for value in 0..7 {
        push(&mut experience, value as f32, &mut rng);
    }
    assert_eq!(experience.len(), 3);
    let mut buffers = BatchBuffers::new(200, &spaces(), 1);
    let batch = experience.sample(AgentRole::Forward, &mut buffers, &mut rng);
    let mut kept: Vec<f32> = batch.rewards.to_vec();
    kept.sort_by(f32::total_cmp);
    kept.dedup();
    assert_eq!(kept, [4.0, 5.0, 6.0]);
}

#[test]
fn a_restored_replay_buffer_continues_as_the_saved_one() {
    let mut rng = Pcg64::seed_from_u64(3);
    for count in [0, 2, 3, 7] {
        let mut experience = Experience::new(3, &spaces(), [70, 1], 0.5).unwrap();
        (0..count).for_each(|value| push(&mut experience, value as f32, &mut rng));
        let mut bytes = Vec::new();
        let kept = experience.kept();
        experience.write_rows(kept.clone(), &mut bytes);
        let mut read = Experience::new(3, &spaces(), [70, 1], 0.5).unwrap();
        read.expect_rows(kept.clone());
        read.read_rows(kept.start, &bytes);
        push(&mut experience, 99.0, &mut rng.clone());
        push(&mut read, 99.0, &mut rng.clone());
        assert_eq!(format!("{experience:?}"), format!("{read:?}"), "after {count}");
    }
}

#[test]
fn observations_kept_as_bytes_are_whole_take_a_fourth_and_survive_a_checkpoint() {
    let mut rng = Pcg64::seed_from_u64(5);
    let memory = |kept| Experience::new(3, &spaces(), [1, 1], 1.0).unwrap().keeping(kept).unwrap();
    let mut bytes = memory(Kept::Bytes);
    for value in [200.0, 7.4, 300.0, 20.0] {
        push(&mut bytes, value, &mut rng);
    }
    let mut buffers = BatchBuffers::new(64, &spaces(), 1);
    let batch = bytes.sample(AgentRole::Forward, &mut buffers, &mut rng);
    for (row, reward) in batch.rewards.iter().enumerate() {
        let whole = reward.round().min(255.0);
        assert_eq!(batch.observations[2 * row..2 * row + 2], [whole, 0.0], "below 0 there is no byte");
    }
    assert_eq!(memory(Kept::Floats).row_bytes() - bytes.row_bytes(), 2 * 2 * 3);
    let mut rows = Vec::new();
    bytes.write_rows(bytes.kept(), &mut rows);
    let mut read = memory(Kept::Bytes);
    read.expect_rows(bytes.kept());
    read.read_rows(bytes.kept().start, &rows);
    assert_eq!(format!("{bytes:?}"), format!("{read:?}"));
    let image = Space::Box { low: vec![0.0; 2], high: vec![255.0; 2] };
    assert!(Kept::Bytes.check(&image).is_ok() && Kept::Bytes.check(&spaces().observation).is_err());
    let sizes =
        [Kept::Bytes, Kept::Floats].map(|kept| Experience::bytes_when_full(10, kept, &spaces(), false));
    assert_eq!(sizes, [10 * (4 + 6 * 4), 10 * (16 + 6 * 4)]);
}

#[test]
fn bootstrap_masks_are_drawn_per_member_and_stay_with_their_transition() {
    let mut rng = Pcg64::seed_from_u64(2);
    let members = 70;
    let mut experience = Experience::new(1, &spaces(), [members, 1], 0.5).unwrap();
    push(&mut experience, 1.0, &mut rng);
    let mut buffers = BatchBuffers::new(2, &spaces(), members);
    let first = experience.sample(AgentRole::Forward, &mut buffers, &mut rng).masks.to_vec();
    assert_eq!(first[..members], first[members..]);
    let ones = first[..members].iter().sum::<f32>();
    assert!((15.0..55.0).contains(&ones), "{ones} of {members} masks are set at probability 0.5");
}

#[test]
fn an_abort_teaches_for_its_lifetime() {
    let mut rng = Pcg64::seed_from_u64(4);
    let abort = |value: f32| Transition {
        observation: &[0.0, 0.0],
        action: &[0.0],
        next_observation: &[0.0, 0.0],
        forward: Some(AgentShare { reward: value, continues: false }),
        reset: None,
        fate: None,
    };
    for (lifetime, expected) in
        [(None, &[-2.0, -1.0, 1.0, 2.0, 3.0, 4.0][..]), (Some(5), &[-2.0, 1.0, 2.0, 3.0, 4.0])]
    {
        let experience = Experience::new(6, &spaces(), [1, 1], 1.0).unwrap();
        let mut experience = experience.with_abort_lifetime(lifetime);
        // The ring is full and has begun anew.
        push(&mut experience, 9.0, &mut rng);
        experience.push(&abort(-1.0), &mut rng);
        push(&mut experience, 1.0, &mut rng);
        push(&mut experience, 2.0, &mut rng);
        experience.push(&abort(-2.0), &mut rng);
        push(&mut experience, 3.0, &mut rng);
        push(&mut experience, 4.0, &mut rng);
        let mut buffers = BatchBuffers::new(200, &spaces(), 1);
        let batch = experience.sample(AgentRole::Forward, &mut buffers, &mut rng);
        let mut drawn = batch.rewards.to_vec();
        drawn.sort_by(f32::total_cmp);
        drawn.dedup();
        assert_eq!(drawn, expected, "{lifetime:?}");
    }
}
