//! The way back from a variant to the user's file.

use std::path::PathBuf;

use super::*;

#[test]
fn a_fault_that_a_plugin_reports_is_located_in_the_users_file() {
    let text = SMALL.replace(
        '@',
        r#", reset: (plugin: "r", config: // first
    (
        a: 1,
        b: Some(c: 2, d: 3),
        e: 4,
    )), variants: {"v": [("reset.config.e", 50), ("reset.config.g", 6)]}"#,
    );
    let mut sets = sets(&["reset.config.h=8"]);
    sets.push(Override::new("reset.config.a", "10", "--a 10").unwrap());
    let variant = file(&text).variants(&sets, None).unwrap().remove(0);
    let config = config(variant.experiment.reset.as_ref().unwrap().choice()).to_owned();
    let place_of = |needle: &str| {
        let offset = config.find(needle).unwrap();
        let position = position_at(&config, offset);
        variant.locate("reset.config", Some(position)).to_string()
    };
    let in_file = |needle: &str| {
        let Position { line, column } = position_at(&text, text.find(needle).unwrap());
        format!("x.ron:{line}:{column}")
    };
    assert_eq!(place_of("b: Some"), in_file("b: Some"));
    assert_eq!(place_of("d: 3"), in_file("d: 3"));
    assert_eq!(place_of("50"), in_file("50"));
    assert_eq!(place_of("g: 6"), in_file("\"reset.config.g\""));
    assert_eq!(place_of("6"), in_file("6)]"));
    assert_eq!(place_of("10"), "--a 10");
    assert_eq!(place_of("h: 8"), "--set reset.config.h=8");
    assert_eq!(variant.locate("reset.config", None).to_string(), in_file("(\n        a: 1"));
    assert_eq!(
        variant.locate("reset.config", Some(Position { line: 1, column: 1 })).to_string(),
        in_file("(\n        a: 1")
    );
    assert_eq!(
        variant.locate("environment.config", Some(Position { line: 1, column: 2 })).to_string(),
        in_file("(plugin: \"e\")")
    );
    assert_eq!(variant.locate("shield.rules[0]", None).to_string(), "x.ron:1:1");
    let error = variant.error_at("reset.config", Some(Position { line: 9, column: 9 }), "odd");
    assert_eq!(error.to_string(), format!("{}: variant `v`: odd", in_file(")), variants")));
    assert_eq!(variant.file(), PathBuf::from("x.ron"));
    let place_in = |field: &str| variant.locate(&format!("reset.config.{field}"), None).to_string();
    assert_eq!(place_in("b"), in_file("Some(c: 2"));
    assert_eq!(place_in("b.d"), in_file("3),\n"));
    assert_eq!(place_in("e"), in_file("50"));
    assert_eq!(place_in("h"), "--set reset.config.h=8");
}
