//! What the bytes between host and guest mean. Both are the same program, so that nothing here is frozen.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use shield_api::{Error, ErrorKind, Space, Spaces, abi::status};
use shield_worker::Memory;

use crate::plugin::Kind;

/// What the guest is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Operation {
    /// The text is a [`Creation`]; the answer's a [`Created`].
    Create = 1,
    Reset,
    /// The text names the start.
    ResetTo,
    Step,
    /// The answer is an index, in the place of a state's length.
    ResetKind,
    Act,
    /// Keep the state; the answer says how long it is.
    Save,
    /// Hand out a piece of the state that was kept.
    TakePiece,
    /// Take a piece of a state; after the last, load it.
    GivePiece,
}

impl Operation {
    pub(super) fn from_code(code: u32) -> Option<Self> {
        use Operation::{Act, Create, GivePiece, Reset, ResetKind, ResetTo, Save, Step, TakePiece};
        [Create, Reset, ResetTo, Step, ResetKind, Act, Save, TakePiece, GivePiece]
            .into_iter()
            .find(|operation| *operation as u32 == code)
    }
}

pub(super) const OPERATION: usize = 0;
pub(super) const STATUS: usize = 4;
pub(super) const SEED: usize = 8;
/// Forward and reset reward.
pub(super) const REWARDS: usize = 16;
pub(super) const FLAGS: usize = 24;
/// Line and column of an error in the plugin's configuration; line 0 if unknown.
pub(super) const POSITION: usize = 28;
/// Length of a whole state, and where in it a piece begins: two `u64`.
pub(super) const STATE: usize = 40;
const METRICS_LENGTH: usize = 56;
const TEXT_LENGTH: usize = 60;
/// Figures of the plugin's own, as lines `name=value`.
const METRICS: usize = 64;
const TEXT: usize = 8 << 10;
/// Action, then observation; or a piece of a state.
pub(super) const NUMBERS: usize = 1 << 20;
/// The longest piece of a state, and room for 16 million numbers. Pages that nobody writes cost nothing.
pub(super) const PIECE: usize = 64 << 20;
pub(super) const MEMORY: usize = NUMBERS + PIECE;

/// Which instance to make.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Creation {
    /// Of the host: a guest of another version would read other bytes.
    pub version: String,
    pub kind: IsolatedKind,
    pub id: String,
    pub path: PathBuf,
    /// What the experiment pins the file to.
    pub sha256: Option<String>,
    pub config: String,
    pub seed: u64,
    pub threads: usize,
    /// `None` for an environment.
    pub spaces: Option<SpacesText>,
}

/// The kinds that can be isolated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum IsolatedKind {
    Environment,
    Policy,
}

impl From<IsolatedKind> for Kind {
    fn from(kind: IsolatedKind) -> Self {
        match kind {
            IsolatedKind::Environment => Self::Environment,
            IsolatedKind::Policy => Self::Policy,
        }
    }
}

/// What an environment says of itself.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Created {
    pub spaces: SpacesText,
    pub episode_length: usize,
    pub brings_reset_reward: bool,
    pub starts: Vec<String>,
    /// Names and costs.
    pub reset_kinds: Vec<(String, f64)>,
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SpacesText {
    observation: SpaceText,
    action: SpaceText,
}

#[derive(Debug, Serialize, Deserialize)]
enum SpaceText {
    Box { low: Vec<f32>, high: Vec<f32> },
    Discrete { n: usize },
}

impl From<&Spaces> for SpacesText {
    fn from(spaces: &Spaces) -> Self {
        let text = |space: &Space| match space.clone() {
            Space::Box { low, high } => SpaceText::Box { low, high },
            Space::Discrete { n } => SpaceText::Discrete { n },
        };
        Self { observation: text(&spaces.observation), action: text(&spaces.action) }
    }
}

impl From<SpacesText> for Spaces {
    fn from(text: SpacesText) -> Self {
        let space = |text| match text {
            SpaceText::Box { low, high } => Space::Box { low, high },
            SpaceText::Discrete { n } => Space::Discrete { n },
        };
        Self { observation: space(text.observation), action: space(text.action) }
    }
}

/// Leaves a text, cut at the end if there is no room for it.
pub(super) fn write_text(memory: &mut Memory, text: &str) {
    let length = text.floor_char_boundary(NUMBERS - TEXT);
    memory.write(TEXT, &text.as_bytes()[..length]);
    memory.write(TEXT_LENGTH, &[length as u32]);
}

pub(super) fn read_text(memory: &Memory) -> String {
    read_string(memory, TEXT, memory.get::<u32>(TEXT_LENGTH), NUMBERS - TEXT)
}

/// Whether a text is short enough to arrive whole.
pub(super) fn fits(text: &str) -> bool {
    text.len() <= NUMBERS - TEXT
}

pub(super) fn write_metrics(memory: &mut Memory, lines: &str) {
    let length = lines.len().min(TEXT - METRICS);
    memory.write(METRICS, &lines.as_bytes()[..length]);
    memory.write(METRICS_LENGTH, &[length as u32]);
}

/// The figures of the last call; empty, and without an allocation, for most plugins.
pub(super) fn read_metrics(memory: &Memory) -> String {
    match memory.get::<u32>(METRICS_LENGTH) {
        0 => String::new(),
        length => read_string(memory, METRICS, length, TEXT - METRICS),
    }
}

/// The length comes from a process that may have written anything.
fn read_string(memory: &Memory, offset: usize, length: u32, most: usize) -> String {
    let mut bytes = vec![0; (length as usize).min(most)];
    memory.read(offset, &mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

/// The status of an outcome.
pub(super) fn code(error: &Error) -> i32 {
    match error.kind() {
        ErrorKind::InvalidArgument => status::INVALID_ARGUMENT,
        ErrorKind::InvalidConfig => status::INVALID_CONFIG,
        ErrorKind::Unsupported => status::UNSUPPORTED,
        ErrorKind::Failed => status::FAILED,
        ErrorKind::Panicked => status::PANICKED,
    }
}

/// The class of failure behind a status.
pub(super) fn kind(code: i32) -> ErrorKind {
    match code {
        status::INVALID_ARGUMENT => ErrorKind::InvalidArgument,
        status::INVALID_CONFIG => ErrorKind::InvalidConfig,
        status::UNSUPPORTED => ErrorKind::Unsupported,
        status::PANICKED => ErrorKind::Panicked,
        _ => ErrorKind::Failed,
    }
}
