//! The manifest: what a plugin says of itself, readable from the file without executing it.
//!
//! It is text in a section of the library, [`SECTION`]: a magic line, then `key=value` entries, each closed by the unit
//! separator `0x1f`; the record separator `0x1e` ends the manifest. Entries named `field`, `type`, `default`
//! and `doc` describe the configuration, one after the other. A macro writes it at compile time, in C by joining literals.

use crate::Field;

/// Name of the section that holds the manifests of a library.
pub const SECTION: &str = ".shield_manifest";
/// How each manifest begins.
pub const MAGIC: &str = "SHIELD MANIFEST 1\x1f";
const UNIT: char = '\x1f';
const RECORD: char = '\x1e';

/// What [`export_plugin!`](crate::export_plugin!) knows of a plugin when it is compiled.
#[derive(Debug, Clone, Copy)]
pub struct ManifestParts {
    /// For example `mujoco/cliff-cheetah`.
    pub id: &'static str,
    /// `environment`, `learner`, `policy`, `abort-rule` or `reset-task`.
    pub kind: &'static str,
    /// Version of the plugin's crate.
    pub version: &'static str,
    /// Version of the interface, for example `1.0`.
    pub abi: &'static str,
    /// `unwind` or `abort`.
    pub panic: &'static str,
    /// Authors, separated by colons.
    pub authors: &'static str,
    /// SPDX expression.
    pub license: &'static str,
    /// One line for people.
    pub description: &'static str,
    /// Whether the same seed gives the same behaviour.
    pub deterministic: bool,
    /// The configuration.
    pub fields: &'static [Field],
}

/// Length of the encoded manifest in bytes.
pub const fn encoded_len(parts: &ManifestParts) -> usize {
    encode_into(parts, &mut [])
}

/// The encoded manifest. `N` is [`encoded_len`].
pub const fn encode<const N: usize>(parts: &ManifestParts) -> [u8; N] {
    let mut bytes = [0; N];
    encode_into(parts, &mut bytes);
    bytes
}

/// Writes into `out` if it is long enough; an empty `out` only counts.
const fn encode_into(parts: &ManifestParts, out: &mut [u8]) -> usize {
    let mut at = put(out, 0, MAGIC);
    at = entry(out, at, "id=", parts.id);
    at = entry(out, at, "kind=", parts.kind);
    at = entry(out, at, "version=", parts.version);
    at = entry(out, at, "abi=", parts.abi);
    at = entry(out, at, "language=", "rust");
    at = entry(out, at, "panic=", parts.panic);
    at = entry(out, at, "authors=", parts.authors);
    at = entry(out, at, "license=", parts.license);
    at = entry(out, at, "description=", parts.description);
    at = entry(out, at, "deterministic=", if parts.deterministic { "true" } else { "false" });
    let mut index = 0;
    while index < parts.fields.len() {
        let field = &parts.fields[index];
        at = entry(out, at, "field=", field.name);
        at = entry(out, at, "type=", field.kind);
        at = entry(out, at, "default=", field.default);
        at = entry(out, at, "doc=", field.doc);
        index += 1;
    }
    put(out, at, "\x1e")
}

const fn entry(out: &mut [u8], at: usize, key: &str, value: &str) -> usize {
    let at = put(out, at, key);
    let at = put(out, at, value);
    put(out, at, "\x1f")
}

const fn put(out: &mut [u8], at: usize, text: &str) -> usize {
    let bytes = text.as_bytes();
    let mut index = 0;
    while !out.is_empty() && index < bytes.len() {
        out[at + index] = bytes[index];
        index += 1;
    }
    at + bytes.len()
}

/// A manifest as the host reads it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Manifest {
    /// For example `mujoco/cliff-cheetah`.
    pub id: String,
    /// `environment`, `learner`, `policy`, `abort-rule` or `reset-task`.
    pub kind: String,
    /// Version of the plugin.
    pub version: String,
    /// Major and minor version of the interface.
    pub abi: (u32, u32),
    /// `rust` or `c`.
    pub language: String,
    /// `unwind` or `abort`.
    pub panic: String,
    /// Authors, separated by colons.
    pub authors: String,
    /// SPDX expression.
    pub license: String,
    /// One line for people.
    pub description: String,
    /// Whether the same seed gives the same behaviour.
    pub deterministic: bool,
    /// The configuration's fields.
    pub fields: Vec<ManifestField>,
}

/// One field of a plugin's configuration.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ManifestField {
    /// Its name in RON.
    pub name: String,
    /// Its type.
    pub kind: String,
    /// Its default, as RON text.
    pub default: String,
    /// What it does.
    pub doc: String,
}

/// Reads every manifest in the bytes of a section.
///
/// # Errors
/// A sentence that says what is wrong with which manifest.
pub fn decode_section(bytes: &[u8]) -> Result<Vec<Manifest>, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "the manifest is not UTF-8 text".to_string())?;
    let manifests: Vec<Manifest> = text
        .split(RECORD)
        .map(|record| record.trim_start_matches('\0'))
        .filter(|record| !record.is_empty())
        .map(decode)
        .collect::<Result<_, _>>()?;
    if manifests.is_empty() { Err("the manifest section is empty".into()) } else { Ok(manifests) }
}

/// Reads one manifest, with or without its closing separator.
///
/// # Errors
/// A sentence that says what is missing or malformed.
pub fn decode(record: &str) -> Result<Manifest, String> {
    let body = record
        .strip_prefix(MAGIC)
        .ok_or_else(|| "a manifest does not begin with its magic line".to_string())?
        .trim_end_matches(RECORD);
    let entries: Vec<(&str, &str)> = body
        .split_terminator(UNIT)
        .map(|entry| {
            entry.split_once('=').ok_or_else(|| format!("the manifest entry {entry:?} has no value"))
        })
        .collect::<Result<_, _>>()?;
    let get = |key: &str| {
        let found = entries.iter().find(|(name, _)| *name == key).map(|(_, value)| (*value).to_string());
        found.ok_or_else(|| format!("the manifest has no {key:?}"))
    };
    let abi = get("abi")?;
    let abi = abi
        .split_once('.')
        .and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?)))
        .ok_or_else(|| format!("the manifest's interface version {abi:?} is not of the form 1.0"))?;
    let id = get("id")?;
    if id.is_empty() {
        return Err("the manifest's id is empty".into());
    }
    Ok(Manifest {
        id,
        abi,
        kind: get("kind")?,
        version: get("version")?,
        language: get("language")?,
        panic: get("panic")?,
        authors: get("authors")?,
        license: get("license")?,
        description: get("description")?,
        deterministic: get("deterministic")? == "true",
        fields: decode_fields(&entries),
    })
}

fn decode_fields(entries: &[(&str, &str)]) -> Vec<ManifestField> {
    let mut fields: Vec<ManifestField> = Vec::new();
    for (key, value) in entries {
        let value = (*value).trim().to_string();
        match (*key, fields.last_mut()) {
            ("field", _) => fields.push(ManifestField { name: value, ..ManifestField::default() }),
            ("type", Some(field)) => field.kind = value,
            ("default", Some(field)) => field.default = value,
            ("doc", Some(field)) => field.doc = value,
            _ => {}
        }
    }
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARTS: ManifestParts = ManifestParts {
        id: "acme/rule",
        kind: "abort-rule",
        version: "0.3.1",
        abi: "1.0",
        panic: "unwind",
        authors: "A:B",
        license: "MIT",
        description: "Says no",
        deterministic: true,
        fields: &[Field { name: "limit", kind: "f32", default: "0.5", doc: " The limit." }],
    };

    #[test]
    fn a_manifest_encoded_at_compile_time_is_decoded() {
        static BYTES: [u8; encoded_len(&PARTS)] = encode(&PARTS);
        let mut section = BYTES.to_vec();
        section.extend([0; 7]);
        section.extend(BYTES);
        let manifests = decode_section(&section).unwrap();
        assert_eq!(manifests.len(), 2);
        assert_eq!(manifests[0], manifests[1]);
        let manifest = &manifests[0];
        assert_eq!((manifest.id.as_str(), manifest.abi, manifest.deterministic), ("acme/rule", (1, 0), true));
        assert_eq!(manifest.fields[0].doc, "The limit.");
    }

    #[test]
    fn a_truncated_or_foreign_manifest_is_refused() {
        let bytes: [u8; encoded_len(&PARTS)] = encode(&PARTS);
        for bad in [&bytes[..40], &bytes[5..], b"", b"\xff\xfe", b"\0\0"] {
            assert!(decode_section(bad).is_err(), "{bad:?}");
        }
    }
}
