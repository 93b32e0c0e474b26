//! One variant of an experiment: its values, and the way back from each of them to what the user wrote.

use std::path::Path;

use serde::de::DeserializeOwned;
use shield_api::{Position, ron_options};

use super::ExperimentFile;
use super::config::Experiment;
use super::edit::{EditedText, Origin};
use super::error::{Fault, InputError, Location, offset_at, position_at, remedy_of};
use super::overrides::{Given, Override};
use super::path;
use super::tree::{Kind, Node, skip_trivia};
use super::validate::{Complaint, validate};

/// An experiment with the overrides of one variant and of the command line.
#[derive(Debug, Clone)]
pub struct Variant {
    /// Names the folder of its runs.
    pub name: String,
    /// What it says; valid.
    pub experiment: Experiment,
    source: Source,
}

/// The text of a variant, or of another configuration, and where each part of it was written.
#[derive(Debug, Clone)]
pub struct Source {
    file: ExperimentFile,
    /// The variant, if it is one of several.
    declared: Option<String>,
    edited: EditedText,
    overrides: Vec<Override>,
}

impl Variant {
    /// Applies the overrides in their order and reads the result. `declared` says that the file names this variant.
    pub(super) fn read(
        file: &ExperimentFile,
        name: &str,
        declared: bool,
        overrides: Vec<Override>,
    ) -> Result<Self, InputError> {
        let source = Source::new(file, declared.then_some(name), overrides)?;
        let experiment = source.read(validate)?;
        Ok(Self { name: name.to_owned(), experiment, source })
    }

    /// Where the user wrote the value at `path`, for example `reset.config`; with a `position`, the place inside that value's
    /// text, as a plugin reports it. What is not written anywhere is where the value around it is.
    pub fn locate(&self, path: &str, position: Option<Position>) -> Location {
        self.source.location(self.source.offset(path, position))
    }

    /// The same as [`InputError`], for what a plugin says about the value at `path`.
    pub fn error_at(&self, path: &str, position: Option<Position>, message: impl Into<String>) -> InputError {
        self.source.error_at(path, position, message)
    }

    /// Its text.
    pub fn source(&self) -> &Source {
        &self.source
    }

    /// The file from which it was read.
    pub fn file(&self) -> &Path {
        &self.source.file.path
    }
}

impl Source {
    /// The text of a file with the overrides applied in their order; `declared` is the variant, if it is one of several.
    pub(super) fn new(
        file: &ExperimentFile,
        declared: Option<&str>,
        overrides: Vec<Override>,
    ) -> Result<Self, InputError> {
        let mut source = Self {
            file: file.clone(),
            declared: declared.map(str::to_owned),
            edited: EditedText::new(&file.text),
            overrides,
        };
        source.apply()?;
        Ok(source)
    }

    /// What the text says, if `validate` agrees.
    pub(super) fn read<T: DeserializeOwned>(
        &self,
        validate: impl FnOnce(&T) -> Result<(), Complaint>,
    ) -> Result<T, InputError> {
        let read = ron_options().from_str::<T>(self.edited.text());
        let config = read.map_err(|error| self.error(Fault::from_ron(self.edited.text(), &error)))?;
        validate(&config).map_err(|complaint| self.error_at(&complaint.path, None, complaint.message))?;
        Ok(config)
    }

    /// An error at the value of `path`; without a position, at the field of it that the message names, if it names one.
    pub fn error_at(&self, path: &str, position: Option<Position>, message: impl Into<String>) -> InputError {
        let message = message.into();
        let named = if position.is_none() { self.named_field(path, &message) } else { None };
        let offset = named.unwrap_or_else(|| self.offset(path, position));
        let remedy = remedy_of(&message);
        self.error(Fault { offset, message, remedy })
    }

    fn apply(&mut self) -> Result<(), InputError> {
        let root = self.tree()?;
        if let Some(variants) = root.entries().iter().find(|entry| entry.key == "variants") {
            let span = variants.value.span.clone();
            self.edited.replace(span.clone(), &[("{}", Origin::File(span.start))]);
        }
        for index in 0..self.overrides.len() {
            let root = self.tree()?;
            let Override { path, value, .. } = &self.overrides[index];
            let set = if path.is_empty() || path.starts_with("variants") {
                Err(format!("`{path}` cannot be overridden"))
            } else {
                path::set(&mut self.edited, &root, path, (value, index))
            };
            set.map_err(|message| {
                let location = self.origin_location(Origin::Around(index));
                InputError { location, message: self.in_context(Some(index), &message), remedy: None }
            })?;
        }
        let root = self.tree()?;
        settle_forms(&mut self.edited, &root, false);
        let root = self.tree()?;
        if let (rules, true) = path::nearest(&root, "shield.rules") {
            name_rules(&mut self.edited, rules);
        }
        Ok(())
    }

    fn tree(&self) -> Result<Node, InputError> {
        Node::parse(self.edited.text())
            .map_err(|offset| self.error(Fault { offset, message: "this is not RON".into(), remedy: None }))
    }

    /// The offset in the edited text.
    fn offset(&self, path: &str, position: Option<Position>) -> usize {
        let text = self.edited.text();
        let Ok(root) = Node::parse(text) else { return 0 };
        let (node, is_itself) = path::nearest(&root, path);
        match position.filter(|_| is_itself) {
            None => node.span.start,
            Some(Position { line, column }) => {
                let value = &text[node.span.clone()];
                let inside = skip_trivia(value, offset_at(value, line as usize, column as usize));
                node.span.start + inside.min(value.len().saturating_sub(1))
            }
        }
    }

    /// The offset of the first field of the value at `path` whose name is a word of the message.
    fn named_field(&self, path: &str, message: &str) -> Option<usize> {
        let root = Node::parse(self.edited.text()).ok()?;
        let (node, true) = path::nearest(&root, path) else { return None };
        let mut words = message.split(|letter: char| !letter.is_alphanumeric() && letter != '_');
        words.find_map(|word| {
            let entry = node.inner().entries().iter().find(|entry| entry.key == word)?;
            Some(entry.value.span.start)
        })
    }

    fn location(&self, offset: usize) -> Location {
        self.origin_location(self.edited.origin(offset))
    }

    fn origin_location(&self, origin: Origin) -> Location {
        let given = |index: usize| &self.overrides[index].origin;
        let offset = match origin {
            Origin::File(offset) => offset,
            Origin::Value(index, inside) => match given(index) {
                Given::Argument(argument) => return Location::Argument(argument.clone()),
                Given::File { value, .. } => value + inside,
            },
            Origin::Around(index) => match given(index) {
                Given::Argument(argument) => return Location::Argument(argument.clone()),
                Given::File { path, .. } => *path,
            },
        };
        self.file.location(offset)
    }

    fn error(&self, fault: Fault) -> InputError {
        let origin = self.edited.origin(fault.offset);
        let index = match origin {
            Origin::File(_) => None,
            Origin::Value(index, _) | Origin::Around(index) => Some(index),
        };
        InputError {
            location: self.origin_location(origin),
            message: self.in_context(index, &fault.message),
            remedy: fault.remedy,
        }
    }

    /// The message with the variant and the override that it concerns.
    fn in_context(&self, index: Option<usize>, message: &str) -> String {
        let variant = self.declared.as_ref().map(|name| format!("variant `{name}`"));
        let path = index.map(|index| format!("override `{}`", self.overrides[index].path));
        match (variant, path) {
            (Some(variant), Some(path)) => format!("{variant}, {path}: {message}"),
            (Some(context), None) | (None, Some(context)) => format!("{context}: {message}"),
            (None, None) => message.to_owned(),
        }
    }
}

/// Brings both ways to write a structure inside a name to the one that is understood there. With its extension for the short form
/// `ron` refuses the long one, `Some((field: 1))`; inside a `RawValue`, so in a plugin's `config`, it refuses the short one.
fn settle_forms(edited: &mut EditedText, node: &Node, is_config: bool) {
    let is_some = node.named && edited.text()[node.span.clone()].starts_with("Some");
    let end = node.span.end - 1;
    let unwrapped = match &node.kind {
        Kind::Tuple(open, items) if !is_config && node.named => match items.as_slice() {
            [Node { named: false, span, kind: Kind::Struct(inner, _) }] => {
                Some((*open..*inner, span.end - 1..end))
            }
            _ => None,
        },
        _ => None,
    };
    let wrapped = match &node.kind {
        Kind::Struct(open, _) if is_config && is_some => Some(*open),
        Kind::Tuple(open, items) if is_config && is_some && items.len() > 1 => Some(*open),
        _ => None,
    };
    // From the end, so that the offsets of what comes before stay as they are.
    if let Some((_, closing)) = &unwrapped {
        edited.replace(closing.clone(), &[]);
    }
    if wrapped.is_some() {
        edited.replace(end..end, &[(")", edited.origin(end))]);
    }
    for entry in node.entries().iter().rev() {
        settle_forms(edited, &entry.value, is_config || entry.key == "config");
    }
    for item in node.items().iter().rev() {
        settle_forms(edited, item, is_config);
    }
    if let Some(open) = wrapped {
        edited.replace(open..open, &[("(", edited.origin(open))]);
    }
    if let Some((opening, _)) = unwrapped {
        edited.replace(opening, &[]);
    }
}

/// Gives the name `Rule` to every rule that has none, so that it can stand beside `All` and `Any`.
fn name_rules(edited: &mut EditedText, rules: &Node) {
    for rule in rules.inner().items().iter().rev() {
        let start = rule.span.start;
        let text = &edited.text()[rule.span.clone()];
        let is_group = ["All", "Any"].iter().any(|name| text.starts_with(name)) && rule.named;
        let is_bare = !rule.named && text.starts_with('(');
        if is_group {
            name_rules(edited, rule);
        } else if is_bare {
            edited.replace(start..start, &[("Rule", edited.origin(start))]);
        }
    }
}

impl ExperimentFile {
    pub(super) fn location(&self, offset: usize) -> Location {
        let position = Some(position_at(&self.text, offset.min(self.text.len())));
        Location::File { file: self.path.display().to_string(), position }
    }
}
