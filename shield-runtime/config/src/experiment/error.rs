//! What is wrong with an experiment, and where.

use std::fmt;

use shield_api::Position;

use super::tree::{Kind, Node, skip_trivia};

/// A place in what the user wrote.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Location {
    /// `file:line:column`.
    File {
        /// The file, as the user named it.
        file: String,
        /// Where in the file; `None` if it could not be read.
        position: Option<Position>,
    },
    /// An argument of the command line, such as `--set steps=5`.
    Argument(String),
}

impl fmt::Display for Location {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { file, position: Some(Position { line, column }) } => {
                write!(formatter, "{file}:{line}:{column}")
            }
            Self::File { file, position: None } => formatter.write_str(file),
            Self::Argument(text) => formatter.write_str(text),
        }
    }
}

/// Something that the user must change.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{location}: {message}{}", remedy.as_ref().map(|remedy| format!("; {remedy}")).unwrap_or_default())]
pub struct InputError {
    /// Where.
    pub location: Location,
    /// What is wrong.
    pub message: String,
    /// What to do about it, where that is known.
    pub remedy: Option<String>,
}

/// A fault before its place in the user's file is known.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Fault {
    /// In the text that was read.
    pub offset: usize,
    pub message: String,
    pub remedy: Option<String>,
}

impl Fault {
    /// What `ron` says about a text, with the offset of the value that is wrong.
    pub fn from_ron(text: &str, error: &ron::error::SpannedError) -> Self {
        let message = lower_first(&without_structure(&error.code).to_string());
        Self { offset: offset_of(text, error), message, remedy: remedy(&error.code) }
    }
}

/// The offset of a line and column, both from 1, or the end of the text.
pub(super) fn offset_at(text: &str, line: usize, column: usize) -> usize {
    let ends = text.match_indices('\n').map(|(end, _)| end + 1);
    let start = std::iter::once(0).chain(ends).nth(line.saturating_sub(1)).unwrap_or(text.len());
    let mut characters = text[start..].char_indices();
    characters.nth(column.saturating_sub(1)).map_or(text.len(), |(offset, _)| start + offset)
}

/// Line and column of an offset, both from 1.
pub(super) fn position_at(text: &str, offset: usize) -> Position {
    let before = &text[..offset];
    let line_start = before.rfind('\n').map_or(0, |end| end + 1);
    let line = 1 + before.matches('\n').count();
    let column = 1 + before[line_start..].chars().count();
    Position { line: line as u32, column: column as u32 }
}

/// `ron` tells where its cursor was. For a value of the wrong type that is behind it; for a missing field, the closing bracket.
fn offset_of(text: &str, error: &ron::error::SpannedError) -> usize {
    use ron::Error as E;
    let start = error.span.start;
    let cursor = skip_trivia(text, offset_at(text, start.line, start.col));
    let Ok(tree) = Node::parse(text) else { return cursor };
    match &error.code {
        E::MissingStructField { .. } => {
            let around = tree.innermost(&|node| node.span.contains(&cursor));
            around.map_or(cursor, |node| node.span.start)
        }
        E::NoSuchStructField { .. } | E::DuplicateStructField { .. } => cursor,
        code => {
            let is_behind = matches!(
                code,
                E::InvalidValueForType { .. }
                    | E::Message(_)
                    | E::ExpectedStructLike
                    | E::ExpectedNamedStructLike(_)
            );
            let concerned = tree.innermost(&|node| {
                let is_leaf = matches!(node.kind, Kind::Leaf);
                node.span.contains(&cursor)
                    || is_behind && is_leaf && skip_trivia(text, node.span.end) == cursor
            });
            let leaf = concerned.filter(|node| matches!(node.kind, Kind::Leaf));
            leaf.map_or(cursor, |node| node.span.start)
        }
    }
}

/// `ron` names the structure around where `Some` stands before the one with the fault, so none is named: the place says it.
fn without_structure(code: &ron::Error) -> ron::Error {
    use ron::Error as E;
    let mut code = code.clone();
    if let E::NoSuchStructField { outer, .. }
    | E::MissingStructField { outer, .. }
    | E::DuplicateStructField { outer, .. } = &mut code
    {
        *outer = None;
    }
    code
}

fn remedy(code: &ron::Error) -> Option<String> {
    use ron::Error as E;
    match code {
        E::NoSuchStructField { expected, found, .. } | E::NoSuchEnumVariant { expected, found, .. } => {
            did_you_mean(found, expected.iter().copied())
        }
        E::ExpectedString => Some("a text needs quotes".into()),
        E::ExpectedStructLikeEnd | E::ExpectedArrayEnd | E::ExpectedMapEnd => {
            Some("a comma may be missing before this".into())
        }
        _ => None,
    }
}

/// Asks whether the nearest of the known names was meant, if one is near enough.
pub(super) fn did_you_mean<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    const NEAR_ENOUGH: f64 = 0.5;
    let near =
        |name: &&str| strsim::normalized_damerau_levenshtein(&found.to_lowercase(), &name.to_lowercase());
    let best = known.into_iter().max_by(|one, other| near(one).total_cmp(&near(other)));
    best.filter(|name| near(name) >= NEAR_ENOUGH).map(|name| format!("did you mean `{name}`?"))
}

/// The remedy for what a plugin says of a name that it does not know, "…named `qmin` in `Config`, expected one of `q_min`, …".
pub(super) fn remedy_of(message: &str) -> Option<String> {
    let (found, expected) = message.split_once(", expected ")?;
    did_you_mean(in_backticks(found).next()?, in_backticks(expected))
}

fn in_backticks(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

fn lower_first(sentence: &str) -> String {
    let mut characters = sentence.chars();
    characters.next().map(|first| first.to_lowercase().chain(characters).collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_and_offsets_convert_into_each_other() {
        let text = "äb\n\nc";
        for offset in (0..=text.len()).filter(|offset| text.is_char_boundary(*offset)) {
            let Position { line, column } = position_at(text, offset);
            assert_eq!(offset_at(text, line as usize, column as usize), offset, "{line}:{column}");
        }
        assert_eq!(position_at(text, text.len()), Position { line: 3, column: 2 });
        assert_eq!(offset_at(text, 9, 9), text.len());
    }

    #[test]
    fn only_similar_names_are_proposed() {
        let known = ["steps", "seeds"];
        assert_eq!(did_you_mean("stpes", known).as_deref(), Some("did you mean `steps`?"));
        assert_eq!(did_you_mean("gamma", known), None);
    }

    #[test]
    fn a_plugins_message_about_an_unknown_field_gets_a_remedy() {
        let message =
            "Unexpected field named `qmin` in `Config`, expected either `q_min` or `combine` instead";
        assert_eq!(remedy_of(message).as_deref(), Some("did you mean `q_min`?"));
        assert_eq!(remedy_of("`qmin` is 5, expected less"), None);
    }
}
