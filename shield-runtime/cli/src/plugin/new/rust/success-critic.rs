<% extends "rust/base.rs" %>
<% set saved = "probability" %>
<% block summary %>the same undo probability everywhere; put a real critic here<% endblock %>
<% block description %>The same undo probability everywhere<% endblock %>

<% block settings %>
        /// Share of the way towards the target that one transition goes.
        rate: f32 = 0.1,
        /// What is estimated before anything was learned.
        initial_probability: f32 = 0.5,
<% endblock %>

<% block instance %>
/// What was learned.
struct [[ type ]] {
    rate: f32,
    spaces: Spaces,
    probability: f32,
}
<% endblock %>

<% block create %>
        if !(settings.rate > 0.0 && settings.rate <= 1.0) {
            let message = format!("`rate` is {}; it must be above 0 and up to 1", settings.rate);
            return Err(Error::invalid_config(message).in_field("rate"));
        }
        if !(0.0..=1.0).contains(&settings.initial_probability) {
            let message = format!("`initial_probability` is {}; it must be in [0, 1]", settings.initial_probability);
            return Err(Error::invalid_config(message).in_field("initial_probability"));
        }
        Ok(Self { rate: settings.rate, spaces: setup.spaces()?.clone(), probability: settings.initial_probability })
<% endblock %>

<% block abilities %>
impl SuccessCritic for [[ type ]] {
    fn info(&self) -> SuccessCriticInfo {
        SuccessCriticInfo { members: 1 }
    }

    fn probabilities(&mut self, observation: &[f32], action: &[f32], probabilities: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.spaces.observation_len())?;
        check_finite("action", action, self.spaces.action_len())?;
        probabilities.fill(self.probability);
        Ok(())
    }

    fn gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.probabilities(observation, action, probabilities)?;
        gradients.fill(0.0);
        Ok(())
    }

    fn update(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        // Refused as a whole: either every transition is learned, or nothing has changed.
        let (observation_len, action_len) = (self.spaces.observation_len(), self.spaces.action_len());
        check_finite("observations", batch.observations, batch.size * observation_len)?;
        check_finite("actions", batch.actions, batch.size * action_len)?;
        check_finite("next observations", batch.next_observations, batch.size * observation_len)?;
        check_finite("next actions", batch.next_actions, batch.size * action_len)?;
        for (what, values) in [
            ("successes", batch.successes),
            ("continuations", batch.continuations),
            ("outcomes", batch.outcomes),
            ("outcome weights", batch.outcome_weights),
            ("masks", batch.masks),
        ] {
            check_finite(what, values, batch.size)?;
            if values.iter().any(|value| !(0.0..=1.0).contains(value)) {
                return Err(Error::invalid_argument(format!("{what} lie in [0, 1]")));
            }
        }
        for row in 0..batch.size {
            // 1 in the reset set and 0 where nothing follows; else the outcome, as far as it counts, and what comes next.
            let weight = batch.outcome_weights[row];
            let later = weight * batch.outcomes[row] + (1.0 - weight) * self.probability;
            let success = batch.successes[row];
            let target = success + (1.0 - success) * batch.continuations[row] * later;
            let moved = self.probability + self.rate * batch.masks[row] * (target - self.probability);
            self.probability = moved.clamp(0.0, 1.0);
        }
        Ok(())
    }
}
<% endblock %>

<% block tests %>
    fn estimate_after(outcome: f32) -> f32 {
        let spaces = Spaces { observation: Space::unbounded(2), action: Space::uniform(1, -1.0, 1.0) };
        let setup = Setup::with_spaces(0, 1, Host::silent(), spaces);
        let mut critic = [[ type ]]::create(Settings::default(), &setup).unwrap();
        let batch = AttemptBatch {
            size: 1,
            observations: &[0.0; 2],
            actions: &[0.0],
            next_observations: &[0.0; 2],
            next_actions: &[0.0],
            successes: &[0.0],
            continuations: &[1.0],
            outcomes: &[outcome],
            outcome_weights: &[1.0],
            masks: &[1.0],
        };
        critic.update(&batch).unwrap();
        let mut probabilities = [0.0];
        critic.probabilities(&[0.0; 2], &[0.0], &mut probabilities).unwrap();
        probabilities[0]
    }

    #[test]
    fn a_success_raises_the_estimate_and_a_failure_lowers_it() {
        assert!(estimate_after(1.0) > 0.5);
        assert!(estimate_after(0.0) < 0.5);
    }
<% endblock %>
