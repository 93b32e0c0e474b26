//! What is wrong with an experiment, and where.

use std::fmt;

use shield_api::Position;

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

/// The offset of a line and column, both from 1, or the end of the text.
pub(super) fn offset_at(text: &str, Position { line, column }: Position) -> usize {
    let ends = text.match_indices('\n').map(|(end, _)| end + 1);
    let start = std::iter::once(0).chain(ends).nth((line as usize).saturating_sub(1)).unwrap_or(text.len());
    let mut characters = text[start..].char_indices();
    characters.nth((column as usize).saturating_sub(1)).map_or(text.len(), |(offset, _)| start + offset)
}

#[cfg(test)]
mod tests {
    use shield_api::notation::position_at;

    use super::*;

    #[test]
    fn positions_and_offsets_convert_into_each_other() {
        let text = "äb\n\nc";
        for offset in (0..=text.len()).filter(|offset| text.is_char_boundary(*offset)) {
            assert_eq!(offset_at(text, position_at(text, offset)), offset);
        }
        assert_eq!(offset_at(text, Position { line: 9, column: 9 }), text.len());
    }
}
