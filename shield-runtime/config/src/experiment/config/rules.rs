//! Rules, and how they are composed.

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{
        EnumAccess, MapAccess, Visitor,
        value::{EnumAccessDeserializer, MapAccessDeserializer},
    },
    ser::SerializeStructVariant,
};

use super::PluginChoice;

/// A rule, or several composed.
#[derive(Debug, Clone)]
pub enum RuleConfig {
    /// One rule; written without this name, `(plugin: …)`.
    Rule(PluginChoice),
    /// One rule whose rows a projection may exceed. It judges what was found as strictly as any.
    Soft {
        /// What an excess of s costs: priority · s² / 2, where moving the action by d costs d² / 2.
        priority: f32,
        /// The rule.
        rule: PluginChoice,
    },
    /// Every one must allow the action.
    All(Vec<RuleConfig>),
    /// One is enough.
    Any(Vec<RuleConfig>),
}

impl RuleConfig {
    /// The plugins of a list of rules, in the order in which the shield counts them, with the path of each.
    pub(in crate::experiment) fn collect<'a>(
        rules: &'a [Self],
        path: &str,
        found: &mut Vec<(String, &'a PluginChoice)>,
    ) {
        for (index, rule) in rules.iter().enumerate() {
            let path = format!("{path}[{index}]");
            match rule {
                Self::Rule(choice) => found.push((path, choice)),
                Self::Soft { rule, .. } => found.push((format!("{path}.rule"), rule)),
                Self::All(parts) | Self::Any(parts) => Self::collect(parts, &path, found),
            }
        }
    }

    pub(super) fn plugins_mut(&mut self) -> Vec<&mut PluginChoice> {
        match self {
            Self::Rule(choice) | Self::Soft { rule: choice, .. } => vec![choice],
            Self::All(parts) | Self::Any(parts) => parts.iter_mut().flat_map(Self::plugins_mut).collect(),
        }
    }
}

/// A rule that is written with a name.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
enum Named {
    Rule(PluginChoice),
    Soft { priority: f32, rule: PluginChoice },
    All(Vec<RuleConfig>),
    Any(Vec<RuleConfig>),
}

/// A single rule may be written without its name.
impl<'de> Deserialize<'de> for RuleConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_enum("RuleConfig", &["Rule", "Soft", "All", "Any"], RuleVisitor)
    }
}

struct RuleVisitor;

impl<'de> Visitor<'de> for RuleVisitor {
    type Value = RuleConfig;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a rule, such as `(plugin: \"ensemble-threshold\")` or `Any([…])`")
    }

    fn visit_map<A: MapAccess<'de>>(self, fields: A) -> Result<RuleConfig, A::Error> {
        PluginChoice::deserialize(MapAccessDeserializer::new(fields)).map(RuleConfig::Rule)
    }

    fn visit_enum<A: EnumAccess<'de>>(self, variant: A) -> Result<RuleConfig, A::Error> {
        Ok(match Named::deserialize(EnumAccessDeserializer::new(variant))? {
            Named::Rule(choice) => RuleConfig::Rule(choice),
            Named::Soft { priority, rule } => RuleConfig::Soft { priority, rule },
            Named::All(parts) => RuleConfig::All(parts),
            Named::Any(parts) => RuleConfig::Any(parts),
        })
    }
}

/// A single rule is written without its name.
impl Serialize for RuleConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        const NAME: &str = "RuleConfig";
        match self {
            Self::Rule(choice) => choice.serialize(serializer),
            Self::Soft { priority, rule } => {
                let mut soft = serializer.serialize_struct_variant(NAME, 1, "Soft", 2)?;
                soft.serialize_field("priority", priority)?;
                soft.serialize_field("rule", rule)?;
                soft.end()
            }
            Self::All(parts) => serializer.serialize_newtype_variant(NAME, 2, "All", parts),
            Self::Any(parts) => serializer.serialize_newtype_variant(NAME, 3, "Any", parts),
        }
    }
}
