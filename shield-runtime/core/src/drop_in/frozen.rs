//! The same shield around another environment, for an evaluation.

use super::{DropIn, DropInObserver, metrics::EpisodeMetrics};
use crate::cycle::ResetCycle;

/// Another environment behind a shield that learns elsewhere: whose turn it is there, and what the next decision is measured against. What decides,
/// and who undoes, are lent by the shield for each call, so that both are always as trained as they are now.
pub struct Frozen {
    cycle: ResetCycle,
    metrics: EpisodeMetrics,
    observer: Option<Box<dyn DropInObserver>>,
    start_probabilities: Option<Vec<f32>>,
}

impl DropIn {
    /// Another environment with the same spaces, before its first start.
    pub fn freeze(&self) -> Frozen {
        Frozen {
            cycle: self.cycle.without_parts(self.spaces()),
            metrics: EpisodeMetrics::default(),
            observer: None,
            start_probabilities: None,
        }
    }

    /// Lets `body` use this shield for another environment. Nothing learns or explores, nothing is stored or counted, and neither rules nor reset task
    /// are told of anything; a rule that does not decide any more stays so.
    pub fn frozen<R>(&mut self, other: &mut Frozen, body: impl FnOnce(&mut Self) -> R) -> R {
        self.exchange(other);
        self.is_frozen = true;
        // A warm-up is over there when it is here, and an attempt takes as long.
        self.cycle.follow(&other.cycle);
        let done = body(self);
        self.exchange(other);
        self.is_frozen = false;
        done
    }

    fn exchange(&mut self, other: &mut Frozen) {
        let measured =
            self.cycle.ladder().and_then(|ladder| ladder.start_probabilities().map(<[f32]>::to_vec));
        std::mem::swap(&mut self.cycle, &mut other.cycle);
        std::mem::swap(&mut self.metrics, &mut other.metrics);
        std::mem::swap(&mut self.observer, &mut other.observer);
        self.cycle.take_deciders(&mut other.cycle);
        let is_frozen = !self.is_frozen;
        if let Some(ladder) = self.cycle.ladder_mut() {
            ladder.go_on_from(other.start_probabilities.as_deref());
            ladder.freeze(is_frozen);
        }
        other.start_probabilities = measured;
    }
}
