//! What the wrappers of all kinds share: making, calling and ending an instance, and asking it what went wrong.

use std::{
    cell::OnceCell,
    ffi::c_void,
    panic::{AssertUnwindSafe, catch_unwind},
    ptr,
};

use shield_api::{
    Error, ErrorKind, Position, Result, Setup, Spaces,
    abi::{CreateArguments, Instance, LifeTable, PositionView, SpaceView, Status, Text, Writer, status},
    check_length,
};

use crate::plugin::{
    PluginError,
    library::{FunctionTable, function_table},
};

/// Room for a plugin's message at the first attempt, and the most that is ever asked for.
const MESSAGE_BYTES: usize = 1024;
const LONGEST_MESSAGE: usize = 64 * 1024;

/// An instance and the functions that every kind has.
#[derive(Debug)]
pub(super) struct Handle {
    id: Box<str>,
    instance: *mut Instance,
    life: &'static LifeTable,
    /// What the panic said that took the instance out of service.
    panic: OnceCell<String>,
}

// SAFETY: the interface says that an instance may be called by any thread, one at a time. A handle is not `Sync`.
unsafe impl Send for Handle {}

/// A plugin's extension of this name; `None` if it has none.
///
/// # Safety
/// Under this name a plugin gives a `T`, a constant of its library.
pub(super) unsafe fn extension<T: FunctionTable>(
    id: &str,
    life: &LifeTable,
    name: &str,
) -> Result<Option<&'static T>, PluginError> {
    // SAFETY: the name lives for the call.
    let extension = unsafe { (life.get_extension)(Text::new(name)) };
    if extension.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller's promise.
    let checked = unsafe { function_table::<T>(extension.cast()) };
    checked.map(Some).map_err(|what| described_wrongly(id, what))
}

impl Handle {
    /// Makes an instance. The table's functions must be those of one plugin, which `Library::load` has checked.
    pub(super) fn create(
        id: &str,
        life: &'static LifeTable,
        config: &str,
        setup: &Setup,
    ) -> Result<Self, PluginError> {
        let spaces = setup.spaces().ok();
        let arguments = CreateArguments {
            struct_size: size_of::<CreateArguments>(),
            config: Text::new(config),
            seed: setup.seed,
            threads: u32::try_from(setup.threads).unwrap_or(u32::MAX),
            observation_space: spaces.map_or(SpaceView::none(), |spaces| SpaceView::new(&spaces.observation)),
            action_space: spaces.map_or(SpaceView::none(), |spaces| SpaceView::new(&spaces.action)),
            host: setup.host.table().map_or(ptr::null(), ptr::from_ref),
        };
        let mut instance = ptr::null_mut();
        // SAFETY: everything in the arguments lives for the call; the host's table is a constant.
        let code = unsafe { (life.create)(&arguments, &mut instance) };
        if code != status::OK {
            let fault = Fault::read(life, ptr::null_mut(), code);
            let id = id.to_string();
            return Err(match fault.kind {
                ErrorKind::InvalidConfig => {
                    PluginError::Config { id, message: fault.message, position: fault.position }
                }
                kind => PluginError::Create { id, kind, message: fault.message },
            });
        }
        if instance.is_null() {
            return Err(described_wrongly(id, "`create` reports success, but made no instance"));
        }
        Ok(Self { id: id.into(), instance, life, panic: OnceCell::new() })
    }

    /// Calls a function of the instance's table, unless a panic has taken the instance out of service.
    #[inline]
    pub(super) fn call(&self, function: impl FnOnce(*mut Instance) -> Status) -> Result<()> {
        if let Some(panic) = self.panic.get() {
            return Err(self.out_of_service(panic));
        }
        match function(self.instance) {
            status::OK => Ok(()),
            code => Err(self.failure(code)),
        }
    }

    #[cold]
    fn out_of_service(&self, panic: &str) -> Error {
        let message = format!("is out of service since it panicked: {panic}; make a new instance");
        self.error(ErrorKind::Panicked, message)
    }

    #[cold]
    fn failure(&self, code: Status) -> Error {
        let fault = Fault::read(self.life, self.instance, code);
        if fault.kind == ErrorKind::Panicked {
            self.panic.get_or_init(|| fault.message.clone());
            return self.error(ErrorKind::Panicked, format!("panicked: {}", fault.message));
        }
        let error = self.error(fault.kind, fault.message);
        match fault.position {
            Some(position) => error.at(position.line, position.column),
            None => error,
        }
    }

    /// An error that names the plugin.
    pub(super) fn error(&self, kind: ErrorKind, message: impl AsRef<str>) -> Error {
        Error::new(kind, format!("{}: {}", self.id, message.as_ref()))
    }

    /// The plugin answered what it must not.
    #[cold]
    pub(super) fn broken(&self, message: impl AsRef<str>) -> Error {
        self.error(ErrorKind::Failed, message)
    }

    /// Refuses an argument of the wrong length before the plugin sees it.
    #[inline]
    pub(super) fn require_length(&self, what: &str, slice: &[f32], expected: usize) -> Result<()> {
        check_length(what, slice, expected).map_err(|error| self.named(&error))
    }

    /// Refuses an observation or an action of another length than that of the spaces.
    #[inline]
    pub(super) fn require_step(&self, spaces: &Spaces, observation: &[f32], action: &[f32]) -> Result<()> {
        self.require_length("observation", observation, spaces.observation_len())?;
        self.require_length("action", action, spaces.action_len())
    }

    /// The same error, naming the plugin.
    #[cold]
    fn named(&self, error: &Error) -> Error {
        self.error(error.kind(), error.message())
    }

    /// Refuses an output with a value that is NaN or infinite.
    #[inline]
    pub(super) fn require_finite(&self, function: &str, what: &str, values: &[f32]) -> Result<()> {
        // Without an early exit, so that the compiler can look at many values at once.
        if values.iter().fold(true, |is_finite, value| is_finite & value.is_finite()) {
            return Ok(());
        }
        Err(self.not_finite(function, what, values))
    }

    #[cold]
    fn not_finite(&self, function: &str, what: &str, values: &[f32]) -> Error {
        let index = values.iter().position(|value| !value.is_finite()).unwrap_or(0);
        self.broken(format!("`{function}` gave {} for {what}[{index}]", values[index]))
    }

    pub(super) fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        // SAFETY: the instance is this handle's.
        self.written(bytes, |instance, writer| unsafe { (self.life.save)(instance, writer) })
    }

    /// Appends what a function of the instance's tables writes; nothing if it fails.
    pub(super) fn written(
        &self,
        bytes: &mut Vec<u8>,
        function: impl FnOnce(*mut Instance, *const Writer) -> Status,
    ) -> Result<()> {
        let before = bytes.len();
        // Writer and context live for the call.
        let writer = Writer { context: ptr::from_mut(bytes).cast(), write: append };
        let written = self.call(|instance| function(instance, &writer));
        if written.is_err() {
            bytes.truncate(before);
        }
        written
    }

    pub(super) fn load(&mut self, bytes: &[u8]) -> Result<()> {
        // SAFETY: the instance is this handle's; the bytes live for the call.
        self.call(|instance| unsafe { (self.life.load)(instance, bytes.as_ptr(), bytes.len()) })
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: `create` made the instance, and nothing uses it any more.
        unsafe { (self.life.destroy)(self.instance) }
    }
}

/// The spaces in which an instance of any kind but an environment works.
pub(in crate::plugin) fn spaces(id: &str, setup: &Setup) -> Result<Spaces, PluginError> {
    setup.spaces().cloned().map_err(|_| PluginError::Create {
        id: id.into(),
        kind: ErrorKind::InvalidArgument,
        message: "the host must give it the spaces of the environment".into(),
    })
}

/// The error of an instance that says of itself what cannot be.
pub(super) fn described_wrongly(id: &str, message: impl Into<String>) -> PluginError {
    PluginError::Create { id: id.into(), kind: ErrorKind::Failed, message: message.into() }
}

/// An error of a new instance's first call, as one of its making.
pub(in crate::plugin) fn while_creating(id: &str, error: &Error) -> PluginError {
    let message = error.message().strip_prefix(&format!("{id}: ")).unwrap_or(error.message()).to_string();
    PluginError::Create { id: id.into(), kind: error.kind(), message }
}

/// What a plugin says of its last failure.
struct Fault {
    kind: ErrorKind,
    message: String,
    position: Option<Position>,
}

impl Fault {
    /// Asks the instance, or the plugin for the failed `create` of this thread if it is null.
    fn read(life: &LifeTable, instance: *mut Instance, code: Status) -> Self {
        let kind = match code {
            status::INVALID_ARGUMENT => ErrorKind::InvalidArgument,
            status::INVALID_CONFIG => ErrorKind::InvalidConfig,
            status::UNSUPPORTED => ErrorKind::Unsupported,
            status::PANICKED => ErrorKind::Panicked,
            _ => ErrorKind::Failed,
        };
        let mut view = PositionView::default();
        let mut buffer = vec![0; MESSAGE_BYTES];
        let mut ask = |buffer: &mut [u8]| {
            // SAFETY: the buffer is as long as said; the instance is null or this handle's.
            unsafe { (life.last_error)(instance, buffer.as_mut_ptr(), buffer.len(), &mut view) }
        };
        let mut length = ask(&mut buffer);
        if length > buffer.len() {
            buffer.resize(length.min(LONGEST_MESSAGE), 0);
            length = ask(&mut buffer);
        }
        buffer.truncate(length);
        let mut message = String::from_utf8_lossy(&buffer).into_owned();
        if message.is_empty() {
            message = format!("failed without saying why (status {code})");
        } else if !(status::INVALID_ARGUMENT..=status::PANICKED).contains(&code) {
            message = format!("{message} (unknown status {code})");
        }
        let position = (view.line > 0).then_some(Position { line: view.line, column: view.column });
        Self { kind, message, position }
    }
}

/// Takes a piece of a saved state.
unsafe extern "C" fn append(context: *mut c_void, bytes: *const u8, length: usize) -> Status {
    let too_long = length > isize::MAX as usize;
    if context.is_null() || (bytes.is_null() && length > 0) || too_long {
        return status::INVALID_ARGUMENT;
    }
    if length == 0 {
        return status::OK;
    }
    let appended = catch_unwind(AssertUnwindSafe(|| {
        // SAFETY: `save` gave the context, a vector that lives for its call; the plugin gives bytes that live for this one.
        let (target, piece) =
            unsafe { (&mut *context.cast::<Vec<u8>>(), std::slice::from_raw_parts(bytes, length)) };
        target.try_reserve(length).map(|()| target.extend_from_slice(piece))
    }));
    match appended {
        Ok(Ok(())) => status::OK,
        _ => status::FAILED,
    }
}

/// `save` and `load` of a wrapper, through its handle.
macro_rules! checkpoint {
    ($wrapper:ty) => {
        impl shield_api::Checkpoint for $wrapper {
            fn save(&self, bytes: &mut Vec<u8>) -> shield_api::Result<()> {
                self.handle.save(bytes)
            }

            fn load(&mut self, bytes: &[u8]) -> shield_api::Result<()> {
                self.handle.load(bytes)
            }
        }
    };
}
pub(super) use checkpoint;

/// The wrapper of a kind of which nothing is asked when an instance is made.
macro_rules! wrapper {
    ($(#[$doc:meta])* $wrapper:ident, $table:ty) => {
        $(#[$doc])*
        #[derive(Debug)]
        pub struct $wrapper {
            handle: Handle,
            table: &'static $table,
            spaces: shield_api::Spaces,
        }

        checkpoint!($wrapper);

        impl $wrapper {
            pub(in crate::plugin) fn create(
                id: &str,
                table: &'static $table,
                config: &str,
                setup: &shield_api::Setup,
            ) -> std::result::Result<Self, crate::plugin::PluginError> {
                let spaces = super::handle::spaces(id, setup)?;
                let handle = Handle::create(id, &table.life, config, setup)?;
                Ok(Self { handle, table, spaces })
            }
        }
    };
}
pub(super) use wrapper;
