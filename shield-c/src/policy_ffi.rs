//! A reset policy of the caller.
#![allow(unsafe_code, reason = "calls a function of C")]

use std::ffi::c_void;

use runtime::controller::Controller;
use shield_api::Error;

use crate::ffi::{SHIELD_DONE, ShieldPolicy};

/// What the caller's function is given back. It is used in the calls of one shield only, which one thread at a time makes.
struct Context(*mut c_void);

// SAFETY: the caller of `shield_open_with_policy` promises that the thread which uses the shield may use its context.
unsafe impl Send for Context {}

impl Context {
    fn pointer(&self) -> *mut c_void {
        self.0
    }
}

/// The function as the reset agent; `None` where it is null.
pub fn controller(policy: ShieldPolicy, context: *mut c_void) -> Option<Controller> {
    let (policy, context) = (policy?, Context(context));
    Some(Controller::from_fn(move |observation, action| {
        let (seen, seen_len) = (observation.as_ptr(), observation.len());
        // SAFETY: the promise of `shield_open_with_policy`; both arrays are as long as said, and live for the call.
        let code = unsafe { policy(context.pointer(), seen, seen_len, action.as_mut_ptr(), action.len()) };
        if code == SHIELD_DONE {
            Ok(())
        } else {
            Err(Error::failed(format!("the reset policy returned {code}")))
        }
    }))
}
