//! The glue that [`export_plugin!`](crate::export_plugin!) puts between the tables and the traits.
//!
//! Each trampoline checks its pointers, calls the trait inside `catch_unwind`, keeps the error's message for `last_error`, and
//! returns a status. A panic never crosses the line: its message and place are kept, and the instance refuses every
//! further call.

mod environment;
mod kinds;
mod life;
mod success_critic;
mod undo_rule;
mod weights;

pub use environment::environment;
pub use kinds::{abort_rule, learner, policy, reset_task};
pub use success_critic::success_critic;

/// Names of the kinds as the manifest writes them.
#[doc(hidden)]
pub const fn kind_name(macro_name: &'static str) -> &'static str {
    match macro_name.as_bytes() {
        b"abort_rule" => "abort-rule",
        b"reset_task" => "reset-task",
        b"success_critic" => "success-critic",
        _ => macro_name,
    }
}

/// Exports the plugins of a library. Write it once, at the end of the crate; the crate is a `cdylib`.
///
/// Each entry gives the kind (`environment`, `learner`, `policy`, `abort_rule`, `reset_task`, `success_critic`), the id under which
/// experiments name it, the type, a line of description, and whether the same seed gives the same behaviour. Version, authors
/// and licence come from the crate's `Cargo.toml`.
///
/// ```text
/// shield_api::export_plugin! {
///     environment "acme/arm" => Arm { description: "A planar arm", deterministic: true }
///     reset_task "acme/arm-home" => ArmHome { description: "Reset is the home pose", deterministic: true }
/// }
/// ```
#[macro_export]
macro_rules! export_plugin {
    ($( $kind:ident $id:literal => $type:ty { description: $description:literal, deterministic: $deterministic:literal $(,)? } )+) => {
        const _: () = {
            static PLUGINS: &[$crate::abi::PluginDescriptor] = &[
                $({
                    const PARTS: $crate::manifest::ManifestParts = $crate::manifest::ManifestParts {
                        id: $id,
                        kind: $crate::export::kind_name(stringify!($kind)),
                        version: env!("CARGO_PKG_VERSION"),
                        abi: $crate::abi::ABI_VERSION,
                        panic: if cfg!(panic = "abort") { "abort" } else { "unwind" },
                        authors: env!("CARGO_PKG_AUTHORS"),
                        license: env!("CARGO_PKG_LICENSE"),
                        description: $description,
                        deterministic: $deterministic,
                        fields: <<$type as $crate::Plugin>::Config as $crate::PluginConfig>::FIELDS,
                    };
                    #[used]
                    #[unsafe(link_section = ".shield_manifest")]
                    static MANIFEST: [u8; $crate::manifest::encoded_len(&PARTS)] = $crate::manifest::encode(&PARTS);
                    $crate::export::$kind::<$type>(&MANIFEST)
                }),+
            ];

            static LIBRARY: $crate::abi::PluginLibrary = $crate::abi::PluginLibrary {
                struct_size: size_of::<$crate::abi::PluginLibrary>(),
                abi_major: $crate::abi::ABI_MAJOR,
                abi_minor: $crate::abi::ABI_MINOR,
                plugin_count: PLUGINS.len(),
                plugins: PLUGINS.as_ptr(),
            };

            /// The door for everything that is not Rust.
            #[unsafe(no_mangle)]
            pub extern "C" fn shield_plugin_entry_v1() -> *const $crate::abi::PluginLibrary {
                &LIBRARY
            }

            extern "C" fn module() -> $crate::reexports::abi_stable::library::RootModuleResult {
                fn load() -> $crate::abi::PluginModuleRef {
                    use $crate::reexports::abi_stable::prefix_type::PrefixTypeTrait as _;
                    $crate::abi::PluginModule { library: &LIBRARY }.leak_into_prefix()
                }
                $crate::reexports::abi_stable::library::__call_root_module_loader(load)
            }

            /// The door for Rust: the name is what `abi_stable` looks for.
            #[unsafe(export_name = "_1as_0lib_1header_0root_bmodule_bloader")]
            pub static ROOT_MODULE: $crate::reexports::abi_stable::library::LibHeader = unsafe {
                $crate::reexports::abi_stable::library::LibHeader::from_constructor::<$crate::abi::PluginModuleRef>(
                    module,
                    $crate::reexports::abi_stable::library::CheckTypeLayout::Yes,
                )
            };
        };
    };
}
