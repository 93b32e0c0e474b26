//! What a success critic is asked in one round, and what it must refuse.

use shield_api::{ErrorKind, SuccessCritic};

use super::{
    draw::Draw,
    kinds::{BATCH, Refusals, Round, call, same_values, with_last},
};
use crate::environment_check::{Guarded, bits};

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
    for (part, what) in ["observations", "actions", "outcome weights", "next observations", "continuations"]
        .iter()
        .enumerate()
    {
        let mut batch = draw.batch(BATCH, members);
        if let Some(last) = batch.parts_mut()[part].slice_mut().last_mut() {
            *last = bad;
        }
        refusals.push(((*what).to_owned(), critic.update(&batch.attempts()).is_err()));
    }
    refusals
}
