//! The services that the host gives to its plugins: a log, and a place for figures.

use std::{
    ffi::c_void,
    panic::{AssertUnwindSafe, catch_unwind},
};

use shield_api::{
    Host,
    abi::{HostTable, Text},
    metrics,
};

static TABLE: HostTable = HostTable {
    struct_size: size_of::<HostTable>(),
    log: write_log,
    metric: keep_metric,
    get_extension: no_extension,
};

static WITHOUT_METRICS: HostTable = HostTable { metric: drop_metric, ..TABLE };

/// The host's services, for the `Setup` of instances, Rust types included. Log lines go to the `log` crate under the target `plugin`;
/// figures to the [`Metrics`](shield_api::metrics::Metrics) that collect around the call of the instance.
pub fn host() -> Host {
    Host::from_table(Some(&TABLE))
}

/// As [`host`], but figures are dropped: for instances that do not belong to what a run measures.
pub fn host_without_metrics() -> Host {
    Host::from_table(Some(&WITHOUT_METRICS))
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
    metrics::report(name, value);
}

unsafe extern "C" fn drop_metric(_name: Text, _value: f64) {}

/// A plugin of a later minor version may ask for what this host does not have.
unsafe extern "C" fn no_extension(_host: *const HostTable, _name: Text) -> *const c_void {
    std::ptr::null()
}

#[cfg(test)]
mod tests {
    use shield_api::metrics::Metrics;

    use super::*;

    #[test]
    fn figures_reach_the_metrics_around_the_call_and_those_of_a_host_without_metrics_do_not() {
        let metrics = Metrics::default();
        metrics.collect(|| {
            host().metric("loss", 1.0);
            host_without_metrics().metric("loss", 5.0);
        });
        host().metric("loss", 9.0);
        let mut found = Vec::new();
        metrics.drain(&mut |name, mean| found.push((name.to_string(), mean)));
        assert_eq!(found, [("loss".to_string(), 1.0)]);
    }
}
