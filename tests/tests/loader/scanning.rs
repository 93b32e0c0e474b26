//! Finding plugins among folders.

use std::{
    fs::{self, OpenOptions},
    io::Write,
    os::unix::fs::symlink,
    path::Path,
};

use shield_api::Setup;
use shield_runtime::plugin::{Kind, PluginError, Registry, SearchPath, Selection, host};
use tempfile::{TempDir, tempdir};

use crate::fixtures::{c_fixture, fixture};

/// A folder with copies of the given libraries.
fn folder(libraries: &[&Path]) -> TempDir {
    let folder = tempdir().unwrap();
    for library in libraries {
        fs::copy(library, folder.path().join(library.file_name().unwrap())).unwrap();
    }
    folder
}

fn scan(folders: &[&Path]) -> Registry {
    Registry::scan(&SearchPath::new(folders.iter().copied()))
}

#[test]
fn a_scan_lists_plugins_and_skipped_files_with_the_reason() {
    let folder = folder(&[
        &fixture("every-kind"),
        &fixture("other-major"),
        &fixture("aborting"),
        &c_fixture("listed_without_manifest", &["NO_MANIFEST"]),
    ]);
    fs::write(folder.path().join("broken.so"), "text").unwrap();
    fs::write(folder.path().join("readme.txt"), "text").unwrap();
    fs::write(folder.path().join("libversioned.so.1"), "text").unwrap();
    fs::write(folder.path().join("libshield_runtime.so"), "the host, for programs in C").unwrap();
    fs::create_dir(folder.path().join("folder.so")).unwrap();
    symlink("nowhere", folder.path().join("dangling.so")).unwrap();
    let registry = scan(&[folder.path()]);
    assert_eq!(registry.entries().len(), 7);
    let skipped: Vec<(&str, String)> = registry
        .skipped()
        .iter()
        .map(|skipped| (skipped.path.file_name().unwrap().to_str().unwrap(), skipped.reason.to_string()))
        .collect();
    for (name, reason) in [
        ("broken.so", "is not a complete shared library"),
        ("dangling.so", "cannot be read"),
        ("libaborting.so", "panic = \"abort\""),
        ("libother_major.so", "speaks interface 2.0, this host 1.1"),
        ("listed_without_manifest.so", "has no section `.shield_manifest`"),
    ] {
        assert!(
            skipped.iter().any(|(file, why)| *file == name && why.contains(reason)),
            "{name}: {skipped:?}"
        );
    }
    assert_eq!(skipped.len(), 5, "{skipped:?}");
    // Asked for, a plugin in a skipped file is an error that says why the file was skipped.
    let error = registry.find("fixture/by-hand", Kind::Policy).unwrap_err();
    assert!(error.to_string().contains("speaks interface 2.0"), "{error}");
}

#[test]
fn an_unknown_id_is_reported_with_similar_ones_and_the_searched_folders() {
    let folder = folder(&[&fixture("every-kind")]);
    let gone = folder.path().join("gone");
    let registry = scan(&[folder.path(), &gone]);
    for asked in ["fixture/lime", "line", "acme/line"] {
        let message = registry.find(asked, Kind::Environment).unwrap_err().to_string();
        assert!(message.contains("did you mean \"fixture/line\""), "{message}");
        assert!(message.contains(&format!("{} (no such folder)", gone.display())), "{message}");
    }
    let message = registry.find("zzz", Kind::Environment).unwrap_err().to_string();
    assert!(!message.contains("did you mean"), "{message}");
}

#[test]
fn a_plugin_of_the_wrong_kind_is_reported() {
    let folder = folder(&[&fixture("every-kind")]);
    let message = scan(&[folder.path()]).find("fixture/line", Kind::Learner).unwrap_err().to_string();
    assert!(
        message.contains(
            "\"fixture/line\" is a plugin of kind environment, but this place of the experiment needs"
        ),
        "{message}"
    );
}

#[test]
fn a_duplicate_id_names_both_files_when_it_is_asked_for() {
    let (first, second) = (folder(&[&fixture("every-kind")]), folder(&[&fixture("every-kind")]));
    let copy = second.path().join(fixture("every-kind").file_name().unwrap());
    // Another build of the same plugins: a byte behind the end of the library makes the difference.
    OpenOptions::new().append(true).open(copy).unwrap().write_all(b"\n").unwrap();
    let registry = scan(&[first.path(), second.path()]);
    let error = registry.find("fixture/line", Kind::Environment).unwrap_err();
    let message = error.to_string();
    for folder in [&first, &second] {
        let name = folder.path().canonicalize().unwrap();
        assert!(message.contains(name.to_str().unwrap()), "{message}");
    }
    assert_eq!(registry.duplicates().len(), 7);
    assert!(registry.duplicates().contains(&error));
    // A path in the experiment settles it.
    let selection = Selection::new("fixture/line").at(fixture("every-kind"));
    registry.environment(&selection, "", &Setup::new(0, 1, host())).unwrap();
}

#[test]
fn one_file_found_twice_is_not_a_duplicate() {
    let first = folder(&[&fixture("every-kind")]);
    let second = tempdir().unwrap();
    let name = fixture("every-kind").file_name().unwrap().to_owned();
    symlink(first.path().join(&name), second.path().join(&name)).unwrap();
    // Cargo leaves a library twice, as a hard link or, where that is impossible, as a copy.
    let (linked, copied) = (tempdir().unwrap(), folder(&[&fixture("every-kind")]));
    fs::hard_link(first.path().join(&name), linked.path().join(&name)).unwrap();
    let registry = scan(&[first.path(), second.path(), linked.path(), copied.path(), first.path()]);
    registry.find("fixture/line", Kind::Environment).unwrap();
    assert!(registry.duplicates().is_empty());
    assert_eq!(registry.entries().len(), 7);
}

#[test]
fn nothing_is_executed_while_scanning() {
    // This library cannot be opened at all, but its manifest can be read.
    let folder = folder(&[&c_fixture("scanned_undefined", &["UNDEFINED"])]);
    let registry = scan(&[folder.path()]);
    assert_eq!(registry.find("c/gentle", Kind::AbortRule).unwrap().manifest.version, "1.2.3");
}

#[test]
fn one_library_is_loaded_once_and_makes_many_instances() {
    let folder = folder(&[&fixture("every-kind")]);
    let registry = scan(&[folder.path()]);
    let (selection, setup) = (Selection::new("fixture/line"), Setup::new(0, 1, host()));
    let first = registry.environment(&selection, "", &setup).unwrap();
    // Were it read again, it would now be refused.
    let file = registry.find("fixture/line", Kind::Environment).unwrap().path.clone();
    fs::remove_file(&file).unwrap();
    fs::write(&file, "text").unwrap();
    let second = registry.environment(&selection, "", &setup).unwrap();
    drop((first, second));
    assert!(matches!(
        Registry::default().environment(&selection.at(file), "", &setup),
        Err(PluginError::NotALibrary { .. })
    ));
}
