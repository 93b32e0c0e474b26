//! The parent's side.

use std::{
    io,
    os::{
        fd::AsRawFd,
        unix::{net::UnixStream, process::CommandExt},
    },
    process::{Child, Command, Stdio},
    sync::atomic::Ordering::SeqCst,
    thread,
    time::{Duration, Instant},
};

use crate::{
    CHANNEL_VARIABLE, Ending, WorkerError,
    bell::{Bell, Heard},
    ffi,
    memory::Memory,
    nursery,
    transcript::Transcript,
    turn::{Patience, sleep, state, wake},
};

/// A grandchild may hold the bell of a dead child: so often the child itself is looked at.
const CHECK_EVERY: Duration = Duration::from_millis(50);
/// How long a child that has let go of its bell may take to end, for example to write a core file.
const DYING: Duration = Duration::from_secs(5);

/// How a child waits for its requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Waiting {
    /// It looks at the counters for a while before it sleeps, as [`Client`](crate::Client) does: for round trips of microseconds.
    #[default]
    Looking,
    /// It reads a byte from the bell for each request and writes one for each answer: the least that a child must do.
    Blocking,
}

/// How a worker is made.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Bytes of the payload. Pages cost nothing until they are written.
    pub memory: usize,
    /// How the child waits.
    pub waiting: Waiting,
    /// How long a child may take to end by itself when it is no longer wanted; then it is killed.
    pub farewell: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self { memory: 1 << 20, waiting: Waiting::default(), farewell: Duration::from_secs(1) }
    }
}

/// A child process and the memory shared with it. One request is under way at a time. Dropping it ends the child.
#[derive(Debug)]
pub struct Worker {
    memory: Memory,
    /// `None` once the child is told to go.
    bell: Option<Bell>,
    child: Child,
    transcript: Transcript,
    waiting: Waiting,
    farewell: Duration,
    patience: Patience,
    requests: u32,
    /// Why there is no child any more.
    end: Option<WorkerError>,
}

impl Worker {
    /// Starts `command` with a channel to it. Its standard output and error are kept for messages about its end; its standard
    /// input is empty. The child ends with this process, however that ends.
    ///
    /// # Errors
    /// [`WorkerError::Start`].
    pub fn start(mut command: Command, options: Options) -> Result<Self, WorkerError> {
        let program = command.get_program().to_string_lossy().into_owned();
        let failed = |error: io::Error| WorkerError::Start { program, reason: error.to_string() };
        let make = || -> io::Result<Self> {
            let (memory, block) = Memory::create(options.memory)?;
            let (ours, theirs) = UnixStream::pair()?;
            let (output, input) = io::pipe()?;
            let initial = match options.waiting {
                Waiting::Looking => state::AWAKE,
                Waiting::Blocking => state::ALWAYS_ASLEEP,
            };
            memory.child_state().store(initial, SeqCst);
            let descriptors = [block.as_raw_fd(), theirs.as_raw_fd()];
            let channel = format!("{},{},{}", descriptors[0], descriptors[1], memory.block_len());
            command.env(CHANNEL_VARIABLE, channel).stdin(Stdio::null());
            command.stdout(input.try_clone()?).stderr(input);
            // Ctrl-C at the terminal is the parent's to answer.
            command.process_group(0);
            ffi::inherit(&mut command, descriptors, rustix::process::getpid());
            let child = nursery::spawn(command)?;
            Ok(Self {
                memory,
                bell: Some(Bell::new(ours)),
                child,
                transcript: Transcript::of(output)?,
                waiting: options.waiting,
                farewell: options.farewell,
                patience: Patience::new(),
                requests: 0,
                end: None,
            })
        };
        make().map_err(failed)
    }

    /// The payload.
    pub fn memory(&mut self) -> &mut Memory {
        &mut self.memory
    }

    /// The child's process number.
    pub fn process(&self) -> u32 {
        self.child.id()
    }

    /// Hands the payload to the child and waits until it has answered, at most for `limit`. Allocates nothing on success.
    ///
    /// # Errors
    /// The child died, did not answer in time or broke the protocol. It is gone then, and every later call gives the same error.
    pub fn call(&mut self, limit: Duration) -> Result<(), WorkerError> {
        if let Some(end) = &self.end {
            return Err(end.clone());
        }
        self.requests = self.requests.wrapping_add(1);
        match self.exchange(limit) {
            Ok(Heard::Ring) => Ok(()),
            Ok(Heard::HangUp) => Err(self.died()),
            Ok(Heard::Nothing) => Err(self.give_up(|last_lines| WorkerError::Hung { limit, last_lines })),
            Err(error) => {
                let reason = error.to_string();
                Err(self.give_up(|last_lines| WorkerError::Protocol { reason, last_lines }))
            }
        }
    }

    fn exchange(&mut self, limit: Duration) -> io::Result<Heard> {
        let Self { memory, bell: Some(bell), patience, waiting, requests, child, .. } = self else {
            return Ok(Heard::HangUp);
        };
        memory.request().store(*requests, SeqCst);
        wake(memory.child_state(), bell)?;
        let (answer, parent_state) = (memory.answer(), memory.parent_state());
        let is_ready = || answer.load(SeqCst) == *requests;
        if *waiting == Waiting::Looking && patience.look(is_ready) {
            return Ok(Heard::Ring);
        }
        let start = Instant::now();
        loop {
            let left = limit.saturating_sub(start.elapsed());
            let slice = Some(left.min(CHECK_EVERY));
            let heard = match waiting {
                Waiting::Looking => sleep(parent_state, bell, is_ready, slice)?,
                Waiting::Blocking => bell.listen(slice)?,
            };
            match heard {
                Heard::Ring if is_ready() => return Ok(Heard::Ring),
                Heard::Ring if *waiting == Waiting::Blocking => {
                    return Err(io::Error::other("it rang without an answer"));
                }
                Heard::HangUp => return Ok(Heard::HangUp),
                _ if child.try_wait()?.is_some() => return Ok(Heard::HangUp),
                _ if left.is_zero() => return Ok(Heard::Nothing),
                _ => {}
            }
        }
    }

    /// The child let go of its bell: it is ending, or has closed what it must not.
    #[cold]
    fn died(&mut self) -> WorkerError {
        let ended = wait_for(&mut self.child, DYING);
        match ended {
            Some(ending) => self.give_up(|last_lines| WorkerError::Died { ending, last_lines }),
            None => {
                let reason = "it closed its channel and went on".to_string();
                self.give_up(|last_lines| WorkerError::Protocol { reason, last_lines })
            }
        }
    }

    /// Ends the child and keeps the reason.
    #[cold]
    fn give_up(&mut self, error: impl FnOnce(String) -> WorkerError) -> WorkerError {
        end(&mut self.child, Duration::ZERO);
        self.bell = None;
        self.end.insert(error(self.transcript.last_lines())).clone()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // The child reads the end of its channel and may say goodbye.
        self.bell = None;
        end(&mut self.child, self.farewell);
    }
}

/// Waits for the child to end by itself.
fn wait_for(child: &mut Child, limit: Duration) -> Option<Ending> {
    let start = Instant::now();
    let mut pause = Duration::from_micros(100);
    loop {
        // An error says that there is no such child, which no waiting changes.
        match child.try_wait() {
            Ok(Some(status)) => return Some(status.into()),
            Ok(None) if start.elapsed() < limit => thread::sleep(pause),
            _ => return None,
        }
        pause = (pause * 2).min(Duration::from_millis(10));
    }
}

/// Ends the child, at the latest after `farewell`, and leaves no zombie.
fn end(child: &mut Child, farewell: Duration) {
    // A kill fails only where the child is gone, and then there is nothing to wait for.
    if wait_for(child, farewell).is_none() && child.kill().is_ok() {
        child.wait().ok();
    }
}
