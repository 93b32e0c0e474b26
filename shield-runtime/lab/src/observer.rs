//! Receives the loop's events.

use std::time::Duration;

use shield_api::{Learner, StepOutcome};

use crate::loop_state::LoopState;
use shield_core::{
    events::{Counters, DecisionEvent, EpisodeEvent, EvaluationEvent, Intervention},
    experience::{AgentRole, Experience},
    world::World,
};

/// Why the state of a run is to be kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Occasion {
    /// So many steps were made: at the same steps in every run of an experiment.
    Periodic,
    /// The user asked to stop; at any step.
    Interrupted,
    /// All steps were made, and the last evaluation.
    Finished,
}

/// The state of a run, for whoever keeps it.
#[derive(Clone, Copy)]
pub struct Snapshot<'a> {
    /// Why now.
    pub occasion: Occasion,
    /// Everything but the experience.
    pub state: &'a LoopState,
    /// What both agents learn from.
    pub experience: &'a Experience,
}

/// A step of the loop.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// Everything that was counted, this step included.
    pub counters: &'a Counters,
    /// Whose action it was.
    pub role: AgentRole,
    /// What was observed before.
    pub observation: &'a [f32],
    /// The executed action.
    pub action: &'a [f32],
    /// What it led to.
    pub outcome: &'a StepOutcome,
}

/// What an observer may look at: the environment after the event, and the agent that values actions.
pub struct Scene<'a> {
    /// The environment.
    pub world: &'a mut World,
    /// The reset agent's learner, if there is one.
    pub reset: Option<&'a mut dyn Learner>,
}

/// Receives the loop's events. Errors end the run: a result that cannot be written is not worth computing.
#[allow(unused_variables, reason = "the defaults name their arguments for whoever writes others")]
pub trait Observer {
    /// After each environment step. Must be cheap.
    ///
    /// # Errors
    /// The observer cannot go on.
    fn on_step(&mut self, step: &Step<'_>, scene: &mut Scene<'_>) -> anyhow::Result<()> {
        Ok(())
    }

    /// How long the shield took to decide.
    fn on_decision_time(&mut self, time: Duration) {}

    /// After each rejected action.
    ///
    /// # Errors
    /// The observer cannot go on.
    fn on_intervention(
        &mut self,
        intervention: &Intervention<'_>,
        scene: &mut Scene<'_>,
    ) -> anyhow::Result<()> {
        Ok(())
    }

    /// After each decision of the shield, allowed actions too.
    ///
    /// # Errors
    /// The observer cannot go on.
    fn on_decision(&mut self, decision: &DecisionEvent<'_>) -> anyhow::Result<()> {
        Ok(())
    }

    /// After each episode, and after the hard reset that may follow it.
    ///
    /// # Errors
    /// The observer cannot go on.
    fn on_episode(&mut self, episode: &EpisodeEvent, counters: &Counters) -> anyhow::Result<()> {
        Ok(())
    }

    /// A learner's own figure, its mean over the episode that just ended.
    ///
    /// # Errors
    /// The observer cannot go on.
    fn on_metric(&mut self, step: u64, name: &str, mean: f64) -> anyhow::Result<()> {
        Ok(())
    }

    /// After each evaluation, with what the run has counted until then.
    ///
    /// # Errors
    /// The observer cannot go on.
    fn on_evaluation(&mut self, evaluation: &EvaluationEvent, counters: &Counters) -> anyhow::Result<()> {
        Ok(())
    }

    /// Between two steps, where the run's state is to be kept. Everything reported before belongs to it, nothing that follows.
    ///
    /// # Errors
    /// The observer cannot go on.
    fn on_checkpoint(&mut self, snapshot: &Snapshot<'_>) -> anyhow::Result<()> {
        Ok(())
    }
}

/// Two observers that both take every report.
#[derive(Debug)]
pub struct Fanout<A, B>(pub A, pub B);

impl<A: Observer, B: Observer> Observer for Fanout<A, B> {
    fn on_step(&mut self, step: &Step<'_>, scene: &mut Scene<'_>) -> anyhow::Result<()> {
        self.0.on_step(step, scene)?;
        self.1.on_step(step, scene)
    }

    fn on_decision_time(&mut self, time: Duration) {
        self.0.on_decision_time(time);
        self.1.on_decision_time(time);
    }

    fn on_intervention(
        &mut self,
        intervention: &Intervention<'_>,
        scene: &mut Scene<'_>,
    ) -> anyhow::Result<()> {
        self.0.on_intervention(intervention, scene)?;
        self.1.on_intervention(intervention, scene)
    }

    fn on_decision(&mut self, decision: &DecisionEvent<'_>) -> anyhow::Result<()> {
        self.0.on_decision(decision)?;
        self.1.on_decision(decision)
    }

    fn on_episode(&mut self, episode: &EpisodeEvent, counters: &Counters) -> anyhow::Result<()> {
        self.0.on_episode(episode, counters)?;
        self.1.on_episode(episode, counters)
    }

    fn on_metric(&mut self, step: u64, name: &str, mean: f64) -> anyhow::Result<()> {
        self.0.on_metric(step, name, mean)?;
        self.1.on_metric(step, name, mean)
    }

    fn on_evaluation(&mut self, evaluation: &EvaluationEvent, counters: &Counters) -> anyhow::Result<()> {
        self.0.on_evaluation(evaluation, counters)?;
        self.1.on_evaluation(evaluation, counters)
    }

    fn on_checkpoint(&mut self, snapshot: &Snapshot<'_>) -> anyhow::Result<()> {
        self.0.on_checkpoint(snapshot)?;
        self.1.on_checkpoint(snapshot)
    }
}
