//! What a program that a test starts must do without.

use std::{os::unix::process::CommandExt, process::Command};

use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
    apply_filter,
};

/// Kills the program when it makes another process.
pub fn without_processes(command: &mut Command) -> &mut Command {
    filtered(command, 0, SeccompAction::KillProcess)
}

/// Lets no thread start, as where a user has no more left. The limit of the system, `RLIMIT_NPROC`, does not bind root.
pub fn without_threads(command: &mut Command) -> &mut Command {
    filtered(command, libc::CLONE_THREAD as u64, SeccompAction::Errno(libc::EAGAIN as u32))
}

/// Closes a stream before the program begins, as `2>&-` does in a shell.
pub fn without_stream(command: &mut Command, descriptor: i32) -> &mut Command {
    // SAFETY: between fork and exec only a system call is made, and the descriptor is of the child alone.
    unsafe {
        command.pre_exec(move || {
            libc::close(descriptor);
            Ok(())
        })
    }
}

/// `action` meets each call of `clone` in which the flag for threads is `thread_flag`. The arguments of `clone3` lie in memory, where a filter
/// cannot look: libc calls `clone` where `clone3` is missing.
fn filtered(command: &mut Command, thread_flag: u64, action: SeccompAction) -> &mut Command {
    let architecture = std::env::consts::ARCH.try_into().unwrap();
    let flag = SeccompCmpOp::MaskedEq(libc::CLONE_THREAD as u64);
    let is_meant = SeccompCondition::new(0, SeccompCmpArgLen::Qword, flag, thread_flag).unwrap();
    let clone = vec![SeccompRule::new(vec![is_meant]).unwrap()];
    let missing = SeccompAction::Errno(libc::ENOSYS as u32);
    let filters = [(libc::SYS_clone3, Vec::new(), missing), (libc::SYS_clone, clone, action)];
    let programs = filters.map(|(call, rules, action)| -> BpfProgram {
        let rules = [(call, rules)].into_iter().collect();
        let filter = SeccompFilter::new(rules, SeccompAction::Allow, action, architecture).unwrap();
        filter.try_into().unwrap()
    });
    // SAFETY: between fork and exec only system calls are made, and nothing is allocated where they succeed.
    unsafe {
        command.pre_exec(move || {
            programs.iter().try_for_each(|program| apply_filter(program)).map_err(std::io::Error::other)
        })
    }
}
