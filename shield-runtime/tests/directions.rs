//! Which module may use which, until each group of modules is a crate of its own and the compiler says so.
#![allow(clippy::unwrap_used, reason = "a test")]

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

struct Group {
    name: &'static str,
    modules: &'static [&'static str],
    /// The groups on which it may build.
    below: &'static [&'static str],
}

/// The future crates; the program, `cli`, uses all of them from outside.
const GROUPS: [Group; 6] = [
    Group {
        name: "core",
        modules: &[
            "agent",
            "decision",
            "drop_in",
            "experience",
            "plugin_state",
            "record",
            "settings",
            "shield",
            "shielded",
            "world",
        ],
        below: &[],
    },
    Group { name: "host", modules: &["plugin"], below: &[] },
    Group { name: "config", modules: &["experiment", "workshop"], below: &["core", "host"] },
    Group {
        name: "lab",
        modules: &[
            "batch",
            "checkpoint",
            "drop_in_files",
            "evaluation",
            "joint_loop",
            "loop_state",
            "observer",
            "run",
        ],
        below: &["core", "host", "config"],
    },
    Group { name: "report", modules: &["film", "report"], below: &["core", "host", "config", "lab"] },
    Group {
        name: "check",
        modules: &["allocations_ffi", "environment_check", "plugin_bench", "plugin_check"],
        below: &["host"],
    },
];

/// Names of what the core does without: files, configuration texts and libraries that are loaded.
const FOREIGN_TO_CORE: [&str; 8] =
    ["fs", "File", "Path", "PathBuf", "ron", "RawValue", "libloading", "Registry"];

/// A file of the library.
struct Source {
    path: PathBuf,
    /// The module at the top to which it belongs.
    module: String,
    /// Without lines that are comments.
    code: String,
}

fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    find(&root, &mut paths);
    let mut sources = Vec::new();
    for path in paths {
        let inside = path.strip_prefix(&root).unwrap();
        let module = inside.iter().next().unwrap().to_str().unwrap().trim_end_matches(".rs").to_owned();
        if ["lib", "main", "cli"].contains(&module.as_str()) {
            continue;
        }
        let text = fs::read_to_string(&path).unwrap();
        let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        let code = lines.collect::<Vec<_>>().join("\n");
        sources.push(Source { path: inside.to_owned(), module, code });
    }
    sources
}

fn find(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            find(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

fn group_of(module: &str) -> &'static Group {
    let group = GROUPS.iter().find(|group| group.modules.contains(&module));
    group.unwrap_or_else(|| panic!("the module {module} belongs to no group"))
}

/// The modules at the top that `code` names: behind each `crate::` one, or several in braces.
fn named(code: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (at, prefix) in code.match_indices("crate::") {
        let rest = &code[at + prefix.len()..];
        match rest.strip_prefix('{') {
            Some(list) => found.extend(first_words(list)),
            None => {
                found.insert(first_word(rest));
            }
        }
    }
    found
}

/// Of each entry of a list, up to the brace that closes it.
fn first_words(list: &str) -> Vec<String> {
    let (mut depth, mut words) = (0_i32, vec![first_word(list)]);
    for (at, character) in list.char_indices() {
        match character {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => words.push(first_word(&list[at + 1..])),
            _ => {}
        }
        if depth < 0 {
            break;
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

fn first_word(text: &str) -> String {
    text.trim_start().chars().take_while(|character| is_of_a_word(*character)).collect()
}

fn is_of_a_word(character: char) -> bool {
    character.is_alphanumeric() || character == '_'
}

#[test]
fn every_module_uses_only_what_lies_below_it() {
    let mut faults = Vec::new();
    for Source { path, module, code } in sources() {
        let own = group_of(&module);
        for used in named(&code) {
            let group = group_of(&used);
            if group.name != own.name && !own.below.contains(&group.name) {
                faults.push(format!("{} ({}) uses {used} ({})", path.display(), own.name, group.name));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn the_core_knows_no_file_no_configuration_text_and_no_library() {
    for Source { path, module, code } in sources() {
        if group_of(&module).name != "core" {
            continue;
        }
        let mut words = code.split(|character| !is_of_a_word(character));
        let foreign = words.find(|word| FOREIGN_TO_CORE.contains(word));
        assert_eq!(foreign, None, "{}", path.display());
    }
}

#[test]
fn imports_are_read_whatever_their_form() {
    let code = "use crate::{\n    agent::{self, Agent},\n    world::World,\n};\nlet at = crate::run::find();\nuse crate::shield;";
    let expected = ["agent", "run", "shield", "world"].map(str::to_owned);
    assert_eq!(named(code), BTreeSet::from(expected));
}

#[test]
fn every_module_of_the_library_has_a_place_and_every_place_a_module() {
    let found: BTreeSet<String> = sources().into_iter().map(|source| source.module).collect();
    let placed: BTreeSet<String> =
        GROUPS.iter().flat_map(|group| group.modules).map(|module| (*module).to_owned()).collect();
    assert_eq!(found, placed);
}
