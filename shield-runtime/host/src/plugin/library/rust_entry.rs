//! The door for Rust libraries: `abi_stable` compares the layout of every table before anything is called.

use std::path::Path;

use abi_stable::{
    StableAbi,
    abi_stability::abi_checking::{
        AbiInstability, AbiInstabilityError, AbiInstabilityErrors, check_layout_compatibility,
    },
    library::{AbiHeader, AbiHeaderRef, LibHeader, LibraryError, ROOT_MODULE_LOADER_NAME_WITH_NUL},
    type_layout::TLFieldOrFunction,
};
use shield_api::abi::{PluginLibrary, PluginModuleRef};

use super::PluginError;

/// Whether the library has this door at all.
pub(super) fn exists(library: &'static libloading::Library) -> bool {
    // SAFETY: the address is not used.
    unsafe { library.get::<*const ()>(ROOT_MODULE_LOADER_NAME_WITH_NUL.as_bytes()) }.is_ok()
}

/// The list of plugins, after the layouts were compared.
pub(super) fn enter(
    path: &Path,
    library: &'static libloading::Library,
) -> Result<*const PluginLibrary, PluginError> {
    // SAFETY: a symbol of this name is the header of a root module, in every version of `abi_stable`; its first fields, all that
    // is read before `upgrade` has compared them, never change. The library is never unloaded.
    let symbol = unsafe { library.get::<AbiHeaderRef>(ROOT_MODULE_LOADER_NAME_WITH_NUL.as_bytes()) };
    let symbol = symbol.map_err(|_| PluginError::NoDoor {
        path: path.into(),
        language: "rust".into(),
        symbol: "_1as_0lib_1header_0root_bmodule_bloader",
        remedy: "export it with `export_plugin!`; the C symbol is no way around the comparison of layouts",
    })?;
    let header = symbol.upgrade().map_err(|error| explain(path, &error, None))?;
    if header.layout().is_none() {
        return Err(PluginError::Unchecked { path: path.into() });
    }
    let module =
        header.init_root_module::<PluginModuleRef>().map_err(|error| explain(path, &error, Some(header)))?;
    Ok(module.library())
}

/// `abi_stable`'s own sentence about a layout is 20 to 30 KB long.
fn explain(path: &Path, error: &LibraryError, header: Option<&'static LibHeader>) -> PluginError {
    let path = path.to_path_buf();
    match error {
        LibraryError::IncompatibleVersionNumber { expected_version, actual_version, .. } => {
            PluginError::InterfaceCrate {
                path,
                found: actual_version.to_string(),
                expected: expected_version.to_string(),
            }
        }
        LibraryError::InvalidAbiHeader(found) => {
            PluginError::AbiStable { path, found: version(found), expected: version(&AbiHeader::VALUE) }
        }
        LibraryError::AbiInstability(_) => {
            let found = header.and_then(LibHeader::layout);
            let errors = found.and_then(|layout| {
                check_layout_compatibility(<PluginModuleRef as StableAbi>::LAYOUT, layout).err()
            });
            let difference = errors.as_ref().and_then(difference);
            PluginError::Layout { path, difference: difference.unwrap_or_else(|| "no field is named".into()) }
        }
        other => PluginError::Layout { path, difference: shortened(&other.to_string()) },
    }
}

fn version(header: &AbiHeader) -> String {
    format!("{}.{}", header.abi_major, header.abi_minor)
}

/// The difference that lies deepest: those above it follow from it.
fn difference(errors: &AbiInstabilityErrors) -> Option<String> {
    let first: &AbiInstabilityError =
        errors.errors.iter().filter(|error| !error.errs.is_empty()).max_by_key(|e| e.stack_trace.len())?;
    // A pointer's target, a function and a tuple's member are steps without a name of their own.
    let has_name = |name: &&str| !name.starts_with(|first: char| first.is_ascii_digit());
    let fields = first.stack_trace.iter().filter_map(|step| match &step.expected {
        TLFieldOrFunction::Field(field) => Some(field),
        TLFieldOrFunction::Function(_) => None,
    });
    let kind = fields.clone().next_back().map_or("the root module", |field| field.layout().name());
    let place: Vec<&str> = fields.map(|field| field.name()).filter(has_name).collect();
    let what: Vec<String> = first.errs.iter().take(3).map(describe).collect();
    Some(format!("in `{kind}`, at `{}`: {}", place.join("."), what.join("; ")))
}

fn describe(difference: &AbiInstability) -> String {
    match difference {
        AbiInstability::UnexpectedField(pair) => {
            format!("expected the field `{}`, found `{}`", pair.expected.name(), pair.found.name())
        }
        AbiInstability::FieldCountMismatch(pair) => {
            format!("expected {} fields, found {}", pair.expected, pair.found)
        }
        AbiInstability::Size(pair) => format!("expected {} bytes, found {}", pair.expected, pair.found),
        AbiInstability::Alignment(pair) => {
            format!("expected an alignment of {}, found {}", pair.expected, pair.found)
        }
        AbiInstability::Name(pair) => {
            format!("expected the type `{}`, found `{}`", pair.expected.name(), pair.found.name())
        }
        AbiInstability::Package(pair) => {
            format!("expected a type of the crate {}, found one of {}", pair.expected, pair.found)
        }
        other => shortened(&format!("{other:?}")),
    }
}

fn shortened(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ").chars().take(200).collect()
}
