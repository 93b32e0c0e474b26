//! The extension by which a learner's weights and policy leave it.

use std::ffi::c_void;

use super::life::{call, hand_over};
use crate::{
    Learner,
    abi::{EXTENSION_WEIGHTS, Instance, Text, WeightsTable, Writer},
};

/// Every learner has the table; whether it can write anything, its answer says.
pub(super) unsafe extern "C" fn learner_extension<T: Learner>(name: Text) -> *const c_void {
    let table: &'static WeightsTable = const {
        &WeightsTable { struct_size: size_of::<WeightsTable>(), weights: weights::<T>, policy: policy::<T> }
    };
    // SAFETY: the host's text lives for the call.
    match unsafe { name.as_str() } {
        EXTENSION_WEIGHTS => std::ptr::from_ref(table).cast(),
        _ => std::ptr::null(),
    }
}

unsafe extern "C" fn weights<T: Learner>(instance: *mut Instance, writer: *const Writer) -> i32 {
    // SAFETY: the host's promises: an instance of this table, used by one thread, and a writer of its own.
    unsafe {
        call::<T>(instance, |holder| {
            let mut bytes = Vec::new();
            holder.value.weights(&mut bytes)?;
            hand_over(writer, &bytes, "the weights")
        })
    }
}

unsafe extern "C" fn policy<T: Learner>(instance: *mut Instance, writer: *const Writer) -> i32 {
    // SAFETY: as above.
    unsafe {
        call::<T>(instance, |holder| {
            let mut bytes = Vec::new();
            holder.value.onnx(&mut bytes)?;
            hand_over(writer, &bytes, "the policy")
        })
    }
}
