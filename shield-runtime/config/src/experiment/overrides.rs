//! Values that a variant or the command line puts in the place of others.

use indexmap::IndexMap;
use serde::{Deserialize, de::IgnoredAny};
use shield_api::notation::{Entry, Fault, Node, from_node, parse};

use super::{
    ExperimentFile,
    error::{InputError, Location},
};

/// How many overrides may apply to one configuration.
pub(super) const MOST_OVERRIDES: usize = 1_000;
/// How many variants a file may declare.
const MOST_VARIANTS: usize = 1_000;

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
        match parse(value) {
            Ok(node) => {
                let value = value[node.span].to_owned();
                Ok(Self { path: path.into(), value, origin: Given::Argument(argument) })
            }
            Err(fault) => Err(InputError {
                location: Location::Argument(argument),
                message: format!("the value is not RON: {}", fault.message),
                remedy: Some("a text needs quotes, for the shell as well: --set 'name=\"x\"'".into()),
            }),
        }
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

/// A variant's name and the paths that it overrides.
type Named = (String, Vec<(String, IgnoredAny)>);

/// The variants of a file whose tree is `root`, in its order.
pub(super) fn declared(file: &ExperimentFile, root: &Node) -> Result<Vec<Declared>, Fault> {
    let VariantsOnly { variants } = from_node(&file.text, root)?;
    let written = root.entry("variants").map_or(&[][..], |entry| entry.value.entries());
    if let Some(beyond) = written.get(MOST_VARIANTS) {
        let message = format!("there are {} variants; at most {MOST_VARIANTS} are read", written.len());
        return Err(Fault::new(beyond.key_node.span.start, message));
    }
    let variant = |((name, pairs), entry): (Named, &Entry)| {
        let overrides = pairs.into_iter().zip(entry.value.items());
        let overrides = overrides.filter_map(|((path, _), pair)| {
            let [at_path, at_value] = pair.items() else { return None };
            Some(Override {
                path,
                value: file.text[at_value.span.clone()].to_owned(),
                origin: Given::File { path: at_path.span.start, value: at_value.span.start },
            })
        });
        Declared { name, name_start: entry.key_node.span.start, overrides: overrides.collect() }
    };
    Ok(variants.into_iter().zip(written).map(variant).collect())
}
