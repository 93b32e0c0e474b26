//! The texts of a new plugin: one base per language, and what each kind puts into its blocks.

use minijinja::{Environment, Error, UndefinedBehavior, syntax::SyntaxConfig};
use serde::Serialize;

macro_rules! texts {
    ($($name:literal),* $(,)?) => { &[$(($name, include_str!($name))),*] };
}

const TEXTS: &[(&str, &str)] = texts![
    "rust/base.rs",
    "rust/environment.rs",
    "rust/learner.rs",
    "rust/policy.rs",
    "rust/abort-rule.rs",
    "rust/reset-task.rs",
    "rust/success-critic.rs",
    "rust/Cargo.toml",
    "rust/README.md",
    "rust/gitignore",
    "c/base.c",
    "c/environment.c",
    "c/learner.c",
    "c/policy.c",
    "c/abort-rule.c",
    "c/reset-task.c",
    "c/success-critic.c",
    "c/Makefile",
    "c/README.md",
    "c/gitignore",
    "experiment.ron",
];

/// What the templates fill in.
#[derive(Debug, Serialize)]
pub(super) struct Values {
    /// `acme/my-rule`.
    pub id: String,
    /// `my-rule`: the folder, the crate and the experiment.
    pub name: String,
    /// `MyRule`: the type.
    #[serde(rename = "type")]
    pub type_name: String,
    /// `abort-rule`.
    pub kind: String,
    /// `abort_rule`: what the kind is called in `export_plugin!`.
    pub entry: String,
    /// `abort_rule`: where a descriptor has the table.
    pub place: String,
    /// `ABORT_RULE`.
    pub constant: String,
    /// `AbortRule`: whose table it is.
    pub table: String,
    /// Whoever makes it.
    pub author: String,
    /// The library, as seen from the folder.
    pub library: String,
    /// The folder of shield-api.
    pub api: String,
}

/// The templates, ready to be filled.
pub(super) fn templates() -> Result<Environment<'static>, Error> {
    let mut templates = Environment::new();
    // Rust, C and RON use every usual delimiter themselves.
    templates.set_syntax(
        SyntaxConfig::builder()
            .block_delimiters("<%", "%>")
            .variable_delimiters("[[", "]]")
            .comment_delimiters("<#", "#>")
            .build()?,
    );
    // A line with nothing but a tag leaves nothing; every other line stays as it is.
    templates.set_trim_blocks(true);
    templates.set_lstrip_blocks(true);
    templates.set_keep_trailing_newline(true);
    templates.set_undefined_behavior(UndefinedBehavior::SemiStrict);
    TEXTS.iter().try_for_each(|(name, text)| templates.add_template(name, text))?;
    Ok(templates)
}
