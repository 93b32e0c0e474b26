<% extends "rust/base.rs" %>
<% block summary %>reset means that the first number of the observation is small<% endblock %>
<% block description %>Reset is where the first number of the observation is small<% endblock %>

<% block settings %>
        /// The largest magnitude of the first number that counts as reset.
        tolerance: f32 = 0.1,
<% endblock %>

<% block instance %>
/// The task.
struct [[ type ]] {
    tolerance: f32,
    spaces: Spaces,
}
<% endblock %>

<% block create %>
        let spaces = setup.spaces()?.clone();
        if !(settings.tolerance > 0.0 && settings.tolerance.is_finite()) {
            let message = format!("`tolerance` is {}; it must be above 0", settings.tolerance);
            return Err(Error::invalid_config(message).in_field("tolerance"));
        }
        if spaces.observation_len() == 0 {
            return Err(Error::invalid_config("the observation has no numbers"));
        }
        Ok(Self { tolerance: settings.tolerance, spaces })
<% endblock %>

<% block abilities %>
impl ResetTask for [[ type ]] {
    fn evaluate(&mut self, observation: &[f32], action: &[f32], next_observation: &[f32]) -> Result<ResetSignal> {
        check_finite("observation", observation, self.spaces.observation_len())?;
        check_finite("action", action, self.spaces.action_len())?;
        check_finite("next observation", next_observation, self.spaces.observation_len())?;
        let distance = next_observation[0].abs();
        Ok(ResetSignal { reward: (1.0 - distance).max(0.0), in_reset_set: distance < self.tolerance })
    }
}
<% endblock %>

<% block tests %>
    #[test]
    fn only_observations_near_the_target_are_in_the_reset_set() {
        let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
        let setup = Setup::with_spaces(0, 1, Host::silent(), spaces);
        let mut task = [[ type ]]::create(Settings::default(), &setup).unwrap();
        assert!(task.evaluate(&[1.0], &[0.0], &[0.05]).unwrap().in_reset_set);
        assert!(!task.evaluate(&[0.0], &[0.0], &[0.5]).unwrap().in_reset_set);
    }
<% endblock %>
