//! What was learned and counted, in files.

use super::*;

#[test]
fn loading_requires_a_hard_reset_and_refuses_the_file_of_another_shield() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    let agent = || Scripted::acting(|_, _| -1.0);
    drop_in_files::save(&mut builder(agent()).build().unwrap(), &file).unwrap();
    let load = |shield: DropInBuilder| {
        let mut drop_in = shield.build().unwrap();
        drop_in.hard_reset_done(&[0.0]).unwrap();
        let loaded = drop_in_files::load(&mut drop_in, &file);
        assert!(drop_in.needs_hard_reset());
        loaded.map_err(|error| error.to_string())
    };
    assert_eq!(load(builder(agent())), Ok(()));
    let two = load(builder(agent()).rule(moderate())).unwrap_err();
    assert!(two.contains("the states of 1 rules; here there are 2"), "{two}");
    let learning = learning(Updates::Both, Endings::default());
    let learns = load(builder(agent()).learning(learning)).unwrap_err();
    assert!(learns.contains("this shield has a memory"), "{learns}");
    let spaces = Spaces { action: Space::Box { low: vec![-9.0], high: vec![9.0] }, ..spaces() };
    let other = DropIn::builder(spaces, Box::new(agent())).rule(moderate());
    let other = load(other).unwrap_err();
    assert!(other.contains("spaces with other bounds"), "{other}");
}

/// A shield whose experience has room for so many transitions, and the rewards that its agent learns from.
fn remembering(capacity: usize) -> (DropIn, Seen) {
    let agent = Scripted::acting(|_, _| 0.0);
    let seen = agent.seen.clone();
    let experience = Experience::new(capacity, &spaces(), [0, 1], 1.0).unwrap();
    // So many draws of one transition that each of a few dozen is among them.
    let learning = Learning { updates_per_step: 1_000, ..Learning::new(experience, 1, 0) };
    (builder(agent).learning(learning).build().unwrap(), seen)
}

/// Forward steps with the rewards `numbers` / 1,000.
fn remember(drop_in: &mut DropIn, numbers: Range<u32>) {
    for number in numbers {
        drop_in.filter(&[1.0], &mut [0.5]).unwrap();
        let signal = ResetSignal { reward: number as f32 / 1_000.0, in_reset_set: false };
        drop_in.observe(&[1.0], Some(signal), false).unwrap();
    }
}

/// Which transitions the agent has learned from since it was last asked.
fn learned(seen: &Seen) -> Vec<u32> {
    let batch = std::mem::take(&mut *seen.lock().unwrap());
    let mut numbers: Vec<u32> = batch.iter().map(|seen| (seen.0 * 1_000.0).round() as u32).collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

#[test]
fn the_experience_is_loaded_into_more_and_into_less_room() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    // The ring of 20 is not full, just full, and has gone round twice.
    for stored in [13, 20, 45] {
        let (mut saved, _) = remembering(20);
        saved.hard_reset_done(&[1.0]).unwrap();
        remember(&mut saved, 0..stored);
        drop_in_files::save(&mut saved, &file).unwrap();
        for capacity in [20, 30, 21, 19, 7, 1] {
            let (mut loaded, seen) = remembering(capacity);
            drop_in_files::load(&mut loaded, &file).unwrap();
            loaded.hard_reset_done(&[1.0]).unwrap();
            let room = capacity as u32;
            remember(&mut loaded, stored..stored + 1);
            let oldest = stored.saturating_sub(20).max((stored + 1).saturating_sub(room));
            let expected: Vec<u32> = (oldest..stored + 1).collect();
            assert_eq!(learned(&seen), expected, "{stored} transitions, room for {room}");
            // From here on it forgets as ever, and what it saves comes back.
            drop_in_files::save(&mut loaded, &file.with_extension(capacity.to_string())).unwrap();
            remember(&mut loaded, stored + 1..stored + 1 + 2 * room);
            learned(&seen);
            remember(&mut loaded, stored + 1 + 2 * room..stored + 2 + 2 * room);
            let newest: Vec<u32> = (stored + 2 + room..stored + 2 + 2 * room).collect();
            assert_eq!(learned(&seen), newest, "{stored} transitions, room for {room}, later");
        }
    }
    let (mut back, seen) = remembering(20);
    drop_in_files::load(&mut back, &file.with_extension("30")).unwrap();
    back.hard_reset_done(&[1.0]).unwrap();
    remember(&mut back, 46..47);
    assert_eq!(learned(&seen), (27..47).collect::<Vec<u32>>());
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn shields_that_save_at_the_same_time_each_keep_their_own_state() {
    let folder = tempfile::tempdir().unwrap();
    let files = ["q-0.5", "q-0.7"].map(|name| folder.path().join(name));
    let mut shields = [3, 8].map(|steps| {
        let (mut drop_in, _) = remembering(100);
        drop_in.hard_reset_done(&[1.0]).unwrap();
        remember(&mut drop_in, 0..steps);
        drop_in
    });
    for _ in 0..50 {
        thread::scope(|scope| {
            for (shield, file) in shields.iter_mut().zip(&files) {
                scope.spawn(|| drop_in_files::save(shield, file).unwrap());
            }
        });
        for (steps, file) in [3.0, 8.0].into_iter().zip(&files) {
            let (mut loaded, _) = remembering(100);
            drop_in_files::load(&mut loaded, file).unwrap();
            assert_eq!(metric(&loaded, "steps"), steps);
        }
    }
    assert_eq!(names(folder.path()), ["q-0.5", "q-0.7"]);
}

#[test]
fn a_save_replaces_its_own_file_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("keep.partial"), "a user's file").unwrap();
    let mut drop_in = builder(Scripted::acting(|_, _| -1.0)).build().unwrap();
    for _ in 0..2 {
        drop_in_files::save(&mut drop_in, &at("keep.sav")).unwrap();
        assert_eq!(names(folder.path()), ["keep.partial", "keep.sav"]);
    }
    assert_eq!(fs::read(at("keep.partial")).unwrap(), b"a user's file");
    let kept = fs::read(at("keep.sav")).unwrap();
    fs::create_dir(at("folder")).unwrap();
    let error = drop_in_files::save(&mut drop_in, &at("folder")).unwrap_err().to_string();
    assert!(error.contains("it is a folder; choose the name of a file"), "{error}");
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("keep.sav", at("link")).unwrap();
        let error = drop_in_files::save(&mut drop_in, &at("link")).unwrap_err().to_string();
        assert!(error.contains("link: it is a symbolic link") && error.contains("keep.sav"), "{error}");
        fs::remove_file(at("link")).unwrap();
    }
    assert_eq!(names(folder.path()), ["folder", "keep.partial", "keep.sav"]);
    assert_eq!(fs::read(at("keep.sav")).unwrap(), kept);
}
