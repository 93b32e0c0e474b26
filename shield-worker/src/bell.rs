//! The doorbell: a pair of sockets through which one byte wakes the other side, and whose end tells that it is gone.

use std::{io, os::unix::net::UnixStream, time::Duration};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
    net::{RecvFlags, SendFlags, recv, send},
};

/// One end of the pair.
#[derive(Debug)]
pub(crate) struct Bell(UnixStream);

/// What came of waiting at a bell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Heard {
    /// The other side rang once.
    Ring,
    /// The other side is gone.
    HangUp,
    /// Neither, in the given time.
    Nothing,
}

impl Bell {
    pub(crate) fn new(socket: UnixStream) -> Self {
        Self(socket)
    }

    /// Wakes the other side, and never waits for it. A bell that is full of rings has been rung. That nobody is there any more is
    /// found by whoever waits for the answer.
    pub(crate) fn ring(&self) -> io::Result<()> {
        loop {
            // Without `NOSIGNAL`, writing to a child that died would end a parent that is not written in Rust.
            return match send(&self.0, &[0], SendFlags::NOSIGNAL | SendFlags::DONTWAIT) {
                Ok(_) | Err(Errno::AGAIN | Errno::PIPE | Errno::CONNRESET) => Ok(()),
                Err(Errno::INTR) => continue,
                Err(error) => Err(error.into()),
            };
        }
    }

    /// Waits for the other side, for ever without a limit.
    pub(crate) fn listen(&mut self, limit: Option<Duration>) -> io::Result<Heard> {
        let limit = limit.map(|limit| Timespec {
            tv_sec: limit.as_secs().try_into().unwrap_or(i64::MAX),
            tv_nsec: limit.subsec_nanos().into(),
        });
        let mut sockets = [PollFd::new(&self.0, PollFlags::IN)];
        match poll(&mut sockets, limit.as_ref()) {
            Ok(0) | Err(Errno::INTR) => return Ok(Heard::Nothing),
            Ok(_) => {}
            Err(error) => return Err(error.into()),
        }
        match recv(&self.0, &mut [0], RecvFlags::DONTWAIT) {
            Ok((1, _)) => Ok(Heard::Ring),
            Ok(_) | Err(Errno::CONNRESET) => Ok(Heard::HangUp),
            Err(Errno::INTR | Errno::AGAIN) => Ok(Heard::Nothing),
            Err(error) => Err(error.into()),
        }
    }
}
