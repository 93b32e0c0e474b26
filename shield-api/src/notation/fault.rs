//! What is wrong with a text, and where.

use std::fmt;

use serde::de;

use crate::Position;

/// Longer names are compared with nothing and shown shortened.
const LONGEST_NAME: usize = 64;

/// What is wrong with a text, its place, and perhaps what to do about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Unknown until the reader of the value around adds its own.
    offset: Option<usize>,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    pub remedy: Option<String>,
}

impl Fault {
    /// A fault at a byte of the text.
    pub fn new(offset: usize, message: impl Into<String>) -> Self {
        Self { offset: Some(offset), message: message.into(), remedy: None }
    }

    /// The same fault with what to do about it.
    #[must_use]
    pub fn with_remedy(mut self, remedy: Option<impl Into<String>>) -> Self {
        self.remedy = remedy.map(Into::into);
        self
    }

    /// The byte of the text at which the fault lies.
    pub fn offset(&self) -> usize {
        self.offset.unwrap_or_default()
    }

    /// Line and column in the text that was read.
    pub fn position(&self, text: &str) -> Position {
        position_at(text, self.offset())
    }

    /// The same fault, at `offset` if it has no place yet.
    pub(super) fn or_at(mut self, offset: usize) -> Self {
        self.offset.get_or_insert(offset);
        self
    }

    fn unplaced(message: String) -> Self {
        Self { offset: None, message, remedy: None }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.message)?;
        self.remedy.as_ref().map_or(Ok(()), |remedy| write!(formatter, "; {remedy}"))
    }
}

impl std::error::Error for Fault {}

impl de::Error for Fault {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::unplaced(message.to_string())
    }

    fn invalid_type(found: de::Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        Self::unplaced(format!("expected {expected}, found {found}"))
    }

    fn invalid_value(found: de::Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        Self::invalid_type(found, expected)
    }

    fn invalid_length(length: usize, expected: &dyn de::Expected) -> Self {
        Self::unplaced(format!("expected {expected}, found {}", values(length)))
    }

    fn unknown_variant(variant: &str, expected: &'static [&'static str]) -> Self {
        unknown("variant", variant, expected)
    }

    fn unknown_field(field: &str, expected: &'static [&'static str]) -> Self {
        unknown("field", field, expected)
    }

    fn missing_field(field: &'static str) -> Self {
        Self::unplaced(format!("the field `{field}` is missing"))
    }

    fn duplicate_field(field: &'static str) -> Self {
        Self::unplaced(format!("`{field}` is given twice"))
    }
}

fn unknown(what: &str, found: &str, known: &[&str]) -> Fault {
    let message = match known {
        [] => format!("there is no {what} `{}`, and no other", shown(found)),
        _ => format!("there is no {what} `{}`, only {}", shown(found), listed(known.iter().copied(), "and")),
    };
    Fault::unplaced(message).with_remedy(did_you_mean(found, known.iter().copied()))
}

/// So many values.
pub(super) fn values(count: usize) -> String {
    if count == 1 { "1 value".into() } else { format!("{count} values") }
}

/// Names to choose from.
pub(super) fn one_of<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    listed(names, "or")
}

fn listed<'a>(names: impl IntoIterator<Item = &'a str>, conjunction: &str) -> String {
    let quoted: Vec<String> = names.into_iter().map(|name| format!("`{name}`")).collect();
    match quoted.as_slice() {
        [others @ .., last] if !others.is_empty() => format!("{} {conjunction} {last}", others.join(", ")),
        _ => quoted.concat(),
    }
}

/// Asks whether the nearest of the known names was meant, if one is near enough.
pub fn did_you_mean<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    const NEAR_ENOUGH: f64 = 0.5;
    let is_name = |name: &str| name.len() <= LONGEST_NAME;
    if !is_name(found) {
        return None;
    }
    let found = found.to_lowercase();
    let near = |name: &str| strsim::normalized_damerau_levenshtein(&found, &name.to_lowercase());
    let known = known.into_iter().filter(|name| is_name(name)).map(|name| (near(name), name));
    let (nearness, best) = known.max_by(|(one, _), (other, _)| one.total_cmp(other))?;
    (nearness >= NEAR_ENOUGH).then(|| format!("did you mean `{best}`?"))
}

/// A piece of the text on one line, shortened.
pub(super) fn shown(text: &str) -> String {
    let line = text.lines().next().unwrap_or_default();
    let is_whole = line.len() == text.len() && text.len() <= LONGEST_NAME;
    let end = line.floor_char_boundary(LONGEST_NAME.min(line.len()));
    if is_whole { text.to_owned() } else { format!("{}…", &line[..end]) }
}

/// Line and column of a byte of the text, both from 1.
pub fn position_at(text: &str, offset: usize) -> Position {
    let before = &text[..text.floor_char_boundary(offset.min(text.len()))];
    let line_start = before.rfind('\n').map_or(0, |end| end + 1);
    let line = 1 + before.matches('\n').count();
    let column = 1 + before[line_start..].chars().count();
    Position { line: line as u32, column: column as u32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_near_names_are_proposed() {
        let known = ["steps", "seeds"];
        assert_eq!(did_you_mean("stpes", known).as_deref(), Some("did you mean `steps`?"));
        assert_eq!(did_you_mean("STEP", known).as_deref(), Some("did you mean `steps`?"));
        assert_eq!(did_you_mean("gamma", known), None);
        assert_eq!(did_you_mean("steps", []), None);
    }

    #[test]
    fn a_name_of_any_length_is_shown_shortened_and_compared_with_nothing() {
        let endless = "ä".repeat(1_000_000);
        assert_eq!(did_you_mean(&endless, ["steps"]), None);
        assert!(shown(&endless).len() < 70);
        assert_eq!(shown("one\ntwo"), "one…");
        assert_eq!(shown("\"x\""), "\"x\"");
    }

    #[test]
    fn positions_count_characters_and_stay_inside_the_text() {
        let text = "äb\n\nc";
        let at = |offset| {
            let Position { line, column } = position_at(text, offset);
            (line, column)
        };
        assert_eq!([at(0), at(2), at(3), at(4), at(5)], [(1, 1), (1, 2), (1, 3), (2, 1), (3, 1)]);
        assert_eq!([at(1), at(6), at(99)], [(1, 1), (3, 2), (3, 2)]);
    }
}
