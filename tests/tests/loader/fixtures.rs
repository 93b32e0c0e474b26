//! Building and loading the libraries.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use shield_api::{Setup, Space, Spaces};
use shield_runtime::plugin::{Library, PluginError, host};
use shield_tests::succeed;

fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures")
}

/// Beside the temporary folder of the tests, so that dependencies are compiled once.
fn target() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap().join("fixtures")
}

/// The Rust library of that name.
pub fn fixture(name: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        cargo(&["build", "--workspace", "--exclude", "aborting"]);
        // One crate alone is compiled with another panic strategy: that needs no second copy of its dependencies.
        cargo(&["rustc", "--package", "aborting", "--", "-C", "panic=abort"]);
    });
    target().join("debug").join(file_name(name))
}

fn file_name(name: &str) -> String {
    format!("{}{}{}", env::consts::DLL_PREFIX, name.replace('-', "_"), env::consts::DLL_SUFFIX)
}

fn cargo(arguments: &[&str]) {
    let (subcommand, rest) = arguments.split_first().unwrap();
    succeed(
        Command::new(env!("CARGO"))
            .arg(subcommand)
            .arg("--manifest-path")
            .arg(sources().join("Cargo.toml"))
            .arg("--target-dir")
            .arg(target())
            .args(rest),
    );
}

/// The Rust library of that name, optimised.
pub fn optimised_fixture(name: &str) -> PathBuf {
    cargo(&["build", "--release", "--package", name]);
    target().join("release").join(file_name(name))
}

/// The rule in C with the given macros defined.
pub fn c_fixture(name: &str, defines: &[&str]) -> PathBuf {
    let path = c_path(name);
    compile_rule(&path, defines, &[]);
    path
}

/// The success critic in C with the given macros defined.
pub fn c_critic(name: &str, defines: &[&str]) -> PathBuf {
    let path = c_path(&format!("critic_{name}"));
    compile(&path, "critic.c", defines, &[]);
    path
}

fn c_path(name: &str) -> PathBuf {
    let folder = target().join("c");
    fs::create_dir_all(&folder).unwrap();
    folder.join(format!("{name}{}", env::consts::DLL_SUFFIX))
}

/// Builds the rule in C at `path`, with the given macros defined and more for the linker.
pub fn compile_rule(path: &Path, defines: &[&str], link: &[&str]) {
    compile(path, "rule.c", defines, link);
}

fn compile(path: &Path, source: &str, defines: &[&str], link: &[&str]) {
    let mut cc = shared_library(path);
    cc.args(defines.iter().map(|define| format!("-D{define}")))
        .arg("-I")
        .arg(sources().join("../../shield-api/include"))
        .arg(sources().join("c").join(source))
        .args(link)
        .arg("-lm");
    succeed(&mut cc);
}

/// Builds a library from C that is no plugin; its name for the linker is that of its file.
pub fn compile_c(path: &Path, source: &str) {
    let file = path.with_extension("c");
    fs::write(&file, source).unwrap();
    let name = path.file_name().unwrap().to_str().unwrap();
    succeed(shared_library(path).arg(format!("-Wl,-soname,{name}")).arg(&file));
    fs::remove_file(file).unwrap();
}

fn shared_library(path: &Path) -> Command {
    let mut cc = Command::new("cc");
    cc.args(["-std=c11", "-Wall", "-Wextra", "-O1", "-fPIC", "-shared", "-o"]).arg(path);
    cc
}

/// The error of loading the library at `path`; panics if it loads.
pub fn refusal(path: &Path) -> PluginError {
    Library::load(path).expect_err("the library was loaded")
}

/// Checks that loading is refused with a message that has all of `parts`, names the file, and is one short paragraph.
pub fn check_refusal(path: &Path, parts: &[&str]) {
    let message = refusal(path).to_string();
    let name = path.file_name().unwrap().to_str().unwrap();
    for part in parts.iter().chain(&[name]) {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
    assert!(message.len() < 1_000 && !message.contains('\n'), "{message}");
}

/// The setup of an instance with a seed of 3, two observed values and one action in [-1, 1].
pub fn setup() -> Setup {
    let spaces = Spaces { observation: Space::unbounded(2), action: Space::uniform(1, -1.0, 1.0) };
    Setup::with_spaces(3, 1, host(), spaces)
}
