//! `{{id}}`: reset means that the first number of the observation is small.
#![forbid(unsafe_code)]

use shield_api::*;


config! {
    /// Settings of `{{id}}`.
    pub struct Settings {
        /// The largest magnitude of the first number that counts as reset.
        tolerance: f32 = 0.1,
    }
}

/// The task.
struct {{type}} {
    tolerance: f32,
    spaces: Spaces,
}

impl Plugin for {{type}} {
    type Config = Settings;

    fn create(settings: Settings, setup: &Setup) -> Result<Self> {
        let spaces = setup.spaces()?.clone();
        if !(settings.tolerance > 0.0 && settings.tolerance.is_finite()) {
            return Err(Error::invalid_config(format!("`tolerance` is {}; it must be above 0", settings.tolerance)));
        }
        if spaces.observation_len() == 0 {
            return Err(Error::invalid_config("the observation has no numbers"));
        }
        Ok(Self { tolerance: settings.tolerance, spaces })
    }
}

impl ResetTask for {{type}} {
    fn evaluate(&mut self, observation: &[f32], action: &[f32], next_observation: &[f32]) -> Result<ResetSignal> {
        check_finite("observation", observation, self.spaces.observation_len())?;
        check_finite("action", action, self.spaces.action_len())?;
        check_finite("next observation", next_observation, self.spaces.observation_len())?;
        let distance = next_observation[0].abs();
        Ok(ResetSignal { reward: (1.0 - distance).max(0.0), in_reset_set: distance < self.tolerance })
    }
}

/// There is no state beyond the configuration: nothing to save, and nothing to load.
impl Checkpoint for {{type}} {
    fn save(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        if bytes.is_empty() { Ok(()) } else { Err(Error::invalid_argument("there is no state to load")) }
    }
}

shield_api::export_plugin! {
    reset_task "{{id}}" => {{type}} { description: "Reset is where the first number of the observation is small", deterministic: true }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_near_counts_as_reset() {
        let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
        let setup = Setup::with_spaces(0, 1, Host::silent(), spaces);
        let mut task = {{type}}::create(Settings::default(), &setup).unwrap();
        assert!(task.evaluate(&[1.0], &[0.0], &[0.05]).unwrap().in_reset_set);
        assert!(!task.evaluate(&[0.0], &[0.0], &[0.5]).unwrap().in_reset_set);
    }
}
