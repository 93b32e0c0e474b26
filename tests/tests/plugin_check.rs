//! `shield plugin check`: it passes what is sound, and finds each planted defect by the check that is meant for it.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
};

use serde_json::Value;
use shield_tests::{shield, workspace};

fn compile(compiler: &str, arguments: &[&str], source: &Path, name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("checked");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(format!("lib{name}{}", env::consts::DLL_SUFFIX));
    let include = workspace().join("shield-api/include");
    let mut command = Command::new(compiler);
    command
        .args(["-O1", "-fPIC", "-shared", "-I"])
        .arg(include)
        .args(arguments)
        .arg("-o")
        .arg(&path)
        .arg(source);
    let output = command.arg("-lm").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    path
}

/// Every line of the report on a plugin or library.
fn checked(plugin: &str, extra: &[&str]) -> Vec<Value> {
    let output = shield().args(["plugin", "check", plugin, "--json"]).args(extra).output().unwrap();
    let report = String::from_utf8_lossy(&output.stdout).into_owned();
    let lines: Vec<Value> = serde_json::from_str(&report)
        .unwrap_or_else(|_| panic!("{report}{}", String::from_utf8_lossy(&output.stderr)));
    let is_bad = lines.iter().any(|line| line["verdict"] != "pass" && line["verdict"] != "skip");
    assert_eq!(output.status.code(), Some(i32::from(is_bad)), "the exit code says what the report says");
    lines
}

fn bad(lines: &[Value]) -> Vec<String> {
    let is_bad = |line: &&Value| line["verdict"] != "pass" && line["verdict"] != "skip";
    let text =
        |line: &Value| format!("{} {} {}", line["check"], line["verdict"], line["reason"]).replace('"', "");
    lines.iter().filter(is_bad).map(text).collect()
}

/// The defect's name, and the check that must find it with a part of what it says.
fn finds(kind: u32, defect: &str, check: &str, expected: &str) {
    let source = workspace().join("tests/fixtures/c/defects.c");
    let defines = [format!("-DDEFECT_KIND={kind}"), format!("-DDEFECT={defect}")];
    let library =
        compile("cc", &[&defines[0], &defines[1]], &source, &format!("defect_{}", defect.to_lowercase()));
    let library = library.to_str().unwrap();
    if check.is_empty() {
        let found = bad(&checked(library, &[]));
        assert!(found.is_empty(), "{defect}: {found:?}");
        return;
    }
    let found = bad(&checked(library, &["--only", check, "--time-limit", "5"]));
    assert!(
        found.iter().any(|line| line.contains(expected)),
        "{defect}: {expected:?} is missing in {found:?}"
    );
}

#[test]
fn planted_defects_of_environments_are_found() {
    finds(1, "NONE", "", "");
    for (defect, check, expected) in [
        ("WRITES_BEHIND", "guards", "behind the buffer of the observation"),
        ("WRITES_BEFORE_ACTION", "guards", "before the buffer of the action"),
        ("NAN_OBSERVATION", "finite", "NaN"),
        ("FORGETS_SEED", "seed", "another instance does something else"),
        ("EXECUTES_NAN", "bad-actions", "is executed"),
        ("LOADS_ANYTHING", "foreign-state", "are loaded as a state"),
        ("FORGETS_STATE", "state", "continues differently"),
        ("TAKES_ANY_FIELD", "unknown-field", "is accepted"),
        ("SEGFAULTS", "finite", "CRASH the process died of signal 11 (segmentation fault)"),
        ("HANGS", "finite", "HANG"),
        ("EXITS", "finite", "CRASH the process ended with"),
        ("ABORTS", "finite", "signal 6"),
        ("LEAKS", "memory", "stay behind"),
        ("RICH_REWARD", "reset-reward", "a reset reward is 2"),
        ("OUT_OF_BOUNDS", "spaces", "outside [-2, 2]"),
        ("REFUSES_TOO_LATE", "bad-actions", "changed the state"),
        ("SHARES_STATE", "instances", "something else than alone"),
        ("CHANGES_WHEN_LOADING", "foreign-state", "changed the state"),
        #[cfg(all(target_os = "linux", target_env = "gnu"))]
        ("ALLOCATES", "allocations", "allocations in"),
    ] {
        finds(1, defect, check, expected);
    }
}

#[test]
fn planted_defects_of_policies_and_rules_are_found() {
    finds(3, "POLICY_NONE", "", "");
    for (defect, check, expected) in [
        ("ACTS_OUTSIDE", "answers", "outside [-1, 1]"),
        ("POLICY_WRITES_BEHIND", "answers", "behind the buffer of the action"),
        ("ACTS_ON_NAN", "bad-numbers", "is not refused"),
        ("POLICY_DIFFERS", "seed", "different answers"),
        ("CHANGES_ITS_INPUT", "answers", "given to read"),
    ] {
        finds(3, defect, check, expected);
    }
    finds(4, "RULE_NONE", "", "");
    for (defect, check, expected) in [
        ("ALLOWS_NAN", "bad-numbers", "is not refused"),
        ("CHANGES_ITS_MIND", "answers", "two verdicts for one context"),
        ("LONG_REASON", "answers", "257 bytes of a reason"),
        ("NAN_SCORE", "answers", "NaN for the score"),
    ] {
        finds(4, defect, check, expected);
    }
}

#[test]
fn planted_defects_of_success_critics_and_of_rules_with_undo_probabilities_are_found() {
    finds(6, "CRITIC_NONE", "", "");
    finds(6, "CRITIC_CONSTANT", "", "");
    for (defect, check, expected) in [
        ("ABOVE_ONE", "answers", "gave 1.5 for a probability"),
        ("ESTIMATES_NAN", "bad-numbers", "is not refused"),
        ("LEARNS_NAN", "bad-numbers", "is not refused"),
        ("TWO_OPINIONS", "answers", "without gradients"),
        ("CRITIC_DIFFERS", "seed", "different answers"),
        ("WRONG_SIGN", "gradient", "where the probabilities change by"),
        ("LEARNS_BACKWARDS", "learning", "attempts that succeed it estimates"),
        #[cfg(all(target_os = "linux", target_env = "gnu"))]
        ("ESTIMATES_ALLOCATE", "allocations", "allocations in"),
    ] {
        finds(6, defect, check, expected);
    }
    finds(4, "UNDO_NONE", "", "");
    for (defect, check, expected) in [
        ("UNDO_ALLOWS_NAN", "bad-numbers", "undo probabilities is not refused"),
        ("UNDO_CHANGES_ITS_MIND", "answers", "two verdicts for one context"),
        ("UNDO_WRITES_ESTIMATES", "answers", "given to read"),
    ] {
        finds(4, defect, check, expected);
    }
}

#[test]
fn our_own_plugins_and_the_examples_in_c_and_cpp_pass_every_check() {
    let listed = shield().args(["plugin", "list"]).output().unwrap();
    let listed = String::from_utf8(listed.stdout).unwrap();
    // Environments have a suite of their own; here one of them stands for the command. Without a file, `onnx` is nothing to check.
    let others = listed
        .lines()
        .skip(1)
        .take_while(|line| !line.is_empty())
        .filter(|line| !line.contains(" environment "));
    let mut ids: Vec<String> =
        others.filter_map(|line| Some(line.split_whitespace().next()?.to_string())).collect();
    ids.retain(|id| id != "onnx");
    assert!(ids.len() >= 9, "{ids:?}");
    ids.push("gridworld".into());
    let examples = workspace().join("examples/plugins");
    for (compiler, source, name) in
        [("cc", "tank-c/tank.c", "tank"), ("c++", "rate-limit-cpp/rate_limit.cpp", "rate_limit")]
    {
        let arguments = ["-Wall", "-Wextra", "-Werror", "-fvisibility=hidden"];
        ids.push(compile(compiler, &arguments, &examples.join(source), name).to_str().unwrap().into());
    }
    for id in ids {
        // A rule on actions has to know how many numbers they have.
        let of_two = ["--config", "(constraints: [(a: [1.0, 0.0], b: 0.5)])"];
        let extra = if id == "linear-constraints" { &of_two[..] } else { &[] };
        let found = bad(&checked(&id, extra));
        assert!(found.is_empty(), "{id}: {found:?}");
    }
}
