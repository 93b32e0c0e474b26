<% extends "rust/base.rs" %>
<% set saved = "value" %>
<% block summary %>the same value everywhere; put a real learner here<% endblock %>
<% block description %>The same value everywhere<% endblock %>

<% block settings %>
        /// Share of the way towards the target that one update goes.
        rate: f32 = 0.1,
        /// γ.
        discount: f32 = 0.99,
<% endblock %>

<% block instance %>
/// What was learned.
struct [[ type ]] {
    settings: Settings,
    spaces: Spaces,
    value: f32,
}
<% endblock %>

<% block create %>
        if !(settings.rate > 0.0 && settings.rate <= 1.0) {
            let message = format!("`rate` is {}; it must be above 0 and up to 1", settings.rate);
            return Err(Error::invalid_config(message).in_field("rate"));
        }
        if !(0.0..1.0).contains(&settings.discount) {
            let message = format!("`discount` is {}; it must be in [0, 1)", settings.discount);
            return Err(Error::invalid_config(message).in_field("discount"));
        }
        Ok(Self { settings, spaces: setup.spaces()?.clone(), value: 0.0 })
<% endblock %>

<% block abilities %>
impl Learner for [[ type ]] {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: 1, discount: self.settings.discount }
    }

    fn act(&mut self, observation: &[f32], _mode: ActMode, action: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.spaces.observation_len())?;
        action.fill(0.0);
        self.spaces.action.clamp(action);
        Ok(())
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.spaces.observation_len())?;
        check_finite("action", action, self.spaces.action_len())?;
        values[0] = self.value;
        Ok(())
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.q_values(observation, action, values)?;
        gradients.fill(0.0);
        Ok(())
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        // Refused as a whole: either every transition is learned, or nothing has changed.
        check_finite("rewards", batch.rewards, batch.size)?;
        check_finite("continuations", batch.continuations, batch.size)?;
        check_finite("observations", batch.observations, batch.size * self.spaces.observation_len())?;
        check_finite("actions", batch.actions, batch.size * self.spaces.action_len())?;
        check_finite("next observations", batch.next_observations, batch.size * self.spaces.observation_len())?;
        check_finite("masks", batch.masks, batch.size)?;
        let Settings { rate, discount } = self.settings;
        for row in 0..batch.size {
            let target = batch.rewards[row] + discount * batch.continuations[row] * self.value;
            self.value += rate * batch.masks[row] * (target - self.value);
        }
        Ok(())
    }
}
<% endblock %>

<% block tests %>
    fn setup() -> Setup {
        let spaces = Spaces { observation: Space::unbounded(2), action: Space::uniform(1, -1.0, 1.0) };
        Setup::with_spaces(0, 1, Host::silent(), spaces)
    }

    #[test]
    fn a_reward_raises_the_value() {
        let mut learner = [[ type ]]::create(Settings::default(), &setup()).unwrap();
        let batch = Batch {
            size: 1,
            observations: &[0.0; 2],
            actions: &[0.0],
            rewards: &[1.0],
            next_observations: &[0.0; 2],
            continuations: &[1.0],
            masks: &[1.0],
        };
        learner.update(&batch).unwrap();
        let mut values = [0.0];
        learner.q_values(&[0.0; 2], &[0.0], &mut values).unwrap();
        assert!(values[0] > 0.0);
    }
<% endblock %>
