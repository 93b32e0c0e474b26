//! RESULTS.md of Gymnasium's environments: a row for each, and below it what the shield said.

use super::TARGETED;
use super::record::{Record, Run, Shielded, Verdict};
use crate::reproduce::record::Spread;
use crate::reproduce::tables::{GAP, show, thousands};

const HEAD: &str = "# Results in Gymnasium's environments

Written by `cargo xtask reproduce gymnasium`: from the records in this folder, not by hand. It trains what is not recorded with
[`train.py`](train.py), two at a time, some minutes each; `cargo xtask reproduce gymnasium --no-run` only writes this page anew. `Pendulum-v1` and the
like name one environment.

The agent is PPO of Stable-Baselines3, and all of its settings and of the shield's are the usual ones: `shield.ShieldedEnv(gymnasium.make(…))`. With
the shield, the steps of the reset agent count like those of PPO, so that both trainings make the same number of steps. PPO ends a training within a
batch with the shield, and after a whole one without.

Each figure is the median over the seeds, with the smallest and the largest in brackets. Returns are means of five greedy episodes at the end: with
the shield, then the same agent without it, then the agent that was trained without. Behind the shield, the reset agent's steps belong to the episode,
and what follows a failed attempt earns nothing. Hard resets are those with the shield, the episodes those of PPO with the shield, and then the
episodes without it, each of which ends in a hard reset. The realised risk is the share of attempts that failed.

**The target** is that the shield works: at least 60% forward steps, hard resets after at most a fifth of the episodes, and no loss of return beyond
the spread (the return with the shield is below the median without by no more than the best seed without is above the worst); or that it says why it
does not within 2,000 steps. The first seven environments have the target. The others were chosen afterwards, and nothing was tried in them.

";

/// The page, from the records that there are.
pub fn page(records: &[(&str, Option<Record>)]) -> String {
    let mut page = HEAD.to_owned();
    page += "| environment | seeds | forward steps, % | hard resets, episodes, without | returns: with, without it, trained without | realised risk | target |\n";
    page += "|---|---|---|---|---|---|---|\n";
    for (index, (environment, record)) in records.iter().enumerate() {
        let name =
            if index < TARGETED { (*environment).to_owned() } else { format!("{environment} (no target)") };
        page += &record.as_ref().map_or_else(
            || format!("| {name} | 0 |{}\n", format!(" {GAP} |").repeat(5)),
            |record| row(&name, record),
        );
    }
    page += "\n## What the shield said\n\nThe step of each warning, by seed, and the first one in its own words.\n";
    for (environment, record) in records {
        if let Some(record) = record {
            page += &said(environment, record);
        }
    }
    page
}

fn row(name: &str, record: &Record) -> String {
    let ours = |figure: fn(&Run, &Shielded) -> Option<f64>, decimals| {
        let figures = record.shielded().filter_map(|(run, shielded)| figure(run, shielded));
        show(Spread::around(figures.collect()), decimals)
    };
    let plain = |figure: fn(&Run) -> f64, decimals| {
        show(Spread::around(record.plain().map(figure).collect()), decimals)
    };
    format!(
        "| {name} | {} | {} | {}, {}, {} | {}, {}, {} | {} | {} |\n",
        record.shielded().count(),
        ours(|_, shielded| Some(100.0 * shielded.forward_share()), 0),
        ours(|run, _| Some(run.hard_resets as f64), 0),
        ours(|_, shielded| Some(shielded.episodes as f64), 0),
        plain(|run| run.hard_resets as f64, 0),
        ours(|run, _| Some(run.gain), 1),
        ours(|_, shielded| Some(shielded.return_without_shield), 1),
        plain(|run| run.gain, 1),
        ours(|_, shielded| shielded.realised_risk(), 2),
        target(&record.verdicts()),
    )
}

/// How many seeds work, how many say why not and when, and how many do neither.
fn target(verdicts: &[Verdict]) -> String {
    let works = verdicts.iter().filter(|verdict| **verdict == Verdict::Works).count();
    let missed = verdicts.iter().filter(|verdict| **verdict == Verdict::Missed).count();
    let says: Vec<u64> = verdicts
        .iter()
        .filter_map(|verdict| if let Verdict::SaysWhy(step) = verdict { Some(*step) } else { None })
        .collect();
    let mut parts = Vec::new();
    if works > 0 {
        parts.push(format!("works: {works}"));
    }
    if let Some(latest) = says.iter().max() {
        parts.push(format!("says why: {}, by step {}", says.len(), thousands(*latest)));
    }
    if missed > 0 {
        parts.push(format!("**missed: {missed}**"));
    }
    if parts.is_empty() { GAP.into() } else { parts.join("; ") }
}

fn said(environment: &str, record: &Record) -> String {
    let mut text = format!("\n### {environment}, {} steps\n\n", thousands(record.steps));
    for (Run { seed, .. }, shielded) in record.shielded() {
        let told =
            |finding: &super::record::Finding| format!("{} ({})", finding.name, thousands(finding.step));
        let all: Vec<String> = shielded.findings.iter().map(told).collect();
        let all = if all.is_empty() { "nothing".into() } else { all.join(", ") };
        text += &format!("- seed {seed}: {all}\n");
    }
    if let Some(first) = record.shielded().find_map(|(_, shielded)| shielded.findings.first()) {
        text += "\n";
        wrapped(&first.text, 160).iter().for_each(|line| text += &format!("> {line}\n"));
    }
    text
}

/// The words in lines of at most so many characters.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + word.chars().count() < width => *line += &format!(" {word}"),
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::*;

    #[test]
    fn an_environment_is_a_row_with_its_verdicts() {
        let row = |record: Record| row("x", &record);
        let works = row(record(15_000, 10, 9.0, &[]));
        assert_eq!(works, "| x | 1 | 75 | 10, 100, 100 | 9.0, 3.0, 10.0 (8.0 to 12.0) | 0.20 | works: 1 |\n");
        assert!(row(record(5_000, 50, 1.0, &[1_234])).ends_with("| says why: 1, by step 1,234 |\n"));
        assert!(row(record(5_000, 50, 1.0, &[])).ends_with("| **missed: 1** |\n"));
    }

    #[test]
    fn the_page_shows_every_environment_and_what_was_said() {
        let page = page(&[("A-v1", Some(record(5_000, 50, 1.0, &[1_234]))), ("B-v1", None)]);
        assert!(page.contains("\n| B-v1 | 0 | – | – | – | – | – |\n"), "{page}");
        assert!(page.contains("- seed 0: no-success (1,234)\n\n> no | success [no-success]\n"), "{page}");
        assert!(page.lines().all(|line| line.chars().count() <= 200), "a line is too long");
    }

    #[test]
    fn words_are_wrapped_and_none_is_lost() {
        assert_eq!(wrapped("a bc def ghij", 9), ["a bc def", "ghij"]);
        assert_eq!(wrapped("endless", 3), ["endless"]);
    }

    #[test]
    fn verdicts_of_several_seeds_are_counted() {
        let verdicts =
            [Verdict::Works, Verdict::SaysWhy(900), Verdict::Missed, Verdict::SaysWhy(1_900), Verdict::Works];
        assert_eq!(target(&verdicts), "works: 2; says why: 2, by step 1,900; **missed: 1**");
        assert_eq!(target(&[]), "–");
    }
}
