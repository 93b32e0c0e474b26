//! Shared pieces of the tests: where the plugins and the command `shield` are, and small experiments.

use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
    process::{self, Command, Output},
    sync::OnceLock,
};

/// The folder of the test's own executable. Cargo puts the plugins there, because this package depends on them.
pub fn plugins_folder() -> PathBuf {
    let executable = env::current_exe().expect("a test has an executable");
    executable.parent().expect("it lies in a folder").to_path_buf()
}

/// The root of the workspace.
pub fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("this package lies in the workspace")
}

/// The program of the profile's folder, in a folder without neighbours: beside it lie plugins too, which another call of Cargo may have
/// built with other features than those that belong to the test.
fn alone(profile: &Path, name: &str) -> PathBuf {
    let folder = profile.join("alone");
    fs::create_dir_all(&folder).expect("the profile's folder can be written");
    let (aside, program) = (folder.join(format!("{name}-{}", process::id())), folder.join(name));
    // Another test may do the same at this moment.
    fs::copy(profile.join(name), &aside).expect("the program can be copied");
    fs::rename(&aside, &program).expect("the copy can be renamed");
    program
}

/// The command `shield` with our plugins on its path, built first in the profile of the test.
pub fn shield() -> Command {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    let program = PROGRAM.get_or_init(|| {
        let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.current_dir(workspace()).args([
            "build",
            "--quiet",
            "--package",
            "shield-cli",
            "--bin",
            "shield",
        ]);
        if !cfg!(debug_assertions) {
            cargo.arg("--release");
        }
        assert!(cargo.status().expect("cargo starts").success(), "shield does not build");
        let profile = plugins_folder().parent().expect("deps lies in the profile's folder").to_path_buf();
        alone(&profile, &format!("shield{}", env::consts::EXE_SUFFIX))
    });
    let mut command = Command::new(program);
    command.env("SHIELD_PLUGIN_PATH", plugins_folder()).env("XDG_DATA_HOME", "/nonexistent");
    command
}

/// Runs the command `shield` in `folder`.
pub fn call(folder: &Path, arguments: &[&str]) -> Output {
    shield().current_dir(folder).args(arguments).output().expect("shield starts")
}

/// What a program printed.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The output of a command that succeeds.
pub fn succeed(command: &mut Command) -> String {
    let Output { status, stdout, stderr } = command.output().expect("the command starts");
    assert!(status.success(), "{command:?}: {}\n{}", text(&stdout), text(&stderr));
    text(&stdout)
}

/// Makes a named pipe at `path`.
pub fn named_pipe(path: &Path) {
    succeed(Command::new("mkfifo").arg(path));
}

/// Compiles a program in C against `shield.h` and the library for C.
pub fn compile_c_program(source: &Path, program: &Path) {
    let folder = plugins_folder();
    let mut cc = Command::new(env::var_os("CC").unwrap_or_else(|| "cc".into()));
    cc.args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]).arg(source);
    cc.arg("-I").arg(workspace().join("shield-c/include")).arg("-L").arg(&folder).arg("-lshield_runtime");
    succeed(cc.arg(format!("-Wl,-rpath,{}", folder.display())).arg("-o").arg(program));
}

/// Lets a program find no plugins but those beside its library.
pub fn without_plugins_elsewhere(command: &mut Command) -> &mut Command {
    command.env_remove("SHIELD_PLUGIN_PATH").env("XDG_DATA_HOME", "/nonexistent")
}

/// Every file of a run by its path in the folder, except what differs between two runs of a seed: wall-clock figures and checkpoints.
pub fn run_files(run: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    collect(run, run, &mut files);
    files
}

fn collect(root: &Path, folder: &Path, files: &mut BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(folder).expect("the folder can be read") {
        let path = entry.expect("the folder can be read").path();
        let name = path.strip_prefix(root).expect("it lies inside").to_string_lossy().into_owned();
        if path.is_dir() {
            if name != "checkpoint" {
                collect(root, &path, files);
            }
            continue;
        }
        let bytes = fs::read(&path).expect("a file can be read");
        match name.as_str() {
            "timings.csv" => {}
            "summary.json" => {
                let mut summary: serde_json::Map<String, serde_json::Value> =
                    serde_json::from_slice(&bytes).expect("a summary is JSON");
                for key in ["wall_seconds", "steps_per_second", "decision_us_p50", "decision_us_p99"] {
                    assert!(summary.remove(key).is_some(), "{key} is missing");
                }
                files.insert(name, serde_json::to_vec(&summary).expect("JSON can be written"));
            }
            _ => drop(files.insert(name, bytes)),
        }
    }
}

/// A small experiment in the gridworld; `{}` in `extra` is not special.
pub fn gridworld(steps: u64, extra: &str) -> String {
    format!(
        r#"Experiment(
    name: "small",
    steps: {steps},
    seeds: [0, 1],
    environment: (plugin: "gridworld"),
    forward: Learner(plugin: "tabular-q"),
    reset: (plugin: "tabular-q"),
    shield: (
        rules: [(plugin: "ensemble-threshold", config: (q_min: 0.4, combine: Optimistic))],
        warm_up_steps: 0,
    ),
    experience: (batch: 16, updates: Both, on_reset_success: Terminal, on_reset_failure: Zero),
    evaluation: Some(every: 500, episodes: 1),
    {extra}
)
"#
    )
}

/// A small experiment with the cart and networks.
pub fn cart(steps: u64, extra: &str) -> String {
    format!(
        r#"Experiment(
    name: "cart",
    steps: {steps},
    seeds: [0],
    environment: (plugin: "mujoco/cliff-cart"),
    forward: Learner(plugin: "ddpg", config: (critics: 1, actor_hidden: [16, 16], critic_hidden: [16, 16])),
    reset: (plugin: "ddpg", config: (critics: 3, actor_hidden: [16, 16], critic_hidden: [16, 16])),
    shield: (
        rules: [(plugin: "ensemble-threshold", config: (q_min: 1.0, combine: Realist))],
        warm_up_steps: 300,
    ),
    experience: (batch: 32, updates: Both, capacity: 10_000, bootstrap_probability: 0.8),
    evaluation: Some(every: 500, episodes: 2),
    {extra}
)
"#
    )
}

/// One of these experiments with other rules, and whatever else its shield has.
///
/// # Panics
/// It has no rules.
pub fn with_shield(experiment: &str, shield: &str) -> String {
    let start = experiment.find("rules: [").expect("the experiment has rules");
    let length = experiment[start..].find("],\n").expect("the rules end with their line");
    format!("{}{shield}{}", &experiment[..start], &experiment[start + length + 2..])
}

/// The cart's way home, a network in ONNX, as the reset agent of an experiment or a drop-in.
pub fn way_home() -> String {
    let path = workspace().join("examples/policies/home.onnx");
    format!(r#"Policy(plugin: "onnx", config: (path: {path:?}, output: Normalised))"#)
}

/// The small experiment with the cart, its reset agent in the place of which stands its [`way_home`], judged by a success critic.
pub fn driven_home(steps: u64, extra: &str) -> String {
    let text = cart(steps, extra);
    let (before, reset) = text.split_once("reset: ").expect("the cart has a reset agent");
    let (_, after) = reset.split_once("\n").expect("it stands on a line");
    let text = format!("{before}reset: {},\n{after}", way_home());
    text.replace(
        r#"(plugin: "ensemble-threshold", config: (q_min: 1.0, combine: Realist))"#,
        r#"(plugin: "undo-probability")"#,
    )
    .replace("warm_up_steps: 300", "warm_up_steps: 0")
}
