//! Values that a variant or the command line puts in the place of others.

use serde::Deserialize;
use serde::de::IgnoredAny;
use shield_api::ron_options;

use indexmap::IndexMap;

use super::ExperimentFile;
use super::error::{Fault, InputError, Location};
use super::tree::Node;

/// A value for one path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Override {
    /// For example `shield.rules[0].config.q_min`.
    pub path: String,
    /// RON text.
    pub value: String,
    pub(super) origin: Given,
}

/// Where an override was given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Given {
    /// On the command line, in this argument.
    Argument(String),
    /// In the file; the offsets of its path and of its value.
    File { path: usize, value: usize },
}

impl Override {
    /// Reads `path=value`, as `--set` takes it.
    ///
    /// # Errors
    /// There is no `=`, or the value is not RON.
    pub fn parse(assignment: &str) -> Result<Self, InputError> {
        let argument = format!("--set {assignment}");
        let Some((path, value)) = assignment.split_once('=') else {
            return Err(InputError {
                location: Location::Argument(argument),
                message: "there is no `=`".into(),
                remedy: Some("write `--set path=value`, for example `--set steps=5000`".into()),
            });
        };
        Self::new(path.trim(), value.trim(), argument)
    }

    /// An override that another argument stands for, such as `--steps 5000`.
    ///
    /// # Errors
    /// The value is not RON.
    pub fn new(path: &str, value: &str, argument: impl Into<String>) -> Result<Self, InputError> {
        let argument = argument.into();
        let wrong = |message: String, remedy| InputError {
            location: Location::Argument(argument.clone()),
            message: format!("the value {value:?} is not RON: {message}"),
            remedy,
        };
        let quotes = || Some("a text needs quotes, for the shell as well: --set 'name=\"x\"'".to_owned());
        if let Err(error) = ron_options().from_str::<IgnoredAny>(value) {
            return Err(wrong(Fault::from_ron(value, &error).message, quotes()));
        }
        let node = Node::parse(value).map_err(|_| wrong("it cannot be read".into(), quotes()))?;
        let value = value[node.span].to_owned();
        Ok(Self { path: path.into(), value, origin: Given::Argument(argument) })
    }
}

/// The only field that is read before the overrides are known.
#[derive(Deserialize)]
#[serde(rename = "Experiment")]
struct VariantsOnly {
    #[serde(default)]
    variants: IndexMap<String, Vec<(String, IgnoredAny)>>,
}

/// A variant as it stands in the file.
pub(super) struct Declared {
    pub name: String,
    pub name_start: usize,
    pub overrides: Vec<Override>,
}

/// The variants of a file whose tree is `root`, in its order.
pub(super) fn declared(file: &ExperimentFile, root: &Node) -> Result<Vec<Declared>, Fault> {
    let read: VariantsOnly =
        ron_options().from_str(&file.text).map_err(|error| Fault::from_ron(&file.text, &error))?;
    let Some(entry) = root.entries().iter().find(|entry| entry.key == "variants") else {
        return Ok(Vec::new());
    };
    let mut found: Vec<Declared> = Vec::new();
    for (name, pairs) in &read.variants {
        let mut same = entry.value.entries().iter().filter(|variant| variant.key == *name);
        let Some(variant) = same.next() else { continue };
        if let Some(second) = same.next() {
            let message = format!("the variant `{name}` is declared twice");
            return Err(Fault { offset: second.key_start, message, remedy: None });
        }
        let overrides = pairs.iter().zip(variant.value.items()).filter_map(|((path, _), pair)| {
            let [at_path, at_value] = pair.items() else { return None };
            Some(Override {
                path: path.clone(),
                value: file.text[at_value.span.clone()].to_owned(),
                origin: Given::File { path: at_path.span.start, value: at_value.span.start },
            })
        });
        let overrides = overrides.collect();
        found.push(Declared { name: name.clone(), name_start: variant.key_start, overrides });
    }
    Ok(found)
}
