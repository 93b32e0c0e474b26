//! `shield doctor`: whether a shield can help, before training or after a run.

use std::path::PathBuf;

use clap::Args;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use shield_check::environment_check::random_action;
use shield_config::experiment::{ExperimentFile, Mode, Override, Variant};
use shield_core::{
    examination::{Examination, STARTS, STEPS, StepEnd, Verdict},
    world::{Stepped, World},
};
use shield_host::plugin::Registry;
use shield_lab::run::{FoundInRun, Run, RunFolder, Summary, prepare};

use super::{Failure, eval::one_run, findings::printable, output};

/// Arguments of `shield doctor`.
#[derive(Args)]
#[command(after_help = "\
Of an experiment, the environment of its first shielded variant is reset a few times and makes random steps, with the reset task of the \
experiment. Nothing is learned and nothing is written. Each line is a check: `ok`, `note` (it works, but you should know), `?` (it could not be told), \
`CHANGE` (a setting must be changed) or `CANNOT` (no setting helps). The last line is the verdict.

Of a run, nothing is executed: what it recorded is read, and what kept its shield from helping is said as it was at the end of the run.

Examples:
  shield doctor examples/quickstart.ron
  shield doctor my.ron --set 'reset_task=Some((plugin: \"near-start\", config: (radius: 0.5)))'
  shield doctor runs/mine/shielded/seed-0

Exit codes: 0 it works, 1 a setting must be changed or it cannot help, 2 the input is wrong.")]
pub struct DoctorArguments {
    /// The experiment, a RON file, or the folder of a run.
    #[arg(value_name = "EXPERIMENT|RUN")]
    subject: PathBuf,
    /// The variant to look at instead of the first shielded one.
    #[arg(long)]
    variant: Option<String>,
    /// Random steps.
    #[arg(long, default_value_t = STEPS, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    steps: u32,
    /// Starts before the first step; every walk of random steps adds one.
    #[arg(long, default_value_t = STARTS, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    starts: u32,
    /// Seed of starts and actions.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Sets a field of the experiment, for example reset_task=None. May be repeated.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    sets: Vec<String>,
}

/// Examines the environment of an experiment, or reads what a run found.
pub fn doctor(arguments: &DoctorArguments, registry: &Registry) -> Result<(), Failure> {
    if arguments.subject.is_dir() {
        return of_run(&one_run(&arguments.subject)?);
    }
    let variant = variant(arguments)?;
    let mut world = prepare(registry, &variant, arguments.seed)?.world;
    let checkup = examine(&mut world, arguments).map_err(|(steps, error)| {
        Failure::Run(format!("the environment or the reset task failed after {steps} random steps: {error}"))
    })?;
    output::result(format_args!("{}, {} random steps\n{checkup}", variant.name, arguments.steps))?;
    match checkup.verdict() {
        Verdict::Works => Ok(()),
        Verdict::Change(_) => Err(Failure::Run("a setting must be changed".into())),
        Verdict::CannotHelp(_) => Err(Failure::Run("a shield cannot help here".into())),
    }
}

fn variant(arguments: &DoctorArguments) -> Result<Variant, Failure> {
    let overrides: Result<Vec<Override>, _> = arguments.sets.iter().map(|set| Override::parse(set)).collect();
    let only = arguments.variant.as_ref().map(std::slice::from_ref);
    let variants = ExperimentFile::read(&arguments.subject)?.variants(&overrides?, only)?;
    let shielded = variants.into_iter().find(|variant| variant.experiment.mode == Mode::Shielded);
    shielded
        .ok_or_else(|| Failure::Input("no variant of the experiment has a shield (`mode: Shielded`)".into()))
}

/// Starts, then walks of random actions. Of an error, it says after how many steps it came.
fn examine(
    world: &mut World,
    arguments: &DoctorArguments,
) -> Result<shield_core::examination::Checkup, (u32, shield_api::Error)> {
    let mut examination = Examination::new();
    let mut rng = Pcg64::seed_from_u64(arguments.seed);
    let (spaces, limit) = (world.spec().spaces.clone(), world.spec().episode_length);
    let mut made = 0;
    for _ in 0..arguments.starts {
        world.hard_reset(None, rng.next_u64()).map_err(|error| (made, error))?;
        examination.start(world.observation(), None);
    }
    while made < arguments.steps {
        world.hard_reset(None, rng.next_u64()).map_err(|error| (made, error))?;
        examination.start(world.observation(), None);
        examination.walk();
        for length in 1..=arguments.steps - made {
            let action = random_action(&spaces.action, &mut rng);
            let stepped = world.step(&action).map_err(|error| (made, error))?;
            made += 1;
            let Stepped::Made(outcome) = stepped else { break };
            let end = if outcome.terminated { StepEnd::Terminated } else { StepEnd::Continues };
            examination.step(world.next_observation(), Some(outcome.in_reset_set), end);
            world.advance();
            let is_over = outcome.terminated || length as usize >= limit;
            if is_over || examination.is_walk_over(length, arguments.steps) {
                break;
            }
        }
    }
    if let Some(task) = world.reset_task() {
        examination.judge(task, spaces.action_len()).map_err(|error| (made, error))?;
    }
    Ok(examination.conclude())
}

/// Findings that keep a shield from working; with the others it works, but not as well as it could.
const GRAVE: [&str; 8] = [
    "starts-outside",
    "starts-unlikely",
    "every-state-inside",
    "no-success",
    "nothing-allowed",
    "resets-requested",
    "resets-truncated",
    "episodes-terminate",
];

fn is_grave(found: &FoundInRun) -> bool {
    !found.is_over && GRAVE.contains(&found.name.as_str())
}

fn of_run(folder: &RunFolder) -> Result<(), Failure> {
    let path = folder.path().display();
    let run = Run::of_folder(folder.clone(), &[]).map_err(input)?;
    if run.variant.experiment.mode != Mode::Shielded {
        return Err(Failure::Input(format!("{path} is a run without a shield")));
    }
    let summary = folder.summary().map_err(input)?;
    let summary = summary.ok_or_else(|| {
        Failure::Input(format!("{path} has no summary.json yet: the run is going on, or was killed"))
    })?;
    output::result(recorded(&summary))?;
    if summary.findings.iter().any(is_grave) {
        return Err(Failure::Run("a setting must be changed".into()));
    }
    Ok(())
}

/// What a run recorded, and the verdict.
fn recorded(summary: &Summary) -> String {
    let Summary { steps, forward_steps, hard_resets, early_aborts, reset_episodes, .. } = summary;
    let share = 100.0 * *forward_steps as f64 / (*steps).max(1) as f64;
    let mut text = format!(
        "{} steps, {share:.0}% of them forward; {early_aborts} early aborts, {reset_episodes} attempts, {hard_resets} hard resets\n",
        steps
    );
    for found in &summary.findings {
        let word = if is_grave(found) { "CHANGE" } else { "note" };
        text += &format!("{word:<7} {:<18} {} [{}]\n", found.name, found.sentence, found.when());
    }
    let grave = summary.findings.iter().find(|found| is_grave(found));
    let present = summary.findings.iter().find(|found| !found.is_over);
    text += &match (grave, present) {
        (Some(found), _) => format!("verdict: change this setting: {}", found.sentence),
        (None, Some(_)) => "verdict: it works, but not as well as it could".into(),
        (None, None) => "verdict: it works: nothing keeps the shield from helping".into(),
    };
    text.lines().map(printable).collect::<Vec<_>>().join("\n")
}

fn input(error: anyhow::Error) -> Failure {
    Failure::Input(format!("{error:#}"))
}
