//! Text that remembers where each of its parts comes from.

use std::ops::Range;

/// Where a piece of text comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    /// From the user's file, from this offset on.
    File(usize),
    /// From the value of the override with this index, from this offset of the value on.
    Value(usize, usize),
    /// Written around the value of the override with this index.
    Around(usize),
}

impl Origin {
    /// The origin of the text `by` bytes later.
    fn later(self, by: usize) -> Self {
        match self {
            Self::File(offset) => Self::File(offset + by),
            Self::Value(index, offset) => Self::Value(index, offset + by),
            Self::Around(index) => Self::Around(index),
        }
    }
}

/// The user's file with some of its text replaced.
#[derive(Debug, Clone)]
pub(super) struct EditedText {
    text: String,
    /// Where each piece begins and comes from, in order; together they are the whole text.
    pieces: Vec<(usize, Origin)>,
}

impl EditedText {
    /// The file as it is.
    pub fn new(text: &str) -> Self {
        Self { text: text.to_owned(), pieces: vec![(0, Origin::File(0))] }
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    /// Puts `parts` in the place of `range`.
    pub fn replace(&mut self, range: Range<usize>, parts: &[(&str, Origin)]) {
        let resume = self.origin(range.end);
        let split = self.pieces.partition_point(|(start, _)| *start < range.start);
        let rest = self.pieces.split_off(split);
        let mut at = range.start;
        for (part, origin) in parts.iter().filter(|(part, _)| !part.is_empty()) {
            self.pieces.push((at, *origin));
            at += part.len();
        }
        self.pieces.push((at, resume));
        let behind = rest.into_iter().filter(|(start, _)| *start > range.end);
        self.pieces.extend(behind.map(|(start, origin)| (start - range.end + at, origin)));
        let replacement: String = parts.iter().map(|(part, _)| *part).collect();
        self.text.replace_range(range, &replacement);
    }

    /// Where the text at this offset comes from.
    pub fn origin(&self, offset: usize) -> Origin {
        let behind = self.pieces.partition_point(|(start, _)| *start <= offset);
        let (start, origin) = self.pieces[behind.saturating_sub(1)];
        origin.later(offset - start)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_character_keeps_its_origin_through_overlapping_edits() {
        let mut edited = EditedText::new("0123456789");
        edited.replace(
            2..4,
            &[("<", Origin::Around(0)), ("abc", Origin::Value(0, 0)), (">", Origin::Around(0))],
        );
        assert_eq!(edited.text(), "01<abc>456789");
        edited.replace(4..9, &[("XY", Origin::Value(1, 7))]);
        edited.replace(0..0, &[("+", Origin::Around(2))]);
        assert_eq!(edited.text(), "+01<aXY6789");
        let origins: Vec<Origin> = (0..edited.text().len()).map(|offset| edited.origin(offset)).collect();
        let file = (6..10).map(Origin::File);
        let expected: Vec<Origin> = [
            Origin::Around(2),
            Origin::File(0),
            Origin::File(1),
            Origin::Around(0),
            Origin::Value(0, 0),
            Origin::Value(1, 7),
            Origin::Value(1, 8),
        ]
        .into_iter()
        .chain(file)
        .collect();
        assert_eq!(origins, expected);
    }
}
