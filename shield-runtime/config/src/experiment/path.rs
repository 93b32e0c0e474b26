//! Paths into a RON text, such as `shield.rules[0].config.q_min`.

use super::edit::{EditedText, Origin};
use super::error::did_you_mean;
use super::tree::{Kind, Node};

/// One step of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Segment<'a> {
    Field(&'a str),
    Index(usize),
}

/// Splits a path; an empty path is the whole text.
fn segments(path: &str) -> Result<Vec<Segment<'_>>, String> {
    let malformed = || format!("`{path}` is not a path; it should look like `shield.rules[0].config.q_min`");
    let mut found = Vec::new();
    for part in path.split('.').filter(|_| !path.is_empty()) {
        let (field, indices) = part.find('[').map_or((part, ""), |bracket| part.split_at(bracket));
        if field.is_empty() || !(indices.is_empty() || indices.ends_with(']')) {
            return Err(malformed());
        }
        found.push(Segment::Field(field));
        for index in indices.split_terminator(']') {
            let digits = index.strip_prefix('[').and_then(|digits| digits.parse().ok());
            found.push(Segment::Index(digits.ok_or_else(malformed)?));
        }
    }
    Ok(found)
}

fn child<'a>(node: &'a Node, segment: Segment) -> Option<&'a Node> {
    let node = node.inner();
    match segment {
        Segment::Field(name) => {
            node.entries().iter().find(|entry| entry.key == name).map(|entry| &entry.value)
        }
        Segment::Index(index) => node.items().get(index),
    }
}

/// The value at a path, or the nearest one around it, and whether it is the value itself.
pub(super) fn nearest<'a>(root: &'a Node, path: &str) -> (&'a Node, bool) {
    let Ok(segments) = segments(path) else { return (root, false) };
    let mut node = root;
    for segment in segments {
        match child(node, segment) {
            Some(found) => node = found,
            None => return (node, false),
        }
    }
    (node, true)
}

/// Gives the value at a path; fields that are missing are written, and the structures around them.
/// `value` is the text with the index of its override.
///
/// # Errors
/// A sentence that says why there is no such place.
pub(super) fn set(
    edited: &mut EditedText,
    root: &Node,
    path: &str,
    value: (&str, usize),
) -> Result<(), String> {
    let (text, index) = value;
    let segments = segments(path)?;
    let mut node = root;
    for (depth, segment) in segments.iter().enumerate() {
        match child(node, *segment) {
            Some(found) => node = found,
            None => return insert(edited, node.inner(), &segments[depth..], value),
        }
    }
    edited.replace(node.span.clone(), &[(text, Origin::Value(index, 0))]);
    Ok(())
}

fn insert(
    edited: &mut EditedText,
    node: &Node,
    missing: &[Segment],
    value: (&str, usize),
) -> Result<(), String> {
    let is_none = &edited.text()[node.span.clone()] == "None";
    let (range, before, after) = match node.place_for_field() {
        Some((at, true)) => (at..at, ", ", ""),
        Some((at, false)) => (at..at, "", ""),
        None if is_none => (node.span.clone(), "(", ")"),
        None => return Err(why_not(node, missing[0])),
    };
    let is_map = matches!(node.kind, Kind::Map(..));
    let mut around = before.to_owned();
    for (depth, segment) in missing.iter().enumerate() {
        let Segment::Field(name) = segment else {
            return Err(no_list(node, &missing[..depth]).unwrap_or_else(|| why_not(node, *segment)));
        };
        if is_map && depth == 0 {
            around += &format!("{name:?}: ");
        } else if name.chars().all(|character| character.is_alphanumeric() || character == '_') {
            around += &format!("{name}: ");
        } else {
            return Err(format!("`{name}` cannot be the name of a field"));
        }
        if depth + 1 < missing.len() {
            around.push('(');
        }
    }
    let closing = format!("{}{after}", ")".repeat(missing.len() - 1));
    let (text, index) = value;
    let origin = Origin::Around(index);
    edited.replace(range, &[(&around, origin), (text, Origin::Value(index, 0)), (&closing, origin)]);
    Ok(())
}

/// What is wrong with an element of a list that is not written, `fields` inside `node`; `None` if no field is missing.
fn no_list(node: &Node, fields: &[Segment]) -> Option<String> {
    let names: Vec<&str> = fields
        .iter()
        .filter_map(|segment| match segment {
            Segment::Field(name) => Some(*name),
            Segment::Index(_) => None,
        })
        .collect();
    let known = node.entries().iter().map(|entry| entry.key.as_str());
    let remedy = did_you_mean(names.first()?, known).map(|remedy| format!("; {remedy}"));
    Some(format!("there is no list `{}`{}", names.join("."), remedy.unwrap_or_default()))
}

fn why_not(node: &Node, segment: Segment) -> String {
    match (segment, &node.kind) {
        (Segment::Field(name), _) => format!("there is no place for `{name}`: the value there has no fields"),
        (Segment::Index(index), Kind::List(..)) => {
            format!("there is no element [{index}]: the list has {}", node.items().len())
        }
        (Segment::Index(index), _) => format!("there is no element [{index}]: there is no list"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set_in(text: &str, path: &str, value: &str) -> Result<String, String> {
        let mut edited = EditedText::new(text);
        let root = Node::parse(text).unwrap();
        set(&mut edited, &root, path, (value, 0)).map(|()| edited.text().to_owned())
    }

    #[test]
    fn an_override_replaces_a_value_or_adds_a_missing_field() {
        let check = |text, path, expect: Result<&str, &str>| {
            let found = set_in(text, path, "7");
            assert_eq!(found, expect.map(str::to_owned).map_err(str::to_owned), "{text} {path}");
        };
        check("(a: 1, b: 2)", "a", Ok("(a: 7, b: 2)"));
        check("(a: 1, /* x */ b: 2, // y\n)", "c", Ok("(a: 1, /* x */ b: 2, c: 7, // y\n)"));
        check("X(a: Some((b: [1, (2, 3)])))", "a.b[1][0]", Ok("X(a: Some((b: [1, (7, 3)])))"));
        check("(a: Some(b: 1))", "a.c", Ok("(a: Some(b: 1, c: 7))"));
        check("()", "a.b.c", Ok("(a: (b: (c: 7)))"));
        check("(a: None)", "a.b", Ok("(a: (b: 7))"));
        check("(a: {\"k\": 1})", "a.k", Ok("(a: {\"k\": 7})"));
        check("(a: {})", "a.new key", Ok("(a: {\"new key\": 7})"));
        check("(a: 1)", "a.b", Err("there is no place for `b`: the value there has no fields"));
        check("(a: [1])", "a[1]", Err("there is no element [1]: the list has 1"));
        check("(a: 1)", "a[0]", Err("there is no element [0]: there is no list"));
        check("(a: 1)", "b[0].c", Err("there is no list `b`"));
        check("(rules: [1])", "ruls[0]", Err("there is no list `ruls`; did you mean `rules`?"));
        check("(rules: (x: [1]))", "ruls.x[0]", Err("there is no list `ruls.x`; did you mean `rules`?"));
        check("(a: 1)", "b c", Err("`b c` cannot be the name of a field"));
        for malformed in ["a..b", ".a", "a.", "a[x]", "a[0", "a[0]b"] {
            assert!(set_in("(a: [1])", malformed, "7").is_err(), "{malformed}");
        }
    }
}
