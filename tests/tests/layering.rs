//! The direction of dependencies between the crates, as `cargo metadata` sees them.
#![allow(clippy::unwrap_used, reason = "a test")]

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::process::Command;

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, Package, PackageId};

/// Lines that a file has at most.
const LONGEST_FILE: usize = 400;

/// Files that are longer, because they are tables: what they say stands side by side.
const TABLES: [&str; 1] = ["shield-api/src/abi.rs"];

/// Heavy libraries, which live behind the plugin line.
const HEAVY: [&str; 5] = ["mujoco-rs", "tch", "torch-sys", "pyo3", "pyo3-ffi"];

fn metadata() -> Metadata {
    let version = Command::new("rustc").arg("-vV").output().unwrap();
    let version = String::from_utf8(version.stdout).unwrap();
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
    // Of this platform only: the crates of the others need not be on disk.
    MetadataCommand::new()
        .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml"))
        .other_options(vec!["--filter-platform".into(), host.into()])
        .exec()
        .unwrap()
}

/// The names of our own crates on which a package depends: for building, for testing or at run time.
fn own_dependencies(metadata: &Metadata, package: &Package) -> BTreeSet<String> {
    let own: BTreeSet<String> =
        metadata.workspace_packages().iter().map(|package| package.name.to_string()).collect();
    let named = package.dependencies.iter().map(|dependency| dependency.name.clone());
    named.filter(|name| own.contains(name)).collect()
}

/// The packages that lie in a folder such as `plugins`.
fn packages_in<'a>(metadata: &'a Metadata, folder: &str) -> Vec<&'a Package> {
    let parent = metadata.workspace_root.join(folder);
    let lies_there = |package: &&Package| package.manifest_path.ancestors().nth(2) == Some(&parent);
    let found: Vec<&Package> = metadata.workspace_packages().into_iter().filter(lies_there).collect();
    assert!(!found.is_empty(), "nothing in {folder}");
    found
}

/// Plugins and environments; the libraries beside them, which are neither, left out.
fn plugins(metadata: &Metadata) -> Vec<&Package> {
    let mut found = [packages_in(metadata, "plugins"), packages_in(metadata, "envs")].concat();
    found.retain(|package| !["actor-critic", "learner-kit", "rule-kit"].contains(&package.name.as_str()));
    found
}

fn package<'a>(metadata: &'a Metadata, name: &str) -> &'a Package {
    let all = metadata.workspace_packages();
    all.into_iter().find(|package| package.name == name).unwrap_or_else(|| panic!("no package {name}"))
}

fn assert_own_dependencies(metadata: &Metadata, package: &Package, allowed: &[&str]) {
    let mut excess = own_dependencies(metadata, package);
    excess.retain(|name| !allowed.contains(&name.as_str()));
    assert!(excess.is_empty(), "{} depends on {excess:?}; of ours it may on {allowed:?}", package.name);
}

/// Every package that is linked into the given one or helps to build it.
fn everything_below(metadata: &Metadata, package: &Package) -> BTreeSet<String> {
    let resolve = metadata.resolve.as_ref().unwrap();
    let nodes: HashMap<&PackageId, _> = resolve.nodes.iter().map(|node| (&node.id, node)).collect();
    let mut seen: BTreeSet<&PackageId> = BTreeSet::new();
    let mut open = vec![&package.id];
    while let Some(id) = open.pop() {
        if !seen.insert(id) {
            continue;
        }
        let shipped = nodes[id].deps.iter().filter(|dependency| {
            dependency.dep_kinds.iter().any(|info| info.kind != DependencyKind::Development)
        });
        open.extend(shipped.map(|dependency| &dependency.pkg));
    }
    seen.into_iter().map(|id| metadata[id].name.to_string()).collect()
}

#[test]
fn plugins_and_environments_do_not_depend_on_the_host() {
    let metadata = metadata();
    for package in plugins(&metadata) {
        assert_own_dependencies(
            &metadata,
            package,
            &["shield-api", "actor-critic", "learner-kit", "rule-kit", "shield-worker"],
        );
    }
}

#[test]
fn the_interface_the_workers_and_the_kits_depend_on_nothing_above_them() {
    let metadata = metadata();
    assert_own_dependencies(&metadata, package(&metadata, "shield-worker"), &[]);
    assert_own_dependencies(&metadata, package(&metadata, "actor-critic"), &[]);
    assert_own_dependencies(&metadata, package(&metadata, "rule-kit"), &["shield-api"]);
    assert_own_dependencies(&metadata, package(&metadata, "learner-kit"), &["shield-api", "actor-critic"]);
    assert_own_dependencies(&metadata, package(&metadata, "shield-api"), &[]);
}

/// The crates of the runtime, from below, each with those on which it may build.
const RUNTIME: [(&str, &[&str]); 8] = [
    ("shield-core", &["shield-api"]),
    ("shield-host", &["shield-api", "shield-worker"]),
    ("shield-config", &["shield-api", "shield-core", "shield-host"]),
    ("shield-decisions", &["shield-api", "shield-core", "shield-host", "shield-config"]),
    ("shield-lab", &["shield-api", "shield-core", "shield-host", "shield-config", "shield-decisions"]),
    ("shield-report", &["shield-api", "shield-core", "shield-host", "shield-config", "shield-lab"]),
    ("shield-check", &["shield-api", "shield-host"]),
    (
        "shield-runtime",
        &[
            "shield-api",
            "shield-core",
            "shield-host",
            "shield-config",
            "shield-decisions",
            "shield-lab",
            "shield-report",
            "shield-check",
        ],
    ),
];

#[test]
fn the_crates_of_the_runtime_build_on_those_below_them() {
    let metadata = metadata();
    for (name, below) in RUNTIME {
        assert_own_dependencies(&metadata, package(&metadata, name), below);
    }
    let inside = packages_in(&metadata, "shield-runtime");
    for package in inside.iter().filter(|package| package.name != "shield-cli") {
        assert!(RUNTIME.iter().any(|(known, _)| package.name == *known), "{} has no place", package.name);
    }
}

/// The packages that a crate compiles, itself included, for itself and for what builds it.
fn compiled(arguments: &[&str]) -> BTreeSet<String> {
    let tree = Command::new(env!("CARGO"))
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(".."))
        .args(["tree", "--edges", "normal,build", "--prefix", "none", "--format", "{p}"])
        .args(arguments)
        .output()
        .unwrap();
    assert!(tree.status.success(), "{}", String::from_utf8_lossy(&tree.stderr));
    let tree = String::from_utf8(tree.stdout).unwrap();
    tree.lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
}

#[test]
fn an_embedder_compiles_few_packages() {
    let core = compiled(&["--package", "shield-core", "--no-default-features"]);
    assert!(core.len() <= 60 && core.len() > 10, "{}: {core:#?}", core.len());
    let drop_in = ["--package", "shield-runtime", "--no-default-features", "--features", "clarabel"];
    let drop_in = compiled(&drop_in);
    assert!(drop_in.len() <= 110 && drop_in.len() > core.len(), "{}: {drop_in:#?}", drop_in.len());
    let for_c = compiled(&["--package", "shield-c"]);
    assert!(for_c.len() <= 110, "{}: {for_c:#?}", for_c.len());
}

#[test]
fn the_c_and_python_libraries_depend_on_no_plugin() {
    let metadata = metadata();
    for binding in ["shield-c", "shield-python"] {
        assert_own_dependencies(&metadata, package(&metadata, binding), &["shield-api", "shield-runtime"]);
    }
    let python = everything_below(&metadata, package(&metadata, "shield-python"));
    assert!(python.contains("pyo3"), "Python is not seen where it is used");
}

#[test]
fn the_host_links_no_heavy_library() {
    let metadata = metadata();
    let below = everything_below(&metadata, package(&metadata, "shield-cli"));
    assert!(below.contains("abi_stable_derive"), "the graph is not followed: {below:?}");
    let heavy: Vec<&str> = HEAVY.into_iter().filter(|name| below.contains(*name)).collect();
    assert!(heavy.is_empty(), "the program reaches {heavy:?}");
    let core = &package(&metadata, "shield-core").dependencies;
    let foreign = |name: &str| ["ron", "libloading", "object"].contains(&name);
    assert!(!core.iter().any(|dependency| foreign(&dependency.name)), "the core knows texts or libraries");
    let robots = everything_below(&metadata, package(&metadata, "mujoco-robots"));
    assert!(robots.contains("mujoco-rs"), "MuJoCo is not seen where it is used");
}

#[test]
fn every_plugin_is_a_shared_library_alone() {
    let metadata = metadata();
    for package in plugins(&metadata) {
        let libraries = package.targets.iter().filter(|target| target.is_lib() || target.is_cdylib());
        let kinds: Vec<String> =
            libraries.flat_map(|target| &target.crate_types).map(ToString::to_string).collect();
        assert_eq!(kinds, ["cdylib"], "{}", package.name);
    }
}

/// Our own source files in Rust and Python, below a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let (kind, path) = entry.map(|entry| (entry.file_type().unwrap(), entry.path())).unwrap();
        let name = path.file_name().unwrap().to_str().unwrap();
        if kind.is_dir() && !["target", "native"].contains(&name) && !name.starts_with('.') {
            sources(&path, found);
        } else if kind.is_file() && path.extension().is_some_and(|kind| kind == "rs" || kind == "py") {
            found.push(path);
        }
    }
}

#[test]
fn no_file_is_too_long_to_be_read_but_for_tables() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    let mut found = Vec::new();
    sources(&root, &mut found);
    assert!(found.len() > 400, "only {} files were found", found.len());
    let long: Vec<String> = found
        .iter()
        .filter(|path| std::fs::read_to_string(path).unwrap().lines().count() > LONGEST_FILE)
        .map(|path| path.strip_prefix(&root).unwrap().to_str().unwrap().replace('\\', "/"))
        .collect();
    assert_eq!(long, TABLES, "files of more than {LONGEST_FILE} lines: split them by what they are about");
}
