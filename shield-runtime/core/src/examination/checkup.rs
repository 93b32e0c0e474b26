//! What an examination came to.

use std::fmt;

/// How a check stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Nothing is in the way.
    Good,
    /// It could not be told.
    Unknown,
    /// It works, but the user should know.
    Note,
    /// A setting must be changed.
    Change,
    /// No setting helps.
    Hopeless,
}

impl Standing {
    /// One word for a list of checks.
    pub fn word(self) -> &'static str {
        match self {
            Self::Good => "ok",
            Self::Unknown => "?",
            Self::Note => "note",
            Self::Change => "CHANGE",
            Self::Hopeless => "CANNOT",
        }
    }
}

/// One check: what it looked at, what it saw, and what follows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Check {
    /// What it looked at.
    pub name: &'static str,
    /// How it stands.
    pub standing: Standing,
    /// What was seen, with figures.
    pub seen: String,
    /// What to do about it, or why nothing helps; empty if it is good.
    pub remedy: String,
}

impl Check {
    pub(super) fn new(name: &'static str, standing: Standing, seen: String, remedy: &str) -> Self {
        Self { name, standing, seen, remedy: remedy.to_owned() }
    }
}

/// The conclusion of a checkup.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing is in the way of a shield.
    Works,
    /// This must be changed first.
    Change(String),
    /// It cannot help here, because of this.
    CannotHelp(String),
}

/// All checks, and what they come to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Checkup {
    /// In the order in which they are to be read.
    pub checks: Vec<Check>,
}

impl Checkup {
    /// From checks that were made.
    pub fn of(checks: Vec<Check>) -> Self {
        Self { checks }
    }

    /// The gravest check decides: what no setting helps, before what a setting would.
    pub fn verdict(&self) -> Verdict {
        let first = |standing| self.checks.iter().find(|check| check.standing == standing);
        match (first(Standing::Hopeless), first(Standing::Change)) {
            (Some(check), _) => Verdict::CannotHelp(format!("{}: {}", check.seen, check.remedy)),
            (None, Some(check)) => Verdict::Change(check.remedy.clone()),
            (None, None) => Verdict::Works,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Works => {
                f.write_str("it works, as far as random actions show: nothing is in the way of a shield")
            }
            Self::Change(remedy) => write!(f, "change this setting: {remedy}"),
            Self::CannotHelp(reason) => write!(f, "it cannot help here because {reason}"),
        }
    }
}

impl fmt::Display for Checkup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for Check { name, standing, seen, remedy } in &self.checks {
            writeln!(f, "{:<7} {name:<13} {seen}", standing.word())?;
            if !remedy.is_empty() {
                writeln!(f, "{:21} → {remedy}", "")?;
            }
        }
        write!(f, "verdict: {}", self.verdict())
    }
}
