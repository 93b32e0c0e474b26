//! Where children are born: on a thread that lives as long as the process. The system ends a child with the *thread* that made
//! it, and the thread that asks for a worker may be gone before the worker is.

use std::{
    io,
    process::{Child, Command},
    sync::{
        Mutex, PoisonError,
        mpsc::{Sender, SyncSender, channel, sync_channel},
    },
    thread,
};

struct Order {
    command: Command,
    reply: SyncSender<io::Result<Child>>,
}

/// The thread of this process. A forked copy of the process has none yet, which the number tells.
static NURSERY: Mutex<Option<(u32, Sender<Order>)>> = Mutex::new(None);

/// Starts a command.
pub(crate) fn spawn(command: Command) -> io::Result<Child> {
    let (reply, answer) = sync_channel(1);
    let is_gone = |_| io::Error::other("the thread that starts workers is gone");
    nursery()?.send(Order { command, reply }).map_err(|_| is_gone(()))?;
    answer.recv().map_err(|_| is_gone(()))?
}

fn nursery() -> io::Result<Sender<Order>> {
    let mut slot = NURSERY.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if let Some((owner, sender)) = &*slot
        && *owner == process
    {
        return Ok(sender.clone());
    }
    let (sender, orders) = channel::<Order>();
    thread::Builder::new().name("worker-nursery".into()).spawn(move || {
        for Order { mut command, reply } in orders {
            let child = command.spawn();
            // The command holds the child's ends of the pipes open.
            drop(command);
            if let Err(unheard) = reply.send(child)
                && let Ok(mut orphan) = unheard.0
            {
                // Nobody waits for it any more, so that nobody would end it either.
                if orphan.kill().is_ok() {
                    orphan.wait().ok();
                }
            }
        }
    })?;
    *slot = Some((process, sender.clone()));
    Ok(sender)
}
