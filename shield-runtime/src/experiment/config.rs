//! What an experiment says, field by field. Defaults cite their source.

use indexmap::IndexMap;
use ron::value::RawValue;
use serde::{Deserialize, Deserializer, Serialize, Serializer, ser::SerializeStructVariant};

use crate::plugin::{Kind, Selection};

/// A whole experiment: one environment, two agents, a shield, several seeds and variants.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Names the folder of the runs.
    pub name: String,
    /// Environment steps of a run, both phases together.
    pub steps: u64,
    /// One run per seed.
    pub seeds: Vec<u64>,
    /// Who acts, and when the world is reset.
    #[serde(default)]
    pub mode: Mode,
    /// The world.
    pub environment: PluginChoice,
    /// The agent or policy that does the task.
    pub forward: Forward,
    /// The learner that undoes it. Needed by `Shielded` and `ResetOnly`.
    #[serde(default)]
    pub reset: Option<PluginChoice>,
    /// What must not happen.
    #[serde(default)]
    pub shield: ShieldConfig,
    /// Replaces the environment's own reset reward and reset set.
    #[serde(default)]
    pub reset_task: Option<PluginChoice>,
    /// The transitions that both agents share, and what they learn from them.
    #[serde(default)]
    pub experience: ExperienceConfig,
    /// Greedy episodes in a second instance of the environment, at fixed intervals.
    #[serde(default)]
    pub evaluation: Option<EvaluationConfig>,
    /// Keeping the state of a run, so that it can be continued and its agents be used. `None`: nothing is kept.
    #[serde(default = "usual_checkpoints")]
    pub checkpoint: Option<CheckpointConfig>,
    /// What is kept of the shield's decisions.
    #[serde(default)]
    pub record: RecordConfig,
    /// What one hard reset costs, or a factor to the costs that the environment names; the summary's `hard_reset_cost` is the sum.
    #[serde(default = "one")]
    pub hard_reset_cost: f64,
    /// Threads that one run may use. Results do not depend on it.
    #[serde(default = "one_thread")]
    pub threads: usize,
    /// SHA-256 by plugin id; another file is refused before anything of it is executed. `shield plugin lock` writes them.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub pins: IndexMap<String, String>,
    /// Named lists of overrides, `"name": [("path.to.field", value)]`. Without any, there is one variant, `default`.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub variants: IndexMap<String, Vec<(String, Box<RawValue>)>>,
}

impl Experiment {
    /// Every plugin that the experiment names: the path of its field, such as `shield.rules[0]`, its kind, and the choice.
    pub fn plugins(&self) -> Vec<(String, Kind, &PluginChoice)> {
        let mut found = vec![("environment".to_owned(), Kind::Environment, &self.environment)];
        found.push(match &self.forward {
            Forward::Learner(choice) => ("forward".into(), Kind::Learner, choice),
            Forward::Policy(choice) => ("forward".into(), Kind::Policy, choice),
        });
        found.extend(self.reset.iter().map(|choice| ("reset".into(), Kind::Learner, choice)));
        let mut rules = Vec::new();
        RuleConfig::collect(&self.shield.rules, "shield.rules", &mut rules);
        found.extend(rules.into_iter().map(|(path, choice)| (path, Kind::AbortRule, choice)));
        found.extend(self.reset_task.iter().map(|choice| ("reset_task".into(), Kind::ResetTask, choice)));
        found
    }

    /// The rules in the order in which the shield counts them, whatever way they are composed.
    pub fn rules(&self) -> impl Iterator<Item = &PluginChoice> {
        let mut found = Vec::new();
        RuleConfig::collect(&self.shield.rules, "shield.rules", &mut found);
        found.into_iter().map(|(_, choice)| choice)
    }

    pub(super) fn plugins_mut(&mut self) -> impl Iterator<Item = &mut PluginChoice> {
        let (Forward::Learner(forward) | Forward::Policy(forward)) = &mut self.forward;
        [&mut self.environment, forward]
            .into_iter()
            .chain(&mut self.reset)
            .chain(self.shield.rules.iter_mut().flat_map(RuleConfig::plugins_mut))
            .chain(&mut self.reset_task)
    }
}

fn usual_checkpoints() -> Option<CheckpointConfig> {
    Some(CheckpointConfig::default())
}

pub(super) fn one() -> f64 {
    1.0
}

pub(super) fn one_thread() -> usize {
    1
}

/// When the state of a run is kept. At Ctrl-C and at its end it always is.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Environment steps between two checkpoints: what a run loses at most when it is killed.
    pub every: u64,
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { every: 10_000 }
    }
}

/// Who acts, and when the world is reset.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub enum Mode {
    /// The paper's method: both agents alternate, the shield decides, hard resets after failed attempts only.
    #[default]
    Shielded,
    /// The usual way: a counted hard reset after every forward episode; no reset agent, no shield.
    StatusQuo,
    /// Forward episodes without any reset.
    ForwardOnly,
    /// Only the reset agent acts and learns; every episode begins with a counted hard reset (the paper's "insert-only").
    ResetOnly {
        /// The named start of each episode; the environment's usual start if `None`.
        #[serde(default)]
        start: Option<String>,
    },
}

/// A plugin and its configuration.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PluginChoice {
    /// The plugin's id.
    pub plugin: String,
    /// A file to load it from, instead of the search path.
    #[serde(default)]
    pub path: Option<std::path::PathBuf>,
    /// RON text that only the plugin understands.
    #[serde(default = "empty_config", deserialize_with = "bare_config")]
    pub config: Box<RawValue>,
    /// In a process of its own, so that a crash, an exit or a hang in it is an error. For environments and policies.
    #[serde(default, skip_serializing_if = "is_default")]
    pub isolate: bool,
    /// How that process is treated.
    #[serde(default, skip_serializing_if = "is_default")]
    pub worker: WorkerConfig,
}

impl PluginChoice {
    /// What it names, whatever the experiment pins.
    pub fn selection(&self) -> Selection {
        Selection { path: self.path.clone(), ..Selection::new(&self.plugin) }
    }
}

/// How the process of an isolated plugin is treated.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorkerConfig {
    /// What follows when it dies or gives no answer, or the plugin panics.
    pub on_failure: OnWorkerFailure,
    /// How long the plugin may take to be made, in seconds.
    pub start_timeout_s: f64,
    /// How long any later call may take, in seconds.
    pub step_timeout_s: f64,
}

impl Default for WorkerConfig {
    fn default() -> Self {
        Self { on_failure: OnWorkerFailure::Error, start_timeout_s: 60.0, step_timeout_s: 10.0 }
    }
}

/// What follows the failure of an isolated plugin's process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub enum OnWorkerFailure {
    /// The run ends with the reason.
    Error,
    /// A new process takes its place. An environment's episode ends there, and a counted hard reset follows; a policy is asked again.
    Restart,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Without the comments around it, so that the text begins where the value does: the positions that a plugin reports count from there.
fn bare_config<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Box<RawValue>, D::Error> {
    Box::<RawValue>::deserialize(deserializer).map(RawValue::trim_boxed)
}

fn empty_config() -> Box<RawValue> {
    RawValue::from_boxed_ron("()".into()).expect("() is RON")
}

/// Who does the task.
#[derive(Debug, Clone, Deserialize, Serialize)]
pub enum Forward {
    /// An agent that learns.
    Learner(PluginChoice),
    /// A finished policy.
    Policy(PluginChoice),
}

impl Forward {
    /// The plugin behind it.
    pub fn choice(&self) -> &PluginChoice {
        match self {
            Self::Learner(choice) | Self::Policy(choice) => choice,
        }
    }
}

/// The shield, and what follows its decisions.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShieldConfig {
    /// An action is executed only if every rule allows it.
    pub rules: Vec<RuleConfig>,
    /// What is tried with a rejected action before it is aborted. `None`: nothing, as in the paper.
    pub projection: Option<ProjectionConfig>,
    /// A decision that takes longer, in microseconds of a monotonic clock, is an abort. It makes a run non-deterministic.
    pub deadline_us: Option<u64>,
    /// N of the paper: failed reset episodes in a row before a hard reset. Paper, appendix C: 1.
    pub reset_attempts: ResetAttempts,
    /// Which states of a reset episode count for its success.
    pub reset_test: ResetTest,
    /// What lies between two attempts.
    pub between_attempts: BetweenAttempts,
    /// A reset episode ends as soon as the reset set is reached.
    pub stop_on_reset: bool,
    /// Steps at the beginning during which nothing is aborted: untrained values would abort everything for ever.
    pub warm_up_steps: u64,
    /// The rules judge the reset agent's exploratory actions too; a rejected one is replaced by its greedy action.
    pub shield_exploration: bool,
    /// What the forward agent learns from an abort.
    pub on_abort: OnAbort,
    /// What a caller's buffer holds after an abort where the reset agent's action is not usable. `None`: the action of the space
    /// that is nearest to zero.
    pub fallback_action: Option<Vec<f32>>,
}

impl Default for ShieldConfig {
    fn default() -> Self {
        Self {
            rules: Vec::new(),
            projection: None,
            deadline_us: None,
            reset_attempts: ResetAttempts::After(1),
            reset_test: ResetTest::default(),
            between_attempts: BetweenAttempts::default(),
            stop_on_reset: true,
            warm_up_steps: 1_000,
            shield_exploration: false,
            on_abort: OnAbort::default(),
            fallback_action: None,
        }
    }
}

/// What the forward agent learns from an abort.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize, Serialize)]
pub enum OnAbort {
    /// Nothing, as in the paper: the rejected action was never executed, and the step before it bootstraps.
    #[default]
    Nothing,
    /// The rejected action ends its task: a transition from which nothing more is to be had.
    Truncate,
    /// The same, and its reward is −x.
    Penalise(f32),
}

impl OnAbort {
    /// The reward of a rejected action, which is the last of its episode; `None` if it is not learned from.
    pub fn reward(self) -> Option<f32> {
        match self {
            Self::Nothing => None,
            Self::Truncate => Some(0.0),
            Self::Penalise(penalty) => Some(-penalty),
        }
    }
}

/// A rule, or several composed.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum RuleConfig {
    /// One rule; written without this name, `(plugin: …)`.
    Rule(PluginChoice),
    /// One rule whose rows a projection may exceed. It judges what was found as strictly as any.
    Soft {
        /// What an excess of s costs: priority · s² / 2, where moving the action by d costs d² / 2.
        priority: f32,
        /// The rule.
        rule: PluginChoice,
    },
    /// Every one must allow the action.
    All(Vec<RuleConfig>),
    /// One is enough.
    Any(Vec<RuleConfig>),
}

impl RuleConfig {
    /// The plugins of a list of rules, in the order in which the shield counts them, with the path of each.
    pub(super) fn collect<'a>(rules: &'a [Self], path: &str, found: &mut Vec<(String, &'a PluginChoice)>) {
        for (index, rule) in rules.iter().enumerate() {
            let path = format!("{path}[{index}]");
            match rule {
                Self::Rule(choice) => found.push((path, choice)),
                Self::Soft { rule, .. } => found.push((format!("{path}.rule"), rule)),
                Self::All(parts) | Self::Any(parts) => Self::collect(parts, &path, found),
            }
        }
    }

    fn plugins_mut(&mut self) -> Vec<&mut PluginChoice> {
        match self {
            Self::Rule(choice) | Self::Soft { rule: choice, .. } => vec![choice],
            Self::All(parts) | Self::Any(parts) => parts.iter_mut().flat_map(Self::plugins_mut).collect(),
        }
    }
}

/// A single rule is written without its name, as it may be read.
impl Serialize for RuleConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        const NAME: &str = "RuleConfig";
        match self {
            Self::Rule(choice) => choice.serialize(serializer),
            Self::Soft { priority, rule } => {
                let mut soft = serializer.serialize_struct_variant(NAME, 1, "Soft", 2)?;
                soft.serialize_field("priority", priority)?;
                soft.serialize_field("rule", rule)?;
                soft.end()
            }
            Self::All(parts) => serializer.serialize_newtype_variant(NAME, 2, "All", parts),
            Self::Any(parts) => serializer.serialize_newtype_variant(NAME, 3, "Any", parts),
        }
    }
}

/// What is tried with an action that a rule rejects, before it is aborted.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub enum ProjectionConfig {
    /// The nearest action that keeps the rules' linear rows, by a quadratic program.
    Qp(QpConfig),
    /// The reset agent's greedy action, for one step.
    Replace,
    /// Of discrete actions, the allowed one of the highest forward value.
    Best,
}

/// How the nearest allowed action is looked for.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct QpConfig {
    /// By how much each row `A a ≤ b` is tightened, in the unit of its rule: for values, reset value above the threshold.
    pub margin: f32,
    /// How often the rules may be linearised in one decision.
    pub max_iterations: u32,
    /// How far each dimension may move from the proposed action, as a share of half its range. `None`: as far as the space goes.
    pub trust_region: Option<f32>,
    /// What moving each dimension costs: distance² = Σ weight · movement². `None`: 1 each.
    pub weights: Option<Vec<f32>>,
}

impl Default for QpConfig {
    fn default() -> Self {
        Self { margin: 0.0, max_iterations: 3, trust_region: None, weights: None }
    }
}

/// N, the number of failed reset episodes in a row after which a hard reset follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(untagged, expecting = "expected a number of attempts or `Unlimited`")]
pub enum ResetAttempts {
    /// A hard reset after that many failures.
    After(u32),
    /// `Unlimited`: never a hard reset.
    Never(Unlimited),
}

impl ResetAttempts {
    /// N, or `None` where there is no limit.
    pub fn limit(self) -> Option<u32> {
        match self {
            Self::After(limit) => Some(limit),
            Self::Never(_) => None,
        }
    }
}

/// The word `Unlimited`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub enum Unlimited {
    /// No limit.
    Unlimited,
}

/// When a reset episode has succeeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum ResetTest {
    /// Some state that it visited is in the reset set (§4.2).
    #[default]
    AnyVisited,
    /// Its final state is in the reset set (Algorithm 1).
    FinalState,
}

impl ResetTest {
    /// Of an episode that has visited the reset set or not, and is there now or not.
    pub fn is_passed(self, has_visited: bool, is_there: bool) -> bool {
        match self {
            Self::AnyVisited => has_visited,
            Self::FinalState => is_there,
        }
    }
}

/// What lies between two attempts to reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum BetweenAttempts {
    /// A forward episode (Algorithm 1).
    #[default]
    Forward,
    /// Nothing: the reset agent tries again at once.
    Reset,
}

/// The experience and what is learned from it.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExperienceConfig {
    /// How many transitions are kept; the oldest are overwritten.
    pub capacity: usize,
    /// Transitions per update. Lillicrap et al. 2015: 64.
    pub batch: usize,
    /// Updates after each environment step, of each agent that learns.
    pub updates_per_step: usize,
    /// Who learns after a step.
    pub updates: Updates,
    /// Probability that an ensemble member learns from a transition (Osband et al. 2016); 1 gives every member everything.
    pub bootstrap_probability: f64,
    /// Whether reaching the reset set ends the reset agent's task.
    pub on_reset_success: OnResetSuccess,
    /// Whether a failed reset episode ends it.
    pub on_reset_failure: OnResetFailure,
    /// How much of a hard reset's cost the reset agent loses in the reward of the step before it.
    pub cost_weight: f32,
}

impl Default for ExperienceConfig {
    fn default() -> Self {
        Self {
            capacity: 1_000_000,
            batch: 64,
            updates_per_step: 1,
            updates: Updates::default(),
            bootstrap_probability: 1.0,
            on_reset_success: OnResetSuccess::default(),
            on_reset_failure: OnResetFailure::default(),
            cost_weight: 0.0,
        }
    }
}

impl ExperienceConfig {
    /// The two endings of the reset agent's task.
    pub fn endings(&self) -> Endings {
        Endings { on_success: self.on_reset_success, on_failure: self.on_reset_failure }
    }
}

/// How reset episodes end for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Endings {
    /// In the reset set.
    pub on_success: OnResetSuccess,
    /// At the end of a failed reset episode.
    pub on_failure: OnResetFailure,
}

impl Endings {
    /// Whether the value of the state after a step counts for the reset agent. `has_failed`: it was the last step of a failed reset episode.
    pub fn reset_continues(self, in_reset_set: bool, terminated: bool, has_failed: bool) -> bool {
        let is_done = in_reset_set && self.on_success == OnResetSuccess::Terminal;
        let is_lost = has_failed && self.on_failure == OnResetFailure::Zero;
        !terminated && !is_done && !is_lost
    }
}

/// Who learns after a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum Updates {
    /// The agent in charge (Algorithm 1).
    #[default]
    Active,
    /// Both agents, from the shared experience.
    Both,
}

/// What the reset set means for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum OnResetSuccess {
    /// The task ends there: with a reset reward of 1 in the reset set and 0 elsewhere, the value is the probability to get there.
    Terminal,
    /// It goes on: values lie in [0, 1/(1 − γ)), as the paper's robots have it.
    #[default]
    Bootstrap,
}

/// What the last step of a failed reset episode means for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum OnResetFailure {
    /// The value beyond it is 0, so that irreversible states do not live on their own estimate.
    Zero,
    /// A time-out like any other.
    #[default]
    Bootstrap,
}

/// What is kept of the shield's decisions, to explain and replay them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordConfig {
    /// The decisions of every n-th step are recorded, and every rejection; 0: none at all.
    pub decisions: u64,
    /// With the forward decision of every n-th step, the environment's state; 0: never.
    pub states_every: u64,
}

impl RecordConfig {
    /// Whether the decision at `step` is recorded.
    pub fn takes(&self, step: u64, is_rejection: bool) -> bool {
        self.decisions > 0 && (is_rejection || step.is_multiple_of(self.decisions) || self.takes_state(step))
    }

    /// Whether the state at `step` is.
    pub fn takes_state(&self, step: u64) -> bool {
        self.states_every > 0 && step.is_multiple_of(self.states_every)
    }
}

impl Default for RecordConfig {
    fn default() -> Self {
        Self { decisions: 1, states_every: 0 }
    }
}

/// Evaluation at fixed intervals; its steps do not count.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Steps between two evaluations.
    pub every: u64,
    /// Episodes of one evaluation.
    #[serde(default = "ten")]
    pub episodes: u32,
    /// Who is evaluated.
    #[serde(default)]
    pub agent: EvaluatedAgent,
    /// The named start of each episode; the usual one if `None`.
    #[serde(default)]
    pub start: Option<String>,
    /// Whether the shield stands between the agent and the world.
    #[serde(default)]
    pub shielded: bool,
    /// An evaluation has succeeded if at least this share of its episodes did; three in a row solve the task.
    #[serde(default = "one")]
    pub solved_at: f64,
}

fn ten() -> u32 {
    10
}

/// Who is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum EvaluatedAgent {
    /// The forward agent or policy.
    #[default]
    Forward,
    /// The reset agent; returns are reset rewards, and success is reaching the reset set.
    Reset,
}
