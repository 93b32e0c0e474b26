//! What a plugin author and a user who does not trust everyone meet: `shield plugin new`, `info` and `lock`.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use shield_tests::{call, gridworld, plugins_folder, shield, succeed, text, workspace};

const KINDS: [&str; 6] = ["environment", "learner", "policy", "abort-rule", "reset-task", "success-critic"];

fn refused(folder: &Path, arguments: &[&str], expected: &[&str]) {
    let output = call(folder, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    for part in expected {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
}

/// Makes a plugin, builds it, and runs its example experiment for a few steps.
fn new_build_run(folder: &Path, kind: &str, language: &str, build: &mut Command) {
    let (id, name) = (format!("acme/my-{kind}"), format!("my-{kind}"));
    let api = workspace().join("shield-api");
    let made = ["plugin", "new", &id, "--kind", kind, "--lang", language, "--api", api.to_str().unwrap()];
    succeed(shield().current_dir(folder).args(made));
    let folder = folder.join(&name);
    succeed(build.current_dir(&folder));
    let release = if language == "rust" { "target/release/" } else { "" };
    let library = format!("{release}lib{}{}", name.replace('-', "_"), env::consts::DLL_SUFFIX);
    let information = succeed(shield().current_dir(&folder).args(["plugin", "info", &library]));
    for part in [&id, kind, language, "sha256"] {
        assert!(information.contains(part), "{part:?} is missing in: {information}");
    }
    if kind == "success-critic" {
        succeed(shield().current_dir(&folder).args(["plugin", "check", &library]));
        let measured =
            succeed(shield().current_dir(&folder).args(["plugin", "bench", &library, "--seconds", "0.01"]));
        for call in ["probabilities", "gradients", "update"] {
            assert!(measured.contains(call), "{call:?} is missing in: {measured}");
        }
    }
    succeed(shield().current_dir(&folder).args(["run", "experiment.ron", "--steps", "300"]));
    let runs = folder.join(format!("runs/{name}/default/seed-0"));
    let plugins = fs::read_to_string(runs.join("plugins.json")).unwrap();
    assert!(plugins.contains(&id), "{plugins}");
}

#[test]
fn a_new_plugin_in_c_of_every_kind_builds_and_runs() {
    let folder = tempfile::tempdir().unwrap();
    for kind in KINDS {
        new_build_run(folder.path(), kind, "c", &mut Command::new("make"));
    }
}

/// Built without optimisation, beside the other fixtures, so that what they depend on is compiled once.
#[test]
fn a_new_plugin_in_rust_of_every_kind_passes_its_tests_and_runs() {
    let folder = tempfile::tempdir().unwrap();
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("fixtures");
    for kind in KINDS {
        let mut build = Command::new("sh");
        let script = "cargo test --quiet && cargo build --quiet && mkdir -p target && ln -s \"$CARGO_TARGET_DIR/debug\" target/release";
        build.args(["-c", script]).env("CARGO_TARGET_DIR", &target);
        build.env("CARGO_PROFILE_DEV_DEBUG", "false").env("CARGO_NET_OFFLINE", "true");
        new_build_run(folder.path(), kind, "rust", &mut build);
    }
}

#[test]
fn impossible_plugins_are_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let new = |id, extra: &[&'static str]| [&["plugin", "new", id, "--kind", "policy"][..], extra].concat();
    refused(folder.path(), &new("No Good", &[]), &["\"No Good\" cannot be an id", "acme/my-rule"]);
    refused(folder.path(), &new("a/b", &["--api", "nowhere"]), &["nowhere is not the folder of shield-api"]);
    fs::create_dir(folder.path().join("b")).unwrap();
    refused(folder.path(), &new("a/b", &[]), &["b exists already", "--path"]);
    refused(folder.path(), &["plugin", "info", "ddgp"], &["there is no plugin \"ddgp\"", "\"ddpg\""]);
}

#[test]
fn a_plugin_is_shown_with_its_fields_and_an_example() {
    let shown = succeed(shield().args(["plugin", "info", "ensemble-threshold"]));
    for part in [
        "ensemble-threshold 1.0.0, abort-rule",
        "q_min: ",
        "shield: (rules: [(plugin: \"ensemble-threshold\"",
    ] {
        assert!(shown.contains(part), "{part:?} is missing in: {shown}");
    }
}

/// The kept library stands for a stranger's.
#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn the_cost_of_each_call_is_shown_with_its_allocations() {
    let library = workspace().join("tests/fixtures/kept/1.0.0/libkept.so");
    let library = library.to_str().unwrap();
    let measured = succeed(shield().args(["plugin", "bench", library, "--seconds", "0.01", "--json"]));
    let rows: Vec<serde_json::Value> = serde_json::from_str(&measured).unwrap();
    let calls: Vec<&str> = rows.iter().map(|row| row["call"].as_str().unwrap()).collect();
    let of_rule = ["create", "evaluate", "linearise", "observe", "save", "load"];
    let of_environment = ["create", "reset", "step", "save", "load"];
    let mut expected = [&of_rule[..], &of_environment[..]];
    if rows[0]["plugin"] == "kept/corridor" {
        expected.reverse();
    }
    assert_eq!(calls, expected.concat());
    for row in &rows {
        let [p50, p99] = ["p50_ns", "p99_ns"].map(|key| row[key].as_f64().unwrap());
        assert!(p50 > 0.0 && p50 <= p99 && row["calls"].as_u64().unwrap() >= 3, "{row}");
        // Its source makes a vector for each row, and saves into one.
        let allocates = ["create", "linearise", "save"].contains(&row["call"].as_str().unwrap());
        assert_eq!(row["allocations"].as_f64().unwrap() > 0.0, allocates, "{row}");
    }
    let table = succeed(shield().args(["plugin", "bench", "tabular-q", "--seconds", "0.01"]));
    for part in ["P50", "P99", "ALLOCATIONS", "q_values", "update"] {
        assert!(table.contains(part), "{part:?} is missing in: {table}");
    }
    // It has no numbers to learn from: the spaces that are asked for are those that it is given.
    let numbers = shield().args(["plugin", "bench", "tabular-q", "--observation", "3"]).output().unwrap();
    assert_eq!(numbers.status.code(), Some(1), "{}", text(&numbers.stdout));
    assert!(text(&numbers.stderr).contains("error: tabular-q: "), "{}", text(&numbers.stderr));
    let nowhere = tempfile::tempdir().unwrap();
    refused(
        nowhere.path(),
        &["plugin", "bench", "tabular-q", "--seconds", "NaN"],
        &["--seconds NaN is no time"],
    );
}

/// A folder with copies of the plugins that the gridworld needs, and the experiment.
fn own_plugins() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let plugins = folder.path().join("plugins");
    fs::create_dir(&plugins).unwrap();
    for name in ["gridworld", "tabular_q", "ensemble_threshold"] {
        let file = format!("lib{name}{}", env::consts::DLL_SUFFIX);
        fs::copy(plugins_folder().join(&file), plugins.join(&file)).unwrap();
    }
    fs::write(folder.path().join("x.ron"), gridworld(300, "")).unwrap();
    (folder, plugins)
}

fn with_plugins(folder: &Path, plugins: &Path, arguments: &[&str]) -> Output {
    shield().current_dir(folder).env("SHIELD_PLUGIN_PATH", plugins).args(arguments).output().unwrap()
}

#[test]
fn a_pinned_experiment_runs_with_the_pinned_files_alone() {
    let (folder, plugins) = own_plugins();
    let run = |arguments: &[&str]| with_plugins(folder.path(), &plugins, arguments);
    let locked = run(&["plugin", "lock", "x.ron"]);
    assert!(locked.status.success(), "{}", text(&locked.stderr));
    let pinned = fs::read_to_string(folder.path().join("x.ron")).unwrap();
    assert_eq!(pinned.matches("\": \"").count(), 3, "{pinned}");
    assert!(run(&["run", "x.ron"]).status.success());
    assert!(run(&["plugin", "lock", "x.ron"]).status.success());
    assert!(
        fs::read_to_string(folder.path().join("x.ron")).unwrap() == pinned,
        "pinning twice changes the file"
    );

    // One byte more behind the library: it would still load.
    let changed = plugins.join(format!("libtabular_q{}", env::consts::DLL_SUFFIX));
    let mut bytes = fs::read(&changed).unwrap();
    bytes.push(0);
    fs::write(&changed, bytes).unwrap();
    let output = run(&["run", "x.ron", "--out", "again"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    for part in ["x.ron:", "libtabular_q", "the experiment pins \"tabular-q\"", "shield plugin lock"] {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
    assert!(!folder.path().join("again").exists());
}

#[test]
fn a_malformed_or_unused_pin_is_refused_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    for (pin, expected) in
        [("\"tabular-q\": \"abc\"", "not a SHA-256"), ("\"tabula-q\": \"{}\"", "no variant uses")]
    {
        let pins = format!("pins: {{{}}},", pin.replace("{}", &"0".repeat(64)));
        fs::write(folder.path().join("x.ron"), gridworld(300, &pins)).unwrap();
        refused(folder.path(), &["run", "x.ron"], &["x.ron:14:", expected]);
    }
}

#[cfg(unix)]
#[test]
fn a_library_that_everyone_may_replace_is_refused_unless_that_is_allowed() {
    use std::os::unix::fs::PermissionsExt as _;
    let (folder, plugins) = own_plugins();
    let file = plugins.join(format!("libgridworld{}", env::consts::DLL_SUFFIX));
    let usual = [(&file, 0o644), (&plugins, 0o755)];
    for (path, mode) in [(&file, 0o666), (&plugins, 0o777)] {
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        let output = with_plugins(folder.path(), &plugins, &["run", "x.ron"]);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("is writable by every user") && message.contains("chmod o-w"), "{message}");
        assert!(!folder.path().join("runs").exists());
        let mut allowed = shield();
        allowed.env("SHIELD_PLUGIN_PATH", &plugins).env("SHIELD_ALLOW_WRITABLE_PLUGINS", "1");
        succeed(allowed.current_dir(folder.path()).args(["run", "x.ron", "--out", "allowed", "--overwrite"]));
        for (path, mode) in usual {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        }
    }
}
