//! A shield behind a pointer.

use std::{
    ffi::CString,
    fmt::Display,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
};

use runtime::{
    controller::Controller,
    drop_in::DropIn,
    experiment::DropInFile,
    plugin::{Registry, SearchPath},
    shield::write_safe,
};

use crate::errors;

/// A drop-in shield, and what C may look at.
pub struct Shield {
    pub drop_in: DropIn,
    pub reason: CString,
    /// The finding that was asked for last.
    pub finding: CString,
    /// What a buffer holds after an error: the fallback action, also when the shield itself can no more be asked.
    rest: Vec<f32>,
    is_poisoned: bool,
}

/// Opens the shield that a file describes, with a reset agent that the caller gives if the file names none. Plugins are looked for beside the
/// library, too.
pub fn open(
    config: &Path,
    library_folder: Option<&Path>,
    reset: Option<Controller>,
) -> Result<Shield, String> {
    let file = DropInFile::read(config, &[]).map_err(|error| error.to_string())?;
    let search_path = library_folder.map_or_else(SearchPath::from_environment, SearchPath::beside);
    let registry = Registry::scan(&search_path);
    let opened = match reset {
        None => file.open(&registry, None),
        Some(reset) => file.open_with(&registry, None, reset),
    };
    let drop_in = opened.map_err(|error| error.to_string())?;
    let rest = drop_in.fallback_action().to_vec();
    Ok(Shield { drop_in, reason: CString::default(), finding: CString::default(), rest, is_poisoned: false })
}

/// Runs `body`; an error or a panic in it is kept for `shield_last_error`.
pub fn guarded<R, E: Display>(body: impl FnOnce() -> Result<R, E>) -> Option<R> {
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(value)) => {
            errors::clear();
            Some(value)
        }
        Ok(Err(error)) => {
            errors::keep(error);
            None
        }
        Err(panic) => {
            let words = panic.downcast_ref::<String>().map(String::as_str);
            let words = words.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a word");
            errors::keep(format!("the shield panicked: {words}"));
            None
        }
    }
}

impl Shield {
    /// As [`guarded`]; after a panic nothing is done with the shield any more.
    pub fn with<R, E: Display>(&mut self, body: impl FnOnce(&mut DropIn) -> Result<R, E>) -> Option<R> {
        if std::mem::replace(&mut self.is_poisoned, true) {
            errors::keep("the shield panicked before; close it");
            return None;
        }
        let (drop_in, is_poisoned) = (&mut self.drop_in, &mut self.is_poisoned);
        guarded(|| {
            let result = body(drop_in);
            *is_poisoned = false;
            result
        })
    }

    /// Makes an action harmless that nobody has allowed.
    pub fn rest(&self, action: &mut [f32]) {
        write_safe(&self.rest, action);
    }
}
