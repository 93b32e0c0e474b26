//! Which settings the rows of the table try.

use shield_config::experiment::Override;
use shield_lab::run::{AcceptedRisk, Recorded};

use super::{Failure, WhatIfArguments};

/// What the first column varies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// `q_min` of the rule `ensemble-threshold`.
    QMin,
    /// The accepted risk of the rule `undo-probability`.
    Risk,
}

impl Axis {
    /// What the arguments ask for; else what the run has a rule for.
    pub fn of(arguments: &WhatIfArguments, recorded: &Recorded) -> Self {
        let has = |axis: Self| path(recorded, &[axis.rule()]).is_some();
        let is_risk =
            !arguments.risk.is_empty() || arguments.q_min.is_empty() && has(Self::Risk) && !has(Self::QMin);
        if is_risk { Self::Risk } else { Self::QMin }
    }

    fn rule(self) -> &'static str {
        match self {
            Self::QMin => "ensemble-threshold",
            Self::Risk => "undo-probability",
        }
    }

    fn heading(self) -> &'static str {
        match self {
            Self::QMin => "q_min",
            Self::Risk => "accepted risk",
        }
    }

    fn flag(self) -> &'static str {
        match self {
            Self::QMin => "--q-min",
            Self::Risk => "--risk",
        }
    }
}

/// Where the first of these rules stands in the experiment.
fn path(recorded: &Recorded, rules: &[&str]) -> Option<String> {
    let plugins = recorded.plugins();
    let found = plugins
        .iter()
        .find(|(path, _, rule)| path.starts_with("shield.rules") && rules.contains(&rule.plugin.as_str()));
    found.map(|(path, ..)| path.clone())
}

/// One combination of settings.
pub struct Row {
    /// What the table says of it.
    pub cells: Vec<String>,
    /// What it changes.
    pub overrides: Vec<Override>,
}

/// The rows of the table.
pub struct Settings<'a> {
    axis: Axis,
    values: &'a [f32],
    combine: &'a [String],
    sets: Vec<Override>,
    /// As they were given.
    written: &'a [String],
}

impl<'a> Settings<'a> {
    /// What the arguments ask for.
    pub fn of(arguments: &'a WhatIfArguments, axis: Axis) -> Result<Self, Failure> {
        let mut sets = Vec::new();
        for set in &arguments.sets {
            let set = Override::parse(set)?;
            if !set.path.starts_with("shield.rules") {
                return Err(Failure::Input(format!(
                    "--set {}={}: a replay reads nothing but the rules, `shield.rules`",
                    set.path, set.value
                )));
            }
            sets.push(set);
        }
        let values = match axis {
            Axis::QMin => &arguments.q_min,
            Axis::Risk => &arguments.risk,
        };
        Ok(Self { axis, values, combine: &arguments.combine, sets, written: &arguments.sets })
    }

    /// The headings of what is set.
    pub fn headings(&self) -> Vec<&'static str> {
        let set = (!self.sets.is_empty()).then_some("set");
        set.into_iter().chain([self.axis.heading(), "combine"]).collect()
    }

    /// The cells of the row that changes nothing.
    pub fn as_recorded(&self, recorded: &Recorded) -> Vec<String> {
        let mut cells = vec![String::new(); self.headings().len()];
        cells[0] = match (self.axis, recorded.accepted_risk()) {
            (Axis::Risk, Some(AcceptedRisk::Share(share))) => format!("as recorded ({share})"),
            _ => "as recorded".into(),
        };
        cells
    }

    /// Every combination of what was given.
    pub fn rows(&self, recorded: &Recorded) -> Result<Vec<Row>, Failure> {
        let not_given = if self.sets.is_empty() { "as recorded" } else { "-" };
        let mut rows = Vec::new();
        for value in or_none(self.values) {
            for combine in or_none(self.combine) {
                let overrides = self.overrides(recorded, value, combine)?;
                if overrides.is_empty() {
                    continue;
                }
                let cell = |given: Option<String>| given.unwrap_or_else(|| not_given.into());
                let set = (!self.sets.is_empty()).then(|| self.written.join("\n"));
                let own = [cell(value.map(f32::to_string)), cell(combine.cloned())];
                rows.push(Row { cells: set.into_iter().chain(own).collect(), overrides });
            }
        }
        Ok(rows)
    }

    fn overrides(
        &self,
        recorded: &Recorded,
        value: Option<&f32>,
        combine: Option<&String>,
    ) -> Result<Vec<Override>, Failure> {
        let mut overrides = self.sets.clone();
        if let Some(value) = value {
            let (rule, flag) = (self.axis.rule(), self.axis.flag());
            let path = path(recorded, &[rule]).ok_or_else(|| no_rule(rule, flag))?;
            let origin = format!("{flag} {value}");
            let set = |field: &str, value: String| {
                Override::new(&format!("{path}.config.{field}"), &value, origin.clone())
            };
            match self.axis {
                Axis::QMin => overrides.push(set("q_min", format!("{value:?}"))?),
                // A budget of hard resets gives way to the share.
                Axis::Risk => overrides.extend([
                    set("hard_resets_per_1000", "None".into())?,
                    set("accepted_risk", format!("Some({value:?})"))?,
                ]),
            }
        }
        if let Some(combine) = combine {
            let rules = [self.axis.rule(), Axis::QMin.rule(), Axis::Risk.rule()];
            let found = rules.iter().find_map(|rule| path(recorded, &[rule]));
            let path = found.ok_or_else(|| no_rule(Axis::QMin.rule(), "--combine"))?;
            let value = match combine.as_str() {
                "min" => "Pessimistic",
                "mean" => "Realist",
                "max" => "Optimistic",
                other => other,
            };
            let origin = format!("--combine {combine}");
            overrides.push(Override::new(&format!("{path}.config.combine"), value, origin)?);
        }
        Ok(overrides)
    }
}

fn no_rule(rule: &str, flag: &str) -> Failure {
    Failure::Input(format!(
        "the run has no rule {rule:?}, to which {flag} belongs; --set sets any field of another"
    ))
}

/// Each value, or one that is not given.
fn or_none<T>(values: &[T]) -> Vec<Option<&T>> {
    if values.is_empty() { vec![None] } else { values.iter().map(Some).collect() }
}
