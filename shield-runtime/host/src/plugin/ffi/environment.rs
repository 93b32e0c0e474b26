//! A loaded environment.

use shield_api::{
    Environment, EnvironmentSpec, ErrorKind, Frame, ResetKind, Result, Setup, Space, Spaces, StepOutcome,
    abi::{
        CostsTable, EXTENSION_COSTS, EXTENSION_RENDER, EXTENSION_STARTS, EnvironmentTable, Floats, Instance,
        RenderTable, SpaceView, SpecView, StartsTable, StepView, Text,
    },
};

use super::handle::{Handle, checkpoint, described_wrongly, extension, while_creating};
use crate::plugin::PluginError;

/// No environment has more named starts or kinds of hard resets; a plugin that never stops naming them is stopped here.
const MOST_NAMES: usize = 10_000;
const LONGEST_NAME: usize = 256;
/// Of either side, in pixels.
const LARGEST_FRAME: u32 = 4096;
const USUAL_FRAME: [usize; 2] = [320, 240];

/// An environment behind the binary interface.
#[derive(Debug)]
pub struct LoadedEnvironment {
    handle: Handle,
    table: &'static EnvironmentTable,
    starts_table: Option<&'static StartsTable>,
    render_table: Option<&'static RenderTable>,
    starts: Vec<String>,
    costs_table: Option<&'static CostsTable>,
    reset_kinds: Vec<ResetKind>,
    spec: EnvironmentSpec,
}

checkpoint!(LoadedEnvironment);

impl LoadedEnvironment {
    pub(in crate::plugin) fn create(
        id: &str,
        table: &'static EnvironmentTable,
        config: &str,
        setup: &Setup,
    ) -> Result<Self, PluginError> {
        let handle = Handle::create(id, &table.life, config, setup)?;
        let spec = read_spec(id, &handle, table)?;
        // SAFETY: under each name a plugin gives the table of that name.
        let (starts_table, costs_table, render_table) = unsafe {
            (
                extension::<StartsTable>(id, &table.life, EXTENSION_STARTS)?,
                extension::<CostsTable>(id, &table.life, EXTENSION_COSTS)?,
                extension::<RenderTable>(id, &table.life, EXTENSION_RENDER)?,
            )
        };
        let starts = match starts_table {
            Some(table) => read_starts(&handle, table).map_err(|error| while_creating(id, &error))?,
            None => Vec::new(),
        };
        let reset_kinds = match costs_table {
            Some(table) => read_reset_kinds(&handle, table).map_err(|error| while_creating(id, &error))?,
            None => Vec::new(),
        };
        Ok(Self { handle, table, starts_table, starts, costs_table, reset_kinds, render_table, spec })
    }

    fn check_observation(&self, function: &str, observation: &[f32]) -> Result<()> {
        self.handle.require_finite(function, "observation", observation)?;
        let Space::Discrete { .. } = self.spec.spaces.observation else { return Ok(()) };
        let ones = observation.iter().filter(|value| **value == 1.0).count();
        let zeros = observation.iter().filter(|value| **value == 0.0).count();
        if ones == 1 && ones + zeros == observation.len() {
            Ok(())
        } else {
            Err(self.handle.broken(format!("`{function}` gave a discrete observation that is not one-hot")))
        }
    }
}

impl Environment for LoadedEnvironment {
    fn spec(&self) -> EnvironmentSpec {
        self.spec.clone()
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.handle.require_length("observation", observation, self.spec.spaces.observation_len())?;
        observation.fill(f32::NAN);
        // SAFETY: the instance is of this table; the buffer is as long as said.
        self.handle.call(|instance| unsafe {
            (self.table.reset)(instance, seed, observation.as_mut_ptr(), observation.len())
        })?;
        self.check_observation("reset", observation)
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        self.handle.require_length("action", action, self.spec.spaces.action_len())?;
        self.handle.require_length("observation", observation, self.spec.spaces.observation_len())?;
        observation.fill(f32::NAN);
        let mut view = StepView { forward_reward: f32::NAN, reset_reward: f32::NAN, flags: 0 };
        // SAFETY: the instance is of this table; action and buffer are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            let (pointer, length) = (observation.as_mut_ptr(), observation.len());
            (self.table.step)(instance, Floats::new(action), pointer, length, &mut view)
        })?;
        self.check_observation("step", observation)?;
        self.handle.require_finite(
            "step",
            "[forward, reset] reward",
            &[view.forward_reward, view.reset_reward],
        )?;
        StepOutcome::try_from(view)
            .map_err(|flags| self.handle.broken(format!("`step` gave the unknown flags {flags:#x}")))
    }

    fn starts(&self) -> Vec<String> {
        self.starts.clone()
    }

    fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        let table = self.starts_table.filter(|_| self.starts.iter().any(|name| name == start));
        let Some(table) = table else {
            let known = if self.starts.is_empty() { "none".into() } else { self.starts.join(", ") };
            let message = format!("has no start named {start:?}; its starts: {known}");
            return Err(self.handle.error(ErrorKind::InvalidArgument, message));
        };
        self.handle.require_length("observation", observation, self.spec.spaces.observation_len())?;
        observation.fill(f32::NAN);
        // SAFETY: the instance is of this table; name and buffer live for the call and are as long as said.
        self.handle.call(|instance| unsafe {
            (table.reset_to)(instance, Text::new(start), seed, observation.as_mut_ptr(), observation.len())
        })?;
        self.check_observation("reset_to", observation)
    }

    fn reset_kinds(&self) -> Vec<ResetKind> {
        self.reset_kinds.clone()
    }

    fn reset_kind(&self) -> Result<usize> {
        let Some(table) = self.costs_table else {
            return Err(self.handle.error(ErrorKind::Unsupported, "has no kinds of hard resets"));
        };
        let mut index = usize::MAX;
        // SAFETY: the instance is of this table; the place lives for the call.
        self.handle.call(|instance| unsafe { (table.present)(instance, &mut index) })?;
        if index < self.reset_kinds.len() {
            return Ok(index);
        }
        let known = self.reset_kinds.len();
        Err(self.handle.broken(format!("`present` gave the kind {index} of a hard reset; there are {known}")))
    }

    /// The size that the environment proposes, if it can be drawn at all; else, or where it names an impossible one, the usual size.
    fn frame_size(&self) -> [usize; 2] {
        let (mut width, mut height) = (0, 0);
        let asked = self.render_table.map(|table| {
            // SAFETY: the instance is of this table's plugin; both places live for the call.
            self.handle.call(|instance| unsafe { (table.size)(instance, &mut width, &mut height) })
        });
        let is_possible = (1..=LARGEST_FRAME).contains(&width) && (1..=LARGEST_FRAME).contains(&height);
        if asked.is_some_and(|asked| asked.is_ok()) && is_possible {
            [width as usize, height as usize]
        } else {
            USUAL_FRAME
        }
    }

    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        let Some(table) = self.render_table else {
            return Err(self.handle.error(ErrorKind::Unsupported, "cannot draw itself"));
        };
        let shades = Floats::new(frame.shades());
        let size = [frame.width(), frame.height()].map(|pixels| u32::try_from(pixels).unwrap_or(u32::MAX));
        let pixels = frame.pixels();
        // SAFETY: the instance is of this table's plugin; shades and buffer live for the call and are as long as said.
        self.handle.call(|instance| unsafe {
            (table.render)(instance, size[0], size[1], shades, pixels.as_mut_ptr(), pixels.len())
        })
    }
}

fn read_spec(
    id: &str,
    handle: &Handle,
    table: &'static EnvironmentTable,
) -> Result<EnvironmentSpec, PluginError> {
    let mut view = SpecView {
        struct_size: size_of::<SpecView>(),
        observation_space: SpaceView::none(),
        action_space: SpaceView::none(),
        episode_length: 0,
        brings_reset_reward: 0,
    };
    handle
        // SAFETY: the instance is of this table; the view lives for the call.
        .call(|instance| unsafe { (table.spec)(instance, &mut view) })
        .map_err(|error| while_creating(id, &error))?;
    let read = |view: &SpaceView, what: &str| {
        // SAFETY: the plugin's bounds are valid until its next call, which comes later.
        let space = unsafe { view.read(what) }.map_err(|error| described_wrongly(id, error.message()))?;
        space.ok_or_else(|| described_wrongly(id, format!("`spec` gives no {what} space")))
    };
    let spaces = Spaces {
        observation: read(&view.observation_space, "observation")?,
        action: read(&view.action_space, "action")?,
    };
    if view.episode_length == 0 {
        return Err(described_wrongly(
            id,
            "`spec` gives an episode length of 0; an episode has at least one step",
        ));
    }
    Ok(EnvironmentSpec {
        spaces,
        episode_length: view.episode_length as usize,
        brings_reset_reward: view.brings_reset_reward != 0,
    })
}

fn read_starts(handle: &Handle, table: &'static StartsTable) -> Result<Vec<String>> {
    read_names(handle, "start", |instance, index, buffer| {
        // SAFETY: the instance is of this plugin; the buffer is as long as said.
        unsafe { (table.name)(instance, index, buffer.as_mut_ptr(), buffer.len()) }
    })
}

fn read_reset_kinds(handle: &Handle, table: &'static CostsTable) -> Result<Vec<ResetKind>> {
    let mut costs = Vec::new();
    let names = read_names(handle, "kind of hard reset", |instance, index, buffer| {
        let mut cost = f64::NAN;
        // SAFETY: the instance is of this plugin; the buffer is as long as said, and the place lives for the call.
        let length = unsafe { (table.kind)(instance, index, buffer.as_mut_ptr(), buffer.len(), &mut cost) };
        costs.push(cost);
        length
    })?;
    Ok(names.into_iter().zip(costs).map(|(name, cost)| ResetKind { name, cost }).collect())
}

/// Reads names until one is empty. `ask` writes the name of an index into the buffer and returns its full length.
fn read_names(
    handle: &Handle,
    what: &str,
    mut ask: impl FnMut(*mut Instance, usize, &mut [u8]) -> usize,
) -> Result<Vec<String>> {
    let mut names = Vec::new();
    loop {
        let mut buffer = [0; LONGEST_NAME];
        let mut length = 0;
        handle.call(|instance| {
            length = ask(instance, names.len(), &mut buffer);
            shield_api::abi::status::OK
        })?;
        if length == 0 {
            return Ok(names);
        }
        if length > LONGEST_NAME || names.len() == MOST_NAMES {
            return Err(handle.broken(format!(
                "its {what} {} has a name of {length} bytes; at most {MOST_NAMES} names of {LONGEST_NAME} bytes are read",
                names.len()
            )));
        }
        names.push(String::from_utf8_lossy(&buffer[..length]).into_owned());
    }
}
