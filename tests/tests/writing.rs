//! Where the command and the library for C write: over a regular file of that name, and over nothing else.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    os::unix::fs::symlink,
    path::Path,
    process::{Command, Output},
};

use shield_tests::{
    call, cart, compile_c_program, gridworld, named_pipe, text, without_plugins_elsewhere, workspace,
};
use tempfile::TempDir;

fn done(folder: &Path, arguments: &[&str]) {
    let output = call(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

const PRECIOUS: &str = "a user's file";

/// A folder with a file that must stay as it is, and what must not be written over: a link to that file, a link to nothing, a folder, a pipe.
fn traps(ending: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(format!("{name}{ending}"));
    fs::write(folder.path().join("precious"), PRECIOUS).unwrap();
    symlink("precious", at("link")).unwrap();
    symlink("nowhere", at("dangling")).unwrap();
    fs::create_dir(at("folder")).unwrap();
    named_pipe(&at("pipe"));
    folder
}

const TRAPS: [(&str, &str); 4] = [
    ("link", "it is a symbolic link"),
    ("dangling", "it is a symbolic link"),
    ("folder", "it is a folder"),
    ("pipe", "it is a device, a pipe or a socket"),
];

/// `write` with the path of each trap fails for the reason of the trap, and changes nothing in the folder.
fn refuses_traps(ending: &str, write: impl Fn(&Path) -> Output) {
    let folder = traps(ending);
    let before = names(folder.path());
    for (name, reason) in TRAPS {
        let output = write(&folder.path().join(format!("{name}{ending}")));
        let message = text(&output.stderr);
        assert!(!output.status.success() && message.contains(reason), "{name}: {message}");
        assert_eq!(names(folder.path()), before, "{name}");
        assert_eq!(fs::read_to_string(folder.path().join("precious")).unwrap(), PRECIOUS, "{name}");
    }
}

fn ran(experiment: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    done(folder.path(), &["run", "x.ron", "--seeds", "0"]);
    folder
}

#[test]
fn a_report_is_written_over_a_regular_file_only() {
    let home = ran(&gridworld(300, ""));
    refuses_traps(".html", |out| {
        call(home.path(), &["report", "runs/small", "--out", out.to_str().unwrap()])
    });
    // Names that it might use on the way are somebody else's.
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("precious"), PRECIOUS).unwrap();
    symlink("precious", at("page.partial")).unwrap();
    symlink("precious", at("page.html.partial")).unwrap();
    let out = at("page.html");
    for _ in 0..2 {
        done(home.path(), &["report", "runs/small", "--out", out.to_str().unwrap()]);
        assert!(fs::read_to_string(&out).unwrap().contains("</html>"));
    }
    assert_eq!(names(folder.path()), ["page.html", "page.html.partial", "page.partial", "precious"]);
    assert_eq!(fs::read_to_string(at("precious")).unwrap(), PRECIOUS);
}

#[test]
fn an_export_and_a_film_are_written_over_regular_files_only() {
    let home = ran(&cart(400, ""));
    let folder = tempfile::tempdir().unwrap();
    let precious = folder.path().join("precious");
    fs::write(&precious, PRECIOUS).unwrap();
    symlink("precious", folder.path().join("reset.onnx")).unwrap();
    let output =
        call(home.path(), &["export", "runs/cart/default/seed-0", "--out", folder.path().to_str().unwrap()]);
    let message = text(&output.stderr);
    assert!(output.status.code() == Some(1) && message.contains("reset.onnx"), "{message}");
    assert_eq!(fs::read_to_string(&precious).unwrap(), PRECIOUS);
    let whole = ["forward.onnx", "forward.safetensors", "precious", "reset.onnx", "reset.safetensors"];
    assert_eq!(names(folder.path()), whole);
    for ending in [".png", ".gif"] {
        refuses_traps(ending, |out| {
            call(home.path(), &["render", "x.ron", "--steps", "2", "--out", out.to_str().unwrap()])
        });
    }
}

#[test]
fn a_new_plugin_is_made_in_a_new_folder_only() {
    let folder = traps("");
    let before = names(folder.path());
    let api = workspace().join("shield-api");
    let new = |path: &str| {
        let arguments = ["plugin", "new", "a/b", "--kind", "policy", "--api", api.to_str().unwrap()];
        call(folder.path(), &[&arguments[..], &["--path", path]].concat())
    };
    for (trap, _) in TRAPS {
        let output = new(trap);
        let message = text(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains("exists already"), "{trap}: {message}");
    }
    assert_eq!(names(folder.path()), before);
    assert!(names(&folder.path().join("folder")).is_empty());
    assert!(new("deep/new").status.success());
    assert!(names(&folder.path().join("deep/new")).contains(&"Cargo.toml".into()));
}

#[test]
fn a_lock_writes_the_file_that_a_link_leads_to_and_keeps_the_link() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("real.ron"), gridworld(300, "")).unwrap();
    fs::write(at("real.partial"), PRECIOUS).unwrap();
    symlink("real.ron", at("x.ron")).unwrap();
    done(folder.path(), &["plugin", "lock", "x.ron"]);
    assert!(at("x.ron").is_symlink());
    assert!(fs::read_to_string(at("real.ron")).unwrap().contains("pins: {"));
    assert_eq!(fs::read_to_string(at("real.partial")).unwrap(), PRECIOUS);
    assert_eq!(names(folder.path()), ["real.partial", "real.ron", "x.ron"]);
}

/// Saves to the second argument, and says why it cannot.
const SAVE: &str = r#"
#include <stdio.h>
#include "shield.h"

int main(int count, char **arguments) {
    Shield *shield = count == 3 ? shield_open(arguments[1]) : NULL;
    if (!shield) return 2;
    int32_t saved = shield_save(shield, arguments[2]);
    fprintf(stderr, "%s\n", shield_last_error());
    shield_close(shield);
    return saved == SHIELD_DONE ? 0 : 1;
}
"#;

#[test]
fn a_program_in_c_saves_over_a_regular_file_only() {
    let folder = tempfile::tempdir().unwrap();
    let (source, program) = (folder.path().join("save.c"), folder.path().join("save"));
    fs::write(&source, SAVE).unwrap();
    compile_c_program(&source, &program);
    let save = |path: &Path| {
        let mut command = Command::new(&program);
        without_plugins_elsewhere(&mut command)
            .arg(workspace().join("examples/c/cart.ron"))
            .arg(path)
            .output()
            .unwrap()
    };
    refuses_traps("", save);
    let state = folder.path().join("state");
    for _ in 0..2 {
        let output = save(&state);
        assert!(output.status.success(), "{}", text(&output.stderr));
    }
    assert_eq!(names(folder.path()), ["save", "save.c", "state"]);
}
