//! `shield plugin new`: the folder of a plugin that builds at once.

mod templates;

use std::{
    env, fs, io,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};

use shield_host::plugin::Kind;
use shield_lab::run::write_in_folder;

use self::templates::{Values, templates};
use super::super::{Failure, output};

/// Arguments of `shield plugin new`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct NewArguments {
    /// The id under which experiments name it, for example acme/my-rule: small letters, digits, `-`, `_`, and one `/` after your name.
    id: String,
    /// What it is.
    #[arg(long, value_enum)]
    kind: NewKind,
    /// The language.
    #[arg(long = "lang", value_enum, default_value = "rust")]
    language: Language,
    /// The folder to make; the last part of the id if none is given.
    #[arg(long)]
    path: Option<PathBuf>,
    /// The folder of shield-api to build against, unpacked if it comes as a package; looked for beside this program if none is given.
    #[arg(long, value_name = "FOLDER")]
    api: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  shield plugin new acme/my-rule --kind abort-rule            in Rust, without any `unsafe`
  shield plugin new acme/arm --kind environment --lang c      in C, against shield_plugin.h
  cd my-rule && cargo build --release && shield plugin check target/release/libmy_rule.so";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum NewKind {
    /// A world in which the agents act
    Environment,
    /// An agent that learns, with an ensemble of Q-functions
    Learner,
    /// A finished controller
    Policy,
    /// What forbids actions
    #[value(alias = "rule")]
    AbortRule,
    /// What "undone" means, for an environment that does not say it
    ResetTask,
    /// An ensemble that estimates how likely an action can be undone
    SuccessCritic,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Language {
    /// Rust, against the crate shield-api
    Rust,
    /// C, against shield_plugin.h; C++ can include it as well
    C,
}

impl NewKind {
    /// The kind in a manifest.
    fn name(self) -> &'static str {
        match self {
            Self::Environment => Kind::Environment,
            Self::Learner => Kind::Learner,
            Self::Policy => Kind::Policy,
            Self::AbortRule => Kind::AbortRule,
            Self::ResetTask => Kind::ResetTask,
            Self::SuccessCritic => Kind::SuccessCritic,
        }
        .name()
    }

    /// The kind whose table it sets, as the manifest writes it: the descriptor has no place of its own for later kinds.
    fn table(self) -> &'static str {
        if self == Self::SuccessCritic { Kind::Learner.name() } else { self.name() }
    }
}

/// Makes the folder and says what comes next.
pub fn new(arguments: &NewArguments) -> Result<(), Failure> {
    check_id(&arguments.id).map_err(Failure::Input)?;
    let api = match &arguments.api {
        Some(api) => is_api(api).then(|| api.clone()).ok_or_else(|| not_an_api(api))?,
        None => api_beside_program().ok_or_else(no_api)?,
    };
    let api = api.canonicalize().map_err(|error| Failure::Input(format!("{}: {error}", api.display())))?;
    let name = arguments.id.rsplit('/').next().unwrap_or(&arguments.id);
    let folder = arguments.path.clone().unwrap_or_else(|| name.into());
    let texts = files(arguments, name, &api).map_err(|error| Failure::Run(format!("{error:#}")))?;
    create(&folder)?;
    let write = |(file, text): &(&str, String)| write_in_folder(&folder.join(file), text.as_bytes());
    if let Err(error) = texts.iter().try_for_each(write) {
        // It was made a moment ago, and is of no use without all of its files.
        fs::remove_dir_all(&folder).ok();
        return Err(Failure::Run(format!("{error:#}")));
    }
    let build = if arguments.language == Language::Rust { "cargo build --release" } else { "make" };
    let library = library(arguments.language, name);
    let folder = folder.display();
    output::note(format_args!("Made {folder}. Next:\n  cd {folder} && {build}"));
    output::note(format_args!("  shield plugin check {library}"));
    output::note(format_args!("  shield run experiment.ron"));
    Ok(())
}

/// Makes the folder. It must be new, so that no file in it is anybody else's.
fn create(folder: &Path) -> Result<(), Failure> {
    let parents = folder.parent().map_or(Ok(()), fs::create_dir_all);
    parents.and_then(|()| fs::create_dir(folder)).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => {
            Failure::Input(format!("{} exists already; --path <folder> makes another", folder.display()))
        }
        _ => Failure::Run(format!("{} cannot be made: {error}", folder.display())),
    })
}

/// The files of the folder with their texts.
fn files(
    arguments: &NewArguments,
    name: &str,
    api: &Path,
) -> Result<Vec<(&'static str, String)>, minijinja::Error> {
    let (kind, table) = (arguments.kind.name(), arguments.kind.table());
    let author = env::var("USER").unwrap_or_else(|_| "unknown".into());
    let values = Values {
        id: arguments.id.clone(),
        name: name.into(),
        type_name: type_name(name),
        kind: kind.into(),
        entry: kind.replace('-', "_"),
        constant: kind.replace('-', "_").to_uppercase(),
        place: table.replace('-', "_"),
        table: type_name(table),
        author: author.replace(['"', '\\'], ""),
        library: library(arguments.language, name),
        api: api.display().to_string(),
    };
    let source = |folder: &str, ending: &str| format!("{folder}/{kind}.{ending}");
    let own = match arguments.language {
        Language::Rust => [
            ("Cargo.toml", "rust/Cargo.toml".into()),
            ("src/lib.rs", source("rust", "rs")),
            ("README.md", "rust/README.md".into()),
            (".gitignore", "rust/gitignore".into()),
        ],
        Language::C => [
            ("Makefile", "c/Makefile".into()),
            ("plugin.c", source("c", "c")),
            ("README.md", "c/README.md".into()),
            (".gitignore", "c/gitignore".into()),
        ],
    };
    let templates = templates()?;
    let experiment = ("experiment.ron", "experiment.ron".into());
    own.into_iter()
        .chain([experiment])
        .map(|(file, template)| Ok((file, templates.get_template(&template)?.render(&values)?)))
        .collect()
}

/// The library that the folder builds, as seen from the folder.
fn library(language: Language, name: &str) -> String {
    let file = format!("lib{}{}", name.replace('-', "_"), env::consts::DLL_SUFFIX);
    if language == Language::Rust { format!("target/release/{file}") } else { file }
}

/// `my-rule` as `MyRule`.
fn type_name(name: &str) -> String {
    let capital = |word: &str| {
        let mut letters = word.chars();
        letters
            .next()
            .map(|first| first.to_uppercase().chain(letters).collect::<String>())
            .unwrap_or_default()
    };
    name.split(['-', '_']).map(capital).collect()
}

fn check_id(id: &str) -> Result<(), String> {
    let is_part = |part: &str| {
        part.starts_with(|first: char| first.is_ascii_lowercase())
            && part
                .chars()
                .all(|letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || "-_".contains(letter))
    };
    let parts: Vec<&str> = id.split('/').collect();
    if parts.len() <= 2 && parts.iter().all(|part| is_part(part)) {
        return Ok(());
    }
    Err(format!(
        "{id:?} cannot be an id: it takes small letters, digits, `-` and `_`, begins with a letter, and has at most one `/` after \
         your name, as in acme/my-rule"
    ))
}

/// In the archive of `cargo xtask dist` the packaged interface lies beside the program, in the source tree above `target/`.
fn api_beside_program() -> Option<PathBuf> {
    let program = env::current_exe().and_then(|path| path.canonicalize()).ok()?;
    program.ancestors().skip(1).map(|folder| folder.join("shield-api")).find(|folder| is_api(folder))
}

fn is_api(folder: &Path) -> bool {
    folder.join("Cargo.toml").is_file() && folder.join("include/shield_plugin.h").is_file()
}

fn not_an_api(folder: &Path) -> Failure {
    let message = "is not the folder of shield-api: it has no Cargo.toml and include/shield_plugin.h";
    Failure::Input(format!("{} {message}", folder.display()))
}

fn no_api() -> Failure {
    Failure::Input("shield-api is not beside this program; --api <folder> says where it is".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_a_valid_name_of_a_crate_and_a_file() {
        for good in ["a", "acme/my-rule", "a1/b_2"] {
            assert_eq!(check_id(good), Ok(()));
        }
        for bad in ["", "/a", "a/", "a/b/c", "A", "1a", "a b", "../a", "a.b", "ä"] {
            assert!(check_id(bad).is_err(), "{bad}");
        }
        assert_eq!(type_name("my-second_rule"), "MySecondRule");
    }
}
