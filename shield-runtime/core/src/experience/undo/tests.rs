mod kept;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::Space;

use super::*;
use crate::experience::{AgentShare, Transition};

const EVERYTHING: UndoSettings = UndoSettings {
    bootstrap_probability: 1.0,
    failure_share: 0.0,
    success_share: 0.0,
    outcome_half_life: f64::INFINITY,
};

fn spaces() -> Spaces {
    Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) }
}

fn memory(capacity: usize, settings: UndoSettings) -> Experience {
    Experience::new(capacity, &spaces(), [1, 1], 1.0).unwrap().with_undo(settings).unwrap()
}

/// Stores a step whose observation is its number, which no agent learns from but the success critic.
fn push(experience: &mut Experience, fate: Option<Fate>) {
    let number = experience.next_number() as f32;
    let share = Some(AgentShare { reward: 0.0, continues: true });
    let transition = Transition {
        observation: &[number],
        action: &[0.5],
        next_observation: &[number + 0.5],
        forward: share,
        reset: share.filter(|_| fate.is_some()),
        fate,
    };
    experience.push(&transition, &mut Pcg64::seed_from_u64(0));
}

fn steps(experience: &mut Experience, count: usize) {
    (0..count).for_each(|_| push(experience, Some(Fate::GoesOn)));
}

/// An attempt of `length` steps after the last forward step, successful if it reached the reset set with its last step.
fn attempt(experience: &mut Experience, length: u64, succeeds: bool) {
    let first = experience.next_number();
    for step in 1..=length {
        let is_there = succeeds && step == length;
        push(experience, Some(if is_there { Fate::InResetSet } else { Fate::GoesOn }));
    }
    let end = first + length;
    experience.note_attempt(Attempt {
        before: first.checked_sub(1),
        first,
        end,
        reached: succeeds.then_some(end - 1),
        succeeded: succeeds,
        terminated: false,
    });
}

/// A row of a batch.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    observation: f32,
    fate: [f32; 2],
    outcome: f32,
    weight: f32,
    masks: [f32; 8],
}

fn draw(experience: &Experience, size: usize, seed: u64) -> Vec<Row> {
    let mut buffers = AttemptBuffers::new(size, &spaces(), 8);
    experience.sample_undo(&mut buffers, &mut Pcg64::seed_from_u64(seed));
    let batch = buffers.complete(|_, _| Ok(())).unwrap();
    (0..size)
        .map(|row| Row {
            observation: batch.observations[row],
            fate: [batch.successes[row], batch.continuations[row]],
            outcome: batch.outcomes[row],
            weight: batch.outcome_weights[row],
            masks: std::array::from_fn(|member| batch.masks[row * 8 + member]),
        })
        .collect()
}

/// What is drawn of each step, from the oldest to the newest: its outcome, and what that weighs.
fn labels(experience: &Experience) -> Vec<(f32, f32, f32)> {
    let mut drawn = draw(experience, 4_000, 1);
    drawn.sort_by(|left, right| left.observation.total_cmp(&right.observation));
    drawn.dedup_by_key(|row| row.observation);
    drawn.iter().map(|row| (row.observation, row.outcome, row.weight)).collect()
}

/// How many of the rows have an observation in `numbers`.
fn count(rows: &[Row], numbers: std::ops::Range<f32>) -> usize {
    rows.iter().filter(|row| numbers.contains(&row.observation)).count()
}

#[test]
fn an_outcome_fades_by_half_while_so_many_attempts_end() {
    let fading = UndoSettings { outcome_half_life: 4.0, failure_share: 0.5, ..EVERYTHING };
    // A success, and out of its reach a failure, which is drawn from the failures too.
    let mut experience = memory(1_000, fading);
    attempt(&mut experience, 1, true);
    steps(&mut experience, 29);
    attempt(&mut experience, 1, false);
    let weights = |experience: &Experience, number: f32| {
        let mut rows = draw(experience, 2_000, 2);
        rows.retain(|row| row.observation == number);
        rows.dedup_by_key(|row| row.weight);
        rows.iter().map(|row| row.weight).collect::<Vec<_>>()
    };
    // Steps alone make nothing old.
    steps(&mut experience, 100);
    let quarter = 0.25_f32.exp2();
    assert_eq!([weights(&experience, 0.0), weights(&experience, 30.0)], [[1.0 / quarter], [1.0]]);
    (0..4).for_each(|_| attempt(&mut experience, 1, true));
    assert_eq!([weights(&experience, 0.0), weights(&experience, 30.0)], [[0.5 / quarter], [0.5]]);
    // Also where the attempt itself is forgotten.
    steps(&mut experience, 1_000);
    (0..4).for_each(|_| attempt(&mut experience, 1, true));
    assert_eq!([weights(&experience, 0.0), weights(&experience, 30.0)], [vec![], vec![0.25]]);
    // And where it was kept.
    let mut read = memory(1_000, fading);
    read.restore_undo(&experience.save_undo().unwrap()).unwrap();
    let mut rows = Vec::new();
    experience.write_rows(experience.kept(), &mut rows);
    read.expect_rows(experience.kept());
    read.read_rows(experience.kept().start, &rows);
    assert_eq!(draw(&read, 200, 3), draw(&experience, 200, 3));
}

#[test]
fn a_batch_has_its_shares_around_failures_and_before_successes() {
    let shares = UndoSettings { failure_share: 0.25, success_share: 0.125, ..EVERYTHING };
    let mut experience = memory(100_000, shares);
    // Until something succeeded or failed, everything is drawn alike.
    steps(&mut experience, 20_000);
    assert_eq!(count(&draw(&experience, 64, 3), 0.0..20_000.0), 64);
    // Attempts that succeed after 50 steps, and later one that fails after 60.
    (0..3).for_each(|_| attempt(&mut experience, 50, true));
    steps(&mut experience, 20_000);
    attempt(&mut experience, 60, false);
    steps(&mut experience, 20_000);
    let (mut of_failure, mut of_success) = (0, 0);
    for seed in 0..100 {
        let rows = draw(&experience, 64, seed);
        // The last 20 steps of the success, and 20 steps before and after the start of the failure.
        let failure = count(&rows, 40_130.0..40_170.0);
        let success: usize =
            [20_050.0, 20_100.0, 20_150.0].iter().map(|end| count(&rows, end - 20.0..*end)).sum();
        assert!((16..19).contains(&failure) && (8..11).contains(&success), "{failure} and {success} rows");
        (of_failure, of_success) = (of_failure + failure, of_success + success);
    }
    // 4,000 uniform draws from 60,210 steps add few of these 40 and 60.
    assert!((1_600..1_615).contains(&of_failure) && (800..815).contains(&of_success));
}

#[test]
fn the_share_of_successes_is_drawn_uniformly_where_there_is_none() {
    let shares = UndoSettings { failure_share: 0.0, success_share: 1.0, ..EVERYTHING };
    let mut experience = memory(1_000, shares);
    steps(&mut experience, 500);
    attempt(&mut experience, 5, false);
    let rows = draw(&experience, 200, 4);
    assert!(count(&rows, 0.0..250.0) > 50 && count(&rows, 250.0..505.0) > 50);
}

#[test]
fn failures_are_still_drawn_when_the_memory_has_forgotten_them() {
    let shares = UndoSettings { failure_share: 0.5, ..EVERYTHING };
    let mut experience = memory(100, shares);
    steps(&mut experience, 10);
    attempt(&mut experience, 3, false);
    let before = draw(&experience, 400, 5);
    steps(&mut experience, 1_000);
    assert_eq!(experience.kept(), 913..1_013);
    let rows = draw(&experience, 400, 5);
    assert_eq!((count(&rows, 0.0..13.0), count(&rows, 913.0..1_013.0)), (200, 200));
    // They keep where they led, and their outcomes.
    for row in rows.iter().filter(|row| row.observation < 13.0) {
        let then = before.iter().find(|then| then.observation == row.observation).unwrap();
        assert_eq!(row, then);
    }
    // 0 to 2 steps of it fit behind the first 98 failures; then the oldest give way.
    for _ in 0..97 {
        attempt(&mut experience, 1, false);
    }
    assert_eq!(experience.undo.as_ref().unwrap().failures.len(), 100);
    assert_eq!(count(&draw(&experience, 400, 6), 0.0..13.0), 0);
}

#[test]
fn actions_that_were_never_executed_are_drawn_in_no_stratum() {
    let shares = UndoSettings { failure_share: 0.3, success_share: 0.3, ..EVERYTHING };
    let mut experience = memory(50, shares);
    for round in 0..40 {
        steps(&mut experience, 1);
        (0..3).for_each(|_| push(&mut experience, None));
        attempt(&mut experience, 2, round % 2 == 0);
        for row in draw(&experience, 64, round) {
            let is_abort = (1..4).contains(&(row.observation as u32 % 6));
            assert!(!is_abort, "step {} was never made", row.observation);
        }
        // Three of six are executed.
        let kept = experience.kept();
        let executed = kept.filter(|number| !(1..4).contains(&(number % 6))).count();
        assert_eq!(experience.len_for_undo(), executed);
    }
}

#[test]
fn the_step_before_an_abort_has_the_outcome_of_the_attempt_after_it() {
    let mut experience = memory(1_000, EVERYTHING);
    steps(&mut experience, 2);
    push(&mut experience, None);
    experience.note_attempt(Attempt {
        before: Some(1),
        first: 3,
        end: 3,
        reached: None,
        succeeded: false,
        terminated: true,
    });
    assert_eq!(labels(&experience), [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0)]);
}

#[test]
fn a_member_learns_from_a_transition_each_time_or_never() {
    let masked = UndoSettings { bootstrap_probability: 0.7, failure_share: 0.25, ..EVERYTHING };
    let filled = || {
        let mut experience = memory(2_000, masked);
        steps(&mut experience, 1_000);
        attempt(&mut experience, 5, false);
        experience
    };
    let (experience, mut masks) = (filled(), [None; 1_005]);
    for seed in 0..20 {
        for row in draw(&experience, 1_000, seed) {
            let known = masks[row.observation as usize].get_or_insert(row.masks);
            assert_eq!(*known, row.masks, "step {}", row.observation);
        }
    }
    for row in draw(&filled(), 1_000, 21) {
        assert_eq!(masks[row.observation as usize].unwrap_or(row.masks), row.masks, "in another run");
    }
    let masks: Vec<[f32; 8]> = masks.into_iter().flatten().collect();
    for member in 0..8 {
        let learned = masks.iter().filter(|mask| mask[member] == 1.0).count() as f64 / masks.len() as f64;
        assert!((0.64..0.76).contains(&learned), "member {member} learns from {learned}");
        for other in 0..member {
            let both = masks.iter().filter(|mask| mask[member] == mask[other]).count() as f64;
            // Independent masks agree with probability 0.7² + 0.3².
            assert!((0.51..0.65).contains(&(both / masks.len() as f64)), "members {member} and {other}");
        }
    }
    // Where every member learns from everything, no mask is 0.
    let mut all = memory(10, EVERYTHING);
    steps(&mut all, 10);
    assert!(draw(&all, 50, 0).iter().all(|row| row.masks == [1.0; 8]));
}
