//! The risk that the user accepts, as the rule `undo-probability` is told.

use serde::Deserialize;
use shield_api::{USUAL_ACCEPTED_RISK, notation};

use shield_config::experiment::{Experiment, Mode, PluginChoice};

const RULE: &str = "undo-probability";

/// How many attempts may fail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AcceptedRisk {
    /// This share of them.
    Share(f64),
    /// So many of 1,000 environment steps.
    Per1000Steps(f64),
}

/// What of the rule's configuration concerns the risk.
#[derive(Deserialize)]
#[serde(default)]
struct Config {
    accepted_risk: Option<f64>,
    hard_resets_per_1000: Option<f64>,
    adapt: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self { accepted_risk: None, hard_resets_per_1000: None, adapt: true }
    }
}

impl AcceptedRisk {
    /// That of the first rule `undo-probability`; `None` where there is none, or where its threshold does not follow the outcomes.
    pub fn of(experiment: &Experiment) -> Option<Self> {
        if experiment.mode != Mode::Shielded {
            return None;
        }
        Self::of_rules(experiment.rules())
    }

    /// That of the first of these rules that has one.
    pub fn of_rules<'a>(mut rules: impl Iterator<Item = &'a PluginChoice>) -> Option<Self> {
        let rule = rules.find(|rule| rule.plugin == RULE)?;
        Self::read(rule.config.get_ron())
    }

    fn read(config: &str) -> Option<Self> {
        let Config { accepted_risk, hard_resets_per_1000, adapt } = notation::from_str(config).ok()?;
        adapt.then(|| match hard_resets_per_1000 {
            Some(budget) => Self::Per1000Steps(budget),
            None => Self::Share(accepted_risk.unwrap_or(USUAL_ACCEPTED_RISK)),
        })
    }

    /// The share of `attempts` within so many `steps` that may fail: at most 1. `None` where a budget meets no attempt.
    pub fn share(self, steps: u64, attempts: u64) -> Option<f64> {
        match self {
            Self::Share(share) => Some(share),
            Self::Per1000Steps(budget) => {
                (attempts > 0).then(|| (budget * steps as f64 / 1000.0 / attempts as f64).min(1.0))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{AcceptedRisk::*, *};

    #[test]
    fn the_risk_is_read_as_the_rule_reads_it() {
        for (config, expected) in [
            ("()", Some(Share(0.2))),
            ("(combine: Quantile(0.3), accepted_risk: 0.1)", Some(Share(0.1))),
            ("(accepted_risk: Some(0.4), adapt: true)", Some(Share(0.4))),
            ("(accepted_risk: None, hard_resets_per_1000: 3.0)", Some(Per1000Steps(3.0))),
            ("(adapt: false, initial_threshold: 0.8)", None),
        ] {
            assert_eq!(AcceptedRisk::read(config), expected, "{config}");
        }
    }

    #[test]
    fn a_budget_is_a_share_of_the_attempts_that_were_made() {
        assert_eq!(Share(0.1).share(0, 0), Some(0.1));
        assert_eq!(Per1000Steps(2.0).share(10_000, 80), Some(0.25));
        assert_eq!(Per1000Steps(2.0).share(10_000, 5), Some(1.0));
        assert_eq!(Per1000Steps(2.0).share(10_000, 0), None);
    }
}
