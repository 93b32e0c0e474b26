//! `shield_plugin.h` is generated from the tables of `shield-api`, and this test keeps it current.
#![allow(clippy::unwrap_used, reason = "a test")]

use std::{env, fmt::Write as _, fs, path::Path};

use cbindgen::{Builder, Config};
use syn::{Attribute, Expr, Item, ItemConst, ItemMod, Lit, Meta, Visibility};

/// Set by `cargo xtask header`: the file is written instead of compared.
const WRITE: &str = "SHIELD_WRITE_HEADER";
/// The root module is the way in for Rust libraries; what an instance is, a C library defines for itself.
const NOT_IN_C: [&str; 2] = ["PluginModule", "Instance"];
const INSTANCE: &str = "
// An instance of a plugin: the library alone defines the struct.
typedef struct ShieldInstance ShieldInstance;
";

/// `#define SHIELD_STATUS_OK 0`, with the constant's documentation. `scope` is empty or the module's name.
fn define(scope: &str, constant: &ItemConst) -> String {
    let value = match &*constant.expr {
        Expr::Lit(literal) => match &literal.lit {
            Lit::Int(integer) => integer.base10_digits().to_string(),
            Lit::Str(text) => format!("{:?}", text.value()),
            other => panic!("{}: no literal for C: {other:?}", constant.ident),
        },
        other => panic!("{}: not a literal: {other:?}", constant.ident),
    };
    let mut lines = documentation(&constant.attrs);
    writeln!(lines, "#define SHIELD_{scope}{} {value}", constant.ident).unwrap();
    lines
}

fn module(module: &ItemMod) -> String {
    let mut lines = format!("\n{}", documentation(&module.attrs));
    let scope = format!("{}_", module.ident.to_string().to_uppercase());
    for item in module.content.iter().flat_map(|(_, items)| items) {
        let Item::Const(constant) = item else { panic!("{scope}: only constants have a form in C") };
        lines += &define(&scope, constant);
    }
    lines
}

fn documentation(attributes: &[Attribute]) -> String {
    let mut lines = String::new();
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("doc")) {
        let Meta::NameValue(pair) = &attribute.meta else { continue };
        let Expr::Lit(literal) = &pair.value else { continue };
        let Lit::Str(text) = &literal.lit else { continue };
        writeln!(lines, "//{}", text.value()).unwrap();
    }
    lines
}

#[test]
fn the_plugin_header_matches_the_tables() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shield-api/include");
    let source = folder.join("../src/abi.rs");
    let items = syn::parse_file(&fs::read_to_string(&source).unwrap()).unwrap().items;

    let mut config = Config::from_file(folder.join("cbindgen.toml")).unwrap();
    let mut constants = String::new();
    for item in &items {
        match item {
            Item::Struct(table) => {
                let name = table.ident.to_string();
                let is_for_c = !NOT_IN_C.contains(&name.as_str());
                if is_for_c { &mut config.export.include } else { &mut config.export.exclude }.push(name);
            }
            Item::Const(constant) => constants += &define("", constant),
            Item::Mod(part) if matches!(part.vis, Visibility::Public(_)) => constants += &module(part),
            _ => {}
        }
    }
    config.after_includes = Some(constants + INSTANCE);
    config.trailer = Some(fs::read_to_string(folder.join("manifest.h")).unwrap());

    check(config, &source, &folder.join("shield_plugin.h"));
}

#[test]
fn the_library_header_matches_its_exports() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shield-c/include");
    let config = Config::from_file(folder.join("cbindgen.toml")).unwrap();
    check(config, &folder.join("../src/ffi.rs"), &folder.join("shield.h"));
}

/// Compares a header with what its source gives, or writes it.
fn check(config: Config, source: &Path, path: &Path) {
    let mut generated = Vec::new();
    Builder::new().with_config(config).with_src(source).generate().unwrap().write(&mut generated);
    // Links and headings of rustdoc mean nothing in C.
    let generated = String::from_utf8(generated).unwrap().replace("[`", "`").replace("`]", "`");
    let generated = generated.replace("// # Safety\n//\n", "// The caller promises:\n");
    if env::var_os(WRITE).is_some() {
        fs::write(path, &generated).unwrap();
    }
    let committed = fs::read_to_string(path).unwrap_or_default();
    assert!(committed == generated, "{} is not current: run `cargo xtask header`", path.display());
}
