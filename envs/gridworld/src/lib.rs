#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod map;
mod picture;

use map::Map;
use shield_api::{
    Checkpoint, Environment, EnvironmentSpec, Error, Frame, Plugin, Result, Setup, Space, Spaces,
    StepOutcome, check_length,
};

shield_api::config! {
    /// Settings of a gridworld.
    pub struct GridworldConfig {
        /// A map's name (south-east, two-goals, frozen-lake-4x4, frozen-lake-8x8) or a list of its rows: S start, . or F free,
        /// # wall, X or H absorbing, G goal, A absorbing goal.
        map: Map = Map::default() => "\"south-east\"",
        /// Steps of an episode. None takes the map's own: 100 for frozen-lake-8x8, else 30.
        horizon: Option<usize> = None,
    }
}

/// Directions, in the order of the actions (that of Gymnasium's frozen lake): west, south, east, north.
const ACTIONS: usize = 4;
const SAVE_MAGIC: &[u8; 8] = b"gridwrl1";

/// An agent in a map. Absorbing cells do not end the episode: the agent stays in them until a hard reset.
struct Gridworld {
    map: Map,
    horizon: usize,
    /// Where each action leads from each cell.
    successors: Vec<[usize; ACTIONS]>,
    /// What entering each cell, or staying in it, is worth.
    outcomes: Vec<StepOutcome>,
    action_space: Space,
    cell: usize,
}

impl Gridworld {
    fn write_observation(&self, observation: &mut [f32]) {
        observation.fill(0.0);
        observation[self.cell] = 1.0;
    }

    fn outcome(map: &Map, cell: usize) -> StepOutcome {
        let (kind, is_start) = (map.cells[cell], cell == map.start);
        StepOutcome {
            forward_reward: f32::from(u8::from(kind.is_goal())),
            reset_reward: f32::from(u8::from(is_start)),
            in_reset_set: is_start,
            terminated: false,
            success: kind.is_goal(),
            irreversible: kind.is_absorbing(),
        }
    }

    /// What a saved state belongs to: a state of one map means nothing in another.
    fn map_bytes(&self) -> impl Iterator<Item = u8> {
        let width = self.map.width as u64;
        width.to_le_bytes().into_iter().chain(self.map.cells.iter().map(|cell| *cell as u8))
    }
}

impl Plugin for Gridworld {
    type Config = GridworldConfig;

    fn create(config: GridworldConfig, _setup: &Setup) -> Result<Self> {
        let map = config.map;
        let horizon = config.horizon.unwrap_or(map.horizon);
        if horizon == 0 {
            let message = "horizon is 0; an episode has at least 1 step";
            return Err(Error::invalid_config(message).in_field("horizon"));
        }
        let cells = 0..map.cells.len();
        Ok(Self {
            horizon,
            successors: cells.clone().map(|cell| map.neighbours(cell)).collect(),
            outcomes: cells.map(|cell| Self::outcome(&map, cell)).collect(),
            action_space: Space::Discrete { n: ACTIONS },
            cell: map.start,
            map,
        })
    }
}

impl Checkpoint for Gridworld {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.extend(SAVE_MAGIC);
        bytes.extend(self.map_bytes());
        bytes.extend((self.cell as u64).to_le_bytes());
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let foreign = || Error::invalid_argument("these bytes are not a state of this gridworld");
        let (head, cell) = bytes.split_last_chunk::<8>().ok_or_else(foreign)?;
        if !head.iter().copied().eq(SAVE_MAGIC.iter().copied().chain(self.map_bytes())) {
            return Err(foreign());
        }
        let cell = usize::try_from(u64::from_le_bytes(*cell)).map_err(|_| foreign())?;
        if self.map.cells.get(cell).is_none_or(|kind| *kind == map::Cell::Wall) {
            return Err(foreign());
        }
        self.cell = cell;
        Ok(())
    }
}

impl Environment for Gridworld {
    fn spec(&self) -> EnvironmentSpec {
        let observation = Space::Discrete { n: self.map.cells.len() };
        EnvironmentSpec {
            spaces: Spaces { observation, action: self.action_space.clone() },
            episode_length: self.horizon,
            brings_reset_reward: true,
        }
    }

    fn reset(&mut self, _seed: u64, observation: &mut [f32]) -> Result<()> {
        check_length("observation", observation, self.map.cells.len())?;
        self.cell = self.map.start;
        self.write_observation(observation);
        Ok(())
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        check_length("observation", observation, self.map.cells.len())?;
        let action = self.action_space.action_index(action)?;
        self.cell = self.successors[self.cell][action];
        self.write_observation(observation);
        Ok(self.outcomes[self.cell])
    }

    fn frame_size(&self) -> [usize; 2] {
        picture::size(&self.map)
    }

    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        picture::draw(&self.map, self.cell, frame);
        Ok(())
    }
}

shield_api::export_plugin! {
    environment "gridworld" => Gridworld {
        description: "Deterministic gridworlds with absorbing cells (paper, section 5)",
        deterministic: true,
    }
}

#[cfg(test)]
mod tests;
