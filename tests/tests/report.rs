//! `shield report`, and records of runs.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{fs, path::Path};

use serde_json::Value;
use shield_runtime::{
    experiment::ExperimentFile,
    plugin::{Registry, SearchPath},
    report::FIGURE_NAMES,
    run::{RunFolder, prepare},
};
use shield_tests::{call, cart, gridworld, plugins_folder, workspace};
use tempfile::TempDir;

const VARIANTS: &str = r#"variants: {"q-0.4": [], "q-0": [("shield.rules[0].config.q_min", 0.0)], "status-quo": [("mode", StatusQuo)]},"#;

fn done(folder: &Path, arguments: &[&str]) -> String {
    let output = call(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A folder in which three variants ran with two seeds.
fn ran() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), gridworld(1_000, VARIANTS)).unwrap();
    let said = done(folder.path(), &["run", "x.ron", "--record", "none.json"]);
    assert!(said.contains("none.json does not exist yet"), "{said}");
    folder
}

fn record(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn the_page_is_complete_and_self_contained() {
    let folder = ran();
    done(folder.path(), &["report", "runs/small", "--png", "png", "--svg", "svg", "--prefix", "a-"]);
    let page = fs::read_to_string(folder.path().join("runs/small/report.html")).unwrap();
    for part in [
        "<td>q-0</td><td>2</td>",
        "<td>status-quo</td>",
        "<code>shield.rules[0].config.q_min</code>",
        "<code>mode</code>",
        "tabular-q",
        "Hard resets of a whole run",
        "id=\"where-q-0.4\"",
    ] {
        assert!(page.contains(part), "{part} is missing");
    }
    let places = page.matches("http://").count() - page.matches("http://www.w3.org/2000/svg").count();
    assert_eq!((places, page.matches("https://").count()), (0, 0), "the page names another place");
    let q_0 = page.find("<td>q-0</td>").unwrap();
    assert!(q_0 < page.find("<td>q-0.4</td>").unwrap(), "variants are in natural order");
    for entry in fs::read_dir(folder.path().join("png")).unwrap() {
        let file = entry.unwrap().file_name().into_string().unwrap();
        let name = file.strip_prefix("a-").unwrap().strip_suffix(".png").unwrap();
        assert!(FIGURE_NAMES.contains(&name) || name.starts_with("where-"), "{name} cannot be chosen");
    }
    for name in ["return", "hard-resets", "final-hard-resets", "lifetime-reward", "where-q-0.4"] {
        let png = fs::read(folder.path().join(format!("png/a-{name}.png"))).unwrap();
        assert!(png.starts_with(b"\x89PNG"), "{name}");
        let svg = fs::read_to_string(folder.path().join(format!("svg/a-{name}.svg"))).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{name}");
    }
}

#[test]
fn a_report_of_a_record_equals_that_of_its_runs() {
    let folder = ran();
    done(folder.path(), &["report", "runs/small", "--record", "kept.json"]);
    done(folder.path(), &["report", "kept.json", "--out", "again.html"]);
    let [first, again] =
        ["runs/small/report.html", "again.html"].map(|name| fs::read(folder.path().join(name)).unwrap());
    assert!(first == again);
    let record = record(&folder.path().join("kept.json"));
    let names = record["variants"].as_array().unwrap().iter().map(|variant| &variant["name"]);
    assert!(names.eq(["q-0", "q-0.4", "status-quo"]));
    let run = &record["variants"][0]["runs"][0];
    assert_eq!((&run["seed"], &run["summary"]["steps"]), (&0.into(), &1_000.into()));
    let course = &run["course"];
    assert_eq!(course["step"].as_array().unwrap().len(), 50);
    assert_eq!(course["hard_resets"][49], run["summary"]["hard_resets"]);
}

#[test]
fn variants_and_figures_can_be_chosen() {
    let folder = ran();
    let chosen = ["--variants", "status-quo,q-0", "--figures", "hard-resets,success", "--out", "x.html"];
    done(folder.path(), &[&["report", "runs/small"], &chosen[..]].concat());
    let page = fs::read_to_string(folder.path().join("x.html")).unwrap();
    assert!(page.find("<td>status-quo</td>").unwrap() < page.find("<td>q-0</td>").unwrap());
    assert!(!page.contains("<td>q-0.4</td>"));
    assert!(page.contains("id=\"hard-resets\"") && !page.contains("id=\"lifetime-reward\""));
    for (arguments, expected) in [
        (["--variants", "q-1"], "there is no variant q-1; there are: q-0, q-0.4, status-quo"),
        (["--figures", "smoke"], "there is no figure smoke; there are: "),
    ] {
        let output = call(folder.path(), &[&["report", "runs/small"], &arguments[..]].concat());
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && message.contains(expected), "{message}");
    }
    // A threshold of 0 aborts nothing.
    let arguments = ["report", "runs/small", "--out", "none.html", "--figures", "where-q-0"];
    let output = call(folder.path(), &arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && message.contains("where-q-0.4"), "{message}");
    assert!(!folder.path().join("none.html").exists());
}

#[test]
fn dimensions_can_be_chosen_and_unknown_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), cart(1_000, "")).unwrap();
    done(folder.path(), &["run", "x.ron", "--set", "shield.rules[0].config.q_min=1000"]);
    done(folder.path(), &["report", "runs/cart", "--dimensions", "2,0", "--record", "kept.json"]);
    let record = record(&folder.path().join("kept.json"));
    let points = &record["variants"][0]["runs"][0]["aborts"]["Points"];
    assert_eq!(points["dimensions"], serde_json::json!([2, 0]));
    let page = fs::read_to_string(folder.path().join("runs/cart/report.html")).unwrap();
    for axis in ["dimension 2 of the observation", "dimension 0 of the observation"] {
        assert!(page.contains(axis), "the heat map does not say that it shows {axis}");
    }
    for (source, dimensions, expected) in [
        ("runs/cart", "0,99", "there is no 99"),
        ("runs/cart", "0", "two numbers"),
        ("kept.json", "0,1", "a record keeps the dimensions"),
    ] {
        let output = call(folder.path(), &["report", source, "--dimensions", dimensions]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && message.contains(expected), "{message}");
    }
}

#[test]
fn a_report_without_a_finished_run_says_why() {
    let folder = ran();
    for run in RunFolder::find(&folder.path().join("runs")).unwrap() {
        let path = run.path().join("summary.json");
        let mut summary = record(&path);
        (summary["complete"], summary["error"]) = (false.into(), "the arm fell off".into());
        fs::write(path, summary.to_string()).unwrap();
    }
    let output = call(folder.path(), &["report", "runs/small"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(message.contains("runs/small/q-0/seed-0 failed: the arm fell off"), "{message}");
}

#[test]
fn a_recorded_run_is_repeated_only_after_a_change() {
    let folder = ran();
    done(folder.path(), &["report", "runs/small", "--record", "kept.json"]);
    let output = call(folder.path(), &["run", "x.ron", "--out", "elsewhere", "--record", "kept.json"]);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(printed.contains("Every run is recorded in kept.json."), "{printed}");
    assert!(!folder.path().join("elsewhere").exists(), "all were recorded");

    let more = ["--variants", "q-0", "--seeds", "0,7"];
    done(
        folder.path(),
        &[&["run", "x.ron", "--out", "elsewhere", "--record", "kept.json"], &more[..]].concat(),
    );
    let made = |name: &str| folder.path().join("elsewhere/small").join(name).exists();
    assert!(made("q-0/seed-7") && !made("q-0/seed-0"));

    // What was recorded by another version, or with other settings, is no longer true.
    let kept = fs::read_to_string(folder.path().join("kept.json")).unwrap();
    let version = |text: &str| text.replacen("\"version\":\"1.0.0\"", "\"version\":\"0.9.0\"", 1);
    assert_ne!(kept, version(&kept));
    fs::write(folder.path().join("old.json"), version(&kept)).unwrap();
    done(folder.path(), &["run", "x.ron", "--out", "old", "--record", "old.json"]);
    assert!(folder.path().join("old/small/q-0/seed-0").exists());
    let changed = ["--set", "forward.config.epsilon=0.2", "--variants", "q-0", "--seeds", "0"];
    done(
        folder.path(),
        &[&["run", "x.ron", "--out", "changed", "--record", "kept.json"], &changed[..]].concat(),
    );
    assert!(folder.path().join("changed/small/q-0/seed-0").exists());
}

#[test]
fn the_lifetime_return_is_the_same_in_every_file() {
    let folder = ran();
    let mut lifetimes = Vec::new();
    for run in RunFolder::find(&folder.path().join("runs")).unwrap() {
        let column = |file: &str, name: &str| -> Vec<f64> {
            let mut table = csv::Reader::from_path(run.path().join(file)).unwrap();
            let at = table.headers().unwrap().iter().position(|heading| heading == name).unwrap();
            table.records().map(|row| row.unwrap()[at].parse().unwrap()).collect()
        };
        let summary: Value = record(&run.path().join("summary.json"));
        let lifetime = summary["lifetime_return"].as_f64().unwrap();
        let sum: f64 = column("metrics.csv", "forward_return").iter().sum();
        assert_eq!(lifetime, sum);
        assert_eq!(lifetime, *column("metrics.csv", "lifetime_return").last().unwrap());
        assert_eq!(lifetime, *column("evaluations.csv", "lifetime_return").last().unwrap());
        let resets = column("evaluations.csv", "hard_resets");
        assert_eq!(*resets.last().unwrap(), summary["hard_resets"].as_f64().unwrap());
        assert!(resets.is_sorted());
        lifetimes.push(lifetime);
    }
    assert_eq!(lifetimes.len(), 6);
    assert!(lifetimes.iter().any(|lifetime| *lifetime > 0.0), "the goal was never reached");
}

#[test]
fn the_experiments_that_are_reproduced_are_valid_and_named_as_their_files() {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let mut count = 0;
    let folders = ["examples/paper", "examples/untouched"].map(|folder| workspace().join(folder));
    for entry in folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap()) {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "ron") {
            continue;
        }
        let variants = ExperimentFile::read(&path).and_then(|file| file.variants(&[], None)).unwrap();
        let name = path.file_stem().unwrap().to_str().unwrap();
        assert_eq!(variants[0].experiment.name, name);
        count += 1;
        // The others have networks of which one takes as much memory as all tests together.
        let is_small =
            name.ends_with("-small") || name.starts_with("gridworld") || path.starts_with(&folders[1]);
        if is_small {
            for variant in &variants {
                if let Err(error) = prepare(&registry, variant, 0) {
                    panic!("{name}, {}: {error}", variant.name);
                }
            }
        }
    }
    assert!(count > 0);
}
