//! What kept shields from helping, after the table of an experiment.

use shield_lab::run::{FoundInRun, Summary};

/// A line for each finding of each variant, with the seeds that have it and the words of the first.
pub fn notes(variants: &[String], runs: &[Summary]) -> Vec<String> {
    let mut notes = Vec::new();
    for variant in variants {
        let of_variant: Vec<&Summary> = runs.iter().filter(|run| run.variant == *variant).collect();
        let mut known: Vec<&str> = Vec::new();
        for found in of_variant.iter().flat_map(|run| &run.findings) {
            let FoundInRun { name, sentence, .. } = found;
            if known.contains(&name.as_str()) {
                continue;
            }
            known.push(name);
            let has_it = |run: &&&Summary| run.findings.iter().any(|found| found.name == *name);
            let mut seeds: Vec<u64> = of_variant.iter().filter(has_it).map(|run| run.seed).collect();
            seeds.sort_unstable();
            let seeds = seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
            notes.push(printable(&format!(
                "note: {variant}, seed {seeds}: {sentence} [{name}, {}]",
                found.when()
            )));
        }
    }
    notes
}

/// A record may come from anywhere: no control character of it reaches the terminal.
pub fn printable(text: &str) -> String {
    text.chars()
        .map(|letter| if letter.is_control() { char::REPLACEMENT_CHARACTER } else { letter })
        .collect()
}

#[cfg(test)]
mod tests {
    use shield_core::events::Counters;
    use shield_lab::run::Identity;

    use super::*;

    fn run(variant: &str, seed: u64, findings: &[(&str, &str)]) -> Summary {
        let identity = Identity { experiment: "e".into(), variant: variant.into(), seed };
        let findings = findings.iter().map(|(name, sentence)| FoundInRun {
            name: (*name).into(),
            sentence: (*sentence).into(),
            step: 1_000,
            is_over: seed == 1,
        });
        Summary { findings: findings.collect(), ..Summary::new(&identity, &Counters::default()) }
    }

    #[test]
    fn a_finding_of_several_seeds_is_one_line() {
        let runs = [
            run("b", 1, &[("no-success", "10 attempts")]),
            run("a", 0, &[]),
            run("b", 0, &[("slow-return", "60 steps"), ("no-success", "12 attempts\u{1b}[31m")]),
        ];
        let notes = notes(&["a".into(), "b".into()], &runs);
        assert_eq!(notes.len(), 2, "{notes:?}");
        assert_eq!(
            notes[0],
            "note: b, seed 0, 1: 10 attempts [no-success, after 1000 steps; no longer so at the end]"
        );
        assert!(!printable("\u{1b}[31m").contains('\u{1b}'));
    }
}
