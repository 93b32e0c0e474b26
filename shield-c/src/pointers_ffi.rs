//! Pointers of C, each checked before anything is done with it.
#![allow(unsafe_code, reason = "the boundary to C")]

use std::{
    ffi::{CStr, OsStr, c_char, c_void},
    fmt::Display,
    os::unix::ffi::OsStrExt,
    path::{Path, PathBuf},
    ptr, slice,
};

use runtime::{cycle::HardResetDue, drop_in::DropIn, drop_in_files::StateError};
use shield_api::{Error, ResetSignal};

use crate::{
    errors,
    ffi::{SHIELD_DONE, SHIELD_FAILED, shield_last_error},
    handle::Shield,
};

pub unsafe fn observe(
    shield: *mut Shield,
    next: *const f32,
    length: usize,
    signal: Option<ResetSignal>,
    terminated: i32,
) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { see(shield, next, length, |drop_in, next| drop_in.observe(next, signal, terminated != 0)) }
}

/// Tells a shield that may be null of an observation that may be.
pub unsafe fn see(
    shield: *mut Shield,
    observation: *const f32,
    length: usize,
    body: impl FnOnce(&mut DropIn, &[f32]) -> shield_api::Result<()>,
) -> i32 {
    // SAFETY: the caller's promise; null is refused.
    let observation = unsafe { numbers(observation, length) };
    let checked = |drop_in: &mut DropIn| match observation {
        Some(observation) => body(drop_in, observation),
        None => {
            drop_in.require_hard_reset(HardResetDue::Lost);
            Err(Error::invalid_argument("the observation is null"))
        }
    };
    // SAFETY: the caller's promise.
    unsafe { change(shield, checked) }
}

/// Writes or reads a shield's file.
pub unsafe fn with_file(
    shield: *mut Shield,
    file: *const c_char,
    body: impl FnOnce(&mut DropIn, &Path) -> Result<(), StateError>,
) -> i32 {
    // SAFETY: the caller's promise.
    let file = unsafe { path(file) };
    let checked = |drop_in: &mut DropIn| -> Result<(), String> {
        let file = file.as_deref().ok_or("the path is null")?;
        body(drop_in, file).map_err(|error| error.to_string())
    };
    // SAFETY: the caller's promise.
    unsafe { change(shield, checked) }
}

/// Changes what is behind a shield that may be null.
pub unsafe fn change<R, E: Display>(
    shield: *mut Shield,
    body: impl FnOnce(&mut DropIn) -> Result<R, E>,
) -> i32 {
    // SAFETY: the caller's promise.
    unsafe { on(shield, |shield| shield.with(body).map(|_| SHIELD_DONE)) }
}

/// Does something with a shield that may be null.
pub unsafe fn on(shield: *mut Shield, body: impl FnOnce(&mut Shield) -> Option<i32>) -> i32 {
    // SAFETY: the caller's promise.
    let Some(shield) = (unsafe { shield.as_mut() }) else {
        errors::keep("the shield is null");
        return SHIELD_FAILED;
    };
    let done = body(shield);
    if done.is_some() {
        errors::clear();
    }
    done.unwrap_or(SHIELD_FAILED)
}

pub unsafe fn numbers<'a>(numbers: *const f32, length: usize) -> Option<&'a [f32]> {
    // SAFETY: the caller's promise.
    if numbers.is_null() { None } else { Some(unsafe { slice::from_raw_parts(numbers, length) }) }
}

pub unsafe fn path(text: *const c_char) -> Option<PathBuf> {
    if text.is_null() {
        return None;
    }
    // SAFETY: the caller's promise.
    let text = unsafe { CStr::from_ptr(text) };
    Some(PathBuf::from(OsStr::from_bytes(text.to_bytes())))
}

/// The folder in which this library lies.
pub fn library_folder() -> Option<PathBuf> {
    let own = shield_last_error as *const c_void;
    let mut found = libc::Dl_info {
        dli_fname: ptr::null(),
        dli_fbase: ptr::null_mut(),
        dli_sname: ptr::null(),
        dli_saddr: ptr::null_mut(),
    };
    // SAFETY: `own` is an address in this library, and `found` is filled where the call succeeds.
    let is_found = unsafe { libc::dladdr(own, &raw mut found) } != 0;
    // SAFETY: the loader's name of this library, which is never unloaded while its code runs.
    let library = is_found.then(|| unsafe { path(found.dli_fname) }).flatten()?;
    library.canonicalize().ok()?.parent().map(Path::to_owned)
}
