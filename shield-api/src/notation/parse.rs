//! From a text to its tree, in one pass. Brackets, names, strings and comments are read here; what a leaf says, the `ron` crate reads.

use std::collections::HashSet;

use serde::de::IgnoredAny;

use super::{Entry, Fault, Kind, Node, fault::shown, position_at};

/// How many brackets may stand inside one another.
pub const MAX_DEPTH: usize = 128;
/// How many bytes a text may have.
pub const LONGEST: usize = 4 << 20;

/// The tree of a whole text. The time that it takes grows with the length of the text alone.
///
/// # Errors
/// The text is not RON, repeats a key, or exceeds [`MAX_DEPTH`] or [`LONGEST`].
pub fn parse(text: &str) -> Result<Node, Fault> {
    if text.len() > LONGEST {
        let message = format!("the text has {} bytes; at most {LONGEST} are read", text.len());
        return Err(Fault::new(LONGEST, message));
    }
    let mut scanner = Scanner { text, at: 0, open: Vec::new() };
    scanner.attributes()?;
    let root = scanner.node()?;
    scanner.trivia()?;
    if scanner.rest().is_empty() {
        return Ok(root);
    }
    let message = format!("{} follows the value, where the text should end", scanner.found());
    Err(Fault::new(scanner.at, message))
}

/// The offset of the first character from `at` on that is neither whitespace nor comment.
pub fn skip_trivia(text: &str, at: usize) -> usize {
    let mut scanner = Scanner { text, at, open: Vec::new() };
    scanner.trivia().map_or(text.len(), |()| scanner.at)
}

struct Scanner<'a> {
    text: &'a str,
    at: usize,
    /// Where each bracket stands that is not closed yet.
    open: Vec<usize>,
}

impl<'a> Scanner<'a> {
    fn rest(&self) -> &'a str {
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

    fn fault<T>(&self, message: impl Into<String>) -> Result<T, Fault> {
        Err(Fault::new(self.at, message))
    }

    /// What stands here, for a message.
    fn found(&self) -> String {
        let word = &self.rest()[..word_len(self.rest())];
        match self.peek() {
            None => "the end".into(),
            Some(character) if word.is_empty() => format!("`{character}`"),
            Some(_) => format!("`{}`", shown(word)),
        }
    }

    /// The text has ended too early.
    fn end<T>(&self) -> Result<T, Fault> {
        let Some(open) = self.open.last() else { return self.fault("the text ends where a value should be") };
        let (bracket, line) = (&self.text[*open..=*open], position_at(self.text, *open).line);
        self.fault(format!("the text ends, but the `{bracket}` of line {line} is not closed"))
    }

    fn trivia(&mut self) -> Result<(), Fault> {
        loop {
            // Marks of reading direction count as whitespace in RON.
            self.eat_while(|character| character.is_whitespace() || "\u{200E}\u{200F}".contains(character));
            if self.rest().starts_with("//") {
                self.eat_while(|character| character != '\n');
            } else if self.rest().starts_with("/*") {
                self.block_comment()?;
            } else {
                return Ok(());
            }
        }
    }

    fn block_comment(&mut self) -> Result<(), Fault> {
        let (start, mut depth) = (self.at, 0_usize);
        loop {
            if self.eat("/*") {
                depth += 1;
            } else if self.eat("*/") {
                depth -= 1;
            } else if let Some(character) = self.peek() {
                self.at += character.len_utf8();
            } else {
                return Err(Fault::new(start, "this comment is not closed: `*/` is missing"));
            }
            if depth == 0 {
                return Ok(());
            }
        }
    }

    /// What may stand before the value, such as `#![enable(implicit_some)]`.
    fn attributes(&mut self) -> Result<(), Fault> {
        self.trivia()?;
        while self.rest().starts_with('#') {
            let start = self.at;
            while !self.eat("]") {
                match self.peek() {
                    Some('"') => self.quoted('"')?,
                    Some(character) => self.at += character.len_utf8(),
                    None => return Err(Fault::new(start, "this attribute is not closed: `]` is missing")),
                }
            }
            let attribute = &self.text[start..self.at];
            ron::Deserializer::from_str(attribute)
                .map_err(|error| Fault::new(start, lower_first(&error.code.to_string())))?;
            self.trivia()?;
        }
        Ok(())
    }

    fn node(&mut self) -> Result<Node, Fault> {
        let start = self.at;
        let Some(first) = self.peek() else { return self.end() };
        if string_ahead(self.rest()) {
            self.string()?;
            return self.leaf(start);
        }
        let name_len = name_len(self.rest());
        if name_len > 0 {
            self.at += name_len;
            self.trivia()?;
            if self.peek() != Some('(') {
                self.at = start;
                return self.word();
            }
        }
        let content = match first {
            '[' => self.list(),
            '{' => self.map(),
            _ if self.peek() == Some('(') => self.parenthesised(),
            _ => return self.word(),
        };
        let (open_len, kind) = content?;
        Ok(Node { span: start..self.at, name_len, open_len: open_len - start, kind })
    }

    /// A number or a bare name.
    fn word(&mut self) -> Result<Node, Fault> {
        let (start, word) = (self.at, &self.rest()[..word_len(self.rest())]);
        if word.is_empty() {
            return self.fault(format!("a value should stand here, not {}", self.found()));
        }
        self.at += word.len();
        if name_len(word) == word.len() {
            return Ok(Node::leaf(start..self.at, word.len()));
        }
        self.leaf(start)
    }

    /// A leaf from `start` to here, if the `ron` crate can read it.
    fn leaf(&self, start: usize) -> Result<Node, Fault> {
        let text = &self.text[start..self.at];
        let Err(error) = ron::from_str::<IgnoredAny>(text) else { return Ok(Node::leaf(start..self.at, 0)) };
        Err(if string_ahead(text) {
            Fault::new(start, lower_first(&error.code.to_string()))
        } else {
            let message = format!("`{}` is neither a number nor a name", shown(text));
            Fault::new(start, message).with_remedy(Some("a text needs quotes"))
        })
    }

    fn string(&mut self) -> Result<(), Fault> {
        let start = self.at;
        self.eat("b");
        if !self.eat("r") {
            let quote = if self.rest().starts_with('"') { '"' } else { '\'' };
            return self.quoted(quote);
        }
        let hashes = self.at;
        self.eat_while(|character| character == '#');
        let closing = format!("\"{}", &self.text[hashes..self.at]);
        self.eat("\"");
        match self.rest().find(&closing) {
            Some(length) => self.at += length + closing.len(),
            None => {
                return Err(Fault::new(
                    start,
                    format!("this text is not closed: `{}` is missing", shown(&closing)),
                ));
            }
        }
        Ok(())
    }

    fn quoted(&mut self, quote: char) -> Result<(), Fault> {
        let start = self.at;
        self.at += 1;
        while let Some(character) = self.peek() {
            self.at += character.len_utf8();
            if character == quote {
                return Ok(());
            }
            if character == '\\' {
                self.at += self.peek().map_or(0, char::len_utf8);
            }
        }
        Err(Fault::new(start, format!("this text is not closed: `{quote}` is missing")))
    }

    fn parenthesised(&mut self) -> Result<(usize, Kind), Fault> {
        let content = self.begin()?;
        let start = self.at;
        self.at += name_len(self.rest());
        let is_named = self.at > start && {
            self.trivia()?;
            self.peek() == Some(':')
        };
        self.at = start;
        let kind = if is_named {
            Kind::Struct(self.entries(")", Self::field_name)?)
        } else {
            Kind::Tuple(self.until(")", Self::node)?)
        };
        Ok((content, kind))
    }

    fn list(&mut self) -> Result<(usize, Kind), Fault> {
        let content = self.begin()?;
        Ok((content, Kind::List(self.until("]", Self::node)?)))
    }

    fn map(&mut self) -> Result<(usize, Kind), Fault> {
        let content = self.begin()?;
        Ok((content, Kind::Map(self.entries("}", Self::node)?)))
    }

    /// Goes over a bracket that opens; gives the place behind it.
    fn begin(&mut self) -> Result<usize, Fault> {
        if self.open.len() == MAX_DEPTH {
            return self.fault(format!("more than {MAX_DEPTH} brackets stand inside one another here"));
        }
        self.open.push(self.at);
        self.at += 1;
        let content = self.at;
        self.trivia()?;
        Ok(content)
    }

    /// What stands, separated by commas, before the closing bracket.
    fn until<T>(
        &mut self,
        close: &str,
        one: impl Fn(&mut Self) -> Result<T, Fault>,
    ) -> Result<Vec<T>, Fault> {
        let mut found = Vec::new();
        while !self.eat(close) {
            found.push(one(self)?);
            self.trivia()?;
            if !self.eat(",") && !self.rest().starts_with(close) {
                if self.peek().is_none() {
                    return self.end();
                }
                return self.fault(format!("`,` or `{close}` should stand here, not {}", self.found()));
            }
            self.trivia()?;
        }
        self.open.pop();
        Ok(found)
    }

    fn entries(
        &mut self,
        close: &str,
        key: impl Fn(&mut Self) -> Result<Node, Fault>,
    ) -> Result<Vec<Entry>, Fault> {
        let entries = self.until(close, |scanner| scanner.entry(&key))?;
        let mut known = HashSet::with_capacity(entries.len());
        match entries.iter().find(|entry| !known.insert(entry.key.as_str())) {
            None => Ok(entries),
            Some(Entry { key, key_node, .. }) => {
                Err(Fault::new(key_node.span.start, format!("`{}` is given twice", shown(key))))
            }
        }
    }

    fn entry(&mut self, key: impl Fn(&mut Self) -> Result<Node, Fault>) -> Result<Entry, Fault> {
        let key_node = key(self)?;
        let written = &self.text[key_node.span.clone()];
        let key = if key_node.name_len > 0 {
            key_node.name(self.text).to_owned()
        } else {
            ron::from_str(written).unwrap_or_else(|_| written.to_owned())
        };
        self.trivia()?;
        if !self.eat(":") {
            if self.peek().is_none() {
                return self.end();
            }
            return self.fault(format!("`:` should stand here, behind `{}`", shown(written)));
        }
        self.trivia()?;
        Ok(Entry { key, key_node, value: self.node()? })
    }

    fn field_name(&mut self) -> Result<Node, Fault> {
        let (start, length) = (self.at, name_len(self.rest()));
        if self.peek().is_none() {
            return self.end();
        }
        if length == 0 {
            return self.fault(format!("the name of a field should stand here, not {}", self.found()));
        }
        self.at += length;
        Ok(Node::leaf(start..self.at, length))
    }
}

/// Whether `text` begins with a string or a character.
fn string_ahead(text: &str) -> bool {
    let text = text.strip_prefix('b').unwrap_or(text);
    let raw = text.strip_prefix('r').map(|hashes| hashes.trim_start_matches('#'));
    text.starts_with(['"', '\'']) || raw.is_some_and(|raw| raw.starts_with('"'))
}

/// Bytes of the name, raw or not, with which `text` begins.
fn name_len(text: &str) -> usize {
    let end = |from: usize, is_part: fn(char) -> bool| {
        text[from..].find(|character| !is_part(character)).map_or(text.len(), |end| from + end)
    };
    if text.starts_with("r#") {
        let raw = end(2, |character| character.is_alphanumeric() || "_.+-".contains(character));
        return if raw > 2 { raw } else { 0 };
    }
    let begins = text.chars().next().is_some_and(|first| first.is_alphabetic() || first == '_');
    if begins { end(0, |character| character.is_alphanumeric() || character == '_') } else { 0 }
}

/// Bytes up to the next whitespace, bracket or separator.
fn word_len(text: &str) -> usize {
    let is_end = |character: char| character.is_whitespace() || "()[]{},:\"".contains(character);
    let end = text.find(is_end).unwrap_or(text.len());
    let comment = text[..end].find("//").into_iter().chain(text[..end].find("/*")).min();
    comment.unwrap_or(end)
}

fn lower_first(sentence: &str) -> String {
    let mut characters = sentence.chars();
    characters.next().map(|first| first.to_lowercase().chain(characters).collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests;
