//! Who undoes what was done.

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{
        EnumAccess, MapAccess, Visitor,
        value::{EnumAccessDeserializer, MapAccessDeserializer},
    },
};

use super::PluginChoice;
use shield_host::plugin::Kind;

/// Who undoes what was done.
#[derive(Debug, Clone)]
pub enum Reset {
    /// An agent that learns to; written without this name, `(plugin: …)`.
    Learner(PluginChoice),
    /// A policy that is given, and learns nothing.
    Policy(PluginChoice),
}

impl Reset {
    /// The plugin behind it.
    pub fn choice(&self) -> &PluginChoice {
        match self {
            Self::Learner(choice) | Self::Policy(choice) => choice,
        }
    }

    pub(super) fn choice_mut(&mut self) -> &mut PluginChoice {
        match self {
            Self::Learner(choice) | Self::Policy(choice) => choice,
        }
    }

    /// The path of its field, its kind, and the choice.
    pub(super) fn plugin(&self) -> (String, Kind, &PluginChoice) {
        let kind = match self {
            Self::Learner(_) => Kind::Learner,
            Self::Policy(_) => Kind::Policy,
        };
        ("reset".into(), kind, self.choice())
    }
}

/// An agent that is written with a name.
#[derive(Deserialize)]
enum Named {
    Learner(PluginChoice),
    Policy(PluginChoice),
}

/// A learner may be written without its name.
impl<'de> Deserialize<'de> for Reset {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_enum("Reset", &["Learner", "Policy"], ResetVisitor)
    }
}

struct ResetVisitor;

impl<'de> Visitor<'de> for ResetVisitor {
    type Value = Reset;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a reset agent, such as `(plugin: \"ddpg\")` or `Policy(plugin: …)`")
    }

    fn visit_map<A: MapAccess<'de>>(self, fields: A) -> Result<Reset, A::Error> {
        PluginChoice::deserialize(MapAccessDeserializer::new(fields)).map(Reset::Learner)
    }

    fn visit_enum<A: EnumAccess<'de>>(self, variant: A) -> Result<Reset, A::Error> {
        Ok(match Named::deserialize(EnumAccessDeserializer::new(variant))? {
            Named::Learner(choice) => Reset::Learner(choice),
            Named::Policy(choice) => Reset::Policy(choice),
        })
    }
}

/// A learner is written without its name.
impl Serialize for Reset {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Learner(choice) => choice.serialize(serializer),
            Self::Policy(choice) => serializer.serialize_newtype_variant("Reset", 1, "Policy", choice),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::{DropInFile, ExperimentFile, InputError, Override, Variant};

    /// `@` stands for the reset agent.
    const EXPERIMENT: &str = r#"(name: "x", steps: 1, seeds: [0], environment: (plugin: "e"), forward: Policy(plugin: "f"),
        shield: (rules: [(plugin: "rule")]), reset: @)"#;

    fn read(reset: &str, sets: &[&str]) -> Result<Variant, InputError> {
        let sets: Vec<_> = sets.iter().map(|set| Override::parse(set).unwrap()).collect();
        let file = ExperimentFile::from_text("x.ron", EXPERIMENT.replace('@', reset));
        file.variants(&sets, None).map(|mut variants| variants.remove(0))
    }

    fn resolved(reset: &str, sets: &[&str]) -> String {
        let variant = read(reset, sets).unwrap_or_else(|error| panic!("{error}"));
        variant.resolved_ron(0, &|id| vec![("of".into(), format!("{id:?}"))])
    }

    #[test]
    fn every_form_of_one_reset_agent_is_resolved_to_the_same() {
        for (forms, expected) in [
            (
                [
                    r#"(plugin: "a")"#,
                    r#"Some(plugin: "a")"#,
                    r#"Learner(plugin: "a")"#,
                    r#"Some(Learner((plugin: "a")))"#,
                ],
                r#"reset: (plugin: "a", path: None, config: (of: "a"))"#,
            ),
            (
                [
                    r#"Policy(plugin: "a")"#,
                    r#"Some(Policy(plugin: "a"))"#,
                    r#"Policy((plugin: "a"))"#,
                    r#"/**/ Policy( plugin: "a",)"#,
                ],
                r#"reset: Policy(plugin: "a", path: None, config: (of: "a"))"#,
            ),
        ] {
            for form in forms {
                let text = resolved(form, &[]);
                assert!(text.contains(expected), "{form} became\n{text}");
                let again =
                    ExperimentFile::from_text("config.ron", text.clone()).variants(&[], None).unwrap();
                assert_eq!(
                    again[0].resolved_ron(0, &|_| Vec::new()).split_once('\n').unwrap().1,
                    text.split_once('\n').unwrap().1
                );
            }
        }
    }

    #[test]
    fn overrides_reach_into_a_policy_and_put_another_in_its_place() {
        let text = resolved(r#"Policy(plugin: "a")"#, &["reset.config.gain=2", "reset.isolate=true"]);
        assert!(
            text.contains(
                r#"reset: Policy(plugin: "a", path: None, config: (gain: 2, of: "a"), isolate: true)"#
            ),
            "{text}"
        );
        let text = resolved(r#"(plugin: "a")"#, &[r#"reset=Policy(plugin: "b")"#]);
        assert!(text.contains(r#"reset: Policy(plugin: "b""#), "{text}");
    }

    #[test]
    fn a_reset_policy_is_listed_as_one_and_may_be_isolated() {
        for (form, kind) in [("", Kind::Learner), ("Policy", Kind::Policy)] {
            let reset = format!(r#"{form}(plugin: "a")"#);
            let experiment = read(&reset, &[]).unwrap().experiment;
            assert_eq!(experiment.plugins()[2].0, "reset");
            assert_eq!(experiment.plugins()[2].1, kind);
            let isolated = read(&reset, &["reset.isolate=true"]).map(|_| ());
            assert_eq!(isolated.is_ok(), kind == Kind::Policy, "{isolated:?}");
            let text =
                format!(r#"(reset: {form}(plugin: "a", isolate: true), shield: (rules: [(plugin: "r")]))"#);
            let drop_in = DropInFile::from_text("x.ron", &text, &[]).map(|file| file.config.plugins()[0].1);
            assert_eq!(drop_in.ok(), (kind == Kind::Policy).then_some(kind));
        }
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        for (reset, words) in [
            (r#"Polcy(plugin: "a")"#, "Policy"),
            (r#"Policy(plugn: "a")"#, "plugin"),
            (r#"(plugn: "a")"#, "plugin"),
            (r#"Policy(plugin: "")"#, "the id of a plugin is empty"),
            ("7", "expected `Learner` or `Policy`"),
        ] {
            let error = read(reset, &[]).unwrap_err().to_string();
            assert!(error.starts_with("x.ron:2:") && error.contains(words), "{reset}: {error}");
        }
    }
}
