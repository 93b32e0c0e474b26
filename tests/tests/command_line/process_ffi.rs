//! Limits and signals for a program that a test starts.

use std::{
    os::unix::process::CommandExt,
    process::{Child, Command},
};

/// Makes each write beyond `bytes` of a file fail.
pub fn with_files_up_to(command: &mut Command, bytes: libc::rlim_t) -> &mut Command {
    // SAFETY: the two calls are safe between fork and exec.
    unsafe {
        command.pre_exec(move || {
            let limit = libc::rlimit { rlim_cur: bytes, rlim_max: bytes };
            libc::setrlimit(libc::RLIMIT_FSIZE, &limit);
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
            Ok(())
        })
    }
}

/// What Ctrl-C does.
pub fn interrupt(child: &Child) {
    // SAFETY: a signal to our own child.
    unsafe { libc::kill(i32::try_from(child.id()).unwrap(), libc::SIGINT) };
}
