//! What runs came to, for people: records, figures, and one page.

mod attempts;
mod check;
mod columns;
mod course;
mod draw;
mod figures;
mod page;
mod picture;
mod places;
mod record;
mod statistics;

pub use attempts::{ATTEMPT_COLUMNS, ATTEMPT_NOTE, Diagram, Forecasts, has_attempts};
pub use columns::{COLUMNS, Cell, Column, forward_share};
pub use course::{Course, EvaluationCourse};
pub use draw::{png, svg, titled};
pub use figures::{Band, Dots, FIGURE_NAMES, Figure, HeatMap, Lines, Row, figures};
pub use page::page;
pub use picture::Picture;
pub use places::Places;
pub use record::{Record, RunRecord, VariantRecord, natural_order};
pub use statistics::{Spread, median, show};
