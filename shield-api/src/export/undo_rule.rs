//! The extension by which a rule is given undo probabilities, and told how attempts ended.

use std::ffi::c_void;

use super::{
    kinds::{judge, read_context},
    life::{call, required},
};
use crate::{
    AbortRule, ObservedAttempt, Result, RuleContext,
    abi::{
        EXTENSION_UNDO_RULE, Floats, Instance, ObservedAttemptView, RowSink, RuleContextView, Text,
        UndoRuleTable, UndoView, VerdictView,
    },
};

/// Every rule has the table; which probabilities it is given, its needs say.
pub(super) unsafe extern "C" fn undo_rule_extension<T: AbortRule>(name: Text) -> *const c_void {
    let table: &'static UndoRuleTable = const {
        &UndoRuleTable {
            struct_size: size_of::<UndoRuleTable>(),
            evaluate: evaluate::<T>,
            linearise: linearise::<T>,
            observe_attempt: observe_attempt::<T>,
        }
    };
    // SAFETY: the host's text lives for the call.
    match unsafe { name.as_str() } {
        EXTENSION_UNDO_RULE => std::ptr::from_ref(table).cast(),
        _ => std::ptr::null(),
    }
}

/// # Safety
/// The pointers in the views are null or valid for their lengths as long as `'a`.
unsafe fn read<'a>(context: *const RuleContextView, undo: *const UndoView) -> Result<RuleContext<'a>> {
    // SAFETY: the caller's promise.
    unsafe {
        let undo = required(undo.cast_mut(), "the undo probabilities")?;
        Ok(RuleContext {
            probabilities: undo.probabilities.as_slice(),
            greedy_probabilities: undo.greedy_probabilities.as_slice(),
            start_probabilities: undo.start_probabilities.as_slice(),
            ..read_context(context)?
        })
    }
}

// Every function below is called by a host that keeps the promises of the table: an instance that `create` of the same table
// made, used by one thread at a time, and pointers that are null or valid for the length given with them.

unsafe extern "C" fn evaluate<T: AbortRule>(
    instance: *mut Instance,
    context: *const RuleContextView,
    undo: *const UndoView,
    view: *mut VerdictView,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe { call::<T>(instance, |holder| judge(&holder.value, &read(context, undo)?, view)) }
}

unsafe extern "C" fn linearise<T: AbortRule>(
    instance: *mut Instance,
    context: *const RuleContextView,
    undo: *const UndoView,
    gradients: Floats,
    rows: *const RowSink,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let mut rows = *required(rows.cast_mut(), "the place for the rows")?;
            holder.value.linearise(&read(context, undo)?, gradients.as_slice(), &mut rows)
        })
    }
}

unsafe extern "C" fn observe_attempt<T: AbortRule>(
    instance: *mut Instance,
    attempt: *const ObservedAttemptView,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let view = required(attempt.cast_mut(), "the attempt")?;
            let attempt = ObservedAttempt { step: view.step, succeeded: view.succeeded != 0 };
            holder.value.observe_attempt(&attempt)
        })
    }
}
