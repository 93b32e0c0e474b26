//! Whom a library must belong to before anything of it is executed.

use std::{
    fs,
    os::unix::fs::{PermissionsExt as _, symlink},
    path::{Path, PathBuf},
    process::Command,
};

use shield_runtime::plugin::{Kind, Library, PluginError, Registry, SearchPath, Selection, Stranger};
use shield_tests::{named_pipe, succeed};
use tempfile::{TempDir, tempdir};

use crate::fixtures::{c_fixture, compile_c, compile_rule, setup};

const ID: &str = "c/gentle";

fn set_mode(path: &Path, mode: u32) {
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
}

/// A folder that only its user may write to, with a copy of the rule in C.
fn safe() -> (TempDir, PathBuf) {
    let folder = tempdir().unwrap();
    let library = folder.path().canonicalize().unwrap().join("libtank.so");
    fs::copy(c_fixture("trusted", &[]), &library).unwrap();
    set_mode(folder.path(), 0o755);
    (folder, library)
}

fn scan(folder: &Path) -> Registry {
    Registry::scan(&SearchPath::new([folder]))
}

/// The place that is not trusted, and who could change it.
fn distrusted(error: PluginError) -> (PathBuf, Stranger) {
    match error {
        PluginError::Untrusted { distrust, .. } => (distrust.place, distrust.by),
        other => panic!("{other}"),
    }
}

#[test]
fn a_link_in_a_folder_that_everyone_may_write_is_skipped_although_it_leads_to_a_safe_one() {
    let (_safe, library) = safe();
    let open = tempdir().unwrap();
    let folder = open.path().canonicalize().unwrap();
    symlink(&library, folder.join("libtank.so")).unwrap();
    set_mode(&folder, 0o777);
    let error = scan(&folder).find(ID, Kind::AbortRule).unwrap_err();
    let message = error.to_string();
    let expected = [
        folder.join("libtank.so").display().to_string(),
        format!("{} is writable by every user", folder.display()),
        format!("`chmod o-w {}`", folder.display()),
        "SHIELD_ALLOW_WRITABLE_PLUGINS=1".into(),
    ];
    for part in expected {
        assert!(message.contains(&part), "{part:?} is not in: {message}");
    }
    assert_eq!(distrusted(error), (folder.clone(), Stranger::Everyone));
    assert_eq!(distrusted(Library::load(&folder.join("libtank.so")).unwrap_err()).0, folder);

    // It takes nothing from the safe folder, in whatever order they are searched.
    let registry = Registry::scan(&SearchPath::new([folder.as_path(), library.parent().unwrap()]));
    assert_eq!(registry.find(ID, Kind::AbortRule).unwrap().path, library);
    assert_eq!(registry.skipped().len(), 1);
}

#[test]
fn a_folder_above_the_searched_one_that_everyone_may_write_is_refused() {
    let above = tempdir().unwrap();
    let plugins = above.path().canonicalize().unwrap().join("plugins");
    fs::create_dir(&plugins).unwrap();
    let library = plugins.join("libtank.so");
    fs::copy(c_fixture("trusted", &[]), &library).unwrap();
    set_mode(above.path(), 0o777);
    let place = above.path().canonicalize().unwrap();
    let error = scan(&plugins).find(ID, Kind::AbortRule).unwrap_err();
    assert_eq!(distrusted(error), (place.clone(), Stranger::Everyone));
    let choice = Selection::new(ID).at(&library);
    let error = Registry::default().abort_rule(&choice, "", &setup()).unwrap_err();
    assert_eq!(distrusted(error).0, place);
    // A folder such as /tmp lets nobody replace what is another's.
    set_mode(above.path(), 0o1777);
    Registry::default().abort_rule(&choice, "", &setup()).unwrap();
    scan(&plugins).find(ID, Kind::AbortRule).unwrap();
}

#[test]
fn a_library_that_was_found_is_checked_again_when_it_is_loaded() {
    let (_safe, library) = safe();
    let registry = scan(library.parent().unwrap());
    set_mode(&library, 0o666);
    let error = registry.abort_rule(&Selection::new(ID), "", &setup()).unwrap_err();
    assert_eq!(distrusted(error), (library, Stranger::Everyone));
}

#[test]
fn a_library_beside_a_plugin_that_it_brings_along_is_checked_too() {
    let (_safe, library) = safe();
    let folder = library.parent().unwrap();
    let [near, far] = ["libtrust_near.so", "libtrust_far.so"].map(|name| folder.join(name));
    compile_c(&far, "float from_far(float x) { return x; }");
    compile_c(&near, "float from_beside(float x) { return x; }");
    let link = ["-L", folder.to_str().unwrap(), "-ltrust_near", "-Wl,-rpath,$ORIGIN"];
    compile_rule(&library, &["NEIGHBOUR"], &link);
    // The neighbour has one of its own.
    let mut cc = Command::new("cc");
    cc.args(["-shared", "-fPIC", "-Wl,--no-as-needed", "-Wl,-rpath,$ORIGIN", "-Wl,-soname,libtrust_near.so"]);
    let source = folder.join("near.c");
    fs::write(&source, "float from_beside(float x) { return x; }").unwrap();
    cc.arg(&source).args(["-L", folder.to_str().unwrap(), "-ltrust_far", "-o"]).arg(&near);
    succeed(&mut cc);
    for path in [&near, &far] {
        set_mode(path, 0o646);
        assert_eq!(distrusted(Library::load(&library).unwrap_err()), (path.clone(), Stranger::Everyone));
        set_mode(path, 0o644);
    }
    Library::load(&library).unwrap();
}

#[test]
fn a_named_pipe_or_a_device_among_the_libraries_is_skipped_with_its_reason() {
    let (folder, _library) = safe();
    named_pipe(&folder.path().join("libpipe.so"));
    symlink("/dev/zero", folder.path().join("libzero.so")).unwrap();
    let registry = scan(folder.path());
    registry.find(ID, Kind::AbortRule).unwrap();
    let skipped: Vec<String> = registry.skipped().iter().map(|skipped| skipped.reason.to_string()).collect();
    assert_eq!(skipped.len(), 2, "{skipped:?}");
    assert!(skipped[0].contains("libpipe.so: cannot be read: it is a named pipe"), "{skipped:?}");
    assert!(skipped[1].contains("cannot be read: it is a device"), "{skipped:?}");
}
