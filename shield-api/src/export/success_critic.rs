//! The tables of a success critic: that of a learner, whose values are probabilities, and an extension by which it learns.

use std::ffi::c_void;

use super::{
    kinds::descriptor,
    life::{self, buffer, call, required},
};
use crate::{
    AttemptBatch, Error, Plugin, SuccessCritic,
    abi::{
        AttemptBatchView, BatchView, EXTENSION_SUCCESS_CRITIC, Floats, Instance, LearnerInfoView,
        LearnerTable, LifeTable, PluginDescriptor, SuccessCriticTable, Text, kind,
    },
    check_length,
};

/// The entry of a success critic in a library's list.
pub const fn success_critic<T: SuccessCritic + Plugin>(manifest: &'static [u8]) -> PluginDescriptor {
    let table = const {
        &LearnerTable {
            struct_size: size_of::<LearnerTable>(),
            life: LifeTable { get_extension: extension::<T>, ..life::table::<T>() },
            info: info::<T>,
            act: no_action::<T>,
            q_values: probabilities::<T>,
            q_gradients: gradients::<T>,
            update: no_update::<T>,
        }
    };
    PluginDescriptor { learner: table, ..descriptor(kind::SUCCESS_CRITIC, manifest) }
}

unsafe extern "C" fn extension<T: SuccessCritic>(name: Text) -> *const c_void {
    let table: &'static SuccessCriticTable =
        const { &SuccessCriticTable { struct_size: size_of::<SuccessCriticTable>(), update: update::<T> } };
    // SAFETY: the host's text lives for the call.
    match unsafe { name.as_str() } {
        EXTENSION_SUCCESS_CRITIC => std::ptr::from_ref(table).cast(),
        _ => std::ptr::null(),
    }
}

// Every function below is called by a host that keeps the promises of the table: an instance that `create` of the same table
// made, used by one thread at a time, and pointers that are null or valid for the length given with them.

unsafe extern "C" fn info<T: SuccessCritic>(instance: *mut Instance, view: *mut LearnerInfoView) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let members = u32::try_from(holder.value.info().members).unwrap_or(u32::MAX);
            *required(view, "the place for the information")? = LearnerInfoView { members, discount: 1.0 };
            Ok(())
        })
    }
}

unsafe extern "C" fn no_action<T: SuccessCritic>(
    instance: *mut Instance,
    _observation: Floats,
    _mode: u32,
    _action: *mut f32,
    _length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe { call::<T>(instance, |_| Err(Error::unsupported("acting, which a success critic does not do,"))) }
}

unsafe extern "C" fn no_update<T: SuccessCritic>(instance: *mut Instance, _batch: *const BatchView) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe { call::<T>(instance, |_| Err(Error::unsupported("learning without outcomes of attempts"))) }
}

unsafe extern "C" fn probabilities<T: SuccessCritic>(
    instance: *mut Instance,
    observation: Floats,
    action: Floats,
    probabilities: *mut f32,
    members: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let probabilities = buffer(probabilities, members, "probabilities")?;
            holder.value.probabilities(observation.as_slice(), action.as_slice(), probabilities)
        })
    }
}

unsafe extern "C" fn gradients<T: SuccessCritic>(
    instance: *mut Instance,
    observation: Floats,
    action: Floats,
    probabilities: *mut f32,
    members: usize,
    gradients: *mut f32,
    gradients_length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let probabilities = buffer(probabilities, members, "probabilities")?;
            let gradients = buffer(gradients, gradients_length, "gradients")?;
            check_length("gradients", gradients, members * action.length)?;
            let (observation, action) = (observation.as_slice(), action.as_slice());
            holder.value.gradients(observation, action, probabilities, gradients)
        })
    }
}

unsafe extern "C" fn update<T: SuccessCritic>(
    instance: *mut Instance,
    batch: *const AttemptBatchView,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let view = required(batch.cast_mut(), "the batch")?;
            let batch = AttemptBatch {
                size: view.size,
                observations: view.observations.as_slice(),
                actions: view.actions.as_slice(),
                next_observations: view.next_observations.as_slice(),
                next_actions: view.next_actions.as_slice(),
                successes: view.successes.as_slice(),
                continuations: view.continuations.as_slice(),
                outcomes: view.outcomes.as_slice(),
                outcome_weights: view.outcome_weights.as_slice(),
                masks: view.masks.as_slice(),
            };
            for (name, column) in [
                ("successes", batch.successes),
                ("continuations", batch.continuations),
                ("outcomes", batch.outcomes),
                ("outcome_weights", batch.outcome_weights),
            ] {
                check_length(name, column, batch.size)?;
            }
            holder.value.update(&batch)
        })
    }
}
