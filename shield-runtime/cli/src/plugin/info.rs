//! `shield plugin info`: what a plugin says of itself.

use std::path::Path;

use clap::Args;
use shield_api::manifest::{Manifest, ManifestField};
use shield_host::plugin::{Entry, Kind, PluginError, Registry, fingerprint};

use super::super::{Failure, output};

/// Arguments of `shield plugin info`.
#[derive(Args)]
pub struct InfoArguments {
    /// An id, such as ddpg, or a library, such as target/release/libmine.so.
    plugin: String,
}

/// Prints the manifest of the plugin, or of every plugin in the library.
pub fn info(arguments: &InfoArguments, registry: &Registry) -> Result<(), Failure> {
    let refused = |error: PluginError| Failure::Input(error.to_string());
    for Entry { path, manifest, .. } in registry.named(&arguments.plugin).map_err(refused)? {
        let sha256 = fingerprint(&path).map_err(refused)?;
        output::result(described(&manifest, &path, &sha256))?;
    }
    Ok(())
}

fn described(manifest: &Manifest, path: &Path, sha256: &str) -> String {
    let Manifest { id, kind, version, language, panic, authors, license, description, .. } = manifest;
    let (major, minor) = manifest.abi;
    let repeats =
        if manifest.deterministic { "the same seed gives the same behaviour" } else { "not by seed" };
    let mut text = format!("{id} {version}, {kind}\n  {description}\n\n");
    for (name, value) in [
        ("file", path.display().to_string()),
        ("sha256", sha256.to_owned()),
        ("interface", format!("{major}.{minor}, written in {language}, panic = {panic}")),
        ("deterministic", repeats.to_owned()),
        ("authors", authors.replace(':', ", ")),
        ("licence", license.clone()),
    ] {
        text += &format!("  {name:<14}{value}\n");
    }
    text += "\nConfiguration\n";
    if manifest.fields.is_empty() {
        text += "  none\n";
    }
    for ManifestField { name, kind, default, doc } in &manifest.fields {
        text += &format!("  {name}: {kind} = {default}\n      {doc}\n");
    }
    text + "\nIn an experiment, with its defaults\n" + &example(manifest)
}

/// The field of an experiment that names the plugin.
fn example(manifest: &Manifest) -> String {
    let (before, after) = match Kind::from_name(&manifest.kind) {
        Some(Kind::Environment) => ("environment: ", ""),
        Some(Kind::Learner) => ("reset: ", ""),
        Some(Kind::Policy) => ("forward: Policy", ""),
        Some(Kind::AbortRule) => ("shield: (rules: [", "])"),
        Some(Kind::ResetTask) => ("reset_task: ", ""),
        Some(Kind::SuccessCritic) => ("shield: (success_critic: ", ")"),
        None => ("", ""),
    };
    let fields = manifest.fields.iter().map(|field| format!("      {}: {},\n", field.name, field.default));
    let fields: String = fields.collect();
    let config = if fields.is_empty() { String::new() } else { format!(", config: (\n{fields}  )") };
    format!("  {before}(plugin: {:?}{config}){after},\n", manifest.id)
}

#[cfg(test)]
mod tests {
    use super::*;
    use shield_config::experiment::ExperimentFile;

    #[test]
    fn the_example_of_every_kind_fits_into_an_experiment() {
        let field = ManifestField {
            name: "limit".into(),
            kind: "f32".into(),
            default: "0.5".into(),
            ..ManifestField::default()
        };
        for kind in Kind::ALL {
            let manifest = Manifest {
                id: "acme/it".into(),
                kind: kind.name().into(),
                version: "1.0.0".into(),
                abi: (1, 0),
                language: "c".into(),
                panic: "unwind".into(),
                authors: "A".into(),
                license: "MIT".into(),
                description: "It".into(),
                deterministic: true,
                fields: vec![field.clone()],
            };
            let example = example(&manifest);
            let mut others = vec!["environment: (plugin: \"e\")", "forward: Policy(plugin: \"p\")"];
            others.push("shield: (rules: [(plugin: \"r\")])");
            others.push("reset: (plugin: \"l\")");
            others.retain(|other| other.split(':').next() != example.trim().split(':').next());
            let text = format!("(name: \"x\", steps: 1, seeds: [0], {}, {example})", others.join(", "));
            let read = ExperimentFile::from_text("x.ron", text.clone()).variants(&[], None);
            let variants = read.unwrap_or_else(|error| panic!("{error} in {text}"));
            let plugins = variants[0].experiment.plugins();
            assert!(plugins.iter().any(|(_, _, choice)| choice.plugin == "acme/it"), "{text}");
        }
    }
}
