//! What `shield.h` declares. No panic leaves these functions, and where one fails, `shield_last_error` says why.
#![allow(unsafe_code, reason = "the boundary to C")]

use std::{
    convert::Infallible,
    ffi::{c_char, c_void},
    ptr, slice,
};

use runtime::{decision::Decision, drop_in::DropIn, drop_in_files};
use shield_api::{Phase, ResetSignal};

use crate::{
    errors,
    handle::{self, Shield},
    pointers_ffi::{change, library_folder, numbers, observe, on, path, see, with_file},
    policy_ffi,
};

/// The call has failed; `shield_last_error` says why.
pub const SHIELD_FAILED: i32 = -1;
/// The call has succeeded.
pub const SHIELD_DONE: i32 = 0;
/// Verdict: every rule allows the action.
pub const SHIELD_ALLOW: i32 = 1;
/// Verdict: allowed by the rules that need nothing learned; the others are not asked before `warm_up_steps` are over.
pub const SHIELD_WARM_UP: i32 = 2;
/// Verdict: the action was altered so that every rule allows it.
pub const SHIELD_PROJECT: i32 = 3;
/// Verdict: the action is rejected; the reset agent takes over, and the buffer holds its action.
pub const SHIELD_ABORT: i32 = 4;
/// Verdict: the reset agent is in charge, and the buffer holds its action.
pub const SHIELD_RESETTING: i32 = 5;

/// A reset policy of the caller, such as a hand-written way home: writes the action for an observation into `action`, and returns SHIELD_DONE.
/// Anything else says that it has no action; that, and an action that is not finite or outside the space, is never executed.
///
/// It is also asked about observations of the past, from which the success critic learns: its action must depend on the observation alone. It
/// neither throws nor calls a function of this header with the same shield.
pub type ShieldPolicy = Option<
    unsafe extern "C" fn(
        context: *mut c_void,
        observation: *const f32,
        observation_len: usize,
        action: *mut f32,
        action_len: usize,
    ) -> i32,
>;

/// Opens the shield that the RON file `config` describes, its `spaces` included. Plugins are looked for in SHIELD_PLUGIN_PATH, beside this
/// library, in `plugins` beside it, and in the user's data folder.
/// Returns null where that fails. One thread at a time may use a shield.
///
/// # Safety
/// `config` is a text that ends with 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_open(config: *const c_char) -> *mut Shield {
    let opened = handle::guarded(|| -> Result<Shield, String> {
        // SAFETY: the caller's promise; null is refused inside.
        let config = unsafe { path(config) }.ok_or("the path of the configuration is null")?;
        handle::open(&config, library_folder().as_deref(), None)
    });
    opened.map_or(ptr::null_mut(), |shield| Box::into_raw(Box::new(shield)))
}

/// As `shield_open`, with a reset policy of the caller in the place of a reset agent that learns; the file names no `reset`. `context` is handed to
/// it at each call. What it remembers is in no file of `shield_save`.
///
/// # Safety
/// `config` is a text that ends with 0. `reset_policy` is such a function, and it and `context` can be used until `shield_close` by the thread that
/// uses the shield.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_open_with_policy(
    config: *const c_char,
    reset_policy: ShieldPolicy,
    context: *mut c_void,
) -> *mut Shield {
    let opened = handle::guarded(|| -> Result<Shield, String> {
        // SAFETY: the caller's promise; null is refused inside.
        let config = unsafe { path(config) }.ok_or("the path of the configuration is null")?;
        let reset = policy_ffi::controller(reset_policy, context).ok_or("the reset policy is null")?;
        handle::open(&config, library_folder().as_deref(), Some(reset))
    });
    opened.map_or(ptr::null_mut(), |shield| Box::into_raw(Box::new(shield)))
}

/// Decides on `action`, which afterwards holds what may be executed, whatever is returned: after a failure the action of the space that is nearest to
/// 0, and zeros where `shield` is null. The first observation of all is taken for a start.
/// Returns a verdict, or SHIELD_FAILED.
///
/// # Safety
/// `shield` is from `shield_open`; the arrays have the lengths that are given.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_filter(
    shield: *mut Shield,
    observation: *const f32,
    observation_len: usize,
    action: *mut f32,
    action_len: usize,
) -> i32 {
    // SAFETY: the caller's promise; null is refused.
    let (shield, observation, action) = unsafe {
        let action =
            if action.is_null() { None } else { Some(slice::from_raw_parts_mut(action, action_len)) };
        (shield.as_mut(), numbers(observation, observation_len), action)
    };
    let (shield, observation, action) = match (shield, observation, action) {
        (Some(shield), Some(observation), Some(action)) => (shield, observation, action),
        (shield, _, action) => {
            errors::keep("the shield, the observation or the action is null");
            match (shield, action) {
                (Some(shield), Some(action)) => shield.rest(action),
                // Nobody knows what is harmless there; 0 is what most machines rest at.
                (None, Some(action)) => action.fill(0.0),
                (_, None) => {}
            }
            return SHIELD_FAILED;
        }
    };
    let Some(decision) = shield.with(|drop_in| drop_in.filter(observation, action)) else {
        shield.rest(action);
        return SHIELD_FAILED;
    };
    match shield.drop_in.reason() {
        "" => errors::forget(&mut shield.reason),
        reason => shield.reason = errors::text(reason),
    }
    match decision {
        Decision::Allow => SHIELD_ALLOW,
        Decision::WarmUp => SHIELD_WARM_UP,
        Decision::Project(_) => SHIELD_PROJECT,
        Decision::Abort(_) => SHIELD_ABORT,
        Decision::Resetting => SHIELD_RESETTING,
    }
}

/// What was in the buffer was executed and led to `next_observation`; the reset agent learns. `terminated` is not 0 where the environment
/// cannot go on. The configuration names a `reset_task`; without one, see `shield_observe_reset`.
///
/// # Safety
/// As for `shield_filter`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_observe(
    shield: *mut Shield,
    next_observation: *const f32,
    observation_len: usize,
    terminated: i32,
) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { observe(shield, next_observation, observation_len, None, terminated) }
}

/// As `shield_observe`, where no `reset_task` says what "reset" means: the reset reward, up to 1, of the state that was reached, and
/// not 0 if it counts as reset.
///
/// # Safety
/// As for `shield_filter`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_observe_reset(
    shield: *mut Shield,
    next_observation: *const f32,
    observation_len: usize,
    reset_reward: f32,
    in_reset_set: i32,
    terminated: i32,
) -> i32 {
    let signal = ResetSignal { reward: reset_reward, in_reset_set: in_reset_set != 0 };
    // SAFETY: the caller's promise.
    unsafe { observe(shield, next_observation, observation_len, Some(signal), terminated) }
}

/// The task is done, or its time is up: the reset agent takes over, as `shield_is_resetting` says, if there is anything to undo.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_begin_reset(shield: *mut Shield) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { change(shield, |drop_in| Ok::<_, Infallible>(drop_in.begin_reset())) }
}

/// 1 if the reset agent is in charge of the next step, else 0.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_is_resetting(shield: *mut Shield) -> i32 {
    let is_resetting = |shield: &mut Shield| Some(i32::from(shield.drop_in.phase() == Phase::Reset));
    // SAFETY: the caller's promise.
    unsafe { on(shield, is_resetting) }
}

/// 1 if nothing may move before `shield_hard_reset_done`: the reset agent has given up, or the environment has ended. Else 0.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_needs_hard_reset(shield: *mut Shield) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { on(shield, |shield| Some(i32::from(shield.drop_in.needs_hard_reset()))) }
}

/// Everything is back at its start, where `observation` is seen.
///
/// # Safety
/// As for `shield_filter`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_hard_reset_done(
    shield: *mut Shield,
    observation: *const f32,
    observation_len: usize,
) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { see(shield, observation, observation_len, DropIn::hard_reset_done) }
}

/// How many more starts are to be shown to the reset task, by `shield_observe_start`, before the first step: `calibration_resets` of the file.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_calibration_resets(shield: *const Shield) -> u32 {
    // SAFETY: the caller's promise.
    unsafe { shield.as_ref() }.map_or(0, |shield| shield.drop_in.calibration_resets())
}

/// The environment was reset once more before the first step, and `observation` is seen: the reset task learns how far starts scatter. Nothing
/// else follows, and nothing is counted.
///
/// # Safety
/// As for `shield_filter`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_observe_start(
    shield: *mut Shield,
    observation: *const f32,
    observation_len: usize,
) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { see(shield, observation, observation_len, DropIn::observe_start) }
}

/// Mean of the reset ensemble's values of the action that was proposed last; NaN if no rule needed them.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_reset_value(shield: *const Shield) -> f32 {
    // SAFETY: the caller's promise.
    unsafe { shield.as_ref() }.map_or(f32::NAN, |shield| shield.drop_in.reset_value())
}

/// Why the last action was rejected, for a person; empty if it was not. Valid until the next call with this shield.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_reason(shield: *const Shield) -> *const c_char {
    // SAFETY: the caller's promise.
    unsafe { shield.as_ref() }.map_or(c"".as_ptr(), |shield| shield.reason.as_ptr())
}

/// How many findings there are: what keeps the shield from helping, such as starts that do not count as reset. Each is found once, and none goes
/// away: tell a person of those beyond the ones that you know.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_findings(shield: *const Shield) -> usize {
    // SAFETY: the caller's promise.
    unsafe { shield.as_ref() }.map_or(0, |shield| shield.drop_in.findings().count())
}

/// A finding, counted from 0 in the order in which they were found, for a person: what was seen, with figures, and what to do. Empty if there are
/// not so many. Valid until the next call with this shield.
///
/// # Safety
/// `shield` is from `shield_open`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_finding(shield: *mut Shield, index: usize) -> *const c_char {
    // SAFETY: the caller's promise.
    let Some(shield) = (unsafe { shield.as_mut() }) else { return c"".as_ptr() };
    match shield.drop_in.findings().nth(index) {
        Some(finding) => shield.finding = errors::text(finding),
        None => errors::forget(&mut shield.finding),
    }
    shield.finding.as_ptr()
}

/// Writes everything that was learned and counted into a file, in one step: a failure leaves the old file as it was. Only a regular file is replaced;
/// a folder, a device, a pipe or a symbolic link of that name is an error.
///
/// # Safety
/// `shield` is from `shield_open`, `file` a text that ends with 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_save(shield: *mut Shield, file: *const c_char) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { with_file(shield, file, drop_in_files::save) }
}

/// Goes on from a file of a shield with the same spaces, reset agent, rules and reset task; a hard reset is needed then, also after a failure. The
/// capacity of the experience may differ: of more transitions than there is room for, the newest stay.
///
/// # Safety
/// As for `shield_save`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_load(shield: *mut Shield, file: *const c_char) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { with_file(shield, file, drop_in_files::load) }
}

/// Why the last call of this thread has failed; empty if it has not. Valid until its next call.
#[unsafe(no_mangle)]
pub extern "C" fn shield_last_error() -> *const c_char {
    errors::last()
}

/// Frees a shield; null is nothing to be freed.
///
/// # Safety
/// `shield` is from `shield_open` and is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn shield_close(shield: *mut Shield) {
    if !shield.is_null() {
        // SAFETY: made by `shield_open`, and freed once.
        let shield = unsafe { Box::from_raw(shield) };
        // Where a plugin panics when it goes, there is nothing left to be done.
        handle::guarded(|| {
            drop(shield);
            Ok::<_, Infallible>(())
        });
    }
}
