//! Every check must be able to fail: an environment with one fault fails the check that is meant for it. A program of its own, since one
//! check measures the memory of its process.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::atomic::{AtomicU64, Ordering};

use shield_api::{
    Checkpoint, Environment, EnvironmentSpec, Error, Frame, Result, Space, Spaces, StepOutcome, check_finite,
};
use shield_runtime::environment_check::{CHECKS, Subject, Verdict};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    ObservationOutside,
    NotFinite,
    LargeReward,
    ForgetsSeed,
    HalfState,
    TakesForeignBytes,
    FarStart,
    AnyStart,
    TakesNan,
    MovesBeforeRefusing,
    SharedState,
    DrawingMoves,
    Allocates,
    Leaks,
}

static SHARED: AtomicU64 = AtomicU64::new(0);
/// Stands for the allocator's count.
static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

/// A point on a line with a slow drift.
struct Line {
    fault: Fault,
    position: f32,
    drift: f32,
}

impl Line {
    fn observe(&self, observation: &mut [f32]) {
        observation[0] = self.position;
        if self.fault == Fault::ObservationOutside && self.position > 0.5 {
            observation[0] = 11.0;
        }
        if self.fault == Fault::NotFinite && self.position > 0.5 {
            observation[0] = f32::NAN;
        }
    }
}

impl Checkpoint for Line {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.extend(self.position.to_le_bytes());
        if self.fault != Fault::HalfState {
            bytes.extend(self.drift.to_le_bytes());
        }
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let number = |bytes: &[u8]| bytes.try_into().map(f32::from_le_bytes).ok();
        let halves = if self.fault == Fault::HalfState { bytes.len() == 4 } else { bytes.len() == 8 };
        if !halves && self.fault == Fault::TakesForeignBytes {
            self.position = 0.0;
            return Ok(());
        }
        let position = bytes.get(..4).and_then(number).filter(|_| halves);
        self.position = position.ok_or_else(|| Error::invalid_argument("not a line"))?;
        self.drift = bytes.get(4..).and_then(number).unwrap_or(0.0);
        Ok(())
    }
}

impl Environment for Line {
    fn spec(&self) -> EnvironmentSpec {
        EnvironmentSpec {
            spaces: Spaces {
                observation: Space::uniform(1, -10.0, 10.0),
                action: Space::uniform(1, -1.0, 1.0),
            },
            episode_length: 50,
            brings_reset_reward: true,
        }
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.position = if self.fault == Fault::FarStart { 5.0 } else { 0.0 };
        self.drift = (seed % 7) as f32 * 1e-3;
        if self.fault == Fault::ForgetsSeed {
            self.drift = SHARED.fetch_add(1, Ordering::Relaxed) as f32 * 1e-6;
        }
        self.observe(observation);
        Ok(())
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        if self.fault == Fault::MovesBeforeRefusing {
            self.position += 0.01;
        }
        if self.fault != Fault::TakesNan {
            check_finite("action", action, 1)?;
        }
        let action = action.first().copied().filter(|action| action.is_finite()).unwrap_or(0.0);
        self.position = (self.position + 0.1 * action + self.drift).clamp(-10.0, 10.0);
        if self.fault == Fault::SharedState {
            self.position += (SHARED.fetch_add(1, Ordering::Relaxed) % 1_009) as f32 * 1e-6;
        }
        if self.fault == Fault::Allocates {
            ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        }
        self.observe(observation);
        let near = 1.0 - self.position.abs().min(1.0);
        Ok(StepOutcome {
            forward_reward: self.position,
            reset_reward: if self.fault == Fault::LargeReward { 2.0 * near } else { near },
            in_reset_set: self.position.abs() < 0.1,
            ..StepOutcome::default()
        })
    }

    fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        if self.fault != Fault::AnyStart {
            return Err(Error::invalid_argument(format!("no start {start}")));
        }
        self.reset(seed, observation)
    }

    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        if self.fault == Fault::DrawingMoves {
            self.position += 1e-3;
        }
        let column = ((self.position + 10.0) / 20.0 * frame.width() as f32) as usize;
        let (pixels, at) = (frame.pixels(), 3 * column);
        pixels.fill(0);
        pixels[at] = 255;
        Ok(())
    }
}

/// Runs one check, or none of that name exists.
fn run(name: &str, fault: Fault) -> std::result::Result<Verdict, String> {
    let make = || {
        if fault == Fault::Leaks {
            // Else the optimiser sees that nobody reads it, and never allocates.
            std::mem::forget(std::hint::black_box(vec![1_u8; 16 * 1024]));
        }
        Ok(Box::new(Line { fault, position: 0.0, drift: 0.0 }) as Box<dyn Environment>)
    };
    let count = |body: &mut dyn FnMut()| {
        let before = ALLOCATIONS.load(Ordering::Relaxed);
        body();
        ALLOCATIONS.load(Ordering::Relaxed) - before
    };
    let subject = Subject { make: &make, is_deterministic: true, seed: 3, allocations: Some(&count) };
    (CHECKS.iter().find(|check| check.name == name).unwrap().run)(&subject)
}

/// One test, so that nothing else uses memory meanwhile.
#[test]
fn a_sound_environment_passes_every_check_and_each_fault_fails_its_own() {
    for check in CHECKS {
        let verdict = run(check.name, Fault::None);
        assert!(matches!(verdict, Ok(Verdict::Passed(_))), "{}: {verdict:?}", check.name);
    }
    for (fault, check) in [
        (Fault::ObservationOutside, "spaces"),
        (Fault::NotFinite, "finite"),
        (Fault::LargeReward, "reset-reward"),
        (Fault::ForgetsSeed, "seed"),
        (Fault::HalfState, "state"),
        (Fault::TakesForeignBytes, "foreign-state"),
        (Fault::FarStart, "reset-set"),
        (Fault::AnyStart, "starts"),
        (Fault::TakesNan, "bad-actions"),
        (Fault::MovesBeforeRefusing, "bad-actions"),
        (Fault::SharedState, "instances"),
        (Fault::DrawingMoves, "picture"),
        (Fault::Allocates, "allocations"),
        (Fault::Leaks, "memory"),
    ] {
        assert!(run(check, fault).is_err(), "{fault:?} passes {check}");
    }
}

#[test]
fn every_check_has_a_name_of_its_own() {
    let mut names: Vec<&str> = CHECKS.iter().map(|check| check.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), CHECKS.len());
}
