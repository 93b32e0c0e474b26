//! Who hears what a drop-in decides, and what its episodes come to.

use super::DropIn;
use crate::{
    cycle::HardResetDue,
    decision::Decision,
    events::{Counters, DecisionEvent, EpisodeEvent},
    experience::AgentRole,
    plugin_state::PluginState,
};

/// Receives what a drop-in decides and what its episodes come to, in the order in which it happens. Nothing that the shield does depends on
/// it, so nothing here fails: an observer that writes keeps its errors for itself.
pub trait DropInObserver: Send {
    /// The rules judged a proposed action, or the reset agent failed. `reason` says why the action was rejected, for a person; empty if it
    /// was not. What is refused unjudged, while a hard reset is awaited, is not told.
    fn on_decision(&mut self, decision: &DecisionEvent<'_>, reason: &str);

    /// A plugin reported a figure, such as `reset/critic_loss`, in the episode under way.
    fn on_metric(&mut self, name: &str, mean: f64);

    /// An episode of either agent is over. The hard reset that may follow is not known yet.
    fn on_episode(&mut self, episode: &EpisodeEvent, counters: &Counters);

    /// Everything is at its start again, by a hard reset that was counted.
    fn on_hard_reset(&mut self, counters: &Counters);

    /// The shield goes on from a state that was kept: so much was counted, and the rules had these states.
    fn on_restored(&mut self, counters: &Counters, rules: &[PluginState]);
}

impl DropIn {
    /// Tells `observer` from now on what is decided and what becomes of it. The rules are then told everything that a replay of their
    /// decisions needs, which may cost a valuation more.
    pub fn report_to(&mut self, observer: Box<dyn DropInObserver>) {
        if let Some(ladder) = &mut self.cycle.parts_mut().ladder {
            ladder.be_thorough(true);
        }
        self.observer = Some(observer);
    }

    pub(super) fn report(&mut self, role: AgentRole, decision: Decision) {
        let Some(observer) = &mut self.observer else { return };
        let (last, _) = self.cycle.last();
        if let (Some(event), Some(ladder)) = (last.event(role, decision), last.ladder) {
            observer.on_decision(&event, ladder.reason());
        }
    }

    pub(super) fn report_episode(&mut self, episode: &EpisodeEvent) {
        self.take_metrics();
        if let Some(observer) = &mut self.observer {
            observer.on_episode(episode, self.cycle.counters());
        }
    }

    pub(super) fn report_hard_reset(&mut self) {
        if let Some(observer) = &mut self.observer {
            observer.on_hard_reset(self.cycle.counters());
        }
    }

    pub(super) fn report_restored(&mut self, rules: &[PluginState]) {
        if let Some(observer) = &mut self.observer {
            observer.on_restored(self.cycle.counters(), rules);
        }
    }

    /// Takes what the plugins reported since the last time.
    pub(super) fn take_metrics(&mut self) {
        let Self { cycle, metrics, observer, .. } = self;
        cycle.metrics().drain(&mut |name, mean| {
            metrics.note(name, mean);
            if let Some(observer) = observer {
                observer.on_metric(name, mean);
            }
        });
    }

    /// Nothing may move before a hard reset; an episode that is under way is cut short.
    pub(super) fn cut(&mut self, cause: HardResetDue) {
        if let Some(episode) = self.cycle.interrupted() {
            self.report_episode(&episode);
        }
        self.cycle.require_hard_reset(cause);
    }
}
