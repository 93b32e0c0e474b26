//! What is read out of a tree, and where what is wrong with it stands.

use std::{collections::BTreeMap, fmt::Debug, ops::Range};

use serde::Deserialize;

use super::*;

#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Point {
    x: f32,
    #[serde(default)]
    y: Option<Box<Point>>,
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
enum Shape {
    Nothing,
    Circle(f32),
    Dot(Point),
    Line(f32, f32),
    Box { width: u8, height: Option<u8> },
    Many(Vec<Shape>),
}

#[derive(Debug, PartialEq, Deserialize)]
struct Metres(f64);

#[derive(Debug, PartialEq, Deserialize)]
struct Pair(u8, char);

#[derive(Debug, PartialEq, Deserialize)]
struct Marker;

fn reads<'de, T: Deserialize<'de> + Debug + PartialEq>(texts: &[&'de str], expected: &T) {
    for text in texts {
        assert_eq!(from_str::<T>(text).as_ref(), Ok(expected), "{text}");
    }
}

fn point(x: f32) -> Point {
    Point { x, y: None }
}

#[test]
fn an_option_has_three_forms_at_every_depth() {
    let nested = Point { x: 1.0, y: Some(Box::new(Point { x: 2.0, y: Some(Box::new(point(3.0))) })) };
    reads(
        &[
            "(x: 1, y: Some(x: 2, y: Some(x: 3)))",
            "(x: 1, y: Some((x: 2, y: Some((x: 3, y: None)))))",
            "Point(x: 1.0, y: (x: 2, y: (x: 3)))",
            "(x: 1, y: Some(Point(x: 2, y: Point(x: 3)),),)",
            "(x: 1, y: Some /* a */ ( /* b */ x: 2, y: Some((x: 3))))",
        ],
        &nested,
    );
    reads(&["Some(5)", "5"], &Some(5_u8));
    reads(&["None"], &None::<u8>);
    reads(&["Some(Some(5))", "Some(5)", "5"], &Some(Some(5_u8)));
    reads(&["Some(1, 2)", "Some((1, 2))", "(1, 2)"], &Some((1_u8, 2_u8)));
    reads(&["Some()", "Some(())", "()"], &Some(()));
    reads(&["Some([1])", "[1]"], &Some(vec![1_u8]));
}

#[test]
fn a_variant_has_its_content_in_both_forms() {
    reads(&["Nothing"], &Shape::Nothing);
    reads(&["Circle(2)"], &Shape::Circle(2.0));
    reads(&["Dot(x: 1)", "Dot((x: 1))", "Dot(Point(x: 1))"], &Shape::Dot(point(1.0)));
    reads(&["Line(1, 2)"], &Shape::Line(1.0, 2.0));
    let tall = Shape::Box { width: 1, height: Some(2) };
    reads(&["Box(width: 1, height: 2)", "Box((height: Some(2), width: 1))"], &tall);
    reads(&["Box(width: 1)"], &Shape::Box { width: 1, height: None });
    reads(&["Many([Nothing, Many([])])"], &Shape::Many(vec![Shape::Nothing, Shape::Many(Vec::new())]));
}

#[test]
fn every_kind_of_value_is_read() {
    reads(&["5.0", "(5.0)", "Metres(5.0)"], &Metres(5.0));
    reads(&["(1, 'a')", "Pair(1, 'a')"], &Pair(1, 'a'));
    reads(&["Marker", "()"], &Marker);
    reads(&["true"], &true);
    reads(&["-1_000", "-0x3E8"], &-1_000_i64);
    reads(&["inf"], &f32::INFINITY);
    reads(&["-inf"], &f64::NEG_INFINITY);
    reads(&["\"a\\n\\u{e4}\"", "r#\"a\nä\"#"], &"a\nä".to_owned());
    reads(&["\"borrowed\""], &"borrowed");
    reads(&["'\\''"], &'\'');
    reads(&["2..5"], &(2_u8..5));
    reads(&["(start: 2, end: 5)"], &(2_u8..5));
    reads(
        &["{1: Nothing, 2: Circle(1)}"],
        &BTreeMap::from([(1_u8, Shape::Nothing), (2, Shape::Circle(1.0))]),
    );
    reads(&["{(1, 2): 'a'}"], &BTreeMap::from([((1_u8, 2_u8), 'a')]));
    reads(&["{\"k\\t\": 1}"], &BTreeMap::from([("k\t".to_owned(), 1_u8)]));
    reads(&["#![enable(implicit_some)] (x: 1)"], &point(1.0));
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(untagged)]
enum Either {
    Number(u8),
    Text(String),
    Shape(Shape),
    Place(Point),
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "kind")]
enum Tagged {
    Round { radius: f32 },
}

#[derive(Debug, PartialEq, Deserialize)]
struct Flat {
    name: String,
    #[serde(flatten)]
    rest: BTreeMap<String, u8>,
}

#[test]
fn a_type_that_asks_what_stands_there_is_told() {
    reads(&["5"], &Either::Number(5));
    reads(&["\"Nothing\""], &Either::Text("Nothing".into()));
    reads(&["Circle(2.5)"], &Either::Shape(Shape::Circle(2.5)));
    reads(&["Line(1, 2)"], &Either::Shape(Shape::Line(1.0, 2.0)));
    reads(&["(x: 1)"], &Either::Place(point(1.0)));
    reads(&["(kind: \"Round\", radius: 2)", "(radius: 2, kind: Round)"], &Tagged::Round { radius: 2.0 });
    let flat = Flat { name: "n".into(), rest: BTreeMap::from([("a".to_owned(), 1)]) };
    reads(&["(name: \"n\", a: 1)", "(a: 1, name: \"n\")"], &flat);
    let text = "{\"a\": (1, true, None, 'c'), \"b\": (x: [Some(2.5)], y: ())}";
    assert_eq!(from_str::<ron::Value>(text).unwrap(), ron::from_str::<ron::Value>(text).unwrap());
}

/// `text` holds a `@` where the fault is.
fn check<T: for<'de> Deserialize<'de> + Debug>(text: &str, message: &str) {
    let place = text.find('@').expect("a mark");
    let fault = from_str::<T>(&text.replacen('@', "", 1)).unwrap_err();
    assert_eq!((fault.to_string().as_str(), fault.offset()), (message, place), "{text}");
}

#[test]
fn a_fault_stands_at_its_value_in_every_form() {
    for (before, after) in [("(", ")"), ("Some(", ")"), ("Some((", "))")] {
        let inside = |fields: &str| format!("(x: 1, y: {before}{fields}{after})");
        check::<Point>(&inside("x: 2, @z: 3"), "there is no field `z`, only `x` and `y`");
        check::<Point>(&inside("x: @\"2\""), "expected a number, found \"2\"");
        check::<Point>(&inside("x: 2, y: (x: @[])"), "expected a number, found a list `[…]`");
    }
    check::<Point>("(x: 1, y: @(y: None))", "the field `x` is missing");
    check::<Point>("(x: 1, y: @Some(y: None))", "the field `x` is missing");
    check::<Point>("(x: 1, y: Some(@(y: None)))", "the field `x` is missing");
    check::<Point>("(x: 1, y: @5)", "expected fields in brackets, as in `(name: value)`, found 5");
    check::<Point>("@Pint(x: 1)", "expected `Point(…)`, found `Pint`; did you mean `Point`?");
    check::<Point>("@{\"x\": 1}", "expected fields in brackets, as in `(name: value)`, found a map `{…}`");
}

#[test]
fn a_fault_says_what_was_expected_and_what_was_found() {
    check::<Vec<u8>>("[1, @256]", "expected a whole number from 0 to 255, found 256");
    check::<Vec<u8>>("[1, @1.5]", "expected a whole number from 0 to 255, found 1.5");
    check::<Vec<u8>>("@(1, 2)", "expected a list `[…]`, found a tuple `(…)`");
    check::<(u8, u8)>("@[1, 2]", "expected 2 values in brackets `(…)`, found a list `[…]`");
    check::<(u8, u8)>("(1, 2, @3)", "expected 2 values, found 3");
    check::<(u8, u8)>("@(1)", "expected a tuple of size 2, found 1 value");
    check::<bool>("@Yes", "expected true or false, found Yes");
    check::<char>("@\"a\"", "expected a character, as in `'a'`, found \"a\"");
    check::<()>("@None", "expected `()`, found None");
    check::<Option<u8>>("@Some", "`Some` needs a value in brackets: `Some(…)`");
    check::<Shape>(
        "@Crcle(1)",
        "there is no variant `Crcle`, only `Nothing`, `Circle`, `Dot`, `Line`, `Box` and `Many`; did you mean `Circle`?",
    );
    check::<Shape>("@Circle", "`Circle` needs a value in brackets: `Circle(…)`");
    check::<Shape>("@Nothing(1)", "`Nothing` stands alone, without brackets");
    check::<Shape>("Line(1, 2, @3)", "expected 2 values, found 3");
    check::<Shape>(
        "Box(width: 1, @wdth: 2)",
        "there is no field `wdth`, only `width` and `height`; did you mean `width`?",
    );
    check::<Shape>(
        "@(width: 1)",
        "expected `Nothing`, `Circle`, `Dot`, `Line`, `Box` or `Many`, found fields `(…)`",
    );
    check::<Shape>(
        "Many([Nothing, @5])",
        "expected `Nothing`, `Circle`, `Dot`, `Line`, `Box` or `Many`, found 5",
    );
    check::<BTreeMap<u8, u8>>("{1: 2, @\"3\": 4}", "expected a whole number from 0 to 255, found \"3\"");
    check::<BTreeMap<u8, u8>>("{1: 2, 3: @\"4\"}", "expected a whole number from 0 to 255, found \"4\"");
    check::<Range<u8>>("@5", "expected a range, as in `0..5`, found 5");
    let long = format!("@{}", "9".repeat(100_000));
    assert!(from_str::<u8>(&long[1..]).unwrap_err().to_string().len() < 200);
}
