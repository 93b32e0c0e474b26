//! The checks themselves.

use std::{fs, thread};

use shield_api::{ErrorKind, Frame, Space};

use super::{
    Guarded, Subject,
    Verdict::{self, Passed, Skipped},
    rollout::{Rollout, STEPS},
};

/// Steps before a state is saved: no multiple of a usual episode's length, so that it lies within an episode.
const BEFORE_SAVING: usize = 111;

type Finding = Result<Verdict, String>;

/// Fails with the message unless the condition holds.
fn ensure(holds: bool, message: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(message()) }
}

/// Where two recordings of one length differ, for a person.
fn ensure_same(one: &[u32], other: &[u32], what: &str) -> Result<(), String> {
    let differs = one.iter().zip(other).position(|(one, other)| one != other);
    ensure(differs.is_none() && one.len() == other.len(), || {
        let place = differs.unwrap_or(0);
        format!("{what}: the first difference is value {place} of {} in {STEPS} steps", one.len())
    })
}

/// Reproducibility cannot be asked of an environment that does not promise it.
fn unless_deterministic(subject: &Subject<'_>) -> Option<Verdict> {
    let reason = "its manifest says that it is not deterministic by seed";
    (!subject.is_deterministic).then(|| Skipped(reason.into()))
}

pub fn spaces(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    let spec = rollout.spec.clone();
    spec.spaces.observation.validate("observation").map_err(|error| error.to_string())?;
    spec.spaces.action.validate("action").map_err(|error| error.to_string())?;
    ensure(spec.episode_length > 0, || "its episodes have no steps".into())?;
    if let Space::Box { low, high } = &spec.spaces.action {
        let unbounded = low.iter().chain(high).position(|bound| !bound.is_finite());
        ensure(unbounded.is_none(), || "an action without bounds cannot be explored".into())?;
    }
    for _ in 0..STEPS {
        rollout.advance()?;
        if let Space::Box { low, high } = &spec.spaces.observation {
            for (index, value) in rollout.observation.iter().enumerate() {
                let is_inside = *value >= low[index] && *value <= high[index];
                ensure(is_inside, || {
                    format!("observation[{index}] is {value}, outside [{}, {}]", low[index], high[index])
                })?;
            }
        } else {
            let ones = rollout.observation.iter().filter(|value| **value == 1.0).count();
            let sum: f32 = rollout.observation.iter().sum();
            ensure(ones == 1 && sum == 1.0, || "an observation is not one-hot".into())?;
        }
    }
    let (observation, action) = (spec.spaces.observation_len(), spec.spaces.action_len());
    let length = spec.episode_length;
    Ok(Passed(format!("observation {observation}, action {action}, episodes of {length}")))
}

pub fn finite(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    let mut range = [f32::INFINITY, f32::NEG_INFINITY];
    for step in 0..STEPS {
        let outcome = rollout.advance()?;
        let rewards = [outcome.forward_reward, outcome.reset_reward];
        let is_finite = rollout.observation.iter().chain(&rewards).all(|value| value.is_finite());
        ensure(is_finite, || format!("step {step} gave a value that is not finite"))?;
        range = [range[0].min(rewards[0]), range[1].max(rewards[0])];
    }
    Ok(Passed(format!("forward rewards from {:.3} to {:.3} in {STEPS} steps", range[0], range[1])))
}

pub fn guards(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    let mut observation = Guarded::output("observation", rollout.observation.len());
    let seed = subject.seed;
    let reset = rollout.environment.reset(seed, observation.slice_mut());
    reset.map_err(|error| format!("a reset with seed {seed} fails: {error}"))?;
    observation.checked()?;
    for _ in 0..rollout.spec.episode_length.min(STEPS) {
        let action = Guarded::input("action", &rollout.act()?);
        let stepped = rollout.environment.step(action.slice(), observation.slice_mut());
        let outcome = stepped.map_err(|error| format!("a step fails: {error}"))?;
        observation.checked()?;
        action.checked()?;
        if outcome.terminated {
            break;
        }
    }
    Ok(Passed("observation and action".into()))
}

pub fn reset_reward(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    if !rollout.spec.brings_reset_reward {
        return Ok(Skipped("it brings no reset reward; a reset task does".into()));
    }
    let mut range = [f32::INFINITY, f32::NEG_INFINITY];
    for _ in 0..STEPS {
        let reward = rollout.advance()?.reset_reward;
        range = [range[0].min(reward), range[1].max(reward)];
        ensure((0.0..=1.0).contains(&reward), || {
            format!("a reset reward is {reward}; values lie in [0, 1/(1 − γ)] only for rewards in [0, 1]")
        })?;
    }
    Ok(Passed(format!("from {:.3} to {:.3} in {STEPS} steps", range[0], range[1])))
}

pub fn seed(subject: &Subject<'_>) -> Finding {
    if let Some(skipped) = unless_deterministic(subject) {
        return Ok(skipped);
    }
    let mut rollout = Rollout::new(subject)?;
    let recorded = rollout.record(STEPS)?;
    let other = Rollout::new(subject)?.record(STEPS)?;
    ensure_same(&recorded, &other, "another instance does something else")?;
    // A used instance must begin like a new one.
    let mut used = Rollout::new(subject)?;
    std::mem::swap(&mut used.environment, &mut rollout.environment);
    ensure_same(&recorded, &used.record(STEPS)?, "a used instance does something else than a new one")?;
    Ok(Passed(format!("{STEPS} steps, three times")))
}

pub fn state(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    let mut twin = Rollout::new(subject)?;
    rollout.record(BEFORE_SAVING)?;
    let mut bytes = Vec::new();
    match rollout.environment.save(&mut bytes) {
        Err(error) if error.kind() == ErrorKind::Unsupported => {
            return Ok(Skipped("it cannot save its state: a run continues at the next hard reset".into()));
        }
        saved => saved.map_err(|error| format!("saving fails: {error}"))?,
    }
    let continued = rollout.record(STEPS)?;
    // The twin has seen the same actions and seeds, so that only its world must be set.
    twin.record(BEFORE_SAVING)?;
    let mut fresh = (subject.make)()?;
    fresh
        .load(&bytes)
        .map_err(|error| format!("a new instance does not load what another saved: {error}"))?;
    let mut again = Vec::new();
    fresh.save(&mut again).map_err(|error| format!("saving what was loaded fails: {error}"))?;
    ensure(again == bytes, || "saving what was loaded gives other bytes".into())?;
    twin.environment = fresh;
    ensure_same(&continued, &twin.record(STEPS)?, "a loaded state continues differently")?;
    Ok(Passed(format!("{} bytes, {STEPS} steps on", bytes.len())))
}

pub fn foreign_state(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    rollout.record(10)?;
    let mut bytes = Vec::new();
    if rollout.environment.save(&mut bytes).is_err() {
        return Ok(Skipped("it cannot save its state".into()));
    }
    let shorter = &bytes[..bytes.len().saturating_sub(1)];
    let longer = [bytes.as_slice(), &[0]].concat();
    for (what, bad) in [
        ("no bytes at all", &[][..]),
        ("foreign bytes", b"foreign"),
        ("a state without its last byte", shorter),
        ("a state and one byte more", &longer),
    ] {
        ensure(rollout.environment.load(bad).is_err(), || format!("{what} are loaded as a state"))?;
        let mut after = Vec::new();
        rollout.environment.save(&mut after).map_err(|error| format!("saving fails: {error}"))?;
        ensure(after == bytes, || format!("{what} were refused, but changed the state"))?;
    }
    Ok(Passed("four kinds of them".into()))
}

/// A reset has no outcome. So a short way back must exist: doing nothing once, or for alternatives one or two of them.
pub fn reset_set(subject: &Subject<'_>) -> Finding {
    const SEEDS: u64 = 20;
    let mut rollout = Rollout::new(subject)?;
    if !rollout.spec.brings_reset_reward {
        return Ok(Skipped("it has no reset set of its own; a reset task does".into()));
    }
    let idle = rollout.idle();
    let ways: Vec<Vec<Vec<f32>>> = match rollout.spec.spaces.action {
        Space::Box { .. } => vec![vec![idle]],
        Space::Discrete { n } => {
            let one = (0..n).map(|first| vec![vec![first as f32]]);
            let two = (0..n * n).map(|pair| vec![vec![(pair / n) as f32], vec![(pair % n) as f32]]);
            one.chain(two).collect()
        }
    };
    for seed in 0..SEEDS {
        let mut is_reached = false;
        for way in &ways {
            rollout.reset(seed)?;
            let mut outcome = None;
            for action in way {
                outcome = Some(rollout.step(action)?);
            }
            is_reached = outcome.is_some_and(|outcome| outcome.in_reset_set && !outcome.irreversible);
            if is_reached {
                break;
            }
        }
        ensure(is_reached, || {
            format!("after a hard reset with seed {seed}, doing nothing is not in the reset set")
        })?;
    }
    let starts = rollout.environment.starts();
    let exceptions = if starts.is_empty() {
        String::new()
    } else {
        format!("; not asked of the named starts {}", starts.join(", "))
    };
    Ok(Passed(format!("{SEEDS} seeds{exceptions}")))
}

pub fn starts(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    let starts = rollout.environment.starts();
    for start in &starts {
        let reached = rollout.environment.reset_to(start, subject.seed, &mut rollout.observation);
        reached.map_err(|error| format!("its own start {start:?} cannot be reached: {error}"))?;
        let idle = rollout.idle();
        rollout.step(&idle)?;
    }
    let unknown = rollout.environment.reset_to("\u{1}no such start", 0, &mut rollout.observation);
    ensure(unknown.is_err(), || "a start that does not exist is reached without an error".into())?;
    Ok(Passed(if starts.is_empty() { "it has none".into() } else { starts.join(", ") }))
}

pub fn bad_actions(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    let mut undisturbed = Rollout::new(subject)?;
    rollout.record(10)?;
    undisturbed.record(10)?;
    let good = rollout.idle();
    let with_last = |value: f32| {
        let mut action = good.clone();
        if let Some(last) = action.last_mut() {
            *last = value;
        }
        action
    };
    let mut bad = vec![vec![], [good.as_slice(), &[0.0]].concat()];
    bad.extend([f32::NAN, f32::INFINITY, f32::NEG_INFINITY].map(with_last));
    if let Space::Discrete { n } = rollout.spec.spaces.action {
        bad.extend([-1.0, 0.5, n as f32].map(with_last));
    }
    for action in &bad {
        let stepped = rollout.environment.step(action, &mut rollout.observation);
        ensure(stepped.is_err(), || format!("the action {action:?} is executed"))?;
    }
    if !subject.is_deterministic {
        return Ok(Passed(format!("{} of them; that nothing changes cannot be told", bad.len())));
    }
    let after = rollout.record(STEPS)?;
    ensure_same(&undisturbed.record(STEPS)?, &after, "refused actions changed the state")?;
    Ok(Passed(format!("{} of them", bad.len())))
}

pub fn instances(subject: &Subject<'_>) -> Finding {
    if let Some(skipped) = unless_deterministic(subject) {
        return Ok(skipped);
    }
    const THREADS: usize = 4;
    let alone = Rollout::new(subject)?.record(STEPS)?;
    // The rest of a subject stays on its own thread.
    let (make, seed) = (subject.make, subject.seed);
    let together: Vec<Result<Vec<u32>, String>> = thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS)
            .map(|_| {
                thread::Builder::new().spawn_scoped(scope, move || {
                    let subject = Subject { make, seed, is_deterministic: true, allocations: None };
                    Rollout::new(&subject)?.record(STEPS)
                })
            })
            .collect();
        let refused = |error| format!("a thread cannot be started: {error}");
        let lost = |_| Err("a thread panicked".to_string());
        threads.into_iter().map(|thread| thread.map_err(refused)?.join().unwrap_or_else(lost)).collect()
    });
    for other in together {
        ensure_same(&alone, &other?, "beside others it does something else than alone")?;
    }
    // Threads may miss each other; turns cannot.
    let (mut one, mut other) = (Rollout::new(subject)?, Rollout::new(subject)?);
    let mut in_turn = Vec::new();
    for _ in 0..STEPS {
        in_turn.extend(one.record(1)?);
        other.record(1)?;
    }
    ensure_same(&alone, &in_turn, "taking turns with another it does something else than alone")?;
    Ok(Passed(format!("{THREADS} at once")))
}

pub fn picture(subject: &Subject<'_>) -> Finding {
    let mut rollout = Rollout::new(subject)?;
    let mut undrawn = Rollout::new(subject)?;
    rollout.record(1)?;
    undrawn.record(1)?;
    let [width, height] = rollout.environment.frame_size();
    let (mut first, mut second) = (vec![0; 3 * width * height], vec![1; 3 * width * height]);
    let draw = |rollout: &mut Rollout, pixels: &mut [u8]| {
        let mut frame = Frame::new(width, height, pixels)?;
        rollout.environment.render(&mut frame)
    };
    if let Err(error) = draw(&mut rollout, &mut first) {
        return Ok(Skipped(error.message().into()));
    }
    let drawn = draw(&mut rollout, &mut second);
    drawn.map_err(|error| format!("the second picture of a state fails: {error}"))?;
    ensure(first == second, || "two pictures of one state differ".into())?;
    ensure(first.iter().any(|byte| *byte != first[0]), || "the picture is empty".into())?;
    if subject.is_deterministic {
        let after = rollout.record(STEPS)?;
        ensure_same(&undrawn.record(STEPS)?, &after, "drawing changed what follows")?;
    }
    Ok(Passed(format!("{width} × {height} pixels")))
}

pub fn allocations(subject: &Subject<'_>) -> Finding {
    let Some(count) = subject.allocations else {
        return Ok(Skipped("this program does not count allocations; the project's tests do".into()));
    };
    let mut rollout = Rollout::new(subject)?;
    rollout.record(20)?;
    let mut total = 0;
    for _ in 0..STEPS {
        let action = rollout.act()?;
        let mut stepped = None;
        total += count(&mut || stepped = Some(rollout.environment.step(&action, &mut rollout.observation)));
        let outcome = stepped.ok_or("the counter did not run the step")?;
        if outcome.map_err(|error| error.to_string())?.terminated {
            rollout.reset(subject.seed)?;
        }
    }
    ensure(total == 0, || format!("{total} allocations in {STEPS} steps"))?;
    Ok(Passed(format!("{STEPS} steps")))
}

/// Bytes of this process in main memory, where the system tells.
fn resident_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kilobytes| kilobytes * 1024)
}

pub fn memory(subject: &Subject<'_>) -> Finding {
    leaves_no_memory(&|| Rollout::new(subject)?.advance().map(|_| ()))
}

/// Whether lives of instances, each made, used and ended by `live`, leave memory behind.
///
/// # Errors
/// A sentence that says how much; what `live` says.
pub fn leaves_no_memory(live: &dyn Fn() -> Result<(), String>) -> Finding {
    const INSTANCES: u64 = 1_000;
    /// Of one instance; the allocator's own habits cost about a tenth of it.
    const ALLOWED: u64 = 4 * 1024;
    let cycle = |count: u64| (0..count).try_for_each(|_| live());
    // What is kept once and for all, and the allocator's reserves, are there after these.
    cycle(INSTANCES / 5)?;
    let mut grown = 0;
    // A leak shows in every round; pages that the system hands out at another moment do so in one.
    for _ in 0..2 {
        let Some(before) = resident_bytes() else {
            return Ok(Skipped("this system does not tell how much memory a process has".into()));
        };
        cycle(INSTANCES)?;
        grown = resident_bytes().unwrap_or(before).saturating_sub(before);
        if grown <= INSTANCES * ALLOWED {
            break;
        }
    }
    ensure(grown <= INSTANCES * ALLOWED, || {
        format!("{} bytes stay behind for each of {INSTANCES} instances", grown / INSTANCES)
    })?;
    Ok(Passed(format!("{INSTANCES} instances, {} KB more than before", grown / 1024)))
}
