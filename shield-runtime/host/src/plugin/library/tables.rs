//! Checks of a library's tables, word by word, before a Rust reference to them exists: a table with a null function pointer, or
//! one that is shorter than this host thinks, must never become a `&Table`.

use std::path::Path;

use shield_api::{
    abi::{
        ABI_MAJOR, AbortRuleTable, CostsTable, EnvironmentTable, LearnerTable, PluginDescriptor,
        PluginLibrary, PolicyTable, RenderTable, ResetTaskTable, StartsTable, SuccessCriticTable,
        UndoRuleTable, WeightsTable,
    },
    manifest::{Manifest, decode},
};

use super::{Kind, LoadedPlugin, PluginError, Table};

/// A table that consists of its size and of function pointers, as all of them do.
///
/// # Safety
/// The type is `repr(C)`: a `usize`, then exactly `FUNCTIONS.len()` function pointers in this order.
pub(in crate::plugin) unsafe trait FunctionTable: Sized + 'static {
    /// How messages call the table.
    const NAME: &'static str;
    /// The functions, in order.
    const FUNCTIONS: &'static [&'static str];
}

macro_rules! function_tables {
    ($( $table:ty, $name:literal: [$($function:literal),*]; )*) => { $(
        // SAFETY: the assertion below; the order is that of `shield_api::abi`.
        unsafe impl FunctionTable for $table {
            const NAME: &'static str = $name;
            const FUNCTIONS: &'static [&'static str] = &[$($function),*];
        }
        const _: () = assert!(
            size_of::<$table>() == (1 + <$table as FunctionTable>::FUNCTIONS.len()) * size_of::<usize>()
        );
    )* };
}

function_tables! {
    EnvironmentTable, "environment":
        ["create", "destroy", "save", "load", "last_error", "get_extension", "spec", "reset", "step"];
    LearnerTable, "learner":
        ["create", "destroy", "save", "load", "last_error", "get_extension", "info", "act", "q_values", "q_gradients",
         "update"];
    PolicyTable, "policy": ["create", "destroy", "save", "load", "last_error", "get_extension", "act"];
    AbortRuleTable, "abort-rule":
        ["create", "destroy", "save", "load", "last_error", "get_extension", "needs", "evaluate", "linearise", "observe"];
    ResetTaskTable, "reset-task":
        ["create", "destroy", "save", "load", "last_error", "get_extension", "evaluate", "observe_start"];
    StartsTable, "starts": ["name", "reset_to"];
    CostsTable, "costs": ["kind", "present"];
    RenderTable, "render": ["size", "render"];
    WeightsTable, "weights": ["weights", "policy"];
    SuccessCriticTable, "success-critic": ["update"];
    UndoRuleTable, "undo-rule": ["evaluate", "linearise", "observe_attempt"];
}

/// Checks pointer and size of a struct that begins with its own size.
///
/// # Safety
/// The pointer is null, or points to a `usize` that is the size of what lies there.
unsafe fn check_size<T>(pointer: *const T, what: &str) -> Result<(), String> {
    if pointer.is_null() {
        return Err(format!("its {what} is a null pointer"));
    }
    if !pointer.is_aligned() {
        return Err(format!("its {what} lies at the address {pointer:p}, which is not aligned"));
    }
    // SAFETY: not null, aligned for `T` and so for `usize`; the caller's promise.
    let size = unsafe { pointer.cast::<usize>().read() };
    if size == size_of::<T>() {
        Ok(())
    } else {
        Err(format!("its {what} says struct_size {size}, expected {}", size_of::<T>()))
    }
}

/// A table of functions as a reference, if it is complete.
///
/// # Safety
/// The pointer is null, or points to a `usize` that is the size of what lies there, in a library that is never unloaded and
/// never writes to it.
pub(in crate::plugin) unsafe fn function_table<T: FunctionTable>(
    pointer: *const T,
) -> Result<&'static T, String> {
    // SAFETY: the caller's promise.
    unsafe { check_size(pointer, &format!("{} table", T::NAME)) }?;
    // SAFETY: the size was just compared, and the type consists of so many words.
    let words = unsafe { std::slice::from_raw_parts(pointer.cast::<usize>(), 1 + T::FUNCTIONS.len()) };
    match T::FUNCTIONS.iter().zip(&words[1..]).find(|(_, word)| **word == 0) {
        Some((function, _)) => {
            Err(format!("`{function}` of its {} table is a null function pointer", T::NAME))
        }
        // SAFETY: no function pointer is null, and the caller's promise.
        None => Ok(unsafe { &*pointer }),
    }
}

/// Checks the list of a library and everything that it points to, against the manifests in the file's section.
pub(super) fn check_library(
    path: &Path,
    list: *const PluginLibrary,
    manifests: Vec<Manifest>,
) -> Result<Vec<LoadedPlugin>, PluginError> {
    let wrong = |what: String| PluginError::Table { path: path.into(), what };
    // SAFETY: the door's function returns the address of a constant of a library that is never unloaded.
    let list = unsafe {
        check_size(list, "list of plugins").map_err(wrong)?;
        &*list
    };
    if list.abi_major != ABI_MAJOR {
        let id = manifests.first().map(|manifest| manifest.id.clone()).unwrap_or_default();
        return Err(PluginError::Interface { path: path.into(), id, abi: (list.abi_major, list.abi_minor) });
    }
    if list.plugin_count != manifests.len() {
        return Err(wrong(format!(
            "it lists {} plugins, the manifest section of its file {}",
            list.plugin_count,
            manifests.len()
        )));
    }
    let mut remaining = manifests;
    (0..list.plugin_count)
        .map(|index| {
            // SAFETY: the list says that so many descriptors lie there, and the section agrees.
            let descriptor = unsafe {
                let pointer = list.plugins.wrapping_add(index);
                check_size(pointer, &format!("descriptor {index}")).map_err(wrong)?;
                &*pointer
            };
            check_descriptor(path, descriptor, &mut remaining)
        })
        .collect()
}

fn check_descriptor(
    path: &Path,
    descriptor: &'static PluginDescriptor,
    remaining: &mut Vec<Manifest>,
) -> Result<LoadedPlugin, PluginError> {
    // SAFETY: the text is a constant of the library.
    let text = unsafe { descriptor.manifest.as_str() };
    let told = decode(text).map_err(|reason| PluginError::BadManifest { path: path.into(), reason })?;
    let differs =
        |what: String| PluginError::ManifestDiffers { path: path.into(), id: told.id.clone(), what };
    let position = remaining.iter().position(|manifest| manifest.id == told.id && manifest.kind == told.kind);
    let written = remaining
        .swap_remove(position.ok_or_else(|| differs("the file lists no plugin of that id and kind".into()))?);
    if let Some(what) = first_difference(&written, &told) {
        return Err(differs(what));
    }
    let kind =
        Kind::from_name(&told.kind).filter(|kind| kind.code() == descriptor.kind).ok_or_else(|| {
            differs(format!("it says the kind {:?} and the number {}", told.kind, descriptor.kind))
        })?;
    let table = check_table(descriptor, kind).map_err(|what| PluginError::Table {
        path: path.into(),
        what: format!("plugin {:?}: {what}", told.id),
    })?;
    Ok(LoadedPlugin { manifest: written, kind, table })
}

/// The one table of a descriptor.
fn check_table(descriptor: &'static PluginDescriptor, kind: Kind) -> Result<Table, String> {
    let set: Vec<Kind> = [
        (Kind::Environment, descriptor.environment.is_null()),
        (Kind::Learner, descriptor.learner.is_null()),
        (Kind::Policy, descriptor.policy.is_null()),
        (Kind::AbortRule, descriptor.abort_rule.is_null()),
        (Kind::ResetTask, descriptor.reset_task.is_null()),
    ]
    .into_iter()
    .filter_map(|(kind, is_null)| (!is_null).then_some(kind))
    .collect();
    // Later kinds have no place of their own in the descriptor, which is frozen.
    let expected = if kind == Kind::SuccessCritic { Kind::Learner } else { kind };
    if set != [expected] {
        let names: Vec<&str> = set.iter().map(|kind| kind.name()).collect();
        return Err(format!("the {expected} table alone must be set, but these are: [{}]", names.join(", ")));
    }
    // SAFETY: tables are constants of a library that is never unloaded, and begin with their size.
    unsafe {
        Ok(match kind {
            Kind::Environment => Table::Environment(function_table(descriptor.environment)?),
            Kind::Learner => Table::Learner(function_table(descriptor.learner)?),
            Kind::Policy => Table::Policy(function_table(descriptor.policy)?),
            Kind::AbortRule => Table::AbortRule(function_table(descriptor.abort_rule)?),
            Kind::ResetTask => Table::ResetTask(function_table(descriptor.reset_task)?),
            Kind::SuccessCritic => Table::SuccessCritic(function_table(descriptor.learner)?),
        })
    }
}

fn first_difference(written: &Manifest, told: &Manifest) -> Option<String> {
    let parts = |manifest: &Manifest| {
        [
            ("version", manifest.version.clone()),
            ("interface", format!("{}.{}", manifest.abi.0, manifest.abi.1)),
            ("language", manifest.language.clone()),
            ("panic", manifest.panic.clone()),
            ("authors", manifest.authors.clone()),
            ("license", manifest.license.clone()),
            ("description", manifest.description.clone()),
            ("deterministic", manifest.deterministic.to_string()),
            ("configuration", format!("{:?}", manifest.fields)),
        ]
    };
    let mut pairs = parts(written).into_iter().zip(parts(told));
    pairs
        .find(|(left, right)| left != right)
        .map(|((name, left), (_, right))| format!("{name}: {left:?} in the file, {right:?} once loaded"))
}
