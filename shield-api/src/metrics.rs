//! Where the figures go that instances report with [`Host::metric`](crate::Host::metric). For hosts: a plugin has no use for it.
//!
//! The function behind `Host::metric` carries no context, so the thread knows whose call is running: for the time of the call, and no longer.

use std::{
    cell::RefCell,
    sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError},
};

use serde::{Deserialize, Serialize};

/// Metrics hold at most so many names: a plugin that makes up names for ever is stopped here.
const MOST_NAMES: usize = 256;

/// What was reported under one name since it was last drained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    name: String,
    sum: f64,
    count: u64,
}

/// Figures by name, in the order in which the names were first reported. A clone shares them with the original.
///
/// ```
/// use shield_api::metrics::{Metrics, report};
///
/// let (ours, others) = (Metrics::default(), Metrics::default());
/// ours.collect(|| report("loss", 1.0));
/// others.collect(|| report("loss", 5.0));
/// ours.collect_as("forward", || report("loss", 2.0));
/// let mut found = Vec::new();
/// ours.drain(&mut |name, mean| found.push((name.to_owned(), mean)));
/// assert_eq!(found, [("loss".to_owned(), 1.0), ("forward/loss".to_owned(), 2.0)]);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Metrics {
    figures: Arc<Mutex<Vec<Metric>>>,
}

/// Who collects, and what precedes the names.
struct Collector {
    metrics: Metrics,
    scope: &'static str,
}

thread_local! {
    static COLLECTOR: RefCell<Option<Collector>> = const { RefCell::new(None) };
}

impl Metrics {
    /// Runs `body`: the figures that instances report on this thread meanwhile come here.
    pub fn collect<R>(&self, body: impl FnOnce() -> R) -> R {
        self.collect_as("", body)
    }

    /// As [`collect`](Self::collect), but a figure is named `scope/name`. So the same figure of two instances stays apart.
    pub fn collect_as<R>(&self, scope: &'static str, body: impl FnOnce() -> R) -> R {
        struct Restore(Option<Collector>);
        impl Drop for Restore {
            fn drop(&mut self) {
                COLLECTOR.set(self.0.take());
            }
        }
        let collector = Collector { metrics: self.clone(), scope };
        let _restore = Restore(COLLECTOR.replace(Some(collector)));
        body()
    }

    /// Hands over the mean of each figure that was reported since the last time, and begins anew. A figure that was not reported is
    /// not handed over.
    pub fn drain(&self, take: &mut impl FnMut(&str, f64)) {
        for metric in self.lock().iter_mut().filter(|metric| metric.count > 0) {
            take(&metric.name, metric.sum / metric.count as f64);
            (metric.sum, metric.count) = (0.0, 0);
        }
    }

    /// The mean of a figure since it was last handed over, which stays to be handed over; `None` if it was not reported.
    pub fn waiting(&self, name: &str) -> Option<f64> {
        let figures = self.lock();
        let metric = figures.iter().find(|metric| metric.count > 0 && metric.name == name)?;
        Some(metric.sum / metric.count as f64)
    }

    /// Every name, with what is waiting to be handed over.
    pub fn save(&self) -> Vec<Metric> {
        self.lock().clone()
    }

    /// Goes on from what [`save`](Self::save) gave.
    pub fn restore(&self, saved: &[Metric]) {
        saved.clone_into(&mut self.lock());
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Metric>> {
        self.figures.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Allocates only at the first sight of a name.
    fn add(&self, scope: &str, name: &str, value: f64) {
        let mut figures = match self.figures.try_lock() {
            Ok(figures) => figures,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            // Who is just draining takes no more figures.
            Err(TryLockError::WouldBlock) => return,
        };
        let is_same = |full: &str| match scope {
            "" => full == name,
            _ => full.strip_prefix(scope).and_then(|rest| rest.strip_prefix('/')) == Some(name),
        };
        if let Some(metric) = figures.iter_mut().find(|metric| is_same(&metric.name)) {
            metric.sum += value;
            metric.count += 1;
        } else if figures.len() < MOST_NAMES {
            let name = if scope.is_empty() { name.to_string() } else { format!("{scope}/{name}") };
            figures.push(Metric { name, sum: value, count: 1 });
        }
    }
}

/// Adds a figure to the [`Metrics`] that collect on this thread; without any, it is dropped. A host's table calls it.
pub fn report(name: &str, value: f64) {
    // A thread that is ending takes no more figures.
    COLLECTOR
        .try_with(|collector| {
            if let Some(Collector { metrics, scope }) = &*collector.borrow() {
                metrics.add(scope, name, value);
            }
        })
        .ok();
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::panic::catch_unwind;

    use super::*;

    fn drained(metrics: &Metrics) -> Vec<(String, f64)> {
        let mut found = Vec::new();
        metrics.drain(&mut |name, mean| found.push((name.to_string(), mean)));
        found
    }

    #[test]
    fn figures_are_averaged_and_then_begin_anew() {
        let metrics = Metrics::default();
        metrics.collect(|| {
            report("loss", 1.0);
            report("loss", 3.0);
            report("noise", 5.0);
        });
        assert_eq!(drained(&metrics), [("loss".to_string(), 2.0), ("noise".to_string(), 5.0)]);
        assert_eq!(drained(&metrics), []);
        metrics.collect(|| report("noise", 7.0));
        assert_eq!(drained(&metrics), [("noise".to_string(), 7.0)]);
    }

    #[test]
    fn a_call_within_a_call_collects_for_itself_and_the_outer_one_goes_on() {
        let (outer, inner) = (Metrics::default(), Metrics::default());
        outer.collect_as("forward", || {
            report("loss", 1.0);
            inner.collect(|| report("loss", 2.0));
            report("loss", 3.0);
        });
        report("loss", 9.0);
        assert_eq!(drained(&outer), [("forward/loss".to_string(), 2.0)]);
        assert_eq!(drained(&inner), [("loss".to_string(), 2.0)]);
    }

    #[test]
    fn nobody_collects_after_a_call_that_panicked() {
        let metrics = Metrics::default();
        let panicking = metrics.clone();
        catch_unwind(move || panicking.collect(|| panic!("on purpose"))).unwrap_err();
        report("loss", 1.0);
        assert_eq!(drained(&metrics), []);
    }

    #[test]
    fn what_was_saved_goes_on() {
        let (first, second) = (Metrics::default(), Metrics::default());
        first.collect(|| report("b", 1.0));
        first.collect(|| report("a", 2.0));
        second.restore(&first.save());
        second.collect(|| report("a", 4.0));
        assert_eq!(drained(&second), [("b".to_string(), 1.0), ("a".to_string(), 3.0)]);
    }

    #[test]
    fn the_number_of_metrics_is_bounded() {
        let metrics = Metrics::default();
        metrics.collect(|| (0..2 * MOST_NAMES).for_each(|index| report(&index.to_string(), 0.0)));
        assert_eq!(drained(&metrics).len(), MOST_NAMES);
    }
}
