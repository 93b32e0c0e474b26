//! The licences of what is linked into the archive's program and libraries. Most of them ask to be given along.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs;

use anyhow::{Context, Result};
use cargo_metadata::{DependencyKind, Metadata, Node, Package, PackageId};

/// How a file with a licence or a notice begins, in capitals.
const NAMES: [&str; 5] = ["LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "NOTICE"];
const HEAD: &str = "What is linked into the program and the libraries beside this folder, with the licences that came with it. \
                    The Rust standard library is under the MIT or the Apache-2.0 licence, too.\n";

/// The licences of all packages that the workspace's are linked with, `left_out` of them aside: each text once, below the names of the
/// packages that it came with.
///
/// # Errors
/// A licence cannot be read.
pub fn of_dependencies(metadata: &Metadata, left_out: &[&str]) -> Result<String> {
    let mut texts: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut without = BTreeSet::new();
    for package in linked(metadata, left_out)? {
        let name = format!("{} {}", package.name, package.version);
        let own = own_texts(package).with_context(|| format!("the licence of {name} cannot be read"))?;
        if own.is_empty() {
            without.insert(format!("{name}: {}", package.license.as_deref().unwrap_or("not said")));
        }
        for text in own {
            texts.entry(text).or_default().insert(name.clone());
        }
    }
    let mut sections: Vec<String> = texts
        .into_iter()
        .map(|(text, names)| {
            let names: Vec<String> = names.into_iter().collect();
            format!("{}\n\n{}\n", names.join(", "), text.trim_end())
        })
        .collect();
    sections.sort();
    if !without.is_empty() {
        let names: Vec<String> = without.into_iter().collect();
        sections.push(format!("These came without the text of their licence:\n\n{}\n", names.join("\n")));
    }
    let rule = format!("\n{}\n\n", "=".repeat(100));
    Ok(format!("{HEAD}{rule}{}", sections.join(&rule)))
}

/// What is linked into the packages of the workspace, itself aside. That a build script or a test needs it does not count.
fn linked<'a>(metadata: &'a Metadata, left_out: &[&str]) -> Result<Vec<&'a Package>> {
    let resolved = metadata.resolve.as_ref().context("cargo says nothing of dependencies")?;
    let nodes: HashMap<&PackageId, &Node> = resolved.nodes.iter().map(|node| (&node.id, node)).collect();
    let packed =
        metadata.workspace_packages().into_iter().filter(|own| !left_out.contains(&own.name.as_str()));
    let mut open: Vec<&PackageId> = packed.map(|own| &own.id).collect();
    let mut found = BTreeSet::new();
    while let Some(id) = open.pop() {
        if !found.insert(id) {
            continue;
        }
        let node = nodes.get(id).with_context(|| format!("cargo does not say what {id} depends on"))?;
        let needed = node
            .deps
            .iter()
            .filter(|dependency| dependency.dep_kinds.iter().any(|kind| kind.kind == DependencyKind::Normal));
        open.extend(needed.map(|dependency| &dependency.pkg));
    }
    let is_foreign =
        |package: &&Package| found.contains(&package.id) && !metadata.workspace_members.contains(&package.id);
    Ok(metadata.packages.iter().filter(is_foreign).collect())
}

/// The licences and notices that lie in the package's folder.
fn own_texts(package: &Package) -> Result<Vec<String>> {
    let folder = package.manifest_path.parent().context("a manifest lies in a folder")?;
    let mut texts = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().to_uppercase()).unwrap_or_default();
        let is_named = package.license_file().is_some_and(|named| path == named.as_std_path());
        if path.is_file() && (is_named || NAMES.iter().any(|known| name.starts_with(known))) {
            texts.push(String::from_utf8_lossy(&fs::read(&path)?).replace("\r\n", "\n"));
        }
    }
    Ok(texts)
}
