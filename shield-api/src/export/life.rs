//! The life that every kind shares, and the one place where a call crosses from the tables into safe Rust.

use std::{
    any::Any,
    cell::{Cell, RefCell},
    ffi::c_void,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Once,
};

use crate::{
    Checkpoint, EnvironmentSpec, Error, ErrorKind, Host, Plugin, PluginConfig, Result, Setup, Space, Spaces,
    abi::{CreateArguments, Instance, LifeTable, PositionView, SpaceView, Text, Writer, space_kind, status},
};

/// What stands behind the pointer to an instance.
pub(super) struct Holder<T> {
    pub(super) value: T,
    /// What the last answer to `spec` pointed into.
    pub(super) spec: Option<EnvironmentSpec>,
    error: Option<Error>,
    has_panicked: bool,
}

thread_local! {
    /// Why the last `create` of this thread failed: there is no instance yet that could keep it.
    static CREATE_ERROR: RefCell<Option<Error>> = const { RefCell::new(None) };
    /// What the last panic of this thread said, until the trampoline takes it.
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
    /// Whether this thread has made an instance: then it is the host's, and a panic on it ends in a trampoline.
    static IS_HOSTS: Cell<bool> = const { Cell::new(false) };
}

/// Keeps message and place of each panic for the trampoline, which reports them; so only those of the plugin's own threads are printed
/// as well. (And of a thread of the host on which no instance was made: to tell that apart would cost each call as much as all the
/// rest of the trampoline.)
fn install_panic_hook() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let previous = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            let place = info.location().map(|place| format!(" ({}:{})", place.file(), place.line()));
            let message = format!("{}{}", payload_text(info.payload()), place.unwrap_or_default());
            // A thread that is ending keeps nothing.
            let is_kept = PANIC.try_with(|kept| *kept.borrow_mut() = Some(message)).is_ok();
            if !is_kept || !IS_HOSTS.get() {
                previous(info);
            }
        }));
    });
    IS_HOSTS.set(true);
}

fn payload_text(payload: &dyn Any) -> &str {
    payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without a message")
}

/// Runs `body`; a panic becomes an error.
#[inline]
fn contained<R>(body: impl FnOnce() -> Result<R>) -> Result<R> {
    catch_unwind(AssertUnwindSafe(body)).unwrap_or_else(|payload| Err(panicked(payload)))
}

#[cold]
fn panicked(payload: Box<dyn Any + Send>) -> Error {
    let message = PANIC.take().unwrap_or_else(|| payload_text(&*payload).to_string());
    // Dropping a payload may panic in turn.
    std::mem::forget(payload);
    Error::new(ErrorKind::Panicked, message)
}

fn code(error: &Error) -> i32 {
    match error.kind() {
        ErrorKind::InvalidArgument => status::INVALID_ARGUMENT,
        ErrorKind::InvalidConfig => status::INVALID_CONFIG,
        ErrorKind::Unsupported => status::UNSUPPORTED,
        ErrorKind::Failed => status::FAILED,
        ErrorKind::Panicked => status::PANICKED,
    }
}

/// The way of every call after `create`: null check, refusal after a panic, `catch_unwind`, keeping of the error.
///
/// # Safety
/// `instance` is null or came from [`create`] for the same `T`, and no other call is using it.
#[inline]
pub(super) unsafe fn call<T>(
    instance: *mut Instance,
    body: impl FnOnce(&mut Holder<T>) -> Result<()>,
) -> i32 {
    // SAFETY: the caller's promise.
    let Some(holder) = (unsafe { instance.cast::<Holder<T>>().as_mut() }) else {
        return status::INVALID_ARGUMENT;
    };
    if holder.has_panicked {
        return status::PANICKED;
    }
    match contained(|| body(holder)) {
        Ok(()) => status::OK,
        Err(error) => holder.keep(error),
    }
}

impl<T> Holder<T> {
    /// Keeps the error for `last_error`; gives its status.
    #[cold]
    fn keep(&mut self, error: Error) -> i32 {
        let code = code(&error);
        self.has_panicked = error.kind() == ErrorKind::Panicked;
        self.error = Some(error);
        code
    }
}

#[cold]
fn null_pointer(what: &str) -> Error {
    Error::invalid_argument(format!("{what} is a null pointer"))
}

/// A pointer that must not be null, as a mutable reference.
///
/// # Safety
/// If not null, `pointer` is valid for reads and writes during the call and not used elsewhere.
pub(super) unsafe fn required<'a, T>(pointer: *mut T, what: &str) -> Result<&'a mut T> {
    // SAFETY: the caller's promise.
    unsafe { pointer.as_mut() }.ok_or_else(|| null_pointer(what))
}

/// A caller's buffer as a slice.
///
/// # Safety
/// If not null, `pointer` is valid for writing `length` values during the call and not used elsewhere.
pub(super) unsafe fn buffer<'a, T>(pointer: *mut T, length: usize, what: &str) -> Result<&'a mut [T]> {
    if pointer.is_null() {
        return Err(null_pointer(what));
    }
    // SAFETY: the caller's promise.
    Ok(unsafe { std::slice::from_raw_parts_mut(pointer, length) })
}

/// Copies as much of `text` as fits; returns its full length.
///
/// # Safety
/// If not null, `buffer` is valid for writing `capacity` bytes.
pub(super) unsafe fn copy_text(text: &str, buffer: *mut u8, capacity: usize) -> usize {
    if !buffer.is_null() {
        let take = text.floor_char_boundary(capacity.min(text.len()));
        // SAFETY: `take` is at most `capacity`; the two ranges belong to different owners.
        unsafe { std::ptr::copy_nonoverlapping(text.as_ptr(), buffer, take) };
    }
    text.len()
}

/// # Safety
/// The bounds are null or valid for `length` values.
unsafe fn read_space(view: &SpaceView, what: &str) -> Result<Option<Space>> {
    let length = view.length as usize;
    let space = match view.kind {
        space_kind::NONE => return Ok(None),
        space_kind::DISCRETE => Space::Discrete { n: length },
        space_kind::BOX if !view.low.is_null() && !view.high.is_null() => {
            // SAFETY: not null, and the caller's promise.
            let (low, high) = unsafe {
                (std::slice::from_raw_parts(view.low, length), std::slice::from_raw_parts(view.high, length))
            };
            Space::Box { low: low.to_vec(), high: high.to_vec() }
        }
        kind => {
            return Err(Error::invalid_argument(format!("the {what} space is of the unknown kind {kind}")));
        }
    };
    space.validate(what)?;
    Ok(Some(space))
}

/// # Safety
/// The pointers in `arguments` are valid as `CreateArguments` says.
unsafe fn make<T: Plugin>(arguments: *const CreateArguments) -> Result<T> {
    // SAFETY: the caller's promise.
    let arguments =
        unsafe { arguments.as_ref() }.ok_or_else(|| Error::invalid_argument("no arguments are given"))?;
    // SAFETY: the caller's promise; the host's table lives as long as the instance, which the host ends first.
    let (text, observation, action, host) = unsafe {
        (
            arguments.config.as_str(),
            read_space(&arguments.observation_space, "observation")?,
            read_space(&arguments.action_space, "action")?,
            arguments.host.as_ref(),
        )
    };
    let config = if text.trim().is_empty() { T::Config::default() } else { T::Config::parse(text)? };
    let (seed, threads, host) = (arguments.seed, arguments.threads.max(1) as usize, Host::from_table(host));
    let setup = match (observation, action) {
        (Some(observation), Some(action)) => {
            Setup::with_spaces(seed, threads, host, Spaces { observation, action })
        }
        _ => Setup::new(seed, threads, host),
    };
    T::create(config, &setup).map_err(|error| error.located_in(text))
}

unsafe extern "C" fn create<T: Plugin>(
    arguments: *const CreateArguments,
    instance: *mut *mut Instance,
) -> i32 {
    install_panic_hook();
    let made = contained(|| {
        // SAFETY: the host's promise in `LifeTable::create`.
        let slot = unsafe { required(instance, "the place for the instance") }?;
        // SAFETY: as above.
        let value = unsafe { make::<T>(arguments) }?;
        let holder = Holder { value, spec: None, error: None, has_panicked: false };
        *slot = Box::into_raw(Box::new(holder)).cast();
        Ok(())
    });
    match made {
        Ok(()) => status::OK,
        Err(error) => {
            let code = code(&error);
            CREATE_ERROR.with_borrow_mut(|kept| *kept = Some(error));
            code
        }
    }
}

unsafe extern "C" fn destroy<T: Plugin>(instance: *mut Instance) {
    if instance.is_null() {
        return;
    }
    // SAFETY: the host gives back what `create::<T>` made, once.
    let holder = unsafe { Box::from_raw(instance.cast::<Holder<T>>()) };
    // A panic while dropping has nobody left to report to; the instance is gone either way.
    contained(|| {
        drop(holder);
        Ok(())
    })
    .ok();
}

unsafe extern "C" fn save<T: Checkpoint>(instance: *mut Instance, writer: *const Writer) -> i32 {
    // SAFETY: the host's promise in `LifeTable`.
    unsafe {
        call::<T>(instance, |holder| {
            let mut bytes = Vec::new();
            holder.value.save(&mut bytes)?;
            hand_over(writer, &bytes, "the saved state")
        })
    }
}

/// Gives bytes to the host.
///
/// # Safety
/// `writer` is null or the host's, valid during the call.
pub(super) unsafe fn hand_over(writer: *const Writer, bytes: &[u8], what: &str) -> Result<()> {
    // SAFETY: the caller's promise; the function is the host's and is given its own context; the bytes live for the call.
    let code = unsafe {
        let writer = required(writer.cast_mut(), "the writer")?;
        (writer.write)(writer.context, bytes.as_ptr(), bytes.len())
    };
    match code {
        status::OK => Ok(()),
        code => Err(Error::failed(format!("the host could not take {what} (status {code})"))),
    }
}

unsafe extern "C" fn load<T: Checkpoint>(instance: *mut Instance, bytes: *const u8, length: usize) -> i32 {
    // SAFETY: the host's promise in `LifeTable`.
    unsafe {
        call::<T>(instance, |holder| {
            // SAFETY: null only with length 0, else valid for `length` bytes.
            let bytes = if bytes.is_null() { &[] } else { std::slice::from_raw_parts(bytes, length) };
            holder.value.load(bytes)
        })
    }
}

unsafe extern "C" fn last_error<T>(
    instance: *mut Instance,
    buffer: *mut u8,
    capacity: usize,
    position: *mut PositionView,
) -> usize {
    let copy = |error: Option<&Error>| {
        let Some(error) = error else { return 0 };
        // SAFETY: the host's promise in `LifeTable::last_error`.
        unsafe {
            if let (Some(slot), Some(found)) = (position.as_mut(), error.position()) {
                *slot = PositionView { line: found.line, column: found.column };
            }
            copy_text(error.message(), buffer, capacity)
        }
    };
    // SAFETY: as above; null asks for the failed creation.
    match unsafe { instance.cast::<Holder<T>>().as_ref() } {
        Some(holder) => copy(holder.error.as_ref()),
        None => CREATE_ERROR.with_borrow(|error| copy(error.as_ref())),
    }
}

unsafe extern "C" fn no_extension(_name: Text) -> *const c_void {
    std::ptr::null()
}

pub(super) const fn table<T: Plugin>() -> LifeTable {
    LifeTable {
        create: create::<T>,
        destroy: destroy::<T>,
        save: save::<T>,
        load: load::<T>,
        last_error: last_error::<T>,
        get_extension: no_extension,
    }
}

impl SpaceView {
    /// Borrows a space.
    pub fn new(space: &Space) -> Self {
        match space {
            Space::Box { low, high } => Self {
                kind: space_kind::BOX,
                length: low.len() as u32,
                low: low.as_ptr(),
                high: high.as_ptr(),
            },
            Space::Discrete { n } => Self { kind: space_kind::DISCRETE, length: *n as u32, ..Self::none() },
        }
    }

    /// No space.
    pub const fn none() -> Self {
        Self { kind: space_kind::NONE, length: 0, low: std::ptr::null(), high: std::ptr::null() }
    }

    /// Copies the space out; `None` if there is none.
    ///
    /// # Errors
    /// An unknown kind, missing bounds, or a space that cannot exist.
    ///
    /// # Safety
    /// The bounds are null or valid for `length` values.
    pub unsafe fn read(&self, what: &str) -> Result<Option<Space>> {
        // SAFETY: the caller's promise.
        unsafe { read_space(self, what) }
    }
}
