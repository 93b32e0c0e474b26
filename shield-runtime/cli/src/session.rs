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
use shield_lab::run::{Identity, Order, Prepared, RunFolder, Standing, Summary};
use shield_report::report::Record;

use super::{Failure, findings, output, progress::Progress, table};

/// A run that somebody asked for.
pub struct Job {
    /// What it does.
    pub variant: Variant,
    /// Which one it is.
    pub identity: Identity,
    /// Where it is written.
    pub folder: RunFolder,
    /// What was made for it already, when the input was checked.
    pub prepared: Option<Prepared>,
}

impl Job {
    fn order<'a>(&'a self, registry: &'a Registry) -> Order<'a> {
        Order { registry, variant: &self.variant, identity: &self.identity, folder: &self.folder }
    }
}

/// Set by Ctrl-C; every run looks at it before each step.
static STOP: AtomicBool = AtomicBool::new(false);

/// What all runs of one command share.
pub struct Session<'a> {
    registry: &'a Registry,
    jobs: Option<NonZeroUsize>,
    overwrite: bool,
    can_overwrite: bool,
    record: Option<Record>,
    display: MultiProgress,
}

#[derive(Default)]
struct Outcomes {
    summaries: Vec<Summary>,
    failures: Vec<String>,
}

impl<'a> Session<'a> {
    /// `jobs` runs at the same time. Earlier results stay.
    pub fn new(registry: &'a Registry, jobs: Option<NonZeroUsize>) -> Self {
        Self {
            registry,
            jobs,
            overwrite: false,
            can_overwrite: false,
            record: None,
            display: MultiProgress::new(),
        }
    }

    /// Of a command with --overwrite and --out, which messages then recommend. Earlier results are replaced if `overwrite` says so.
    #[must_use]
    pub fn with_overwrite(mut self, overwrite: bool) -> Self {
        (self.overwrite, self.can_overwrite) = (overwrite, true);
        self
    }

    /// Runs that are kept in `record` are not made again.
    #[must_use]
    pub fn with_record(mut self, record: Option<Record>) -> Self {
        self.record = record;
        self
    }

    /// Makes every run that is not finished, and prints the table of all.
    pub fn work(&self, jobs: Vec<Job>) -> Result<(), Failure> {
        let total = jobs.len();
        let (mut names, mut bare): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
        for Variant { name, experiment, .. } in jobs.iter().map(|job| &job.variant) {
            if names.contains(name) {
                continue;
            }
            names.push(name.clone());
            bare.extend(experiment.is_evaluated_without_its_shield().then(|| name.clone()));
        }
        let goes_on = match jobs.iter().all(|job| job.variant.experiment.checkpoint.is_some()) {
            true => "the same command again goes on from here",
            false => "the same command again goes on with the runs that keep checkpoints",
        };
        let mut outcomes = Outcomes::default();
        let missing = self.missing(jobs, &mut outcomes)?;
        self.stop_on_ctrl_c();
        self.run_all(missing, &mut outcomes)?;

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
    fn missing(&self, jobs: Vec<Job>, outcomes: &mut Outcomes) -> Result<VecDeque<Job>, Failure> {
        let mut missing = VecDeque::new();
        let remedy = match self.can_overwrite {
            true => "; --overwrite replaces it, --out <folder> writes elsewhere",
            false => "; `shield run` with its experiment and --overwrite makes it anew",
        };
        for job in jobs {
            let record = self.record.as_ref().filter(|_| !self.overwrite);
            if let Some(summary) = record.and_then(|record| record.summary_of(&job.order(self.registry))) {
                outcomes.summaries.push(summary.clone());
                continue;
            }
            let standing =
                if self.overwrite { Ok(Standing::Missing) } else { job.order(self.registry).standing() };
            let path = job.folder.path().display();
            // A file that cannot be read is no reason to recommend that everything be removed.
            match standing.map_err(|error| Failure::Input(format!("{path}: {error:#}")))? {
                Standing::Finished(summary) => outcomes.summaries.push(*summary),
                Standing::Missing | Standing::Unfinished => missing.push_back(job),
                Standing::Differs(difference) => {
                    return Err(Failure::Input(format!(
                        "{path} has a run with another configuration: {difference}{remedy}"
                    )));
                }
                Standing::Foreign => {
                    return Err(Failure::Input(format!(
                        "{path} is there, but not as a run: it has no config.ron{remedy}"
                    )));
                }
            }
        }
        if !outcomes.summaries.is_empty() {
            let count = outcomes.summaries.len();
            let (text, them) =
                if count == 1 { ("1 run is".into(), "it") } else { (format!("{count} runs are"), "them") };
            let remedy =
                if self.can_overwrite { format!("; --overwrite makes {them} anew") } else { String::new() };
            output::message(format_args!("{text} finished already and kept{remedy}"));
        }
        Ok(missing)
    }

    /// The first Ctrl-C lets every run keep its state and write its summary; the second ends the program at once.
    fn stop_on_ctrl_c(&self) {
        let display = self.display.clone();
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

    /// Works through the jobs; a run that fails does not end the others. With fewer threads than there should be, it takes longer.
    fn run_all(&self, jobs: VecDeque<Job>, outcomes: &mut Outcomes) -> Result<(), Failure> {
        let workers =
            self.jobs.map_or_else(|| default_jobs(&jobs), NonZeroUsize::get).clamp(1, jobs.len().max(1));
        let queue = Mutex::new(jobs);
        let outcomes = Mutex::new(outcomes);
        thread::scope(|scope| {
            for started in 0..workers {
                let worker = thread::Builder::new().spawn_scoped(scope, || self.work_off(&queue, &outcomes));
                match worker {
                    Ok(_) => {}
                    Err(error) if started == 0 => return Err(Failure::Run(no_thread(&error))),
                    Err(error) => {
                        let reason = no_thread(&error);
                        self.say(&format!(
                            "warning: {started} instead of {workers} runs at a time: {reason}"
                        ));
                        break;
                    }
                }
            }
            Ok(())
        })
    }

    /// Takes one job after the other, until there are no more.
    fn work_off(&self, queue: &Mutex<VecDeque<Job>>, outcomes: &Mutex<&mut Outcomes>) {
        while let Some(mut job) = next(queue) {
            let prepared = job.prepared.take();
            let outcome = catch_unwind(AssertUnwindSafe(|| self.run_one(&job, prepared)))
                .unwrap_or_else(|_| Err(anyhow!("the shield itself panicked; please report it")));
            let mut outcomes = outcomes.lock().unwrap_or_else(PoisonError::into_inner);
            match outcome {
                Ok(summary) => outcomes.summaries.push(summary),
                Err(error) => {
                    outcomes.failures.push(format!("{}: {error:#}", job.folder.path().display()));
                }
            }
        }
    }

    fn run_one(&self, job: &Job, prepared: Option<Prepared>) -> Result<Summary> {
        let order = job.order(self.registry);
        let launch = match self.overwrite || !job.folder.is_begun()? {
            true => order.begin(prepared, self.overwrite)?,
            false => order.proceed()?,
        };
        let name = format!("{} seed {}", job.identity.variant, job.identity.seed);
        for warning in launch.warnings() {
            self.say(&format!("warning: {name}: {warning}"));
        }
        let steps_before = launch.steps_before();
        if steps_before > 0 {
            self.say(&format!("{name} goes on after {steps_before} steps"));
        }
        let progress = Progress::new(&self.display, name, job.variant.experiment.steps, steps_before);
        launch.run(progress, &STOP)
    }

    /// Above the lines of the runs; also where there is no terminal to draw them on.
    fn say(&self, message: &str) {
        self.display.suspend(|| output::message(message));
    }
}

fn no_thread(error: &std::io::Error) -> String {
    format!("a thread cannot be started: {error}; `ulimit -u` shows how many this user may have")
}

fn default_jobs(jobs: &VecDeque<Job>) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = jobs.iter().map(|job| job.variant.experiment.threads).max().unwrap_or(1);
    (cores / threads).max(1)
}

fn next(queue: &Mutex<VecDeque<Job>>) -> Option<Job> {
    if STOP.load(Ordering::Relaxed) {
        return None;
    }
    queue.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
}
