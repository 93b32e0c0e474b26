//! A rule written in C: it works, and every way to fill its tables wrongly is refused.

use std::sync::Mutex;

use shield_api::{
    AbortRule, Checkpoint, Error, ErrorKind, ObservedDecision, Phase, Position, Reason, Result, Rows,
    RuleContext, RuleVerdict, Verdict,
};
use shield_runtime::plugin::{LoadedAbortRule, PluginError, Registry, Selection};

use crate::fixtures::{c_fixture, check_refusal, setup};

fn create(name: &str, defines: &[&str], config: &str) -> Result<LoadedAbortRule, PluginError> {
    let selection = Selection::new("c/gentle").at(c_fixture(name, defines));
    Registry::default().abort_rule(&selection, config, &setup())
}

fn context(proposed: &[f32]) -> RuleContext<'_> {
    RuleContext {
        step: 0,
        observation: &[0.0, 0.0],
        proposed,
        previous: None,
        values: &[1.0],
        greedy_values: &[],
        forward_values: &[],
        discount: 0.9,
        phase: Phase::Forward,
        ..RuleContext::default()
    }
}

fn judge(rule: &LoadedAbortRule, action: f32) -> Result<(RuleVerdict, String)> {
    let mut room = [0; 64];
    let mut reason = Reason::new(&mut room);
    let verdict = rule.evaluate(&context(&[action]), &mut reason)?;
    let length = reason.len();
    Ok((verdict, String::from_utf8(room[..length].to_vec()).unwrap()))
}

#[test]
fn a_rule_in_c_judges_and_linearises_and_keeps_its_state() {
    let mut rule = create("good", &[], "()").unwrap();
    assert!(rule.needs().values);
    let (judged, reason) = judge(&rule, 0.75).unwrap();
    assert_eq!((judged.verdict, judged.score, reason.as_str()), (Verdict::Reject, 0.75, "too hard"));
    assert_eq!(judge(&rule, 0.25).unwrap().0.verdict, Verdict::Allow);

    struct Collected(Mutex<Vec<(f32, f32)>>);
    impl Rows for Collected {
        fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
            self.0.lock().unwrap().push((coefficients[0], bound));
            Ok(())
        }
    }
    let mut rows = Collected(Mutex::default());
    rule.linearise(&context(&[0.75]), &[0.0], &mut rows).unwrap();
    assert_eq!(*rows.0.lock().unwrap(), [(1.0, 0.5), (-1.0, 0.5)]);

    rule.observe(&ObservedDecision { step: 0, aborted: true, action: &[0.0] }).unwrap();
    let mut bytes = vec![9];
    rule.save(&mut bytes).unwrap();
    assert_eq!(bytes, [9, 1, 0, 0, 0], "what was there stays, and both pieces are appended");
    rule.load(&bytes[1..]).unwrap();
    let error = rule.load(&bytes).unwrap_err();
    assert_eq!(error, Error::invalid_argument("c/gentle: a state has 4 bytes"));
}

#[test]
fn a_library_in_c_of_a_later_minor_version_works() {
    let rule = create("later_minor", &["ABI_MINOR=7"], "()").unwrap();
    assert_eq!(judge(&rule, 0.25).unwrap().0.verdict, Verdict::Allow);
}

#[test]
fn a_failed_save_leaves_the_callers_bytes_as_they_were() {
    let rule = create("save_fails", &["SAVE_FAILS"], "()").unwrap();
    let mut bytes = vec![9];
    assert_eq!(rule.save(&mut bytes).unwrap_err(), Error::failed("c/gentle: the disk is full"));
    assert_eq!(bytes, [9]);
}

#[test]
fn an_error_of_the_caller_ends_the_linearisation() {
    struct Full;
    impl Rows for Full {
        fn push(&mut self, _: &[f32], _: f32) -> Result<()> {
            Err(Error::failed("no more room"))
        }
    }
    let rule = create("good_rows", &[], "()").unwrap();
    let error = rule.linearise(&context(&[0.75]), &[0.0], &mut Full).unwrap_err();
    assert_eq!(error, Error::failed("c/gentle: `linearise`: no more room"));
}

#[test]
fn a_refused_configuration_has_a_place() {
    let error = create("good_config", &[], "(limit: 1)").unwrap_err();
    let place = Some(Position { line: 1, column: 2 });
    assert_eq!(error.config_fault(), Some(("this rule has no settings", place)));
    assert_eq!(error.to_string(), "c/gentle: this rule has no settings");
}

#[test]
fn malformed_tables_are_refused_before_the_first_call() {
    for (name, define, expected) in [
        ("null_function", "NULL_FUNCTION", "`evaluate` of its abort-rule table is a null function pointer"),
        ("table_size", "TABLE_SIZE=80", "its abort-rule table says struct_size 80, expected 88"),
        ("descriptor_size", "DESCRIPTOR_SIZE=64", "its descriptor 0 says struct_size 64, expected 72"),
        ("library_size", "LIBRARY_SIZE=40", "its list of plugins says struct_size 40, expected 32"),
        ("null_list", "NULL_LIST", "its list of plugins is a null pointer"),
        ("major", "ABI_MAJOR=2", "speaks interface 2.1, this host 1.1"),
        ("count", "COUNT=1000", "it lists 1000 plugins, the manifest section of its file 1"),
        ("kind", "KIND=3", "it says the kind \"abort-rule\" and the number 3"),
        ("two_tables", "TWO_TABLES", "these are: [policy, abort-rule]"),
        ("no_entry", "NO_ENTRY", "does not export `shield_plugin_entry_v1`"),
        ("language", "LANGUAGE=\"cobol\"", "says the language \"cobol\""),
        ("kind_name", "KIND_NAME=\"oracle\"", "\"c/gentle\" is of the unknown kind \"oracle\""),
        ("says_rust", "LANGUAGE=\"rust\"", "says \"rust\", but the library does not export"),
    ] {
        check_refusal(&c_fixture(name, &[define]), &[expected]);
    }
}

#[test]
fn a_missing_instance_and_an_unknown_need_are_refused() {
    let error = create("no_instance", &["NO_INSTANCE"], "()").unwrap_err().to_string();
    assert_eq!(error, "c/gentle: `create` reports success, but made no instance");
    let error = create("unknown_need", &["UNKNOWN_NEED"], "()").unwrap_err().to_string();
    assert!(error.contains("asks for what this host does not know: 0x40"), "{error}");
}

#[test]
fn meaningless_answers_are_errors() {
    for (name, define, expected) in [
        ("verdict", "UNKNOWN_VERDICT", "c/gentle: `evaluate` gave the unknown verdict 7"),
        ("no_verdict", "NO_VERDICT", "c/gentle: `evaluate` gave the unknown verdict 0"),
        ("status", "UNKNOWN_STATUS", "c/gentle: something (unknown status 77)"),
        (
            "reason",
            "LONG_REASON",
            "c/gentle: `evaluate` says that it wrote 257 bytes of a reason into room for 256",
        ),
    ] {
        let rule = create(name, &[define], "()").unwrap();
        let error = judge(&rule, 0.0).unwrap_err();
        assert_eq!((error.kind(), error.message()), (ErrorKind::Failed, expected));
    }
}
