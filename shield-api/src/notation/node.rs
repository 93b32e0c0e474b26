//! The tree of a text.

use std::ops::Range;

use super::Segment;

/// A value and the bytes that it takes, without the comments around it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    /// Its bytes in the text, a name before its bracket included.
    pub span: Range<usize>,
    /// Bytes of the name with which it begins, as in `Some(…)` and `Pessimistic`; 0 if it has none.
    pub name_len: usize,
    /// Bytes from its beginning to the first one of its content; 0 for a leaf.
    pub open_len: usize,
    /// What stands inside.
    pub kind: Kind,
}

/// What a value is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kind {
    /// A number, a text, a character, a bare name.
    Leaf,
    /// `(field: value)`, with or without a name before it.
    Struct(Vec<Entry>),
    /// `{key: value}`.
    Map(Vec<Entry>),
    /// `[value]`.
    List(Vec<Node>),
    /// `(value)`, with or without a name before it.
    Tuple(Vec<Node>),
}

/// A value with its name or key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// The field's name, or what a text that is a key says.
    pub key: String,
    /// Where the key stands.
    pub key_node: Node,
    /// What it names.
    pub value: Node,
}

impl Node {
    pub(super) fn leaf(span: Range<usize>, name_len: usize) -> Self {
        Self { span, name_len, open_len: 0, kind: Kind::Leaf }
    }

    /// The name with which it begins, in the text that was parsed; empty if it has none.
    pub fn name<'a>(&self, text: &'a str) -> &'a str {
        let name = &text[self.span.start..self.span.start + self.name_len];
        name.strip_prefix("r#").unwrap_or(name)
    }

    /// Whether a name stands before a bracket.
    pub fn is_named(&self) -> bool {
        self.name_len > 0 && !self.is_leaf()
    }

    /// Whether nothing can stand inside.
    pub fn is_leaf(&self) -> bool {
        matches!(self.kind, Kind::Leaf)
    }

    /// The value itself, inside `Some(…)` and other names around a single value.
    pub fn inner(&self) -> &Self {
        match &self.kind {
            Kind::Tuple(items) if self.is_named() && items.len() == 1 => items[0].inner(),
            _ => self,
        }
    }

    /// The same, to be changed.
    pub fn inner_mut(&mut self) -> &mut Self {
        let is_wrapper = self.is_named() && self.items().len() == 1;
        if is_wrapper { self.items_mut()[0].inner_mut() } else { self }
    }

    /// The entries of a structure or a map.
    pub fn entries(&self) -> &[Entry] {
        match &self.kind {
            Kind::Struct(entries) | Kind::Map(entries) => entries,
            _ => &[],
        }
    }

    /// The elements of a list or a tuple.
    pub fn items(&self) -> &[Self] {
        match &self.kind {
            Kind::List(items) | Kind::Tuple(items) => items,
            _ => &[],
        }
    }

    fn items_mut(&mut self) -> &mut [Self] {
        match &mut self.kind {
            Kind::List(items) | Kind::Tuple(items) => items,
            _ => &mut [],
        }
    }

    /// The entry of that name.
    pub fn entry(&self, name: &str) -> Option<&Entry> {
        self.entries().iter().find(|entry| entry.key == name)
    }

    /// The values directly inside.
    pub fn children(&self) -> impl Iterator<Item = &Self> {
        self.entries().iter().map(|entry| &entry.value).chain(self.items())
    }

    /// The value that a step of a path leads to, names around a single value left out.
    pub fn child(&self, segment: Segment<'_>) -> Option<&Self> {
        let node = self.inner();
        match segment {
            Segment::Field(name) => node.entry(name).map(|entry| &entry.value),
            Segment::Index(index) => node.items().get(index),
        }
    }

    /// The same, to be changed.
    pub fn child_mut(&mut self, segment: Segment<'_>) -> Option<&mut Self> {
        match (segment, &mut self.inner_mut().kind) {
            (Segment::Field(name), Kind::Struct(entries) | Kind::Map(entries)) => {
                entries.iter_mut().find(|entry| entry.key == name).map(|entry| &mut entry.value)
            }
            (Segment::Index(index), Kind::List(items) | Kind::Tuple(items)) => items.get_mut(index),
            _ => None,
        }
    }

    /// How many brackets stand inside one another.
    pub fn depth(&self) -> usize {
        let inside = self.children().map(Self::depth).max().unwrap_or(0);
        if self.is_leaf() { 0 } else { 1 + inside }
    }
}
