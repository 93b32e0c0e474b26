//! Everything that a joint loop remembers between two steps, but for the experience.

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::metrics::Metric;

use crate::evaluation::EvaluatorState;
use shield_core::{
    agent::AgentState,
    cycle::{CycleState, LearnedState, UndoState},
    events::Counters,
    plugin_state::PluginState,
    world::{World, WorldState},
};

/// The random numbers of the loop itself.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LoopRandomness {
    /// Seeds of hard resets.
    pub resets: Pcg64,
    /// Bootstrap masks.
    pub masks: Pcg64,
}

/// The state of a joint loop between two steps: everything but the experience.
#[derive(Serialize, Deserialize)]
pub struct LoopState {
    pub(crate) counters: Counters,
    pub(crate) is_finished: bool,
    pub(crate) cycle: CycleState,
    pub(crate) last_evaluation: Option<u64>,
    pub(crate) randomness: LoopRandomness,
    pub(crate) world: WorldState,
    pub(crate) learned: LearnedState,
    pub(crate) evaluator: Option<EvaluatorState>,
    pub(crate) metrics: Vec<Metric>,
    pub(crate) undo: UndoState,
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
            ("forward".into(), agent(&self.learned.forward)),
            ("reset".into(), agent(&self.learned.reset)),
            (
                "reset_task".into(),
                task(&self.world.reset_task)
                    && evaluator.is_none_or(|state| state.reset_tasks.iter().all(task)),
            ),
        ];
        if let Some(critic) = &self.undo.critic {
            all.push(("shield.success_critic".into(), critic.plugin.is_saved()));
        }
        for (index, rule) in self.learned.rules.iter().enumerate() {
            all.push((format!("shield.rules[{index}]"), rule.is_saved()));
        }
        all.into_iter().filter(|(_, is_saved)| !is_saved).map(|(field, _)| field).collect()
    }
}
