//! Set-up and chores, as `cargo xtask …`; `cargo shield …` is short for `cargo xtask shield …`.

mod against;
mod cargo;
mod dist;
mod native;
mod peers;
mod python;
mod reproduce;
mod say;
mod stages;
mod torch;
mod wheel;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use say::say;

/// Set-up and chores of the shield.
///
/// Whatever a command needs and is missing, it brings first: MuJoCo is downloaded once, and what changed is built.
#[derive(Parser)]
#[command(bin_name = "cargo xtask", after_help = EXAMPLES)]
struct CommandLine {
    #[command(subcommand)]
    chore: Chore,
}

const EXAMPLES: &str = "Examples:
  cargo shield run examples/quickstart.ron    run an experiment
  cargo shield --help                         what the shield itself can do
  cargo xtask test                            every test
  cargo xtask test --stage doc                only the examples in the documentation
  cargo xtask test --python                   the Python package, with Stable-Baselines3
  cargo xtask test --peers                    our robots against Gymnasium's and dm_control's
  cargo shield --with torch run mine.ron      the same with the plugin on libtorch
  cargo xtask test --torch                    that plugin's tests
  cargo xtask dist                            an archive for machines without Rust
  cargo xtask test --dist                     that the archive works elsewhere
  cargo xtask test --long                     a million projections, 200 kills
  cargo xtask bench --bench decision          one benchmark
  cargo xtask bench --peers                   our learner against torch and Stable-Baselines3
  cargo xtask bench --against main            here against another commit, in one run
  cargo xtask reproduce gridworld-qmin        one of the paper's experiments
  cargo xtask reproduce untouched             the shield as it is, in seven environments
  cargo xtask reproduce gymnasium             the same around Stable-Baselines3 in Gymnasium's";

#[derive(Subcommand)]
enum Chore {
    /// Bring the native libraries that the environments need (MuJoCo) into `native/`
    ///
    /// Does nothing if they are there, or if MUJOCO_DYNAMIC_LINK_DIR names a folder of yours.
    Setup,
    /// Build the `shield` program, every plugin and every environment
    ///
    /// They lie side by side in `target/release`, where `shield` finds its plugins.
    Build(Build),
    /// Pack the program, every plugin, MuJoCo, the headers and `shield-api` into an archive that runs anywhere
    ///
    /// It lies in `target/dist` and is tried before: unpacked elsewhere, with nothing of this environment, it runs the quickstart for a few
    /// steps, finds and checks its plugins, shields a program in C, and makes plugins in C and in Rust.
    Dist(Build),
    /// Build what changed, in release mode, and run `shield` with the arguments that follow
    ///
    /// Every argument behind `shield` goes to it, flags too, and its exit code comes back. But for `--with torch` at the beginning, which
    /// first brings libtorch (600 MB, once, unless LIBTORCH names yours) and builds the plugin on it: `ddpg-torch`, `td3-torch`, `torchscript`.
    #[command(disable_help_flag = true)]
    Shield {
        /// For example: run examples/quickstart.ron --jobs 2
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<OsString>,
    },
    /// Run the tests, and say how long each stage took
    Test {
        /// Only this stage; it can be given several times
        #[arg(long = "stage", value_name = "NAME")]
        stages: Vec<stages::Name>,
        /// Only the comparison of the robots with Gymnasium's and the DeepMind control suite's
        ///
        /// Installs both from PyPI into native/python/peers, once (about a minute, 600 MB). Compares masses, inertias, joints and
        /// motors, 200 control steps of free motion, and the speed of the half-cheetah.
        #[arg(long, conflicts_with = "stages")]
        peers: bool,
        /// Only the Python package: its wheel is built and installed, and its tests run
        ///
        /// Installs torch and Stable-Baselines3 from PyPI into native/python/drop-in, once (a few minutes, 2 GB). Prints what the wrapper
        /// costs for a step.
        #[arg(long, conflicts_with_all = ["stages", "peers"])]
        python: bool,
        /// Only the torch plugin, by itself and against ddpg and td3
        ///
        /// Brings libtorch into native/torch, once (600 MB), unless LIBTORCH names yours, and compiles its bindings (some minutes, once).
        #[arg(long, conflicts_with_all = ["stages", "peers"])]
        torch: bool,
        /// Only the archive of `dist`, built quickly and not to run quickly
        ///
        /// Packs what the other tests have built, unpacks it elsewhere, and uses it with an empty environment: the quickstart, a program in C,
        /// new plugins in C and Rust.
        #[arg(long, conflicts_with_all = ["stages", "peers", "python", "torch"])]
        dist: bool,
        /// Only the long forms of tests that draw at random
        ///
        /// Solves a million programs of projections and makes a million decisions, and kills runs 200 times. Takes some minutes.
        #[arg(long, conflicts_with_all = ["stages", "peers", "python", "torch", "dist"])]
        long: bool,
    },
    /// Write `shield-api/include/shield_plugin.h` anew, after a change of the tables
    Header,
    /// Run the paper's experiments as far as they are not recorded, and write examples/paper/RESULTS.md
    ///
    /// Small ones, for two cores: the first three take minutes, all together some hours. Ctrl-C keeps what is done, and the same command goes
    /// on from there. Records and plots beside RESULTS.md are written anew. `untouched` names those of the shield with its usual settings, whose
    /// RESULTS.md is in examples/untouched. `gymnasium` trains an agent of Stable-Baselines3 in Gymnasium's environments with the shield and without;
    /// it first installs the Python package, torch and Stable-Baselines3 into native/python/drop-in (once, a few minutes, 2 GB), and writes
    /// examples/gymnasium/RESULTS.md.
    Reproduce(reproduce::Arguments),
    /// Run the benchmarks
    Bench {
        /// Only this one; a pattern such as `decision*` is possible
        #[arg(long = "bench", value_name = "NAME", default_value = "*")]
        pattern: String,
        /// Only the comparison of our learners with torch and Stable-Baselines3, in one run
        ///
        /// Installs both from PyPI into native/python/torch, once (a few minutes, 2 GB). Prints the ratios and writes them to
        /// target/bench-peers.json; takes some five minutes on a machine that does nothing else.
        #[arg(long, conflicts_with_all = ["pattern", "arguments"])]
        peers: bool,
        /// Only the comparison with another commit: the calls of plugins, and the steps and decisions of two short runs
        ///
        /// Builds the commit in target/against, once (as long as a first build takes), measures both in turn in one run, and prints the ratios.
        #[arg(long, value_name = "COMMIT", conflicts_with_all = ["pattern", "arguments", "peers"])]
        against: Option<String>,
        /// Arguments for criterion, behind `--`
        #[arg(last = true)]
        arguments: Vec<String>,
    },
}

#[derive(Args)]
struct Build {
    /// Optimised; this is the default
    #[arg(long, conflicts_with = "debug")]
    release: bool,
    /// Quick to build and slow to run
    #[arg(long)]
    debug: bool,
}

fn main() -> ExitCode {
    match run(CommandLine::parse().chore) {
        Ok(code) => code,
        Err(error) => {
            say::complain(format_args!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run(chore: Chore) -> anyhow::Result<ExitCode> {
    let root = cargo::workspace_root();
    let mujoco = native::mujoco(root).context("MuJoCo could not be set up")?;
    match chore {
        Chore::Setup => say(format_args!("MuJoCo is in {}", mujoco.display())),
        Chore::Build(Build { debug, .. }) => build(root, !debug)?,
        Chore::Dist(Build { debug, .. }) => make_archive(root, &mujoco, !debug)?,
        Chore::Shield { arguments } => {
            let (with_torch, arguments) = split_with(&arguments)?;
            build(root, true)?;
            if with_torch {
                torch::build(root).context("the torch plugin could not be built")?;
            }
            return shield(arguments);
        }
        Chore::Test { peers: true, .. } => return peers::test(root),
        Chore::Test { python: true, .. } => return wheel::test(root),
        Chore::Test { dist: true, .. } => make_archive(root, &mujoco, false)?,
        Chore::Test { torch: true, .. } => torch::test(root).context("the torch plugin")?,
        Chore::Test { long: true, .. } => stages::run_long(root)?,
        Chore::Test { stages, .. } => return stages::run(root, &stages),
        Chore::Header => {
            let test = ["test", "--quiet", "--workspace", "--test", "header"];
            cargo::run(cargo::command(root).args(test).env("SHIELD_WRITE_HEADER", "1"))?;
        }
        Chore::Reproduce(arguments) => {
            if arguments.needs_program() {
                build(root, true)?;
            }
            return reproduce::reproduce(root, &program()?, &arguments);
        }
        Chore::Bench { peers: true, .. } => peers::bench(root)?,
        Chore::Bench { against: Some(commit), .. } => against::bench(root, &mujoco, &commit)?,
        Chore::Bench { pattern, arguments, .. } => {
            let bench = ["bench", "--workspace", "--bench", &pattern, "--"];
            cargo::run(cargo::command(root).args(bench).args(arguments))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn build(root: &Path, optimised: bool) -> anyhow::Result<()> {
    cargo::run(&mut build_command(root, optimised))
}

fn build_command(root: &Path, optimised: bool) -> Command {
    let mut command = cargo::command(root);
    command.args(["build", "--workspace"]);
    command.args(dist::LEFT_OUT.map(|name| ["--exclude", name]).as_flattened());
    if optimised {
        command.arg("--release");
    }
    command
}

fn make_archive(root: &Path, mujoco: &Path, optimised: bool) -> anyhow::Result<()> {
    let archive = dist::make(root, mujoco, optimised).context("the archive")?;
    say(format_args!("{} works elsewhere", archive.display()));
    Ok(())
}

/// The `shield` program as [`build`] leaves it.
fn program() -> anyhow::Result<PathBuf> {
    Ok(cargo::target_folder()?.join("release").join(program_name()))
}

fn program_name() -> String {
    format!("shield{}", std::env::consts::EXE_SUFFIX)
}

/// Whether the arguments begin with `--with torch`, and those behind it.
fn split_with(arguments: &[OsString]) -> anyhow::Result<(bool, &[OsString])> {
    match arguments {
        [with, name, rest @ ..] if with == "--with" && name == "torch" => Ok((true, rest)),
        [with, ..] if with == "--with" => {
            anyhow::bail!("`--with` is followed by `torch`; there is nothing else to add")
        }
        _ => Ok((false, arguments)),
    }
}

/// Becomes the `shield` program, or runs it where a process cannot be replaced.
fn shield(arguments: &[OsString]) -> anyhow::Result<ExitCode> {
    let program = program()?;
    let mut command = Command::new(&program);
    command.args(arguments);
    #[cfg(unix)]
    let status: Result<std::process::ExitStatus, _> =
        Err(std::os::unix::process::CommandExt::exec(&mut command));
    #[cfg(not(unix))]
    let status = command.status();
    let status = status.with_context(|| format!("{} could not be run", program.display()))?;
    Ok(status.code().and_then(|code| u8::try_from(code).ok()).map_or(ExitCode::FAILURE, ExitCode::from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        <CommandLine as clap::CommandFactory>::command().debug_assert();
    }

    #[test]
    fn only_torch_can_be_added_and_only_in_front() {
        let split = |line: &str| {
            let given: Vec<OsString> = line.split_whitespace().map(OsString::from).collect();
            split_with(&given).map(|(with_torch, rest)| (with_torch, rest.len())).ok()
        };
        assert_eq!(split("--with torch run x.ron"), Some((true, 2)));
        assert_eq!(split("run x.ron --with torch"), Some((false, 4)));
        assert_eq!(split(""), Some((false, 0)));
        assert_eq!(split("--with mujoco run x.ron"), None);
        assert_eq!(split("--with"), None);
    }

    #[test]
    fn flags_behind_shield_belong_to_shield() {
        let given = ["run", "x.ron", "--help", "--set", "a=1", "--", "-V"];
        for skip in [0, 2] {
            let line = ["xtask", "shield"].iter().chain(&given[skip..]);
            let Chore::Shield { arguments } = CommandLine::try_parse_from(line).unwrap().chore else {
                panic!("another chore");
            };
            assert_eq!(arguments, given[skip..]);
        }
    }
}
