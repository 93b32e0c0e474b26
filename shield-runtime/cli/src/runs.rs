//! Many runs at once, over the cores, with one display.

use std::{
    collections::VecDeque,
    num::NonZeroUsize,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};

use anyhow::{Result, anyhow};
use indicatif::MultiProgress;
use shield_config::experiment::Variant;
use shield_host::plugin::Registry;
use shield_lab::{
    joint_loop::LoopParts,
    run::{Run, Standing, Summary, provenance},
};
use shield_report::report::Record;

use super::{Failure, findings, output, progress::Progress, table};

/// What becomes of results that are there already.
pub enum Earlier {
    /// They stay; the command has no `--overwrite` that messages could recommend.
    Stays,
    /// They stay, and messages recommend `--overwrite`. Runs that the record keeps are not made either.
    MayStay(Option<Record>),
    /// They are replaced.
    IsReplaced,
}

/// Set by Ctrl-C; every run looks at it before each step.
static STOP: AtomicBool = AtomicBool::new(false);

#[derive(Default)]
struct Outcomes {
    summaries: Vec<Summary>,
    failures: Vec<String>,
}

/// Makes every run that is not finished, `at_once` of them at the same time, and prints the table of all. With each run comes what was
/// prepared for it already, when the input was checked.
pub fn make_all(
    registry: &Registry,
    runs: Vec<(Run, Option<LoopParts>)>,
    at_once: Option<NonZeroUsize>,
    earlier: &Earlier,
) -> Result<(), Failure> {
    let total = runs.len();
    let (mut names, mut bare): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    for Variant { name, experiment, .. } in runs.iter().map(|(run, _)| &run.variant) {
        if names.contains(name) {
            continue;
        }
        names.push(name.clone());
        bare.extend(experiment.is_evaluated_without_its_shield().then(|| name.clone()));
    }
    let goes_on = match runs.iter().all(|(run, _)| run.variant.experiment.checkpoint.is_some()) {
        true => "the same command again goes on from here",
        false => "the same command again goes on with the runs that keep checkpoints",
    };
    let mut outcomes = Outcomes::default();
    let missing = missing(registry, runs, earlier, &mut outcomes)?;
    let display = MultiProgress::new();
    stop_on_ctrl_c(&display);
    let overwrite = matches!(earlier, Earlier::IsReplaced);
    let make = |run: &Run, parts| make(registry, run, parts, overwrite, &display);
    make_at_once(missing, at_once, &make, &display, &mut outcomes)?;

    let Outcomes { summaries, failures } = outcomes;
    if !summaries.is_empty() {
        output::note(table::results(&names, &bare, &summaries));
        if let Some(attempts) = table::attempts(&names, &summaries) {
            output::note(attempts);
        }
        findings::notes(&names, &summaries).iter().for_each(output::note);
    }
    if !failures.is_empty() {
        let list = failures.join("\n  ");
        return Err(Failure::Run(format!("{} of {total} runs failed:\n  {list}", failures.len())));
    }
    if STOP.load(Ordering::Relaxed) {
        return Err(Failure::Interrupted(format!("stopped by Ctrl-C; {goes_on}")));
    }
    Ok(())
}

/// Takes out what is finished already, and refuses what is something else now. Nothing is written yet.
fn missing(
    registry: &Registry,
    runs: Vec<(Run, Option<LoopParts>)>,
    earlier: &Earlier,
    outcomes: &mut Outcomes,
) -> Result<VecDeque<(Run, Option<LoopParts>)>, Failure> {
    let (record, remedy) = match earlier {
        Earlier::IsReplaced => return Ok(runs.into()),
        Earlier::MayStay(record) => {
            (record.as_ref(), "--overwrite replaces it, --out <folder> writes elsewhere")
        }
        Earlier::Stays => (None, "`shield run` with its experiment and --overwrite makes it anew"),
    };
    let mut missing = VecDeque::new();
    for (run, parts) in runs {
        let made_of = |variant: &Variant| provenance(registry, variant, run.seed);
        if let Some(summary) = record.and_then(|record| record.summary_of(&run, made_of)) {
            outcomes.summaries.push(summary.clone());
            continue;
        }
        let path = run.folder.path().display();
        // A file that cannot be read is no reason to recommend that everything be removed.
        match run.standing(registry).map_err(|error| Failure::Input(format!("{path}: {error:#}")))? {
            Standing::Finished(summary) => outcomes.summaries.push(*summary),
            Standing::Missing | Standing::Unfinished => missing.push_back((run, parts)),
            Standing::Differs(difference) => {
                return Err(Failure::Input(format!(
                    "{path} has a run with another configuration: {difference}; {remedy}"
                )));
            }
            Standing::Foreign => {
                return Err(Failure::Input(format!(
                    "{path} is there, but not as a run: it has no config.ron; {remedy}"
                )));
            }
        }
    }
    let (text, them) = match outcomes.summaries.len() {
        0 => return Ok(missing),
        1 => ("1 run is".into(), "it"),
        count => (format!("{count} runs are"), "them"),
    };
    let remedy = match earlier {
        Earlier::MayStay(_) => format!("; --overwrite makes {them} anew"),
        Earlier::Stays | Earlier::IsReplaced => String::new(),
    };
    output::message(format_args!("{text} finished already and kept{remedy}"));
    Ok(missing)
}

/// The first Ctrl-C lets every run keep its state and write its summary; the second ends the program at once.
fn stop_on_ctrl_c(display: &MultiProgress) {
    let display = display.clone();
    let installed = ctrlc::set_handler(move || {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        display.println("stopping: each run keeps its state; Ctrl-C again ends at once").ok();
    });
    if let Err(error) = installed {
        output::message(format_args!("warning: Ctrl-C ends the runs at once: {error}"));
    }
}

/// Makes every run; one that fails does not end the others. With fewer threads than there should be, it takes longer.
fn make_at_once(
    runs: VecDeque<(Run, Option<LoopParts>)>,
    at_once: Option<NonZeroUsize>,
    make: &(impl Fn(&Run, Option<LoopParts>) -> Result<Summary> + Sync),
    display: &MultiProgress,
    outcomes: &mut Outcomes,
) -> Result<(), Failure> {
    let workers =
        at_once.map_or_else(|| as_cores_allow(&runs), NonZeroUsize::get).clamp(1, runs.len().max(1));
    let (queue, outcomes) = (Mutex::new(runs), Mutex::new(outcomes));
    // One run after the other, until there are no more.
    let work = || {
        while let Some((run, parts)) = next(&queue) {
            let outcome = catch_unwind(AssertUnwindSafe(|| make(&run, parts)))
                .unwrap_or_else(|_| Err(anyhow!("the shield itself panicked; please report it")));
            let mut outcomes = outcomes.lock().unwrap_or_else(PoisonError::into_inner);
            match outcome {
                Ok(summary) => outcomes.summaries.push(summary),
                Err(error) => outcomes.failures.push(format!("{}: {error:#}", run.folder.path().display())),
            }
        }
    };
    thread::scope(|scope| {
        for started in 0..workers {
            match thread::Builder::new().spawn_scoped(scope, work) {
                Ok(_) => {}
                Err(error) if started == 0 => return Err(Failure::Run(no_thread(&error))),
                Err(error) => {
                    let reason = no_thread(&error);
                    say(
                        display,
                        &format!("warning: {started} instead of {workers} runs at a time: {reason}"),
                    );
                    break;
                }
            }
        }
        Ok(())
    })
}

/// Begins a run or goes on with it, until it is finished or stopped.
fn make(
    registry: &Registry,
    run: &Run,
    parts: Option<LoopParts>,
    overwrite: bool,
    display: &MultiProgress,
) -> Result<Summary> {
    let launch = match overwrite || !run.folder.is_begun()? {
        true => run.begin(registry, parts, overwrite)?,
        false => {
            // They are prepared anew for the state of a checkpoint.
            drop(parts);
            run.proceed(registry)?
        }
    };
    let name = run.identity().to_string();
    for warning in launch.warnings() {
        say(display, &format!("warning: {name}: {warning}"));
    }
    let steps_before = launch.steps_before();
    if steps_before > 0 {
        say(display, &format!("{name} goes on after {steps_before} steps"));
    }
    let progress = Progress::new(display, name, run.variant.experiment.steps, steps_before);
    launch.run(progress, &STOP)
}

/// Above the lines of the runs; also where there is no terminal to draw them on.
fn say(display: &MultiProgress, message: &str) {
    display.suspend(|| output::message(message));
}

fn no_thread(error: &std::io::Error) -> String {
    format!("a thread cannot be started: {error}; `ulimit -u` shows how many this user may have")
}

fn as_cores_allow(runs: &VecDeque<(Run, Option<LoopParts>)>) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = runs.iter().map(|(run, _)| run.variant.experiment.threads).max().unwrap_or(1);
    (cores / threads).max(1)
}

fn next(queue: &Mutex<VecDeque<(Run, Option<LoopParts>)>>) -> Option<(Run, Option<LoopParts>)> {
    if STOP.load(Ordering::Relaxed) {
        return None;
    }
    queue.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
}
