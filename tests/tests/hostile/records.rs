//! `shield report` of records and runs that somebody sent.

use std::{
    fs,
    os::unix::{fs::PermissionsExt, process::ExitStatusExt},
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::{Value, json};
use shield_tests::{call, gridworld, shield, workspace};
use tempfile::TempDir;

use crate::{first_run, limits_ffi::without_processes, ran, refused, said};

/// Where a library or program that was executed leaves a file.
const MARKER: &str = "executed";

/// A folder with runs in a gridworld, and their record.
fn recorded() -> (TempDir, Value) {
    let folder = ran(&gridworld(1_000, ""), &[]);
    let output = call(folder.path(), &["report", "runs/small", "--record", "kept.json"]);
    assert!(output.status.success(), "{}", said(&output));
    let record = serde_json::from_slice(&fs::read(folder.path().join("kept.json")).unwrap()).unwrap();
    (folder, record)
}

/// Reports `source`. A process that is started kills the program.
fn report(folder: &Path, source: &str, arguments: &[&str]) -> Output {
    let mut command = shield();
    command.current_dir(folder).args(["report", source]).args(arguments);
    command.env("SHIELD_WORKER", folder.join("evil.sh")).env("SHIELD_TEST_MARKER", folder.join(MARKER));
    without_processes(&mut command).output().unwrap()
}

fn report_of(folder: &Path, record: &Value, arguments: &[&str]) -> Output {
    fs::write(folder.join("sent.json"), record.to_string()).unwrap();
    report(folder, "sent.json", arguments)
}

/// A library and a program that each leave a file behind when something of them is executed.
fn evil(folder: &Path) -> [PathBuf; 2] {
    let (source, library, program) =
        (folder.join("evil.c"), folder.join("libevil.so"), folder.join("evil.sh"));
    let text = "#include <stdio.h>\n#include <stdlib.h>\n\
        __attribute__((constructor)) static void run(void) { fclose(fopen(getenv(\"SHIELD_TEST_MARKER\"), \"w\")); }\n";
    fs::write(&source, text).unwrap();
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c11", "-fPIC", "-shared", "-o"]).arg(&library).arg(&source);
    compiler.arg("-I").arg(workspace().join("shield-api/include"));
    compiler.arg(workspace().join("tests/fixtures/c/rule.c")).arg("-lm");
    assert!(compiler.status().unwrap().success());
    fs::write(&program, "#!/bin/sh\n: > \"$SHIELD_TEST_MARKER\"\n").unwrap();
    fs::set_permissions(&program, PermissionsExt::from_mode(0o755)).unwrap();
    [library, program]
}

/// The configuration with a plugin's fields in place of the `index`-th plugin's id and path.
fn with_plugin(config: &str, index: usize, fields: &str) -> String {
    let (start, _) = config.match_indices("plugin:").nth(index).unwrap();
    let length = config[start..].find("path: None,").unwrap() + "path: None,".len();
    format!("{}{fields}{}", &config[..start], &config[start + length..])
}

/// Which of [`evil_configurations`] has an isolated plugin.
const ISOLATED: usize = 6;

/// Configurations of which something would be executed, if a report made what they name.
fn evil_configurations(config: &str, folder: &Path) -> Vec<(String, bool)> {
    let [library, program] = evil(folder);
    let named = |id: &str| format!("plugin: {id:?}, path: {library:?},");
    let task = format!("reset_task: (plugin: \"c/gentle\", path: {library:?}),");
    let gridworld = "plugin: \"gridworld\", path: None, config: (map: \"south-east\", horizon: None)";
    assert!(config.contains(gridworld), "{config}");
    let gymnasium = format!("plugin: \"gymnasium\", config: (id: \"CartPole-v1\", python: {program:?})");
    let python = config.replacen(gridworld, &gymnasium, 1);
    let isolated = with_plugin(config, 0, "plugin: \"gridworld\", isolate: true,");
    vec![
        (with_plugin(config, 0, &named("c/gentle")), false),
        (with_plugin(config, 0, &named("gridworld")), true),
        (with_plugin(config, 1, &named("tabular-q")), true),
        (with_plugin(config, 2, &named("tabular-q")), true),
        (with_plugin(config, 3, &named("c/gentle")), true),
        (config.replacen("reset_task: None,", &task, 1), true),
        (isolated, true),
        (python, false),
    ]
}

#[test]
fn a_report_executes_nothing_that_a_record_names() {
    let (folder, record) = recorded();
    let config = record["variants"][0]["config"].as_str().unwrap();
    for (index, (evil, is_drawn)) in evil_configurations(config, folder.path()).into_iter().enumerate() {
        let mut sent = record.clone();
        sent["variants"][0]["config"] = evil.into();
        let output = report_of(folder.path(), &sent, &[]);
        let message = said(&output);
        assert!(output.status.success(), "{index}: {:?}, {message}", output.status);
        assert!(!folder.path().join(MARKER).exists(), "{index}: something was executed");
        // Where its environment is ours, the picture is that of the environment on the search path.
        let page = fs::read_to_string(folder.path().join("sent.html")).unwrap();
        assert_eq!(page.contains("id=\"where-default\""), is_drawn, "{index}: {message}");
    }
}

#[test]
fn a_report_executes_nothing_that_the_configuration_of_a_run_names() {
    let (folder, _) = recorded();
    let files = [0, 1].map(|seed| folder.path().join(format!("runs/small/default/seed-{seed}/config.ron")));
    let configs = files.clone().map(|file| fs::read_to_string(file).unwrap());
    for index in 0..evil_configurations(&configs[0], folder.path()).len() {
        for (file, config) in files.iter().zip(&configs) {
            fs::write(file, &evil_configurations(config, folder.path())[index].0).unwrap();
        }
        let output = report(folder.path(), "runs/small", &["--record", "again.json"]);
        assert!(output.status.success(), "{index}: {}", said(&output));
        assert!(!folder.path().join(MARKER).exists(), "something was executed: {index}");
    }
}

#[test]
fn the_library_and_the_program_of_these_tests_would_show_that_they_were_executed() {
    let (folder, record) = recorded();
    let config = record["variants"][0]["config"].as_str().unwrap();
    let marker = folder.path().join(MARKER);
    for (index, (evil, _)) in evil_configurations(config, folder.path()).into_iter().enumerate() {
        fs::write(folder.path().join("evil.ron"), evil).unwrap();
        let mut command = shield();
        command.current_dir(folder.path()).args(["run", "evil.ron", "--out", "evil"]);
        command.env("SHIELD_WORKER", folder.path().join("evil.sh")).env("SHIELD_TEST_MARKER", &marker);
        let output = command.output().unwrap();
        assert!(fs::remove_file(&marker).is_ok(), "{index}: a run does not execute it: {}", said(&output));
        if index == ISOLATED {
            let status = without_processes(&mut command).status().unwrap();
            assert_eq!(status.signal(), Some(libc::SIGSYS), "a process was started");
        }
    }
}

#[test]
fn a_name_that_leads_out_of_a_folder_is_refused() {
    let (folder, record) = recorded();
    fs::create_dir(folder.path().join("inside")).unwrap();
    for name in ["x/../../escaped/evil", "../evil", "/tmp/evil", "..", "", "a\u{1b}[2J", "<script>", "a\0b"] {
        let (mut variant, mut experiment) = (record.clone(), record.clone());
        variant["variants"][0]["name"] = name.into();
        experiment["experiment"] = name.into();
        for sent in [variant, experiment] {
            let pictures = ["--svg", "inside/svg", "--png", "inside/png"];
            let output = report_of(&folder.path().join("inside"), &sent, &pictures);
            refused(&output, 2, &["sent.json is damaged", "cannot name a folder"]);
        }
    }
    let inside: Vec<_> = fs::read_dir(folder.path().join("inside")).unwrap().collect();
    assert_eq!(inside.len(), 1, "a refused record left something: {inside:?}");
    assert!(!folder.path().join("escaped").exists() && !folder.path().join("evil").exists());
}

#[test]
fn a_run_in_a_folder_whose_name_no_variant_can_have_is_refused() {
    let folder = ran(&gridworld(300, ""), &["--seeds", "0"]);
    fs::create_dir_all(folder.path().join("sent/<b>")).unwrap();
    fs::rename(first_run(folder.path()), folder.path().join("sent/<b>/seed-0")).unwrap();
    let output = call(folder.path(), &["report", "sent"]);
    refused(&output, 2, &["\"<b>\" cannot name a folder"]);
    assert!(!folder.path().join("sent/report.html").exists());
}

#[test]
fn columns_of_unequal_length_are_refused_by_their_name() {
    let (folder, record) = recorded();
    let columns = |part: &str| {
        let run = &record["variants"][0]["runs"][0][part];
        run.as_object().unwrap().keys().cloned().collect::<Vec<_>>()
    };
    for part in ["course", "evaluations"] {
        for column in columns(part) {
            let mut sent = record.clone();
            let figures = sent["variants"][0]["runs"][0][part][&column].as_array_mut().unwrap();
            figures.pop().unwrap();
            let output = report_of(folder.path(), &sent, &["--svg", "svg"]);
            refused(
                &output,
                2,
                &["sent.json is damaged: default, seed 0: the column `", "figures, `step` has"],
            );
        }
    }
}

#[test]
fn runs_of_different_length_are_shown_beside_each_other() {
    let (folder, mut record) = recorded();
    let course = record["variants"][0]["runs"][1]["course"].as_object_mut().unwrap();
    course.values_mut().for_each(|column| column.as_array_mut().unwrap().truncate(7));
    let output = report_of(folder.path(), &record, &[]);
    assert!(output.status.success(), "{}", said(&output));
}

#[test]
fn figures_that_no_run_has_are_refused() {
    let (folder, record) = recorded();
    for (part, column, place, figure) in [
        ("course", "step", 3, json!(0)),
        ("course", "early_aborts", 0, json!(u64::MAX)),
        ("course", "hard_resets", 10, json!(u64::MAX)),
        ("course", "lifetime_return", 49, json!(1e308)),
        ("evaluations", "step", 0, json!(u64::MAX)),
        ("evaluations", "mean_return", 1, json!(-1e308)),
    ] {
        let mut sent = record.clone();
        sent["variants"][0]["runs"][0][part][column][place] = figure;
        let output = report_of(folder.path(), &sent, &["--svg", "svg"]);
        refused(&output, 2, &["sent.json is damaged: default, seed 0: "]);
    }
    let mut sent = record.clone();
    sent["variants"][0]["runs"][0]["summary"]["final_return"] = json!(1e308);
    refused(&report_of(folder.path(), &sent, &[]), 2, &["`summary` has the figure 1e308"]);
    let mut sent = record.clone();
    sent["variants"][0]["runs"][0]["summary"]["accepted_risk"] = json!(-0.1);
    refused(&report_of(folder.path(), &sent, &[]), 2, &["`accepted_risk` is Some(-0.1)"]);
    let bin = |forecasts: u64, came_true: u64, sum: f64| json!({"forecasts": forecasts, "came_true": came_true, "sum": sum});
    for wrong in [bin(2, 3, 1.0), bin(2, 1, 3.0), bin(2, 1, -1.0), bin(u64::MAX, 0, 0.0)] {
        let bins = vec![wrong; 10];
        let reliability = json!({"bins": bins, "squared_error": 0.0});
        let mut sent = record.clone();
        sent["variants"][0]["runs"][0]["forecasts"] = json!({"all": reliability, "last_half": reliability});
        refused(&report_of(folder.path(), &sent, &[]), 2, &["its forecasts have a bin that cannot be"]);
    }
}

#[test]
fn a_record_with_other_cells_than_its_environment_has_no_picture_of_them() {
    let (folder, mut record) = recorded();
    record["variants"][0]["runs"][0]["aborts"] = json!({"Cells": [1, u64::MAX, u64::MAX]});
    let output = report_of(folder.path(), &record, &[]);
    let message = said(&output);
    assert!(output.status.success() && message.contains("the record counts 3 cells"), "{message}");
}
