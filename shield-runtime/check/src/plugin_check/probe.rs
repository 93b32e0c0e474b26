//! What must hold of a plugin of every kind but the environment, asked through rounds of everything that it can do.

use std::{
    thread,
    time::{Duration, Instant},
};

use shield_api::{Checkpoint, ErrorKind, Spaces};

use super::{
    draw::Draw,
    kinds::{Refusals, Round},
};
use crate::environment_check::Verdict::{self, Passed, Skipped};

/// Rounds of one sequence.
const ROUNDS: usize = 20;
const BEFORE_SAVING: usize = 7;
const THREADS: usize = 4;

pub type Finding = Result<Verdict, String>;

/// A plugin of the kind `T`.
pub struct Probe<'a, T: ?Sized> {
    /// Makes an instance with a seed and a number of threads.
    pub make: &'a (dyn Fn(u64, usize) -> Result<Box<T>, String> + Sync),
    /// One round.
    pub round: fn(&mut T, &mut Draw) -> Round,
    /// Calls that must be refused, with this number in them.
    pub refusals: fn(&mut T, &mut Draw, f32) -> Refusals,
    pub spaces: &'a Spaces,
    pub seed: u64,
    pub is_deterministic: bool,
}

impl<T: Checkpoint + ?Sized> Probe<'_, T> {
    fn instance(&self) -> Result<Box<T>, String> {
        (self.make)(self.seed, 1)
    }

    fn draw(&self) -> Draw {
        Draw::new(self.spaces, self.seed)
    }

    fn rounds(&self, instance: &mut T, draw: &mut Draw, count: usize) -> Round {
        let mut seen = Vec::new();
        for _ in 0..count {
            seen.extend((self.round)(instance, draw)?);
        }
        Ok(seen)
    }

    fn fresh_rounds(&self, threads: usize) -> Round {
        self.rounds(&mut *(self.make)(self.seed, threads)?, &mut self.draw(), ROUNDS)
    }

    fn unless_deterministic(&self) -> Option<Verdict> {
        let reason = "its manifest says that it is not deterministic by seed";
        (!self.is_deterministic).then(|| Skipped(reason.into()))
    }

    /// The state as bytes, or why there is none.
    fn saved(&self, instance: &T) -> Result<Result<Vec<u8>, Verdict>, String> {
        let mut bytes = Vec::new();
        match instance.save(&mut bytes) {
            Ok(()) => Ok(Ok(bytes)),
            Err(error) if error.kind() == ErrorKind::Unsupported => {
                Ok(Err(Skipped("it cannot save its state: a run with it does not continue exactly".into())))
            }
            Err(error) => Err(format!("`save` fails: {error}")),
        }
    }

    /// Answers are finite and inside their spaces, and nothing is written where nothing must be.
    pub fn answers(&self) -> Finding {
        let numbers = self.fresh_rounds(1)?.len();
        Ok(Passed(format!("{ROUNDS} rounds, {numbers} numbers")))
    }

    pub fn seed(&self) -> Finding {
        if let Some(skipped) = self.unless_deterministic() {
            return Ok(skipped);
        }
        if self.fresh_rounds(1)? != self.fresh_rounds(1)? {
            return Err("two instances with one seed give different answers".into());
        }
        Ok(Passed(format!("{ROUNDS} rounds, twice")))
    }

    pub fn threads(&self) -> Finding {
        if let Some(skipped) = self.unless_deterministic() {
            return Ok(skipped);
        }
        let alone = self.fresh_rounds(1)?;
        for threads in [2, 3] {
            if self.fresh_rounds(threads)? != alone {
                return Err(format!("with {threads} threads it gives other answers than with one"));
            }
        }
        Ok(Passed("1, 2 and 3".into()))
    }

    pub fn state(&self) -> Finding {
        let (mut instance, mut draw) = (self.instance()?, self.draw());
        self.rounds(&mut instance, &mut draw, BEFORE_SAVING)?;
        let bytes = match self.saved(&instance)? {
            Ok(bytes) => bytes,
            Err(skipped) => return Ok(skipped),
        };
        // Another seed, so that only the saved state can make both equal.
        let mut other = (self.make)(self.seed.wrapping_add(1), 1)?;
        other
            .load(&bytes)
            .map_err(|error| format!("a new instance does not load what another saved: {error}"))?;
        if self.saved(&other)? != Ok(bytes.clone()) {
            return Err("saving what was loaded gives other bytes".into());
        }
        if self.is_deterministic {
            let mut again = Draw::new(self.spaces, self.seed ^ 1);
            let continued = self.rounds(&mut instance, &mut again, ROUNDS)?;
            let mut again = Draw::new(self.spaces, self.seed ^ 1);
            if self.rounds(&mut other, &mut again, ROUNDS)? != continued {
                return Err("a loaded state continues differently".into());
            }
        }
        Ok(Passed(format!("{} bytes, {ROUNDS} rounds on", bytes.len())))
    }

    pub fn foreign_state(&self) -> Finding {
        let (mut instance, mut draw) = (self.instance()?, self.draw());
        self.rounds(&mut instance, &mut draw, BEFORE_SAVING)?;
        let bytes = match self.saved(&instance)? {
            Ok(bytes) => bytes,
            Err(skipped) => return Ok(skipped),
        };
        let noise: Vec<u8> = draw.values(40).iter().flat_map(|value| value.to_bits().to_le_bytes()).collect();
        let longer = [bytes.as_slice(), &[0]].concat();
        let mut foreign = vec![("random bytes", noise.as_slice()), ("a state and one byte more", &longer)];
        if !bytes.is_empty() {
            foreign.push(("no bytes at all", &[]));
            foreign.push(("a state without its last byte", &bytes[..bytes.len() - 1]));
        }
        for (what, bad) in &foreign {
            if instance.load(bad).is_ok() {
                return Err(format!("it loads {what} as a state"));
            }
            if self.saved(&instance)? != Ok(bytes.clone()) {
                return Err(format!("it refuses {what}, but its state has changed"));
            }
        }
        Ok(Passed(format!("{} kinds of them", foreign.len())))
    }

    pub fn bad_numbers(&self) -> Finding {
        let (mut instance, mut draw) = (self.instance()?, self.draw());
        let (mut undisturbed, mut same) = (self.instance()?, self.draw());
        self.rounds(&mut instance, &mut draw, BEFORE_SAVING)?;
        self.rounds(&mut undisturbed, &mut same, BEFORE_SAVING)?;
        let mut count = 0;
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for (what, is_refused) in
                (self.refusals)(&mut instance, &mut Draw::new(self.spaces, self.seed), bad)
            {
                if !is_refused {
                    return Err(format!("{bad}: {what} is not refused"));
                }
                count += 1;
            }
        }
        if self.is_deterministic {
            let after = self.rounds(&mut instance, &mut draw, ROUNDS)?;
            if self.rounds(&mut undisturbed, &mut same, ROUNDS)? != after {
                return Err("what was refused changed its state".into());
            }
        }
        Ok(Passed(format!("{count} calls refused")))
    }

    pub fn instances(&self) -> Finding {
        if let Some(skipped) = self.unless_deterministic() {
            return Ok(skipped);
        }
        let alone = self.fresh_rounds(1)?;
        let (make, round, refusals, spaces, seed) =
            (self.make, self.round, self.refusals, self.spaces, self.seed);
        let together: Vec<Round> = thread::scope(|scope| {
            let threads: Vec<_> = (0..THREADS)
                .map(|_| {
                    thread::Builder::new().spawn_scoped(scope, move || {
                        let probe = Probe { make, round, refusals, spaces, seed, is_deterministic: true };
                        probe.fresh_rounds(1)
                    })
                })
                .collect();
            let refused = |error| format!("a thread cannot be started: {error}");
            let lost = |_| Err("a thread panicked".to_string());
            threads.into_iter().map(|thread| thread.map_err(refused)?.join().unwrap_or_else(lost)).collect()
        });
        for other in together {
            if other? != alone {
                return Err("beside others it gives other answers than alone".into());
            }
        }
        Ok(Passed(format!("{THREADS} at once")))
    }

    /// No threshold: a figure to look at.
    pub fn speed(&self) -> Finding {
        let (mut instance, mut draw) = (self.instance()?, self.draw());
        let mut best = Duration::MAX;
        for _ in 0..ROUNDS {
            let start = Instant::now();
            self.rounds(&mut instance, &mut draw, 1)?;
            best = best.min(start.elapsed());
        }
        Ok(Passed(format!("{:.1} µs a round at best", best.as_secs_f64() * 1e6)))
    }

    /// One round of an instance that is then ended.
    pub fn short_life(&self) -> Result<(), String> {
        self.rounds(&mut *self.instance()?, &mut self.draw(), 1).map(|_| ())
    }
}
