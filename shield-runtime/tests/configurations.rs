//! What is wrong with a configuration is said with its place, whatever is wrong: no depth, length or repetition ends a reader.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use rand::{Rng, RngExt, SeedableRng, seq::IndexedRandom};
use rand_pcg::Pcg64;
use shield_runtime::experiment::{
    DropInFile, ExperimentFile, InputError, Location, Override, RonText, differences,
};

/// Every file under `folder` whose name ends so, in the order of their names.
fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path, ending));
        } else if path.to_str().unwrap().ends_with(ending) {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples")
}

/// The fault stands inside `text`.
fn is_inside(error: &InputError, text: &str) {
    let Location::File { position: Some(place), .. } = &error.location else {
        panic!("{error}: no place, in\n{text}");
    };
    let line = text.split('\n').nth(place.line as usize - 1).unwrap_or_else(|| panic!("{error} in\n{text}"));
    assert!((1..=line.chars().count() + 1).contains(&(place.column as usize)), "{error} in\n{text}");
    assert!(!error.message.is_empty());
}

/// Reads `text` as everything that it could be; returns how often it was refused.
fn read(text: &str) -> usize {
    let file = ExperimentFile::from_text("x.ron", text);
    let refused = [
        file.variants(&[], None).err(),
        DropInFile::from_text("x.ron", text, &[]).err(),
        file.with_pins(&[("a".into(), "b".into())]).err(),
    ];
    let refused: Vec<InputError> = refused.into_iter().flatten().collect();
    refused.iter().for_each(|error| is_inside(error, text));
    refused.len()
}

/// Changes a text a little, as a slip of the hand does.
fn slip(text: &str, rng: &mut impl Rng) -> String {
    const PIECES: [&str; 24] = [
        "(",
        ")",
        "[",
        "]",
        "{",
        "}",
        ",",
        ":",
        "\"",
        "'",
        "\\",
        "#",
        "/*",
        "*/",
        "//",
        "r#\"",
        "Some(",
        "None",
        "-",
        "1e999",
        "\u{e4}",
        "\u{200E}",
        "99999999999999999999",
        "config: ",
    ];
    let ends: Vec<usize> = text.char_indices().map(|(offset, _)| offset).chain([text.len()]).collect();
    let (mut start, mut end) = (*ends.choose(rng).unwrap(), *ends.choose(rng).unwrap());
    if start > end {
        (start, end) = (end, start);
    }
    let near = ends[(ends.binary_search(&start).unwrap() + rng.random_range(0..9)).min(ends.len() - 1)];
    let (before, part, after) = (&text[..start], &text[start..end], &text[end..]);
    match rng.random_range(0..6) {
        0 => before.to_owned(),
        1 => format!("{before}{}", &text[near..]),
        2 => format!("{before}{}{}", PIECES.choose(rng).unwrap(), &text[start..]),
        3 => format!("{before}{}{}", PIECES.choose(rng).unwrap(), &text[near..]),
        4 => format!("{before}{part}{part}{after}"),
        _ => format!("{before}{after}"),
    }
}

#[test]
fn every_slip_in_an_example_is_faulted_inside_the_file() {
    let mut rng = Pcg64::seed_from_u64(0);
    let (mut read_files, mut refused) = (0, 0);
    for path in files(&examples(), ".ron") {
        if path.ends_with("config.ron") {
            continue;
        }
        read_files += 1;
        let text = fs::read_to_string(&path).unwrap();
        for _ in 0..60 {
            let mut slipped = slip(&text, &mut rng);
            if rng.random_bool(0.3) {
                slipped = slip(&slipped, &mut rng);
            }
            refused += read(&slipped);
        }
    }
    assert!(read_files >= 30 && refused > 60 * read_files, "{refused} of {read_files} files");
}

#[test]
fn every_slip_in_an_override_is_faulted_with_its_argument() {
    let mut rng = Pcg64::seed_from_u64(1);
    let file = ExperimentFile::read(examples().join("quickstart.ron")).unwrap();
    let sets = [
        "shield.rules[0].config=(q_min: Some(0.5), combine: Quantile(0.5))",
        "variants={}",
        "evaluation=Some(every: 100, start: None)",
        "shield.rules=[Any([(plugin: \"a\"), Soft(priority: 1.0, rule: (plugin: \"b\"))])]",
        "reset.config.hidden[0].x.y=[1, 2]",
    ];
    let mut refused = 0;
    for _ in 0..2_000 {
        let slipped = slip(sets.choose(&mut rng).unwrap(), &mut rng);
        let read = Override::parse(&slipped).and_then(|set| file.variants(&[set], None));
        if let Err(error) = read {
            refused += 1;
            let is_placed = match &error.location {
                Location::Argument(argument) => argument.contains(&slipped),
                Location::File { position, .. } => position.is_some(),
            };
            assert!(is_placed, "{error}");
        }
    }
    assert!(refused > 1_000, "{refused}");
}

const SMALL: &str = r#"(name: "x", steps: 10, seeds: [0], mode: ForwardOnly, environment: (plugin: "e", config: @C), forward: Policy(plugin: "p")@F)"#;

fn small(config: &str, fields: &str) -> String {
    SMALL.replace("@C", config).replace("@F", fields)
}

#[test]
fn no_depth_ends_a_reader() {
    for levels in [100, 200, 3_901, 10_073, 200_000] {
        let deep = |open: &str, close: &str| format!("{}{}", open.repeat(levels), close.repeat(levels));
        for (open, close) in
            [("All([", "])"), ("Some(", ")"), ("[", "]"), ("{1: ", "}"), ("(a: ", ")"), ("((", "))")]
        {
            let value = deep(open, close);
            for text in [
                value.clone(),
                open.repeat(levels),
                small(&value, ""),
                small("()", &format!(", shield: (rules: [{value}])")),
                small("()", &format!(", variants: {{\"a\": [(\"environment.config\", {value})]}}")),
                small("()", &format!(", x: /*{}*/ 1", "/*".repeat(levels))),
            ] {
                assert!(read(&text) >= 1, "{levels} {open}");
            }
            let set = Override::parse(&format!("environment.config={value}"));
            let refused = set
                .and_then(|set| ExperimentFile::from_text("x.ron", small("()", "")).variants(&[set], None));
            assert!(refused.is_err() || levels == 100, "{levels} {open}");
            assert!(levels == 100 || RonText::new(value.as_str()).is_err());
            assert!(!differences(&value, "()").is_empty());
        }
        let path = format!("environment.config{}=1", ".a".repeat(levels));
        let set = Override::parse(&path).unwrap();
        let error = ExperimentFile::from_text("x.ron", small("()", "")).variants(&[set], None);
        assert_eq!(error.is_err(), levels > 100);
    }
}

#[test]
fn a_hundred_overrides_of_a_hundred_levels_are_refused_as_one_of_many_is() {
    let sets: Vec<Override> = (0..100)
        .map(|depth| {
            let path = format!("environment.config{}", ".a".repeat(depth));
            Override::parse(&format!("{path}={}1{}", "Some(a: ".repeat(60), ")".repeat(60))).unwrap()
        })
        .collect();
    let error = ExperimentFile::from_text("x.ron", small("()", "")).variants(&sets, None).unwrap_err();
    assert!(error.to_string().contains("more than 128 brackets"), "{error}");
}

#[test]
fn no_repetition_ends_a_reader() {
    let many = |piece: &str| piece.repeat(300_000 / piece.len());
    let numbered = |piece: fn(usize) -> String| (0..20_000).map(piece).collect::<String>();
    for fields in [
        format!(", seeds: [{}]", numbered(|index| format!("{index},"))),
        format!(", threads: 1{}", many(", threads: 1")),
        format!(", pins: {{{}}}", numbered(|index| format!("\"p{index}\": \"0\","))),
        format!(", variants: {{{}}}", numbered(|index| format!("\"v{index}\": [],"))),
        format!(", variants: {{\"a\": [{}]}}", many("(\"steps\", 1),")),
        format!(", shield: (rules: [{}])", many("(plugin: \"r\"),")),
        format!(", {}: 1", many("a")),
        format!(", mode: {}", many("a")),
        format!(", mode: \"{}\"", many("a")),
        format!(", threads: {}", many("9")),
        format!(", hard_reset_cost: {}.0", many("9")),
        format!(", name{}: 1", many(" ")),
        many("#"),
        many("\""),
        many("\\"),
        many("r#"),
        many("//"),
    ] {
        assert!(read(&small("()", &fields)) >= 1, "{}", &fields[..30]);
    }
    let long = " ".repeat(5 << 20);
    assert_eq!(read(&long), 3);
}

#[test]
fn too_many_variants_and_overrides_are_refused_where_the_first_of_them_stands() {
    let variants: String = (0..=1_000).map(|index| format!("\"v{index}\": [],\n")).collect();
    let text = small("()", &format!(", variants: {{\n{variants}}}"));
    let error = ExperimentFile::from_text("x.ron", text).variants(&[], None).unwrap_err();
    assert_eq!(error.to_string(), "x.ron:1002:1: there are 1001 variants; at most 1000 are read");
    let sets = vec![Override::parse("steps=5").unwrap(); 1_001];
    let error = ExperimentFile::from_text("x.ron", small("()", "")).variants(&sets, None).unwrap_err();
    assert_eq!(
        error.to_string(),
        "--set steps=5: override `steps`: there are 1001 overrides; at most 1000 are read"
    );
}

/// A run that goes on compares the text of its configuration with the recorded one. Records may be older than some fields.
#[test]
fn a_configuration_that_was_recorded_is_written_again_line_by_line() {
    let recorded = files(&examples(), "config.ron");
    assert!(recorded.len() >= 60, "{}", recorded.len());
    for path in recorded {
        let text = fs::read_to_string(&path).unwrap();
        let variants = ExperimentFile::from_text(&path, text.clone()).variants(&[], None).unwrap();
        let written = variants[0].resolved_ron(variants[0].experiment.seeds[0], &|_| Vec::new());
        let mut lines = written.lines();
        for line in text.lines().skip(1) {
            assert!(lines.any(|found| found == line), "{}: {line} is not in {written}", path.display());
        }
        let again = ExperimentFile::from_text(&path, written.clone()).variants(&[], None).unwrap().remove(0);
        assert_eq!(again.resolved_ron(again.experiment.seeds[0], &|_| Vec::new()), written);
    }
}
