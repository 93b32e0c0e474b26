//! Evaluation: greedy episodes in a second instance of the environment, apart from everything that the run counts.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{ActMode, Learner, Result};

use crate::{
    agent::ForwardAgent,
    checkpoint::{PluginState, restore_rules, save_rules},
    experiment::EvaluatedAgent,
    observer::{EvaluationRecord, Tally},
    shield::{Agents, Ladder, Moment},
    world::{Stepped, World},
};

/// What an evaluator carries from one evaluation to the next: each begins with a hard reset, which leaves these as they are.
#[derive(Serialize, Deserialize)]
pub(crate) struct EvaluatorState {
    pub reset_task: Option<PluginState>,
    pub rules: Vec<PluginState>,
}

/// Runs greedy episodes. Every evaluation of a run starts from the same seeds, so that two differ by the agent alone.
pub struct Evaluator {
    world: World,
    shield: Option<Ladder>,
    agent: EvaluatedAgent,
    start: Option<String>,
    episodes: u32,
    seed: u64,
    action: Vec<f32>,
    previous: Vec<f32>,
}

impl Evaluator {
    /// Evaluates `agent` in `world` over `episodes` episodes; through `shield`, with rules of its own, if there is one.
    pub fn new(
        world: World,
        shield: Option<Ladder>,
        agent: EvaluatedAgent,
        start: Option<String>,
        episodes: u32,
        seed: u64,
    ) -> Self {
        let action = vec![0.0; world.spec().spaces.action_len()];
        Self { world, shield, agent, start, episodes, seed, previous: action.clone(), action }
    }

    pub(crate) fn save(&mut self) -> Result<EvaluatorState> {
        Ok(EvaluatorState {
            reset_task: self.world.save_reset_task()?,
            rules: save_rules(self.shield.as_mut())?,
        })
    }

    pub(crate) fn restore(&mut self, state: &EvaluatorState) -> Result<()> {
        self.world.restore_reset_task(state.reset_task.as_ref())?;
        restore_rules(self.shield.as_mut(), &state.rules)
    }

    /// One evaluation after `step` training steps.
    ///
    /// # Errors
    /// A plugin failed.
    pub fn run(
        &mut self,
        step: u64,
        mut forward: Option<&mut ForwardAgent>,
        mut reset: Option<&mut dyn Learner>,
    ) -> Result<EvaluationRecord> {
        let mut seeds = Pcg64::seed_from_u64(self.seed);
        let mut record =
            EvaluationRecord { step, mean_return: 0.0, success_rate: 0.0, irreversible_entries: 0, steps: 0 };
        for _ in 0..self.episodes {
            self.world.hard_reset(self.start.as_deref(), seeds.next_u64())?;
            let tally = self.episode(step, &mut forward, &mut reset, &mut record)?;
            let (gain, has_succeeded) = match self.agent {
                EvaluatedAgent::Forward => (tally.forward_return, tally.success),
                EvaluatedAgent::Reset => (tally.reset_return, tally.visited_reset_set),
            };
            record.steps += tally.length;
            record.mean_return += gain;
            record.success_rate += f64::from(u8::from(has_succeeded));
        }
        record.mean_return /= f64::from(self.episodes);
        record.success_rate /= f64::from(self.episodes);
        Ok(record)
    }

    fn episode(
        &mut self,
        step: u64,
        forward: &mut Option<&mut ForwardAgent>,
        reset: &mut Option<&mut dyn Learner>,
        record: &mut EvaluationRecord,
    ) -> Result<Tally> {
        let mut tally = Tally::default();
        let mut was_irreversible = false;
        for _ in 0..self.world.spec().episode_length {
            let observation = self.world.observation();
            match (self.agent, &mut *forward, &mut *reset) {
                (EvaluatedAgent::Forward, Some(forward), _) => {
                    forward.act(observation, ActMode::Greedy, &mut self.action)?;
                }
                (EvaluatedAgent::Reset, _, Some(reset)) => {
                    reset.act(observation, ActMode::Greedy, &mut self.action)?;
                }
                _ => {
                    return Err(shield_api::Error::failed(
                        "the agent to be evaluated does not exist in this mode",
                    ));
                }
            }
            if let (Some(shield), Some(reset)) = (&mut self.shield, &mut *reset) {
                let moment =
                    Moment { step, observation, previous: (tally.length > 0).then_some(&self.previous) };
                let forward = forward.as_deref_mut().and_then(ForwardAgent::learner);
                let agents = Agents { reset: &mut **reset, forward };
                // A rejected action is replaced by the reset agent's for this step: the shield as deployed.
                shield.filter(agents, &moment, &mut self.action);
            }
            // An episode whose world was lost ends there.
            let Stepped::Made(outcome) = self.world.step(&self.action)? else { break };
            self.world.advance();
            self.previous.copy_from_slice(&self.action);
            record.irreversible_entries += u64::from(outcome.irreversible && !was_irreversible);
            was_irreversible = outcome.irreversible;
            tally += &outcome;
            if outcome.terminated {
                break;
            }
        }
        Ok(tally)
    }
}
