//! `shield render`: films a loop or a policy, off-screen.

mod encode;

use std::{
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};

use anyhow::Result;
use clap::{Args, ValueEnum};
use indicatif::MultiProgress;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{ActMode, Environment, Learner};
use shield_runtime::{
    agent::ForwardAgent,
    checkpoint::last_checkpoint,
    environment_check::random_action,
    experiment::{Experiment, ExperimentFile, OnResetSuccess, Override, Variant},
    film::{FilmSettings, Filmer, Picture, SharedEnvironment, SharedLearner},
    joint_loop::{JointLoop, Participants},
    observer::Fanout,
    plugin::Registry,
    run::{Prepared, prepare},
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
    let mut prepared = prepare(registry, &variant, seed)?;
    let missing = match arguments.policy {
        Who::Forward if prepared.participants.forward.is_none() => Some("forward"),
        Who::Reset if prepared.participants.reset.is_none() => Some("reset"),
        _ => None,
    };
    if let Some(role) = missing {
        return Err(Failure::Input(format!("this variant has no {role} agent")));
    }
    if arguments.experiment.is_dir() {
        let saved =
            last_checkpoint(&arguments.experiment).map_err(|error| Failure::Input(format!("{error:#}")))?;
        let restored = prepared.participants.restore_agents(&saved.state);
        restored.map_err(|error| Failure::Input(error.to_string()))?;
    }
    let encoder = Encoder::create(&arguments.out, arguments.fps).map_err(Failure::Input)?;
    let q_min = threshold(registry, &variant.experiment);
    film(arguments, &variant, prepared, q_min, encoder, seed)
        .map_err(|error| Failure::Run(format!("{error:#}")))?;
    output::note(arguments.out.display());
    Ok(())
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

/// The parts of a run with the camera between.
struct Set {
    participants: Participants,
    environment: SharedEnvironment,
    reset: Option<SharedLearner>,
}

impl Set {
    fn new(mut participants: Participants) -> Self {
        let mut shared = None;
        participants.world = participants.world.map_environment(|environment| {
            let environment = SharedEnvironment::new(environment);
            shared = Some(environment.clone());
            Box::new(environment)
        });
        let environment = shared.expect("the closure above ran");
        let mut reset = None;
        participants.reset = participants.reset.map(|agent| {
            agent.map_learner(|learner| {
                let learner = SharedLearner::new(learner);
                reset = Some(learner.clone());
                Box::new(learner)
            })
        });
        // An evaluation would only take time.
        participants.evaluator = None;
        Self { participants, environment, reset }
    }
}

fn film(
    arguments: &RenderArguments,
    variant: &Variant,
    prepared: Prepared,
    q_min: Option<f32>,
    mut encoder: Encoder,
    seed: u64,
) -> Result<()> {
    let Set { participants, environment, reset } = Set::new(prepared.participants);
    let largest_value = match (&reset, variant.experiment.experience.endings().on_success) {
        (None, _) | (_, OnResetSuccess::Terminal) => 1.0,
        (Some(reset), OnResetSuccess::Bootstrap) => 1.0 / (1.0 - reset.info().discount),
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
    let filmer = Filmer::new(environment.clone(), reset.clone(), settings, &mut sink);
    let mut loop_settings = prepared.settings;
    (loop_settings.evaluate_every, loop_settings.checkpoint_every) = (None, None);
    if is_of_run {
        loop_settings.updates_per_step = 0;
    }
    loop_settings.steps = arguments.train_steps + if is_loop { arguments.steps } else { 0 };
    let progress = Progress::new(&MultiProgress::new(), "filming".into(), loop_settings.steps, 0);
    let mut observer = Fanout(progress, filmer);
    let stop = AtomicBool::new(false);
    let mut joint = JointLoop::new(loop_settings, participants, prepared.randomness, &mut observer, &stop);
    joint.run()?;
    let forward = joint.into_forward();
    let Fanout(progress, mut filmer) = observer;
    drop(progress);
    if !is_loop {
        let mut actor = match arguments.policy {
            Who::Forward => Actor::Forward(forward.expect("`render` made sure of it")),
            Who::Reset => Actor::Reset(reset.expect("`render` made sure of it")),
            Who::Loop | Who::Random => Actor::Random(Box::new(Pcg64::seed_from_u64(seed))),
        };
        perform(&mut actor, environment, arguments.steps, arguments.every, seed, &mut filmer)?;
    }
    drop(filmer);
    encoder.finish()
}

/// Who acts outside the loop.
enum Actor {
    Forward(ForwardAgent),
    Reset(SharedLearner),
    Random(Box<Pcg64>),
}

/// Episodes one after the other, each from a hard reset.
fn perform(
    actor: &mut Actor,
    mut environment: SharedEnvironment,
    steps: u64,
    every: u64,
    seed: u64,
    filmer: &mut Filmer<'_>,
) -> Result<()> {
    let spec = environment.spec();
    let mut observation = vec![0.0; spec.spaces.observation_len()];
    let mut action = vec![0.0; spec.spaces.action_len()];
    let mut seeds = Pcg64::seed_from_u64(seed);
    let mut left = 0;
    for step in 1..=steps {
        if left == 0 {
            environment.reset(seeds.next_u64(), &mut observation)?;
            left = spec.episode_length;
        }
        let phase = match actor {
            Actor::Forward(agent) => {
                agent.act(&observation, ActMode::Greedy, &mut action)?;
                "FORWARD, unshielded"
            }
            Actor::Reset(agent) => {
                agent.act(&observation, ActMode::Greedy, &mut action)?;
                "RESET"
            }
            Actor::Random(rng) => {
                action = random_action(&spec.spaces.action, rng);
                "RANDOM"
            }
        };
        let outcome = environment.step(&action, &mut observation)?;
        left = if outcome.terminated { 0 } else { left - 1 };
        if step.is_multiple_of(every) {
            filmer.shoot(phase, step)?;
        }
    }
    Ok(())
}

/// The path's file that is being written.
fn partial(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".partial");
    name.into()
}
