//! What the rules need to judge an action: values, probabilities and their gradients.

use shield_api::{ActMode, Error, Phase, Result, SuccessCritic, check_finite, check_length};

use super::{Judgement, Jury};
use crate::shield::{Agents, GivenValues, Moment};

impl Jury {
    /// Computes what the rules need of the state alone, once per decision.
    pub fn value_state(&mut self, agents: &mut Agents<'_>, moment: &Moment<'_>) -> Result<()> {
        let needs = self.present_needs();
        let is_start = self.phase == Phase::Forward && self.is_at_start && needs.any_greedy_probabilities();
        let are_always_needed = self.is_thorough && needs.greedy_on_rejection;
        if needs.greedy_values {
            agents.reset.act(moment.observation, ActMode::Greedy, &mut self.greedy_action)?;
            let values = &mut self.present.greedy_values;
            agents.reset.q_values(moment.observation, &self.greedy_action, values)?;
            check_finite("the reset values", values, values.len())?;
        }
        if needs.greedy_probabilities || are_always_needed || is_start {
            self.value_greedy_action(agents, moment)?;
        }
        if is_start {
            self.start_probabilities.copy_from_slice(&self.present.greedy_probabilities);
            self.is_at_start = false;
        }
        Ok(())
    }

    /// Computes the undo probabilities of the reset agent's own action.
    pub(super) fn value_greedy_action(&mut self, agents: &mut Agents<'_>, moment: &Moment<'_>) -> Result<()> {
        agents.reset.act(moment.observation, ActMode::Greedy, &mut self.greedy_action)?;
        let probabilities = &mut self.present.greedy_probabilities;
        success_critic(agents)?.probabilities(moment.observation, &self.greedy_action, probabilities)?;
        check_probabilities(probabilities)
    }

    pub(super) fn take(&mut self, given: &GivenValues<'_>) -> Result<()> {
        let needs = self.present_needs();
        let Judgement { values, greedy_values, .. } = &mut self.present;
        if needs.values {
            check_finite("the reset values", given.values, values.len())?;
            values.copy_from_slice(given.values);
        }
        if needs.greedy_values {
            check_finite("the reset values", given.greedy_values, greedy_values.len())?;
            greedy_values.copy_from_slice(given.greedy_values);
        }
        let Judgement { probabilities, greedy_probabilities, .. } = &mut self.present;
        let are_greedy_needed = needs.any_greedy_probabilities();
        let start = &mut self.start_probabilities;
        for (place, given, is_needed) in [
            (probabilities, given.probabilities, needs.probabilities),
            (greedy_probabilities, given.greedy_probabilities, are_greedy_needed),
            (start, given.start_probabilities, are_greedy_needed),
        ] {
            if is_needed {
                check_length("the undo probabilities", given, place.len())?;
                check_probabilities(given)?;
                place.copy_from_slice(given);
            }
        }
        let forward_values = &mut self.present.forward_values;
        if needs.forward_values {
            check_finite("the forward values", given.forward_values, given.forward_values.len())?;
            given.forward_values.clone_into(forward_values);
        }
        Ok(())
    }

    pub(super) fn value_action(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
    ) -> Result<()> {
        let needs = self.present_needs();
        if needs.values {
            let values = &mut self.present.values;
            agents.reset.q_values(moment.observation, action, values)?;
            check_finite("the reset values", values, values.len())?;
        }
        if needs.probabilities {
            let probabilities = &mut self.present.probabilities;
            success_critic(agents)?.probabilities(moment.observation, action, probabilities)?;
            check_probabilities(probabilities)?;
        }
        if let Some(forward) = agents.forward.as_deref_mut().filter(|_| needs.forward_values) {
            let values = &mut self.present.forward_values;
            values.resize(forward.info().members, f32::NAN);
            forward.q_values(moment.observation, action, values)?;
            check_finite("the forward values", values, values.len())?;
        }
        Ok(())
    }

    /// The mean of the forward ensemble's values of an action.
    pub fn forward_mean(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
    ) -> Result<f32> {
        let Some(forward) = agents.forward.as_deref_mut() else {
            return Err(Error::failed("the forward agent is a policy, which values nothing"));
        };
        let values = &mut self.forward_values;
        values.resize(forward.info().members, f32::NAN);
        forward.q_values(moment.observation, action, values)?;
        check_finite("the forward values", values, values.len())?;
        Ok((values.iter().copied().map(f64::from).sum::<f64>() / values.len() as f64) as f32)
    }

    /// Computes ∂P/∂action of each member of the success critic at `action` into `gradients`, if some rule needs the probabilities.
    pub fn differentiate_probabilities(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        if !self.present_needs().probabilities {
            return Ok(());
        }
        let probabilities = &mut self.present.probabilities;
        success_critic(agents)?.gradients(moment.observation, action, probabilities, gradients)?;
        check_probabilities(probabilities)?;
        check_finite("the gradients", gradients, gradients.len())
    }

    /// Computes ∂Q/∂action of each member at `action` into `gradients`, if some rule needs the values.
    pub fn differentiate(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        if !self.present_needs().values {
            return Ok(());
        }
        let values = &mut self.present.values;
        agents.reset.q_gradients(moment.observation, action, values, gradients)?;
        check_finite("the reset values", values, values.len())?;
        check_finite("the gradients", gradients, gradients.len())
    }
}

fn success_critic<'a>(agents: &'a mut Agents<'_>) -> Result<&'a mut dyn SuccessCritic> {
    match &mut agents.success {
        Some(critic) => Ok(&mut **critic),
        None => Err(Error::failed("a rule needs undo probabilities, and there is no success critic")),
    }
}

/// Written so that NaN is refused.
fn check_probabilities(probabilities: &[f32]) -> Result<()> {
    let is_probability = |value: &f32| (0.0..=1.0).contains(value);
    match probabilities.iter().find(|value| !is_probability(value)) {
        None => Ok(()),
        Some(other) => {
            Err(Error::failed(format!("the success critic gave {other}, which is no probability")))
        }
    }
}
