//! What a success critic learns from, kept and read again: in other room, and of states that cannot be.

use super::*;

/// What [`DropIn`](crate::drop_in::DropIn) does with a state.
fn moved(saved: &Experience, capacity: usize, settings: UndoSettings) -> Experience {
    let mut rows = Vec::new();
    saved.write_rows(saved.kept(), &mut rows);
    let mut moved = memory(capacity, settings);
    moved.restore_undo(&saved.save_undo().unwrap()).unwrap();
    moved.replace(saved.kept(), &rows);
    moved
}

#[test]
fn outcomes_stay_with_their_steps_in_more_and_in_less_room() {
    for rounds in [1, 2, 3, 7, 20] {
        let mut saved = memory(38, EVERYTHING);
        for round in 0..rounds {
            steps(&mut saved, 2);
            attempt(&mut saved, 4, round % 2 == 0);
        }
        let labels_before = labels(&saved);
        for capacity in [38, 39, 1_000, 37, 25, 7, 1] {
            let found = labels(&moved(&saved, capacity, EVERYTHING));
            let mut expected = labels_before[labels_before.len().saturating_sub(capacity)..].to_vec();
            // Numbered anew, an attempt whose first steps are forgotten has lost its outcome.
            let is_cut = capacity > 38 && saved.kept().start > 0;
            let lost = if is_cut { 2 } else { 0 };
            expected[..lost].iter_mut().for_each(|label| (label.1, label.2) = (0.0, 0.0));
            assert_eq!(found, expected, "{rounds} rounds, room for {capacity}");
        }
    }
}

#[test]
fn the_newest_failures_stay_in_more_and_in_less_room() {
    let failures = UndoSettings { failure_share: 1.0, ..EVERYTHING };
    for attempts in [3, 10, 25] {
        let mut saved = memory(20, failures);
        // Each has the 19 steps before it in its window.
        for _ in 0..attempts {
            attempt(&mut saved, 2, false);
        }
        let store = |experience: &Experience| {
            let failures = &experience.undo.as_ref().unwrap().failures;
            (0..failures.len()).map(|index| failures.get(index).0[0]).collect::<Vec<_>>()
        };
        let before = store(&saved);
        assert!(before == store(&moved(&saved, 20, failures)));
        for capacity in [30, 19, 6, 2] {
            let mut loaded = moved(&saved, capacity, failures);
            let found = store(&loaded);
            let next = saved.undo.as_ref().unwrap().failures.save().next;
            let oldest = if before.len() < 20 { 0 } else { next };
            let in_order = [&before[oldest..], &before[..oldest]].concat();
            assert_eq!(found, in_order[before.len().saturating_sub(capacity)..], "room for {capacity}");
            // From here on it forgets as ever.
            (0..2 * capacity).for_each(|_| attempt(&mut loaded, 1, false));
            let newest = store(&loaded);
            assert!(newest.len() == capacity && newest.iter().all(|number| *number >= capacity as f32));
        }
    }
}

/// Draws from a memory with such a state, and notes further attempts.
fn use_it(mut experience: Experience) {
    for round in 0..30 {
        steps(&mut experience, 3);
        attempt(&mut experience, 2, round % 3 == 0);
        for row in draw(&experience, 32, round) {
            let shares = [row.fate[0], row.fate[1], row.outcome, row.weight];
            assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)), "{row:?}");
        }
    }
}

fn used() -> Experience {
    let shares = UndoSettings {
        bootstrap_probability: 0.5,
        failure_share: 0.3,
        success_share: 0.3,
        outcome_half_life: 3.0,
    };
    let mut experience = memory(60, shares);
    for round in 0..9 {
        steps(&mut experience, 3);
        attempt(&mut experience, 2, round % 2 == 0);
    }
    experience
}

#[test]
fn a_state_that_cannot_be_is_refused() {
    let good = used().save_undo().unwrap();
    let with = |change: &dyn Fn(&mut UndoMemoryState)| {
        let mut state = good.clone();
        change(&mut state);
        used().restore_undo(&state).is_ok()
    };
    assert!(with(&|_| ()));
    let changes: [&dyn Fn(&mut UndoMemoryState); 14] = [
        &|state| state.attempts[1].first = state.attempts[1].end + 1,
        &|state| state.attempts[1].before = Some(state.attempts[1].first),
        &|state| state.attempts[2].reached = Some(state.attempts[2].end),
        &|state| state.attempts[2].reached = Some(0),
        &|state| state.attempts.swap(0, 1),
        &|state| state.attempts[3].end = u64::MAX,
        &|state| state.failures.rows.truncate(3),
        &|state| state.failures.labels.truncate(3),
        &|state| state.failures.rows[0] = f32::NAN,
        &|state| state.failures.labels[0].weight = 1.5,
        &|state| state.failures.labels[0].outcome = f32::NAN,
        &|state| state.failures.labels[0].fate = -1.0,
        &|state| state.failures.labels[0].fate = f32::NAN,
        &|state| state.failures.next = usize::MAX,
    ];
    for (index, change) in changes.iter().enumerate() {
        assert!(!with(change), "change {index} was accepted");
    }
}

/// Whatever numbers a state has: it is refused, or what is drawn are shares, and nothing panics.
#[test]
fn no_state_makes_drawing_panic() {
    let mut random = Pcg64::seed_from_u64(8);
    let mut accepted = 0;
    for _ in 0..2_000 {
        let mut state = used().save_undo().unwrap();
        for _ in 0..random.random_range(1..4) {
            let number = match random.random_range(0..4) {
                0 => u64::MAX - random.random_range(0..3),
                1 => 1 << 40,
                _ => random.random_range(0..70),
            };
            let (attempts, labels) = (state.attempts.len(), state.failures.labels.len());
            let attempt = &mut state.attempts[random.random_range(0..attempts)];
            match random.random_range(0..11) {
                0 => attempt.first = number,
                1 => attempt.end = number,
                2 => attempt.before = Some(number),
                3 => attempt.reached = Some(number),
                4 => (attempt.succeeded, attempt.reached) = (!attempt.succeeded, None),
                5 => state.failures.labels[random.random_range(0..labels)].number = number,
                6 => state.failures.next = number as usize,
                7 => state.ended = number,
                8 => state.failures.labels[random.random_range(0..labels)].ended = number,
                // All of them lie beyond what is kept.
                9 => state.attempts.iter_mut().for_each(|attempt| {
                    let later = |own: u64| own.saturating_add(number / 4);
                    (attempt.first, attempt.end) = (later(attempt.first), later(attempt.end));
                    attempt.reached = attempt.reached.map(later);
                }),
                _ => state.attempts.push(Attempt { first: number, end: number, ..Attempt::default() }),
            }
        }
        // As a run goes on, whose rows are there before; and as a drop-in, into another room.
        let mut run = used();
        if run.restore_undo(&state).is_err() {
            continue;
        }
        accepted += 1;
        use_it(run);
        let (saved, mut rows) = (used(), Vec::new());
        saved.write_rows(saved.kept(), &mut rows);
        let mut drop_in = memory(random.random_range(20..80), EVERYTHING);
        drop_in.restore_undo(&state).unwrap();
        drop_in.replace(saved.kept(), &rows);
        use_it(drop_in);
    }
    assert!(accepted > 200, "only {accepted} states were tried");
}
