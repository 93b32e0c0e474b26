//! What the bytes between this plugin and `worker.py` mean.

use serde::{Deserialize, Serialize};
use shield_worker::Memory;

/// What the worker is asked, as a number at [`COMMAND`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    Make = 1,
    Reset = 2,
    Step = 3,
    Render = 4,
}

/// The worker did what it should.
pub const OK: u32 = 0;
/// The user must change something: the text says what.
pub const UNFIT: u32 = 1;

pub const COMMAND: usize = 0;
pub const STATUS: usize = 4;
pub const SEED: usize = 8;
pub const REWARD: usize = 16;
pub const FLAGS: usize = 24;
const TEXT_LENGTH: usize = 28;
const TEXT: usize = 32;
/// Numbers as `f32`: of a new environment its bounds, later the action, behind it the observation, and behind that a picture.
pub const NUMBERS: usize = 1 << 20;
/// Room for observations of 16 million values; pages that nobody writes cost nothing.
pub const MEMORY: usize = NUMBERS + (64 << 20);

pub const TERMINATED: u32 = 2;
pub const SUCCESS: u32 = 4;

/// What to make.
#[derive(Debug, Serialize)]
pub struct Wanted<'a> {
    pub id: &'a str,
    /// Empty for none.
    pub import: &'a str,
    pub kwargs: serde_json::Map<String, serde_json::Value>,
}

/// What was made. The bounds of its boxes lie at [`NUMBERS`]: low and high of the observation, then of the action.
#[derive(Debug, Deserialize)]
pub struct Made {
    pub observation: SpaceSize,
    pub action: SpaceSize,
    pub time_limit: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum SpaceSize {
    Box { length: usize },
    Discrete { length: usize },
}

/// The size of a picture in pixels. Its bytes lie behind the observation.
#[derive(Debug, Deserialize)]
pub struct Drawn {
    pub width: usize,
    pub height: usize,
}

/// Leaves a text for the worker; false if there is no room for it.
pub fn write_text(memory: &mut Memory, text: &str) -> bool {
    let fits = text.len() <= NUMBERS - TEXT;
    if fits {
        memory.write(TEXT, text.as_bytes());
        memory.write(TEXT_LENGTH, &[text.len() as u32]);
    }
    fits
}

/// The text that the worker left.
pub fn read_text(memory: &Memory) -> String {
    let length = memory.get::<u32>(TEXT_LENGTH) as usize;
    let mut bytes = vec![0; length.min(NUMBERS - TEXT)];
    memory.read(TEXT, &mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}
