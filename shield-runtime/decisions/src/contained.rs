//! Libraries that panic where they should refuse what they read: their panic becomes an error.

use std::{
    cell::{Cell, RefCell},
    panic::{self, AssertUnwindSafe},
    sync::Once,
};

use anyhow::{Result, anyhow};

thread_local! {
    static IS_CONTAINED: Cell<bool> = const { Cell::new(false) };
    static SAID: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Runs `body`, whose panic is an error with the panic's words. It is not printed, and what `body` changed is not used any more.
pub(crate) fn contained<R>(body: impl FnOnce() -> R) -> Result<R> {
    keep_what_is_said();
    let before = IS_CONTAINED.replace(true);
    let done = panic::catch_unwind(AssertUnwindSafe(body));
    IS_CONTAINED.set(before);
    done.map_err(|_| anyhow!("{}", SAID.take().unwrap_or_else(|| "a panic without a message".into())))
}

/// Every other panic is still the affair of the hook that was there before.
fn keep_what_is_said() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let previous = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            // A thread that is ending contains nothing.
            if IS_CONTAINED.try_with(Cell::get).unwrap_or(false) {
                let message = info.payload_as_str().unwrap_or("a panic without a message");
                SAID.set(Some(message.to_owned()));
            } else {
                previous(info);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contained_panic_is_an_error_with_its_words() {
        let error = contained(|| panic!("page {} is torn", 3)).unwrap_err();
        assert_eq!(error.to_string(), "page 3 is torn");
        assert_eq!(contained(|| 7).unwrap(), 7);
    }
}
