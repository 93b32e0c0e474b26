//! Which plugins a configuration names, and what of their configuration it leaves out.

use anyhow::Result;
use serde_json::{Map, Value, to_string_pretty, to_value};
use shield_api::manifest::Manifest;
use shield_config::experiment::PluginChoice;
use shield_host::plugin::{Kind, PluginError, Registry};

/// A field that names a plugin, the plugin's kind, and the choice.
pub type Named<'a> = (String, Kind, &'a PluginChoice);

/// `plugins.json`: which plugin each field is, with version and the SHA-256 of its file.
///
/// # Errors
/// A plugin is missing, or its file cannot be read.
pub fn plugins_json(registry: &Registry, plugins: &[Named<'_>]) -> Result<String> {
    let mut identities = Map::new();
    for (path, kind, choice) in plugins {
        let identity = to_value(registry.identify(&choice.selection(), *kind)?)?;
        identities.insert(path.clone(), identity);
    }
    Ok(to_string_pretty(&Value::Object(identities))? + "\n")
}

/// The manifest of each plugin.
///
/// # Errors
/// A plugin is missing.
pub fn manifests(registry: &Registry, plugins: &[Named<'_>]) -> Result<Vec<Manifest>, PluginError> {
    let entry = |(_, kind, choice): &Named<'_>| registry.entry(&choice.selection(), *kind);
    plugins.iter().map(|named| entry(named).map(|entry| entry.manifest)).collect()
}

/// The fields of the plugin with this id, with their defaults as RON.
pub fn fields_of(manifests: &[Manifest], id: &str) -> Vec<(String, String)> {
    let fields = manifests.iter().find(|manifest| manifest.id == id).map(|manifest| &manifest.fields);
    fields.into_iter().flatten().map(|field| (field.name.clone(), field.default.clone())).collect()
}
