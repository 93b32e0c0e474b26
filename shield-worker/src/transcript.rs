//! What a child prints: kept for the message about its end.

use std::{
    collections::VecDeque,
    io::{PipeReader, Read},
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, channel},
    },
    thread,
    time::Duration,
};

/// So many bytes are kept, and so many lines of them shown.
const KEPT_BYTES: usize = 8 * 1024;
const SHOWN_LINES: usize = 20;
/// How long to wait for the rest of the output of a child that has ended: a grandchild may hold the pipe open.
const PATIENCE: Duration = Duration::from_millis(300);

/// The end of what a child printed to its standard output and error.
#[derive(Debug)]
pub(crate) struct Transcript {
    kept: Arc<Mutex<VecDeque<u8>>>,
    /// Closed at the end of the output.
    end: Receiver<()>,
}

impl Transcript {
    /// Reads until the last writer is gone, on a thread of its own.
    pub(crate) fn of(mut output: PipeReader) -> std::io::Result<Self> {
        let kept = Arc::new(Mutex::new(VecDeque::new()));
        let (sender, end) = channel();
        let shared = kept.clone();
        thread::Builder::new().name("worker-output".into()).spawn(move || {
            let _sender = sender;
            let mut piece = [0; 4096];
            while let Ok(count @ 1..) = output.read(&mut piece) {
                let mut kept = shared.lock().unwrap_or_else(PoisonError::into_inner);
                kept.extend(&piece[..count]);
                let excess = kept.len().saturating_sub(KEPT_BYTES);
                kept.drain(..excess);
            }
        })?;
        Ok(Self { kept, end })
    }

    /// The last lines, waiting a moment for the end of the output.
    pub(crate) fn last_lines(&self) -> String {
        // Whether the end came or the time is over: what there is, is shown.
        self.end.recv_timeout(PATIENCE).ok();
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let text = String::from_utf8_lossy(kept.make_contiguous());
        let lines: Vec<&str> = text.trim_end().lines().collect();
        lines[lines.len().saturating_sub(SHOWN_LINES)..].join("\n")
    }
}
