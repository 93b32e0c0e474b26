//! A run on disk: its folder, its tables, its summary.

mod accepted_risk;
mod attempt_log;
mod attempts;
mod build;
mod calibration;
mod counterfactual;
mod files;
mod folder;
mod go_on;
mod launch;
mod new_folder;
mod recorded;
mod recorder;
mod replay;
mod summary;
mod tables;

pub use accepted_risk::AcceptedRisk;
pub use attempts::{AttemptSummary, RecordedAttempt, last_half, read_attempts, reliability};
pub use build::prepare;
pub use calibration::{CalibrationBin, calibration};
pub use counterfactual::{Counterfactual, counterfactual};
pub use folder::{RunFolder, write_in_folder};
pub use launch::{Launch, Restored, Run, Standing, provenance, restore};
pub use new_folder::NewFolder;
pub use recorded::Recorded;
pub use recorder::{Recorder, RecorderState};
pub use replay::{Replay, replay};
pub use shield_decisions::{DecisionRow, read_decisions};
pub use summary::{FoundInRun, Identity, Summary};
