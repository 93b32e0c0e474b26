//! The command `shield` as a user meets it: what it writes, what it refuses, and with which exit code.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::Path,
    process::{Output, Stdio},
    time::{Duration, Instant},
};

use serde_json::Value;
use shield_tests::{cart, gridworld, run_files, shield, workspace};
use tempfile::TempDir;

/// Runs `experiment` in a folder of its own.
fn run(experiment: &str, arguments: &[&str]) -> (Output, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let output = run_in(folder.path(), experiment, arguments);
    (output, folder)
}

fn run_in(folder: &Path, experiment: &str, arguments: &[&str]) -> Output {
    fs::write(folder.join("x.ron"), experiment).unwrap();
    shield().current_dir(folder).args(["run", "x.ron"]).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn summary(run: &Path) -> Value {
    serde_json::from_slice(&fs::read(run.join("summary.json")).unwrap()).unwrap()
}

/// The experiment is refused with exit code 2 and a message that contains `expected`; nothing is written.
fn refused(experiment: &str, arguments: &[&str], expected: &[&str]) {
    let (output, folder) = run(experiment, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    for part in expected {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
    assert!(!folder.path().join("runs").exists(), "a refused start left a folder: {message}");
}

#[test]
fn a_run_writes_its_folder_and_prints_a_table() {
    let variants = r#"variants: {"a": [], "b": [("mode", StatusQuo)]},"#;
    let (output, folder) = run(&gridworld(1_000, variants), &[]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let printed = text(&output.stdout);
    for part in ["a ", "b ", "resets", "irreversible", "Runs are in runs/small"] {
        assert!(printed.contains(part), "{part:?} is missing in: {printed}");
    }
    for (variant, seed) in [("a", 0), ("a", 1), ("b", 0), ("b", 1)] {
        let run = folder.path().join(format!("runs/small/{variant}/seed-{seed}"));
        let files = [
            "config.ron",
            "metrics.csv",
            "interventions.csv",
            "evaluations.csv",
            "learning.csv",
            "timings.csv",
        ];
        for file in files {
            assert!(run.join(file).exists(), "{file} is missing");
        }
        let summary = summary(&run);
        assert_eq!(
            (&summary["steps"], &summary["variant"], &summary["seed"]),
            (&1_000.into(), &variant.into(), &seed.into())
        );
        assert_eq!(summary["complete"], true);
        let metrics = fs::read_to_string(run.join("metrics.csv")).unwrap();
        let length: u64 =
            metrics.lines().skip(1).map(|row| row.split(',').nth(3).unwrap().parse::<u64>().unwrap()).sum();
        assert_eq!(length, 1_000, "the episodes add up to the steps");
        let hard_resets = metrics.lines().skip(1).filter(|row| row.split(',').nth(9) == Some("1")).count();
        assert_eq!(summary["hard_resets"], hard_resets);
    }
}

#[test]
fn the_resolved_configuration_gives_the_same_results() {
    let (output, folder) = run(&gridworld(1_000, ""), &["--seeds", "1"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let first = folder.path().join("runs/small/default/seed-1");
    let resolved = fs::read_to_string(first.join("config.ron")).unwrap();
    assert!(resolved.contains("initial_high: 1.0"), "a plugin's defaults are written out: {resolved}");
    let output = run_in(folder.path(), &resolved, &["--out", "again"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let second = folder.path().join("again/small/default/seed-1");
    for file in ["metrics.csv", "interventions.csv", "evaluations.csv", "learning.csv", "config.ron"] {
        assert_eq!(fs::read(first.join(file)).unwrap(), fs::read(second.join(file)).unwrap(), "{file}");
    }
}

#[test]
fn arguments_override_the_experiment() {
    let variants = r#"variants: {"a": [], "b": []},"#;
    let arguments = [
        "--steps",
        "300",
        "--seeds",
        "7",
        "--variants",
        "b",
        "--set",
        "shield.rules[0].config.q_min=0.0",
        "--jobs",
        "1",
    ];
    let (output, folder) = run(&gridworld(1_000, variants), &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(!folder.path().join("runs/small/a").exists());
    let summary = summary(&folder.path().join("runs/small/b/seed-7"));
    assert_eq!((&summary["steps"], &summary["early_aborts"]), (&300.into(), &0.into()));
}

#[test]
fn wrong_input_is_refused_with_its_place() {
    let good = gridworld(100, "");
    refused(
        &good.replace("warm_up_steps", "warm_up_step"),
        &[],
        &["x.ron:10:", "warm_up_step", "warm_up_steps"],
    );
    let misspelt = good.replace("combine: Optimistic", "combne: Optimistic");
    refused(&misspelt, &[], &["x.ron:9:", "combne", "did you mean `combine`?"]);
    for set in ["shield.rules[0].config.q_min=NaN", "reset.config.members=0"] {
        refused(&good, &["--set", set], &[&format!("error: --set {set}: ")]);
    }
    refused(&good, &["--set", "shield.ruls[0].config.q_min=3"], &["`ruls`", "did you mean `rules`?"]);
    refused(&good, &["--jobs", "0"], &["--jobs"]);
    refused(&good.replace("q_min: 0.4", "q_min: \"high\""), &[], &["x.ron:9:"]);
    refused(&good.replace("\"tabular-q\"", "\"tabular\""), &[], &["x.ron:6:", "tabular-q"]);
    let nested = good
        .replace("rules: [(", "rules: [Any([(plugin: \"deadline-latch\", config: (stps: 3)), (")
        .replace("Optimistic))]", "Optimistic))])]");
    refused(&nested, &[], &["x.ron:9:", "stps"]);
    refused(
        &good.replace("reset: (plugin: \"tabular-q\")", "reset: (plugin: \"gridworld\")"),
        &[],
        &["x.ron:7:", "environment"],
    );
    refused(&good.replace("steps: 100", "steps: 0"), &[], &["x.ron:3:", "at least one step"]);
    refused(
        &good.replace("evaluation: Some(", "evaluation: Some(start: Some(\"roof\"), "),
        &[],
        &["x.ron:13:", "roof"],
    );
    refused(&good, &["--set", "shield.warm_up_step=3"], &["--set shield.warm_up_step=3"]);
    refused(&good, &["--variants", "q"], &["default"]);
    refused("Experiment(", &[], &["x.ron:1:"]);
    refused(&gridworld(100, "mode: ResetOnly(strat: None),"), &[], &["x.ron:14:", "strat"]);
    refused(&good, &["--set", "experience.capacity=1152921504606846976"], &["no memory", "capacity"]);
    let discrete = good.replace("warm_up_steps", "projection: Qp(), warm_up_steps");
    refused(&discrete, &[], &["x.ron:10:", "actions are discrete", "`Best` and `Replace` work here"]);
    let override_of_b = r#"variants: {"a": [], "b": [("shield.rules[0].config.q_min", "x")]},"#;
    refused(&gridworld(100, override_of_b), &[], &["x.ron:14:", "b"]);
}

#[test]
fn a_text_of_any_depth_or_length_is_refused_with_its_place() {
    let good = gridworld(100, "");
    let deep = |levels: usize| format!("{}1{}", "[".repeat(levels), "]".repeat(levels));
    let too_deep = "more than 128 brackets";
    for levels in [200, 3_901, 10_073] {
        let rules = good.replace("rules: [(", &format!("rules: [{}(", "All([".repeat(levels)));
        refused(&rules, &[], &["x.ron:9:", too_deep]);
        let options = good.replace("q_min: 0.4", &format!("q_min: {}0.4", "Some(".repeat(levels)));
        refused(&options, &[], &["x.ron:9:", too_deep]);
        refused(&deep(levels), &[], &["x.ron:1:129: ", too_deep]);
    }
    refused(&good, &["--set", &format!("reset.config={}", deep(200))], &["--set reset.config=", too_deep]);
    let nested = format!("environment.config{}=1", ".x".repeat(127));
    refused(&good, &["--set", &nested], &["--set environment.config.x", "more than 128 parts"]);
    let long = format!("{good}//{}", "x".repeat(5 << 20));
    refused(&long, &[], &["x.ron:16:", "at most 4194304 are read"]);
    let twice = good.replace("steps: 100,", "steps: 100,\n    steps: 200,");
    refused(&twice, &[], &["x.ron:4:5: `steps` is given twice"]);
}

#[test]
fn a_refused_setting_of_a_plugin_is_named_with_its_place() {
    let good = gridworld(100, "");
    let with = |config: &str| good.replace("config: (q_min: 0.4, combine: Optimistic)", config);
    for (config, place, message) in [
        ("config: (\n combine: Optimistic,\n q_min: NaN)", "x.ron:11:9: ", "q_min is NaN"),
        ("config: (q_min: 0.4,\n combine: Quantile(2.0))", "x.ron:10:11: ", "the quantile is 2"),
        ("config: (\n q_min: 0.4, schedule: Linear)", "x.ron:10:24: ", "a schedule needs final_q_min"),
        ("config: (\n\n final_q_min: Some(0.4))", "x.ron:11:15: ", "have no effect"),
        ("config: (\n q_mim: 0.4)", "x.ron:10:2: ", "did you mean `q_min`?"),
        ("config: (\n combine: KOfN(-1))", "x.ron:10:16: ", "a whole number of at least 0, found -1"),
    ] {
        refused(&with(config), &[], &[place, message]);
    }
}

#[test]
fn a_missing_file_and_a_missing_argument_are_input_errors() {
    let output = shield().args(["run", "/nonexistent/x.ron"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("/nonexistent/x.ron"));
    assert_eq!(shield().arg("run").output().unwrap().status.code(), Some(2));
    assert_eq!(shield().arg("walk").output().unwrap().status.code(), Some(2));
}

#[test]
fn an_earlier_run_is_overwritten_only_when_told_to() {
    let (output, folder) = run(&gridworld(200, ""), &["--seeds", "0"]);
    assert!(output.status.success());
    let metrics = folder.path().join("runs/small/default/seed-0/metrics.csv");
    fs::write(&metrics, "precious").unwrap();
    let output = run_in(folder.path(), &gridworld(200, ""), &["--seeds", "1,0"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let kept = "1 run is finished already and kept; --overwrite makes it anew";
    assert!(text(&output.stderr).contains(kept), "{}", text(&output.stderr));
    assert_eq!(fs::read_to_string(&metrics).unwrap(), "precious");
    assert!(folder.path().join("runs/small/default/seed-1/summary.json").exists());
    let output =
        run_in(folder.path(), &gridworld(200, ""), &["--seeds", "2,0", "--set", "experience.batch=8"]);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    assert!(message.contains("`experience.batch` is 16") && message.contains("--overwrite"), "{message}");
    assert_eq!(fs::read_to_string(&metrics).unwrap(), "precious");
    assert!(!folder.path().join("runs/small/default/seed-2").exists());
    let output = run_in(folder.path(), &gridworld(200, ""), &["--seeds", "0", "--overwrite"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_ne!(fs::read_to_string(&metrics).unwrap(), "precious");
}

#[test]
fn a_broken_pipe_is_not_an_error() {
    let mut list = shield();
    list.args(["plugin", "list"]).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = list.spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output.stderr));
}

#[test]
fn a_folder_that_cannot_be_written_fails_the_run() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("runs"), "a file, not a folder").unwrap();
    let output = run_in(folder.path(), &gridworld(200, ""), &[]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("runs/small/default/seed-0"), "{}", text(&output.stderr));
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_fails_the_run_with_a_message() {
    use std::os::unix::process::CommandExt;
    let folder = tempfile::tempdir().unwrap();
    let experiment = gridworld(4_000, "checkpoint: (every: 500),");
    fs::write(folder.path().join("x.ron"), &experiment).unwrap();
    let mut command = shield();
    command.current_dir(folder.path()).args(["run", "x.ron", "--seeds", "0"]);
    // SAFETY: the two calls are safe between fork and exec. A limit on the size of files stands for the full disk.
    unsafe {
        command.pre_exec(|| {
            let limit = libc::rlimit { rlim_cur: 400_000, rlim_max: 400_000 };
            libc::setrlimit(libc::RLIMIT_FSIZE, &limit);
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
            Ok(())
        });
    }
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("seed-0"), "{}", text(&output.stderr));
    // With room again, nothing is lost.
    let output = run_in(folder.path(), &experiment, &["--seeds", "0"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("goes on after"), "{}", text(&output.stderr));
    let (_, calm) = run(&experiment, &["--seeds", "0"]);
    let files = |folder: &TempDir| run_files(&folder.path().join("runs/small/default/seed-0"));
    assert!(files(&folder) == files(&calm), "the continued run differs");
}

#[test]
#[cfg(target_os = "linux")]
fn ctrl_c_finishes_the_row_and_writes_the_summary() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), cart(100_000_000, "")).unwrap();
    let mut child = shield()
        .current_dir(folder.path())
        .args(["run", "x.ron"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let metrics = folder.path().join("runs/cart/default/seed-0/metrics.csv");
    let start = Instant::now();
    while fs::metadata(&metrics).map_or(0, |data| data.len()) < 500 {
        assert!(start.elapsed() < Duration::from_secs(60), "no row was written");
        std::thread::sleep(Duration::from_millis(50));
    }
    // SAFETY: a signal to our own child.
    unsafe { libc::kill(i32::try_from(child.id()).unwrap(), libc::SIGINT) };
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(130));
    let summary = summary(metrics.parent().unwrap());
    assert_eq!(summary["complete"], false);
    let rows = fs::read_to_string(&metrics).unwrap();
    let last = rows.lines().last().unwrap();
    assert!(rows.ends_with('\n') && last.contains("interrupted"), "{last}");
    assert_eq!(last.split(',').next().unwrap(), summary["steps"].to_string());
}

#[test]
fn an_evaluation_repeats_the_last_one_of_the_run_and_changes_nothing() {
    let (output, folder) = run(&gridworld(3_000, ""), &[]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let eval = |arguments: &[&str]| {
        shield().current_dir(folder.path()).args(["eval", "runs/small"]).args(arguments).output().unwrap()
    };
    let runs = [0, 1].map(|seed| folder.path().join(format!("runs/small/default/seed-{seed}")));
    let before =
        runs.clone().map(|run| (run_files(&run), fs::read(run.join("checkpoint/latest.bin")).unwrap()));
    let output = eval(&["--episodes", "1", "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let evaluated: Value = serde_json::from_slice(&output.stdout).unwrap();
    for (index, run) in runs.iter().enumerate() {
        let summary = summary(run);
        assert_eq!(evaluated[index]["mean_return"], summary["final_return"]);
        assert_eq!(evaluated[index]["success_rate"], summary["success_rate"]);
        assert_eq!(
            (&evaluated[index]["step"], &evaluated[index]["seed"]),
            (&summary["steps"], &summary["seed"])
        );
    }
    let reset: Value =
        serde_json::from_slice(&eval(&["--episodes", "1", "--agent", "reset", "--json"]).stdout).unwrap();
    assert_ne!(evaluated[0]["mean_return"], reset[0]["mean_return"]);
    let output = eval(&["--episodes", "3", "--shielded"]);
    assert!(output.status.success() && text(&output.stdout).contains("3000"), "{}", text(&output.stderr));
    let after = runs.map(|run| (run_files(&run), fs::read(run.join("checkpoint/latest.bin")).unwrap()));
    assert!(before == after, "an evaluation changed a run");

    let refused = |output: Output, expected: &str| {
        let message = text(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains(expected), "{message}");
    };
    refused(eval(&["--start", "roof"]), "roof");
    fs::remove_dir_all(folder.path().join("runs/small/default/seed-0/checkpoint")).unwrap();
    let output = eval(&[]);
    let warning = text(&output.stderr);
    assert!(output.status.success(), "{warning}");
    assert!(warning.contains("left out: runs/small/default/seed-0: ") && warning.contains("no checkpoint"));
    let one = |command: &str, run: &str, more: &[&str]| {
        shield().current_dir(folder.path()).args([command, run]).args(more).output().unwrap()
    };
    refused(one("eval", "runs/small/default/seed-0", &[]), "no checkpoint");
    refused(one("render", "runs/small/default/seed-0", &["--out", "x.gif"]), "no checkpoint");
    refused(one("render", "runs/small", &["--out", "x.gif"]), "such as runs/small/default/seed-0");
    refused(one("export", "runs", &[]), "such as runs/small/default/seed-0");
    let nothing = shield().args(["eval"]).arg(folder.path().join("runs/small/default/seed-0/none")).output();
    refused(nothing.unwrap(), "none");
}

#[test]
fn a_run_that_cannot_be_evaluated_is_left_out() {
    let variants = r#"variants: {"a": [], "b": [("mode", StatusQuo)]},"#;
    let (output, folder) = run(&gridworld(300, variants), &["--seeds", "0"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let eval =
        |root: &str| shield().current_dir(folder.path()).args(["eval", root, "--shielded"]).output().unwrap();
    let output = eval("runs/small");
    let (table, warning) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success() && table.contains("│ a ") && !table.contains("│ b "), "{table}");
    assert!(
        warning.contains("left out: runs/small/b/seed-0: ") && warning.contains("no shield"),
        "{warning}"
    );
    let output = eval("runs/small/b");
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("runs/small/b/seed-0"), "{}", text(&output.stderr));
    let out = ["render", "x.ron", "--out", "x.gif", "--policy", "reset", "--variant", "b"];
    let output = shield().current_dir(folder.path()).args(out).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
}

#[test]
fn stopped_runs_continue_from_their_folder() {
    let (output, folder) = run(&gridworld(2_000, "checkpoint: (every: 500),"), &["--seeds", "0"]);
    assert!(output.status.success());
    let run = folder.path().join("runs/small/default/seed-0");
    let expected = run_files(&run);
    fs::remove_file(run.join("summary.json")).unwrap();
    let output = shield().current_dir(folder.path()).args(["resume", "runs"]).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("default"), "{}", text(&output.stdout));
    assert!(run_files(&run) == expected, "the continued run differs");
    let output = shield().current_dir(folder.path()).args(["resume", "."]).output().unwrap();
    let kept = text(&output.stderr);
    assert!(kept.contains("finished already") && !kept.contains("--overwrite"), "{kept}");
    let empty = tempfile::tempdir().unwrap();
    let output = shield().arg("resume").arg(empty.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("no run in it"), "{}", text(&output.stderr));
}

#[test]
fn the_list_of_plugins_names_them() {
    let output = shield().args(["plugin", "list"]).output().unwrap();
    assert!(output.status.success());
    let printed = text(&output.stdout);
    for part in [
        "ddpg",
        "ddqn",
        "td3",
        "gridworld",
        "mujoco/cliff-cart",
        "mujoco/cliff-cheetah",
        "near-start",
        "calibrated-start",
        "success-critic",
        "tabular-success",
        "undo-probability",
        "ensemble-threshold",
    ] {
        assert!(printed.contains(part), "{part} is missing in: {printed}");
    }
}

#[test]
fn help_shows_examples_and_options() {
    for (arguments, expected) in [(&["--help"][..], "Examples:"), (&["run", "--help"], "--overwrite")] {
        let output = shield().args(arguments).output().unwrap();
        assert!(output.status.success() && text(&output.stdout).contains(expected));
    }
}

/// Starts the examples in Python, or those that are not, with further arguments. Paths in them count from the workspace.
fn start_examples(in_python: bool, arguments: &[&str]) {
    for entry in fs::read_dir(workspace().join("examples")).unwrap() {
        let path = entry.unwrap().path();
        let is_example = path.extension().is_some_and(|extension| extension == "ron");
        if !is_example || fs::read_to_string(&path).unwrap().contains("\"gymnasium\"") != in_python {
            continue;
        }
        let folder = tempfile::tempdir().unwrap();
        let mut command = shield();
        command
            .current_dir(workspace())
            .arg("run")
            .arg(&path)
            .args(arguments)
            .args(["--steps", "60", "--out"]);
        let output = command.arg(folder.path()).output().unwrap();
        assert!(output.status.success(), "{}: {}", path.display(), text(&output.stderr));
    }
}

#[test]
fn every_example_starts() {
    start_examples(false, &["--set", "evaluation.episodes=1"]);
}

#[cfg(feature = "python-tests")]
#[test]
fn every_example_in_python_starts() {
    let python =
        std::env::var("SHIELD_PEERS_PYTHON").expect("`cargo xtask test --peers` names the interpreter");
    start_examples(true, &["--set", &format!("environment.config.python={python:?}")]);
}
