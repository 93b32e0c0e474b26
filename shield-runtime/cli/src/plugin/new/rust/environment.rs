<% extends "rust/base.rs" %>
<% set saved = "position" %>
<% block setup %>_setup<% endblock %>
<% block summary %>a point on a line that falls off beyond 1<% endblock %>
<% block description %>A point on a line that falls off beyond 1<% endblock %>

<% block settings %>
        /// How far one step leads.
        stride: f32 = 0.1,
        /// Steps of an episode.
        horizon: usize = 50,
<% endblock %>

<% block instance %>
/// The state of the world.
struct [[ type ]] {
    settings: Settings,
    position: f32,
}
<% endblock %>

<% block create %>
        // A value that cannot be is refused here, so that nobody checks again.
        if !(settings.stride > 0.0 && settings.stride.is_finite()) {
            let message = format!("`stride` is {}; it must be above 0", settings.stride);
            return Err(Error::invalid_config(message).in_field("stride"));
        }
        if settings.horizon == 0 {
            return Err(Error::invalid_config("`horizon` is 0; an episode needs a step").in_field("horizon"));
        }
        Ok(Self { settings, position: 0.0 })
<% endblock %>

<% block abilities %>
impl Environment for [[ type ]] {
    fn spec(&self) -> EnvironmentSpec {
        let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
        EnvironmentSpec { spaces, episode_length: self.settings.horizon, brings_reset_reward: true }
    }

    fn reset(&mut self, _seed: u64, observation: &mut [f32]) -> Result<()> {
        self.position = 0.0;
        observation[0] = self.position;
        Ok(())
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        check_finite("action", action, 1)?;
        let has_fallen = self.position > 1.0;
        if !has_fallen {
            self.position += self.settings.stride * action[0].clamp(-1.0, 1.0);
        }
        observation[0] = self.position;
        Ok(StepOutcome {
            forward_reward: self.position.clamp(0.0, 1.0),
            reset_reward: 1.0 - self.position.abs().min(1.0),
            in_reset_set: self.position.abs() < 0.1,
            success: self.position > 0.9,
            irreversible: self.position > 1.0,
            ..StepOutcome::default()
        })
    }
}
<% endblock %>

<% block tests %>
    #[test]
    fn driving_to_the_right_ends_in_an_irreversible_fall() {
        let mut world = [[ type ]]::create(Settings::default(), &Setup::new(0, 1, Host::silent())).unwrap();
        let mut observation = [0.0];
        world.reset(0, &mut observation).unwrap();
        let fall = (0..20).map(|_| world.step(&[1.0], &mut observation).unwrap().irreversible).collect::<Vec<_>>();
        assert!(!fall[0] && fall[19]);
        assert!(world.step(&[-1.0], &mut observation).unwrap().irreversible, "there is no way back");
    }
<% endblock %>
