<% extends "rust/base.rs" %>
<% block summary %>always pushes equally hard; put a controller here<% endblock %>
<% block description %>Always pushes equally hard<% endblock %>

<% block settings %>
        /// Where in each dimension's range the action lies: -1 is its lower end, 1 its upper.
        push: f32 = 0.5,
<% endblock %>

<% block instance %>
/// The policy.
struct [[ type ]] {
    spaces: Spaces,
    action: Vec<f32>,
}
<% endblock %>

<% block create %>
        if !(-1.0..=1.0).contains(&settings.push) {
            let message = format!("`push` is {}; it must be in [-1, 1]", settings.push);
            return Err(Error::invalid_config(message).in_field("push"));
        }
        let spaces = setup.spaces()?.clone();
        let action = match &spaces.action {
            Space::Box { low, high } => {
                let middle = low.iter().zip(high).map(|(low, high)| (low + high) / 2.0);
                middle.zip(low.iter().zip(high)).map(|(at, (low, high))| at + settings.push * (high - low) / 2.0).collect()
            }
            Space::Discrete { .. } => vec![0.0],
        };
        Ok(Self { spaces, action })
<% endblock %>

<% block abilities %>
impl Policy for [[ type ]] {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.spaces.observation_len())?;
        action.copy_from_slice(&self.action);
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
    fn the_policy_pushes_half_as_hard_as_it_can() {
        let mut policy = [[ type ]]::create(Settings::default(), &setup()).unwrap();
        let mut action = [0.0];
        policy.act(&[0.0, 0.0], &mut action).unwrap();
        assert_eq!(action, [0.5]);
    }
<% endblock %>
