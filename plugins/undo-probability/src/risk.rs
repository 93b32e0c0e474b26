//! The risk: what the user accepts, what became of the attempts, and how the threshold follows (adaptive conformal inference).

use shield_api::{Error, ObservedAttempt, Result, USUAL_ACCEPTED_RISK};

use crate::Config;

/// Below its beginning the threshold comes down no faster than with this accepted risk.
const SLOWEST: f64 = 0.05;

/// How many of the last attempts the realised risk is taken over.
const WINDOW: u64 = 100;

/// How the state begins.
const MAGIC: &[u8] = b"shield/undo-probability/1\n";

/// The risk that the user accepts.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Accepted {
    /// The share of attempts that may fail.
    Share(f64),
    /// How many attempts may fail per environment step.
    PerStep(f64),
}

impl Accepted {
    /// The share of such attempts that may fail, of one that ended this many steps after the one before.
    fn share(self, steps: u64) -> f64 {
        match self {
            Self::Share(share) => share,
            Self::PerStep(failures) => (failures * steps as f64).min(1.0),
        }
    }
}

/// How the threshold follows the outcomes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Adaptation {
    accepted: Accepted,
    /// η.
    rate: f64,
    /// The least threshold after a failure.
    initial: f64,
}

impl Adaptation {
    /// `None` where the threshold stays. Refuses what is out of range, and fields that would have no effect.
    pub fn new(config: &Config) -> Result<Option<Self>> {
        let Config { accepted_risk, hard_resets_per_1000, adapt, adaptation_rate, .. } = *config;
        let given = [("accepted_risk", accepted_risk), ("hard_resets_per_1000", hard_resets_per_1000)];
        if !adapt && let Some((field, _)) = given.iter().find(|(_, value)| value.is_some()) {
            let message = format!(
                "{field} has no effect with `adapt: false`: the threshold then stays at initial_threshold"
            );
            return Err(Error::invalid_config(message).in_field(*field));
        }
        let is_rate = adaptation_rate > 0.0 && adaptation_rate <= 1.0;
        if !is_rate {
            let message = format!(
                "adaptation_rate is {adaptation_rate}, but must be above 0 and at most 1; with `adapt: false` the threshold stays"
            );
            return Err(Error::invalid_config(message).in_field("adaptation_rate"));
        }
        let accepted = accepted(accepted_risk, hard_resets_per_1000)?;
        let (rate, initial) = (f64::from(adaptation_rate), f64::from(initial_threshold(config)));
        Ok(adapt.then_some(Self { accepted, rate, initial }))
    }

    /// The share of attempts that may fail; `None` where the user set a budget of steps.
    pub fn accepted_risk(&self) -> Option<f64> {
        match self.accepted {
            Accepted::Share(share) => Some(share),
            Accepted::PerStep(_) => None,
        }
    }
}

/// The threshold before the first attempt.
pub fn initial_threshold(config: &Config) -> f32 {
    let usual = 1.0 - config.accepted_risk.unwrap_or(USUAL_ACCEPTED_RISK as f32);
    config.initial_threshold.unwrap_or(usual)
}

fn accepted(risk: Option<f32>, hard_resets_per_1000: Option<f32>) -> Result<Accepted> {
    let refuse = |field: &str, message: String| Err(Error::invalid_config(message).in_field(field));
    match (risk, hard_resets_per_1000) {
        (Some(_), Some(_)) => {
            let message = "accepted_risk and hard_resets_per_1000 both set the risk; give one of them";
            refuse("hard_resets_per_1000", message.into())
        }
        (_, Some(budget)) => {
            let is_budget = budget > 0.0 && budget.is_finite();
            if !is_budget {
                let message = format!("hard_resets_per_1000 is {budget}, but must be above 0 and finite");
                return refuse("hard_resets_per_1000", message);
            }
            Ok(Accepted::PerStep(f64::from(budget) / 1000.0))
        }
        (risk, None) => {
            let risk = risk.unwrap_or(USUAL_ACCEPTED_RISK as f32);
            let is_share = risk > 0.0 && risk < 1.0;
            if !is_share {
                let message = format!("accepted_risk is {risk}, but must lie between 0 and 1");
                return refuse("accepted_risk", message);
            }
            Ok(Accepted::Share(f64::from(risk)))
        }
    }
}

/// What became of the attempts so far, and the threshold that followed: the rule's state.
#[derive(Debug, Clone, PartialEq)]
pub struct History {
    /// In [0, 1].
    pub threshold: f64,
    /// When the last attempt ended; before the first one, when the first decision was made.
    last_step: Option<u64>,
    attempts: u64,
    failures: u64,
    /// The last [`WINDOW`] attempts as bits, the latest lowest; 1 is a failure.
    recent: u128,
}

impl History {
    pub fn new(threshold: f64) -> Self {
        Self { threshold, last_step: None, attempts: 0, failures: 0, recent: 0 }
    }

    /// Takes note of a decision: steps count from the first.
    pub fn begin(&mut self, step: u64) {
        self.last_step.get_or_insert(step);
    }

    /// Takes note of an attempt: θ ← θ + η (failed − accepted), at least 0, at most 1, and after a failure at least θ₀. Below
    /// θ₀ it comes down by a share of itself, so that the further it goes the more successes it takes.
    pub fn record(&mut self, attempt: &ObservedAttempt, adaptation: Option<&Adaptation>) {
        let failed = u8::from(!attempt.succeeded);
        let steps = attempt.step.saturating_sub(self.last_step.unwrap_or(attempt.step));
        if let Some(Adaptation { accepted, rate, initial }) = adaptation {
            let share = accepted.share(steps);
            self.threshold = if !attempt.succeeded {
                (self.threshold + rate * (1.0 - share)).clamp(*initial, 1.0)
            } else if self.threshold > *initial {
                (self.threshold - rate * share).max(*initial)
            } else {
                self.threshold * (1.0 - rate * share.min(SLOWEST))
            };
        }
        self.last_step = Some(attempt.step);
        self.attempts += 1;
        self.failures += u64::from(failed);
        self.recent = (self.recent << 1 | u128::from(failed)) & window(WINDOW);
    }

    /// The share of failures among the last attempts; `None` before the first.
    pub fn realised_risk(&self) -> Option<f64> {
        let attempts = self.attempts.min(WINDOW);
        (attempts > 0).then(|| f64::from(self.recent.count_ones()) / attempts as f64)
    }

    pub fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&self.threshold.to_le_bytes());
        bytes.push(u8::from(self.last_step.is_some()));
        for count in [self.last_step.unwrap_or(0), self.attempts, self.failures] {
            bytes.extend_from_slice(&count.to_le_bytes());
        }
        bytes.extend_from_slice(&self.recent.to_le_bytes());
    }

    /// # Errors
    /// These are not the bytes of a state, or of one that cannot be.
    pub fn read(bytes: &[u8]) -> Result<Self> {
        Self::parse(bytes).filter(Self::is_possible).ok_or_else(|| {
            Error::invalid_argument(format!("these {} bytes are not a state of this rule", bytes.len()))
        })
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes.strip_prefix(MAGIC)?;
        let threshold = f64::from_le_bytes(take(&mut rest)?);
        let has_begun = take::<1>(&mut rest)?[0];
        let [step, attempts, failures] =
            [take(&mut rest)?, take(&mut rest)?, take(&mut rest)?].map(u64::from_le_bytes);
        let last_step = match (has_begun, step) {
            (0, 0) => None,
            (1, step) => Some(step),
            _ => return None,
        };
        let recent = u128::from_le_bytes(take(&mut rest)?);
        rest.is_empty().then_some(Self { threshold, last_step, attempts, failures, recent })
    }

    fn is_possible(&self) -> bool {
        let recent_failures = u64::from(self.recent.count_ones());
        let earlier = self.attempts.saturating_sub(WINDOW);
        let failures = recent_failures..=recent_failures.saturating_add(earlier);
        (0.0..=1.0).contains(&self.threshold)
            && (self.recent & !window(self.attempts.min(WINDOW))) == 0
            && failures.contains(&self.failures)
            && (self.attempts == 0 || self.last_step.is_some())
    }
}

/// As many of the lowest bits as there are attempts, at most [`WINDOW`].
fn window(attempts: u64) -> u128 {
    (1 << attempts) - 1
}

/// The next bytes.
fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, left) = rest.split_first_chunk()?;
    *rest = left;
    Some(*taken)
}
