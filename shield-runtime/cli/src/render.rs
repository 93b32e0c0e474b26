//! `shield render`: films a loop or a policy, off-screen.

mod encode;

use std::{
    path::PathBuf,
    process,
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use indicatif::MultiProgress;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::ActMode;
use shield_check::environment_check::random_action;
use shield_config::experiment::{Experiment, ExperimentFile, OnResetSuccess, Override, Variant};
use shield_core::{
    agent::Agent,
    cycle::CycleParts,
    world::{Stepped, World},
};
use shield_host::plugin::Registry;
use shield_lab::{
    checkpoint::last_checkpoint,
    joint_loop::{JointLoop, LoopParts},
    observer::{Fanout, Scene},
    run::{RecorderState, prepare},
};
use shield_report::{
    film::{FilmSettings, Filmer},
    report::Picture,
};

use super::{Failure, eval::one_run, output, progress::Progress};
use encode::Encoder;

/// Arguments of `shield render`.
#[derive(Args)]
pub struct RenderArguments {
    /// The experiment, a RON file; or the folder of a run, whose agents are filmed as they were last saved and learn no more.
    experiment: PathBuf,
    /// The picture to write: .gif, .mp4 (through the program ffmpeg), or .png (the last picture alone).
    #[arg(long)]
    out: PathBuf,
    /// Whose actions are filmed.
    #[arg(long, value_enum, default_value_t = Who::Loop)]
    policy: Who,
    /// Steps to film.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// Steps of training before the film.
    #[arg(long, default_value_t = 0)]
    train_steps: u64,
    /// One picture for so many steps.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// Pictures per second.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=50))]
    fps: u16,
    /// Size of the environment's picture, such as 480x360. Default: the environment's own.
    #[arg(long, value_parser = size)]
    size: Option<[usize; 2]>,
    /// The variant; the experiment's first by default.
    #[arg(long)]
    variant: Option<String>,
    /// The seed; the experiment's first by default.
    #[arg(long)]
    seed: Option<u64>,
    /// Sets a field of the experiment, for example shield.rules[0].config.q_min=5. May be repeated.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    sets: Vec<String>,
}

/// Who acts in a film.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Who {
    /// The joint loop of the experiment, with its shield: both agents take turns, and go on learning
    Loop,
    /// The forward agent alone, greedy, without a shield
    Forward,
    /// The reset agent alone, greedy
    Reset,
    /// Nobody: random actions
    Random,
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let side = |text: &str| text.parse().ok().filter(|pixels| (16..=4096).contains(pixels));
    let sides = text.split_once('x').and_then(|(width, height)| Some([side(width)?, side(height)?]));
    sides.ok_or_else(|| "a size is WIDTHxHEIGHT, each from 16 to 4096 pixels, for example 480x360".into())
}

/// Films.
pub fn render(arguments: &RenderArguments, registry: &Registry) -> Result<(), Failure> {
    let variant = variant(arguments)?;
    let seed = arguments.seed.unwrap_or(variant.experiment.seeds[0]);
    let mut parts = prepare(registry, &variant, seed)?;
    let missing = match arguments.policy {
        Who::Forward if parts.agents.forward.is_none() => Some("forward"),
        Who::Reset if parts.agents.reset.is_none() => Some("reset"),
        _ => None,
    };
    if let Some(role) = missing {
        return Err(Failure::Input(format!("this variant has no {role} agent")));
    }
    if arguments.experiment.is_dir() {
        let saved = last_checkpoint::<RecorderState>(&arguments.experiment);
        let saved = saved.map_err(|error| Failure::Input(format!("{error:#}")))?;
        let restored = parts.restore_agents(&saved.state);
        restored.map_err(|error| Failure::Input(error.to_string()))?;
    }
    stop_on_ctrl_c();
    let encoder = Encoder::create(&arguments.out, arguments.fps).map_err(Failure::Input)?;
    let q_min = threshold(registry, &variant.experiment);
    let filmed = film(arguments, &variant, parts, q_min, encoder, seed);
    if STOP.load(Ordering::Relaxed) {
        return Err(Failure::Interrupted("stopped by Ctrl-C; no film was written".into()));
    }
    filmed.map_err(|error| Failure::Run(format!("{error:#}")))?;
    output::note(arguments.out.display());
    Ok(())
}

/// Set by Ctrl-C. The film then ends before it is complete, and its file is removed.
static STOP: AtomicBool = AtomicBool::new(false);

/// The first Ctrl-C ends the film, the second the program at once.
fn stop_on_ctrl_c() {
    let installed = ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            process::exit(130);
        }
    });
    if let Err(error) = installed {
        output::message(format_args!("warning: Ctrl-C leaves an unfinished file behind: {error}"));
    }
}

fn variant(arguments: &RenderArguments) -> Result<Variant, Failure> {
    let mut sets = arguments.sets.iter().map(|set| Override::parse(set)).collect::<Result<Vec<_>, _>>()?;
    let path = if arguments.experiment.is_dir() {
        if arguments.train_steps > 0 {
            let message = "the agents of a run are trained already: --train-steps is for an experiment";
            return Err(Failure::Input(message.into()));
        }
        // It lies behind them.
        sets.push(Override::new("shield.warm_up_steps", "0", "a run's film")?);
        one_run(&arguments.experiment)?.path().join("config.ron")
    } else {
        arguments.experiment.clone()
    };
    let file = ExperimentFile::read(&path)?;
    let only = arguments.variant.as_ref().map(|name| vec![name.clone()]);
    let mut variants = file.variants(&sets, only.as_deref())?;
    Ok(variants.swap_remove(0))
}

/// The first rule's `q_min` that is a plain number: the experiment's, else the plugin's default.
fn threshold(registry: &Registry, experiment: &Experiment) -> Option<f32> {
    let value = |text: &str| text.trim().parse::<f32>().ok();
    let rules = experiment.plugins().into_iter().filter(|(path, ..)| path.starts_with("shield"));
    rules.into_iter().find_map(|(_, _, choice)| {
        let given = choice.config.get_ron().split_once("q_min").and_then(|(_, rest)| {
            let rest = rest.trim_start().strip_prefix(':')?;
            value(rest.split([',', ')', '\n']).next()?)
        });
        let entry = registry.entries().iter().find(|entry| entry.manifest.id == choice.plugin)?;
        let field = entry.manifest.fields.iter().find(|field| field.name == "q_min");
        given.or_else(|| value(&field?.default))
    })
}

fn film(
    arguments: &RenderArguments,
    variant: &Variant,
    mut parts: LoopParts,
    q_min: Option<f32>,
    mut encoder: Encoder,
    seed: u64,
) -> Result<()> {
    // An evaluation would only take time.
    parts.evaluator = None;
    let reset = parts.agents.reset.as_ref().map(Agent::info);
    let largest_value = match (&reset, variant.experiment.experience.endings().on_success) {
        (None, _) | (_, OnResetSuccess::Terminal) => 1.0,
        (Some(reset), OnResetSuccess::Bootstrap) => 1.0 / (1.0 - reset.discount),
    };
    let (is_loop, is_of_run) = (arguments.policy == Who::Loop, arguments.experiment.is_dir());
    let settings = FilmSettings {
        size: arguments.size,
        from: arguments.train_steps,
        every: arguments.every,
        q_min,
        largest_value,
    };
    let mut sink = |picture: &Picture| encoder.add(picture);
    let spaces = parts.world.spec().spaces.clone();
    let filmer = Filmer::new(spaces, reset.map_or(0, |reset| reset.members), settings, &mut sink);
    let loop_settings = &mut parts.settings;
    (loop_settings.evaluate_every, loop_settings.checkpoint_every) = (None, None);
    if is_of_run {
        loop_settings.cycle.updates_per_step = 0;
        loop_settings.cycle.reset_updates_per_step = None;
    }
    loop_settings.steps = arguments.train_steps + if is_loop { arguments.steps } else { 0 };
    let progress = Progress::new(&MultiProgress::new(), "filming".into(), loop_settings.steps, 0);
    let mut observer = Fanout(progress, filmer);
    let mut joint = JointLoop::new(parts, &mut observer, &STOP);
    joint.run()?;
    let (world, agents) = joint.into_parts();
    let Fanout(progress, mut filmer) = observer;
    drop(progress);
    if !is_loop {
        perform(arguments, world, agents, seed, &mut filmer)?;
    }
    drop(filmer);
    if STOP.load(Ordering::Relaxed) {
        return Ok(());
    }
    encoder.finish().with_context(|| format!("cannot write {}", arguments.out.display()))
}

/// Episodes one after the other, each from a hard reset, in which one agent acts, or nobody.
fn perform(
    arguments: &RenderArguments,
    mut world: World,
    agents: CycleParts,
    seed: u64,
    filmer: &mut Filmer<'_>,
) -> Result<()> {
    let CycleParts { mut forward, mut reset, .. } = agents;
    let spec = world.spec().clone();
    let mut action = vec![0.0; spec.spaces.action_len()];
    let mut seeds = Pcg64::seed_from_u64(seed);
    let mut actions = Pcg64::seed_from_u64(seed);
    let mut left = 0;
    for step in 1..=arguments.steps {
        if STOP.load(Ordering::Relaxed) {
            break;
        }
        if left == 0 {
            world.hard_reset(None, seeds.next_u64())?;
            left = spec.episode_length;
        }
        let observation = world.observation().to_vec();
        let phase = match (arguments.policy, &mut forward, &mut reset) {
            (Who::Forward, Some(forward), _) => {
                forward.act(&observation, ActMode::Greedy, &mut action)?;
                "FORWARD, unshielded"
            }
            (Who::Reset, _, Some(reset)) => {
                reset.learner().act(&observation, ActMode::Greedy, &mut action)?;
                "RESET"
            }
            _ => {
                action = random_action(&spec.spaces.action, &mut actions);
                "RANDOM"
            }
        };
        let Stepped::Made(outcome) = world.step(&action)? else {
            bail!("the environment's process was lost on the way");
        };
        world.advance();
        left = if outcome.terminated { 0 } else { left - 1 };
        if step.is_multiple_of(arguments.every) {
            let mut scene = Scene { world: &mut world, reset: reset.as_mut().map(|agent| agent.learner()) };
            filmer.shoot(phase, step, (&observation, &action), &mut scene)?;
        }
    }
    Ok(())
}
