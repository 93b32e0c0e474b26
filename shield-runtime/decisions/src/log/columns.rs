//! The columns of a part.

use std::sync::Arc;

use anyhow::Result;
use parquet::{
    basic::{Compression, ConvertedType, Repetition, Type as PhysicalType},
    file::properties::{EnabledStatistics, WriterProperties, WriterPropertiesBuilder},
    schema::types::{ColumnPath, Type, TypePtr},
};

use super::ROWS;
use crate::read::DecisionRow;
use shield_core::events::DecisionEvent;

/// The kinds of figures of a decision, in the order of their columns.
const KINDS: [&str; 11] = [
    "observation",
    "proposed",
    "previous",
    "executed",
    "value",
    "greedy_value",
    "forward_value",
    "probability",
    "greedy_probability",
    "start_probability",
    "score",
];

/// The figures of a decision, of each kind.
pub(super) type Numbers<'a> = [&'a [f32]; KINDS.len()];

/// The figures of a decision that is recorded now.
pub(super) fn of_event<'a>(record: &DecisionEvent<'a>) -> Numbers<'a> {
    let judgement = record.judgement;
    [
        record.observation,
        record.proposed,
        record.previous.unwrap_or_default(),
        record.executed.unwrap_or_default(),
        &judgement.values,
        &judgement.greedy_values,
        &judgement.forward_values,
        &judgement.probabilities,
        &judgement.greedy_probabilities,
        &judgement.start_probabilities,
        &judgement.scores,
    ]
}

/// The figures of a decision that was written before.
pub(super) fn of_row(row: &DecisionRow) -> Numbers<'_> {
    [
        &row.observation,
        &row.proposed,
        &row.previous,
        &row.executed,
        &row.values,
        &row.greedy_values,
        &row.forward_values,
        &row.probabilities,
        &row.greedy_probabilities,
        &row.start_probabilities,
        &row.scores,
    ]
}

impl DecisionRow {
    /// Where figures of a kind belong; `None` for another name.
    pub(crate) fn numbers(&mut self, kind: &str) -> Option<&mut Vec<f32>> {
        Some(match kind {
            "observation" => &mut self.observation,
            "proposed" => &mut self.proposed,
            "previous" => &mut self.previous,
            "executed" => &mut self.executed,
            "value" => &mut self.values,
            "greedy_value" => &mut self.greedy_values,
            "forward_value" => &mut self.forward_values,
            "probability" => &mut self.probabilities,
            "greedy_probability" => &mut self.greedy_probabilities,
            "start_probability" => &mut self.start_probabilities,
            "score" => &mut self.scores,
            _ => return None,
        })
    }
}

/// How many figures of each kind a decision has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Widths([usize; KINDS.len()]);

impl Widths {
    /// As the first decision has them: the actions executed before and now are as long as the proposed one, also where there are none.
    pub fn of(numbers: Numbers<'_>) -> Self {
        let mut widths = numbers.map(<[f32]>::len);
        let [_, proposed, previous, executed, ..] = &mut widths;
        (*previous, *executed) = (*proposed, *proposed);
        Self(widths)
    }

    /// The columns of numbers in their order: a name, and how many there are of it.
    pub fn columns(self) -> impl Iterator<Item = (&'static str, usize)> {
        KINDS.into_iter().zip(self.0)
    }

    pub fn total(self) -> usize {
        self.0.iter().sum()
    }
}

/// Columns of texts, in their order before the numbers.
pub(super) const TEXTS: [&str; 3] = ["phase", "verdict", "cause"];

pub(super) fn schema(widths: Widths) -> Result<TypePtr> {
    let column = |name: &str, physical, converted| {
        Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::REQUIRED)
            .with_converted_type(converted)
            .build()
            .map(Arc::new)
    };
    let mut fields = vec![column("step", PhysicalType::INT64, ConvertedType::NONE)?];
    for name in TEXTS {
        fields.push(column(name, PhysicalType::BYTE_ARRAY, ConvertedType::UTF8)?);
    }
    fields.push(column("state", PhysicalType::BYTE_ARRAY, ConvertedType::NONE)?);
    for (name, count) in widths.columns() {
        for index in 0..count {
            fields.push(column(&format!("{name}_{index}"), PhysicalType::FLOAT, ConvertedType::NONE)?);
        }
    }
    Ok(Arc::new(Type::group_type_builder("decisions").with_fields(fields).build()?))
}

/// Numbers seldom repeat: a dictionary of them, and their extremes, would take most of the time and be of no use.
pub(super) fn properties() -> WriterProperties {
    let plain = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_max_row_group_row_count(Some(ROWS))
        .set_statistics_enabled(EnabledStatistics::None)
        .set_dictionary_enabled(false);
    let with_texts = |properties, name| {
        WriterPropertiesBuilder::set_column_dictionary_enabled(properties, ColumnPath::from(name), true)
    };
    TEXTS.into_iter().fold(plain, with_texts).build()
}
