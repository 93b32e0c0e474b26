//! A finished policy from a file that torch has exported.

use shield_api::{Checkpoint, Error, Plugin, Policy, Result, Setup, check_finite, check_length};
use tch::{CModule, Device, Kind, TchError, Tensor, no_grad};

use crate::networks::{failed, read};

shield_api::config! {
    /// Settings of a TorchScript policy.
    pub struct TorchScriptConfig {
        /// The file that `torch.jit.script` or `torch.jit.trace` has made, `….pt`. It maps `1 × observation_len` to `1 × action_len`.
        path: String = String::new() => "\"\"",
        /// Whether the file's actions lie in [-1, 1] and are to be spread over the action space.
        in_unit_box: bool = false,
    }
}

/// Plays a TorchScript file: the actions are those of its `forward`.
#[derive(Debug)]
pub struct TorchScript {
    module: CModule,
    device: Device,
    observation_len: usize,
    /// Centre and half the range of each dimension, where the file's actions are to be spread.
    spread: Option<Vec<(f32, f32)>>,
    action_len: usize,
}

impl Plugin for TorchScript {
    type Config = TorchScriptConfig;

    fn create(config: TorchScriptConfig, setup: &Setup) -> Result<Self> {
        let spaces = setup.spaces()?;
        let device = Device::cuda_if_available();
        tch::set_num_threads(setup.threads as i32);
        let mut module = CModule::load_on_device(&config.path, device).map_err(|error| {
            let message = format!("path is {:?}, which is no TorchScript file: {error}", config.path);
            Error::invalid_config(message).in_field("path")
        })?;
        module.f_set_eval().map_err(failed)?;
        let spread = match (config.in_unit_box, &spaces.action) {
            (false, _) => None,
            (true, shield_api::Space::Box { low, high }) => {
                let spread = |(low, high): (&f32, &f32)| (low + (high - low) / 2.0, (high - low) / 2.0);
                Some(low.iter().zip(high).map(spread).collect())
            }
            (true, shield_api::Space::Discrete { .. }) => {
                let message = "in_unit_box needs continuous actions";
                return Err(Error::invalid_config(message).in_field("in_unit_box"));
            }
        };
        let mut policy = Self {
            module,
            device,
            observation_len: spaces.observation_len(),
            spread,
            action_len: spaces.action_len(),
        };
        // A file for another robot is refused here, not in the middle of a run.
        policy.play(&vec![0.0; policy.observation_len], &mut vec![0.0; policy.action_len]).map_err(
            |error| {
                let message = format!("{:?} does not fit the spaces: {error}", config.path);
                Error::invalid_config(message).in_field("path")
            },
        )?;
        Ok(policy)
    }
}

impl TorchScript {
    fn play(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        let forward = || -> Result<Tensor, TchError> {
            let seen = Tensor::f_from_slice(observation)?.f_view([1, -1])?.f_to_device(self.device)?;
            self.module.forward_ts(&[seen])?.f_to_kind(Kind::Float)
        };
        let acted = no_grad(forward).map_err(failed)?;
        if acted.numel() != action.len() {
            let (found, expected) = (acted.numel(), action.len());
            return Err(Error::failed(format!("it returns {found} values, the action has {expected}")));
        }
        read(&acted, action)?;
        for (value, (centre, half_range)) in action.iter_mut().zip(self.spread.iter().flatten()) {
            *value = centre + half_range * *value;
        }
        Ok(())
    }
}

impl Policy for TorchScript {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.observation_len)?;
        check_length("action", action, self.action_len)?;
        self.play(observation, action)?;
        check_finite("the action", action, self.action_len)
    }
}

impl Checkpoint for TorchScript {
    fn save(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        // The file is the state; it keeps nothing else.
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        if bytes.is_empty() {
            Ok(())
        } else {
            Err(Error::invalid_argument("a TorchScript policy has no state"))
        }
    }
}
