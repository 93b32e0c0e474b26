//! `shield env`: environments without an experiment around them.

use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{Environment, Setup};
use shield_check::environment_check::{CHECKS, Subject, Verdict, random_action};
use shield_host::plugin::{Kind, LoadedEnvironment, Registry, Selection, host};

use super::{Failure, output, plugin};

#[derive(Subcommand)]
pub enum EnvCommand {
    /// Lists the environments on the search path, without loading any.
    List,
    /// Runs an environment through what must hold of every environment, and says what passed, failed or could not be told.
    ///
    /// Exit code 1 if something failed. The last check makes 1,200 instances, which takes a few seconds.
    Check(Named),
    /// Measures how fast an environment steps: random actions, one thread, through the plugin's interface.
    ///
    /// The figure is the best of several rounds, since whatever else runs on the machine only slows it.
    Bench(BenchArguments),
}

/// Which environment.
#[derive(Args)]
pub struct Named {
    /// Its id, for example mujoco/cliff-cheetah.
    id: String,
    /// Its configuration, for example '(horizon: 100)'.
    #[arg(long, default_value = "")]
    config: String,
    /// Seed of actions and starts.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

#[derive(Args)]
pub struct BenchArguments {
    #[command(flatten)]
    named: Named,
    /// Steps of a round.
    #[arg(long, default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Rounds.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
}

pub fn run(command: &EnvCommand, registry: &Registry) -> Result<(), Failure> {
    match command {
        EnvCommand::List => plugin::list(registry, Some(Kind::Environment)),
        EnvCommand::Check(named) => check(named, registry),
        EnvCommand::Bench(arguments) => bench(arguments, registry),
    }
}

fn make(named: &Named, registry: &Registry) -> Result<LoadedEnvironment, Failure> {
    let setup = Setup::new(named.seed, 1, host());
    registry
        .environment(&Selection::new(&named.id), &named.config, &setup)
        .map_err(|error| Failure::Input(error.to_string()))
}

fn check(named: &Named, registry: &Registry) -> Result<(), Failure> {
    let entry =
        registry.find(&named.id, Kind::Environment).map_err(|error| Failure::Input(error.to_string()))?;
    // What the user wrote wrongly is no failed check.
    drop(make(named, registry)?);
    let make = || -> Result<Box<dyn Environment>, String> {
        Ok(Box::new(make(named, registry).map_err(|failure| failure.to_string())?))
    };
    let subject = Subject {
        make: &make,
        is_deterministic: entry.manifest.deterministic,
        seed: named.seed,
        allocations: None,
    };
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Dynamic);
    let mut failed = Vec::new();
    for check in CHECKS {
        let (verdict, reason) = match (check.run)(&subject) {
            Ok(Verdict::Passed(seen)) => ("pass", seen),
            Ok(Verdict::Skipped(why)) => ("skip", why),
            Err(what) => {
                failed.push(check.name);
                ("FAIL", what)
            }
        };
        table.add_row([verdict, check.name, check.rule, &reason]);
    }
    output::result(table)?;
    if failed.is_empty() {
        return Ok(());
    }
    Err(Failure::Run(format!(
        "{} fails {} of {} checks: {}",
        named.id,
        failed.len(),
        CHECKS.len(),
        failed.join(", ")
    )))
}

fn bench(arguments: &BenchArguments, registry: &Registry) -> Result<(), Failure> {
    let mut environment = make(&arguments.named, registry)?;
    let mut best = Duration::MAX;
    for _ in 0..arguments.rounds {
        let time = round(&mut environment, arguments.steps, arguments.named.seed);
        best = best.min(time.map_err(|error| Failure::Run(error.to_string()))?);
    }
    let seconds = best.as_secs_f64();
    output::result(format_args!(
        "{}: {:.0} steps/s, {:.2} µs a step",
        arguments.named.id,
        f64::from(arguments.steps) / seconds,
        1e6 * seconds / f64::from(arguments.steps)
    ))
}

/// The time of so many steps, hard resets at the end of episodes included. Every round does the same.
fn round(environment: &mut LoadedEnvironment, steps: u32, seed: u64) -> shield_api::Result<Duration> {
    let spec = environment.spec();
    let mut rng = Pcg64::seed_from_u64(seed);
    let actions: Vec<Vec<f32>> = (0..100).map(|_| random_action(&spec.spaces.action, &mut rng)).collect();
    let mut observation = vec![0.0; spec.spaces.observation_len()];
    let begun = Instant::now();
    let mut left = 0;
    for (step, action) in (0..steps).zip(actions.iter().cycle()) {
        if left == 0 {
            environment.reset(seed.wrapping_add(u64::from(step)), &mut observation)?;
            left = spec.episode_length;
        }
        left -= 1;
        if environment.step(action, &mut observation)?.terminated {
            left = 0;
        }
    }
    Ok(begun.elapsed())
}
