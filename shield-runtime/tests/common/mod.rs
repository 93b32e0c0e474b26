//! A small world and scripted agents, so that each test can say what happens at every step.
#![allow(dead_code, clippy::unwrap_used, reason = "part of tests, each of which uses some of it")]

pub mod critic;

use std::{
    sync::{Arc, Mutex, atomic::AtomicBool},
    time::Duration,
};

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{
    AbortRule, ActMode, Batch, Checkpoint, Environment, EnvironmentSpec, Error, Learner, LearnerInfo, Needs,
    Policy, Reason, ResetKind, Result, RuleContext, RuleVerdict, Space, Spaces, StepOutcome,
};
use shield_runtime::{
    agent::{Agent, ForwardAgent},
    critic::Critic,
    cycle::{CycleParts, CycleSettings, Memory},
    evaluation::Evaluator,
    events::{Counters, EpisodeEvent, EvaluationEvent, Intervention},
    experience::{AgentRole, Experience},
    experiment::{Mode, ProjectionConfig, RecordConfig},
    joint_loop::{JointLoop, LoopParts, LoopSettings},
    observer::{Observer, Scene as Stage},
    shield::{Ladder, LadderSettings},
    world::World,
};

pub const EPISODE: usize = 6;
/// The cell from which nothing leads back.
pub const PIT: i32 = 4;

pub fn spaces() -> Spaces {
    Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) }
}

/// A line of cells: a positive action leads right, any other left, never below 0; at `PIT` it stays. Reset means cell 0.
pub struct Line {
    pub cell: i32,
    pub terminates_at: Option<i32>,
    /// Kinds of hard resets with their costs; the second is one from the pit.
    pub kinds: Vec<(&'static str, f64)>,
    /// Everything that was executed: (cell before, action).
    pub log: Arc<Mutex<Vec<(i32, f32)>>>,
    pub resets: Arc<Mutex<Vec<Option<String>>>>,
}

impl Line {
    pub fn new() -> Self {
        Self { cell: 0, terminates_at: None, kinds: Vec::new(), log: Arc::default(), resets: Arc::default() }
    }
}

impl Checkpoint for Line {}

impl Environment for Line {
    fn spec(&self) -> EnvironmentSpec {
        EnvironmentSpec { spaces: spaces(), episode_length: EPISODE, brings_reset_reward: true }
    }

    fn reset(&mut self, _seed: u64, observation: &mut [f32]) -> Result<()> {
        self.resets.lock().unwrap().push(None);
        self.cell = 0;
        observation[0] = 0.0;
        Ok(())
    }

    fn starts(&self) -> Vec<String> {
        vec!["far".into()]
    }

    fn reset_to(&mut self, start: &str, _seed: u64, observation: &mut [f32]) -> Result<()> {
        self.resets.lock().unwrap().push(Some(start.into()));
        self.cell = 3;
        observation[0] = 3.0;
        Ok(())
    }

    fn reset_kinds(&self) -> Vec<ResetKind> {
        self.kinds.iter().map(|(name, cost)| ResetKind { name: (*name).into(), cost: *cost }).collect()
    }

    fn reset_kind(&self) -> Result<usize> {
        Ok(usize::from(self.cell == PIT))
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        shield_api::check_finite("action", action, 1)?;
        self.log.lock().unwrap().push((self.cell, action[0]));
        if self.cell != PIT {
            self.cell = (self.cell + if action[0] > 0.0 { 1 } else { -1 }).max(0);
        }
        observation[0] = self.cell as f32;
        Ok(StepOutcome {
            forward_reward: self.cell as f32,
            reset_reward: f32::from(u8::from(self.cell == 0)),
            in_reset_set: self.cell == 0,
            terminated: self.terminates_at == Some(self.cell),
            success: self.cell == 3,
            irreversible: self.cell == PIT,
        })
    }
}

type Act = Box<dyn FnMut(f32, ActMode) -> f32 + Send>;
type Value = Box<dyn FnMut(f32, f32) -> Vec<f32> + Send>;
type Update = Box<dyn FnMut() -> Result<()> + Send>;

/// What an update saw: reward, continuation and mask of each row.
pub type Seen = Arc<Mutex<Vec<(f32, f32, f32)>>>;

pub struct Scripted {
    pub members: usize,
    pub act: Act,
    pub value: Value,
    pub update: Update,
    pub seen: Seen,
}

impl Scripted {
    pub fn acting(act: impl FnMut(f32, ActMode) -> f32 + Send + 'static) -> Self {
        Self {
            members: 1,
            act: Box::new(act),
            value: Box::new(|_, _| vec![1.0]),
            update: Box::new(|| Ok(())),
            seen: Seen::default(),
        }
    }

    pub fn valuing(
        mut self,
        members: usize,
        value: impl FnMut(f32, f32) -> Vec<f32> + Send + 'static,
    ) -> Self {
        self.members = members;
        self.value = Box::new(value);
        self
    }

    pub fn updating(mut self, update: impl FnMut() -> Result<()> + Send + 'static) -> Self {
        self.update = Box::new(update);
        self
    }
}

impl Checkpoint for Scripted {}

impl Learner for Scripted {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: self.members, discount: 0.9 }
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        action[0] = (self.act)(observation[0], mode);
        if action[0] == f32::NEG_INFINITY { Err(Error::failed("no action today")) } else { Ok(()) }
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        let found = (self.value)(observation[0], action[0]);
        if found.is_empty() {
            return Err(Error::failed("no values today"));
        }
        values.copy_from_slice(&found);
        Ok(())
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        for row in 0..batch.size {
            let members = self.members;
            let mask = batch.masks[row * members..(row + 1) * members].iter().sum();
            self.seen.lock().unwrap().push((batch.rewards[row], batch.continuations[row], mask));
        }
        (self.update)()
    }
}

impl Policy for Scripted {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        Learner::act(self, observation, ActMode::Greedy, action)
    }
}

type Judge = Box<dyn Fn(&RuleContext<'_>) -> Result<RuleVerdict> + Send>;

/// A rule that is a closure.
pub struct Rule {
    pub needs: Needs,
    pub judge: Judge,
}

impl Rule {
    pub fn judging(
        judge: impl Fn(&RuleContext<'_>) -> Result<RuleVerdict> + Send + 'static,
    ) -> Box<dyn AbortRule> {
        Box::new(Self { needs: Needs { values: true, ..Needs::default() }, judge: Box::new(judge) })
    }

    /// Rejects what the smallest value puts below the threshold.
    pub fn below(threshold: f32) -> Box<dyn AbortRule> {
        Self::judging(move |context| {
            let value = context.values.iter().copied().fold(f32::INFINITY, f32::min);
            Ok(RuleVerdict::from_safe(value >= threshold, value))
        })
    }
}

impl Checkpoint for Rule {}

impl AbortRule for Rule {
    fn needs(&self) -> Needs {
        self.needs
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        use std::fmt::Write;
        let verdict = (self.judge)(context)?;
        write!(reason, "the rule compared {}", verdict.score).unwrap();
        Ok(verdict)
    }
}

pub fn shield(rules: Vec<Box<dyn AbortRule>>, reset_agent: &dyn Learner, warm_up_steps: u64) -> Ladder {
    let settings = LadderSettings { spaces: spaces(), warm_up_steps, fallback_action: vec![-0.25] };
    Ladder::new(rules, reset_agent, settings).unwrap()
}

/// Keeps everything that the loop reports.
#[derive(Default)]
pub struct Notebook {
    pub episodes: Vec<EpisodeEvent>,
    /// Step, proposed, executed, cause, reason.
    pub interventions: Vec<(u64, f32, Option<f32>, String, String)>,
    pub evaluations: Vec<EvaluationEvent>,
}

impl Observer for Notebook {
    fn on_episode(&mut self, episode: &EpisodeEvent, _counters: &Counters) -> anyhow::Result<()> {
        self.episodes.push(*episode);
        Ok(())
    }

    fn on_intervention(&mut self, intervention: &Intervention<'_>, _: &mut Stage<'_>) -> anyhow::Result<()> {
        self.interventions.push((
            intervention.step,
            intervention.proposed[0],
            intervention.executed.map(|action| action[0]),
            intervention.abort.cause.to_string(),
            intervention.reason.to_string(),
        ));
        Ok(())
    }

    fn on_evaluation(&mut self, evaluation: &EvaluationEvent, _: &Counters) -> anyhow::Result<()> {
        self.evaluations.push(*evaluation);
        Ok(())
    }
}

/// A run to be described: defaults first, then what a test changes.
pub struct Scene {
    pub settings: LoopSettings,
    pub line: Line,
    pub forward: Option<ForwardAgent>,
    pub reset: Option<Scripted>,
    pub success: Option<Critic>,
    pub rules: Vec<Box<dyn AbortRule>>,
    pub warm_up_steps: u64,
    pub projection: Option<ProjectionConfig>,
    pub deadline: Option<Duration>,
    pub evaluator: Option<Evaluator>,
    pub bootstrap_probability: f64,
    /// Transitions that the memory holds: 1, so that every update sees exactly the step before it.
    pub capacity: usize,
}

pub fn settings(steps: u64) -> LoopSettings {
    LoopSettings {
        calibration_resets: 0,
        cycle: CycleSettings::default(),
        steps,
        record: RecordConfig::default(),
        evaluate_every: None,
        checkpoint_every: None,
    }
}

pub fn forward_learner(learner: Scripted) -> Option<ForwardAgent> {
    Some(ForwardAgent::Learner(Box::new(agent(AgentRole::Forward, learner))))
}

pub fn agent(role: AgentRole, learner: Scripted) -> Agent {
    Agent::new(role, Box::new(learner), 1, &spaces(), Pcg64::seed_from_u64(1))
}

impl Scene {
    /// Forward always goes right, reset always left, the rule rejects values below 0.5 (all are 1).
    pub fn new(steps: u64) -> Self {
        Self {
            settings: settings(steps),
            line: Line::new(),
            forward: forward_learner(Scripted::acting(|_, _| 1.0)),
            reset: Some(Scripted::acting(|_, _| -1.0)),
            success: None,
            rules: vec![Rule::below(0.5)],
            warm_up_steps: 0,
            projection: None,
            deadline: None,
            evaluator: None,
            bootstrap_probability: 1.0,
            capacity: 1,
        }
    }

    pub fn run(self) -> (Counters, Notebook) {
        let mut notebook = Notebook::default();
        let counters = self.run_with(&mut notebook).unwrap();
        (counters, notebook)
    }

    /// Batches have one row.
    pub fn run_with(self, observer: &mut dyn Observer) -> anyhow::Result<Counters> {
        let stop = AtomicBool::new(false);
        let members = [
            self.forward.as_ref().map_or(0, ForwardAgent::members),
            self.reset.as_ref().map_or(0, |reset| reset.members),
        ];
        let shield = self
            .reset
            .as_ref()
            .filter(|_| self.settings.cycle.mode == Mode::Shielded)
            .map(|reset| shield(self.rules, reset, self.warm_up_steps));
        let shield = shield.map(|shield| match &self.success {
            Some(critic) => shield.with_success_critic(critic.info()),
            None => shield,
        });
        let shield = shield.map(|shield| match self.projection {
            Some(projection) => shield.with_projection(projection).unwrap(),
            None => shield,
        });
        let shield = shield.map(|shield| match self.deadline {
            Some(deadline) => shield.with_deadline(deadline),
            None => shield,
        });
        let experience = Experience::new(self.capacity, &spaces(), members, self.bootstrap_probability);
        let mut experience = experience.unwrap();
        if self.success.is_some() {
            experience = experience.with_undo(critic::ALIKE).unwrap();
        }
        let memory = Memory { experience, masks: Pcg64::seed_from_u64(3) };
        let agents = CycleParts {
            forward: self.forward,
            reset: self.reset.map(|reset| agent(AgentRole::Reset, reset)),
            success: self.success,
            ladder: shield,
            memory: Some(memory),
        };
        let world = World::new(Box::new(self.line), None).unwrap();
        let (settings, evaluator, resets) = (self.settings, self.evaluator, Pcg64::seed_from_u64(2));
        let parts = LoopParts { settings, world, agents, evaluator, resets };
        let mut joint = JointLoop::new(parts, observer, &stop);
        joint.run()?;
        Ok(*joint.counters())
    }
}
