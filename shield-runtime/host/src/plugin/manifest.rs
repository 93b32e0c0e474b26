//! Reading manifests from a file without loading it: nothing of the file is executed.

use std::path::Path;

use object::{Object, ObjectSection, ReadCache};
use shield_api::{
    abi::ABI_MAJOR,
    manifest::{Manifest, SECTION, decode_section},
};

use super::{Kind, PluginError, file::LibraryFile};

/// The manifests of all plugins in the library at `path`. Reads the file's headers and one section, not the whole file.
///
/// # Errors
/// The file cannot be read, is not a complete library, or has no manifest that can be understood.
pub fn read_manifests(path: &Path) -> Result<Vec<Manifest>, PluginError> {
    manifests_in(&LibraryFile::open(path)?)
}

/// As [`read_manifests`].
pub(super) fn manifests_in(file: &LibraryFile) -> Result<Vec<Manifest>, PluginError> {
    let path = file.path();
    let not_a_library =
        |error: object::Error| PluginError::NotALibrary { path: path.into(), reason: error.to_string() };
    let cache = ReadCache::new(file.file());
    let object = object::File::parse(&cache).map_err(not_a_library)?;
    let section =
        object.section_by_name(SECTION).ok_or_else(|| PluginError::NoManifest { path: path.into() })?;
    let bytes = section.data().map_err(not_a_library)?;
    decode_section(bytes).map_err(|reason| PluginError::BadManifest { path: path.into(), reason })
}

/// How a library enters this process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Language {
    /// By the root module of `abi_stable`, whose layout is compared.
    Rust,
    /// By the C symbol, whose tables are checked word by word.
    C,
}

impl Language {
    fn from_name(name: &str) -> Option<Self> {
        match name {
            "rust" => Some(Self::Rust),
            "c" => Some(Self::C),
            _ => None,
        }
    }
}

/// The kind of a plugin.
pub(super) fn kind_of(path: &Path, manifest: &Manifest) -> Result<Kind, PluginError> {
    Kind::from_name(&manifest.kind).ok_or_else(|| PluginError::BadManifest {
        path: path.into(),
        reason: format!("{:?} is of the unknown kind {:?}", manifest.id, manifest.kind),
    })
}

/// Refuses manifests of libraries that this host must not load; says in which language the library is written.
pub(super) fn check_manifests(path: &Path, manifests: &[Manifest]) -> Result<Language, PluginError> {
    let malformed = |reason: String| PluginError::BadManifest { path: path.into(), reason };
    let mut languages = Vec::with_capacity(manifests.len());
    for manifest in manifests {
        let id = manifest.id.clone();
        if manifest.abi.0 != ABI_MAJOR {
            return Err(PluginError::Interface { path: path.into(), id, abi: manifest.abi });
        }
        kind_of(path, manifest)?;
        let language = Language::from_name(&manifest.language);
        languages.push(language.ok_or_else(|| {
            malformed(format!(
                "{id:?} says the language {:?}; known are \"rust\" and \"c\"",
                manifest.language
            ))
        })?);
    }
    match languages.first() {
        Some(first) if languages.iter().all(|language| language == first) => Ok(*first),
        _ => Err(malformed("its plugins name different languages".into())),
    }
}

/// Refuses libraries in which a panic would end this process.
pub(super) fn refuse_aborting(path: &Path, manifests: &[Manifest]) -> Result<(), PluginError> {
    match manifests.iter().find(|manifest| manifest.panic == "abort") {
        Some(manifest) => Err(PluginError::PanicAborts { path: path.into(), id: manifest.id.clone() }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest(language: &str) -> Manifest {
        Manifest {
            id: "acme/rule".into(),
            kind: "abort-rule".into(),
            version: "1.0.0".into(),
            abi: (1, 7),
            language: language.into(),
            panic: "unwind".into(),
            authors: "A".into(),
            license: "MIT".into(),
            description: "Says no".into(),
            deterministic: true,
            fields: Vec::new(),
        }
    }

    #[test]
    fn a_newer_minor_version_is_accepted() {
        let language = check_manifests(Path::new("a.so"), &[manifest("c"), manifest("c")]);
        assert_eq!(language, Ok(Language::C));
    }

    #[test]
    fn a_library_of_two_languages_is_refused() {
        let error = check_manifests(Path::new("a.so"), &[manifest("rust"), manifest("c")]).unwrap_err();
        assert!(error.to_string().contains("name different languages"), "{error}");
    }
}
