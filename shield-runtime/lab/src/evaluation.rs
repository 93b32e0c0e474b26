//! Evaluation: greedy episodes in other instances of the environment, apart from everything that the run counts.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{ActMode, Error, Result, SuccessCritic};

use crate::lanes::{Lane, Lanes};
use shield_core::{
    agent::ForwardAgent,
    cycle::{Evaluated, restore_rules, save_rules},
    events::{EvaluationEvent, EvaluationFigures, Tally},
    plugin_state::PluginState,
    settings::EvaluatedAgent,
    shield::{self, Ladder, Moment},
    world::Stepped,
};

/// What an evaluator carries from one evaluation to the next: each begins with a hard reset, which leaves these as they are.
#[derive(Serialize, Deserialize)]
pub(crate) struct EvaluatorState {
    /// One per world.
    pub reset_tasks: Vec<Option<PluginState>>,
}

/// Runs greedy episodes: with the shield, if it has one, and without. Every evaluation of a run starts from the same seeds, so that two
/// differ by the agent or by the shield alone.
pub struct Evaluator {
    batch: Lanes,
    ladder: Option<Ladder>,
    agent: EvaluatedAgent,
    start: Option<String>,
    episodes: u32,
    seed: u64,
    previous: Vec<f32>,
    /// Of the shield: goes on from the training's, so that what rules measure in steps passes here too.
    clock: u64,
}

/// An episode under way, or done.
#[derive(Clone, Copy, Default)]
struct Episode {
    tally: Tally,
    irreversible_entries: u64,
    was_irreversible: bool,
}

impl Evaluator {
    /// Evaluates `agent` in the worlds of `batch` over `episodes` episodes. With a `ladder`, which has rules of its own, each evaluation is
    /// made twice: with it, then without.
    ///
    /// # Errors
    /// There is no world.
    pub fn new(
        mut batch: Lanes,
        ladder: Option<Ladder>,
        agent: EvaluatedAgent,
        start: Option<String>,
        episodes: u32,
        seed: u64,
    ) -> Result<Self> {
        let Some(first) = batch.lanes().first() else {
            return Err(Error::invalid_argument("an evaluation needs a world"));
        };
        let previous = first.action.clone();
        Ok(Self { batch, ladder, agent, start, episodes, seed, previous, clock: 0 })
    }

    pub(crate) fn save(&mut self) -> Result<EvaluatorState> {
        let lanes = self.batch.lanes().iter();
        let reset_tasks = lanes.map(|lane| lane.world.save_reset_task()).collect::<Result<_>>()?;
        Ok(EvaluatorState { reset_tasks })
    }

    pub(crate) fn restore(&mut self, state: &EvaluatorState) -> Result<()> {
        for (lane, task) in self.batch.lanes().iter_mut().zip(&state.reset_tasks) {
            lane.world.restore_reset_task(task.as_ref())?;
        }
        Ok(())
    }

    /// Shows a start to the reset task of each world.
    pub(crate) fn show_start(&mut self, seed: u64) -> Result<()> {
        let start = self.start.as_deref();
        self.batch.lanes().iter_mut().try_for_each(|lane| lane.world.hard_reset(start, seed))
    }

    /// One evaluation after `step` training steps.
    ///
    /// # Errors
    /// A plugin failed.
    pub fn run(&mut self, step: u64, mut agents: Evaluated<'_>) -> Result<EvaluationEvent> {
        if let (Some(ladder), Some(trained)) = (&mut self.ladder, &mut agents.ladder) {
            // What the rules have adapted to is what is deployed.
            restore_rules(Some(ladder), &save_rules(Some(trained))?)?;
        }
        self.clock = step;
        let shielded = self.ladder.is_some().then(|| self.evaluate(true, &mut agents)).transpose()?;
        let bare = self.evaluate(false, &mut agents)?;
        Ok(match shielded {
            Some(figures) => EvaluationEvent { step, figures, without_shield: Some(bare) },
            None => EvaluationEvent { step, figures: bare, without_shield: None },
        })
    }

    /// All episodes, with the shield or without.
    fn evaluate(&mut self, is_shielded: bool, agents: &mut Evaluated<'_>) -> Result<EvaluationFigures> {
        let mut seeds = Pcg64::seed_from_u64(self.seed);
        let seeds: Vec<u64> = (0..self.episodes).map(|_| seeds.next_u64()).collect();
        // Rules follow one episode at a time.
        let at_once = if is_shielded { 1 } else { self.batch.lanes().len() };
        let mut episodes = Vec::new();
        for wave in seeds.chunks(at_once) {
            episodes.extend(self.wave(is_shielded, wave, agents)?);
        }
        let mut figures = EvaluationFigures::default();
        for Episode { tally, irreversible_entries, .. } in episodes {
            let (gain, has_succeeded) = match self.agent {
                EvaluatedAgent::Forward => (tally.forward_return, tally.success),
                EvaluatedAgent::Reset => (tally.reset_return, tally.visited_reset_set),
            };
            figures.steps += tally.length;
            figures.irreversible_entries += irreversible_entries;
            figures.mean_return += gain;
            figures.success_rate += f64::from(u8::from(has_succeeded));
        }
        figures.mean_return /= f64::from(self.episodes);
        figures.success_rate /= f64::from(self.episodes);
        Ok(figures)
    }

    /// One episode per seed, all at the same time: the agent acts for one world after the other, then all worlds step.
    fn wave(&mut self, is_shielded: bool, seeds: &[u64], agents: &mut Evaluated<'_>) -> Result<Vec<Episode>> {
        self.ladder.iter_mut().for_each(Ladder::begin_cycle);
        let mut episodes = vec![Episode::default(); seeds.len()];
        for (lane, seed) in self.batch.lanes().iter_mut().zip(seeds) {
            lane.world.hard_reset(self.start.as_deref(), *seed)?;
            lane.is_running = true;
        }
        while self.batch.lanes().iter().any(|lane| lane.is_running) {
            for (index, episode) in episodes.iter().enumerate() {
                if !self.batch.lanes()[index].is_running {
                    continue;
                }
                self.act(index, agents)?;
                if is_shielded {
                    self.filter(index, episode.tally.length > 0, agents);
                }
            }
            self.batch.step();
            for (lane, episode) in self.batch.lanes().iter_mut().zip(&mut episodes) {
                if lane.is_running {
                    episode.take(lane)?;
                }
            }
        }
        Ok(episodes)
    }

    /// Chooses the next action of a lane.
    fn act(&mut self, lane: usize, agents: &mut Evaluated<'_>) -> Result<()> {
        let Lane { world, action, .. } = &mut self.batch.lanes()[lane];
        let observation = world.observation();
        match (self.agent, &mut agents.forward, &mut agents.reset) {
            (EvaluatedAgent::Forward, Some(forward), _) => forward.act(observation, ActMode::Greedy, action),
            (EvaluatedAgent::Reset, _, Some(reset)) => reset.act(observation, ActMode::Greedy, action),
            _ => Err(Error::failed("the agent to be evaluated does not exist in this mode")),
        }
    }

    /// Lets the shield judge the next action of a lane. A rejected one is replaced by the reset agent's for this step: the shield as deployed.
    fn filter(&mut self, lane: usize, has_previous: bool, agents: &mut Evaluated<'_>) {
        let Lane { world, action, .. } = &mut self.batch.lanes()[lane];
        let Evaluated { forward, reset, success, .. } = agents;
        if let (Some(ladder), Some(reset)) = (&mut self.ladder, reset) {
            let previous = has_previous.then_some(&self.previous[..]);
            let moment = Moment { step: self.clock, observation: world.observation(), previous };
            let forward = forward.as_deref_mut().and_then(ForwardAgent::learner);
            let success = success.as_mut().map(|critic| &mut **critic as &mut dyn SuccessCritic);
            ladder.filter(shield::Agents { reset: &mut **reset, forward, success }, &moment, action);
        }
        self.previous.copy_from_slice(action);
        self.clock += 1;
    }
}

impl Episode {
    /// Counts a lane's last step, and stops the lane where it ends the episode.
    fn take(&mut self, lane: &mut Lane) -> Result<()> {
        let Stepped::Made(outcome) = lane.outcome()? else {
            // An episode whose world was lost ends there.
            lane.is_running = false;
            return Ok(());
        };
        lane.world.advance();
        self.irreversible_entries += u64::from(outcome.irreversible && !self.was_irreversible);
        self.was_irreversible = outcome.irreversible;
        self.tally += &outcome;
        let is_last = self.tally.length >= lane.world.spec().episode_length as u64;
        lane.is_running = !outcome.terminated && !is_last;
        Ok(())
    }
}
