//! `bench --against`: what decisions, environment steps and updates cost here and at another commit, measured in turn in one run.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use anyhow::{Context, ensure};
use serde::Deserialize;

use crate::{cargo, native, say::say};

/// How often each side is measured. The best time counts: what else runs on the machine only slows.
const ROUNDS: usize = 5;

/// What both sides run.
const EXPERIMENT: &str = include_str!("against/runs.ron");

/// Its variants.
const VARIANTS: [&str; 2] = ["gridworld", "cheetah"];

/// Plugins whose every call is measured, with further arguments of `shield plugin bench`.
const PLUGINS: [(&str, &[&str]); 4] = [
    ("ddpg", &["--config", "(critics: 20)", "--observation", "17", "--action", "6"]),
    ("ensemble-threshold", &[]),
    ("gridworld", &[]),
    ("mujoco/cliff-cheetah", &[]),
];

/// Measures the workspace against `commit`, whose sources and build stay in `target/against`. `mujoco` is the folder of MuJoCo's library.
///
/// # Errors
/// There is no such commit; something cannot be built or started; the commit is older than what is measured.
pub fn bench(root: &Path, mujoco: &Path, commit: &str) -> anyhow::Result<()> {
    let commit = resolve(root, commit)?;
    let folder = cargo::target_folder()?.join("against").join(&commit);
    let programs = [build_there(root, mujoco, &folder, &commit)?, {
        crate::build(root, true)?;
        crate::program()?
    }];
    let mut costs = Costs::default();
    for round in 0..ROUNDS {
        say(format_args!("round {} of {ROUNDS}", round + 1));
        for side in if round % 2 == 0 { [0, 1] } else { [1, 0] } {
            let scratch = native::scratch_beside(&folder.join("runs"))?;
            measure(&programs[side], scratch.path(), &mut |name, microseconds| {
                costs.note(name, side, microseconds);
            })?;
        }
    }
    say(costs.table(&commit));
    Ok(())
}

/// The full hash of a commit.
fn resolve(root: &Path, commit: &str) -> anyhow::Result<String> {
    let mut git = Command::new("git");
    git.current_dir(root).args(["rev-parse", "--verify", "--quiet", "--end-of-options"]);
    let output = git.arg(format!("{commit}^{{commit}}")).output().context("git could not be started")?;
    ensure!(
        output.status.success(),
        "there is no commit {commit} here; `git log` lists those that there are"
    );
    Ok(String::from_utf8(output.stdout).context("git gives no hash")?.trim().to_owned())
}

/// Builds a commit in a folder of its own, as [`crate::build`] builds the workspace. Returns its program.
fn build_there(root: &Path, mujoco: &Path, folder: &Path, commit: &str) -> anyhow::Result<PathBuf> {
    let (source, target) = (folder.join("source"), folder.join("target"));
    if !source.exists() {
        let scratch = native::scratch_beside(&source)?;
        unpack(root, commit, scratch.path()).with_context(|| format!("the files of {commit}"))?;
        fs::rename(scratch.keep(), &source).with_context(|| format!("cannot fill {}", source.display()))?;
    }
    let mut command = crate::build_command(&source, true);
    cargo::run(command.env("CARGO_TARGET_DIR", &target).env(cargo::MUJOCO_FOLDER, mujoco))?;
    Ok(target.join("release").join(crate::program_name()))
}

fn unpack(root: &Path, commit: &str, folder: &Path) -> anyhow::Result<()> {
    let mut git = Command::new("git");
    git.current_dir(root).args(["archive", "--format=tar", commit]).stdout(Stdio::piped());
    let mut git = git.spawn().context("git could not be started")?;
    let files = git.stdout.take().context("the output of git was asked for")?;
    tar::Archive::new(files).unpack(folder)?;
    ensure!(git.wait()?.success(), "git archive failed");
    Ok(())
}

/// A row of `shield plugin bench --json`.
#[derive(Deserialize)]
struct Call {
    plugin: String,
    call: String,
    p50_ns: f64,
}

/// What is read of `summary.json`.
#[derive(Deserialize)]
struct Summary {
    steps_per_second: f64,
    decision_us_p50: Option<f64>,
    early_aborts: u64,
    hard_resets: u64,
}

/// Measures everything once, each in microseconds.
fn measure(program: &Path, folder: &Path, note: &mut dyn FnMut(String, f64)) -> anyhow::Result<()> {
    for (plugin, arguments) in PLUGINS {
        let bench = ["plugin", "bench", plugin, "--json", "--seconds", "0.2"];
        let json = output(Command::new(program).args(bench).args(arguments))?;
        let calls: Vec<Call> = serde_json::from_str(&json).context("what `shield plugin bench` prints")?;
        for Call { plugin, call, p50_ns } in calls {
            note(format!("{plugin}: {call}"), p50_ns / 1e3);
        }
    }
    let (file, out) = (folder.join("against.ron"), folder.join("runs"));
    fs::write(&file, EXPERIMENT).with_context(|| format!("cannot write {}", file.display()))?;
    output(Command::new(program).arg("run").arg(&file).arg("--out").arg(&out).args(["--jobs", "1"]))?;
    for variant in VARIANTS {
        let path = out.join("against").join(variant).join("seed-0/summary.json");
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let summary: Summary = serde_json::from_str(&text).context("a summary")?;
        let Summary { steps_per_second, decision_us_p50, early_aborts, hard_resets } = summary;
        note(format!("run {variant}: step, updates included"), 1e6 / steps_per_second);
        note(format!("run {variant}: decision"), decision_us_p50.context("the run decided nothing")?);
        // No cost, but the same on both sides if they did the same work.
        note(format!("run {variant}: {EARLY_ABORTS}"), early_aborts as f64);
        note(format!("run {variant}: {HARD_RESETS}"), hard_resets as f64);
    }
    Ok(())
}

const EARLY_ABORTS: &str = "early aborts";
const HARD_RESETS: &str = "hard resets";

/// What a program prints. It loads the plugins beside it, not those of the user's search path.
fn output(command: &mut Command) -> anyhow::Result<String> {
    let command = command.env_remove("SHIELD_PLUGIN_PATH").stdin(Stdio::null()).stderr(Stdio::piped());
    let output = command.output().with_context(|| format!("{command:?} could not be started"))?;
    let message = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{command:?} failed ({}): {message}", output.status);
    String::from_utf8(output.stdout).context("what it prints is no text")
}

/// The best time of each measure at both sides: at the commit, and here.
#[derive(Default)]
struct Costs(Vec<(String, [f64; 2])>);

impl Costs {
    fn note(&mut self, name: String, side: usize, microseconds: f64) {
        let place = self.0.iter().position(|(known, _)| *known == name).unwrap_or_else(|| {
            self.0.push((name, [f64::INFINITY; 2]));
            self.0.len() - 1
        });
        let best = &mut self.0[place].1[side];
        *best = best.min(microseconds);
    }

    /// One row per measure that both sides have; above 1, it takes longer here.
    fn table(&self, commit: &str) -> String {
        let mut lines = vec![format!(
            "\nbest of {ROUNDS}, µs{:>41} {:>12} {:>12}  here / there",
            "",
            &commit[..commit.len().min(7)],
            "here"
        )];
        for (name, [there, here]) in &self.0 {
            lines.push(match there.is_finite() && here.is_finite() {
                _ if name.ends_with(EARLY_ABORTS) || name.ends_with(HARD_RESETS) => {
                    let same = if there == here { "the same" } else { "other work: not to be compared" };
                    format!("{name:<55} {there:>12} {here:>12}  {same}")
                }
                true => format!("{name:<55} {there:>12.3} {here:>12.3}  {:.3}", here / there),
                false => format!("{name:<55} only {}", if here.is_finite() { "here" } else { "there" }),
            });
        }
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_time_of_each_side_counts() {
        let mut costs = Costs::default();
        for (side, time) in [(0, 2.0), (1, 4.0), (1, 3.0), (0, 2.5)] {
            costs.note("gridworld: step".into(), side, time);
        }
        costs.note("new: act".into(), 1, 1.0);
        for (side, count) in [(0, 7.0), (1, 8.0)] {
            costs.note(format!("run x: {EARLY_ABORTS}"), side, count);
        }
        let table = costs.table("0123456789");
        let rows: Vec<&str> = table.trim().lines().collect();
        assert!(rows[0].contains("0123456 ") && rows[1].ends_with("2.000        3.000  1.500"), "{table}");
        assert!(rows[2].ends_with("only here") && rows[3].ends_with("not to be compared"), "{table}");
    }

    #[test]
    fn a_commit_is_known_by_its_hash() {
        let root = cargo::workspace_root();
        let error = resolve(root, "no-such-branch").unwrap_err().to_string();
        assert!(error.contains("no-such-branch"), "{error}");
    }
}
