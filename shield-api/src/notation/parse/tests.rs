use super::*;

/// The text of every value, outermost first.
fn values(text: &str) -> Vec<&str> {
    fn collect<'a>(node: &Node, text: &'a str, into: &mut Vec<&'a str>) {
        into.push(&text[node.span.clone()]);
        node.children().for_each(|child| collect(child, text, into));
    }
    let root = parse(text).unwrap_or_else(|fault| panic!("{text:?}: {fault}"));
    let mut found = Vec::new();
    collect(&root, text, &mut found);
    found
}

#[test]
fn spans_leave_out_comments_and_see_through_strings() {
    let check = |text: &str, expect: &[&str]| {
        let found = values(text);
        assert_eq!(found[1..], *expect, "{text}");
        for value in found {
            ron::from_str::<IgnoredAny>(value).unwrap();
        }
    };
    check("(a: 1_000, b: -1.5e3 /* , */ ,)", &["1_000", "-1.5e3"]);
    check(r#"#![type = "a]b"] ( a : "x)\"," , b: 'y', c: '\'' )"#, &[r#""x)\",""#, "'y'", r"'\''"]);
    check(
        r###"(a: r#"")"#, b: b"\"", c: br"\", r#d-e: r"", f: b'x')"###,
        &[r###"r#"")"#"###, r#"b"\"""#, r#"br"\""#, r#"r"""#, "b'x'"],
    );
    check(
        "// (\n[Some /* ( /* */ */ (1), Name, (), ('a', true)]",
        &["Some /* ( /* */ */ (1)", "1", "Name", "()", "('a', true)", "'a'", "true"],
    );
    check("{\"k\": [1, // ]\n2], 'c': {}}", &["[1, // ]\n2]", "1", "2", "{}"]);
    check("X(ä: Y(b: inf), c: 0xFF, d: -inf)", &["Y(b: inf)", "inf", "0xFF", "-inf"]);
    check("(a:1/**/,b:2//\n)", &["1", "2"]);
}

#[test]
fn names_and_keys_are_those_that_are_meant() {
    let text = "Some /* ( */ (r#ab: {\"k\\u{41}\": Name, 5: r#x}, c: [X()])";
    let root = parse(text).unwrap();
    assert_eq!((root.name(text), root.is_named()), ("Some", true));
    let map = &root.entry("ab").unwrap().value;
    let keys: Vec<&str> = map.entries().iter().map(|entry| entry.key.as_str()).collect();
    assert_eq!(keys, ["kA", "5"]);
    let names: Vec<&str> = map.children().map(|value| value.name(text)).collect();
    assert_eq!(names, ["Name", "x"]);
    assert!(!map.entries()[0].value.is_named());
    let content = |node: &Node| text[node.span.start + node.open_len..].to_owned();
    assert!(content(&root).starts_with("r#ab: "));
    assert!(content(&root.entry("c").unwrap().value.items()[0]).starts_with(")])"));
}

/// `text` holds a `@` where the fault is.
fn check(text: &str, message: &str) {
    let place = text.find('@').expect("a mark");
    let fault = parse(&text.replacen('@', "", 1)).unwrap_err();
    assert_eq!((fault.to_string().as_str(), fault.offset()), (message, place), "{text}");
}

#[test]
fn text_that_is_not_ron_is_refused_at_its_place() {
    check("@", "the text ends where a value should be");
    check(" // nothing\n@", "the text ends where a value should be");
    check("\n(@", "the text ends, but the `(` of line 2 is not closed");
    check("(a: [\n1@", "the text ends, but the `[` of line 1 is not closed");
    check("(a: {\"b\"@", "the text ends, but the `{` of line 1 is not closed");
    check("(a: 1,@", "the text ends, but the `(` of line 1 is not closed");
    check("(a @1)", "`,` or `)` should stand here, not `1`");
    check("(a: 1, b@)", "`:` should stand here, behind `b`");
    check("(a: 1 @b: 2)", "`,` or `)` should stand here, not `b`");
    check("(a: 1, @5: 2)", "the name of a field should stand here, not `5`");
    check("[1 @2]", "`,` or `]` should stand here, not `2`");
    check("[1, @)]", "a value should stand here, not `)`");
    check("(a: @)", "a value should stand here, not `)`");
    check("(a: @, b: 1)", "a value should stand here, not `,`");
    check("{1@}", "`:` should stand here, behind `1`");
    check("1 @2", "`2` follows the value, where the text should end");
    check("5@, b: 1", "`,` follows the value, where the text should end");
    check("(a: @\"x)", "this text is not closed: `\"` is missing");
    check("(a: @r##\"x\"#)", "this text is not closed: `\"##` is missing");
    check("(a: @'", "this text is not closed: `'` is missing");
    check("(a: 1, @/* /* */ b: 1)", "this comment is not closed: `*/` is missing");
    check("@#![enable(implicit_some)", "this attribute is not closed: `]` is missing");
    check("@#![enable(implicit_sum)] ()", "no RON extension named `implicit_sum`");
    check("(a: @tabular-q)", "`tabular-q` is neither a number nor a name; a text needs quotes");
    check("(a: @mujoco/cart)", "`mujoco/cart` is neither a number nor a name; a text needs quotes");
    check("(a: @1.5.2)", "`1.5.2` is neither a number nor a name; a text needs quotes");
    check("(a: 1, b: 2, @a: 3)", "`a` is given twice");
    check("{\"a\": 1, @\"\\u{61}\": 3}", "`a` is given twice");
    assert!(parse("(a: \"\\q\")").is_err());
}

#[test]
fn brackets_inside_one_another_are_counted() {
    for (open, close) in
        [("[", "]"), ("(", ")"), ("{1:", "}"), ("Some(", ")"), ("All([", "])"), ("(a: ", ")")]
    {
        let brackets = open.matches(['(', '[', '{']).count();
        let nested = |levels: usize| format!("{}1{}", open.repeat(levels), close.repeat(levels));
        let deepest = nested(MAX_DEPTH / brackets);
        assert_eq!(parse(&deepest).unwrap().depth(), MAX_DEPTH, "{open}");
        for levels in [MAX_DEPTH / brackets + 1, 3_901, 100_000] {
            let fault = parse(&nested(levels)).unwrap_err();
            assert_eq!(fault.message, "more than 128 brackets stand inside one another here", "{open}");
            let before = nested(levels)[..fault.offset()].matches(['(', '[', '{']).count();
            assert_eq!(before, MAX_DEPTH, "{open}");
        }
        assert!(parse(&open.repeat(100_000)).is_err());
    }
}

#[test]
fn a_text_of_any_length_is_read_or_refused() {
    let long = |piece: &str| piece.repeat(400_000 / piece.len());
    for piece in ["1,", "[],", "\"x\",", " ", "/**/", "\u{200E}", "a,", "r#a,"] {
        let list = format!("[{}]", long(piece));
        parse(&list).unwrap();
    }
    for piece in ["#", "/*", "r#", "'", "\"", "-", "{", "r\"#", "0x", "\\", "a(", "a:"] {
        let fault = parse(&long(piece)).map_or_else(|fault| fault, |root| panic!("{piece}: {root:?}"));
        assert!(fault.offset() <= LONGEST && fault.to_string().len() < 200, "{piece}: {fault}");
    }
    let fault = parse(&" ".repeat(LONGEST + 1)).unwrap_err();
    assert_eq!(fault.to_string(), "the text has 4194305 bytes; at most 4194304 are read");
}
