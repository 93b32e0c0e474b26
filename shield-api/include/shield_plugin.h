// The interface of plugins of the shield, for C, C++ and whatever speaks C.
//
// A library fills one table of functions per plugin, lists its plugins in a `ShieldPluginLibrary`, returns that list from
// `shield_plugin_entry_v1`, and places the manifest of each with `SHIELD_MANIFEST`. `shield plugin new --lang c` writes a
// complete one. Rules for every function: data is borrowed for the call; nothing is freed by the other side; no exception
// and no longjmp leaves it; an instance is called by one thread at a time. Text is UTF-8 and not terminated by 0.

#ifndef SHIELD_PLUGIN_H
#define SHIELD_PLUGIN_H

// Made by `cargo xtask header` from shield-api/src/abi.rs; edit that file instead.

#include <stddef.h>
#include <stdint.h>
// Major version of the tables; a library of another major version is refused.
#define SHIELD_ABI_MAJOR 1
// Minor version of the tables: grows with look-ups by name, never with fields.
#define SHIELD_ABI_MINOR 1
// Both, as the manifest writes them.
#define SHIELD_ABI_VERSION "1.1"
// The symbol that every library exports for readers of C: a function returning `*const PluginLibrary`.
#define SHIELD_ENTRY_SYMBOL "shield_plugin_entry_v1"
// Extension of an environment: `StartsTable`.
#define SHIELD_EXTENSION_STARTS "shield.environment.starts/1"
// Extension of an environment: `CostsTable`.
#define SHIELD_EXTENSION_COSTS "shield.environment.costs/1"
// Extension of an environment: `RenderTable`.
#define SHIELD_EXTENSION_RENDER "shield.environment.render/1"
// Extension of a learner: `WeightsTable`.
#define SHIELD_EXTENSION_WEIGHTS "shield.learner.weights/1"
// Extension of a success critic, which must have it: `SuccessCriticTable`.
#define SHIELD_EXTENSION_SUCCESS_CRITIC "shield.success_critic/1"
// Extension of an abort rule that needs undo probabilities, or learns from attempts: `UndoRuleTable`.
#define SHIELD_EXTENSION_UNDO_RULE "shield.abort_rule.undo/1"

// The statuses. A number that is not listed counts as `FAILED`(status::FAILED).
// The call did what it should.
#define SHIELD_STATUS_OK 0
// An argument is wrong; nothing has changed.
#define SHIELD_STATUS_INVALID_ARGUMENT 1
// The configuration is wrong.
#define SHIELD_STATUS_INVALID_CONFIG 2
// The plugin does not offer this.
#define SHIELD_STATUS_UNSUPPORTED 3
// The plugin tried and failed.
#define SHIELD_STATUS_FAILED 4
// The plugin panicked; the instance must only be destroyed.
#define SHIELD_STATUS_PANICKED 5

// The kinds of plugin, as `PluginDescriptor::kind`.
// An environment.
#define SHIELD_KIND_ENVIRONMENT 1
// A learner.
#define SHIELD_KIND_LEARNER 2
// A policy.
#define SHIELD_KIND_POLICY 3
// An abort rule.
#define SHIELD_KIND_ABORT_RULE 4
// A reset task.
#define SHIELD_KIND_RESET_TASK 5
// A success critic (since 1.1). It sets the table of a learner, whose values are probabilities and which neither acts nor updates, and
// has the extension `SuccessCriticTable`(super::SuccessCriticTable).
#define SHIELD_KIND_SUCCESS_CRITIC 6

// The kinds of space, as `SpaceView::kind`.
// No space is given.
#define SHIELD_SPACE_KIND_NONE 0
// A vector with bounds.
#define SHIELD_SPACE_KIND_BOX 1
// One of `length` alternatives.
#define SHIELD_SPACE_KIND_DISCRETE 2

// Bits of `StepView::flags`.
// The new state is in S_reset.
#define SHIELD_STEP_FLAG_IN_RESET_SET 1
// The environment cannot go on.
#define SHIELD_STEP_FLAG_TERMINATED 2
// The task is achieved.
#define SHIELD_STEP_FLAG_SUCCESS 4
// Ground truth: the state cannot be undone.
#define SHIELD_STEP_FLAG_IRREVERSIBLE 8

// Bits of the answer of `AbortRuleTable::needs`: what is computed before the rule is asked.
// The reset ensemble's values of the proposed action.
#define SHIELD_NEED_VALUES 1
// The reset ensemble's values of the reset agent's greedy action.
#define SHIELD_NEED_GREEDY_VALUES 2
// The forward ensemble's values of the proposed action.
#define SHIELD_NEED_FORWARD_VALUES 4
// The success critic's estimates for the proposed action (since 1.1; takes the extension `UndoRuleTable`(super::UndoRuleTable)).
#define SHIELD_NEED_PROBABILITIES 8
// The same for the reset agent's greedy action, here and at the start (since 1.1; takes the same extension).
#define SHIELD_NEED_GREEDY_PROBABILITIES 16
// The same, but here only once the rule has rejected the action: it is asked without them first, and then again (since 1.1).
#define SHIELD_NEED_GREEDY_ON_REJECTION 32

// The verdicts in `VerdictView::verdict`; 0 and every other number reject.
// The action may be executed.
#define SHIELD_VERDICT_ALLOW 1
// The action must not be executed.
#define SHIELD_VERDICT_REJECT 2

// Whose action a rule judges, as `RuleContextView::phase`.
// The forward agent's.
#define SHIELD_PHASE_FORWARD 1
// The reset agent's.
#define SHIELD_PHASE_RESET 2

// The modes of `LearnerTable::act`.
// With exploration noise.
#define SHIELD_ACT_MODE_EXPLORE 1
// The best known action.
#define SHIELD_ACT_MODE_GREEDY 2

// An instance of a plugin: the library alone defines the struct.
typedef struct ShieldInstance ShieldInstance;


// Borrowed UTF-8 text, not terminated.
typedef struct ShieldText {
  // First byte; may be null if `length` is 0.
  const uint8_t *pointer;
  // How many bytes.
  size_t length;
} ShieldText;

// Borrowed numbers.
typedef struct ShieldFloats {
  // First value; may be null if `length` is 0.
  const float *pointer;
  // How many values.
  size_t length;
} ShieldFloats;

// A place in a configuration text, from 1; a line of 0 means that it is not known.
typedef struct ShieldPositionView {
  // Line, from 1.
  uint32_t line;
  // Column, from 1.
  uint32_t column;
} ShieldPositionView;

// A space; the bounds belong to whoever gives it.
typedef struct ShieldSpaceView {
  // One of `space_kind`.
  uint32_t kind;
  // Dimensions of a box, or alternatives.
  uint32_t length;
  // `length` lower bounds of a box, else null.
  const float *low;
  // `length` upper bounds of a box, else null.
  const float *high;
} ShieldSpaceView;

// The host's services. Valid as long as the instance lives.
typedef struct ShieldHostTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // Writes a line of the given level (1 error, 2 warning, 3 information, 4 debugging).
  void (*log)(uint32_t level, struct ShieldText message);
  // Reports a figure.
  void (*metric)(struct ShieldText name, double value);
  // A table of further services by name; null where this host has none of that name. `host` is this table.
  const void *(*get_extension)(const struct ShieldHostTable *host, struct ShieldText name);
} ShieldHostTable;

// Arguments of `LifeTable::create`.
typedef struct ShieldCreateArguments {
  // Size of this struct in bytes.
  size_t struct_size;
  // The plugin's configuration: RON text, verbatim from the experiment. Empty means the defaults.
  struct ShieldText config;
  // Seed of everything random.
  uint64_t seed;
  // Threads that may be used.
  uint32_t threads;
  // The observation space; of kind `NONE` for an environment.
  struct ShieldSpaceView observation_space;
  // The action space; of kind `NONE` for an environment.
  struct ShieldSpaceView action_space;
  // The host's services; may be null.
  const struct ShieldHostTable *host;
} ShieldCreateArguments;

// Takes the bytes of a saved state.
typedef struct ShieldWriter {
  // Given back to `write`.
  void *context;
  // Appends bytes; returns a `status`.
  int32_t (*write)(void *context, const uint8_t *bytes, size_t length);
} ShieldWriter;

// Takes the rows of a linearised rule.
typedef struct ShieldRowSink {
  // Given back to `push`.
  void *context;
  // Adds the row `coefficients · a ≤ bound`; returns a `status`.
  int32_t (*push)(void *context, const float *coefficients, size_t length, float bound);
} ShieldRowSink;

// What every kind shares.
typedef struct ShieldLifeTable {
  // Makes an instance and stores it; on an error stores nothing.
  int32_t (*create)(const struct ShieldCreateArguments *arguments, ShieldInstance **instance);
  // Ends an instance. Null is allowed.
  void (*destroy)(ShieldInstance *instance);
  // Writes the state in one or more pieces.
  int32_t (*save)(ShieldInstance *instance, const struct ShieldWriter *writer);
  // Restores a state.
  int32_t (*load)(ShieldInstance *instance, const uint8_t *bytes, size_t length);
  // Copies the message of the instance's last failure (of this thread's last failed `create`, if null) into `buffer`, at
  // most `capacity` bytes, and its position if `position` is not null; returns the message's full length.
  size_t (*last_error)(ShieldInstance *instance,
                       uint8_t *buffer,
                       size_t capacity,
                       struct ShieldPositionView *position);
  // A table of further abilities by name, such as `shield.environment.starts/1`; null if there is none.
  const void *(*get_extension)(struct ShieldText name);
} ShieldLifeTable;

// What `EnvironmentTable::spec` fills. The bounds are valid until the instance's next call.
typedef struct ShieldSpecView {
  // Size of this struct in bytes, set by the host.
  size_t struct_size;
  // What the agents see.
  struct ShieldSpaceView observation_space;
  // What the agents do.
  struct ShieldSpaceView action_space;
  // The most steps of an episode.
  uint32_t episode_length;
  // 1 if reset reward and reset set mean something.
  uint32_t brings_reset_reward;
} ShieldSpecView;

// What a step led to.
typedef struct ShieldStepView {
  // Reward of the task.
  float forward_reward;
  // Reward of undoing it.
  float reset_reward;
  // Bits of `step_flag`.
  uint32_t flags;
} ShieldStepView;

// An environment.
typedef struct ShieldEnvironmentTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // What every kind shares; `save` and `load` keep the full state of the world.
  struct ShieldLifeTable life;
  // Describes the environment.
  int32_t (*spec)(ShieldInstance *instance, struct ShieldSpecView *spec);
  // Hard reset.
  int32_t (*reset)(ShieldInstance *instance, uint64_t seed, float *observation, size_t length);
  // Executes an action.
  int32_t (*step)(ShieldInstance *instance,
                  struct ShieldFloats action,
                  float *observation,
                  size_t length,
                  struct ShieldStepView *outcome);
} ShieldEnvironmentTable;

// Extension of environments: initial states with names.
typedef struct ShieldStartsTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // Copies the name with the given index into `buffer`; returns its full length, 0 if there is no such index.
  size_t (*name)(ShieldInstance *instance, size_t index, uint8_t *buffer, size_t capacity);
  // Hard reset to a named start.
  int32_t (*reset_to)(ShieldInstance *instance,
                      struct ShieldText start,
                      uint64_t seed,
                      float *observation,
                      size_t length);
} ShieldStartsTable;

// Extension of environments: kinds of hard resets, and what they cost.
typedef struct ShieldCostsTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // Copies the name of the kind with the given index into `buffer` and stores its cost; returns the name's full length, 0 if there is
  // no such index.
  size_t (*kind)(ShieldInstance *instance,
                 size_t index,
                 uint8_t *buffer,
                 size_t capacity,
                 double *cost);
  // Stores the index of the kind that a hard reset from the present state would be.
  int32_t (*present)(ShieldInstance *instance, size_t *index);
} ShieldCostsTable;

// Extension of learners: what they learned, for other programs. Either may answer `UNSUPPORTED`.
typedef struct ShieldWeightsTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // Writes the weights, a file in the format safetensors.
  int32_t (*weights)(ShieldInstance *instance, const struct ShieldWriter *writer);
  // Writes the greedy policy, a model in ONNX: one observation in, one action in the units of its space out.
  int32_t (*policy)(ShieldInstance *instance, const struct ShieldWriter *writer);
} ShieldWeightsTable;

// Extension of environments: pictures of the present state.
typedef struct ShieldRenderTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // Stores the width and height in pixels of a picture that suits.
  int32_t (*size)(ShieldInstance *instance, uint32_t *width, uint32_t *height);
  // Draws the present state, and changes nothing. `pixels` holds `length` = `3 × width × height` bytes: rows from the top, pixels
  // from the left, red, green, blue. `shades` is empty, or holds for each observation of a discrete space a figure from 0 to 1 to
  // shade its place by, NaN for none; whoever cannot shows none.
  int32_t (*render)(ShieldInstance *instance,
                    uint32_t width,
                    uint32_t height,
                    struct ShieldFloats shades,
                    uint8_t *pixels,
                    size_t length);
} ShieldRenderTable;

// What `LearnerTable::info` fills.
typedef struct ShieldLearnerInfoView {
  // Size of the ensemble.
  uint32_t members;
  // γ.
  float discount;
} ShieldLearnerInfoView;

// A batch of transitions, row by row.
typedef struct ShieldBatchView {
  // Size of this struct in bytes.
  size_t struct_size;
  // How many transitions.
  size_t size;
  // States, `size × observation length`.
  struct ShieldFloats observations;
  // Executed actions, `size × action length`.
  struct ShieldFloats actions;
  // The agent's rewards, `size`.
  struct ShieldFloats rewards;
  // States that followed, `size × observation length`.
  struct ShieldFloats next_observations;
  // 1 where the next state's value counts, 0 where the transition ends; `size`.
  struct ShieldFloats continuations;
  // 1 where the member learns from the transition, else 0; `size × members`.
  struct ShieldFloats masks;
} ShieldBatchView;

// A learner.
typedef struct ShieldLearnerTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // What every kind shares.
  struct ShieldLifeTable life;
  // Describes the learner.
  int32_t (*info)(ShieldInstance *instance, struct ShieldLearnerInfoView *info);
  // Chooses an action; `mode` is one of `act_mode`.
  int32_t (*act)(ShieldInstance *instance,
                 struct ShieldFloats observation,
                 uint32_t mode,
                 float *action,
                 size_t length);
  // One value per member.
  int32_t (*q_values)(ShieldInstance *instance,
                      struct ShieldFloats observation,
                      struct ShieldFloats action,
                      float *values,
                      size_t members);
  // One value and one gradient per member; `gradients` holds `members × action length`.
  int32_t (*q_gradients)(ShieldInstance *instance,
                         struct ShieldFloats observation,
                         struct ShieldFloats action,
                         float *values,
                         size_t members,
                         float *gradients,
                         size_t gradients_length);
  // Learns from a batch.
  int32_t (*update)(ShieldInstance *instance, const struct ShieldBatchView *batch);
} ShieldLearnerTable;

// A policy.
typedef struct ShieldPolicyTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // What every kind shares.
  struct ShieldLifeTable life;
  // Chooses an action.
  int32_t (*act)(ShieldInstance *instance,
                 struct ShieldFloats observation,
                 float *action,
                 size_t length);
} ShieldPolicyTable;

// What a rule may look at; see `crate::RuleContext`.
typedef struct ShieldRuleContextView {
  // Size of this struct in bytes.
  size_t struct_size;
  // Environment steps so far.
  uint64_t step;
  // The state.
  struct ShieldFloats observation;
  // The proposed action.
  struct ShieldFloats proposed;
  // The action executed before; null and empty after a hard reset.
  struct ShieldFloats previous;
  // The reset ensemble's values at the proposed action.
  struct ShieldFloats values;
  // The same at the reset agent's greedy action.
  struct ShieldFloats greedy_values;
  // The forward ensemble's values.
  struct ShieldFloats forward_values;
  // γ of the reset agent.
  float discount;
  // One of `phase`.
  uint32_t phase;
} ShieldRuleContextView;

// What `AbortRuleTable::evaluate` fills. The buffer for the reason is the host's.
typedef struct ShieldVerdictView {
  // One of `verdict`.
  uint32_t verdict;
  // The figure that was compared.
  float score;
  // Where the reason goes.
  uint8_t *reason;
  // Room for it, in bytes.
  size_t reason_capacity;
  // How many bytes were written.
  size_t reason_length;
} ShieldVerdictView;

// What became of a decision; see `crate::ObservedDecision`.
typedef struct ShieldObservedDecisionView {
  // Size of this struct in bytes.
  size_t struct_size;
  // Environment steps so far.
  uint64_t step;
  // The action that will be executed.
  struct ShieldFloats action;
  // 1 if the proposed action was aborted.
  uint32_t aborted;
} ShieldObservedDecisionView;

// An abort rule.
typedef struct ShieldAbortRuleTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // What every kind shares.
  struct ShieldLifeTable life;
  // Stores bits of `need`.
  int32_t (*needs)(ShieldInstance *instance, uint32_t *needs);
  // Judges an action.
  int32_t (*evaluate)(ShieldInstance *instance,
                      const struct ShieldRuleContextView *context,
                      struct ShieldVerdictView *verdict);
  // Gives the rule as rows; `gradients` holds `members × action length`, row by row.
  int32_t (*linearise)(ShieldInstance *instance,
                       const struct ShieldRuleContextView *context,
                       struct ShieldFloats gradients,
                       const struct ShieldRowSink *rows);
  // Learns what became of the decision.
  int32_t (*observe)(ShieldInstance *instance, const struct ShieldObservedDecisionView *decision);
} ShieldAbortRuleTable;

// A batch of transitions with what became of the attempts, row by row; see `crate::AttemptBatch`.
typedef struct ShieldAttemptBatchView {
  // Size of this struct in bytes.
  size_t struct_size;
  // How many transitions.
  size_t size;
  // States, `size × observation length`.
  struct ShieldFloats observations;
  // Executed actions, `size × action length`.
  struct ShieldFloats actions;
  // States that followed, `size × observation length`.
  struct ShieldFloats next_observations;
  // What the reset agent does in them, `size × action length`.
  struct ShieldFloats next_actions;
  // 1 where the next state lies in the reset set, `size`.
  struct ShieldFloats successes;
  // 1 where the next state's estimate counts, 0 where nothing follows; `size`.
  struct ShieldFloats continuations;
  // 1 if the attempt reached the reset set, else 0; `size`.
  struct ShieldFloats outcomes;
  // How much the outcome counts, 0 to 1; `size`.
  struct ShieldFloats outcome_weights;
  // 1 where the member learns from the transition, else 0; `size × members`.
  struct ShieldFloats masks;
} ShieldAttemptBatchView;

// Extension of success critics: how they learn.
typedef struct ShieldSuccessCriticTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // Learns from a batch.
  int32_t (*update)(ShieldInstance *instance, const struct ShieldAttemptBatchView *batch);
} ShieldSuccessCriticTable;

// Undo probabilities beside a `RuleContextView`, one per member of the success critic; empty where the rule needs none.
typedef struct ShieldUndoView {
  // Size of this struct in bytes.
  size_t struct_size;
  // Of the proposed action.
  struct ShieldFloats probabilities;
  // Of the reset agent's greedy action.
  struct ShieldFloats greedy_probabilities;
  // Of the reset agent's greedy action in the state in which the last reset ended.
  struct ShieldFloats start_probabilities;
} ShieldUndoView;

// How an attempt to reset ended; see `crate::ObservedAttempt`.
typedef struct ShieldObservedAttemptView {
  // Size of this struct in bytes.
  size_t struct_size;
  // Environment steps so far.
  uint64_t step;
  // 1 if the reset set was reached.
  uint32_t succeeded;
} ShieldObservedAttemptView;

// Extension of abort rules: the functions of `AbortRuleTable` with undo probabilities, which the host calls instead of them, and what
// became of attempts.
typedef struct ShieldUndoRuleTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // Judges an action.
  int32_t (*evaluate)(ShieldInstance *instance,
                      const struct ShieldRuleContextView *context,
                      const struct ShieldUndoView *undo,
                      struct ShieldVerdictView *verdict);
  // Gives the rule as rows; `gradients` are those of the probabilities where the rule needs them, else of the values.
  int32_t (*linearise)(ShieldInstance *instance,
                       const struct ShieldRuleContextView *context,
                       const struct ShieldUndoView *undo,
                       struct ShieldFloats gradients,
                       const struct ShieldRowSink *rows);
  // Learns how an attempt ended.
  int32_t (*observe_attempt)(ShieldInstance *instance,
                             const struct ShieldObservedAttemptView *attempt);
} ShieldUndoRuleTable;

// What `ResetTaskTable::evaluate` fills.
typedef struct ShieldResetSignalView {
  // Reset reward.
  float reward;
  // 1 if the next state is in S_reset.
  uint32_t in_reset_set;
} ShieldResetSignalView;

// A reset task.
typedef struct ShieldResetTaskTable {
  // Size of this struct in bytes.
  size_t struct_size;
  // What every kind shares.
  struct ShieldLifeTable life;
  // Values a transition.
  int32_t (*evaluate)(ShieldInstance *instance,
                      struct ShieldFloats observation,
                      struct ShieldFloats action,
                      struct ShieldFloats next_observation,
                      struct ShieldResetSignalView *signal);
  // The observation after a hard reset.
  int32_t (*observe_start)(ShieldInstance *instance, struct ShieldFloats observation);
} ShieldResetTaskTable;

// One plugin of a library. Exactly the table that `kind` names is set; the others are null.
typedef struct ShieldPluginDescriptor {
  // Size of this struct in bytes.
  size_t struct_size;
  // One of `kind`.
  uint32_t kind;
  // The manifest's text, the same as in the file's section.
  struct ShieldText manifest;
  // Set for an environment.
  const struct ShieldEnvironmentTable *environment;
  // Set for a learner.
  const struct ShieldLearnerTable *learner;
  // Set for a policy.
  const struct ShieldPolicyTable *policy;
  // Set for an abort rule.
  const struct ShieldAbortRuleTable *abort_rule;
  // Set for a reset task.
  const struct ShieldResetTaskTable *reset_task;
} ShieldPluginDescriptor;

// What a library exports: a list of plugins.
typedef struct ShieldPluginLibrary {
  // Size of this struct in bytes.
  size_t struct_size;
  // `ABI_MAJOR` of the header or crate that the library was built with.
  uint32_t abi_major;
  // `ABI_MINOR` of the same.
  uint32_t abi_minor;
  // How many plugins.
  size_t plugin_count;
  // The first of them.
  const struct ShieldPluginDescriptor *plugins;
} ShieldPluginLibrary;

#ifdef __cplusplus
extern "C" {
#endif
#if defined(_WIN32)
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
// The one function that a library exports: its list of plugins.
const ShieldPluginLibrary *shield_plugin_entry_v1(void);
#ifdef __cplusplus
}
#endif

#define SHIELD_STRING_OF(value) #value
#define SHIELD_STRING(value) SHIELD_STRING_OF(value)

// One field of the configuration: four string literals.
#define SHIELD_FIELD(name, type, default_value, doc) \
    "field=" name "\x1f" "type=" type "\x1f" "default=" default_value "\x1f" "doc=" doc "\x1f"

// Places the manifest of one plugin into the section of the file that is read without loading it, as a constant named
// `variable`. All arguments but the first are string literals: `kind` is "environment", "learner", "policy", "abort-rule",
// "reset-task" or "success-critic"; `deterministic` is "true" or "false"; `fields` is a sequence of SHIELD_FIELD(...), or "".
#define SHIELD_MANIFEST(variable, id, kind, version, authors, license, description, deterministic, fields) \
    __attribute__((section(".shield_manifest"), used)) static const char variable[] = \
        "SHIELD MANIFEST 1\x1f" "id=" id "\x1f" "kind=" kind "\x1f" "version=" version "\x1f" \
        "abi=" SHIELD_STRING(SHIELD_ABI_MAJOR) "." SHIELD_STRING(SHIELD_ABI_MINOR) "\x1f" \
        "language=c\x1f" "panic=unwind\x1f" "authors=" authors "\x1f" "license=" license "\x1f" \
        "description=" description "\x1f" "deterministic=" deterministic "\x1f" fields "\x1e"

// The same text, as a descriptor wants it.
#define SHIELD_MANIFEST_TEXT(variable) { (const uint8_t *)(variable), sizeof(variable) - 1 }

#endif  /* SHIELD_PLUGIN_H */
