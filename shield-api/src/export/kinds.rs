//! The tables of every kind but the environment, filled for a type that implements the kind's trait.

use super::life::{self, buffer, call, required};
use super::undo_rule::undo_rule_extension;
use super::weights::learner_extension;
use crate::{
    AbortRule, ActMode, Batch, Error, Learner, ObservedDecision, Phase, Plugin, Policy, Reason, ResetTask,
    Result, Rows, RuleContext, Verdict,
    abi::{
        AbortRuleTable, BatchView, Floats, Instance, LearnerInfoView, LearnerTable, LifeTable,
        ObservedDecisionView, PluginDescriptor, PolicyTable, ResetSignalView, ResetTaskTable, RowSink,
        RuleContextView, Text, VerdictView, act_mode, kind, need, phase, status, verdict,
    },
    check_length,
};

pub(super) const fn descriptor(kind: u32, manifest: &'static [u8]) -> PluginDescriptor {
    PluginDescriptor {
        struct_size: size_of::<PluginDescriptor>(),
        kind,
        manifest: Text { pointer: manifest.as_ptr(), length: manifest.len() },
        environment: std::ptr::null(),
        learner: std::ptr::null(),
        policy: std::ptr::null(),
        abort_rule: std::ptr::null(),
        reset_task: std::ptr::null(),
    }
}

/// The entry of a learner in a library's list.
pub const fn learner<T: Learner + Plugin>(manifest: &'static [u8]) -> PluginDescriptor {
    let table = const {
        &LearnerTable {
            struct_size: size_of::<LearnerTable>(),
            life: LifeTable { get_extension: learner_extension::<T>, ..life::table::<T>() },
            info: info::<T>,
            act: learner_act::<T>,
            q_values: q_values::<T>,
            q_gradients: q_gradients::<T>,
            update: update::<T>,
        }
    };
    PluginDescriptor { learner: table, ..descriptor(kind::LEARNER, manifest) }
}

/// The entry of a policy in a library's list.
pub const fn policy<T: Policy + Plugin>(manifest: &'static [u8]) -> PluginDescriptor {
    let table = const {
        &PolicyTable { struct_size: size_of::<PolicyTable>(), life: life::table::<T>(), act: policy_act::<T> }
    };
    PluginDescriptor { policy: table, ..descriptor(kind::POLICY, manifest) }
}

/// The entry of an abort rule in a library's list.
pub const fn abort_rule<T: AbortRule + Plugin>(manifest: &'static [u8]) -> PluginDescriptor {
    let table = const {
        &AbortRuleTable {
            struct_size: size_of::<AbortRuleTable>(),
            life: LifeTable { get_extension: undo_rule_extension::<T>, ..life::table::<T>() },
            needs: needs::<T>,
            evaluate: evaluate::<T>,
            linearise: linearise::<T>,
            observe: observe::<T>,
        }
    };
    PluginDescriptor { abort_rule: table, ..descriptor(kind::ABORT_RULE, manifest) }
}

/// The entry of a reset task in a library's list.
pub const fn reset_task<T: ResetTask + Plugin>(manifest: &'static [u8]) -> PluginDescriptor {
    let table = const {
        &ResetTaskTable {
            struct_size: size_of::<ResetTaskTable>(),
            life: life::table::<T>(),
            evaluate: reset_signal::<T>,
            observe_start: observe_start::<T>,
        }
    };
    PluginDescriptor { reset_task: table, ..descriptor(kind::RESET_TASK, manifest) }
}

// Every function below is called by a host that keeps the promises of the table: an instance that `create` of the same table
// made, used by one thread at a time, and pointers that are null or valid for the length given with them.

unsafe extern "C" fn info<T: Learner>(instance: *mut Instance, view: *mut LearnerInfoView) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let info = holder.value.info();
            *required(view, "the place for the information")? = LearnerInfoView {
                members: u32::try_from(info.members).unwrap_or(u32::MAX),
                discount: info.discount,
            };
            Ok(())
        })
    }
}

unsafe extern "C" fn learner_act<T: Learner>(
    instance: *mut Instance,
    observation: Floats,
    mode: u32,
    action: *mut f32,
    length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let mode = match mode {
                act_mode::EXPLORE => ActMode::Explore,
                act_mode::GREEDY => ActMode::Greedy,
                other => return Err(Error::invalid_argument(format!("there is no way {other} to act"))),
            };
            holder.value.act(observation.as_slice(), mode, buffer(action, length, "action")?)
        })
    }
}

unsafe extern "C" fn q_values<T: Learner>(
    instance: *mut Instance,
    observation: Floats,
    action: Floats,
    values: *mut f32,
    members: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let values = buffer(values, members, "values")?;
            holder.value.q_values(observation.as_slice(), action.as_slice(), values)
        })
    }
}

unsafe extern "C" fn q_gradients<T: Learner>(
    instance: *mut Instance,
    observation: Floats,
    action: Floats,
    values: *mut f32,
    members: usize,
    gradients: *mut f32,
    gradients_length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let values = buffer(values, members, "values")?;
            let gradients = buffer(gradients, gradients_length, "gradients")?;
            check_length("gradients", gradients, members * action.length)?;
            holder.value.q_gradients(observation.as_slice(), action.as_slice(), values, gradients)
        })
    }
}

unsafe extern "C" fn update<T: Learner>(instance: *mut Instance, batch: *const BatchView) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let view = required(batch.cast_mut(), "the batch")?;
            let batch = Batch {
                size: view.size,
                observations: view.observations.as_slice(),
                actions: view.actions.as_slice(),
                rewards: view.rewards.as_slice(),
                next_observations: view.next_observations.as_slice(),
                continuations: view.continuations.as_slice(),
                masks: view.masks.as_slice(),
            };
            check_length("rewards", batch.rewards, batch.size)?;
            check_length("continuations", batch.continuations, batch.size)?;
            holder.value.update(&batch)
        })
    }
}

unsafe extern "C" fn policy_act<T: Policy>(
    instance: *mut Instance,
    observation: Floats,
    action: *mut f32,
    length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            holder.value.act(observation.as_slice(), buffer(action, length, "action")?)
        })
    }
}

unsafe extern "C" fn needs<T: AbortRule>(instance: *mut Instance, bits: *mut u32) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let needs = holder.value.needs();
            let bit = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
            *required(bits, "the place for the needs")? = bit(needs.values, need::VALUES)
                | bit(needs.greedy_values, need::GREEDY_VALUES)
                | bit(needs.forward_values, need::FORWARD_VALUES)
                | bit(needs.probabilities, need::PROBABILITIES)
                | bit(needs.greedy_probabilities, need::GREEDY_PROBABILITIES)
                | bit(needs.greedy_on_rejection, need::GREEDY_ON_REJECTION);
            Ok(())
        })
    }
}

/// # Safety
/// The pointers in the view are null or valid for their lengths as long as `'a`.
pub(super) unsafe fn read_context<'a>(view: *const RuleContextView) -> Result<RuleContext<'a>> {
    // SAFETY: the caller's promise.
    unsafe {
        let view = required(view.cast_mut(), "the context")?;
        Ok(RuleContext {
            step: view.step,
            observation: view.observation.as_slice(),
            proposed: view.proposed.as_slice(),
            previous: (!view.previous.pointer.is_null()).then(|| view.previous.as_slice()),
            values: view.values.as_slice(),
            greedy_values: view.greedy_values.as_slice(),
            forward_values: view.forward_values.as_slice(),
            discount: view.discount,
            phase: match view.phase {
                phase::FORWARD => Phase::Forward,
                phase::RESET => Phase::Reset,
                other => return Err(Error::invalid_argument(format!("there is no phase {other}"))),
            },
            ..RuleContext::default()
        })
    }
}

unsafe extern "C" fn evaluate<T: AbortRule>(
    instance: *mut Instance,
    context: *const RuleContextView,
    view: *mut VerdictView,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe { call::<T>(instance, |holder| judge(&holder.value, &read_context(context)?, view)) }
}

/// Lets a rule judge, and writes what it says.
///
/// # Safety
/// The view is null or valid, and so is its place for the reason.
pub(super) unsafe fn judge<T: AbortRule>(
    rule: &T,
    context: &RuleContext<'_>,
    view: *mut VerdictView,
) -> Result<()> {
    // SAFETY: the caller's promise.
    unsafe {
        let view = required(view, "the place for the verdict")?;
        let room: &mut [u8] = if view.reason.is_null() {
            &mut []
        } else {
            std::slice::from_raw_parts_mut(view.reason, view.reason_capacity)
        };
        let mut reason = Reason::new(room);
        let judged = rule.evaluate(context, &mut reason)?;
        view.reason_length = reason.len();
        view.score = judged.score;
        view.verdict = match judged.verdict {
            Verdict::Allow => verdict::ALLOW,
            Verdict::Reject => verdict::REJECT,
        };
        Ok(())
    }
}

impl Rows for RowSink {
    fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
        // SAFETY: the function is the host's and is given its own context; the coefficients live for the call.
        match unsafe { (self.push)(self.context, coefficients.as_ptr(), coefficients.len(), bound) } {
            status::OK => Ok(()),
            _ => Err(Error::invalid_argument(format!(
                "the host refused a row with {} coefficients and the bound {bound}",
                coefficients.len()
            ))),
        }
    }
}

unsafe extern "C" fn linearise<T: AbortRule>(
    instance: *mut Instance,
    context: *const RuleContextView,
    gradients: Floats,
    rows: *const RowSink,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let mut rows = *required(rows.cast_mut(), "the place for the rows")?;
            holder.value.linearise(&read_context(context)?, gradients.as_slice(), &mut rows)
        })
    }
}

unsafe extern "C" fn observe<T: AbortRule>(
    instance: *mut Instance,
    decision: *const ObservedDecisionView,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let view = required(decision.cast_mut(), "the decision")?;
            holder.value.observe(&ObservedDecision {
                step: view.step,
                aborted: view.aborted != 0,
                action: view.action.as_slice(),
            })
        })
    }
}

unsafe extern "C" fn reset_signal<T: ResetTask>(
    instance: *mut Instance,
    observation: Floats,
    action: Floats,
    next_observation: Floats,
    view: *mut ResetSignalView,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let (now, then) = (observation.as_slice(), next_observation.as_slice());
            let signal = holder.value.evaluate(now, action.as_slice(), then)?;
            *required(view, "the place for the signal")? =
                ResetSignalView { reward: signal.reward, in_reset_set: u32::from(signal.in_reset_set) };
            Ok(())
        })
    }
}

unsafe extern "C" fn observe_start<T: ResetTask>(instance: *mut Instance, observation: Floats) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe { call::<T>(instance, |holder| holder.value.observe_start(observation.as_slice())) }
}
