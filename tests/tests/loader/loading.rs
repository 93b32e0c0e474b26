//! What is refused when a library is loaded, and with which words.

use std::fs;

use shield_api::Policy as _;
use shield_runtime::plugin::{Library, PluginError, Registry, Selection, read_manifests};
use tempfile::tempdir;

use crate::fixtures::{c_fixture, check_refusal, fixture, refusal, setup};

#[test]
fn a_library_with_several_plugins_of_a_kind_loads() {
    let library = Library::load(&fixture("every-kind")).unwrap();
    let ids: Vec<&str> = library.manifests().map(|manifest| manifest.id.as_str()).collect();
    assert_eq!(
        ids,
        [
            "fixture/line",
            "fixture/cells",
            "fixture/agent",
            "fixture/follower",
            "fixture/gentle",
            "fixture/small",
            "fixture/odds"
        ]
    );
}

#[test]
fn a_failed_load_does_not_poison_the_next() {
    for bad in ["swapped", "unchecked", "two"] {
        refusal(&fixture(bad));
        Library::load(&fixture("every-kind")).unwrap();
    }
    // And a second library is not mistaken for the first.
    assert_eq!(Library::load(&fixture("faulty")).unwrap().manifests().count(), 5);
}

#[test]
fn swapped_fields_are_refused_by_name() {
    let path = fixture("swapped");
    check_refusal(
        &path,
        &[
            "its tables differ",
            "in `StepView`",
            "environment.step",
            "forward_reward",
            "reset_reward",
            "rebuild the plugin",
        ],
    );
    assert!(matches!(refusal(&path), PluginError::Layout { .. }));
}

#[test]
fn a_field_of_another_type_is_refused_by_name() {
    check_refusal(
        &fixture("retyped"),
        &["its tables differ", "abort_rule.observe", "aborted", "expected the type `u32`, found `i32`"],
    );
}

#[test]
fn a_missing_field_is_refused() {
    check_refusal(
        &fixture("missing"),
        &["its tables differ", "in `HostTable`", "expected 4 fields, found 3", "rebuild the plugin"],
    );
}

/// An older one, the first of all, is kept in `tests/fixtures/kept`.
#[test]
fn a_library_of_a_later_minor_version_loads_and_runs() {
    let path = fixture("newer");
    let library = Library::load(&path).unwrap();
    assert_eq!(library.manifests().next().unwrap().abi, (1, 7));
    let choice = Selection::new("fixture/idle").at(&path);
    let mut policy = Registry::default().policy(&choice, "", &setup()).unwrap();
    let mut action = [1.0];
    policy.act(&[0.0, 0.0], &mut action).unwrap();
    assert_eq!(action, [0.0]);
}

#[test]
fn another_major_version_is_refused_from_the_file_alone() {
    let path = fixture("other-major");
    check_refusal(&path, &["\"fixture/by-hand\" speaks interface 2.0, this host 1.1", "shield-api 1"]);
    assert_eq!(read_manifests(&path).unwrap()[0].abi, (2, 0));
}

#[test]
fn another_major_version_of_the_interface_crate_is_refused() {
    check_refusal(&fixture("two"), &["built with shield-api 2.0.0, this host with 1.0.0"]);
}

#[test]
fn a_library_that_hides_its_layout_is_refused() {
    check_refusal(&fixture("unchecked"), &["CheckTypeLayout::No", "export_plugin!"]);
}

#[test]
fn a_rust_library_cannot_enter_by_the_c_symbol() {
    check_refusal(&fixture("no-door"), &["says \"rust\"", "does not export", "no way around"]);
}

#[test]
fn a_rust_library_that_says_c_cannot_avoid_the_comparison_of_layouts() {
    // The same length, so that everything stays in its place.
    let (says, instead) = (&b"language=rust\x1f"[..], &b"language=c\x1fz=\x1f"[..]);
    let mut bytes = fs::read(fixture("unchecked")).unwrap();
    for at in 0..bytes.len() - says.len() {
        if bytes[at..].starts_with(says) {
            bytes[at..at + says.len()].copy_from_slice(instead);
        }
    }
    let folder = tempdir().unwrap();
    let path = folder.path().join("says_c.so");
    fs::write(&path, bytes).unwrap();
    check_refusal(&path, &["says that the library is written in C", "the door of a Rust plugin"]);
}

#[test]
fn a_manifest_that_changes_once_loaded_is_refused() {
    check_refusal(
        &fixture("lying"),
        &["\"fixture/by-hand\"", "\"Does nothing\" in the file, \"Does everything\" once loaded"],
    );
}

#[test]
fn a_library_that_aborts_on_panic_is_refused_from_the_file_alone() {
    check_refusal(&fixture("aborting"), &["\"fixture/idle\"", "panic = \"abort\"", "panic = \"unwind\""]);
}

#[test]
fn a_text_file_is_refused() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("notes.so");
    fs::write(&path, "This is not a library.").unwrap();
    check_refusal(&path, &["is not a complete shared library"]);
    fs::write(&path, "").unwrap();
    check_refusal(&path, &["is not a complete shared library"]);
}

#[test]
fn a_truncated_library_is_refused_wherever_it_is_cut() {
    let whole = fs::read(fixture("every-kind")).unwrap();
    let folder = tempdir().unwrap();
    let path = folder.path().join("cut.so");
    for length in [10, 64, 1_000, whole.len() / 2, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        check_refusal(&path, &["is not a complete shared library"]);
    }
}

#[test]
fn a_missing_file_is_refused_by_name() {
    check_refusal(&tempdir().unwrap().path().join("gone.so"), &["cannot be read"]);
}

#[test]
fn a_library_without_a_manifest_is_refused() {
    check_refusal(&c_fixture("no_manifest", &["NO_MANIFEST"]), &["has no section `.shield_manifest`"]);
}

#[test]
fn an_undefined_symbol_is_found_at_loading_and_named() {
    check_refusal(&c_fixture("undefined", &["UNDEFINED"]), &["undefined symbol: nobody_defines_this"]);
}
