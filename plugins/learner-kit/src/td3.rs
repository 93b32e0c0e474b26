//! The configuration of TD3.

use actor_critic::{
    Activation, Initialisation, Loss, NoiseProcess, Valuation, check_not_negative, check_positive,
};
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;

use crate::settings::check_tau;

shield_api::config! {
    /// Settings of TD3. "TD3" is Fujimoto et al. 2018; "paper" is Leave no Trace, appendix C.
    pub struct Td3Config {
        /// How many pairs of Q-functions; a pair's value is the smaller one (paper: 20 Q-functions).
        critics: usize = 20,
        /// Hidden layers of the actor (TD3 and paper: 400, 300).
        actor_hidden: Vec<usize> = vec![400, 300] => "[400, 300]",
        /// Hidden layers of a critic (TD3 and paper: 400, 300).
        critic_hidden: Vec<usize> = vec![400, 300] => "[400, 300]",
        /// The hidden layer of a critic at which the action enters, from 0; the last if there are fewer (paper: 1; TD3: 0).
        action_layer: usize = 1,
        /// Tanh or Relu in hidden layers (paper: tanh; TD3: ReLU).
        activation: Activation = Activation::Tanh => "Tanh",
        /// Normalises the sums of a critic's hidden layers before the activation (not in TD3; DroQ, Hiraoka et al. 2022, and RLPD do).
        layer_norm: bool = false,
        /// Probability with which an update drops a hidden unit of a critic (not in TD3; DroQ: 0.01 or less, with `layer_norm`).
        dropout: f32 = 0.0,
        /// AdamW's decay of the matrices of actor and critics, times their step sizes (not in TD3).
        weight_decay: f64 = 0.0,
        /// How weights begin: Lillicrap (DDPG's: small in the last layer), FanIn (PyTorch's, so TD3's), Glorot or He.
        initialisation: Initialisation = Initialisation::Lillicrap => "Lillicrap",
        /// Adam's step size for the actor (TD3: 1e-3 with 400-300; its authors' later code has 3e-4 with 256-256).
        actor_rate: f64 = 1e-3,
        /// Adam's step size for the critics (as the actor's).
        critic_rate: f64 = 1e-3,
        /// γ (TD3 and paper: 0.99).
        discount: f32 = 0.99,
        /// Share by which target networks follow, each time that the actor learns (TD3: 0.005).
        tau: f64 = 0.005,
        /// Updates of the critics per update of the actor and of all target networks (TD3: 2).
        policy_delay: u64 = 2,
        /// Size of the noise on target actions, as a share of half the action's range (TD3: 0.2).
        target_sigma: f32 = 0.2,
        /// Bound of that noise, in the same unit (TD3: 0.5).
        target_clip: f32 = 0.5,
        /// Squared or Huber loss of the critics (TD3: squared).
        loss: Loss = Loss::Squared => "Squared",
        /// Gaussian (TD3), or OrnsteinUhlenbeck(theta: 0.15).
        noise: NoiseProcess = NoiseProcess::Gaussian => "Gaussian",
        /// Size of the exploration noise, as a share of half the action's range (TD3: 0.1).
        sigma: f32 = 0.1,
        /// Size of the noise after `sigma_steps`; None: it stays.
        final_sigma: Option<f32> = None,
        /// Exploring actions within which the noise moves linearly to `final_sigma`.
        sigma_steps: u64 = 100_000 => "100000",
        /// Exploring actions that are uniform in the space, at the beginning (TD3: 1,000 for small tasks).
        random_steps: u64 = 1_000 => "1000",
        /// Optimistic initial values: a bias of each critic's last layer, of its target network too.
        initial_value: Option<f32> = None,
        /// Longest gradient of each network; None: as it is.
        gradient_clip: Option<f32> = None,
        /// Scales observations by the running mean and variance of the batches.
        normalise_observations: bool = false,
        /// F32, or Half: `q_values` from copies of the weights in 16 bits, at half the reading (within 2⁻¹¹ of each weight).
        valuation: Valuation = Valuation::F32 => "F32",
    }
}

crate::settings::describe_agent!(Td3Config, "TD3", magic: b"shield/td3/1\n", networks_per_member: 2, also_check: |config| {
    check_tau(config.tau)?;
    config.check_noise()?;
    check_positive("policy_delay", config.policy_delay as f64)?;
    check_not_negative("target_sigma", config.target_sigma)?;
    check_not_negative("target_clip", config.target_clip)
}, exploration: Self::noisy);
crate::settings::describe_noise!(Td3Config);

impl Td3Config {
    /// Target smoothing of actions in [-1, 1]: ã = π'(s') + clip(σ̃ N(0, 1), ±c), inside the box. The same for every pair.
    pub fn smooth(&self, actions: &mut [f32], rng: &mut impl Rng) {
        let (sigma, clip) = (self.target_sigma, self.target_clip);
        for action in actions {
            let draw: f32 = rng.sample(StandardNormal);
            *action = (*action + (sigma * draw).clamp(-clip, clip)).clamp(-1.0, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn target_noise_keeps_its_deviation_its_bound_and_the_box() {
        let config = Td3Config { target_sigma: 0.2, target_clip: 0.3, ..Td3Config::default() };
        let mut rng = Pcg64::seed_from_u64(5);
        let mut noise = vec![0.0; 20_000];
        config.smooth(&mut noise, &mut rng);
        let largest = noise.iter().fold(0.0_f32, |largest, x| largest.max(x.abs()));
        assert_eq!(largest, 0.3);
        // P(|N| > 1.5) = 0.1336.
        let cut = noise.iter().filter(|x| x.abs() == 0.3).count() as f64 / 20_000.0;
        assert!((cut - 0.1336).abs() < 0.01, "{cut}");
        let mut noise = vec![0.95; 20_000];
        config.smooth(&mut noise, &mut rng);
        assert!(noise.iter().all(|x| (0.65..=1.0).contains(x)) && noise.contains(&1.0));
    }
}
