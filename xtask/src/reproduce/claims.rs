//! The claims of the paper, and what our records say of each.

mod judging;

use super::record::{Record, Summary, Variant};
use judging::{
    BESIDE, THEN, aborts_in, alike, busy_note, fewer_at_return, fewer_resets, gain, medians, monotone,
    resets, shown, solve,
};
pub use judging::{Finding, Verdict};

/// With fewer there is no verdict.
const FEWEST_SEEDS: usize = 3;

/// A claim of the paper.
pub struct Claim {
    /// Its section.
    pub section: &'static str,
    pub environment: &'static str,
    /// The paper's words and figure.
    pub claim: &'static str,
    /// Whose record says something of it.
    pub experiment: &'static str,
    /// The variants that are compared.
    pub variants: &'static [&'static str],
    judge: fn(&[&Variant]) -> Option<Finding>,
}

impl Claim {
    /// What the record says; `None` where something was not measured, or with too few seeds.
    pub fn judge(&self, record: &Record) -> Option<Finding> {
        let measured =
            |name: &&str| record.variant(name).filter(|variant| variant.runs.len() >= FEWEST_SEEDS);
        let variants: Option<Vec<&Variant>> = self.variants.iter().map(measured).collect();
        (self.judge)(&variants?)
    }
}

// Section 6.2: the paper's text says N = 2, the names of its figures 4.
const PUSHER: Claim = Claim {
    section: "6.2",
    environment: "pusher",
    claim: "half the hard resets of the status quo at the same final reward",
    experiment: "pusher-small",
    variants: &["status-quo", "attempts-2"],
    judge: |variants| fewer_at_return(variants, 50.0, 90.0),
};
const CHEETAH: Claim = Claim {
    section: "6.2",
    environment: "cliff cheetah",
    claim: "ten times fewer hard resets than the status quo, and a substantially higher reward",
    experiment: "cliff-cheetah-small",
    variants: &["status-quo", "attempts-2"],
    judge: |variants| fewer_at_return(variants, 90.0, 120.0),
};

/// All claims, in the order of the paper.
pub const CLAIMS: &[Claim] = &[
    Claim {
        section: "5",
        environment: "gridworld",
        claim: "Q_min 0 → 0.4: 78% fewer hard resets, no more steps to solve",
        experiment: "gridworld-qmin",
        variants: &["q_min-0", "q_min-0.4"],
        judge: |variants| {
            let Finding { ours, verdict } = fewer_resets(variants, 78.0)?;
            let steps = medians(variants, solve)?;
            let ours = format!("{ours}; steps to solve {}", shown(variants, solve, 0, THEN)?);
            Some(Finding { ours, verdict: verdict.and(Verdict::if_so(steps[1] <= steps[0] * 1.1)) })
        },
    },
    Claim {
        section: "5",
        environment: "gridworld",
        claim: "most aborts happen beside the start, before the absorbing cell south-east of it",
        experiment: "gridworld-aborts",
        variants: &["south-east"],
        judge: |variants| aborts_in(variants, &[1, 5, 7, 11], "around that absorbing cell"),
    },
    Claim {
        section: "5",
        environment: "gridworld",
        claim: "with two goals, most aborts happen beside the absorbing one",
        experiment: "gridworld-aborts",
        variants: &["two-goals"],
        judge: |variants| aborts_in(variants, &[3, 9], "beside the absorbing goal"),
    },
    Claim {
        section: "6.1",
        environment: "ball in cup",
        claim: "without hard resets, ours learns to catch from below and forward-only fails; status quo is the upper bound",
        experiment: "ball-in-cup-small",
        variants: &["ours", "forward-only", "status-quo"],
        judge: |variants| {
            let (returns, resets) = (medians(variants, gain)?, medians(variants, resets)?);
            let ours = format!(
                "return {} (ours / forward-only / status quo); hard resets {:.0} / {:.0} / {:.0}",
                shown(variants, gain, 1, BESIDE)?,
                resets[0],
                resets[1],
                resets[2]
            );
            let [ours_return, forward_only, status_quo] = [returns[0], returns[1], returns[2]];
            let learns = Verdict::if_so(resets[0] == 0.0 && ours_return >= status_quo / 2.0);
            Some(Finding { ours, verdict: learns.and(Verdict::if_so(forward_only < ours_return / 2.0)) })
        },
    },
    PUSHER,
    CHEETAH,
    Claim { section: "6.2 (N = 4)", variants: &["status-quo", "attempts-4"], ..PUSHER },
    Claim { section: "6.2 (N = 4)", variants: &["status-quo", "attempts-4"], ..CHEETAH },
    Claim {
        section: "6.3",
        environment: "pusher",
        claim: "a larger Q_min: 33% fewer hard resets at nearly the same reward",
        experiment: "pusher-small",
        variants: &["attempts-1", "q_min-45"],
        judge: |variants| fewer_at_return(variants, 33.0, 90.0),
    },
    Claim {
        section: "6.3",
        environment: "cliff cheetah",
        claim: "Q_min = 10 prevents 69% of the status quo’s hard resets",
        experiment: "cliff-cheetah-small",
        variants: &["status-quo", "attempts-1"],
        judge: |variants| {
            let Finding { ours, verdict } = fewer_resets(variants, 69.0)?;
            Some(Finding { ours: ours + busy_note(variants)?, verdict })
        },
    },
    Claim {
        section: "6.3",
        environment: "pusher",
        claim: "a lower Q_min gives more hard resets (here 10 → 45 → 55)",
        experiment: "pusher-small",
        variants: &["attempts-1", "q_min-45", "q_min-55"],
        judge: monotone,
    },
    Claim {
        section: "6.3",
        environment: "cliff cheetah",
        claim: "a lower Q_min gives more hard resets (here 10 → 30 → 50)",
        experiment: "cliff-cheetah-small",
        variants: &["attempts-1", "q_min-30", "q_min-50"],
        judge: monotone,
    },
    Claim {
        section: "6.4",
        environment: "pusher",
        claim: "N = 1: 64% fewer hard resets than the status quo",
        experiment: "pusher-small",
        variants: &["status-quo", "attempts-1"],
        judge: |variants| fewer_resets(variants, 64.0),
    },
    Claim {
        section: "6.4",
        environment: "pusher",
        claim: "N = 4 instead of 1: another 2.5 times fewer (60%), reward loss below 25%",
        experiment: "pusher-small",
        variants: &["attempts-1", "attempts-4"],
        judge: |variants| fewer_at_return(variants, 60.0, 75.0),
    },
    Claim {
        section: "6.4",
        environment: "cliff cheetah",
        claim: "more attempts: hard resets near 0, reward unchanged (here N = 1 → 2 → 4)",
        experiment: "cliff-cheetah-small",
        variants: &["attempts-1", "attempts-2", "attempts-4"],
        judge: |variants| fewer_at_return(variants, 90.0, 90.0),
    },
    Claim {
        section: "6.5",
        environment: "pusher",
        claim: "one member alone fails and still needs many resets; more members, slightly fewer resets (here 1 → 5 → 10)",
        experiment: "pusher-small",
        variants: &["members-1", "q_min-45", "members-10"],
        judge: |variants| {
            let Finding { ours, verdict } = monotone(variants)?;
            let returns = medians(variants, gain)?;
            let ours = format!("{ours}; return {}", shown(variants, gain, 1, THEN)?);
            Some(Finding { ours, verdict: verdict.and(Verdict::if_so(returns[0] < returns[1] * 0.75)) })
        },
    },
    Claim {
        section: "6.6",
        environment: "peg insertion",
        claim: "ours solves the sparse task, its resets level off; insert-only never improves",
        experiment: "peg-insertion-small",
        variants: &["ours", "insert-only"],
        judge: |variants| {
            let rate: fn(&Summary) -> Option<f64> = |summary| summary.success_rate.map(|rate| rate * 100.0);
            let rates = medians(variants, rate)?;
            let ours = format!(
                "success {} %; hard resets {} (ours / insert-only)",
                shown(variants, rate, 0, BESIDE)?,
                shown(variants, resets, 0, BESIDE)?
            );
            let verdict = Verdict::if_so(rates[0] >= 50.0).and(Verdict::if_so(rates[1] < 10.0));
            let verdict = if rates[0] == 0.0 { Verdict::Fails } else { verdict };
            Some(Finding { ours, verdict })
        },
    },
    Claim {
        section: "A",
        environment: "gridworld",
        claim: "only optimistic explores at a large Q_min; mean and min fail (here at 0.6)",
        experiment: "gridworld-combine",
        variants: &["optimistic-0.6", "realist-0.6", "pessimistic-0.6"],
        judge: |variants| {
            let returns = medians(variants, gain)?;
            let steps = shown(variants, solve, 0, BESIDE)?;
            let verdict =
                Verdict::if_so(returns[0] > 0.0).and(Verdict::if_so(returns[1] + returns[2] == 0.0));
            let ours = format!(
                "return {}; steps to solve {steps} (max / mean / min)",
                shown(variants, gain, 0, BESIDE)?
            );
            Some(Finding { ours, verdict })
        },
    },
    Claim {
        section: "A",
        environment: "pusher",
        claim: "the way of combining matters little (max / mean / min)",
        experiment: "pusher-small",
        variants: &["optimistic", "realist", "q_min-45"],
        judge: alike,
    },
    Claim {
        section: "A",
        environment: "cliff cheetah",
        claim: "the way of combining matters little (max / mean / min)",
        experiment: "cliff-cheetah-small",
        variants: &["optimistic", "realist", "q_min-30"],
        judge: alike,
    },
    Claim {
        section: "A",
        environment: "cliff walker",
        claim: "the way of combining matters little (max / mean / min)",
        experiment: "cliff-walker-small",
        variants: &["optimistic", "realist", "pessimistic"],
        judge: alike,
    },
    Claim {
        section: "6.3 (stand-in)",
        environment: "cart",
        claim: "a lower Q_min gives more hard resets (here 0 → 1 → 10)",
        experiment: "cart-small",
        variants: &["q_min-0", "q_min-1", "shielded"],
        judge: monotone,
    },
    Claim {
        section: "6.4 (stand-in)",
        environment: "cart",
        claim: "more attempts, fewer hard resets (here N = 1 → 2 → 4)",
        experiment: "cart-small",
        variants: &["shielded", "attempts-2", "attempts-4"],
        judge: monotone,
    },
    Claim {
        section: "6.5 (stand-in)",
        environment: "cart",
        claim: "more members, fewer hard resets (here 1 → 5 → 20)",
        experiment: "cart-small",
        variants: &["members-1", "shielded", "members-20"],
        judge: monotone,
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::experiments::PAPER;

    #[test]
    fn every_claim_names_an_existing_experiment() {
        for claim in CLAIMS {
            assert!(PAPER.iter().any(|experiment| experiment.name == claim.experiment), "{}", claim.claim);
        }
    }

    fn record(resets: [u64; 2], returns: [f64; 2]) -> Record {
        let run = |at: usize| {
            serde_json::json!({"summary": {
                "steps": 100, "forward_steps": 80, "early_aborts": 0, "hard_resets": resets[at], "irreversible_entries": 0,
                "final_return": returns[at], "best_return": null, "lifetime_return": null, "success_rate": null, "steps_to_solve": null}, "aborts": null})
        };
        let names = ["status-quo", "attempts-2"];
        let variant = |at: usize| serde_json::json!({"name": names[at], "runs": [run(at), run(at), run(at)]});
        serde_json::from_value(serde_json::json!({"variants": [variant(0), variant(1)]})).unwrap()
    }

    #[test]
    fn a_verdict_follows_from_the_figures() {
        let claim = CLAIMS.iter().find(|claim| claim.environment == "pusher").unwrap();
        let judge = |record: &Record| claim.judge(record).map(|finding| finding.verdict);
        assert_eq!(judge(&record([100, 40], [60.0, 58.0])), Some(Verdict::Holds));
        assert_eq!(judge(&record([100, 40], [60.0, 20.0])), Some(Verdict::InPart));
        assert_eq!(judge(&record([100, 90], [60.0, 20.0])), Some(Verdict::Fails));
        assert_eq!(judge(&Record { variants: Vec::new() }), None, "nothing was measured");
        let mut one_seed = record([100, 40], [60.0, 58.0]);
        one_seed.variants[1].runs.truncate(1);
        assert_eq!(judge(&one_seed), None, "one seed proves nothing");
    }

    #[test]
    fn variants_that_never_abort_leave_a_claim_untested() {
        let mut measured = record([50, 50], [60.0, 60.0]);
        let judge = |record: &Record| alike(&record.variants.iter().collect::<Vec<_>>()).unwrap().verdict;
        assert_eq!(judge(&measured), Verdict::Untested);
        measured.variants[0].runs.iter_mut().for_each(|run| run.summary.early_aborts = 3);
        assert_eq!(judge(&measured), Verdict::Holds);
    }
}
