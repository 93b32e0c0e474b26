//! What a run finds in its folder when it goes on, and what it leaves there.

use shield_runtime::run::restore;

use super::*;

#[test]
fn a_damaged_checkpoint_is_skipped_for_the_previous_one() {
    let expected = Trial::uninterrupted(&grid());
    for file in ["latest.bin", "the experience", "metrics.csv"] {
        let run = Trial::new(&grid(), &[]);
        run.go(Sabotage::Crash(1_150));
        match file {
            "latest.bin" => damage(&run.checkpoint(file)),
            // The last segment of a memory that forgets holds only what the last checkpoint needs.
            "the experience" => {
                let segments = fs::read_dir(run.checkpoint("")).unwrap().map(|entry| entry.unwrap().path());
                let rows = segments.filter(|path| path.extension().is_some_and(|end| end == "rows"));
                damage(&rows.max().unwrap());
            }
            _ => {
                let path = run.path().join(file);
                let length = fs::metadata(&path).unwrap().len();
                fs::File::options().write(true).open(&path).unwrap().set_len(length * 6 / 10).unwrap();
            }
        }
        let launch = run.proceed().unwrap();
        assert_eq!(launch.steps_before(), 400, "{file}");
        assert!(launch.warnings()[0].contains("passed over"), "{:?}", launch.warnings());
        drop(launch);
        run.go(Sabotage::None);
        same(&expected, &run, file);
    }
}

#[test]
fn a_changed_configuration_is_refused_by_the_name_of_the_field() {
    let run = Trial::new(&grid(), &[]);
    run.go(Sabotage::Stop(450));
    let other = Trial::new(&grid(), &["shield.rules[1].config.q_min=0.3"]);
    let other = Run { folder: run.run.folder.clone(), ..other.run };
    let Ok(Standing::Differs(difference)) = other.standing(registry()) else {
        panic!("no difference was seen")
    };
    assert_eq!(difference.path, "shield.rules[1].config.q_min");
    let error = other.proceed(registry()).err().unwrap().to_string();
    assert!(error.contains("shield.rules[1].config.q_min"), "{error}");
    // How many threads there are changes nothing.
    let threads = Trial::new(&grid(), &["threads=2"]);
    let threads = Run { folder: run.run.folder.clone(), ..threads.run };
    assert!(matches!(threads.standing(registry()), Ok(Standing::Unfinished)));
}

#[test]
fn a_run_that_was_killed_at_once_can_start_again() {
    for files in [&[][..], &["config.partial"]] {
        let run = Trial::new(&gridworld(100, ""), &[]);
        fs::create_dir_all(run.path()).unwrap();
        files.iter().for_each(|file| fs::write(run.path().join(file), "Exp").unwrap());
        assert!(matches!(run.standing(), Ok(Standing::Missing)));
        assert_eq!(run.go(Sabotage::None), 0);
        for file in files {
            let path = run.path().join(file);
            assert_eq!(fs::read_to_string(&path).unwrap(), "Exp", "it is not this launch's to remove");
            fs::remove_file(path).unwrap();
        }
        same(&Trial::uninterrupted(&gridworld(100, "")), &run, "begun again");
    }
}

#[test]
fn what_a_killed_program_left_is_removed_and_what_a_user_put_there_stays() {
    let expected = Trial::uninterrupted(&grid());
    let run = Trial::new(&grid(), &[]);
    run.go(Sabotage::Crash(1_111));
    let at = |name: &str| run.path().join(name);
    let folders = ["", "checkpoint", "decisions"];
    let left = folders.map(|folder| at(folder).join(".shield-0aZ3xY7bQ9kL.partial"));
    let as_before = [at("decisions/part-000007.partial"), at("decisions/part-000009.parquet")];
    let kept = folders.map(|folder| {
        ["keep.partial", "zebra.rows", ".shield-mine.partial"].map(|name| at(folder).join(name))
    });
    for file in left.iter().chain(&as_before).chain(kept.as_flattened()) {
        fs::write(file, "something").unwrap();
    }
    run.go(Sabotage::None);
    for file in left.iter().chain(&as_before) {
        assert!(!file.exists(), "{} was left", file.display());
    }
    for file in kept.as_flattened() {
        assert_eq!(fs::read(file).unwrap(), b"something", "{}", file.display());
        fs::remove_file(file).unwrap();
    }
    same(&expected, &run, "tidied up");
}

#[cfg(unix)]
#[test]
fn a_run_does_not_go_on_in_a_file_that_a_link_leads_to() {
    for name in ["metrics.csv", "timings.csv", "tensorboard/events.out.tfevents.0.shield"] {
        let run = Trial::new(&grid(), &[]);
        run.go(Sabotage::Crash(1_111));
        let (path, elsewhere) = (run.path().join(name), run.path().join("elsewhere"));
        fs::rename(&path, &elsewhere).unwrap();
        let before = fs::read(&elsewhere).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &path).unwrap();
        let error = format!("{:#}", run.proceed().err().unwrap());
        assert!(error.contains(name) && error.contains("it is a symbolic link"), "{error}");
        assert!(fs::read(&elsewhere).unwrap() == before, "{name}: the file elsewhere was changed");
        // With the file back in its place the run goes on.
        fs::rename(&elsewhere, &path).unwrap();
        assert_eq!(run.go(Sabotage::None), 800);
    }
}

#[test]
fn two_processes_cannot_write_one_run() {
    let run = Trial::new(&grid(), &[]);
    run.go(Sabotage::Stop(450));
    let first = run.proceed().unwrap();
    let error = run.proceed().err().unwrap().to_string();
    assert!(error.contains("another process"), "{error}");
    let error = run.begin(true).err().unwrap().to_string();
    assert!(error.contains("another process"), "{error}");
    drop(first);
    assert!(run.proceed().is_ok());
}

#[test]
fn a_finished_run_keeps_its_agents_and_drops_its_replay_buffer() {
    let run = Trial::new(&grid(), &[]);
    run.go(Sabotage::Crash(1_400));
    run.go(Sabotage::None);
    let names: Vec<String> = fs::read_dir(run.checkpoint(""))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .filter(|name| name != "lock")
        .collect();
    assert_eq!(names, ["latest.bin"]);
    assert!(matches!(run.standing(), Ok(Standing::Finished(summary)) if summary.exact_resume));
    let restored = restore(registry(), &run.run.folder, &[]).unwrap();
    assert!(restored.state.is_finished() && restored.state.counters().steps == 1_500);
    // Killed after the last checkpoint, before the summary.
    let summary = run.path().join("summary.json");
    let expected = run.files();
    fs::remove_file(&summary).unwrap();
    assert_eq!(run.go(Sabotage::None), 1_500);
    same(&expected, &run, "only the summary was missing");
}

#[test]
fn without_checkpoints_nothing_is_kept_and_the_summary_says_so() {
    let run = Trial::new(&grid(), &["checkpoint=None"]);
    run.go(Sabotage::None);
    assert!(!run.checkpoint("").exists());
    assert!(matches!(run.standing(), Ok(Standing::Finished(summary)) if !summary.exact_resume));
    assert!(restore(registry(), &run.run.folder, &[]).err().unwrap().to_string().contains("no checkpoint"));
}
