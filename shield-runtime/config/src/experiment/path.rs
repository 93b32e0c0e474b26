//! Paths into a RON text, such as `shield.rules[0].config.q_min`.

use shield_api::notation::{Kind, Node, Segment, did_you_mean, segments};

use super::edit::{EditedText, Origin, place_for_field};

/// Gives the value at a path; fields that are missing are written, and the structures around them.
/// `value` is the text with the index of its override.
///
/// # Errors
/// A sentence that says why there is no such place.
pub(super) fn set(edited: &mut EditedText, path: &str, value: (&str, usize)) -> Result<(), String> {
    let (text, index) = value;
    let segments = segments(path)?;
    let mut node = edited.root();
    for (depth, segment) in segments.iter().enumerate() {
        match node.child(*segment) {
            Some(found) => node = found,
            None => return insert(edited, segments.split_at(depth), value),
        }
    }
    edited.replace(&segments, &[(text, Origin::Value(index, 0))]).map_err(|fault| fault.message)
}

fn insert(
    edited: &mut EditedText,
    (present, missing): (&[Segment<'_>], &[Segment<'_>]),
    (text, index): (&str, usize),
) -> Result<(), String> {
    let found = present.iter().try_fold(edited.root(), |node, segment| node.child(*segment));
    let node = found.unwrap_or(edited.root()).inner();
    let is_none = node.is_leaf() && node.name(edited.text()) == "None";
    if place_for_field(node).is_none() && !is_none {
        return Err(why_not(node, missing[0]));
    }
    let (before, closing) = around(node, missing)?;
    let (origin, value) = (Origin::Around(index), (text, Origin::Value(index, 0)));
    let inserted = if is_none {
        let (before, closing) = (format!("({before}"), format!("{closing})"));
        edited.replace(present, &[(&before, origin), value, (&closing, origin)])
    } else {
        edited.insert(present, &[(&before, origin), value, (&closing, origin)])
    };
    inserted.map_err(|fault| fault.message)
}

/// What stands before and behind the value of a field that is missing in `node`, with the structures around it.
fn around(node: &Node, missing: &[Segment<'_>]) -> Result<(String, String), String> {
    let is_map = matches!(node.kind, Kind::Map(_));
    let mut before = String::new();
    for (depth, segment) in missing.iter().enumerate() {
        let Segment::Field(name) = segment else {
            return Err(no_list(node, &missing[..depth]).unwrap_or_else(|| why_not(node, *segment)));
        };
        if is_map && depth == 0 {
            before += &format!("{name:?}: ");
        } else if is_field_name(name) {
            before += &format!("{name}: ");
        } else {
            return Err(format!("`{name}` cannot be the name of a field"));
        }
        if depth + 1 < missing.len() {
            before.push('(');
        }
    }
    Ok((before, ")".repeat(missing.len() - 1)))
}

fn is_field_name(name: &str) -> bool {
    let begins = name.starts_with(|first: char| first.is_alphabetic() || first == '_');
    begins && name.chars().all(|character| character.is_alphanumeric() || character == '_')
}

/// What is wrong with an element of a list that is not written, `fields` inside `node`; `None` if no field is missing.
fn no_list(node: &Node, fields: &[Segment<'_>]) -> Option<String> {
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

fn why_not(node: &Node, segment: Segment<'_>) -> String {
    match (segment, &node.kind) {
        (Segment::Field(name), _) => format!("there is no place for `{name}`: the value there has no fields"),
        (Segment::Index(index), Kind::List(_)) => {
            format!("there is no element [{index}]: the list has {}", node.items().len())
        }
        (Segment::Index(index), _) => format!("there is no element [{index}]: there is no list"),
    }
}

#[cfg(test)]
mod tests {
    use shield_api::notation::parse;

    use super::*;

    fn set_in(text: &str, path: &str, value: &str) -> Result<String, String> {
        let mut edited = EditedText::new(text, parse(text).unwrap());
        set(&mut edited, path, (value, 0)).map(|()| edited.text().to_owned())
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
        check("(a: 1)", "5", Err("`5` cannot be the name of a field"));
        check("(a: 1)", "b.5", Err("`5` cannot be the name of a field"));
        check("(a: Some())", "a.b", Ok("(a: Some(b: 7))"));
        for malformed in ["a..b", ".a", "a.", "a[x]", "a[0", "a[0]b"] {
            assert!(set_in("(a: [1])", malformed, "7").is_err(), "{malformed}");
        }
    }
}
