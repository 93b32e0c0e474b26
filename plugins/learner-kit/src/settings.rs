//! What the settings of an actor-critic learner have in common.

use actor_critic::{Error, check_positive, check_share};

/// The share by which target networks follow is positive and at most 1.
pub(crate) fn check_tau(tau: f64) -> Result<(), Error> {
    check_positive("tau", tau)?;
    check_share("tau", tau)
}

/// Gives a configuration the method that describes its agent. The configurations list these fields each for itself, since their defaults
/// and sources differ; here they are read. `exploration` adds to the agent's settings how it explores; without, its actions are not disturbed.
macro_rules! describe_agent {
    ($config:ty, $name:literal, magic: $magic:literal, networks_per_member: $networks:literal, also_check: $check:expr, exploration: $explored:expr) => {
        impl $crate::AgentConfig for $config {
            const MAGIC: &'static [u8] = $magic;

            fn info(&self) -> shield_api::LearnerInfo {
                shield_api::LearnerInfo { members: self.critics, discount: self.discount }
            }

            fn agent<'a>(
                &'a self,
                setup: &shield_api::Setup,
            ) -> shield_api::Result<actor_critic::AgentSettings<'a>> {
                let also_check: fn(&Self) -> Result<(), actor_critic::Error> = $check;
                self.check_common().and_then(|()| also_check(self)).map_err($crate::plugin_error)?;
                let spaces = setup.spaces()?;
                let shield_api::Space::Box { low, high } = &spaces.action else {
                    return Err(shield_api::Error::invalid_argument(concat!(
                        $name,
                        " needs continuous actions; for discrete ones there is ddqn"
                    )));
                };
                let explored: fn(
                    &'a Self,
                    actor_critic::AgentSettings<'a>,
                ) -> actor_critic::AgentSettings<'a> = $explored;
                Ok(explored(
                    self,
                    actor_critic::AgentSettings {
                        observation_len: spaces.observation_len(),
                        scale: actor_critic::ActionScale::new(low, high).map_err($crate::plugin_error)?,
                        actor_hidden: &self.actor_hidden,
                        critic_hidden: &self.critic_hidden,
                        action_layer: self.action_layer,
                        activation: self.activation,
                        regularisation: actor_critic::Regularisation {
                            layer_norm: self.layer_norm,
                            dropout: self.dropout,
                            batch_renorm: None,
                        },
                        initialisation: self.initialisation,
                        members: self.critics,
                        networks_per_member: $networks,
                        initial_value: self.initial_value,
                        normalise_observations: self.normalise_observations,
                        noise: actor_critic::NoiseProcess::Gaussian,
                        sigma: actor_critic::Schedule { start: 0.0, end: 0.0, steps: 0 },
                        random_steps: self.random_steps,
                        valuation: self.valuation,
                        initial_temperature: 1.0,
                        threads: setup.threads,
                        seed: setup.seed,
                    },
                ))
            }
        }

        impl $config {
            /// Refuses values that cannot be.
            fn check_common(&self) -> Result<(), actor_critic::Error> {
                use actor_critic::{
                    check_below_one, check_finite_setting, check_layers, check_not_negative, check_positive,
                    check_share,
                };
                check_positive("critics", self.critics as f64)?;
                check_layers("actor_hidden", &self.actor_hidden)?;
                check_layers("critic_hidden", &self.critic_hidden)?;
                check_positive("actor_rate", self.actor_rate)?;
                check_positive("critic_rate", self.critic_rate)?;
                check_below_one("dropout", self.dropout)?;
                check_not_negative("weight_decay", self.weight_decay)?;
                check_share("discount", self.discount)?;
                check_finite_setting("initial_value", self.initial_value.unwrap_or(0.0))?;
                check_positive("gradient_clip", self.gradient_clip.unwrap_or(1.0))
            }
        }
    };
}

/// Exploration by noise on the actions of a deterministic policy: the check of its settings, and what they make of an agent's.
macro_rules! describe_noise {
    ($config:ty) => {
        impl $config {
            fn check_noise(&self) -> Result<(), actor_critic::Error> {
                use actor_critic::{check_not_negative, check_share};
                if let actor_critic::NoiseProcess::OrnsteinUhlenbeck { theta } = self.noise {
                    check_share("noise.theta", theta)?;
                }
                check_not_negative("sigma", self.sigma)?;
                check_not_negative("final_sigma", self.final_sigma.unwrap_or(0.0))
            }

            fn noisy<'a>(
                &'a self,
                settings: actor_critic::AgentSettings<'a>,
            ) -> actor_critic::AgentSettings<'a> {
                let sigma = actor_critic::Schedule {
                    start: self.sigma,
                    end: self.final_sigma.unwrap_or(self.sigma),
                    steps: self.sigma_steps,
                };
                actor_critic::AgentSettings { noise: self.noise, sigma, ..settings }
            }
        }
    };
}

/// A learned temperature: the check of its settings.
macro_rules! describe_temperature {
    ($config:ty) => {
        impl $config {
            fn check_temperature(&self) -> Result<(), actor_critic::Error> {
                use actor_critic::{check_finite_setting, check_not_negative, check_positive};
                check_not_negative("temperature_rate", self.temperature_rate)?;
                check_positive("initial_temperature", self.initial_temperature)?;
                check_finite_setting("target_entropy", self.target_entropy.unwrap_or(0.0))
            }
        }
    };
}

pub(crate) use {describe_agent, describe_noise, describe_temperature};
