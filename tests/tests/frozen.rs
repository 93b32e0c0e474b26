//! The binary tables are frozen for all of 1.x: every struct with its fields, their order, types and places, and every constant.
#![allow(clippy::unwrap_used, reason = "a test")]

use std::{collections::BTreeMap, env, fmt::Write as _, fs, path::Path};

use quote::ToTokens;
use shield_api::abi;
use syn::{Attribute, Item, ItemConst, ItemStruct, Type};

/// Set it to 1 to write down what is new. What is written down already is never changed.
const WRITE: &str = "SHIELD_WRITE_TABLES";
/// They grow with every minor version.
const GROWING: [&str; 2] = ["ABI_MINOR", "ABI_VERSION"];

/// One line per field or constant, under the name of its struct or constant.
type Frozen = BTreeMap<String, String>;

/// Size and alignment in bytes on a machine of 64 bits.
type Extent = (usize, usize);

fn text(tokens: &impl ToTokens) -> String {
    let words = tokens.to_token_stream().to_string();
    let text: String = words.split_whitespace().collect::<Vec<_>>().join(" ");
    [(" :", ":"), ("* ", "*"), (" ,", ","), ("( ", "("), (" )", ")"), (" (", "("), (" ;", ";"), (",)", ")")]
        .iter()
        .fold(text, |text, (from, to)| text.replace(from, to))
}

fn extent(kind: &Type, known: &BTreeMap<String, Extent>) -> Extent {
    match kind {
        Type::Ptr(_) | Type::BareFn(_) | Type::Reference(_) => (8, 8),
        Type::Path(path) => match path.path.segments.last().unwrap().ident.to_string().as_str() {
            "u8" => (1, 1),
            "u32" | "i32" | "f32" => (4, 4),
            "u64" | "f64" | "usize" => (8, 8),
            name => known[name],
        },
        other => panic!("{}: a type that C does not know", text(other)),
    }
}

fn is_for_c(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| text(attribute) == "# [repr(C)]")
}

/// The struct as text, with the place of each field. Its extent is added to `known`.
fn structure(item: &ItemStruct, known: &mut BTreeMap<String, Extent>) -> String {
    let name = item.ident.to_string();
    assert!(is_for_c(&item.attrs), "{name} is not `repr(C)`");
    let (mut end, mut widest, mut lines) = (0, 1, String::new());
    for field in &item.fields {
        let (size, alignment) = extent(&field.ty, known);
        let place = usize::next_multiple_of(end, alignment);
        writeln!(lines, "    {place:>3} {}: {}", field.ident.as_ref().unwrap(), text(&field.ty)).unwrap();
        (end, widest) = (place + size, widest.max(alignment));
    }
    let size = end.next_multiple_of(widest);
    known.insert(name.clone(), (size, widest));
    format!("struct {name}, {size} bytes\n{lines}")
}

fn constant(scope: &str, item: &ItemConst) -> (String, String) {
    let name = format!("{scope}{}", item.ident);
    (name.clone(), format!("const {name}: {} = {}\n", text(&item.ty), text(&item.expr)))
}

/// What `abi.rs` says, and the extent of each struct.
fn tables() -> (Frozen, BTreeMap<String, Extent>) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shield-api/src/abi.rs");
    let (mut found, mut known) = (Frozen::new(), BTreeMap::new());
    for item in syn::parse_file(&fs::read_to_string(source).unwrap()).unwrap().items {
        match item {
            Item::Struct(item) => {
                let lines = structure(&item, &mut known);
                found.insert(item.ident.to_string(), lines);
            }
            Item::Const(item) if !GROWING.contains(&item.ident.to_string().as_str()) => {
                found.extend([constant("", &item)]);
            }
            Item::Mod(module) if module.ident != "tests" => {
                for item in module.content.into_iter().flat_map(|(_, items)| items) {
                    let Item::Const(item) = item else { panic!("{}: not a constant", module.ident) };
                    found.extend([constant(&format!("{}::", module.ident), &item)]);
                }
            }
            _ => {}
        }
    }
    (found, known)
}

/// The name of an entry is its second word.
fn read(text: &str) -> Frozen {
    let entries = text.split("\n\n").filter(|entry| !entry.trim().is_empty());
    entries
        .map(|entry| {
            let name = entry.split_whitespace().nth(1).unwrap().trim_end_matches([',', ':']);
            (name.to_owned(), format!("{}\n", entry.trim_end()))
        })
        .collect()
}

#[test]
fn released_tables_are_unchanged() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/kept/tables.txt");
    let (found, _) = tables();
    let mut frozen = read(&fs::read_to_string(&path).unwrap_or_default());
    for (name, before) in &frozen {
        let now = found.get(name).map_or("nothing of that name", String::as_str);
        assert!(
            now == before,
            "`{name}` of shield-api/src/abi.rs is frozen for all of 1.x, since libraries that were built with 1.0.0 lie in users' folders and \
             must load and run. Undo the change: a new ability is an extension, a table of its own that is found by its name.\n\
             frozen:\n{before}\nnow:\n{now}"
        );
    }
    let new: Vec<&String> = found.keys().filter(|name| !frozen.contains_key(*name)).collect();
    if env::var_os(WRITE).is_some() {
        frozen = found;
        let entries: Vec<&str> = frozen.values().map(String::as_str).collect();
        fs::write(&path, entries.join("\n")).unwrap();
        return;
    }
    assert!(
        new.is_empty(),
        "{new:?} are new. An extension is frozen with its release, as all tables are: look at each field once more, then write it down \
         with `{WRITE}=1 cargo test -p shield-tests --test frozen`"
    );
}

/// The places that are written down are those that the compiler gives.
#[test]
#[cfg(target_pointer_width = "64")]
fn the_recorded_places_of_fields_are_those_of_the_compiler() {
    let (_, extents) = tables();
    macro_rules! check {
        ($($table:ident { $last:ident }),* $(,)?) => { $(
            let (size, alignment) = extents[stringify!($table)];
            assert_eq!(size, size_of::<abi::$table>(), stringify!($table));
            assert_eq!(alignment, align_of::<abi::$table>(), stringify!($table));
            let frozen = &tables().0[stringify!($table)];
            let place = format!("{:>3} {}:", std::mem::offset_of!(abi::$table, $last), stringify!($last));
            assert!(frozen.contains(&place), "{place} is not in {frozen}");
        )* };
    }
    check! {
        CreateArguments { host }, SpecView { brings_reset_reward }, StepView { flags }, BatchView { masks },
        RuleContextView { phase }, VerdictView { reason_length }, ObservedDecisionView { aborted }, HostTable { get_extension },
        EnvironmentTable { step }, LearnerTable { update }, PolicyTable { act }, AbortRuleTable { observe },
        ResetTaskTable { observe_start }, WeightsTable { policy }, PluginDescriptor { reset_task }, PluginLibrary { plugins },
        AttemptBatchView { masks }, SuccessCriticTable { update }, UndoView { start_probabilities }, ObservedAttemptView { succeeded },
        UndoRuleTable { observe_attempt },
    }
}
