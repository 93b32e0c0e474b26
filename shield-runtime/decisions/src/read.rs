//! Reading decisions back.

use std::{collections::HashMap, path::Path};

use anyhow::{Context, Result, anyhow, ensure};
use parquet::{
    file::reader::{FileReader, SerializedFileReader},
    record::Field,
};
use shield_api::regular_file;

use crate::{contained::contained, log::paths};

/// One recorded decision.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DecisionRow {
    /// Environment steps before it.
    pub step: u64,
    /// `forward` or `reset`.
    pub phase: String,
    /// `allow`, `warm_up`, `project`, `replace` or `abort`.
    pub verdict: String,
    /// Why it was rejected; empty if it was not.
    pub cause: String,
    /// The environment's state, if it was kept; else empty.
    pub state: Vec<u8>,
    /// What was observed.
    pub observation: Vec<f32>,
    /// The proposed action.
    pub proposed: Vec<f32>,
    /// The action executed before; NaN after a hard reset.
    pub previous: Vec<f32>,
    /// What was executed; NaN after an abort.
    pub executed: Vec<f32>,
    /// Each member's reset value of the proposed action.
    pub values: Vec<f32>,
    /// Each member's reset value of the reset agent's own action.
    pub greedy_values: Vec<f32>,
    /// Each member's forward value of the proposed action.
    pub forward_values: Vec<f32>,
    /// The success critic's estimates for the proposed action, a figure per member.
    pub probabilities: Vec<f32>,
    /// The same for the reset agent's own action.
    pub greedy_probabilities: Vec<f32>,
    /// The same where the last reset ended, for the reset agent's action there.
    pub start_probabilities: Vec<f32>,
    /// What each rule compared.
    pub scores: Vec<f32>,
}

impl DecisionRow {
    /// Whether it is about an action of the forward agent that the rules judged: the warm-up rejects nothing.
    pub fn is_judged_forward(&self) -> bool {
        self.phase == "forward" && self.verdict != "warm_up"
    }

    /// Whether the proposed action was not executed as it was proposed.
    pub fn was_rejected(&self) -> bool {
        matches!(self.verdict.as_str(), "project" | "replace" | "abort")
    }
}

/// Hands every recorded decision of a run to `take`, in their order, until it says `false`; returns how many there were.
///
/// # Errors
/// There are none, or a file is damaged.
pub fn read_decisions(run: &Path, mut take: impl FnMut(DecisionRow) -> Result<bool>) -> Result<u64> {
    let folder = run.join("decisions");
    let mut parts = paths(&folder)?;
    parts.retain(|path| path.extension().is_some_and(|extension| extension == "parquet"));
    ensure!(
        !parts.is_empty(),
        "{} has no recorded decisions; they need a shield, and `record: (decisions: 1)`",
        run.display()
    );
    let mut count = 0;
    for part in parts {
        let is_wanted = read_part(&part, &mut |row| {
            count += 1;
            take(row)
        })?;
        if !is_wanted {
            break;
        }
    }
    Ok(count)
}

/// Hands every decision of one part to `take`, until it says `false`; returns whether it never did. The library that reads a part panics at
/// some of the damage that it may have.
pub(crate) fn read_part(part: &Path, take: &mut dyn FnMut(DecisionRow) -> Result<bool>) -> Result<bool> {
    let unreadable = || format!("{} cannot be read", part.display());
    let damaged = || format!("{} is damaged", part.display());
    let file = regular_file::open(part).with_context(unreadable)?;
    let reader =
        contained(|| SerializedFileReader::new(file)).with_context(damaged)?.with_context(damaged)?;
    let schema = reader.metadata().file_metadata().schema_descr();
    let kinds = schema.columns().iter().filter_map(|column| {
        let (kind, _) = column.name().rsplit_once('_')?;
        Some((column.name().to_owned(), kind.to_owned()))
    });
    let kinds: HashMap<String, String> = kinds.collect();
    let mut rows = contained(|| reader.get_row_iter(None)).with_context(damaged)?.with_context(damaged)?;
    while let Some(row) = contained(|| rows.next()).with_context(damaged)? {
        let mut decision = DecisionRow::default();
        for (name, field) in row.with_context(damaged)?.get_column_iter() {
            fill(&mut decision, &kinds, name, field).ok_or_else(|| {
                anyhow!(
                    "{}: the column {name} is not known, or has a value that it cannot have",
                    part.display()
                )
            })?;
        }
        if !take(decision)? {
            return Ok(false);
        }
    }
    Ok(true)
}

fn fill(
    decision: &mut DecisionRow,
    columns: &HashMap<String, String>,
    name: &str,
    field: &Field,
) -> Option<()> {
    match (name, field) {
        ("step", Field::Long(step)) => decision.step = u64::try_from(*step).ok()?,
        ("phase", Field::Str(text)) => decision.phase.clone_from(text),
        ("verdict", Field::Str(text)) => decision.verdict.clone_from(text),
        ("cause", Field::Str(text)) => decision.cause.clone_from(text),
        ("state", Field::Bytes(bytes)) => decision.state = bytes.data().to_vec(),
        (name, Field::Float(value)) => decision.numbers(columns.get(name)?)?.push(*value),
        _ => return None,
    }
    Some(())
}
