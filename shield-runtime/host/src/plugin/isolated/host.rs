//! The host's side of one isolated instance: its process, and what to do when that fails.

use std::{process::Command, time::Duration};

use shield_api::{Error, ErrorKind, Result, Setup, abi::status, metrics};
use shield_worker::{Memory, Options, Waiting, Worker, WorkerError};

use super::{
    Isolation, MOST_FAILURES, OnFailure, program,
    protocol::{self, Creation, IsolatedKind, Operation},
};
use crate::plugin::{PluginError, Selection, ffi::while_creating};

/// One instance in a process of its own.
#[derive(Debug)]
pub(super) struct Isolated {
    id: String,
    isolation: Isolation,
    /// RON of a [`Creation`].
    creation: String,
    worker: Worker,
    /// The instance cannot be called any more.
    is_lost: bool,
    failures: u32,
}

impl Isolated {
    /// Starts a process and makes the instance in it, of the file that the choice names; the answer lies in the text of the memory.
    pub(super) fn start(
        kind: IsolatedKind,
        choice: &Selection,
        config: &str,
        setup: &Setup,
        isolation: Isolation,
    ) -> Result<Self, PluginError> {
        let id = choice.id.as_str();
        let failed =
            |message: String| PluginError::Create { id: id.into(), kind: ErrorKind::Failed, message };
        let creation = Creation {
            version: env!("CARGO_PKG_VERSION").into(),
            kind,
            id: id.into(),
            path: choice.path.clone().unwrap_or_default(),
            sha256: choice.sha256.clone(),
            config: config.into(),
            seed: setup.seed,
            threads: setup.threads,
            spaces: setup.spaces().ok().map(Into::into),
        };
        let creation = ron::to_string(&creation).map_err(|error| failed(error.to_string()))?;
        if !protocol::fits(&creation) {
            return Err(failed("its configuration is longer than an isolated plugin can be given".into()));
        }
        let worker = spawn().map_err(failed)?;
        let mut isolated = Self { id: id.into(), isolation, creation, worker, is_lost: false, failures: 0 };
        isolated.create().map_err(|error| match error.kind() {
            ErrorKind::InvalidConfig => {
                let (message, position) = (error.message().into(), error.position());
                PluginError::Config { id: id.into(), message, position }
            }
            _ => while_creating(id, &error),
        })?;
        Ok(isolated)
    }

    fn create(&mut self) -> Result<()> {
        protocol::write_text(self.worker.memory(), &self.creation);
        self.exchange(Operation::Create, self.isolation.start_timeout, "start_timeout_s")
    }

    pub(super) fn memory(&mut self) -> &mut Memory {
        self.worker.memory()
    }

    /// One call of the instance, whose arguments lie in the memory. Allocates nothing on success, unless the plugin reports figures.
    ///
    /// # Errors
    /// The plugin's own, or that there is no plugin any more; then [`recover`](Self::recover) may help.
    pub(super) fn call(&mut self, operation: Operation) -> Result<()> {
        let outcome = self.exchange(operation, self.isolation.step_timeout, "step_timeout_s");
        match &outcome {
            // A reset that goes well says nothing of the step that failed after the last one.
            Ok(()) if matches!(operation, Operation::Step | Operation::Act) => self.failures = 0,
            Ok(()) => {}
            Err(error) => self.is_lost |= error.kind() == ErrorKind::Panicked,
        }
        outcome
    }

    fn exchange(&mut self, operation: Operation, limit: Duration, field: &str) -> Result<()> {
        let memory = self.worker.memory();
        memory.write(protocol::OPERATION, &[operation as u32]);
        if let Err(error) = self.worker.call(limit) {
            self.is_lost = true;
            let remedy = match error {
                WorkerError::Hung { .. } => format!("\nIf it only needs longer, raise `worker.{field}`"),
                _ => String::new(),
            };
            return Err(Error::failed(format!("{}: {error}{remedy}", self.id)));
        }
        let memory = self.worker.memory();
        report(&protocol::read_metrics(memory));
        match memory.get::<u32>(protocol::STATUS).cast_signed() {
            status::OK => Ok(()),
            code => {
                let [line, column]: [u32; 2] = [0, 4].map(|offset| memory.get(protocol::POSITION + offset));
                let error = Error::new(protocol::kind(code), protocol::read_text(memory));
                Err(if line > 0 { error.at(line, column) } else { error })
            }
        }
    }

    /// Puts a new process in the place of a lost one, where that is wanted and has not failed too often; says whether it did.
    ///
    /// # Errors
    /// The instance was made before, and cannot be made now.
    pub(super) fn recover(&mut self) -> Result<bool> {
        let may = self.isolation.on_failure == OnFailure::Restart && self.failures < MOST_FAILURES;
        if !self.is_lost || !may {
            return Ok(false);
        }
        self.failures += 1;
        self.worker = spawn().map_err(Error::failed)?;
        self.is_lost = false;
        self.create()?;
        Ok(true)
    }

    pub(super) fn save(&mut self, bytes: &mut Vec<u8>) -> Result<()> {
        self.call(Operation::Save)?;
        let total = usize::try_from(self.memory().get::<u64>(protocol::STATE)).unwrap_or(usize::MAX);
        let before = bytes.len();
        bytes.try_reserve(total).map_err(|error| Error::failed(format!("its state: {error}")))?;
        while bytes.len() - before < total {
            let taken = bytes.len() - before;
            let length = (total - taken).min(protocol::PIECE);
            self.memory().write(protocol::STATE, &[total as u64, taken as u64]);
            self.call(Operation::TakePiece).inspect_err(|_| bytes.truncate(before))?;
            bytes.resize(before + taken + length, 0);
            self.memory().read(protocol::NUMBERS, &mut bytes[before + taken..]);
        }
        Ok(())
    }

    pub(super) fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let mut given = 0;
        loop {
            let piece = &bytes[given..bytes.len().min(given + protocol::PIECE)];
            self.memory().write(protocol::STATE, &[bytes.len() as u64, given as u64]);
            self.memory().write(protocol::NUMBERS, piece);
            self.call(Operation::GivePiece)?;
            given += piece.len();
            if given == bytes.len() {
                return Ok(());
            }
        }
    }
}

fn spawn() -> Result<Worker, String> {
    let mut command = Command::new(program::find()?);
    command.arg("worker");
    let options =
        Options { memory: protocol::MEMORY, waiting: Waiting::Looking, farewell: Duration::from_secs(2) };
    Worker::start(command, options).map_err(|error| error.to_string())
}

/// Reports the figures that the plugin reported in its process.
fn report(lines: &str) {
    for (name, value) in lines.lines().filter_map(|line| line.rsplit_once('=')) {
        if let Ok(value) = value.parse() {
            metrics::report(name, value);
        }
    }
}

/// `save` and `load` of a wrapper with an `isolated: RefCell<Isolated>`.
macro_rules! checkpoint {
    ($wrapper:ty) => {
        impl shield_api::Checkpoint for $wrapper {
            fn save(&self, bytes: &mut Vec<u8>) -> shield_api::Result<()> {
                self.isolated.borrow_mut().save(bytes)
            }

            fn load(&mut self, bytes: &[u8]) -> shield_api::Result<()> {
                self.isolated.get_mut().load(bytes)
            }
        }
    };
}
pub(super) use checkpoint;
