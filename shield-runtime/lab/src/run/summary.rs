//! `summary.json`: what a run came to, in one object. Keys are added, never renamed.

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

use super::attempts::AttemptSummary;
use shield_core::{
    diagnosis::Found,
    events::{Counters, EvaluationEvent},
};

/// Which run it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Name of the experiment.
    pub experiment: String,
    /// Name of the variant.
    pub variant: String,
    /// Seed.
    pub seed: u64,
}

/// What messages call the run.
impl fmt::Display for Identity {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} seed {}", self.variant, self.seed)
    }
}

/// Something that kept the shield from helping.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FoundInRun {
    /// Its name, which stays.
    pub name: String,
    /// What was seen, with figures, and what to do.
    pub sentence: String,
    /// Environment steps before.
    pub step: u64,
    /// It held no more at the end of the run.
    pub is_over: bool,
}

impl From<&Found> for FoundInRun {
    fn from(Found { finding, step, is_over }: &Found) -> Self {
        let (name, sentence) = (finding.name().into(), finding.to_string());
        Self { name, sentence, step: *step, is_over: *is_over }
    }
}

impl FoundInRun {
    /// When it was found, and whether it still held at the end of the run.
    pub fn when(&self) -> String {
        let end = if self.is_over { "no longer so at the end" } else { "still so at the end" };
        format!("after {} steps; {end}", self.step)
    }
}

/// The summary of a run. Only the four timing keys at its end differ between two runs of one seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the experiment.
    pub experiment: String,
    /// Name of the variant.
    pub variant: String,
    /// Seed.
    pub seed: u64,
    /// Whether all steps of the experiment were made, and nothing failed.
    pub complete: bool,
    /// Why the run failed, if it did.
    pub error: Option<String>,
    /// Environment steps of both phases.
    pub steps: u64,
    /// Those of forward episodes.
    pub forward_steps: u64,
    /// Sum of the forward rewards of all steps, of both phases; `None` of a run that did not count them.
    #[serde(default)]
    pub lifetime_return: Option<f64>,
    /// Forward episodes.
    pub forward_episodes: u64,
    /// Reset episodes.
    pub reset_episodes: u64,
    /// Forward episodes that the shield aborted.
    pub early_aborts: u64,
    /// Of these, aborts because something failed.
    pub failed_closed: u64,
    /// Rejected actions by cause, of either agent.
    pub rejected_by_cause: BTreeMap<String, u64>,
    /// Forward actions that were altered instead of aborted; they count as rejected, too.
    pub projections: u64,
    /// Forward actions that passed unjudged in the warm-up.
    pub warm_up_decisions: u64,
    /// Exploratory actions of the reset agent replaced by its greedy one.
    pub exploration_replaced: u64,
    /// Hard resets, the initial one excluded.
    pub hard_resets: u64,
    /// Their costs, summed.
    pub hard_reset_cost: f64,
    /// Hard resets by the environment's kinds of them; empty where all are alike.
    #[serde(default)]
    pub hard_resets_by_kind: BTreeMap<String, u64>,
    /// Attempts to get back to the start, and the risk.
    #[serde(flatten)]
    pub attempts: AttemptSummary,
    /// Entries into irreversible states.
    pub irreversible_entries: u64,
    /// Times that another process took the place of an isolated environment's; a hard reset follows each.
    pub worker_restarts: u64,
    /// Mean return of the last evaluation: with the shield, if it was evaluated with one.
    pub final_return: Option<f64>,
    /// The same without the shield; `None` where the figure above is without one.
    #[serde(default)]
    pub final_return_without_shield: Option<f64>,
    /// Mean return of the best evaluation.
    pub best_return: Option<f64>,
    /// Mean return of the best evaluation without the shield.
    #[serde(default)]
    pub best_return_without_shield: Option<f64>,
    /// Share of successful episodes in the last evaluation.
    pub success_rate: Option<f64>,
    /// The same without the shield.
    #[serde(default)]
    pub success_rate_without_shield: Option<f64>,
    /// First step after which three evaluations in a row succeeded; the budget if never.
    pub steps_to_solve: Option<u64>,
    /// Whether three evaluations in a row ever succeeded; `None` without evaluations, and of a run of version 1.0.
    #[serde(default)]
    pub solved: Option<bool>,
    /// What kept the shield from helping, the earliest first.
    #[serde(default)]
    pub findings: Vec<FoundInRun>,
    /// Whether a continued run equals an uninterrupted one.
    pub exact_resume: bool,
    /// Whether another run of the same seed gives the same results: not where decisions have a deadline.
    pub deterministic: bool,
    /// Wall-clock time of the run.
    pub wall_seconds: f64,
    /// Environment steps per second of it.
    pub steps_per_second: f64,
    /// Median time of a decision of the shield in microseconds.
    pub decision_us_p50: Option<f64>,
    /// 99th percentile of the same.
    pub decision_us_p99: Option<f64>,
}

/// What the evaluations of a run come to.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Evaluations {
    pub last: Option<EvaluationEvent>,
    pub best_return: Option<f64>,
    pub best_return_without_shield: Option<f64>,
    streak: u32,
    streak_start: u64,
    solved: Option<u64>,
}

impl Evaluations {
    pub fn add(&mut self, evaluation: &EvaluationEvent, solved_at: f64) {
        let EvaluationEvent { step, figures, without_shield } = *evaluation;
        if figures.success_rate >= solved_at {
            if self.streak == 0 {
                self.streak_start = step;
            }
            self.streak += 1;
        } else {
            self.streak = 0;
        }
        if self.streak == 3 && self.solved.is_none() {
            self.solved = Some(self.streak_start);
        }
        let better = |best: Option<f64>, now: f64| Some(best.map_or(now, |best| best.max(now)));
        self.best_return = better(self.best_return, figures.mean_return);
        if let Some(bare) = without_shield {
            self.best_return_without_shield = better(self.best_return_without_shield, bare.mean_return);
        }
        self.last = Some(*evaluation);
    }

    /// First step of the first three successes in a row; `budget` if there were evaluations but never three.
    pub fn steps_to_solve(&self, budget: u64) -> Option<u64> {
        self.last.map(|_| self.solved.unwrap_or(budget))
    }

    /// Whether three evaluations in a row ever succeeded, if there were evaluations.
    pub fn is_solved(&self) -> Option<bool> {
        self.last.map(|_| self.solved.is_some())
    }
}

impl Summary {
    /// Steps after which the task was solved, for people: infinite if it never was. `None` without an evaluation.
    pub fn steps_until_solved(&self) -> Option<f64> {
        let steps = self.steps_to_solve?;
        // In version 1.0 the budget alone says it: two more evaluations follow the first success.
        let is_solved = self.solved.unwrap_or(steps < self.steps);
        Some(if is_solved { steps as f64 } else { f64::INFINITY })
    }

    /// A summary of what was counted; evaluations and times are still empty, and whether the run is complete its recorder knows.
    pub fn new(identity: &Identity, counters: &Counters) -> Self {
        Self {
            experiment: identity.experiment.clone(),
            variant: identity.variant.clone(),
            seed: identity.seed,
            complete: false,
            error: None,
            steps: counters.steps,
            forward_steps: counters.forward_steps,
            lifetime_return: Some(counters.lifetime_return),
            forward_episodes: counters.forward_episodes,
            reset_episodes: counters.reset_episodes,
            early_aborts: counters.early_aborts,
            failed_closed: counters.failed_closed,
            rejected_by_cause: BTreeMap::new(),
            projections: counters.projections,
            warm_up_decisions: counters.warm_up_decisions,
            exploration_replaced: counters.exploration_replaced,
            hard_resets: counters.hard_resets,
            hard_reset_cost: counters.hard_reset_cost,
            hard_resets_by_kind: BTreeMap::new(),
            attempts: AttemptSummary::default(),
            irreversible_entries: counters.irreversible_entries,
            worker_restarts: counters.worker_restarts,
            final_return: None,
            final_return_without_shield: None,
            best_return: None,
            best_return_without_shield: None,
            success_rate: None,
            success_rate_without_shield: None,
            steps_to_solve: None,
            solved: None,
            findings: Vec::new(),
            exact_resume: false,
            deterministic: true,
            wall_seconds: 0.0,
            steps_per_second: 0.0,
            decision_us_p50: None,
            decision_us_p99: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use shield_core::events::EvaluationFigures;

    use super::*;

    fn evaluate(successes: &[f64], solved_at: f64) -> Option<u64> {
        let mut evaluations = Evaluations::default();
        for (index, success_rate) in successes.iter().enumerate() {
            let step = (index as u64 + 1) * 100;
            let bare = EvaluationFigures { mean_return: -1.0 - step as f64, ..EvaluationFigures::default() };
            let figures = EvaluationFigures { success_rate: *success_rate, ..EvaluationFigures::default() };
            evaluations.add(&EvaluationEvent { step, figures, without_shield: Some(bare) }, solved_at);
        }
        assert_eq!(evaluations.best_return_without_shield, evaluations.last.map(|_| -101.0));
        let steps = evaluations.steps_to_solve(9_999);
        assert_eq!(evaluations.is_solved(), steps.map(|steps| steps < 9_999));
        steps
    }

    #[test]
    fn a_run_that_was_never_solved_took_for_ever() {
        let identity = Identity { experiment: "e".into(), variant: "v".into(), seed: 0 };
        let counters = Counters { steps: 900, ..Counters::default() };
        let until = |steps_to_solve, solved| {
            let summary = Summary { steps_to_solve, solved, ..Summary::new(&identity, &counters) };
            summary.steps_until_solved()
        };
        assert_eq!(until(None, None), None);
        assert_eq!(until(Some(300), Some(true)), Some(300.0));
        assert_eq!(until(Some(900), Some(false)), Some(f64::INFINITY));
        // As version 1.0 wrote it, also of a run that was stopped before its last step.
        let old = [300, 900, 2_000].map(|steps| until(Some(steps), None));
        assert_eq!(old, [Some(300.0), Some(f64::INFINITY), Some(f64::INFINITY)]);
    }

    #[test]
    fn a_task_is_solved_at_the_first_of_three_successes_in_a_row() {
        assert_eq!(evaluate(&[], 1.0), None);
        assert_eq!(evaluate(&[1.0, 1.0, 0.9, 1.0], 1.0), Some(9_999));
        assert_eq!(evaluate(&[0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0], 1.0), Some(200));
        assert_eq!(evaluate(&[1.0, 1.0, 0.9, 1.0], 0.9), Some(100));
    }
}
