//! Evaluation: greedy episodes in other instances of the environment, apart from everything that the run counts.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{ActMode, Error, Result, SuccessCritic};

use crate::lanes::{Lane, Lanes};
use shield_core::{
    agent::ForwardAgent,
    cycle::{Evaluated, restore_rules, save_rules},
    events::{EvaluationEvent, Tally},
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
    pub rules: Vec<PluginState>,
}

/// Runs greedy episodes, as many at the same time as there are worlds. Every evaluation of a run starts from the same seeds, so that two
/// differ by the agent alone.
pub struct Evaluator {
    batch: Lanes,
    ladder: Option<Ladder>,
    agent: EvaluatedAgent,
    start: Option<String>,
    episodes: u32,
    seed: u64,
    previous: Vec<f32>,
}

/// An episode under way, or done.
#[derive(Clone, Copy, Default)]
struct Episode {
    tally: Tally,
    irreversible_entries: u64,
    was_irreversible: bool,
}

impl Evaluator {
    /// Evaluates `agent` in the worlds of `batch` over `episodes` episodes; through `ladder`, with rules of its own, if there is one. Rules
    /// follow one episode at a time: with a ladder the batch must hold a single world.
    ///
    /// # Errors
    /// There is no world, or more than one for a ladder.
    pub fn new(
        mut batch: Lanes,
        ladder: Option<Ladder>,
        agent: EvaluatedAgent,
        start: Option<String>,
        episodes: u32,
        seed: u64,
    ) -> Result<Self> {
        let worlds = batch.lanes().len();
        if worlds == 0 || (ladder.is_some() && worlds > 1) {
            return Err(Error::invalid_argument(format!("{worlds} worlds cannot be evaluated in")));
        }
        let previous = batch.lanes()[0].action.clone();
        Ok(Self { batch, ladder, agent, start, episodes, seed, previous })
    }

    pub(crate) fn save(&mut self) -> Result<EvaluatorState> {
        let lanes = self.batch.lanes().iter();
        Ok(EvaluatorState {
            reset_tasks: lanes.map(|lane| lane.world.save_reset_task()).collect::<Result<_>>()?,
            rules: save_rules(self.ladder.as_mut())?,
        })
    }

    pub(crate) fn restore(&mut self, state: &EvaluatorState) -> Result<()> {
        for (lane, task) in self.batch.lanes().iter_mut().zip(&state.reset_tasks) {
            lane.world.restore_reset_task(task.as_ref())?;
        }
        restore_rules(self.ladder.as_mut(), &state.rules)
    }

    /// One evaluation after `step` training steps.
    ///
    /// # Errors
    /// A plugin failed.
    pub fn run(&mut self, step: u64, mut agents: Evaluated<'_>) -> Result<EvaluationEvent> {
        if let (Some(ladder), Some(trained)) = (&mut self.ladder, &mut agents.ladder)
            && ladder.needs().undo_probabilities()
        {
            // What such rules have adapted to is what is deployed.
            restore_rules(Some(ladder), &save_rules(Some(trained))?)?;
        }
        let mut seeds = Pcg64::seed_from_u64(self.seed);
        let seeds: Vec<u64> = (0..self.episodes).map(|_| seeds.next_u64()).collect();
        let mut episodes = Vec::new();
        for wave in seeds.chunks(self.batch.lanes().len()) {
            episodes.extend(self.wave(step, wave, &mut agents)?);
        }
        let mut record =
            EvaluationEvent { step, mean_return: 0.0, success_rate: 0.0, irreversible_entries: 0, steps: 0 };
        for Episode { tally, irreversible_entries, .. } in episodes {
            let (gain, has_succeeded) = match self.agent {
                EvaluatedAgent::Forward => (tally.forward_return, tally.success),
                EvaluatedAgent::Reset => (tally.reset_return, tally.visited_reset_set),
            };
            record.steps += tally.length;
            record.irreversible_entries += irreversible_entries;
            record.mean_return += gain;
            record.success_rate += f64::from(u8::from(has_succeeded));
        }
        record.mean_return /= f64::from(self.episodes);
        record.success_rate /= f64::from(self.episodes);
        Ok(record)
    }

    /// One episode per seed, all at the same time: the agent acts for one world after the other, then all worlds step.
    fn wave(&mut self, step: u64, seeds: &[u64], agents: &mut Evaluated<'_>) -> Result<Vec<Episode>> {
        self.ladder.iter_mut().for_each(Ladder::begin_cycle);
        let mut episodes = vec![Episode::default(); seeds.len()];
        for (lane, seed) in self.batch.lanes().iter_mut().zip(seeds) {
            lane.world.hard_reset(self.start.as_deref(), *seed)?;
            lane.is_running = true;
        }
        while self.batch.lanes().iter().any(|lane| lane.is_running) {
            for (index, episode) in episodes.iter().enumerate() {
                if self.batch.lanes()[index].is_running {
                    self.act(step, index, episode.tally.length > 0, agents)?;
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
    fn act(&mut self, step: u64, lane: usize, has_previous: bool, agents: &mut Evaluated<'_>) -> Result<()> {
        let Lane { world, action, .. } = &mut self.batch.lanes()[lane];
        let observation = world.observation();
        let Evaluated { forward, reset, success, .. } = agents;
        match (self.agent, &mut *forward, &mut *reset) {
            (EvaluatedAgent::Forward, Some(forward), _) => {
                forward.act(observation, ActMode::Greedy, action)?
            }
            (EvaluatedAgent::Reset, _, Some(reset)) => reset.act(observation, ActMode::Greedy, action)?,
            _ => return Err(Error::failed("the agent to be evaluated does not exist in this mode")),
        }
        if let (Some(ladder), Some(reset)) = (&mut self.ladder, reset) {
            let moment = Moment { step, observation, previous: has_previous.then_some(&self.previous) };
            let forward = forward.as_deref_mut().and_then(ForwardAgent::learner);
            // A rejected action is replaced by the reset agent's for this step: the shield as deployed.
            let success = match success {
                Some(critic) => Some(&mut **critic as &mut dyn SuccessCritic),
                None => None,
            };
            let agents = shield::Agents { reset: &mut **reset, forward, success };
            ladder.filter(agents, &moment, action);
        }
        self.previous.copy_from_slice(action);
        Ok(())
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
