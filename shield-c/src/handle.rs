//! A shield behind a pointer.

use std::{
    ffi::CString,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
};

use runtime::{
    drop_in::DropIn,
    experiment::DropInFile,
    plugin::{Registry, SearchPath},
};

use crate::errors;

/// A drop-in shield, and what C may look at.
pub struct Shield {
    pub drop_in: DropIn,
    pub reason: CString,
    /// What a buffer holds after an error: the action of the space that is nearest to 0.
    rest: Vec<f32>,
    is_poisoned: bool,
}

/// Opens the shield that a file describes. Plugins are looked for beside the library, too.
pub fn open(config: &Path, library_folder: Option<&Path>) -> Result<Shield, String> {
    let file = DropInFile::read(config, &[]).map_err(|error| error.to_string())?;
    let search_path = library_folder.map_or_else(SearchPath::from_environment, SearchPath::beside);
    let registry = Registry::scan(&search_path);
    let drop_in = DropIn::open(&registry, &file, None).map_err(|error| error.to_string())?;
    let mut rest = vec![0.0; drop_in.spaces().action_len()];
    drop_in.spaces().action.clamp(&mut rest);
    Ok(Shield { drop_in, reason: CString::default(), rest, is_poisoned: false })
}

/// Runs `body`; an error or a panic in it is kept for `shield_last_error`.
pub fn guarded<R>(body: impl FnOnce() -> Result<R, String>) -> Option<R> {
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(value)) => {
            errors::keep("");
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
    pub fn with<R>(&mut self, body: impl FnOnce(&mut DropIn) -> Result<R, String>) -> Option<R> {
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
        let length = action.len().min(self.rest.len());
        action[..length].copy_from_slice(&self.rest[..length]);
        action[length..].fill(0.0);
    }
}
