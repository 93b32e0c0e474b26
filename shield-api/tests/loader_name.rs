//! The name of the Rust door is a literal in `export_plugin!`: it must be the one that `abi_stable` looks for.

#[test]
fn the_rust_entry_has_the_name_that_abi_stable_looks_for() {
    let source = include_str!("../src/export.rs");
    let name = shield_api::reexports::abi_stable::library::ROOT_MODULE_LOADER_NAME;
    assert!(source.contains(&format!("export_name = \"{name}\"")), "the name is {name}");
}
