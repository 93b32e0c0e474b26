//! Where each value of a RON text stands: what `ron` itself does not tell of a value once it is parsed.
//!
//! The scanner is given text that `ron` has accepted; it knows brackets, names, strings and comments, and no types.

use std::ops::Range;

/// A value and the bytes that it takes, without the comments around it.
#[derive(Debug)]
pub(super) struct Node {
    pub span: Range<usize>,
    /// Whether a name stands before the bracket, as in `Some(…)`.
    pub named: bool,
    pub kind: Kind,
}

#[derive(Debug)]
pub(super) enum Kind {
    /// A number, a text, a bare name.
    Leaf,
    /// `(field: value)`; where its content begins.
    Struct(usize, Vec<Entry>),
    /// `{"key": value}`; where its content begins.
    Map(usize, Vec<Entry>),
    /// `[value]`; where its content begins.
    List(usize, Vec<Node>),
    /// `(value)`; where its content begins.
    Tuple(usize, Vec<Node>),
}

#[derive(Debug)]
pub(super) struct Entry {
    pub key: String,
    pub key_start: usize,
    pub value: Node,
}

impl Node {
    /// The tree of a whole text.
    ///
    /// # Errors
    /// The offset at which the text stops being RON.
    pub fn parse(text: &str) -> Result<Self, usize> {
        let mut scanner = Scanner { text, at: 0 };
        let root = scanner.document();
        root.ok_or(scanner.at)
    }

    /// The value itself, inside `Some(…)` and other names around a single value.
    pub fn inner(&self) -> &Self {
        match &self.kind {
            Kind::Tuple(_, items) if self.named && items.len() == 1 => items[0].inner(),
            _ => self,
        }
    }

    /// The entries of a structure or a map.
    pub fn entries(&self) -> &[Entry] {
        match &self.kind {
            Kind::Struct(_, entries) | Kind::Map(_, entries) => entries,
            _ => &[],
        }
    }

    /// The elements of a list or a tuple.
    pub fn items(&self) -> &[Node] {
        match &self.kind {
            Kind::List(_, items) | Kind::Tuple(_, items) => items,
            _ => &[],
        }
    }

    /// Where another field can be written, and whether a comma must precede it. `None` if this has no fields.
    pub fn place_for_field(&self) -> Option<(usize, bool)> {
        match &self.kind {
            Kind::Struct(open, entries) | Kind::Map(open, entries) => {
                Some(entries.last().map_or((*open, false), |last| (last.value.span.end, true)))
            }
            Kind::Tuple(open, items) if items.is_empty() => Some((*open, false)),
            _ => None,
        }
    }

    /// The values directly inside.
    pub fn children(&self) -> impl Iterator<Item = &Node> {
        self.entries().iter().map(|entry| &entry.value).chain(self.items())
    }

    /// The innermost value of which `chosen` holds; it must hold of everything around it too.
    pub fn innermost(&self, chosen: &impl Fn(&Node) -> bool) -> Option<&Node> {
        let inside = self.children().find_map(|child| child.innermost(chosen));
        inside.or_else(|| Some(self).filter(|node| chosen(node)))
    }
}

/// The offset of the first character from `at` on that is neither whitespace nor comment.
pub(super) fn skip_trivia(text: &str, at: usize) -> usize {
    let mut scanner = Scanner { text, at };
    scanner.trivia();
    scanner.at
}

struct Scanner<'a> {
    text: &'a str,
    at: usize,
}

impl Scanner<'_> {
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    fn peek(&self) -> Option<char> {
        self.rest().chars().next()
    }

    fn eat(&mut self, token: &str) -> bool {
        let found = self.rest().starts_with(token);
        if found {
            self.at += token.len();
        }
        found
    }

    fn eat_while(&mut self, wanted: impl Fn(char) -> bool) {
        let rest = self.rest();
        self.at += rest.find(|character| !wanted(character)).unwrap_or(rest.len());
    }

    /// Moves behind the next `token`.
    fn eat_through(&mut self, token: &str) -> Option<()> {
        let length = self.rest().find(token)? + token.len();
        self.at += length;
        Some(())
    }

    fn trivia(&mut self) {
        loop {
            // Marks of reading direction count as whitespace in RON.
            self.eat_while(|character| character.is_whitespace() || "\u{200E}\u{200F}".contains(character));
            if self.rest().starts_with("//") {
                self.eat_while(|character| character != '\n');
            } else if !self.eat("/*") || self.block_comment().is_none() {
                return;
            }
        }
    }

    fn block_comment(&mut self) -> Option<()> {
        let mut depth = 1;
        while depth > 0 {
            if self.eat("/*") {
                depth += 1;
            } else if self.eat("*/") {
                depth -= 1;
            } else {
                self.at += self.peek()?.len_utf8();
            }
        }
        Some(())
    }

    fn document(&mut self) -> Option<Node> {
        self.trivia();
        while self.eat("#") {
            while !self.eat("]") {
                if self.peek()? == '"' {
                    self.quoted('"')?;
                } else {
                    self.at += self.peek()?.len_utf8();
                }
            }
            self.trivia();
        }
        let root = self.node()?;
        self.trivia();
        self.rest().is_empty().then_some(root)
    }

    fn node(&mut self) -> Option<Node> {
        let start = self.at;
        let (named, kind) = match self.peek()? {
            '(' => (false, self.parenthesised()?),
            '[' => (false, self.list()?),
            '{' => (false, self.map()?),
            _ if self.string_ahead() => {
                self.string()?;
                (false, Kind::Leaf)
            }
            _ if self.name() => {
                let end = self.at;
                self.trivia();
                if self.peek() == Some('(') {
                    (true, self.parenthesised()?)
                } else {
                    self.at = end;
                    (false, Kind::Leaf)
                }
            }
            _ => {
                self.eat_while(|character| !character.is_whitespace() && !"()[]{},:/\"".contains(character));
                (false, Kind::Leaf)
            }
        };
        (self.at > start).then_some(Node { span: start..self.at, named, kind })
    }

    fn string_ahead(&self) -> bool {
        let rest = self.rest();
        let rest = rest.strip_prefix('b').unwrap_or(rest);
        let raw = rest.strip_prefix('r').map(|hashes| hashes.trim_start_matches('#'));
        rest.starts_with(['"', '\'']) || raw.is_some_and(|raw| raw.starts_with('"'))
    }

    fn string(&mut self) -> Option<()> {
        self.eat("b");
        if !self.eat("r") {
            let quote = self.peek()?;
            return self.quoted(quote);
        }
        let start = self.at;
        self.eat_while(|character| character == '#');
        let closing = format!("\"{}", &self.text[start..self.at]);
        self.eat("\"");
        self.eat_through(&closing)
    }

    fn quoted(&mut self, quote: char) -> Option<()> {
        self.at += 1;
        loop {
            let character = self.peek()?;
            self.at += character.len_utf8();
            if character == quote {
                return Some(());
            }
            if character == '\\' {
                self.at += self.peek()?.len_utf8();
            }
        }
    }

    /// Eats a name, `raw` or not, if there is one.
    fn name(&mut self) -> bool {
        let start = self.at;
        if self.eat("r#") {
            self.eat_while(|character| character.is_alphanumeric() || "_.+-".contains(character));
        } else if self.peek().is_some_and(|first| first.is_alphabetic() || first == '_') {
            self.eat_while(|character| character.is_alphanumeric() || character == '_');
        }
        self.at > start
    }

    fn parenthesised(&mut self) -> Option<Kind> {
        self.eat("(");
        let open = self.at;
        self.trivia();
        let start = self.at;
        let is_struct = self.name() && {
            self.trivia();
            self.peek() == Some(':')
        };
        self.at = start;
        Some(if is_struct {
            Kind::Struct(open, self.until(")", Self::field)?)
        } else {
            Kind::Tuple(open, self.until(")", Self::node)?)
        })
    }

    fn list(&mut self) -> Option<Kind> {
        self.eat("[");
        Some(Kind::List(self.at, self.until("]", Self::node)?))
    }

    fn map(&mut self) -> Option<Kind> {
        self.eat("{");
        Some(Kind::Map(self.at, self.until("}", Self::pair)?))
    }

    /// What stands, separated by commas, before the closing bracket.
    fn until<T>(&mut self, close: &str, one: impl Fn(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        let mut found = Vec::new();
        self.trivia();
        while !self.eat(close) {
            found.push(one(self)?);
            self.trivia();
            if !self.eat(",") && !self.rest().starts_with(close) {
                return None;
            }
            self.trivia();
        }
        Some(found)
    }

    fn field(&mut self) -> Option<Entry> {
        let key_start = self.at;
        self.name();
        let key = self.text[key_start..self.at].trim_start_matches("r#").to_owned();
        self.value_of(key, key_start)
    }

    fn pair(&mut self) -> Option<Entry> {
        let key = self.node()?.span;
        let text = &self.text[key.clone()];
        self.value_of(ron::from_str(text).unwrap_or_else(|_| text.to_owned()), key.start)
    }

    fn value_of(&mut self, key: String, key_start: usize) -> Option<Entry> {
        self.trivia();
        if !self.eat(":") {
            return None;
        }
        self.trivia();
        Some(Entry { key, key_start, value: self.node()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The text of every value, outermost first.
    fn values(text: &str) -> Vec<&str> {
        fn collect<'a>(node: &Node, text: &'a str, into: &mut Vec<&'a str>) {
            into.push(&text[node.span.clone()]);
            node.children().for_each(|child| collect(child, text, into));
        }
        let root = Node::parse(text).unwrap_or_else(|at| panic!("{text:?} stops at {at}"));
        let mut found = Vec::new();
        collect(&root, text, &mut found);
        found
    }

    #[test]
    fn spans_exclude_comments_and_respect_strings() {
        let check = |text: &str, expect: &[&str]| {
            let found = values(text);
            assert_eq!(found[1..], *expect, "{text}");
            for value in found {
                shield_api::ron_options().from_str::<ron::Value>(value).unwrap();
            }
        };
        check("(a: 1_000, b: -1.5e3 /* , */ ,)", &["1_000", "-1.5e3"]);
        check(r#"#![type = "a]b"] ( a : "x)\"," , b: 'y', c: '\'' )"#, &[r#""x)\",""#, "'y'", r"'\''"]);
        check(
            r###"(a: r#"")"#, b: b"\"", c: br"\", r#d-e: r"")"###,
            &[r###"r#"")"#"###, r#"b"\"""#, r#"br"\""#, r#"r"""#],
        );
        check(
            "// (\n[Some /* ( /* */ */ (1), Name, (), ('a', true)]",
            &["Some /* ( /* */ */ (1)", "1", "Name", "()", "('a', true)", "'a'", "true"],
        );
        check("{\"k\": [1, // ]\n2], 'c': {}}", &["[1, // ]\n2]", "1", "2", "{}"]);
        check("X(ä: Y(b: inf), c: 0xFF, d: -inf)", &["Y(b: inf)", "inf", "0xFF", "-inf"]);
    }

    #[test]
    fn text_that_is_not_ron_is_refused() {
        for text in ["", "(", "(a: 1", "(a 1)", "[1 2]", "\"x", "(a: )", "1 2", "r#\"x\"", "{1}", "#"] {
            assert!(Node::parse(text).is_err(), "{text:?}");
        }
    }
}
