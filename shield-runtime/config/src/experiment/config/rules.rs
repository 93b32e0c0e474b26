//! Rules, and how they are composed.

use serde::{Deserialize, Serialize, Serializer, ser::SerializeStructVariant};

use super::PluginChoice;

/// A rule, or several composed.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
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

/// A single rule is written without its name, as it may be read.
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
