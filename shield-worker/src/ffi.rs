//! What cannot be said in safe Rust: memory that another process writes too, and a child that inherits descriptors.

use std::{
    io,
    os::{
        fd::{BorrowedFd, FromRawFd, OwnedFd, RawFd},
        unix::process::CommandExt,
    },
    process::Command,
    sync::atomic::AtomicU32,
};

use memmap2::MmapRaw;
use rustix::{
    io::{Errno, FdFlags, fcntl_setfd},
    process::{Pid, Signal, getppid, set_parent_process_death_signal},
};

/// Numbers that mean the same in both processes, whatever their bytes.
///
/// # Safety
/// Every pattern of bytes is a value, and the type has no padding.
pub unsafe trait Plain: Copy + 'static {}

macro_rules! plain {
    ($($number:ty),*) => { $(
        // SAFETY: a number without padding; every pattern is one.
        unsafe impl Plain for $number {}
    )* };
}
plain!(u8, u32, u64, f32, f64);

fn check_range(map: &MmapRaw, offset: usize, bytes: usize) {
    let end = offset.checked_add(bytes);
    assert!(
        end.is_some_and(|end| end <= map.len()),
        "{bytes} bytes at {offset} of {} in the block",
        map.len()
    );
}

/// Copies values into the block, byte by byte: the offset need not be aligned.
pub(crate) fn copy_in<T: Plain>(map: &MmapRaw, offset: usize, values: &[T]) {
    check_range(map, offset, size_of_val(values));
    // SAFETY: the range lies in the mapping, which is not in Rust's own memory and so overlaps no slice. No reference into the
    // block exists: what the other process writes meanwhile can only give other bytes.
    unsafe {
        let target = map.as_mut_ptr().add(offset);
        std::ptr::copy_nonoverlapping(values.as_ptr().cast::<u8>(), target, size_of_val(values));
    }
}

/// Copies values out of the block.
pub(crate) fn copy_out<T: Plain>(map: &MmapRaw, offset: usize, values: &mut [T]) {
    check_range(map, offset, size_of_val(values));
    // SAFETY: as above; every pattern of bytes is a value of the type.
    unsafe {
        let source = map.as_ptr().add(offset);
        std::ptr::copy_nonoverlapping(source, values.as_mut_ptr().cast::<u8>(), size_of_val(values));
    }
}

/// A counter at a fixed place of the block.
pub(crate) fn counter(map: &MmapRaw, offset: usize) -> &AtomicU32 {
    check_range(map, offset, size_of::<AtomicU32>());
    assert!(offset.is_multiple_of(align_of::<AtomicU32>()), "a counter at {offset} is not aligned");
    // SAFETY: the range lies in the mapping, which begins at a page, and lives as long as the reference; both processes use
    // these bytes as an atomic number only.
    unsafe { AtomicU32::from_ptr(map.as_mut_ptr().add(offset).cast()) }
}

/// Lets the child keep two descriptors of this process, under their numbers, and dies with this process.
pub(crate) fn inherit(command: &mut Command, descriptors: [RawFd; 2], parent: Pid) {
    let prepare = move || {
        for descriptor in descriptors {
            // SAFETY: the parent holds it open until the child has started.
            let descriptor = unsafe { BorrowedFd::borrow_raw(descriptor) };
            fcntl_setfd(descriptor, FdFlags::empty())?;
        }
        #[cfg(target_os = "linux")]
        set_parent_process_death_signal(Some(Signal::KILL))?;
        // It may have died before the signal was asked for.
        if getppid() == Some(parent) { Ok(()) } else { Err(io::Error::from(Errno::SRCH)) }
    };
    // SAFETY: between fork and exec only system calls are made, and nothing is allocated.
    unsafe { command.pre_exec(prepare) };
}

/// A descriptor that the parent left open for this process.
pub(crate) fn inherited(descriptor: RawFd) -> io::Result<OwnedFd> {
    // The type of a descriptor has no room for -1.
    if descriptor < 0 {
        return Err(Errno::BADF.into());
    }
    // SAFETY: it is only asked whether it is open.
    fcntl_setfd(unsafe { BorrowedFd::borrow_raw(descriptor) }, FdFlags::CLOEXEC)?;
    // SAFETY: it is open, and nothing else in this process knows it: the parent opened it for this one use.
    Ok(unsafe { OwnedFd::from_raw_fd(descriptor) })
}
