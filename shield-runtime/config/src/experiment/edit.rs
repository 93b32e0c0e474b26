//! Text that remembers where each of its parts comes from, with its tree.

use std::ops::Range;

use shield_api::notation::{Fault, Kind, MAX_DEPTH, Node, Segment, parse};

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

/// The user's file with some of its text replaced. The tree is that of the text after every edit, without being parsed anew.
#[derive(Debug, Clone)]
pub(super) struct EditedText {
    text: String,
    root: Node,
    /// Where each piece begins and comes from, in order; together they are the whole text.
    pieces: Vec<(usize, Origin)>,
}

impl EditedText {
    /// The file as it is, with its tree.
    pub fn new(text: &str, root: Node) -> Self {
        Self { text: text.to_owned(), root, pieces: vec![(0, Origin::File(0))] }
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    pub fn root(&self) -> &Node {
        &self.root
    }

    /// Puts a value, the text of `parts`, in the place of the one at `path`.
    ///
    /// # Errors
    /// It stands too deep.
    pub fn replace(&mut self, path: &[Segment<'_>], parts: &[(&str, Origin)]) -> Result<(), Fault> {
        let mut value = parse(&concat(parts))?;
        let range = at_path(&self.root, path).span.clone();
        move_by(&mut value, 0, range.start as isize);
        self.splice(range, parts);
        *at_path_mut(&mut self.root, path) = value;
        self.check_depth()
    }

    /// Adds a field or an entry, the text of `parts`, to the value at `path`, where [`place_for_field`] finds room.
    ///
    /// # Errors
    /// It stands too deep.
    pub fn insert(&mut self, path: &[Segment<'_>], parts: &[(&str, Origin)]) -> Result<(), Fault> {
        let node = at_path(&self.root, path).inner();
        let Some((at, needs_comma)) = place_for_field(node) else { return Ok(()) };
        let (open, close) = if matches!(node.kind, Kind::Map(_)) { ("{", "}") } else { ("(", ")") };
        let (Kind::Struct(mut added) | Kind::Map(mut added)) =
            parse(&format!("{open}{}{close}", concat(parts)))?.kind
        else {
            return Ok(());
        };
        let lead = if needs_comma { ", " } else { "" };
        let distance = (at + lead.len()) as isize - open.len() as isize;
        for entry in &mut added {
            move_by(&mut entry.key_node, 0, distance);
            move_by(&mut entry.value, 0, distance);
        }
        let origin = parts.first().map_or(Origin::File(at), |(_, origin)| *origin);
        self.splice(at..at, &[&[(lead, origin)], parts].concat());
        match &mut at_path_mut(&mut self.root, path).inner_mut().kind {
            Kind::Struct(entries) | Kind::Map(entries) => entries.append(&mut added),
            empty => *empty = Kind::Struct(added),
        }
        self.check_depth()
    }

    /// Writes `Some((field: 1))` for `Some(field: 1)` in the configurations of plugins: the form that every plugin since 1.0.0 reads.
    ///
    /// # Errors
    /// The brackets stand too deep.
    pub fn write_options_out(&mut self) -> Result<(), Fault> {
        let mut brackets = Vec::new();
        find_short_options(&self.root, &self.text, false, &mut brackets);
        if brackets.is_empty() {
            return Ok(());
        }
        brackets.sort_unstable_by_key(|(offset, _)| std::cmp::Reverse(*offset));
        for (offset, bracket) in brackets {
            self.splice(offset..offset, &[(bracket, self.origin(offset))]);
        }
        self.root = parse(&self.text)?;
        Ok(())
    }

    /// Where the text at this offset comes from.
    pub fn origin(&self, offset: usize) -> Origin {
        let behind = self.pieces.partition_point(|(start, _)| *start <= offset);
        let (start, origin) = self.pieces[behind.saturating_sub(1)];
        origin.later(offset - start)
    }

    fn check_depth(&self) -> Result<(), Fault> {
        if self.root.depth() <= MAX_DEPTH {
            return Ok(());
        }
        Err(Fault::new(0, format!("more than {MAX_DEPTH} brackets would stand inside one another")))
    }

    /// Puts `parts` in the place of `range`, and moves what stands behind it.
    fn splice(&mut self, range: Range<usize>, parts: &[(&str, Origin)]) {
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
        move_by(&mut self.root, range.end, at as isize - range.end as isize);
        self.text.replace_range(range, &concat(parts));
    }
}

fn concat(parts: &[(&str, Origin)]) -> String {
    parts.iter().map(|(part, _)| *part).collect()
}

/// The value at a path, or the nearest one around it.
fn at_path<'a>(root: &'a Node, path: &[Segment<'_>]) -> &'a Node {
    path.iter().try_fold(root, |node, segment| node.child(*segment)).unwrap_or(root)
}

/// The same, to be changed.
fn at_path_mut<'a>(root: &'a mut Node, path: &[Segment<'_>]) -> &'a mut Node {
    path.iter().fold(root, |node, segment| node.child_mut(*segment).expect("the path was found before"))
}

/// Moves what begins at `from` or behind it, and what ends behind it.
fn move_by(node: &mut Node, from: usize, distance: isize) {
    let moved = |offset: usize| offset.saturating_add_signed(distance);
    if node.span.end <= from && node.span.start < from {
        return;
    }
    if node.span.start >= from {
        node.span.start = moved(node.span.start);
    }
    node.span.end = moved(node.span.end);
    match &mut node.kind {
        Kind::Leaf => {}
        Kind::List(items) | Kind::Tuple(items) => {
            items.iter_mut().for_each(|item| move_by(item, from, distance));
        }
        Kind::Struct(entries) | Kind::Map(entries) => {
            for entry in entries {
                move_by(&mut entry.key_node, from, distance);
                move_by(&mut entry.value, from, distance);
            }
        }
    }
}

/// Where another field can be written, and whether a comma must precede it. `None` if this has no fields.
pub(super) fn place_for_field(node: &Node) -> Option<(usize, bool)> {
    let content = node.span.start + node.open_len;
    match &node.kind {
        Kind::Struct(entries) | Kind::Map(entries) => {
            Some(entries.last().map_or((content, false), |last| (last.value.span.end, true)))
        }
        Kind::Tuple(items) if items.is_empty() => Some((content, false)),
        _ => None,
    }
}

/// The brackets that the long form of `Some(…)` has and the short one has not, with their places.
fn find_short_options(node: &Node, text: &str, is_config: bool, found: &mut Vec<(usize, &'static str)>) {
    let is_short = match &node.kind {
        Kind::Struct(_) => true,
        Kind::Tuple(items) => items.len() > 1,
        _ => false,
    };
    if is_config && is_short && node.name(text) == "Some" {
        found.extend([(node.span.start + node.open_len, "("), (node.span.end - 1, ")")]);
    }
    for entry in node.entries() {
        find_short_options(&entry.value, text, is_config || entry.key == "config", found);
    }
    for item in node.items() {
        find_short_options(item, text, is_config, found);
    }
}

#[cfg(test)]
mod tests {
    use shield_api::notation::segments;

    use super::*;

    fn edited(text: &str) -> EditedText {
        EditedText::new(text, parse(text).unwrap())
    }

    #[test]
    fn every_character_keeps_its_origin_through_overlapping_edits() {
        let mut edited = edited("0123456789");
        edited.splice(
            2..4,
            &[("<", Origin::Around(0)), ("abc", Origin::Value(0, 0)), (">", Origin::Around(0))],
        );
        assert_eq!(edited.text(), "01<abc>456789");
        edited.splice(4..9, &[("XY", Origin::Value(1, 7))]);
        edited.splice(0..0, &[("+", Origin::Around(2))]);
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

    #[test]
    fn the_tree_is_that_of_the_text_after_every_edit() {
        let mut edited = edited(
            "X(a: Some(/* a */ (b: [1, (2, 3)])), c: {\"k\": 1}, d: None, e: (), f: Some(g: 1) /* z */)",
        );
        let check = |edited: &EditedText| {
            assert_eq!(*edited.root(), parse(edited.text()).unwrap(), "{}", edited.text())
        };
        let value = |text| [(text, Origin::Value(0, 0))];
        for (path, text) in
            [("a.b[1][0]", "[777, {}]"), ("a.b[0]", "(x: Some(1))"), ("d", "(y: Some(y: 5))"), ("a", "Z")]
        {
            edited.replace(&segments(path).unwrap(), &value(text)).unwrap();
            check(&edited);
        }
        for (path, text) in
            [("c", "\"m\": [2]"), ("e", "h: (i: 3)"), ("e.h", "j: 4"), ("f", "k: 5"), ("", "l: 6")]
        {
            edited.insert(&segments(path).unwrap(), &value(text)).unwrap();
            check(&edited);
        }
        assert_eq!(
            edited.text(),
            "X(a: Z, c: {\"k\": 1, \"m\": [2]}, d: (y: Some(y: 5)), e: (h: (i: 3, j: 4)), f: Some(g: 1, k: 5), l: 6 /* z */)"
        );
    }

    #[test]
    fn options_are_written_out_in_configurations_alone() {
        let mut edited = edited(
            "(a: Some(b: 1), x: [(config: (c: Some(d: Some(1, 2), e: Some((f: Some(3)))), g: Some (h: 4)))])",
        );
        edited.write_options_out().unwrap();
        let expected = "(a: Some(b: 1), x: [(config: (c: Some((d: Some((1, 2)), e: Some((f: Some(3))))), g: Some ((h: 4))))])";
        assert_eq!(edited.text(), expected);
        assert_eq!(*edited.root(), parse(expected).unwrap());
    }

    #[test]
    fn what_would_stand_too_deep_is_refused() {
        let deep = |levels: usize| format!("{}1{}", "[".repeat(levels), "]".repeat(levels));
        let mut edited = edited("(a: (b: 1))");
        let path = segments("a.b").unwrap();
        edited.replace(&path, &[(&deep(MAX_DEPTH - 2), Origin::Value(0, 0))]).unwrap();
        assert!(edited.replace(&path, &[(&deep(MAX_DEPTH - 1), Origin::Value(0, 0))]).is_err());
        assert!(
            edited.insert(&path[..1], &[(&format!("c: {}", deep(MAX_DEPTH)), Origin::Value(0, 0))]).is_err()
        );
    }
}
