//! What is made of runs: records, figures, one page, films.

pub mod film;
pub mod report;
