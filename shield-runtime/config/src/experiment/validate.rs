//! What the types of an experiment cannot say.

use std::{collections::HashSet, time::Duration};

use indexmap::IndexMap;

use super::config::{
    AttemptLength, DropInConfig, EvaluatedAgent, EvaluationConfig, ExperienceConfig, Experiment, Forward,
    Mode, OnAbort, PluginChoice, ProjectionConfig, QpConfig, ResetAttempts, RuleConfig, ShieldConfig,
    SpaceConfig, WorkerConfig,
};
use shield_host::plugin::Kind;

/// What is wrong, and the path of the value to which it belongs.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Complaint {
    pub path: String,
    pub message: String,
}

type Checked = Result<(), Complaint>;

fn ensure(holds: bool, path: impl Into<String>, message: impl Into<String>) -> Checked {
    if holds { Ok(()) } else { Err(Complaint { path: path.into(), message: message.into() }) }
}

/// Refuses what cannot be run.
pub(super) fn validate(experiment: &Experiment) -> Checked {
    folder_name("name", &experiment.name)?;
    ensure(experiment.steps > 0, "steps", "a run needs at least one step")?;
    seeds(&experiment.seeds)?;
    ensure(experiment.threads > 0, "threads", "a run needs at least one thread")?;
    let cost = experiment.hard_reset_cost;
    ensure(
        cost.is_finite() && cost >= 0.0,
        "hard_reset_cost",
        format!("the cost of a hard reset is {cost}; it must be finite and not negative"),
    )?;
    let every = experiment.checkpoint.as_ref().map(|checkpoint| checkpoint.every);
    ensure(every != Some(0), "checkpoint.every", "checkpoints need at least one step between them")?;
    let record = experiment.record;
    ensure(
        record.decisions > 0 || record.states_every == 0,
        "record.states_every",
        "states are kept with decisions, of which `decisions: 0` keeps none",
    )?;
    plugins(experiment)?;
    pins(&experiment.pins)?;
    mode(experiment)?;
    calibration(experiment.calibration_resets, experiment.reset_task.as_ref())?;
    shield(&experiment.shield)?;
    learning(experiment)?;
    experience(&experiment.experience)?;
    experiment.evaluation.as_ref().map_or(Ok(()), |settings| evaluation(experiment, settings))
}

/// Refuses names that cannot be a folder's on every system.
pub(super) fn folder_name(path: &str, name: &str) -> Checked {
    check_folder_name(name).map_err(|message| Complaint { path: path.into(), message })
}

/// Says why a name cannot be a folder's on every system, if it cannot.
pub fn check_folder_name(name: &str) -> Result<(), String> {
    let forbidden = |character: char| character.is_control() || "/\\:*?\"<>|".contains(character);
    let trimmed = name.trim_end_matches('.').trim();
    if !name.is_empty() && trimmed == name && !name.contains(forbidden) {
        return Ok(());
    }
    Err(format!(
        "{name:?} cannot name a folder: it must not be empty, contain any of / \\ : * ? \" < > |, begin or end with a space, or end with a dot"
    ))
}

fn seeds(seeds: &[u64]) -> Checked {
    ensure(!seeds.is_empty(), "seeds", "at least one seed is needed")?;
    let mut known = HashSet::with_capacity(seeds.len());
    for (index, seed) in seeds.iter().enumerate() {
        let is_new = known.insert(seed);
        ensure(is_new, format!("seeds[{index}]"), format!("the seed {seed} is given twice"))?;
    }
    Ok(())
}

fn plugins(experiment: &Experiment) -> Checked {
    experiment.plugins().into_iter().try_for_each(|(path, kind, choice)| plugin(&path, kind, choice))
}

fn plugin(path: &str, kind: Kind, choice: &PluginChoice) -> Checked {
    ensure(!choice.plugin.is_empty(), format!("{path}.plugin"), "the id of a plugin is empty")?;
    ensure(
        !choice.isolate || matches!(kind, Kind::Environment | Kind::Policy),
        format!("{path}.isolate"),
        "only environments and policies can run in a process of their own",
    )?;
    ensure(
        choice.isolate || choice.worker == WorkerConfig::default(),
        format!("{path}.worker"),
        "without `isolate: true` there is no worker process",
    )?;
    let WorkerConfig { start_timeout_s, step_timeout_s, .. } = choice.worker;
    for (field, value) in [("start_timeout_s", start_timeout_s), ("step_timeout_s", step_timeout_s)] {
        let is_limit = Duration::try_from_secs_f64(value).is_ok_and(|limit| !limit.is_zero());
        let message = format!("a time limit is finite and above 0, not {value}");
        ensure(is_limit, format!("{path}.worker.{field}"), message)?;
    }
    Ok(())
}

fn pins(pins: &IndexMap<String, String>) -> Checked {
    for (id, sha256) in pins {
        let is_digit = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
        let is_sha256 = sha256.len() == 64 && sha256.bytes().all(is_digit);
        let message = format!("{sha256:?} is not a SHA-256: 64 lower-case hexadecimal digits");
        ensure(is_sha256, format!("pins.{id}"), message)?;
    }
    Ok(())
}

fn mode(experiment: &Experiment) -> Checked {
    let has_reset = experiment.reset.is_some();
    match experiment.mode {
        Mode::Shielded => {
            ensure(has_reset, "mode", "`Shielded` needs a reset agent: `reset: (plugin: …)`")?;
            ensure(
                !experiment.shield.rules.is_empty(),
                "shield.rules",
                "`Shielded` without any rule would never abort: give at least one in `shield: (rules: […])`, or another mode",
            )
        }
        Mode::ResetOnly { .. } => {
            ensure(has_reset, "mode", "`ResetOnly` needs a reset agent: `reset: (plugin: …)`")
        }
        Mode::StatusQuo | Mode::ForwardOnly => Ok(()),
    }
}

fn calibration(resets: u32, reset_task: Option<&PluginChoice>) -> Checked {
    ensure(
        resets == 0 || reset_task.is_some(),
        "calibration_resets",
        "there is no reset task that would learn from them: leave it out, or name one, for example `reset_task: Some(plugin: \"calibrated-start\")`",
    )
}

fn shield(settings: &ShieldConfig) -> Checked {
    ensure(
        settings.reset_attempts != ResetAttempts::After(0),
        "shield.reset_attempts",
        "a hard reset can follow 1 failed attempt or more, not 0; `Unlimited` means never",
    )?;
    ensure(
        settings.attempt_length != AttemptLength::Steps(0),
        "shield.attempt_length",
        "an attempt needs at least one step",
    )?;
    for (index, value) in settings.fallback_action.iter().flatten().enumerate() {
        let path = format!("shield.fallback_action[{index}]");
        ensure(value.is_finite(), path, format!("an action cannot be {value}"))?;
    }
    ensure(settings.deadline_us != Some(0), "shield.deadline_us", "every decision takes longer than 0 µs")?;
    if let OnAbort::Penalise(penalty) = settings.on_abort {
        let message = format!("the penalty {penalty} is not finite and above 0");
        ensure(penalty.is_finite() && penalty > 0.0, "shield.on_abort", message)?;
    }
    rules(&settings.rules, "shield.rules")?;
    match &settings.projection {
        Some(ProjectionConfig::Qp(settings)) => projection(settings),
        Some(ProjectionConfig::Best | ProjectionConfig::Replace) | None => Ok(()),
    }
}

/// What only a forward agent that learns can do.
fn learning(experiment: &Experiment) -> Checked {
    let learns = matches!(experiment.forward, Forward::Learner(_));
    let settings = &experiment.shield;
    let message = "a finished policy learns from nothing: it takes `forward: Learner(…)`, or `Nothing` here";
    ensure(learns || settings.on_abort == OnAbort::Nothing, "shield.on_abort", message)?;
    let message =
        "a finished policy values no action: `Best` takes `forward: Learner(…)`; `Replace` works here";
    ensure(learns || settings.projection != Some(ProjectionConfig::Best), "shield.projection", message)
}

fn rules(rules: &[RuleConfig], path: &str) -> Checked {
    for (index, rule) in rules.iter().enumerate() {
        let path = format!("{path}[{index}]");
        match rule {
            RuleConfig::Rule(_) => {}
            RuleConfig::Soft { priority, .. } => {
                let message = format!("the priority {priority} is not finite and above 0");
                ensure(priority.is_finite() && *priority > 0.0, format!("{path}.priority"), message)?;
            }
            RuleConfig::All(parts) | RuleConfig::Any(parts) => {
                ensure(!parts.is_empty(), &path, "`All` and `Any` need at least one rule")?;
                self::rules(parts, &path)?;
            }
        }
    }
    Ok(())
}

fn projection(settings: &QpConfig) -> Checked {
    let QpConfig { margin, max_iterations, trust_region, weights } = settings;
    ensure(
        margin.is_finite() && *margin >= 0.0,
        "shield.projection.margin",
        format!("the margin is {margin}; it must be finite and not negative"),
    )?;
    ensure(
        *max_iterations > 0,
        "shield.projection.max_iterations",
        "a projection linearises the rules at least once",
    )?;
    ensure(
        trust_region.is_none_or(|share| share.is_finite() && share > 0.0),
        "shield.projection.trust_region",
        "the share of half a dimension's range must be finite and above 0",
    )?;
    for (index, weight) in weights.iter().flatten().enumerate() {
        let path = format!("shield.projection.weights[{index}]");
        let message = format!("the weight {weight} is not finite and above 0");
        ensure(weight.is_finite() && *weight > 0.0, path, message)?;
    }
    Ok(())
}

fn experience(settings: &ExperienceConfig) -> Checked {
    let ExperienceConfig { capacity, batch, bootstrap_probability: probability, .. } = *settings;
    ensure(batch > 0, "experience.batch", "a batch needs at least one transition")?;
    ensure(
        batch <= capacity,
        "experience.batch",
        format!("a batch of {batch} does not fit into a capacity of {capacity}"),
    )?;
    ensure(
        settings.update_every > 0,
        "experience.update_every",
        "every n-th step needs an n of at least 1; `updates_per_step: 0` learns nothing",
    )?;
    let shares = [("failure_share", settings.failure_share), ("success_share", settings.success_share)];
    for (field, share) in shares {
        let message = format!("{share} is not a share between 0 and 1");
        ensure((0.0..=1.0).contains(&share), format!("experience.{field}"), message)?;
    }
    let sum = settings.failure_share + settings.success_share;
    let message = format!("with `failure_share` it makes {sum}; a batch has no more than 1");
    ensure(sum <= 1.0, "experience.success_share", message)?;
    ensure(
        settings.abort_lifetime != Some(0),
        "experience.abort_lifetime",
        "an abort that teaches for no transition is not stored at all: leave `on_abort` out",
    )?;
    let half_life = settings.outcome_half_life;
    let message = format!("the half-life {half_life} is not above 0; `inf`: outcomes do not fade");
    ensure(half_life > 0.0, "experience.outcome_half_life", message)?;
    let weight = settings.cost_weight;
    ensure(
        weight.is_finite() && weight >= 0.0,
        "experience.cost_weight",
        format!("the weight {weight} is not finite and at least 0"),
    )?;
    ensure(
        probability > 0.0 && probability <= 1.0,
        "experience.bootstrap_probability",
        format!("{probability} is not a probability above 0 and up to 1"),
    )
}

/// Refuses what cannot stand between somebody's own policy and environment.
pub(super) fn validate_drop_in(config: &DropInConfig) -> Checked {
    config.plugins().into_iter().try_for_each(|(path, kind, choice)| plugin(&path, kind, choice))?;
    pins(&config.pins)?;
    ensure(config.threads > 0, "threads", "a shield needs at least one thread")?;
    ensure(config.episode_length > 0, "episode_length", "a reset episode needs at least one step")?;
    let cost = config.hard_reset_cost;
    ensure(
        cost.is_finite() && cost >= 0.0,
        "hard_reset_cost",
        format!("the cost of a hard reset is {cost}; it must be finite and not negative"),
    )?;
    calibration(config.calibration_resets, config.reset_task.as_ref())?;
    let settings = &config.shield;
    ensure(!settings.rules.is_empty(), "shield.rules", "a shield without any rule would never abort")?;
    shield(settings)?;
    ensure(
        settings.on_abort == OnAbort::Nothing,
        "shield.on_abort",
        "what an agent of yours learns from an abort is the reward that you give it, not a matter of the shield",
    )?;
    ensure(
        settings.projection != Some(ProjectionConfig::Best),
        "shield.projection",
        "the values of an agent of yours are not known here: `Replace` works, and for a box of actions `Qp`",
    )?;
    for (name, space) in config.spaces.iter().flat_map(|spaces| spaces.named()) {
        space_is_possible(&format!("spaces.{name}"), name, space)?;
    }
    experience(&config.experience)
}

fn space_is_possible(path: &str, name: &str, space: &SpaceConfig) -> Checked {
    space
        .clone()
        .into_space()
        .validate(name)
        .map_err(|error| Complaint { path: path.to_owned(), message: error.message().to_owned() })
}

fn evaluation(experiment: &Experiment, settings: &EvaluationConfig) -> Checked {
    ensure(settings.every > 0, "evaluation.every", "evaluations need at least one step between them")?;
    ensure(settings.episodes > 0, "evaluation.episodes", "an evaluation needs at least one episode")?;
    let share = settings.solved_at;
    ensure(
        share > 0.0 && share <= 1.0,
        "evaluation.solved_at",
        format!("{share} is not a share above 0 and up to 1"),
    )?;
    let learns_to_reset = matches!(experiment.mode, Mode::Shielded | Mode::ResetOnly { .. });
    ensure(
        settings.agent == EvaluatedAgent::Forward || learns_to_reset,
        "evaluation.agent",
        format!("the mode {:?} has no reset agent to evaluate", experiment.mode),
    )
}
