//! Paths into a text, such as `shield.rules[0].config.q_min`.

use super::{MAX_DEPTH, Node, fault::shown};

/// One step of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Segment<'a> {
    /// To the field or key of this name.
    Field(&'a str),
    /// To an element of a list, from 0.
    Index(usize),
}

/// Splits a path; an empty path is the whole text.
///
/// # Errors
/// A sentence that says why it is not a path.
pub fn segments(path: &str) -> Result<Vec<Segment<'_>>, String> {
    let malformed =
        || format!("`{}` is not a path; it should look like `shield.rules[0].config.q_min`", shown(path));
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
        if found.len() > MAX_DEPTH {
            return Err(format!("`{}` has more than {MAX_DEPTH} parts", shown(path)));
        }
    }
    Ok(found)
}

/// The value at a path, or the nearest one around it, and whether it is the value itself.
pub fn nearest<'a>(root: &'a Node, path: &str) -> (&'a Node, bool) {
    let Ok(segments) = segments(path) else { return (root, false) };
    let mut node = root;
    for segment in segments {
        match node.child(segment) {
            Some(found) => node = found,
            None => return (node, false),
        }
    }
    (node, true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::notation::parse;

    #[test]
    fn a_path_leads_to_its_value_or_to_the_one_around_it() {
        let text = "X(a: Some((b: [1, (2, 3)])), c: {\"k y\": 4}, d: Some(e: 5))";
        let root = parse(text).unwrap();
        for (path, value, is_itself) in [
            ("", text, true),
            ("a", "Some((b: [1, (2, 3)]))", true),
            ("a.b[1][0]", "2", true),
            ("c.k y", "4", true),
            ("d.e", "5", true),
            ("d.f", "Some(e: 5)", false),
            ("a.b[7].x", "[1, (2, 3)]", false),
            ("a..b", text, false),
        ] {
            let (node, found) = nearest(&root, path);
            assert_eq!((&text[node.span.clone()], found), (value, is_itself), "{path}");
        }
    }

    #[test]
    fn a_path_of_any_length_is_refused_shortly() {
        for path in ["a.".repeat(1_000_000), "a[".repeat(1_000_000), format!("a{}", "[0]".repeat(1_000_000))]
        {
            assert!(segments(&path).unwrap_err().len() < 200);
        }
    }
}
