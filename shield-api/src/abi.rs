//! The binary interface: tables of functions that C can fill as well as Rust.
//!
//! Everything here is `#[repr(C)]`, derives `StableAbi`, and is frozen for all of 1.x. Authors in Rust never see it: they
//! implement the traits at the crate's root. Data is owned by the caller and borrowed for the call; nothing is allocated across
//! the line and no ownership moves. Status codes are integers with named constants, so that an unknown one is an error and
//! not undefined behaviour.

use std::ffi::c_void;

use abi_stable::{StableAbi, library::RootModule, package_version_strings, sabi_types::VersionStrings};

use crate::LogLevel;

/// Major version of the tables; a library of another major version is refused.
pub const ABI_MAJOR: u32 = 1;
/// Minor version of the tables: grows with look-ups by name, never with fields.
pub const ABI_MINOR: u32 = 1;
/// Both, as the manifest writes them.
pub const ABI_VERSION: &str = "1.1";
/// The symbol that every library exports for readers of C: a function returning `*const PluginLibrary`.
pub const ENTRY_SYMBOL: &str = "shield_plugin_entry_v1";
/// Extension of an environment: [`StartsTable`].
pub const EXTENSION_STARTS: &str = "shield.environment.starts/1";
/// Extension of an environment: [`CostsTable`].
pub const EXTENSION_COSTS: &str = "shield.environment.costs/1";
/// Extension of an environment: [`RenderTable`].
pub const EXTENSION_RENDER: &str = "shield.environment.render/1";
/// Extension of a learner: [`WeightsTable`].
pub const EXTENSION_WEIGHTS: &str = "shield.learner.weights/1";
/// Extension of a success critic, which must have it: [`SuccessCriticTable`].
pub const EXTENSION_SUCCESS_CRITIC: &str = "shield.success_critic/1";
/// Extension of an abort rule that needs undo probabilities, or learns from attempts: [`UndoRuleTable`].
pub const EXTENSION_UNDO_RULE: &str = "shield.abort_rule.undo/1";

/// What a call returns: one of the constants in [`status`].
pub type Status = i32;

/// The statuses. A number that is not listed counts as [`FAILED`](status::FAILED).
pub mod status {
    /// The call did what it should.
    pub const OK: i32 = 0;
    /// An argument is wrong; nothing has changed.
    pub const INVALID_ARGUMENT: i32 = 1;
    /// The configuration is wrong.
    pub const INVALID_CONFIG: i32 = 2;
    /// The plugin does not offer this.
    pub const UNSUPPORTED: i32 = 3;
    /// The plugin tried and failed.
    pub const FAILED: i32 = 4;
    /// The plugin panicked; the instance must only be destroyed.
    pub const PANICKED: i32 = 5;
}

/// The kinds of plugin, as `PluginDescriptor::kind`.
pub mod kind {
    /// An environment.
    pub const ENVIRONMENT: u32 = 1;
    /// A learner.
    pub const LEARNER: u32 = 2;
    /// A policy.
    pub const POLICY: u32 = 3;
    /// An abort rule.
    pub const ABORT_RULE: u32 = 4;
    /// A reset task.
    pub const RESET_TASK: u32 = 5;
    /// A success critic (since 1.1). It sets the table of a learner, whose values are probabilities and which neither acts nor updates, and
    /// has the extension [`SuccessCriticTable`](super::SuccessCriticTable).
    pub const SUCCESS_CRITIC: u32 = 6;
}

/// The kinds of space, as `SpaceView::kind`.
pub mod space_kind {
    /// No space is given.
    pub const NONE: u32 = 0;
    /// A vector with bounds.
    pub const BOX: u32 = 1;
    /// One of `length` alternatives.
    pub const DISCRETE: u32 = 2;
}

/// Bits of [`StepView::flags`].
pub mod step_flag {
    /// The new state is in S_reset.
    pub const IN_RESET_SET: u32 = 1;
    /// The environment cannot go on.
    pub const TERMINATED: u32 = 2;
    /// The task is achieved.
    pub const SUCCESS: u32 = 4;
    /// Ground truth: the state cannot be undone.
    pub const IRREVERSIBLE: u32 = 8;
}

/// Bits of the answer of [`AbortRuleTable::needs`]: what is computed before the rule is asked.
pub mod need {
    /// The reset ensemble's values of the proposed action.
    pub const VALUES: u32 = 1;
    /// The reset ensemble's values of the reset agent's greedy action.
    pub const GREEDY_VALUES: u32 = 2;
    /// The forward ensemble's values of the proposed action.
    pub const FORWARD_VALUES: u32 = 4;
    /// The success critic's estimates for the proposed action (since 1.1; takes the extension [`UndoRuleTable`](super::UndoRuleTable)).
    pub const PROBABILITIES: u32 = 8;
    /// The same for the reset agent's greedy action, here and at the start (since 1.1; takes the same extension).
    pub const GREEDY_PROBABILITIES: u32 = 16;
    /// The same, but here only once the rule has rejected the action: it is asked without them first, and then again (since 1.1).
    pub const GREEDY_ON_REJECTION: u32 = 32;
}

/// The verdicts in [`VerdictView::verdict`]; 0 and every other number reject.
pub mod verdict {
    /// The action may be executed.
    pub const ALLOW: u32 = 1;
    /// The action must not be executed.
    pub const REJECT: u32 = 2;
}

/// Whose action a rule judges, as [`RuleContextView::phase`].
pub mod phase {
    /// The forward agent's.
    pub const FORWARD: u32 = 1;
    /// The reset agent's.
    pub const RESET: u32 = 2;
}

/// The modes of [`LearnerTable::act`].
pub mod act_mode {
    /// With exploration noise.
    pub const EXPLORE: u32 = 1;
    /// The best known action.
    pub const GREEDY: u32 = 2;
}

/// An instance of a plugin: only its own library knows what is behind the pointer.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct Instance {
    _opaque: u8,
}

/// Borrowed UTF-8 text, not terminated.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct Text {
    /// First byte; may be null if `length` is 0.
    pub pointer: *const u8,
    /// How many bytes.
    pub length: usize,
}

/// Borrowed numbers.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct Floats {
    /// First value; may be null if `length` is 0.
    pub pointer: *const f32,
    /// How many values.
    pub length: usize,
}

/// A place in a configuration text, from 1; a line of 0 means that it is not known.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, StableAbi)]
pub struct PositionView {
    /// Line, from 1.
    pub line: u32,
    /// Column, from 1.
    pub column: u32,
}

/// A space; the bounds belong to whoever gives it.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct SpaceView {
    /// One of [`space_kind`].
    pub kind: u32,
    /// Dimensions of a box, or alternatives.
    pub length: u32,
    /// `length` lower bounds of a box, else null.
    pub low: *const f32,
    /// `length` upper bounds of a box, else null.
    pub high: *const f32,
}

/// The host's services. Valid as long as the instance lives.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct HostTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Writes a line of the given level (1 error, 2 warning, 3 information, 4 debugging).
    pub log: unsafe extern "C" fn(level: u32, message: Text),
    /// Reports a figure.
    pub metric: unsafe extern "C" fn(name: Text, value: f64),
    /// A table of further services by name; null where this host has none of that name. `host` is this table.
    pub get_extension: unsafe extern "C" fn(host: *const HostTable, name: Text) -> *const c_void,
}

/// Arguments of [`LifeTable::create`].
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct CreateArguments {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// The plugin's configuration: RON text, verbatim from the experiment. Empty means the defaults.
    pub config: Text,
    /// Seed of everything random.
    pub seed: u64,
    /// Threads that may be used.
    pub threads: u32,
    /// The observation space; of kind `NONE` for an environment.
    pub observation_space: SpaceView,
    /// The action space; of kind `NONE` for an environment.
    pub action_space: SpaceView,
    /// The host's services; may be null.
    pub host: *const HostTable,
}

/// Takes the bytes of a saved state.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct Writer {
    /// Given back to `write`.
    pub context: *mut c_void,
    /// Appends bytes; returns a [`status`].
    pub write: unsafe extern "C" fn(context: *mut c_void, bytes: *const u8, length: usize) -> i32,
}

/// Takes the rows of a linearised rule.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct RowSink {
    /// Given back to `push`.
    pub context: *mut c_void,
    /// Adds the row `coefficients · a ≤ bound`; returns a [`status`].
    pub push: unsafe extern "C" fn(
        context: *mut c_void,
        coefficients: *const f32,
        length: usize,
        bound: f32,
    ) -> i32,
}

/// What every kind shares.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct LifeTable {
    /// Makes an instance and stores it; on an error stores nothing.
    pub create: unsafe extern "C" fn(arguments: *const CreateArguments, instance: *mut *mut Instance) -> i32,
    /// Ends an instance. Null is allowed.
    pub destroy: unsafe extern "C" fn(instance: *mut Instance),
    /// Writes the state in one or more pieces.
    pub save: unsafe extern "C" fn(instance: *mut Instance, writer: *const Writer) -> i32,
    /// Restores a state.
    pub load: unsafe extern "C" fn(instance: *mut Instance, bytes: *const u8, length: usize) -> i32,
    /// Copies the message of the instance's last failure (of this thread's last failed `create`, if null) into `buffer`, at
    /// most `capacity` bytes, and its position if `position` is not null; returns the message's full length.
    pub last_error: unsafe extern "C" fn(
        instance: *mut Instance,
        buffer: *mut u8,
        capacity: usize,
        position: *mut PositionView,
    ) -> usize,
    /// A table of further abilities by name, such as `shield.environment.starts/1`; null if there is none.
    pub get_extension: unsafe extern "C" fn(name: Text) -> *const c_void,
}

/// What [`EnvironmentTable::spec`] fills. The bounds are valid until the instance's next call.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct SpecView {
    /// Size of this struct in bytes, set by the host.
    pub struct_size: usize,
    /// What the agents see.
    pub observation_space: SpaceView,
    /// What the agents do.
    pub action_space: SpaceView,
    /// The most steps of an episode.
    pub episode_length: u32,
    /// 1 if reset reward and reset set mean something.
    pub brings_reset_reward: u32,
}

/// What a step led to.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, StableAbi)]
pub struct StepView {
    /// Reward of the task.
    pub forward_reward: f32,
    /// Reward of undoing it.
    pub reset_reward: f32,
    /// Bits of [`step_flag`].
    pub flags: u32,
}

/// An environment.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct EnvironmentTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// What every kind shares; `save` and `load` keep the full state of the world.
    pub life: LifeTable,
    /// Describes the environment.
    pub spec: unsafe extern "C" fn(instance: *mut Instance, spec: *mut SpecView) -> i32,
    /// Hard reset.
    pub reset:
        unsafe extern "C" fn(instance: *mut Instance, seed: u64, observation: *mut f32, length: usize) -> i32,
    /// Executes an action.
    pub step: unsafe extern "C" fn(
        instance: *mut Instance,
        action: Floats,
        observation: *mut f32,
        length: usize,
        outcome: *mut StepView,
    ) -> i32,
}

/// Extension of environments: initial states with names.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct StartsTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Copies the name with the given index into `buffer`; returns its full length, 0 if there is no such index.
    pub name: unsafe extern "C" fn(
        instance: *mut Instance,
        index: usize,
        buffer: *mut u8,
        capacity: usize,
    ) -> usize,
    /// Hard reset to a named start.
    pub reset_to: unsafe extern "C" fn(
        instance: *mut Instance,
        start: Text,
        seed: u64,
        observation: *mut f32,
        length: usize,
    ) -> i32,
}

/// Extension of environments: kinds of hard resets, and what they cost.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct CostsTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Copies the name of the kind with the given index into `buffer` and stores its cost; returns the name's full length, 0 if there is
    /// no such index.
    pub kind: unsafe extern "C" fn(
        instance: *mut Instance,
        index: usize,
        buffer: *mut u8,
        capacity: usize,
        cost: *mut f64,
    ) -> usize,
    /// Stores the index of the kind that a hard reset from the present state would be.
    pub present: unsafe extern "C" fn(instance: *mut Instance, index: *mut usize) -> i32,
}

/// Extension of learners: what they learned, for other programs. Either may answer `UNSUPPORTED`.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct WeightsTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Writes the weights, a file in the format safetensors.
    pub weights: unsafe extern "C" fn(instance: *mut Instance, writer: *const Writer) -> i32,
    /// Writes the greedy policy, a model in ONNX: one observation in, one action in the units of its space out.
    pub policy: unsafe extern "C" fn(instance: *mut Instance, writer: *const Writer) -> i32,
}

/// Extension of environments: pictures of the present state.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct RenderTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Stores the width and height in pixels of a picture that suits.
    pub size: unsafe extern "C" fn(instance: *mut Instance, width: *mut u32, height: *mut u32) -> i32,
    /// Draws the present state, and changes nothing. `pixels` holds `length` = `3 × width × height` bytes: rows from the top, pixels
    /// from the left, red, green, blue. `shades` is empty, or holds for each observation of a discrete space a figure from 0 to 1 to
    /// shade its place by, NaN for none; whoever cannot shows none.
    pub render: unsafe extern "C" fn(
        instance: *mut Instance,
        width: u32,
        height: u32,
        shades: Floats,
        pixels: *mut u8,
        length: usize,
    ) -> i32,
}

/// What [`LearnerTable::info`] fills.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, StableAbi)]
pub struct LearnerInfoView {
    /// Size of the ensemble.
    pub members: u32,
    /// γ.
    pub discount: f32,
}

/// A batch of transitions, row by row.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct BatchView {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// How many transitions.
    pub size: usize,
    /// States, `size × observation length`.
    pub observations: Floats,
    /// Executed actions, `size × action length`.
    pub actions: Floats,
    /// The agent's rewards, `size`.
    pub rewards: Floats,
    /// States that followed, `size × observation length`.
    pub next_observations: Floats,
    /// 1 where the next state's value counts, 0 where the transition ends; `size`.
    pub continuations: Floats,
    /// 1 where the member learns from the transition, else 0; `size × members`.
    pub masks: Floats,
}

/// A learner.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct LearnerTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// What every kind shares.
    pub life: LifeTable,
    /// Describes the learner.
    pub info: unsafe extern "C" fn(instance: *mut Instance, info: *mut LearnerInfoView) -> i32,
    /// Chooses an action; `mode` is one of [`act_mode`].
    pub act: unsafe extern "C" fn(
        instance: *mut Instance,
        observation: Floats,
        mode: u32,
        action: *mut f32,
        length: usize,
    ) -> i32,
    /// One value per member.
    pub q_values: unsafe extern "C" fn(
        instance: *mut Instance,
        observation: Floats,
        action: Floats,
        values: *mut f32,
        members: usize,
    ) -> i32,
    /// One value and one gradient per member; `gradients` holds `members × action length`.
    pub q_gradients: unsafe extern "C" fn(
        instance: *mut Instance,
        observation: Floats,
        action: Floats,
        values: *mut f32,
        members: usize,
        gradients: *mut f32,
        gradients_length: usize,
    ) -> i32,
    /// Learns from a batch.
    pub update: unsafe extern "C" fn(instance: *mut Instance, batch: *const BatchView) -> i32,
}

/// A policy.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct PolicyTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// What every kind shares.
    pub life: LifeTable,
    /// Chooses an action.
    pub act: unsafe extern "C" fn(
        instance: *mut Instance,
        observation: Floats,
        action: *mut f32,
        length: usize,
    ) -> i32,
}

/// What a rule may look at; see [`crate::RuleContext`].
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct RuleContextView {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Environment steps so far.
    pub step: u64,
    /// The state.
    pub observation: Floats,
    /// The proposed action.
    pub proposed: Floats,
    /// The action executed before; null and empty after a hard reset.
    pub previous: Floats,
    /// The reset ensemble's values at the proposed action.
    pub values: Floats,
    /// The same at the reset agent's greedy action.
    pub greedy_values: Floats,
    /// The forward ensemble's values.
    pub forward_values: Floats,
    /// γ of the reset agent.
    pub discount: f32,
    /// One of [`phase`].
    pub phase: u32,
}

/// What [`AbortRuleTable::evaluate`] fills. The buffer for the reason is the host's.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct VerdictView {
    /// One of [`verdict`].
    pub verdict: u32,
    /// The figure that was compared.
    pub score: f32,
    /// Where the reason goes.
    pub reason: *mut u8,
    /// Room for it, in bytes.
    pub reason_capacity: usize,
    /// How many bytes were written.
    pub reason_length: usize,
}

/// What became of a decision; see [`crate::ObservedDecision`].
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct ObservedDecisionView {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Environment steps so far.
    pub step: u64,
    /// The action that will be executed.
    pub action: Floats,
    /// 1 if the proposed action was aborted.
    pub aborted: u32,
}

/// An abort rule.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct AbortRuleTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// What every kind shares.
    pub life: LifeTable,
    /// Stores bits of [`need`].
    pub needs: unsafe extern "C" fn(instance: *mut Instance, needs: *mut u32) -> i32,
    /// Judges an action.
    pub evaluate: unsafe extern "C" fn(
        instance: *mut Instance,
        context: *const RuleContextView,
        verdict: *mut VerdictView,
    ) -> i32,
    /// Gives the rule as rows; `gradients` holds `members × action length`, row by row.
    pub linearise: unsafe extern "C" fn(
        instance: *mut Instance,
        context: *const RuleContextView,
        gradients: Floats,
        rows: *const RowSink,
    ) -> i32,
    /// Learns what became of the decision.
    pub observe: unsafe extern "C" fn(instance: *mut Instance, decision: *const ObservedDecisionView) -> i32,
}

/// A batch of transitions with what became of the attempts, row by row; see [`crate::AttemptBatch`].
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct AttemptBatchView {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// How many transitions.
    pub size: usize,
    /// States, `size × observation length`.
    pub observations: Floats,
    /// Executed actions, `size × action length`.
    pub actions: Floats,
    /// States that followed, `size × observation length`.
    pub next_observations: Floats,
    /// What the reset agent does in them, `size × action length`.
    pub next_actions: Floats,
    /// 1 where the next state lies in the reset set, `size`.
    pub successes: Floats,
    /// 1 where the next state's estimate counts, 0 where nothing follows; `size`.
    pub continuations: Floats,
    /// 1 if the attempt reached the reset set, else 0; `size`.
    pub outcomes: Floats,
    /// How much the outcome counts, 0 to 1; `size`.
    pub outcome_weights: Floats,
    /// 1 where the member learns from the transition, else 0; `size × members`.
    pub masks: Floats,
}

/// Extension of success critics: how they learn.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct SuccessCriticTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Learns from a batch.
    pub update: unsafe extern "C" fn(instance: *mut Instance, batch: *const AttemptBatchView) -> i32,
}

/// Undo probabilities beside a [`RuleContextView`], one per member of the success critic; empty where the rule needs none.
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct UndoView {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Of the proposed action.
    pub probabilities: Floats,
    /// Of the reset agent's greedy action.
    pub greedy_probabilities: Floats,
    /// Of the reset agent's greedy action in the state in which the last reset ended.
    pub start_probabilities: Floats,
}

/// How an attempt to reset ended; see [`crate::ObservedAttempt`].
#[repr(C)]
#[derive(Debug, Clone, Copy, StableAbi)]
pub struct ObservedAttemptView {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Environment steps so far.
    pub step: u64,
    /// 1 if the reset set was reached.
    pub succeeded: u32,
}

/// Extension of abort rules: the functions of [`AbortRuleTable`] with undo probabilities, which the host calls instead of them, and what
/// became of attempts.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct UndoRuleTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// Judges an action.
    pub evaluate: unsafe extern "C" fn(
        instance: *mut Instance,
        context: *const RuleContextView,
        undo: *const UndoView,
        verdict: *mut VerdictView,
    ) -> i32,
    /// Gives the rule as rows; `gradients` are those of the probabilities where the rule needs them, else of the values.
    pub linearise: unsafe extern "C" fn(
        instance: *mut Instance,
        context: *const RuleContextView,
        undo: *const UndoView,
        gradients: Floats,
        rows: *const RowSink,
    ) -> i32,
    /// Learns how an attempt ended.
    pub observe_attempt:
        unsafe extern "C" fn(instance: *mut Instance, attempt: *const ObservedAttemptView) -> i32,
}

/// What [`ResetTaskTable::evaluate`] fills.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, StableAbi)]
pub struct ResetSignalView {
    /// Reset reward.
    pub reward: f32,
    /// 1 if the next state is in S_reset.
    pub in_reset_set: u32,
}

/// A reset task.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct ResetTaskTable {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// What every kind shares.
    pub life: LifeTable,
    /// Values a transition.
    pub evaluate: unsafe extern "C" fn(
        instance: *mut Instance,
        observation: Floats,
        action: Floats,
        next_observation: Floats,
        signal: *mut ResetSignalView,
    ) -> i32,
    /// The observation after a hard reset.
    pub observe_start: unsafe extern "C" fn(instance: *mut Instance, observation: Floats) -> i32,
}

/// One plugin of a library. Exactly the table that `kind` names is set; the others are null.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct PluginDescriptor {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// One of [`kind`].
    pub kind: u32,
    /// The manifest's text, the same as in the file's section.
    pub manifest: Text,
    /// Set for an environment.
    pub environment: *const EnvironmentTable,
    /// Set for a learner.
    pub learner: *const LearnerTable,
    /// Set for a policy.
    pub policy: *const PolicyTable,
    /// Set for an abort rule.
    pub abort_rule: *const AbortRuleTable,
    /// Set for a reset task.
    pub reset_task: *const ResetTaskTable,
}

/// What a library exports: a list of plugins.
#[repr(C)]
#[derive(Debug, StableAbi)]
pub struct PluginLibrary {
    /// Size of this struct in bytes.
    pub struct_size: usize,
    /// [`ABI_MAJOR`] of the header or crate that the library was built with.
    pub abi_major: u32,
    /// [`ABI_MINOR`] of the same.
    pub abi_minor: u32,
    /// How many plugins.
    pub plugin_count: usize,
    /// The first of them.
    pub plugins: *const PluginDescriptor,
}

// SAFETY: a descriptor points to constants of its library only, which are never written and never unloaded.
unsafe impl Sync for PluginDescriptor {}
// SAFETY: as above.
unsafe impl Sync for PluginLibrary {}

/// The root module of a Rust library: one field, the list that the C symbol gives too. `abi_stable` compares its layout,
/// and through it that of every table, before anything is called.
#[repr(C)]
#[derive(StableAbi)]
#[sabi(kind(Prefix(prefix_ref = PluginModuleRef)))]
#[sabi(missing_field(panic))]
pub struct PluginModule {
    /// The list of plugins.
    pub library: &'static PluginLibrary,
}

impl RootModule for PluginModuleRef {
    abi_stable::declare_root_module_statics! {PluginModuleRef}
    const BASE_NAME: &'static str = "shield_plugin";
    const NAME: &'static str = "shield_plugin";
    const VERSION_STRINGS: VersionStrings = package_version_strings!();
}

impl Text {
    /// Borrows a string.
    pub const fn new(text: &str) -> Self {
        Self { pointer: text.as_ptr(), length: text.len() }
    }

    /// Reads the text; what is not UTF-8 becomes an empty string.
    ///
    /// # Safety
    /// The pointer is null with length 0, or valid for `length` bytes as long as `'a`.
    pub unsafe fn as_str<'a>(self) -> &'a str {
        if self.pointer.is_null() {
            return "";
        }
        // SAFETY: the caller's promise.
        std::str::from_utf8(unsafe { std::slice::from_raw_parts(self.pointer, self.length) }).unwrap_or("")
    }
}

impl Floats {
    /// Borrows a slice.
    pub const fn new(values: &[f32]) -> Self {
        Self { pointer: values.as_ptr(), length: values.len() }
    }

    /// No values.
    pub const fn none() -> Self {
        Self { pointer: std::ptr::null(), length: 0 }
    }

    /// Reads the values.
    ///
    /// # Safety
    /// The pointer is null with length 0, or valid for `length` values as long as `'a`.
    pub unsafe fn as_slice<'a>(self) -> &'a [f32] {
        if self.pointer.is_null() {
            return &[];
        }
        // SAFETY: the caller's promise.
        unsafe { std::slice::from_raw_parts(self.pointer, self.length) }
    }
}

impl HostTable {
    pub(crate) fn call_log(&self, level: LogLevel, message: &str) {
        // SAFETY: the text lives for the call, and the host's functions accept any text.
        unsafe { (self.log)(level as u32 + 1, Text::new(message)) }
    }

    pub(crate) fn call_metric(&self, name: &str, value: f64) {
        // SAFETY: the text lives for the call, and the host's functions accept any text.
        unsafe { (self.metric)(Text::new(name), value) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_text_matches_the_version_numbers() {
        assert_eq!(ABI_VERSION, format!("{ABI_MAJOR}.{ABI_MINOR}"));
    }
}
