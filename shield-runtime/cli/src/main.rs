//! The command `shield`: arguments in, exit code out.

mod doctor;
mod env;
mod eval;
mod explain;
mod export;
mod findings;
mod output;
mod plugin;
mod progress;
mod render;
mod report;
mod resume;
mod run;
mod runs;
mod table;
mod what_if;

use std::{fmt, process::ExitCode};

use clap::{Parser, Subcommand};
use shield_config::experiment::InputError;
use shield_host::plugin::{Registry, SearchPath, isolated};

/// Trains and judges policies behind a shield: an action that could not be undone is not executed.
///
/// The shield learns, beside the task, how to get back to the start. The value of getting back, an ensemble of Q-functions, decides before
/// every action whether it may be executed; if not, the reset agent takes over.
#[derive(Parser)]
#[command(name = "shield", version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  shield run examples/quickstart.ron                       run every variant with every seed
  shield run examples/gridworld.ron --seeds 0 --variants q_min-0.4
  shield run my.ron --set shield.rules[0].config.q_min=5 --out elsewhere
  shield doctor my.ron                                     can a shield help here? Before any training
  shield resume runs/quickstart                            go on with what was stopped or killed
  shield explain runs/mine/shielded/seed-0 --step 1234     why an action was rejected
  shield what-if runs/mine/shielded/seed-0 --risk 0.1,0.2  what another accepted risk would have rejected
  shield eval runs/quickstart --episodes 100               how good the agents are, with the shield and without
  shield report runs/quickstart --png pictures             a page with figures, and these as files
  shield export runs/mine/shielded/seed-0                  weights and policies for other programs
  shield plugin list                                       what can be named in an experiment
  shield render examples/gridworld.ron --out grid.gif --train-steps 2000
  shield env check mujoco/cliff-cheetah                    what must hold of every environment
  shield env bench mujoco/cliff-cheetah                    how fast an environment steps
  shield plugin info ddpg                                  its configuration, to copy from
  shield plugin new acme/my-rule --kind abort-rule         a plugin of your own, ready to build
  shield plugin bench target/release/libmy_rule.so         what each of its calls costs

Exit codes: 0 done, 1 a run failed, 2 the input is wrong, 130 stopped by Ctrl-C.";

#[derive(Subcommand)]
enum Command {
    /// Runs an experiment: every variant with every seed. What is finished is kept, what was stopped goes on.
    Run(run::RunArguments),
    /// Says whether a shield can help in an environment, before training, or what kept one from helping in a run.
    Doctor(doctor::DoctorArguments),
    /// Goes on with the runs of a folder that were stopped or killed, as if they had never been.
    Resume(resume::ResumeArguments),
    /// Says why the shield rejected an action: rule, probabilities, members, threshold, and what projection tried.
    Explain(explain::ExplainArguments),
    /// Replays the shield's decisions of a run under other settings, and tables what would have been rejected.
    WhatIf(what_if::WhatIfArguments),
    /// Lets the agents of finished or stopped runs act in fresh episodes.
    Eval(eval::EvalArguments),
    /// Shows what the runs of an experiment came to, on one page and in pictures.
    ///
    /// One self-contained page: final table, curves with median and quartiles over the seeds, where the shield aborted, how the variants differ,
    /// and which plugins it was.
    Report(report::ReportArguments),
    /// Writes what the agents of a run learned for other programs: weights as safetensors, policies as ONNX.
    Export(export::ExportArguments),
    /// Finds, shows, makes, checks, measures and pins plugins.
    #[command(subcommand)]
    Plugin(plugin::PluginCommand),
    /// Lists, checks and measures environments.
    #[command(subcommand)]
    Env(env::EnvCommand),
    /// Films the joint loop of an experiment, or a policy, off-screen.
    ///
    /// Under the picture stand the phase, the counts, and the value that the reset agent gives to what is executed, beside Q_min: a bar from
    /// its least to its largest member. Early aborts, projected actions and hard resets are marked around it. A gridworld is drawn twice, shaded
    /// by the reset value and by the early aborts of each cell. Nothing is written but the picture.
    Render(render::RenderArguments),
    /// Serves one isolated plugin to the process that started this one.
    #[command(hide = true)]
    Worker,
}

/// What ends the command with something else than 0.
#[derive(Debug)]
pub enum Failure {
    /// The user's input is wrong: exit code 2.
    Input(String),
    /// A run failed: exit code 1.
    Run(String),
    /// Ctrl-C: exit code 130, as a shell expects.
    Interrupted(String),
}

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Self::Input(message) | Self::Run(message) | Self::Interrupted(message)) = self;
        formatter.write_str(message)
    }
}

impl From<InputError> for Failure {
    fn from(error: InputError) -> Self {
        Self::Input(error.to_string())
    }
}

impl From<&Failure> for ExitCode {
    fn from(failure: &Failure) -> Self {
        Self::from(match failure {
            Failure::Run(_) => 1,
            Failure::Input(_) => 2,
            Failure::Interrupted(_) => 130,
        })
    }
}

/// Reads the arguments and does what they say.
fn main() -> ExitCode {
    let arguments = Arguments::parse();
    if matches!(arguments.command, Command::Worker) {
        return worker();
    }
    let registry = Registry::scan(&SearchPath::from_environment());
    let done = match &arguments.command {
        Command::Run(arguments) => run::run(arguments, &registry),
        Command::Doctor(arguments) => doctor::doctor(arguments, &registry),
        Command::Resume(arguments) => resume::run(arguments, &registry),
        Command::Explain(arguments) => explain::explain(arguments),
        Command::WhatIf(arguments) => what_if::what_if(arguments, &registry),
        Command::Eval(arguments) => eval::run(arguments, &registry),
        Command::Report(arguments) => report::report(arguments, &registry),
        Command::Export(arguments) => export::export(arguments, &registry),
        Command::Plugin(command) => plugin::run(command, &registry),
        Command::Env(command) => env::run(command, &registry),
        Command::Render(arguments) => render::render(arguments, &registry),
        Command::Worker => unreachable!("served above, without a search for plugins"),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let prefix = if matches!(failure, Failure::Interrupted(_)) { "" } else { "error: " };
            output::message(format_args!("{prefix}{failure}"));
            ExitCode::from(&failure)
        }
    }
}

/// What it prints reaches the user only in the message about its end.
fn worker() -> ExitCode {
    match isolated::serve() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::message(format_args!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
