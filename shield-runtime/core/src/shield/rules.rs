//! Rules composed by `All` and `Any`.

use shield_api::{AbortRule, Error, Result};

/// The most combinations of branches; each is a program of its own in a projection.
const MOST_PROGRAMS: usize = 64;

/// A rule, or several composed.
pub enum RuleTree {
    /// One rule.
    Rule(Box<dyn AbortRule>),
    /// One rule whose rows a projection may exceed; see [`soft`](Self::soft).
    Soft {
        /// What an excess of s costs: priority · s² / 2, beside the distance² / 2 of the action.
        priority: f32,
        /// The rule.
        rule: Box<dyn AbortRule>,
    },
    /// Every one must allow the action.
    All(Vec<RuleTree>),
    /// One is enough.
    Any(Vec<RuleTree>),
}

impl RuleTree {
    /// A rule whose linear rows may be exceeded while another action is looked for, at a price: the one of the lower priority gives way
    /// first. The rule itself is not softened: it judges what was found by its true values.
    pub fn soft(priority: f32, rule: Box<dyn AbortRule>) -> Self {
        Self::Soft { priority, rule }
    }
}

impl From<Vec<Box<dyn AbortRule>>> for RuleTree {
    fn from(rules: Vec<Box<dyn AbortRule>>) -> Self {
        Self::All(rules.into_iter().map(Self::Rule).collect())
    }
}

/// How the rules of a list, by their indices, are composed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Shape {
    Rule(usize),
    All(Vec<Shape>),
    Any(Vec<Shape>),
}

impl Shape {
    /// Takes the rules out of a tree, with their priorities where they are soft.
    pub fn of(tree: RuleTree, rules: &mut Vec<(Box<dyn AbortRule>, Option<f32>)>) -> Result<Self> {
        let mut keep = |rule, priority| {
            rules.push((rule, priority));
            Ok(Self::Rule(rules.len() - 1))
        };
        match tree {
            RuleTree::Rule(rule) => keep(rule, None),
            RuleTree::Soft { priority, rule } => {
                let is_valid = priority.is_finite() && priority > 0.0;
                if !is_valid {
                    let message = format!("the priority {priority} is not finite and above 0");
                    return Err(Error::invalid_config(message));
                }
                keep(rule, Some(priority))
            }
            RuleTree::All(parts) => Self::parts(parts, rules).map(Self::All),
            RuleTree::Any(parts) => Self::parts(parts, rules).map(Self::Any),
        }
    }

    fn parts(parts: Vec<RuleTree>, rules: &mut Vec<(Box<dyn AbortRule>, Option<f32>)>) -> Result<Vec<Self>> {
        if parts.is_empty() {
            return Err(Error::invalid_config("`All` and `Any` need at least one rule"));
        }
        parts.into_iter().map(|part| Self::of(part, rules)).collect()
    }

    /// Whether the action is allowed, if each rule for itself says `allows`.
    pub fn holds(&self, allows: &impl Fn(usize) -> bool) -> bool {
        match self {
            Self::Rule(rule) => allows(*rule),
            Self::All(parts) => parts.iter().all(|part| part.holds(allows)),
            Self::Any(parts) => parts.iter().any(|part| part.holds(allows)),
        }
    }

    /// Hands the rules to `blame` because of which the action is not allowed: the first of `All` that does not hold, every one of `Any`.
    pub fn blame(&self, allows: &impl Fn(usize) -> bool, blame: &mut impl FnMut(usize)) {
        match self {
            Self::Rule(rule) => blame(*rule),
            Self::All(parts) => {
                if let Some(part) = parts.iter().find(|part| !part.holds(allows)) {
                    part.blame(allows, blame);
                }
            }
            Self::Any(parts) => parts.iter().for_each(|part| part.blame(allows, blame)),
        }
    }

    /// Every set of rules that together are enough: one branch of each `Any`, all of each `All`.
    pub fn programs(&self) -> Result<Vec<Vec<usize>>> {
        let too_many = || {
            Error::invalid_config(format!(
                "the branches of `Any` combine in more than {MOST_PROGRAMS} ways, each of which is a program to be solved"
            ))
        };
        let mut found = match self {
            Self::Rule(rule) => vec![vec![*rule]],
            Self::Any(parts) => {
                let branches: Result<Vec<_>> = parts.iter().map(Self::programs).collect();
                branches?.concat()
            }
            Self::All(parts) => {
                let mut all = vec![Vec::new()];
                for part in parts {
                    let branches = part.programs()?;
                    if all.len() * branches.len() > MOST_PROGRAMS {
                        return Err(too_many());
                    }
                    let join = |so_far: &Vec<usize>, branch: &Vec<usize>| [&so_far[..], branch].concat();
                    all = all.iter().flat_map(|one| branches.iter().map(move |two| join(one, two))).collect();
                }
                all
            }
        };
        found.iter_mut().for_each(|program| program.sort_unstable());
        if found.len() > MOST_PROGRAMS { Err(too_many()) } else { Ok(found) }
    }
}

#[cfg(test)]
mod tests {
    use super::Shape::{self, All, Any, Rule};

    fn shape() -> Shape {
        All(vec![Rule(0), Any(vec![Rule(1), All(vec![Rule(2), Rule(3)])])])
    }

    #[test]
    fn all_needs_every_rule_and_any_needs_one_branch() {
        let holds = |allowed: &[usize]| shape().holds(&|rule| allowed.contains(&rule));
        assert!(holds(&[0, 1]) && holds(&[0, 2, 3]));
        assert!(!holds(&[1, 2, 3]) && !holds(&[0, 2]) && !holds(&[0]) && !holds(&[]));
        assert_eq!(shape().programs().unwrap(), [vec![0, 1], vec![0, 2, 3]]);
    }

    #[test]
    fn the_rules_that_reject_are_blamed() {
        let blamed = |allowed: &[usize]| {
            let mut blamed = Vec::new();
            shape().blame(&|rule| allowed.contains(&rule), &mut |rule| blamed.push(rule));
            blamed
        };
        assert_eq!(blamed(&[1]), [0]);
        assert_eq!(blamed(&[0, 2]), [1, 3]);
        assert_eq!(blamed(&[0]), [1, 2]);
    }

    #[test]
    fn more_than_64_programs_are_refused() {
        let pair = |first| Any(vec![Rule(first), Rule(first + 1)]);
        assert_eq!(All((0..6).map(|index| pair(2 * index)).collect()).programs().unwrap().len(), 64);
        assert!(All((0..7).map(|index| pair(2 * index)).collect()).programs().is_err());
        assert!(Any((0..65).map(Rule).collect()).programs().is_err());
    }
}
