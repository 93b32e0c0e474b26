//! The child's side.

use std::{
    env, io,
    os::{fd::RawFd, unix::net::UnixStream},
    sync::atomic::Ordering::SeqCst,
};

use crate::{
    CHANNEL_VARIABLE,
    bell::{Bell, Heard},
    ffi,
    memory::Memory,
    turn::{Patience, sleep, wake},
};

/// The child's end of a channel: it waits for requests and answers them.
#[derive(Debug)]
pub struct Client {
    memory: Memory,
    bell: Bell,
    patience: Patience,
    seen: u32,
}

impl Client {
    /// The channel that the parent left for this process. Call it once.
    ///
    /// # Errors
    /// The process is nobody's worker, or the descriptors are not what the variable says.
    pub fn from_environment() -> io::Result<Self> {
        let text = env::var(CHANNEL_VARIABLE).map_err(|_| {
            io::Error::other(format!(
                "this process is nobody's worker: the variable {CHANNEL_VARIABLE} is not set"
            ))
        })?;
        let malformed = || io::Error::other(format!("{CHANNEL_VARIABLE} is {text:?}, not three numbers"));
        let numbers: Vec<RawFd> = text.split(',').filter_map(|number| number.parse().ok()).collect();
        let [memory, bell, length] = numbers[..] else { return Err(malformed()) };
        let named = |error: io::Error| io::Error::other(format!("{CHANNEL_VARIABLE} is {text:?}: {error}"));
        let memory = ffi::inherited(memory).and_then(|file| Memory::open(&file)).map_err(named)?;
        if usize::try_from(length) != Ok(memory.block_len()) {
            let message = format!("the shared block has {} bytes", memory.block_len());
            return Err(named(io::Error::other(message)));
        }
        let bell = Bell::new(UnixStream::from(ffi::inherited(bell).map_err(named)?));
        Ok(Self { memory, bell, patience: Patience::new(), seen: 0 })
    }

    /// The payload.
    pub fn memory(&mut self) -> &mut Memory {
        &mut self.memory
    }

    /// Waits for the next request; false if the parent has gone or wants no more.
    ///
    /// # Errors
    /// The bell cannot be read.
    pub fn wait(&mut self) -> io::Result<bool> {
        let (request, seen) = (self.memory.request(), self.seen);
        let is_ready = || request.load(SeqCst) != seen;
        if !self.patience.look(is_ready) {
            while !is_ready() {
                let heard = sleep(self.memory.child_state(), &mut self.bell, is_ready, None)?;
                if heard == Heard::HangUp {
                    return Ok(false);
                }
            }
        }
        self.seen = request.load(SeqCst);
        Ok(true)
    }

    /// Says that the request is answered; the payload is the parent's again.
    ///
    /// # Errors
    /// The bell cannot be rung.
    pub fn answer(&mut self) -> io::Result<()> {
        self.memory.answer().store(self.seen, SeqCst);
        wake(self.memory.parent_state(), &self.bell)
    }
}
