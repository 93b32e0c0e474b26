//! What is called of each kind, and with what.

use shield_api::{
    AbortRule, ActMode, Checkpoint, Environment, Learner, ObservedDecision, Phase, Reason, ResetTask,
    Result as ApiResult, Rows, RuleContext, SuccessCritic,
};

use super::{
    Settings,
    meter::{Meter, Next},
};
use crate::plugin_check::{Candidate, Draw, DrawnBatch};

const REASON_BYTES: usize = 256;
/// Actions of an environment: they come round again and again.
const ACTIONS: usize = 256;

type Done = Result<(), String>;

/// Nothing has to be prepared.
fn at_once<S>(_: &mut S) -> ApiResult<()> {
    Ok(())
}

/// Measures `create`; gives an instance.
fn create<T: ?Sized>(
    meter: &mut Meter<'_>,
    make: &dyn Fn() -> Result<Box<T>, String>,
) -> Result<Box<T>, String> {
    struct Lives<'a, T: ?Sized> {
        make: &'a dyn Fn() -> Result<Box<T>, String>,
        last: Option<Box<T>>,
    }
    let mut lives = Lives { make, last: Some(make()?) };
    let end = |lives: &mut Lives<'_, T>| {
        lives.last = None;
        Ok(())
    };
    meter.measure("create", &mut lives, end, |lives| {
        lives.last = Some((lives.make)().map_err(shield_api::Error::failed)?);
        Ok(Next::Prepare)
    })?;
    make()
}

/// `save` and `load`, where the plugin offers them.
fn save_and_load<T: Checkpoint + ?Sized>(meter: &mut Meter<'_>, plugin: &mut T) -> Done {
    struct Kept<'a, T: ?Sized> {
        plugin: &'a mut T,
        bytes: Vec<u8>,
    }
    let mut kept = Kept { plugin, bytes: Vec::new() };
    meter.measure("save", &mut kept, at_once, |Kept { plugin, bytes }| {
        bytes.clear();
        plugin.save(bytes).map(|()| Next::Again)
    })?;
    meter.measure("load", &mut kept, at_once, |Kept { plugin, bytes }| {
        plugin.load(bytes).map(|()| Next::Again)
    })
}

struct World {
    environment: Box<dyn Environment>,
    observation: Vec<f32>,
    actions: Vec<Vec<f32>>,
    episode_length: usize,
    steps: usize,
    left: usize,
    seed: u64,
}

impl World {
    fn reset(&mut self) -> ApiResult<()> {
        self.seed = self.seed.wrapping_add(1);
        self.left = self.episode_length;
        self.environment.reset(self.seed, &mut self.observation)
    }

    fn step(&mut self) -> ApiResult<Next> {
        self.steps += 1;
        let action = &self.actions[self.steps % ACTIONS];
        let outcome = self.environment.step(action, &mut self.observation)?;
        self.left = self.left.saturating_sub(1);
        Ok(if outcome.terminated || self.left == 0 { Next::Prepare } else { Next::Again })
    }
}

pub(super) fn environment(candidate: &Candidate<'_>, meter: &mut Meter<'_>) -> Done {
    let environment = create(meter, &|| candidate.environment())?;
    let spec = environment.spec();
    let mut draw = Draw::new(&spec.spaces, candidate.seed);
    let mut world = World {
        environment,
        observation: vec![0.0; spec.spaces.observation_len()],
        actions: (0..ACTIONS).map(|_| draw.action()).collect(),
        episode_length: spec.episode_length,
        steps: 0,
        left: 0,
        seed: candidate.seed,
    };
    meter.measure("reset", &mut world, at_once, |world| world.reset().map(|()| Next::Again))?;
    meter.measure("step", &mut world, World::reset, World::step)?;
    save_and_load(meter, &mut *world.environment)
}

/// Arguments and places that the other kinds share.
struct Asked<T: ?Sized> {
    plugin: Box<T>,
    observation: Vec<f32>,
    next_observation: Vec<f32>,
    action: Vec<f32>,
    place: Vec<f32>,
    values: Vec<f32>,
    probabilities: Vec<f32>,
    gradients: Vec<f32>,
}

impl Asked<dyn AbortRule> {
    fn context(&self) -> RuleContext<'_> {
        RuleContext {
            step: 1,
            observation: &self.observation,
            proposed: &self.action,
            previous: Some(&self.action),
            values: &self.values,
            greedy_values: &self.values,
            forward_values: &self.values,
            probabilities: &self.probabilities,
            greedy_probabilities: &self.probabilities,
            start_probabilities: &self.probabilities,
            discount: 0.99,
            phase: Phase::Forward,
        }
    }
}

/// Takes rows and keeps none.
struct Dropped;

impl Rows for Dropped {
    fn push(&mut self, _coefficients: &[f32], _bound: f32) -> ApiResult<()> {
        Ok(())
    }
}

/// The bench of every kind but the environment.
pub(super) struct Bench<'a, 'b> {
    pub(super) candidate: &'a Candidate<'b>,
    pub(super) settings: &'a Settings,
    pub(super) draw: Draw,
    pub(super) meter: Meter<'a>,
}

impl Bench<'_, '_> {
    fn asked<T: ?Sized>(&mut self, plugin: Box<T>, members: usize) -> Asked<T> {
        let width = self.draw.spaces.action_len();
        Asked {
            plugin,
            observation: self.draw.observation(),
            next_observation: self.draw.observation(),
            action: self.draw.action(),
            place: vec![0.0; width],
            values: self.draw.values(members),
            probabilities: self.draw.probabilities(members),
            gradients: self.draw.values(members * width),
        }
    }

    pub(super) fn learner(&mut self) -> Done {
        struct Taught {
            asked: Asked<dyn Learner>,
            batch: DrawnBatch,
        }
        let (candidate, spaces) = (self.candidate, self.draw.spaces.clone());
        let learner = create(&mut self.meter, &|| candidate.learner(&spaces, candidate.seed, 1))?;
        let members = learner.info().members;
        let batch = self.draw.batch(self.settings.batch, members);
        let mut taught = Taught { asked: self.asked(learner, members), batch };
        let meter = &mut self.meter;
        meter.measure("act, exploring", &mut taught, at_once, |Taught { asked, .. }| {
            asked.plugin.act(&asked.observation, ActMode::Explore, &mut asked.place).map(|()| Next::Again)
        })?;
        meter.measure("act, greedy", &mut taught, at_once, |Taught { asked, .. }| {
            asked.plugin.act(&asked.observation, ActMode::Greedy, &mut asked.place).map(|()| Next::Again)
        })?;
        meter.measure("q_values", &mut taught, at_once, |Taught { asked, .. }| {
            asked.plugin.q_values(&asked.observation, &asked.action, &mut asked.values).map(|()| Next::Again)
        })?;
        meter.measure("q_gradients", &mut taught, at_once, |Taught { asked, .. }| {
            let Asked { plugin, observation, action, values, gradients, .. } = asked;
            plugin.q_gradients(observation, action, values, gradients).map(|()| Next::Again)
        })?;
        meter.measure("update", &mut taught, at_once, |Taught { asked, batch }| {
            asked.plugin.update(&batch.view()).map(|()| Next::Again)
        })?;
        save_and_load(meter, &mut *taught.asked.plugin)
    }

    pub(super) fn success_critic(&mut self) -> Done {
        struct Taught {
            asked: Asked<dyn SuccessCritic>,
            batch: DrawnBatch,
        }
        let (candidate, spaces) = (self.candidate, self.draw.spaces.clone());
        let critic = create(&mut self.meter, &|| candidate.success_critic(&spaces, candidate.seed, 1))?;
        let members = critic.info().members;
        let batch = self.draw.batch(self.settings.batch, members);
        let mut taught = Taught { asked: self.asked(critic, members), batch };
        let meter = &mut self.meter;
        meter.measure("probabilities", &mut taught, at_once, |Taught { asked, .. }| {
            let Asked { plugin, observation, action, values, .. } = asked;
            plugin.probabilities(observation, action, values).map(|()| Next::Again)
        })?;
        meter.measure("gradients", &mut taught, at_once, |Taught { asked, .. }| {
            let Asked { plugin, observation, action, values, gradients, .. } = asked;
            plugin.gradients(observation, action, values, gradients).map(|()| Next::Again)
        })?;
        meter.measure("update", &mut taught, at_once, |Taught { asked, batch }| {
            asked.plugin.update(&batch.attempts()).map(|()| Next::Again)
        })?;
        save_and_load(meter, &mut *taught.asked.plugin)
    }

    pub(super) fn policy(&mut self) -> Done {
        let (candidate, spaces) = (self.candidate, self.draw.spaces.clone());
        let policy = create(&mut self.meter, &|| candidate.policy(&spaces, candidate.seed, 1))?;
        let mut asked = self.asked(policy, 0);
        self.meter.measure("act", &mut asked, at_once, |asked| {
            asked.plugin.act(&asked.observation, &mut asked.place).map(|()| Next::Again)
        })?;
        save_and_load(&mut self.meter, &mut *asked.plugin)
    }

    pub(super) fn abort_rule(&mut self) -> Done {
        let (candidate, spaces) = (self.candidate, self.draw.spaces.clone());
        let rule = create(&mut self.meter, &|| candidate.abort_rule(&spaces, candidate.seed, 1))?;
        let mut asked = self.asked(rule, self.settings.members);
        let meter = &mut self.meter;
        meter.measure("evaluate", &mut asked, at_once, |asked| {
            let mut room = [0; REASON_BYTES];
            asked.plugin.evaluate(&asked.context(), &mut Reason::new(&mut room)).map(|_| Next::Again)
        })?;
        meter.measure("linearise", &mut asked, at_once, |asked| {
            asked.plugin.linearise(&asked.context(), &asked.gradients, &mut Dropped).map(|()| Next::Again)
        })?;
        meter.measure("observe", &mut asked, at_once, |Asked { plugin, action, .. }| {
            plugin.observe(&ObservedDecision { step: 1, aborted: false, action }).map(|()| Next::Again)
        })?;
        save_and_load(meter, &mut *asked.plugin)
    }

    pub(super) fn reset_task(&mut self) -> Done {
        let (candidate, spaces) = (self.candidate, self.draw.spaces.clone());
        let task = create(&mut self.meter, &|| candidate.reset_task(&spaces, candidate.seed, 1))?;
        let mut asked: Asked<dyn ResetTask> = self.asked(task, 0);
        let meter = &mut self.meter;
        // A task may need a start before it can value anything.
        meter.measure("observe_start", &mut asked, at_once, |asked| {
            asked.plugin.observe_start(&asked.observation).map(|()| Next::Again)
        })?;
        meter.measure("evaluate", &mut asked, at_once, |asked| {
            let Asked { plugin, observation, action, next_observation, .. } = asked;
            plugin.evaluate(observation, action, next_observation).map(|_| Next::Again)
        })?;
        save_and_load(meter, &mut *asked.plugin)
    }
}
