//! Counts how often plugins, and the libraries that they link, allocate. Each has an allocator of its own, but all end in libc's `malloc`:
//! the places where their libraries keep its address are given the address of a function that counts first.
//!
//! Only where the format of these places is known: Linux with glibc, on x86-64 and AArch64.

use std::sync::Once;

use crate::environment_check::CountAllocations;

#[cfg(all(target_os = "linux", target_env = "gnu", any(target_arch = "x86_64", target_arch = "aarch64")))]
mod counter {
    use std::{
        ffi::{CStr, c_char, c_int, c_void},
        sync::atomic::{AtomicU64, Ordering::Relaxed},
    };

    use libc::{Elf64_Addr, Elf64_Phdr, Elf64_Rela, Elf64_Sym, dl_phdr_info};

    static COUNT: AtomicU64 = AtomicU64::new(0);

    /// Whether this system lets allocations be counted.
    pub(crate) const IS_KNOWN: bool = true;

    /// Allocations so far, of all threads.
    pub(crate) fn count() -> u64 {
        COUNT.load(Relaxed)
    }

    /// Makes every library that is loaded by now count.
    pub(crate) fn begin() {
        // SAFETY: the function is called for each library that is loaded, and only while it stays loaded.
        unsafe { libc::dl_iterate_phdr(Some(redirect), std::ptr::null_mut()) };
    }

    macro_rules! counting {
        ($($name:ident($($argument:ident: $kind:ty),*) -> $answer:ty;)*) => {
            $(unsafe extern "C" fn $name($($argument: $kind),*) -> $answer {
                COUNT.fetch_add(1, Relaxed);
                // SAFETY: the arguments are passed on as they came, to the function that they were meant for.
                unsafe { libc::$name($($argument),*) }
            })*

            /// The function that takes the place of the one of this name.
            fn replacement(name: &CStr) -> Option<Elf64_Addr> {
                match name.to_bytes() {
                    $(bytes if bytes == stringify!($name).as_bytes() => Some($name as *const () as Elf64_Addr),)*
                    _ => None,
                }
            }
        };
    }

    counting! {
        malloc(size: usize) -> *mut c_void;
        calloc(number: usize, size: usize) -> *mut c_void;
        realloc(pointer: *mut c_void, size: usize) -> *mut c_void;
        aligned_alloc(alignment: usize, size: usize) -> *mut c_void;
        posix_memalign(place: *mut *mut c_void, alignment: usize, size: usize) -> c_int;
    }

    // From the ELF specification and its supplements for the two processors.
    const DT_PLTRELSZ: u64 = 2;
    const DT_STRTAB: u64 = 5;
    const DT_SYMTAB: u64 = 6;
    const DT_RELA: u64 = 7;
    const DT_RELASZ: u64 = 8;
    const DT_JMPREL: u64 = 23;
    /// Address of a symbol: by itself, in the table of addresses, and in that of jumps.
    #[cfg(target_arch = "x86_64")]
    const BY_SYMBOL: [u64; 3] = [1, 6, 7];
    #[cfg(target_arch = "aarch64")]
    const BY_SYMBOL: [u64; 3] = [257, 1025, 1026];

    /// What is needed of a library's dynamic section: addresses, and lengths in bytes.
    #[derive(Default)]
    struct Dynamic {
        strings: Elf64_Addr,
        symbols: Elf64_Addr,
        relocations: [(Elf64_Addr, u64); 2],
    }

    unsafe extern "C" fn redirect(library: *mut dl_phdr_info, _size: usize, _data: *mut c_void) -> c_int {
        // SAFETY: the loader describes a library that is loaded.
        unsafe {
            let library = &*library;
            let name = CStr::from_ptr(library.dlpi_name).to_bytes();
            let is_file = |prefix: &[u8]| {
                name.rsplit(|byte| *byte == b'/').next().is_some_and(|file| file.starts_with(prefix))
            };
            // The first is this program, whose own allocations do not count; libc and the loader are where the calls end.
            if !name.is_empty() && ![&b"libc.so"[..], b"ld-linux", b"linux-vdso"].into_iter().any(is_file) {
                redirect_library(library);
            }
        }
        0
    }

    /// # Safety
    /// The library is loaded and relocated, and stays so.
    unsafe fn redirect_library(library: &dl_phdr_info) {
        // SAFETY: the caller's promise: headers, dynamic section and its tables are mapped, and as long as they say.
        unsafe {
            let headers = std::slice::from_raw_parts(library.dlpi_phdr, usize::from(library.dlpi_phnum));
            let Some(header) = headers.iter().find(|header| header.p_type == libc::PT_DYNAMIC) else {
                return;
            };
            let dynamic = read_dynamic(library.dlpi_addr, header);
            for (address, bytes) in dynamic.relocations {
                let count = bytes as usize / size_of::<Elf64_Rela>();
                if address == 0 || count == 0 {
                    continue;
                }
                for relocation in std::slice::from_raw_parts(address as *const Elf64_Rela, count) {
                    let (symbol, kind) = (relocation.r_info >> 32, relocation.r_info & 0xffff_ffff);
                    if !BY_SYMBOL.contains(&kind) || symbol == 0 {
                        continue;
                    }
                    let symbol = &*(dynamic.symbols as *const Elf64_Sym).add(symbol as usize);
                    let name = CStr::from_ptr((dynamic.strings + u64::from(symbol.st_name)) as *const c_char);
                    if let Some(function) = replacement(name) {
                        store((library.dlpi_addr + relocation.r_offset) as *mut Elf64_Addr, function);
                    }
                }
            }
        }
    }

    /// # Safety
    /// The header is that of the dynamic section of a library that is loaded at `base`.
    unsafe fn read_dynamic(base: Elf64_Addr, header: &Elf64_Phdr) -> Dynamic {
        // The loader has made most addresses absolute, but not those of every library.
        let absolute = |address: u64| if address < base { base + address } else { address };
        let mut found = Dynamic::default();
        let mut entry = (base + header.p_vaddr) as *const [u64; 2];
        loop {
            // SAFETY: the caller's promise; the section ends with an entry of the tag 0.
            let [tag, value] = unsafe { entry.read() };
            match tag {
                0 => return found,
                DT_STRTAB => found.strings = absolute(value),
                DT_SYMTAB => found.symbols = absolute(value),
                DT_RELA => found.relocations[0].0 = absolute(value),
                DT_RELASZ => found.relocations[0].1 = value,
                DT_JMPREL => found.relocations[1].0 = absolute(value),
                DT_PLTRELSZ => found.relocations[1].1 = value,
                _ => {}
            }
            // SAFETY: this was not the last entry.
            entry = unsafe { entry.add(1) };
        }
    }

    /// # Safety
    /// The place is mapped, and holds the address of a function with the same signature as `function`.
    unsafe fn store(place: *mut Elf64_Addr, function: Elf64_Addr) {
        // SAFETY: the caller's promise. The loader protects such places against writing once it has filled them; a place of eight
        // aligned bytes lies in one page.
        unsafe {
            let page = libc::sysconf(libc::_SC_PAGESIZE) as usize;
            let start = (place as usize / page * page) as *mut c_void;
            if libc::mprotect(start, page, libc::PROT_READ | libc::PROT_WRITE) == 0 {
                place.write(function);
            }
        }
    }
}

/// Elsewhere nothing is counted.
#[cfg(not(all(
    target_os = "linux",
    target_env = "gnu",
    any(target_arch = "x86_64", target_arch = "aarch64")
)))]
mod counter {
    pub(crate) const IS_KNOWN: bool = false;

    pub(crate) fn begin() {}

    pub(crate) fn count() -> u64 {
        0
    }
}

pub(crate) use counter::{IS_KNOWN, begin, count};

/// Counts how often the plugins that are loaded by its first use allocate, on whatever thread; `None` where this system does not let
/// them be counted.
pub(crate) fn counter() -> Option<&'static CountAllocations> {
    static BEGUN: Once = Once::new();
    const COUNTER: &CountAllocations = &|body| {
        BEGUN.call_once(begin);
        let before = count();
        body();
        count() - before
    };
    IS_KNOWN.then_some(COUNTER)
}
