//! Keeping the state of a loop, and going on from it.

use std::sync::atomic::Ordering;

use serde::{Deserialize, Serialize};
use shield_api::check_length;

use super::{JointLoop, LoopRandomness, Participants};
use crate::{
    agent::{Agent, AgentState, ForwardAgent},
    checkpoint::{PluginState, restore_rules, save_rules},
    evaluation::{Evaluator, EvaluatorState},
    experience::AgentRole,
    observer::{Counters, Occasion, Snapshot, Tally},
    plugin::{self, Metric},
    shield::Ladder,
    world::{World, WorldState},
};

/// Where a loop begins.
#[derive(Debug, Clone, Copy)]
pub(super) enum Start {
    /// With the first placing, which is not counted.
    New,
    /// Within an episode.
    Within(Tally),
    /// With a counted hard reset: something was lost.
    HardReset,
    /// Nothing is left to be done.
    Finished,
}

/// The state of a joint loop between two steps: everything but the experience.
#[derive(Serialize, Deserialize)]
pub struct LoopState {
    counters: Counters,
    is_finished: bool,
    turn: AgentRole,
    tally: Tally,
    failed_attempts: u32,
    was_irreversible: bool,
    previous: Option<Vec<f32>>,
    last_evaluation: Option<u64>,
    randomness: LoopRandomness,
    world: WorldState,
    forward: Option<AgentState>,
    reset: Option<AgentState>,
    rules: Vec<PluginState>,
    evaluator: Option<EvaluatorState>,
    metrics: Vec<Metric>,
}

impl LoopState {
    /// What the run had counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Whether all steps had been made.
    pub fn is_finished(&self) -> bool {
        self.is_finished
    }

    /// Gives a world's reset task what it had learned of the starts.
    ///
    /// # Errors
    /// The plugin refuses its state.
    pub fn restore_reset_task(&self, world: &mut World) -> shield_api::Result<()> {
        world.restore_reset_task(self.world.reset_task.as_ref())
    }

    /// The fields of the experiment whose plugins could not save their state. If there are any, the run goes on with new instances of
    /// these, from a hard reset.
    pub fn unsaved(&self) -> Vec<String> {
        let agent =
            |agent: &'_ Option<AgentState>| agent.as_ref().is_none_or(|agent| agent.plugin.is_saved());
        let task = |task: &'_ Option<PluginState>| task.as_ref().is_none_or(PluginState::is_saved);
        let evaluator = self.evaluator.as_ref();
        let mut all = vec![
            ("environment".to_owned(), self.world.environment.is_saved()),
            ("forward".into(), agent(&self.forward)),
            ("reset".into(), agent(&self.reset)),
            (
                "reset_task".into(),
                task(&self.world.reset_task)
                    && evaluator.is_none_or(|state| state.reset_tasks.iter().all(task)),
            ),
        ];
        for (index, rule) in self.rules.iter().enumerate() {
            let in_evaluation = evaluator.and_then(|evaluator| evaluator.rules.get(index));
            let is_saved = rule.is_saved() && in_evaluation.is_none_or(PluginState::is_saved);
            all.push((format!("shield.rules[{index}]"), is_saved));
        }
        all.into_iter().filter(|(_, is_saved)| !is_saved).map(|(field, _)| field).collect()
    }
}

impl Participants {
    /// Gives both agents and the rules what they had learned; the world stays as it is.
    ///
    /// # Errors
    /// A plugin refuses its state.
    pub fn restore_agents(&mut self, state: &LoopState) -> shield_api::Result<()> {
        restore_agents(&mut self.forward, &mut self.reset, &mut self.shield, state)
    }
}

fn restore_agents(
    forward: &mut Option<ForwardAgent>,
    reset: &mut Option<Agent>,
    shield: &mut Option<Ladder>,
    state: &LoopState,
) -> shield_api::Result<()> {
    if let (Some(forward), Some(state)) = (forward, &state.forward) {
        forward.restore(state)?;
    }
    if let (Some(reset), Some(state)) = (reset, &state.reset) {
        reset.restore(state)?;
    }
    restore_rules(shield.as_mut(), &state.rules)
}

impl JointLoop<'_> {
    /// Goes on from `state`; the experience of the participants must be that of the same moment. Where a plugin could not save its
    /// state, the loop goes on from a counted hard reset.
    ///
    /// # Errors
    /// A plugin refuses its state.
    pub fn restore(&mut self, state: &LoopState) -> shield_api::Result<()> {
        restore_agents(&mut self.forward, &mut self.reset, &mut self.shield, state)?;
        self.world.restore(&state.world)?;
        if let (Some(evaluator), Some(state)) = (&mut self.evaluator, &state.evaluator) {
            evaluator.restore(state)?;
        }
        if let Some(previous) = &state.previous {
            check_length("the saved action", previous, self.previous.len())?;
            self.previous.copy_from_slice(previous);
        }
        plugin::restore_metrics(&state.metrics);
        self.randomness = state.randomness.clone();
        self.has_previous = state.previous.is_some();
        self.counters = state.counters;
        self.attempts.restore(state.failed_attempts);
        self.was_irreversible = state.was_irreversible;
        self.last_evaluation = state.last_evaluation;
        self.last_checkpoint = state.counters.steps;
        self.start = if state.is_finished {
            Start::Finished
        } else if state.unsaved().is_empty() {
            self.turn = state.turn;
            Start::Within(state.tally)
        } else {
            Start::HardReset
        };
        Ok(())
    }

    /// Something was lost when the run was stopped: it goes on from a hard reset, which counts.
    pub(super) fn lose_the_world(&mut self) -> anyhow::Result<()> {
        // The world's state is not known, so neither is what kind of hard reset it needs.
        self.counters.hard_resets += 1;
        self.counters.hard_reset_cost += self.settings.hard_reset_cost;
        self.attempts.clear();
        self.place()
    }

    /// Between two steps of `role`'s episode: keeps the state where that is due. Returns whether the run was stopped here.
    pub(super) fn pause(&mut self, role: AgentRole, tally: &Tally) -> anyhow::Result<bool> {
        let is_stopped = self.stop.load(Ordering::Relaxed);
        if let Some(every) = self.settings.checkpoint_every
            && self.last_checkpoint != self.counters.steps
        {
            // A stop changes nothing about a checkpoint that is due in every run.
            if self.counters.steps.is_multiple_of(every) {
                self.keep(Occasion::Periodic, role, tally)?;
            } else if is_stopped {
                self.keep(Occasion::Interrupted, role, tally)?;
            }
        }
        self.is_interrupted |= is_stopped;
        Ok(is_stopped)
    }

    /// After the last step and the last evaluation.
    pub(super) fn keep_finished(&mut self) -> anyhow::Result<()> {
        match self.settings.checkpoint_every {
            Some(_) => self.keep(Occasion::Finished, self.turn, &Tally::default()),
            None => Ok(()),
        }
    }

    fn keep(&mut self, occasion: Occasion, turn: AgentRole, tally: &Tally) -> anyhow::Result<()> {
        self.last_checkpoint = self.counters.steps;
        let state = LoopState {
            counters: self.counters,
            is_finished: occasion == Occasion::Finished,
            turn,
            tally: *tally,
            failed_attempts: self.attempts.failed(),
            was_irreversible: self.was_irreversible,
            previous: self.has_previous.then(|| self.previous.clone()),
            last_evaluation: self.last_evaluation,
            randomness: self.randomness.clone(),
            world: self.world.save()?,
            forward: self.forward.as_ref().map(ForwardAgent::save).transpose()?,
            reset: self.reset.as_ref().map(Agent::save).transpose()?,
            rules: save_rules(self.shield.as_mut())?,
            evaluator: self.evaluator.as_mut().map(Evaluator::save).transpose()?,
            metrics: plugin::save_metrics(),
        };
        self.observer.on_checkpoint(&Snapshot { occasion, state: &state, experience: &self.experience })
    }
}
