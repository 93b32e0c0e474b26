//! The services that the host gives to its plugins: a log, and a place for figures.
//!
//! The functions carry no context: they know who calls from the thread, since an instance may use them only on the thread that is
//! calling it.

use std::{
    cell::{Cell, RefCell},
    ffi::c_void,
    panic::{AssertUnwindSafe, catch_unwind},
};

use serde::{Deserialize, Serialize};
use shield_api::{
    Host,
    abi::{HostTable, Text},
};

/// A thread keeps figures of at most so many names: a plugin that makes up names for ever is stopped here.
const MOST_METRICS: usize = 256;

static TABLE: HostTable = HostTable {
    struct_size: size_of::<HostTable>(),
    log: write_log,
    metric: keep_metric,
    get_extension: no_extension,
};

static WITHOUT_METRICS: HostTable = HostTable { metric: drop_metric, ..TABLE };

/// What a plugin reported under one name since the last [`drain_metrics`].
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Metric {
    name: String,
    sum: f64,
    count: u64,
}

thread_local! {
    static METRICS: RefCell<Vec<Metric>> = const { RefCell::new(Vec::new()) };
    static SCOPE: Cell<&'static str> = const { Cell::new("") };
}

/// The host's services, for the `Setup` of instances. Log lines go to the `log` crate under the target `plugin`; figures to the
/// thread's accumulator, see [`drain_metrics`].
pub fn host() -> Host {
    Host::from_table(Some(&TABLE))
}

/// As [`host`], but figures are dropped: for instances that do not belong to what a run measures.
pub fn host_without_metrics() -> Host {
    Host::from_table(Some(&WITHOUT_METRICS))
}

/// Runs `body`; the figures that plugins report on this thread meanwhile are named `scope/name`. So the same figure of two
/// instances stays apart.
pub fn in_metric_scope<R>(scope: &'static str, body: impl FnOnce() -> R) -> R {
    struct Restore(&'static str);
    impl Drop for Restore {
        fn drop(&mut self) {
            SCOPE.set(self.0);
        }
    }
    let _restore = Restore(SCOPE.replace(scope));
    body()
}

/// Hands over the mean of each figure that plugins reported on this thread since the last time, in the order in which their names
/// were first seen, and begins anew. A figure that was not reported is not handed over.
pub fn drain_metrics(take: &mut impl FnMut(&str, f64)) {
    METRICS.with_borrow_mut(|metrics| {
        for metric in metrics.iter_mut().filter(|metric| metric.count > 0) {
            take(&metric.name, metric.sum / metric.count as f64);
            (metric.sum, metric.count) = (0.0, 0);
        }
    });
}

/// Forgets every figure and name on this thread: for the beginning of a run.
pub fn clear_metrics() {
    METRICS.with_borrow_mut(Vec::clear);
}

/// What is waiting to be handed over on this thread, for a checkpoint.
pub(crate) fn save_metrics() -> Vec<Metric> {
    METRICS.with_borrow(Clone::clone)
}

/// Goes on from what [`save_metrics`] gave.
pub(crate) fn restore_metrics(saved: &[Metric]) {
    METRICS.with_borrow_mut(|metrics| saved.clone_into(metrics));
}

unsafe extern "C" fn write_log(level: u32, message: Text) {
    let level = match level {
        1 => log::Level::Error,
        2 => log::Level::Warn,
        3 => log::Level::Info,
        _ => log::Level::Debug,
    };
    // SAFETY: the plugin's text lives for the call.
    let message = unsafe { message.as_str() };
    // A logger that panics must not unwind through the plugin; there is nobody left to tell.
    catch_unwind(AssertUnwindSafe(|| log::log!(target: "plugin", level, "{message}"))).ok();
}

unsafe extern "C" fn keep_metric(name: Text, value: f64) {
    // SAFETY: the plugin's text lives for the call.
    let name = unsafe { name.as_str() };
    // A thread that is ending, or a host that is just draining, takes no more figures.
    METRICS
        .try_with(|metrics| {
            if let Ok(mut metrics) = metrics.try_borrow_mut() {
                add(&mut metrics, SCOPE.get(), name, value);
            }
        })
        .ok();
}

unsafe extern "C" fn drop_metric(_name: Text, _value: f64) {}

/// A plugin of a later minor version may ask for what this host does not have.
unsafe extern "C" fn no_extension(_host: *const HostTable, _name: Text) -> *const c_void {
    std::ptr::null()
}

/// Allocates only at the first sight of a name.
fn add(metrics: &mut Vec<Metric>, scope: &str, name: &str, value: f64) {
    let is_same = |full: &str| match scope {
        "" => full == name,
        _ => full.strip_prefix(scope).and_then(|rest| rest.strip_prefix('/')) == Some(name),
    };
    if let Some(metric) = metrics.iter_mut().find(|metric| is_same(&metric.name)) {
        metric.sum += value;
        metric.count += 1;
    } else if metrics.len() < MOST_METRICS {
        let name = if scope.is_empty() { name.to_string() } else { format!("{scope}/{name}") };
        metrics.push(Metric { name, sum: value, count: 1 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drained() -> Vec<(String, f64)> {
        let mut found = Vec::new();
        drain_metrics(&mut |name, mean| found.push((name.to_string(), mean)));
        found
    }

    #[test]
    fn metrics_are_averaged_and_then_cleared() {
        let host = host();
        host.metric("loss", 1.0);
        host.metric("loss", 3.0);
        host.metric("noise", 5.0);
        assert_eq!(drained(), [("loss".to_string(), 2.0), ("noise".to_string(), 5.0)]);
        assert_eq!(drained(), []);
    }

    #[test]
    fn the_same_metric_of_two_instances_stays_separate() {
        let host = host();
        in_metric_scope("forward", || host.metric("loss", 1.0));
        in_metric_scope("reset", || host.metric("loss", 2.0));
        host.metric("loss", 3.0);
        let names: Vec<String> = drained().into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["forward/loss", "reset/loss", "loss"]);
    }

    #[test]
    fn metrics_of_instances_outside_the_run_are_dropped() {
        host_without_metrics().metric("loss", 1.0);
        assert_eq!(drained(), []);
    }

    #[test]
    fn the_number_of_metrics_is_bounded() {
        let host = host();
        (0..2 * MOST_METRICS).for_each(|index| host.metric(&index.to_string(), 0.0));
        assert_eq!(drained().len(), MOST_METRICS);
    }
}
