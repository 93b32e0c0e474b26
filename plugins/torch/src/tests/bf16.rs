//! Products in bfloat16.

use shield_api::{Host, Learner, Plugin, PluginConfig, Setup};

use super::{conformance::Transitions, continuous};
use crate::{Bf16, Ddpg, F32, agent::Precision};

/// The values of one (s, a) after some updates.
fn learned<P: Precision>() -> Vec<f32> {
    let config = "(critics: 3, actor_hidden: [20, 15], critic_hidden: [20, 15], critic_rate: 1e-2)";
    let setup = Setup::with_spaces(5, 1, Host::silent(), continuous::spaces());
    let mut learner = Ddpg::<P>::create(PluginConfig::parse(config).unwrap(), &setup).unwrap();
    for seed in 0..40 {
        learner.update(&Transitions::random::<Ddpg<F32>>(3, seed % 4).batch()).unwrap();
    }
    let mut values = vec![0.0; 3];
    learner.q_values(&[0.3, -0.2, 0.7], &[0.5, 0.6], &mut values).unwrap();
    values
}

#[test]
fn bf16_learns_nearly_what_f32_learns() {
    let (full, short) = (learned::<F32>(), learned::<Bf16>());
    assert_ne!(full, short);
    for (full, short) in full.iter().zip(&short) {
        assert!((full - short).abs() < 0.05 + 0.1 * full.abs(), "{short} against {full}");
    }
}
