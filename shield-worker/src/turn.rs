//! Taking turns: how one side waits until the other's counter has moved, without missing the moment and without a system call
//! where the other side is quick.

use std::{
    io,
    sync::atomic::{
        AtomicU32,
        Ordering::{Relaxed, SeqCst},
    },
    thread,
    time::{Duration, Instant},
};

use crate::bell::{Bell, Heard};

/// What a side says of itself, in the block.
pub(crate) mod state {
    /// It looks at the counters by itself.
    pub(crate) const AWAKE: u32 = 0;
    /// It waits at the bell: ring once.
    pub(crate) const ASLEEP: u32 = 1;
    /// It waits at the bell each time: ring always.
    pub(crate) const ALWAYS_ASLEEP: u32 = 2;
}

/// Wakes the other side if it waits at the bell. The counter was moved before.
pub(crate) fn wake(other: &AtomicU32, bell: &Bell) -> io::Result<()> {
    let is_asleep = match other.load(SeqCst) {
        state::AWAKE => false,
        state::ASLEEP => other.compare_exchange(state::ASLEEP, state::AWAKE, SeqCst, Relaxed).is_ok(),
        _ => true,
    };
    if is_asleep { bell.ring() } else { Ok(()) }
}

/// How long to look at a counter before going to sleep: longer where it was worth it lately, at most [`LONGEST_LOOK`].
#[derive(Debug)]
pub(crate) struct Patience(Duration);

const LONGEST_LOOK: Duration = Duration::from_micros(50);
const SHORTEST_LOOK: Duration = Duration::from_micros(2);
/// Glances between two looks at the clock.
const GLANCES: u32 = 32;

impl Patience {
    pub(crate) fn new() -> Self {
        // On one processor the other side cannot move while this one looks.
        let alone = thread::available_parallelism().is_ok_and(|count| count.get() == 1);
        Self(if alone { Duration::ZERO } else { LONGEST_LOOK })
    }

    /// Looks for a while; says whether it was worth it.
    pub(crate) fn look(&mut self, is_ready: impl Fn() -> bool) -> bool {
        if self.0.is_zero() {
            return is_ready();
        }
        let start = Instant::now();
        let found = loop {
            if (0..GLANCES).any(|_| {
                std::hint::spin_loop();
                is_ready()
            }) {
                break true;
            }
            if start.elapsed() >= self.0 {
                break false;
            }
        };
        self.0 = if found { (self.0 * 2).min(LONGEST_LOOK) } else { (self.0 / 2).max(SHORTEST_LOOK) };
        found
    }
}

/// Goes to sleep until the bell rings, unless the counter has moved meanwhile. `own` is the state of this side.
pub(crate) fn sleep(
    own: &AtomicU32,
    bell: &mut Bell,
    is_ready: impl Fn() -> bool,
    limit: Option<Duration>,
) -> io::Result<Heard> {
    own.store(state::ASLEEP, SeqCst);
    // Either the other side sees the state and rings, or this one sees the counter: both orders are sequentially consistent.
    // Who changes the state back decides whether a byte is on its way.
    let is_settled = is_ready() && own.compare_exchange(state::ASLEEP, state::AWAKE, SeqCst, Relaxed).is_ok();
    if is_settled { Ok(Heard::Ring) } else { bell.listen(limit) }
}
