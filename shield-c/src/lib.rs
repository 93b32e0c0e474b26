//! The drop-in for C, as `shield.h` describes it: `libshield_runtime`.
#![deny(unsafe_code)]

mod errors;
mod ffi;
mod handle;
mod pointers_ffi;
mod policy_ffi;
