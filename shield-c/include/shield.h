// A shield between a controller and a robot, for C, C++ and whatever speaks C: link with -lshield_runtime.
//
// Each step: `shield_filter` the proposed action, execute what is then in the buffer, report with `shield_observe` where it led. An aborted
// action has given way to the reset agent's, which is in charge from then on until its episode is over. Where `shield_needs_hard_reset`, nothing may
// move before `shield_hard_reset_done`. No call throws or exits.

#ifndef SHIELD_H
#define SHIELD_H

// Made by `cargo xtask header` from shield-c/src/ffi.rs; edit that file instead.

#include <stddef.h>
#include <stdint.h>
// A shield with its reset agent and what that has learned.
typedef struct Shield Shield;


// The call has failed; `shield_last_error` says why.
#define SHIELD_FAILED -1

// The call has succeeded.
#define SHIELD_DONE 0

// Verdict: every rule allows the action.
#define SHIELD_ALLOW 1

// Verdict: allowed by the rules that need nothing learned; the others are not asked before `warm_up_steps` are over.
#define SHIELD_WARM_UP 2

// Verdict: the action was altered so that every rule allows it.
#define SHIELD_PROJECT 3

// Verdict: the action is rejected; the reset agent takes over, and the buffer holds its action.
#define SHIELD_ABORT 4

// Verdict: the reset agent is in charge, and the buffer holds its action.
#define SHIELD_RESETTING 5

// A reset policy of the caller, such as a hand-written way home: writes the action for an observation into `action`, and returns SHIELD_DONE.
// Anything else says that it has no action; that, and an action that is not finite or outside the space, is never executed.
//
// It is also asked about observations of the past, from which the success critic learns: its action must depend on the observation alone. It
// neither throws nor calls a function of this header with the same shield.
typedef int32_t (*ShieldPolicy)(void *context,
                                const float *observation,
                                size_t observation_len,
                                float *action,
                                size_t action_len);

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Opens the shield that the RON file `config` describes, its `spaces` included. Plugins are looked for in SHIELD_PLUGIN_PATH, beside this
// library, in `plugins` beside it, and in the user's data folder.
// Returns null where that fails. One thread at a time may use a shield.
//
// # Safety
// `config` is a text that ends with 0.
Shield *shield_open(const char *config);

// As `shield_open`, with a reset policy of the caller in the place of a reset agent that learns; the file names no `reset`. `context` is handed to
// it at each call. What it remembers is in no file of `shield_save`.
//
// # Safety
// `config` is a text that ends with 0. `reset_policy` is such a function, and it and `context` can be used until `shield_close` by the thread that
// uses the shield.
Shield *shield_open_with_policy(const char *config,
                                ShieldPolicy reset_policy,
                                void *context);

// Decides on `action`, which afterwards holds what may be executed, whatever is returned: after a failure the action of the space that is nearest to
// 0, and zeros where `shield` is null. The first observation of all is taken for a start.
// Returns a verdict, or SHIELD_FAILED.
//
// # Safety
// `shield` is from `shield_open`; the arrays have the lengths that are given.
int32_t shield_filter(Shield *shield,
                      const float *observation,
                      size_t observation_len,
                      float *action,
                      size_t action_len);

// What was in the buffer was executed and led to `next_observation`; the reset agent learns. `terminated` is not 0 where the environment
// cannot go on. The configuration names a `reset_task`; without one, see `shield_observe_reset`.
//
// # Safety
// As for `shield_filter`.
int32_t shield_observe(Shield *shield,
                       const float *next_observation,
                       size_t observation_len,
                       int32_t terminated);

// As `shield_observe`, where no `reset_task` says what "reset" means: the reset reward, up to 1, of the state that was reached, and
// not 0 if it counts as reset.
//
// # Safety
// As for `shield_filter`.
int32_t shield_observe_reset(Shield *shield,
                             const float *next_observation,
                             size_t observation_len,
                             float reset_reward,
                             int32_t in_reset_set,
                             int32_t terminated);

// The task is done, or its time is up: the reset agent takes over, as `shield_is_resetting` says, if there is anything to undo.
//
// # Safety
// `shield` is from `shield_open`.
int32_t shield_begin_reset(Shield *shield);

// 1 if the reset agent is in charge of the next step, else 0.
//
// # Safety
// `shield` is from `shield_open`.
int32_t shield_is_resetting(Shield *shield);

// 1 if nothing may move before `shield_hard_reset_done`: the reset agent has given up, or the environment has ended. Else 0.
//
// # Safety
// `shield` is from `shield_open`.
int32_t shield_needs_hard_reset(Shield *shield);

// Everything is back at its start, where `observation` is seen.
//
// # Safety
// As for `shield_filter`.
int32_t shield_hard_reset_done(Shield *shield, const float *observation, size_t observation_len);

// How many more starts are to be shown to the reset task, by `shield_observe_start`, before the first step: `calibration_resets` of the file.
//
// # Safety
// `shield` is from `shield_open`.
uint32_t shield_calibration_resets(const Shield *shield);

// The environment was reset once more before the first step, and `observation` is seen: the reset task learns how far starts scatter. Nothing
// else follows, and nothing is counted.
//
// # Safety
// As for `shield_filter`.
int32_t shield_observe_start(Shield *shield,
                             const float *observation,
                             size_t observation_len);

// Mean of the reset ensemble's values of the action that was proposed last; NaN if no rule needed them.
//
// # Safety
// `shield` is from `shield_open`.
float shield_reset_value(const Shield *shield);

// Why the last action was rejected, for a person; empty if it was not. Valid until the next call with this shield.
//
// # Safety
// `shield` is from `shield_open`.
const char *shield_reason(const Shield *shield);

// How many findings there are: what keeps the shield from helping, such as starts that do not count as reset. Each is found once, and none goes
// away: tell a person of those beyond the ones that you know.
//
// # Safety
// `shield` is from `shield_open`.
size_t shield_findings(const Shield *shield);

// A finding, counted from 0 in the order in which they were found, for a person: what was seen, with figures, and what to do. Empty if there are
// not so many. Valid until the next call with this shield.
//
// # Safety
// `shield` is from `shield_open`.
const char *shield_finding(Shield *shield,
                           size_t index);

// Writes everything that was learned and counted into a file, in one step: a failure leaves the old file as it was. Only a regular file is replaced;
// a folder, a device, a pipe or a symbolic link of that name is an error.
//
// # Safety
// `shield` is from `shield_open`, `file` a text that ends with 0.
int32_t shield_save(Shield *shield,
                    const char *file);

// Goes on from a file of a shield with the same spaces, reset agent, rules and reset task; a hard reset is needed then, also after a failure. The
// capacity of the experience may differ: of more transitions than there is room for, the newest stay.
//
// # Safety
// As for `shield_save`.
int32_t shield_load(Shield *shield,
                    const char *file);

// Why the last call of this thread has failed; empty if it has not. Valid until its next call.
const char *shield_last_error(void);

// Frees a shield; null is nothing to be freed.
//
// # Safety
// `shield` is from `shield_open` and is not used again.
void shield_close(Shield *shield);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SHIELD_H */
