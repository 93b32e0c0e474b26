//! The last error of each thread, as C reads it.

use std::{
    cell::RefCell,
    ffi::{CString, c_char},
    fmt::Display,
};

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Remembers an error of this thread.
pub fn keep(error: impl Display) {
    LAST.set(text(error));
}

/// Forgets it. Calls that succeed one after the other allocate nothing for it.
pub fn clear() {
    LAST.with_borrow_mut(forget);
}

/// Empties a text, if it is not empty already: an empty one takes memory, too.
pub fn forget(text: &mut CString) {
    if !text.is_empty() {
        *text = CString::default();
    }
}

/// The last error of this thread: valid until its next call.
pub fn last() -> *const c_char {
    LAST.with_borrow(|last| last.as_ptr())
}

/// A text without what C would take for its end.
pub fn text(text: impl Display) -> CString {
    let mut bytes = text.to_string().into_bytes();
    bytes.retain(|byte| *byte != 0);
    CString::new(bytes).unwrap_or_default()
}
