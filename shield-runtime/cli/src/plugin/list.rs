//! `shield plugin list` and `shield env list`.

use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use shield_host::plugin::{Kind, Registry};

use super::super::{Failure, output};

/// Prints what the registry found, of one kind or of all, and what it passed over.
pub fn list(registry: &Registry, kind: Option<Kind>) -> Result<(), Failure> {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["ID", "KIND", "VERSION", "FILE", "DESCRIPTION"]);
    let mut entries: Vec<_> = registry.entries().iter().collect();
    entries.retain(|entry| kind.is_none_or(|kind| entry.kind == kind));
    entries.sort_by_key(|entry| (entry.kind, entry.manifest.id.clone()));
    for entry in entries {
        let file = entry.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let manifest = &entry.manifest;
        table.add_row([&manifest.id, entry.kind.name(), &manifest.version, &file, &manifest.description]);
    }
    let mut text = table.to_string();
    for duplicate in registry.duplicates() {
        text += &format!("\n\nwarning: {duplicate}");
    }
    if !registry.skipped().is_empty() {
        text += "\n\nPassed over:";
        for skipped in registry.skipped() {
            text += &format!("\n  {}: {}", skipped.path.display(), skipped.reason);
        }
    }
    output::result(text)
}
