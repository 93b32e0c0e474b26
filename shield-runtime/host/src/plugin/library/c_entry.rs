//! The door for everything that is not Rust: one C function that returns the list of plugins.

use std::path::Path;

use shield_api::abi::{ENTRY_SYMBOL, PluginLibrary};

use super::{PluginError, rust_entry};

/// The list of plugins, not checked yet.
pub(super) fn enter(
    path: &Path,
    library: &'static libloading::Library,
) -> Result<*const PluginLibrary, PluginError> {
    if rust_entry::exists(library) {
        return Err(PluginError::BadManifest {
            path: path.into(),
            reason: "it says that the library is written in C, but the library has the door of a Rust plugin"
                .into(),
        });
    }
    type Entry = unsafe extern "C" fn() -> *const PluginLibrary;
    // SAFETY: a symbol of this name is a function of this type: the name belongs to this interface and its major version.
    let entry = unsafe { library.get::<Entry>(ENTRY_SYMBOL) }.map_err(|_| PluginError::NoDoor {
        path: path.into(),
        language: "c".into(),
        symbol: ENTRY_SYMBOL,
        remedy: "define that function and give it default visibility (and `extern \"C\"` in C++)",
    })?;
    // SAFETY: as above; the function only returns the address of a constant.
    Ok(unsafe { entry() })
}
