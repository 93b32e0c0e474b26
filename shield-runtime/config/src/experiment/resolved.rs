//! The fully resolved configuration of a run or a drop-in, as RON.

use ron::{Options, extensions::Extensions};
use serde::Serialize;
use shield_api::{
    Spaces,
    notation::{Entry, Node, parse},
};

use super::{
    DropInFile,
    config::{PluginChoice, SpacesConfig},
    edit::place_for_field,
    ron_text::RonText,
    variant::Variant,
};

/// Structures that fit into so many characters stand on one line.
const LINE: usize = 90;
const INDENT: &str = "    ";

impl Variant {
    /// What one run does, with every field explicit: no variants, one seed, and the configuration of each plugin completed by the
    /// defaults that `fields_of` its id lists (names and RON text). A default that is not RON is left out. It can be run again.
    pub fn resolved_ron(&self, seed: u64, fields_of: &dyn Fn(&str) -> Vec<(String, String)>) -> String {
        let mut experiment = self.experiment.clone();
        experiment.seeds = vec![seed];
        experiment.variants.clear();
        for choice in experiment.plugins_mut() {
            complete(choice, &fields_of(&choice.plugin));
        }
        let heading = format!("// {}, variant {}, seed {seed}\nExperiment", experiment.name, self.name);
        written(heading, &experiment)
    }
}

impl DropInFile {
    /// What it says for an environment with these spaces, with every field explicit, as [`Variant::resolved_ron`] does of a run.
    pub fn resolved_ron(&self, spaces: &Spaces, fields_of: &dyn Fn(&str) -> Vec<(String, String)>) -> String {
        let mut config = self.config.clone();
        config.spaces = Some(SpacesConfig::of(spaces));
        for choice in config.plugins_mut() {
            complete(choice, &fields_of(&choice.plugin));
        }
        written("DropIn".into(), &config)
    }
}

/// A configuration over many lines, behind its heading.
fn written(heading: String, config: &impl Serialize) -> String {
    let text = writer().to_string(config).expect("a configuration that was read can be written");
    let root = parse(&text).expect("what ron writes can be read");
    let mut out = heading;
    write_value(&mut out, &root, &text, 0);
    out.push('\n');
    out
}

/// Short forms, as the examples have them.
fn writer() -> Options {
    let short = Extensions::UNWRAP_VARIANT_NEWTYPES | Extensions::IMPLICIT_SOME;
    Options::default().with_default_extension(short).without_recursion_limit()
}

/// Adds the fields that the configuration does not give.
fn complete(choice: &mut PluginChoice, fields: &[(String, String)]) {
    let given = choice.config.get_ron();
    let Ok(root) = parse(given) else { return };
    let node = root.inner();
    let Some((at, mut needs_comma)) = place_for_field(node) else { return };
    let mut text = given[..at].to_owned();
    for (name, default) in fields {
        if node.entry(name).is_some() || parse(default).is_err() {
            continue;
        }
        let comma = if needs_comma { ", " } else { "" };
        text += &format!("{comma}{name}: {default}");
        needs_comma = true;
    }
    text += &given[at..];
    if let Ok(completed) = RonText::new(text) {
        choice.config = completed;
    }
}

fn write_value(out: &mut String, node: &Node, text: &str, depth: usize) {
    let flat = flat(node, text);
    let is_short = depth * INDENT.len() + flat.chars().count() <= LINE && !flat.contains('\n');
    if depth > 0 && is_short || node.children().next().is_none() {
        *out += &flat;
        return;
    }
    let (before, close) = brackets(node, text);
    *out += before;
    let line = |out: &mut String, key: &str, value: &Node| {
        *out += &format!("\n{}{key}", INDENT.repeat(depth + 1));
        write_value(out, value, text, depth + 1);
        out.push(',');
    };
    for entry in node.entries() {
        line(out, &key(entry, text), &entry.value);
    }
    for item in node.items() {
        line(out, "", item);
    }
    *out += &format!("\n{}{close}", INDENT.repeat(depth));
}

/// The value on one line, without comments.
pub(super) fn flat(node: &Node, text: &str) -> String {
    if node.is_leaf() {
        return text[node.span.clone()].to_owned();
    }
    let (before, close) = brackets(node, text);
    let entries = node.entries().iter().map(|entry| key(entry, text) + &flat(&entry.value, text));
    let items = node.items().iter().map(|item| flat(item, text));
    let content: Vec<String> = entries.chain(items).collect();
    format!("{before}{}{close}", content.join(", "))
}

/// What stands before the content, a name included, and the closing bracket.
fn brackets<'a>(node: &Node, text: &'a str) -> (&'a str, &'a str) {
    let open = node.span.start + node.open_len;
    (&text[node.span.start..open], &text[node.span.end - 1..node.span.end])
}

fn key(entry: &Entry, text: &str) -> String {
    format!("{}: ", &text[entry.key_node.span.clone()])
}
