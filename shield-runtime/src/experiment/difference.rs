//! Where two resolved configurations differ.

use std::fmt;

use super::resolved::flat;
use super::tree::Node;

/// The first field that differs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Path of the field, such as `shield.rules[0].config.q_min`.
    pub path: String,
    /// Its value in the first text; `None` if it is not there.
    pub first: Option<String>,
    /// Its value in the second.
    pub second: Option<String>,
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "missing".into());
        write!(formatter, "`{}` is {} there, and {} now", self.path, value(&self.first), value(&self.second))
    }
}

/// Compares two resolved configurations of one run; `None` if they give the same results. `threads` may differ.
pub fn first_difference(first: &str, second: &str) -> Option<Difference> {
    let whole = |text: &str| (!text.trim().is_empty()).then(|| "not RON".to_owned());
    match (Node::parse(first), Node::parse(second)) {
        (Ok(one), Ok(other)) => differ("", (&one, first), (&other, second)),
        _ if first == second => None,
        _ => Some(Difference { path: "config.ron".into(), first: whole(first), second: whole(second) }),
    }
}

fn differ(path: &str, one: (&Node, &str), other: (&Node, &str)) -> Option<Difference> {
    let ((a, first), (b, second)) = (one, other);
    if path == "threads" {
        return None;
    }
    let here = |first: Option<String>, second: Option<String>, path: String| {
        Some(Difference { path, first, second })
    };
    let is_compound = a.children().next().is_some() && b.children().next().is_some();
    if !is_compound {
        let (x, y) = (flat(a, first), flat(b, second));
        return if x == y { None } else { here(Some(x), Some(y), path.to_owned()) };
    }
    let (x, y) = (name(a, first), name(b, second));
    if x != y {
        return here(Some(flat(a, first)), Some(flat(b, second)), path.to_owned());
    }
    for entry in a.entries() {
        let inside = join(path, &entry.key);
        match b.entries().iter().find(|candidate| candidate.key == entry.key) {
            Some(found) => {
                if let Some(found) = differ(&inside, (&entry.value, first), (&found.value, second)) {
                    return Some(found);
                }
            }
            None => return here(Some(flat(&entry.value, first)), None, inside),
        }
    }
    let is_known = |key: &str| a.entries().iter().any(|entry| entry.key == key);
    if let Some(new) = b.entries().iter().find(|entry| !is_known(&entry.key)) {
        return here(None, Some(flat(&new.value, second)), join(path, &new.key));
    }
    if a.items().len() != b.items().len() {
        return here(Some(flat(a, first)), Some(flat(b, second)), path.to_owned());
    }
    // `Some(…)` and the like around one value are no place of their own in a path.
    let is_wrapper = a.named && a.items().len() == 1;
    a.items().iter().zip(b.items()).enumerate().find_map(|(index, (one, other))| {
        let inside = if is_wrapper { path.to_owned() } else { format!("{path}[{index}]") };
        differ(&inside, (one, first), (other, second))
    })
}

/// What stands before the bracket.
fn name<'a>(node: &Node, text: &'a str) -> &'a str {
    let whole = &text[node.span.clone()];
    whole.split(['(', '[', '{']).next().unwrap_or_default().trim_end()
}

fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(first: &str, second: &str, expected: Option<&str>) {
        let found = first_difference(first, second);
        assert_eq!(
            found.as_ref().map(|found| found.path.as_str()),
            expected,
            "{first} and {second}: {found:?}"
        );
    }

    #[test]
    fn the_field_that_differs_is_named() {
        check("A(a: 1, b: (c: [1, 2]))", "A( a: 1, b: (c: [1,2]) )", None);
        check("A(a: 1, b: (c: [1, 2]))", "A(a: 1, b: (c: [1, 3]))", Some("b.c[1]"));
        check("A(a: 1, b: (c: [1, 2]))", "A(a: 1, b: (c: [1]))", Some("b.c"));
        check("A(a: Learner(p: 1))", "A(a: Policy(p: 1))", Some("a"));
        check("A(a: Some((p: 1)))", "A(a: Some((p: 2)))", Some("a.p"));
        check("A(a: Some((p: 1)))", "A(a: None)", Some("a"));
        check("A(a: 1)", "A(a: 1, b: 2)", Some("b"));
        check("A(a: 1, b: 2)", "A(a: 1)", Some("b"));
        check("A(a: 1, threads: 2)", "A(a: 1, threads: 1)", None);
        check("// one\nA(a: 1)", "// other\nA(a: 1)", None);
        check("(", "A(a: 1)", Some("config.ron"));
    }
}
