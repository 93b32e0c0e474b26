//! What a success critic is asked in one round, what it must refuse, and what must hold of no other kind.

use shield_api::{AttemptBatch, ErrorKind, Space, SuccessCritic};

use super::{
    Candidate, Check, Run,
    draw::{Draw, DrawnBatch},
    kinds::{BATCH, Refusals, Round, call, same_values, with_last},
    probe::Finding,
};
use crate::{
    allocations_ffi,
    environment_check::{
        Guarded,
        Verdict::{Passed, Skipped},
        bits,
    },
};

/// Updates before a gradient is compared, and towards each outcome.
const UPDATES: usize = 100;
/// Places at which a gradient is compared, and calls whose allocations are counted.
const POINTS: usize = 40;
/// Of half an action's range: large beside the rounding of an f32, small beside what a critic tells apart.
const DIFFERENCE: f32 = 0.02;

/// The checks that no other kind has.
pub const CHECKS: &[Check] = &[
    Check {
        name: "gradient",
        rule: "the gradient, if there is one, is that of the probabilities",
        run: Run::Any(gradient),
    },
    Check {
        name: "learning",
        rule: "attempts that succeed raise the estimates above what attempts that fail lead to",
        run: Run::Any(learning),
    },
    Check {
        name: "allocations",
        rule: "after the first call, no estimate allocates memory",
        run: Run::Any(allocations),
    },
];

pub fn round(critic: &mut (dyn SuccessCritic + 'static), draw: &mut Draw) -> Round {
    let members = critic.info().members;
    let observation = Guarded::input("observation", &draw.observation());
    let action = Guarded::input("action", &draw.action());
    let mut probabilities = Guarded::output("probabilities", members);
    let place = probabilities.slice_mut();
    call("probabilities", critic.probabilities(observation.slice(), action.slice(), place))?;
    if let Some(other) = probabilities.checked()?.iter().find(|value| !(0.0..=1.0).contains(*value)) {
        return Err(format!("`probabilities` gives {other}, which is no probability"));
    }
    let mut seen = bits(probabilities.slice());

    let mut gradients = Guarded::output("gradients", members * draw.spaces.action_len());
    let mut again = Guarded::output("probabilities", members);
    match critic.gradients(observation.slice(), action.slice(), again.slice_mut(), gradients.slice_mut()) {
        Err(error) if error.kind() == ErrorKind::Unsupported => {}
        result => {
            call("gradients", result)?;
            seen.extend(bits(gradients.checked()?));
            same_values(probabilities.slice(), again.checked()?)?;
        }
    }
    let batch = draw.batch(BATCH, members);
    call("update", critic.update(&batch.attempts()))?;
    batch.checked()?;
    observation.checked()?;
    action.checked()?;
    Ok(seen)
}

pub fn refusals(critic: &mut (dyn SuccessCritic + 'static), draw: &mut Draw, bad: f32) -> Refusals {
    let members = critic.info().members;
    let (observation, action) = (draw.observation(), draw.action());
    let mut place = vec![0.0; members];
    let bad_observation = with_last(&observation, bad);
    let in_observation = critic.probabilities(&bad_observation, &action, &mut place).is_err();
    let in_action = critic.probabilities(&observation, &with_last(&action, bad), &mut place).is_err();
    let mut refusals = vec![
        ("`probabilities` with it in the observation".to_owned(), in_observation),
        ("`probabilities` with it in the action".to_owned(), in_action),
    ];
    let parts =
        ["observations", "actions", "outcome weights", "next observations", "continuations", "outcomes"];
    for (part, what) in parts.iter().enumerate() {
        let mut batch = draw.batch(BATCH, members);
        if let Some(last) = batch.parts_mut()[part].slice_mut().last_mut() {
            *last = bad;
        }
        refusals.push(((*what).to_owned(), critic.update(&batch.attempts()).is_err()));
    }
    refusals
}

/// ∂P/∂action against differences of P. Networks with kinks may disagree at a few places.
fn gradient(candidate: &Candidate<'_>) -> Finding {
    let spaces = candidate.spaces()?;
    let Space::Box { low, high } = &spaces.action else {
        return Ok(Skipped("actions are discrete: there is no gradient".into()));
    };
    let mut critic = candidate.success_critic(&spaces, candidate.seed, 1)?;
    let members = critic.info().members;
    let mut draw = Draw::new(&spaces, candidate.seed);
    // A critic that has learned nothing yet may be flat.
    for _ in 0..UPDATES {
        call("update", critic.update(&draw.batch(BATCH, members).attempts()))?;
    }
    let bounds: Vec<(f32, f32)> = low.iter().copied().zip(high.iter().copied()).collect();
    let mut slopes = Vec::new();
    for _ in 0..POINTS {
        match slopes_at(&mut *critic, &draw.observation(), draw.action(), &bounds)? {
            Some(found) => slopes.extend(found),
            None => {
                return Ok(Skipped(
                    "it has no gradient: what its rules reject is aborted, not altered".into(),
                ));
            }
        }
    }
    let wrong: Vec<&Slope> = slopes.iter().filter(|slope| !slope.is_right()).collect();
    let (count, wrong_count) = (slopes.len(), wrong.len());
    match wrong.first() {
        Some(Slope { given, difference, step }) if wrong_count > count / 4 => Err(format!(
            "`gradients` gives {given} where the probabilities change by {}, and differs at {wrong_count} of {count} places",
            difference / (2.0 * step)
        )),
        _ => Ok(Passed(format!("{} of {count} slopes", count - wrong_count))),
    }
}

/// ∂P/∂aᵢ of one member as it is given, and what P differs by between aᵢ − step and aᵢ + step.
struct Slope {
    given: f32,
    difference: f32,
    step: f32,
}

impl Slope {
    /// Within a tenth, and what an f32 rounds.
    fn is_right(&self) -> bool {
        let expected = 2.0 * self.step * self.given;
        (self.difference - expected).abs() <= 5e-6 + 0.1 * self.difference.abs().max(expected.abs())
    }
}

/// Of every member in every dimension; `None` without a gradient.
fn slopes_at(
    critic: &mut dyn SuccessCritic,
    observation: &[f32],
    mut action: Vec<f32>,
    bounds: &[(f32, f32)],
) -> Result<Option<Vec<Slope>>, String> {
    let (members, width) = (critic.info().members, action.len());
    let steps: Vec<f32> = bounds.iter().map(|(low, high)| DIFFERENCE * half_range(*low, *high)).collect();
    for ((value, step), (low, high)) in action.iter_mut().zip(&steps).zip(bounds) {
        *value = value.max(low + step).min(high - step);
    }
    let [mut above, mut below] = [(); 2].map(|()| vec![0.0; members]);
    let mut gradients = vec![0.0; members * width];
    match critic.gradients(observation, &action, &mut above, &mut gradients) {
        Err(error) if error.kind() == ErrorKind::Unsupported => return Ok(None),
        result => call("gradients", result)?,
    }
    let mut slopes = Vec::new();
    for (dimension, step) in steps.into_iter().enumerate() {
        for (sign, place) in [(1.0, &mut above), (-1.0, &mut below)] {
            let mut moved = action.clone();
            moved[dimension] += sign * step;
            call("probabilities", critic.probabilities(observation, &moved, place))?;
        }
        slopes.extend((0..members).map(|member| Slope {
            given: gradients[member * width + dimension],
            difference: above[member] - below[member],
            step,
        }));
    }
    Ok(Some(slopes))
}

/// Half the width of a dimension of actions; 1 where it has no bounds.
fn half_range(low: f32, high: f32) -> f32 {
    let half = high / 2.0 - low / 2.0;
    if half.is_finite() { half } else { 1.0 }
}

/// Two critics alike; one sees every attempt succeed, the other every attempt fail.
fn learning(candidate: &Candidate<'_>) -> Finding {
    let spaces = candidate.spaces()?;
    let taught = |outcome: f32| -> Result<(Vec<f32>, Vec<f32>), String> {
        let mut critic = candidate.success_critic(&spaces, candidate.seed, 1)?;
        let members = critic.info().members;
        let batch = Draw::new(&spaces, candidate.seed).batch(BATCH, members);
        let before = estimates(&mut *critic, &batch)?;
        let (outcomes, ones) = (vec![outcome; BATCH], vec![1.0; BATCH * members]);
        // Nothing follows: the next state lies in the reset set, or nobody can go on from there.
        let attempts = AttemptBatch {
            successes: &outcomes,
            continuations: &[0.0; BATCH],
            outcomes: &outcomes,
            outcome_weights: &[1.0; BATCH],
            masks: &ones,
            ..batch.attempts()
        };
        for _ in 0..UPDATES {
            call("update", critic.update(&attempts))?;
        }
        Ok((before, estimates(&mut *critic, &batch)?))
    };
    let ((before, high), (_, low)) = (taught(1.0)?, taught(0.0)?);
    if high == before && low == before {
        return Ok(Skipped(format!("{UPDATES} updates change no estimate: it does not learn")));
    }
    let [high, low] = [high, low].map(|values| values.iter().sum::<f32>() / values.len() as f32);
    let is_above = high > low;
    if !is_above {
        return Err(format!(
            "after {UPDATES} batches of attempts that succeed it estimates {high}, after as many that fail {low}"
        ));
    }
    Ok(Passed(format!("{high:.3} after attempts that succeed, {low:.3} after attempts that fail")))
}

/// Those of each transition of the batch.
fn estimates(critic: &mut dyn SuccessCritic, batch: &DrawnBatch) -> Result<Vec<f32>, String> {
    let members = critic.info().members;
    let attempts = batch.attempts();
    let width = |values: &[f32]| values.len() / batch.size;
    let observations = attempts.observations.chunks_exact(width(attempts.observations));
    let actions = attempts.actions.chunks_exact(width(attempts.actions));
    let mut all = Vec::new();
    for (observation, action) in observations.zip(actions) {
        let mut place = vec![0.0; members];
        call("probabilities", critic.probabilities(observation, action, &mut place))?;
        all.extend(place);
    }
    Ok(all)
}

fn allocations(candidate: &Candidate<'_>) -> Finding {
    let spaces = candidate.spaces()?;
    let mut critic = candidate.success_critic(&spaces, candidate.seed, 1)?;
    // Asked for once the library is loaded: what is loaded later is not counted.
    let Some(count) = allocations_ffi::counter() else {
        return Ok(Skipped("allocations cannot be counted on this system".into()));
    };
    let members = critic.info().members;
    let mut draw = Draw::new(&spaces, candidate.seed);
    let mut probabilities = vec![0.0; members];
    let mut gradients = vec![0.0; members * spaces.action_len()];
    let mut total = 0;
    for point in 0..=POINTS {
        let (observation, action) = (draw.observation(), draw.action());
        let mut asked = Ok(());
        let mut counted =
            count(&mut || asked = critic.probabilities(&observation, &action, &mut probabilities));
        call("probabilities", asked)?;
        let mut asked = Ok(());
        let of_gradients = count(&mut || {
            asked = critic.gradients(&observation, &action, &mut probabilities, &mut gradients)
        });
        // The message of an error may be allocated.
        let has_gradient = !asked.as_ref().is_err_and(|error| error.kind() == ErrorKind::Unsupported);
        if has_gradient {
            call("gradients", asked)?;
            counted += of_gradients;
        }
        if point > 0 {
            total += counted;
        }
    }
    if total > 0 {
        return Err(format!("{total} allocations in {POINTS} estimates"));
    }
    Ok(Passed(format!("{POINTS} estimates")))
}
