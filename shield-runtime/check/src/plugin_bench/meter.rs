//! Calls one function again and again, and keeps how long it takes.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use shield_api::{ErrorKind, Result};

use super::Measured;
use crate::allocations_ffi as allocations;

/// Short calls are timed in groups that last at least so long: reading the clock alone takes some 30 ns.
const GROUP: Duration = Duration::from_micros(3);
/// However slow a function is, it is timed so often.
const FEWEST: u64 = 3;
/// Times are kept in picoseconds, to three digits.
const PER_NANOSECOND: f64 = 1e3;
const DIGITS: u8 = 3;
/// A quarter of an hour: longer calls count as so long.
const LONGEST: u64 = 900_000_000_000_000;

/// Whether a function can be called again at once, or something has to be prepared first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Next {
    Again,
    Prepare,
}

pub(super) struct Meter<'a> {
    pub(super) measured: Vec<Measured>,
    time: Duration,
    tell: &'a mut dyn FnMut(&str),
}

impl<'a> Meter<'a> {
    pub(super) fn new(time: Duration, tell: &'a mut dyn FnMut(&str)) -> Self {
        Self { measured: Vec::new(), time, tell }
    }

    /// Measures `call`, which is preceded by `prepare` whenever it asks for that. What the plugin does not support is passed over.
    pub(super) fn measure<S>(
        &mut self,
        name: &'static str,
        subject: &mut S,
        prepare: fn(&mut S) -> Result<()>,
        call: fn(&mut S) -> Result<Next>,
    ) -> Result<(), String> {
        (self.tell)(name);
        prepare(subject).map_err(|error| format!("what comes before `{name}` fails: {error}"))?;
        // A library that came with the last instance counts too.
        allocations::begin();
        match self.times(subject, prepare, call) {
            Err(error) if error.kind() == ErrorKind::Unsupported => Ok(()),
            Err(error) => Err(format!("`{name}` fails: {error}")),
            Ok((times, count)) => {
                let at = |quantile| times.value_at_quantile(quantile) as f64 / PER_NANOSECOND;
                self.measured.push(Measured {
                    call: name,
                    calls: times.len(),
                    p50_ns: at(0.5),
                    p99_ns: at(0.99),
                    allocations: allocations::IS_KNOWN.then(|| count as f64 / times.len().max(1) as f64),
                });
                Ok(())
            }
        }
    }

    /// The times of all calls, and how often they allocated together.
    fn times<S>(
        &self,
        subject: &mut S,
        prepare: fn(&mut S) -> Result<()>,
        call: fn(&mut S) -> Result<Next>,
    ) -> Result<(Histogram<u64>, u64)> {
        // What a first call sets up is no part of the others.
        let mut next = call(subject)?;
        let mut times = histogram()?;
        let (mut count, mut size) = (0, 1);
        let begun = Instant::now();
        while begun.elapsed() < self.time || times.len() < FEWEST {
            if next == Next::Prepare {
                prepare(subject)?;
            }
            let before = allocations::count();
            let start = Instant::now();
            let mut made = 0;
            loop {
                next = call(subject)?;
                made += 1;
                if made == size || next == Next::Prepare {
                    break;
                }
            }
            let taken = start.elapsed();
            if taken < GROUP && made == size {
                size *= 2;
                continue;
            }
            count += allocations::count() - before;
            let each = taken.as_nanos() as f64 * PER_NANOSECOND / made as f64;
            times.saturating_record_n(each as u64, made);
        }
        Ok((times, count))
    }
}

fn histogram() -> Result<Histogram<u64>> {
    Histogram::new_with_max(LONGEST, DIGITS).map_err(|error| shield_api::Error::failed(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_calls_are_grouped_and_unsupported_ones_skipped() {
        let (mut heard, mut calls) = (Vec::new(), 0_u64);
        let mut tell = |name: &str| heard.push(name.to_owned());
        let mut meter = Meter::new(Duration::from_millis(5), &mut tell);
        let nothing = |_: &mut u64| Ok(());
        let count = |calls: &mut u64| {
            *calls += 1;
            Ok(Next::Again)
        };
        meter.measure("counts", &mut calls, nothing, count).unwrap();
        let missing = |_: &mut u64| Err(shield_api::Error::unsupported("this"));
        meter.measure("cannot", &mut calls, nothing, missing).unwrap();
        let fails = |_: &mut u64| Err(shield_api::Error::failed("no"));
        assert_eq!(meter.measure("fails", &mut calls, nothing, fails), Err("`fails` fails: no".into()));
        let measured = meter.measured;
        assert_eq!(heard, ["counts", "cannot", "fails"]);
        assert_eq!(measured.len(), 1);
        let counts = &measured[0];
        assert!(counts.calls > 100 && counts.calls <= calls, "{} of {calls}", counts.calls);
        assert!(counts.p50_ns > 0.0 && counts.p50_ns <= counts.p99_ns && counts.p99_ns < 1e9, "{counts:?}");
    }

    #[test]
    fn each_call_is_prepared_outside_the_measured_time() {
        struct Slow {
            is_prepared: bool,
        }
        let mut tell = |_: &str| ();
        let mut meter = Meter::new(Duration::ZERO, &mut tell);
        let prepare = |slow: &mut Slow| {
            std::thread::sleep(Duration::from_millis(20));
            slow.is_prepared = true;
            Ok(())
        };
        let call = |slow: &mut Slow| {
            assert!(std::mem::take(&mut slow.is_prepared));
            Ok(Next::Prepare)
        };
        meter.measure("once", &mut Slow { is_prepared: false }, prepare, call).unwrap();
        let Measured { calls, p50_ns, .. } = meter.measured[0];
        assert_eq!(calls, FEWEST);
        assert!(p50_ns < 20e6, "the preparation was timed: {p50_ns}");
    }
}
