//! Where two resolved configurations differ.

use std::{collections::HashMap, fmt};

use shield_api::notation::{Node, parse};

use super::resolved::flat;

/// A field that differs.
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
    differences(first, second).into_iter().next()
}

/// Every field in which two resolved configurations differ, in the order of the first. `threads` may.
pub fn differences(first: &str, second: &str) -> Vec<Difference> {
    let whole = |text: &str| (!text.trim().is_empty()).then(|| "not RON".to_owned());
    let mut found = Vec::new();
    match (parse(first), parse(second)) {
        (Ok(one), Ok(other)) => compare("", (&one, first), (&other, second), &mut found),
        _ if first == second => (),
        _ => {
            found.push(Difference { path: "config.ron".into(), first: whole(first), second: whole(second) });
        }
    }
    found
}

fn compare(path: &str, one: (&Node, &str), other: (&Node, &str), found: &mut Vec<Difference>) {
    let ((a, first), (b, second)) = (one, other);
    if path == "threads" {
        return;
    }
    let mut differ = |first: Option<String>, second: Option<String>, path: String| {
        found.push(Difference { path, first, second });
    };
    let is_compound = a.children().next().is_some() && b.children().next().is_some();
    let has_same_name = a.name(first) == b.name(second);
    let has_same_length = a.items().len() == b.items().len();
    if !is_compound || !has_same_name || !has_same_length {
        let (x, y) = (flat(a, first), flat(b, second));
        if x != y || is_compound {
            differ(Some(x), Some(y), path.to_owned());
        }
        return;
    }
    let (ours, theirs) = (by_key(a), by_key(b));
    for entry in a.entries().iter().filter(|entry| !theirs.contains_key(entry.key.as_str())) {
        differ(Some(flat(&entry.value, first)), None, join(path, &entry.key));
    }
    for entry in b.entries().iter().filter(|entry| !ours.contains_key(entry.key.as_str())) {
        differ(None, Some(flat(&entry.value, second)), join(path, &entry.key));
    }
    for entry in a.entries() {
        if let Some(other) = theirs.get(entry.key.as_str()) {
            compare(&join(path, &entry.key), (&entry.value, first), (other, second), found);
        }
    }
    // `Some(…)` and the like around one value are no place of their own in a path.
    let is_wrapper = a.is_named() && a.items().len() == 1;
    for (index, (one, other)) in a.items().iter().zip(b.items()).enumerate() {
        let inside = if is_wrapper { path.to_owned() } else { format!("{path}[{index}]") };
        compare(&inside, (one, first), (other, second), found);
    }
}

fn by_key(node: &Node) -> HashMap<&str, &Node> {
    node.entries().iter().map(|entry| (entry.key.as_str(), &entry.value)).collect()
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

    #[test]
    fn every_field_that_differs_is_listed_once() {
        let found = differences("A(a: 1, b: (c: 2, d: [1, 2]), e: 3)", "A(a: 2, b: (c: 2, d: [1, 3]), f: 3)");
        let mut paths: Vec<&str> = found.iter().map(|difference| difference.path.as_str()).collect();
        paths.sort_unstable();
        assert_eq!(paths, ["a", "b.d[1]", "e", "f"]);
    }
}
