//! A pinned library: nothing but the file with the right hash is ever executed.

use std::{
    fs::{self, OpenOptions},
    io::Write as _,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering::Relaxed},
    thread,
    time::Duration,
};

use shield_api::{Environment as _, Setup};
use shield_runtime::plugin::{
    Kind, PluginError, Registry, Selection, fingerprint, host,
    isolated::{Isolation, OnFailure},
};
use tempfile::tempdir;

use crate::fixtures::{c_fixture, compile_c, compile_rule, fixture, setup};

const ID: &str = "c/gentle";

fn pinned(id: &str, path: &Path, sha256: &str) -> Selection {
    Selection { sha256: Some(sha256.into()), ..Selection::new(id).at(path) }
}

/// A library that leaves a mark as soon as anything of it is executed, and the mark.
fn marking(folder: &Path) -> (PathBuf, PathBuf) {
    let (library, mark) = (folder.join("marking.so"), folder.join("mark"));
    compile_rule(&library, &[&format!("MARK=\"{}\"", mark.display())], &[]);
    (library, mark)
}

/// Says that it is over, also when a test fails.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}

/// Calls `load` again and again with a path at which two libraries are exchanged meanwhile: `right`, a new copy of it each time, and `wrong`.
fn while_exchanged(right: &Path, wrong: &Path, rounds: usize, mut load: impl FnMut(&Path)) {
    let folder = tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for _ in 0..rounds {
        // The system's loader knows a file that it has loaded before.
        fs::copy(right, at("right")).unwrap();
        fs::copy(wrong, at("wrong")).unwrap();
        fs::hard_link(at("right"), at("lib.so")).unwrap();
        let (is_over, has_begun) = (AtomicBool::new(false), AtomicBool::new(false));
        thread::scope(|scope| {
            let exchanging = scope.spawn(|| {
                while !is_over.load(Relaxed) {
                    for file in ["wrong", "right"] {
                        fs::hard_link(at(file), at("next")).unwrap();
                        fs::rename(at("next"), at("lib.so")).unwrap();
                    }
                    has_begun.store(true, Relaxed);
                }
            });
            // On a busy machine the library would be loaded before the first exchange.
            while !has_begun.load(Relaxed) && !exchanging.is_finished() {
                thread::yield_now();
            }
            let _over = Over(&is_over);
            load(&at("lib.so"));
        });
        for name in ["lib.so", "right", "wrong"] {
            fs::remove_file(at(name)).unwrap();
        }
    }
}

#[test]
fn while_two_files_are_exchanged_only_the_pinned_one_is_executed() {
    let folder = tempdir().unwrap();
    let (right, (wrong, mark)) = (c_fixture("pinned", &[]), marking(folder.path()));
    let hash = fingerprint(&right).unwrap();
    let (mut loaded, mut refused) = (0, 0);
    while_exchanged(&right, &wrong, 200, |path| {
        match Registry::default().abort_rule(&pinned(ID, path, &hash), "", &setup()) {
            Ok(_) => loaded += 1,
            Err(PluginError::NotPinned { .. }) => refused += 1,
            Err(other) => panic!("{other}"),
        }
        assert!(!mark.exists(), "the other library was executed");
    });
    assert!(loaded > 0 && refused > 0, "{loaded} loaded, {refused} refused: nothing was exchanged");
}

#[test]
fn while_two_files_are_exchanged_an_isolated_plugin_executes_only_the_pinned_one() {
    shield_tests::shield();
    let folder = tempdir().unwrap();
    let (right, (wrong, mark)) = (fixture("every-kind"), marking(folder.path()));
    let hash = fingerprint(&right).unwrap();
    let limit = Duration::from_secs(60);
    let isolation = Isolation { on_failure: OnFailure::Error, start_timeout: limit, step_timeout: limit };
    let mut loaded = 0;
    while_exchanged(&right, &wrong, 60, |path| {
        let choice = pinned("fixture/line", path, &hash);
        let made =
            Registry::default().isolated_environment(&choice, "", &Setup::new(0, 1, host()), isolation);
        match made {
            Ok(_) => loaded += 1,
            // The file was another when the host looked, or when the process did.
            Err(PluginError::NotPinned { .. }) => {}
            Err(PluginError::Create { message, .. }) => assert!(message.contains("pins"), "{message}"),
            Err(other) => panic!("{other}"),
        }
        assert!(!mark.exists(), "the other library was executed");
    });
    assert!(loaded > 0);
}

#[test]
fn a_pinned_library_finds_what_it_brings_along() {
    let folder = tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    compile_c(&at("libpinned_neighbour.so"), "float from_beside(float x) { return x; }");
    let (beside, library) = (folder.path().to_str().unwrap(), at("libneedy.so"));
    compile_rule(&library, &["NEIGHBOUR"], &["-L", beside, "-lpinned_neighbour", "-Wl,-rpath,$ORIGIN"]);
    let choice = pinned(ID, &library, &fingerprint(&library).unwrap());
    Registry::default().abort_rule(&choice, "", &setup()).unwrap();
}

#[test]
fn a_robot_that_is_pinned_finds_mujoco_beside_itself() {
    let library = shield_tests::plugins_folder().join("libmujoco_robots.so");
    let choice = pinned("mujoco/cliff-cart", &library, &fingerprint(&library).unwrap());
    let mut cart = Registry::default().environment(&choice, "", &Setup::new(0, 1, host())).unwrap();
    let mut observation = vec![0.0; cart.spec().spaces.observation_len()];
    cart.reset(0, &mut observation).unwrap();
}

#[test]
fn a_pinned_library_with_an_undefined_symbol_is_refused_by_its_own_name() {
    let library = c_fixture("pinned_undefined", &["UNDEFINED"]);
    let choice = pinned(ID, &library, &fingerprint(&library).unwrap());
    let message = Registry::default().abort_rule(&choice, "", &setup()).unwrap_err().to_string();
    assert!(message.contains("undefined symbol: nobody_defines_this"), "{message}");
    assert!(
        message.contains("pinned_undefined.so: undefined symbol") && !message.contains("/proc/"),
        "{message}"
    );
}

#[test]
fn a_library_that_was_replaced_after_it_was_loaded_keeps_its_hash() {
    let folder = tempdir().unwrap();
    let (path, next) = (folder.path().join("lib.so"), folder.path().join("next.so"));
    fs::copy(c_fixture("replaced", &[]), &path).unwrap();
    let (registry, first) = (Registry::default(), fingerprint(&path).unwrap());
    registry.abort_rule(&Selection::new(ID).at(&path), "", &setup()).unwrap();
    compile_rule(&next, &["ABI_MINOR=0"], &[]);
    OpenOptions::new().append(true).open(&next).unwrap().write_all(b"\n").unwrap();
    fs::rename(&next, &path).unwrap();
    let second = fingerprint(&path).unwrap();
    // What runs is the first, whatever lies there now.
    registry.abort_rule(&pinned(ID, &path, &first), "", &setup()).unwrap();
    assert_eq!(registry.identify(&Selection::new(ID).at(&path), Kind::AbortRule).unwrap().sha256, first);
    let error = registry.abort_rule(&pinned(ID, &path, &second), "", &setup()).unwrap_err();
    assert!(matches!(error, PluginError::NotPinned { found, .. } if found == first));
    Registry::default().abort_rule(&pinned(ID, &path, &second), "", &setup()).unwrap();
}

#[test]
fn a_library_that_was_written_into_after_it_was_loaded_is_not_taken_for_what_it_was() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("lib.so");
    fs::copy(c_fixture("overwritten", &[]), &path).unwrap();
    let (registry, choice) = (Registry::default(), Selection::new(ID).at(&path));
    registry.abort_rule(&choice, "", &setup()).unwrap();
    // Behind the end of the library, so that nothing that is loaded changes.
    OpenOptions::new().append(true).open(&path).unwrap().write_all(b"\n").unwrap();
    let changed = Some(PluginError::Changed { path: path.canonicalize().unwrap() });
    let choice = pinned(ID, &path, &fingerprint(&path).unwrap());
    for registry in [registry, Registry::default()] {
        assert_eq!(registry.abort_rule(&choice, "", &setup()).err(), changed);
    }
}
