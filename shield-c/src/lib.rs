//! The drop-in for C, as `shield.h` describes it: `libshield_runtime`.
#![deny(unsafe_code)]

mod errors;
mod ffi;
mod handle;
mod policy_ffi;
