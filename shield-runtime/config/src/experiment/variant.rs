//! One variant of an experiment: its values, and the way back from each of them to what the user wrote.

use std::path::Path;

use serde::de::DeserializeOwned;
use shield_api::{
    Position,
    notation::{Fault, Node, Segment, from_node, nearest, position_at, skip_trivia},
};

use super::{
    ExperimentFile,
    config::Experiment,
    edit::{EditedText, Origin},
    error::{InputError, Location, offset_at},
    overrides::{Given, MOST_OVERRIDES, Override},
    path,
    validate::{Complaint, validate},
};

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
    /// Applies the overrides in their order and reads the result. `root` is the tree of the file's text; `declared` says that the file
    /// names this variant.
    pub(super) fn read(
        file: &ExperimentFile,
        root: &Node,
        name: &str,
        declared: bool,
        overrides: Vec<Override>,
    ) -> Result<Self, InputError> {
        let source = Source::new(file, root.clone(), declared.then_some(name), overrides)?;
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
    /// The text of a file, whose tree is `root`, with the overrides applied in their order; `declared` is the variant, if it is one of
    /// several.
    pub(super) fn new(
        file: &ExperimentFile,
        root: Node,
        declared: Option<&str>,
        overrides: Vec<Override>,
    ) -> Result<Self, InputError> {
        let mut source = Self {
            file: file.clone(),
            declared: declared.map(str::to_owned),
            edited: EditedText::new(&file.text, root),
            overrides,
        };
        if source.declared.is_some() {
            source.leave_out_variants()?;
        }
        source.apply()?;
        Ok(source)
    }

    /// What the text says, if `validate` agrees.
    pub(super) fn read<T: DeserializeOwned>(
        &self,
        validate: impl FnOnce(&T) -> Result<(), Complaint>,
    ) -> Result<T, InputError> {
        let config: T =
            from_node(self.edited.text(), self.edited.root()).map_err(|fault| self.error(fault))?;
        validate(&config).map_err(|complaint| self.error_at(&complaint.path, None, complaint.message))?;
        Ok(config)
    }

    /// An error at the value of `path`, or at a place in its text.
    pub fn error_at(&self, path: &str, position: Option<Position>, message: impl Into<String>) -> InputError {
        self.error(Fault::new(self.offset(path, position), message))
    }

    /// What is written at `path`, the overrides applied; `None` if nothing is.
    pub fn written_at(&self, path: &str) -> Option<&str> {
        let (node, is_itself) = nearest(self.edited.root(), path);
        is_itself.then(|| &self.edited.text()[node.span.clone()])
    }

    /// A variant says nothing of the others.
    fn leave_out_variants(&mut self) -> Result<(), InputError> {
        let Some(variants) = self.edited.root().entry("variants") else { return Ok(()) };
        let origin = Origin::File(variants.value.span.start);
        let emptied = self.edited.replace(&[Segment::Field("variants")], &[("{}", origin)]);
        emptied.map_err(|fault| self.error(fault))
    }

    fn apply(&mut self) -> Result<(), InputError> {
        for (index, Override { path, value, .. }) in self.overrides.iter().enumerate() {
            let set = if index == MOST_OVERRIDES {
                Err(format!(
                    "there are {} overrides; at most {MOST_OVERRIDES} are read",
                    self.overrides.len()
                ))
            } else if path.is_empty() || path.starts_with("variants") {
                Err(format!("`{path}` cannot be overridden"))
            } else {
                path::set(&mut self.edited, path, (value, index))
            };
            set.map_err(|message| {
                let location = self.origin_location(Origin::Around(index));
                InputError { location, message: self.in_context(Some(index), &message), remedy: None }
            })?;
        }
        self.edited.write_options_out().map_err(|fault| self.error(fault))
    }

    /// The offset in the edited text.
    fn offset(&self, path: &str, position: Option<Position>) -> usize {
        let (node, is_itself) = nearest(self.edited.root(), path);
        match position.filter(|_| is_itself) {
            None => node.span.start,
            Some(position) => {
                let value = &self.edited.text()[node.span.clone()];
                let inside = skip_trivia(value, offset_at(value, position));
                node.span.start + value.floor_char_boundary(inside.min(value.len().saturating_sub(1)))
            }
        }
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
        let origin = self.edited.origin(fault.offset());
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

impl ExperimentFile {
    pub(super) fn location(&self, offset: usize) -> Location {
        let position = Some(position_at(&self.text, offset));
        Location::File { file: self.path.display().to_string(), position }
    }
}
