//! The block of memory that parent and child share.

use std::{
    fs::File,
    io,
    os::fd::{AsFd, OwnedFd},
    sync::atomic::AtomicU32,
};

use memmap2::MmapRaw;

use crate::ffi::{self, Plain};

/// Where the payload begins. Each counter before it has a cache line of its own.
const HEADER: usize = 256;
const REQUEST: usize = 0;
const ANSWER: usize = 64;
const CHILD_STATE: usize = 128;
const PARENT_STATE: usize = 192;

/// The shared payload: bytes that parent and child write in turns. Values are copied in and out; no reference into it exists, since
/// the other process could write behind it.
#[derive(Debug)]
pub struct Memory {
    map: MmapRaw,
}

impl Memory {
    /// A new block with a payload of `length` bytes, all zero, and the descriptor by which a child maps it. Pages cost nothing
    /// until they are written.
    pub(crate) fn create(length: usize) -> io::Result<(Self, OwnedFd)> {
        let file = anonymous_file()?;
        let total = u64::try_from(HEADER.saturating_add(length)).unwrap_or(u64::MAX);
        File::from(file.try_clone()?).set_len(total)?;
        fix_length(&file)?;
        Ok((Self { map: MmapRaw::map_raw(&file)? }, file))
    }

    pub(crate) fn open(file: &OwnedFd) -> io::Result<Self> {
        let map = MmapRaw::map_raw(file)?;
        if map.len() <= HEADER {
            return Err(io::Error::other("the shared block is shorter than its header"));
        }
        Ok(Self { map })
    }

    /// Length of the whole block, header included.
    pub(crate) fn block_len(&self) -> usize {
        self.map.len()
    }

    pub(crate) fn request(&self) -> &AtomicU32 {
        ffi::counter(&self.map, REQUEST)
    }

    pub(crate) fn answer(&self) -> &AtomicU32 {
        ffi::counter(&self.map, ANSWER)
    }

    pub(crate) fn child_state(&self) -> &AtomicU32 {
        ffi::counter(&self.map, CHILD_STATE)
    }

    pub(crate) fn parent_state(&self) -> &AtomicU32 {
        ffi::counter(&self.map, PARENT_STATE)
    }

    /// Length of the payload in bytes.
    pub fn len(&self) -> usize {
        self.map.len() - HEADER
    }

    /// Never: a payload has at least one byte.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Copies `values` to the byte `offset` of the payload.
    ///
    /// # Panics
    /// They do not fit.
    pub fn write<T: Plain>(&mut self, offset: usize, values: &[T]) {
        ffi::copy_in(&self.map, HEADER.saturating_add(offset), values);
    }

    /// Fills `values` from the byte `offset` of the payload.
    ///
    /// # Panics
    /// So many do not lie there.
    pub fn read<T: Plain>(&self, offset: usize, values: &mut [T]) {
        ffi::copy_out(&self.map, HEADER.saturating_add(offset), values);
    }

    /// One value at the byte `offset`.
    ///
    /// # Panics
    /// It does not lie there.
    pub fn get<T: Plain + Default>(&self, offset: usize) -> T {
        let mut value = [T::default()];
        self.read(offset, &mut value);
        value[0]
    }
}

#[cfg(target_os = "linux")]
fn anonymous_file() -> io::Result<OwnedFd> {
    use rustix::fs::{MemfdFlags, memfd_create};
    Ok(memfd_create("shield-worker", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?)
}

/// A child that shortened the block would end its parent at the next access.
#[cfg(target_os = "linux")]
fn fix_length(file: impl AsFd) -> io::Result<()> {
    use rustix::fs::{SealFlags, fcntl_add_seals};
    Ok(fcntl_add_seals(file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?)
}

#[cfg(not(target_os = "linux"))]
fn anonymous_file() -> io::Result<OwnedFd> {
    tempfile::tempfile().map(Into::into)
}

#[cfg(not(target_os = "linux"))]
fn fix_length(_file: impl AsFd) -> io::Result<()> {
    Ok(())
}
