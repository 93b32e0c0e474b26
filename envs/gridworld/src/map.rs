//! Maps: rows of text, checked once.

use std::fmt;

use serde::Deserialize;
use serde::de::{self, Deserializer, SeqAccess, Visitor};

/// What a cell of the map is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cell {
    /// `.` or `F`: the agent may come and go.
    Free,
    /// `S`: where every episode starts.
    Start,
    /// `#`: cannot be entered.
    Wall,
    /// `X` or `H`: an agent that enters stays there until a hard reset.
    Absorbing,
    /// `G`: reward 1, and the agent may leave again.
    Goal,
    /// `A`: reward 1, but an agent that enters stays there until a hard reset.
    AbsorbingGoal,
}

impl Cell {
    fn from_char(symbol: char) -> Option<Self> {
        Some(match symbol {
            '.' | 'F' => Self::Free,
            'S' => Self::Start,
            '#' => Self::Wall,
            'X' | 'H' => Self::Absorbing,
            'G' => Self::Goal,
            'A' => Self::AbsorbingGoal,
            _ => return None,
        })
    }

    /// No move leads out of the cell.
    pub fn is_absorbing(self) -> bool {
        matches!(self, Self::Absorbing | Self::AbsorbingGoal)
    }

    /// The task is achieved in the cell.
    pub fn is_goal(self) -> bool {
        matches!(self, Self::Goal | Self::AbsorbingGoal)
    }
}

/// A map that is part of the plugin.
struct NamedMap {
    name: &'static str,
    horizon: usize,
    rows: &'static [&'static str],
}

/// The paper shows its two maps as pictures only: the first two are our own, drawn after its text (section 5). The frozen lakes
/// are those of the code that its authors released.
const NAMED_MAPS: &[NamedMap] = &[
    NamedMap { name: "south-east", horizon: 30, rows: &["S....", ".X...", ".....", "...X.", "....G"] },
    NamedMap { name: "two-goals", horizon: 30, rows: &["G...A", ".....", "..S..", ".....", "....."] },
    NamedMap { name: "frozen-lake-4x4", horizon: 30, rows: &["SFFF", "FHFH", "FFFH", "HFFG"] },
    NamedMap {
        name: "frozen-lake-8x8",
        horizon: 100,
        rows: &[
            "SFFFFFFF", "FFFFFFFF", "FFFHFFFF", "FFFFFHFF", "FFFHFFFF", "FHHFFFHF", "FHFFHFHF", "FFFHFFFG",
        ],
    },
];
/// Episode length of a map that is written out in the experiment.
const INLINE_HORIZON: usize = 30;

/// A rectangle of cells with exactly one start. In RON it is the name of a map, or a list of rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Map {
    /// Rows from north to south, each from west to east.
    pub cells: Vec<Cell>,
    /// Number of columns.
    pub width: usize,
    /// Index of the start.
    pub start: usize,
    /// Episode length, where the configuration does not say otherwise.
    pub horizon: usize,
}

impl Map {
    /// One of the maps of the plugin.
    pub fn named(name: &str) -> Result<Self, String> {
        let Some(map) = NAMED_MAPS.iter().find(|map| map.name == name) else {
            let names: Vec<&str> = NAMED_MAPS.iter().map(|map| map.name).collect();
            return Err(format!("there is no map {name:?}; the maps are {}", names.join(", ")));
        };
        Self::from_rows(map.rows, map.horizon)
    }

    fn from_rows(rows: &[impl AsRef<str>], horizon: usize) -> Result<Self, String> {
        let width = rows.first().map_or(0, |row| row.as_ref().chars().count());
        if width == 0 {
            return Err("a map needs at least one cell".into());
        }
        let mut cells = Vec::with_capacity(width * rows.len());
        for (index, row) in rows.iter().map(AsRef::as_ref).enumerate() {
            for symbol in row.chars() {
                let unknown =
                    || format!("row {index} of the map holds {symbol:?}; known are S . F # X H G A");
                cells.push(Cell::from_char(symbol).ok_or_else(unknown)?);
            }
            if cells.len() != width * (index + 1) {
                return Err(format!(
                    "row {index} of the map has {} cells, row 0 has {width}",
                    row.chars().count()
                ));
            }
        }
        let count = |cell| cells.iter().filter(|other| **other == cell).count();
        let (starts, has_goal) = (count(Cell::Start), cells.iter().any(|cell| cell.is_goal()));
        if starts != 1 || !has_goal {
            return Err(format!("a map needs one start S (it has {starts}) and at least one goal G or A"));
        }
        let start = cells.iter().position(|cell| *cell == Cell::Start).unwrap_or_default();
        Ok(Self { cells, width, start, horizon })
    }

    /// Indices of the neighbours of a cell in the order of the actions: west, south, east, north. Where the map ends or a
    /// wall stands, and in an absorbing cell, the agent stays.
    pub fn neighbours(&self, cell: usize) -> [usize; 4] {
        if self.cells[cell].is_absorbing() {
            return [cell; 4];
        }
        let (column, width) = (cell % self.width, self.width);
        let west = if column > 0 { cell - 1 } else { cell };
        let south = if cell + width < self.cells.len() { cell + width } else { cell };
        let east = if column + 1 < width { cell + 1 } else { cell };
        let north = if cell >= width { cell - width } else { cell };
        [west, south, east, north].map(|next| if self.cells[next] == Cell::Wall { cell } else { next })
    }
}

impl Default for Map {
    fn default() -> Self {
        Self::named("south-east").expect("the default map is valid")
    }
}

impl<'de> Deserialize<'de> for Map {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(MapVisitor)
    }
}

struct MapVisitor;

impl<'de> Visitor<'de> for MapVisitor {
    type Value = Map;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("the name of a map or a list of its rows")
    }

    fn visit_str<E: de::Error>(self, name: &str) -> Result<Map, E> {
        Map::named(name).map_err(E::custom)
    }

    fn visit_seq<S: SeqAccess<'de>>(self, mut sequence: S) -> Result<Map, S::Error> {
        let mut rows: Vec<String> = Vec::new();
        while let Some(row) = sequence.next_element()? {
            rows.push(row);
        }
        Map::from_rows(&rows, INLINE_HORIZON).map_err(de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_malformed_map_is_refused_with_the_reason() {
        for (rows, reason) in [
            (&[][..], "at least one cell"),
            (&[""], "at least one cell"),
            (&["S.", "G"], "row 1 of the map has 1 cells"),
            (&["S.", "G.."], "row 1 of the map has 3 cells"),
            (&["S?G"], "'?'"),
            (&["SSG"], "it has 2"),
            (&["..G"], "it has 0"),
            (&["S.."], "at least one goal"),
        ] {
            let error = Map::from_rows(rows, 1).unwrap_err();
            assert!(error.contains(reason), "{rows:?}: {error}");
        }
    }

    #[test]
    fn every_named_map_is_valid_and_its_goal_lies_within_the_horizon() {
        for named in NAMED_MAPS {
            let map = Map::named(named.name).unwrap();
            let mut distance = vec![usize::MAX; map.cells.len()];
            let mut queue = std::collections::VecDeque::from([map.start]);
            distance[map.start] = 0;
            while let Some(cell) = queue.pop_front() {
                for next in map.neighbours(cell) {
                    if distance[next] == usize::MAX {
                        distance[next] = distance[cell] + 1;
                        queue.push_back(next);
                    }
                }
            }
            let reached =
                |wanted| (0..map.cells.len()).filter(|i| map.cells[*i] == wanted).map(|i| distance[i]).min();
            assert!(reached(Cell::Goal).unwrap() < map.horizon, "{}", named.name);
        }
    }

    #[test]
    fn the_two_goals_are_equally_near() {
        let map = Map::named("two-goals").unwrap();
        let distance = |wanted| {
            let cell = map.cells.iter().position(|cell| *cell == wanted).unwrap();
            (cell % 5).abs_diff(map.start % 5) + (cell / 5).abs_diff(map.start / 5)
        };
        assert_eq!(distance(Cell::Goal), distance(Cell::AbsorbingGoal));
    }

    #[test]
    fn walls_and_borders_stop_the_agent() {
        let map = Map::from_rows(&["S#", ".G"], 1).unwrap();
        assert_eq!(map.neighbours(0), [0, 2, 0, 0]);
        assert_eq!(map.neighbours(3), [2, 3, 3, 3]);
    }
}
