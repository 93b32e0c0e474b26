use learner_kit::AgentConfig;
use shield_api::Learner;

use conformance::Settings;

use crate::{Ddpg, DdpgConfig};

#[macro_use]
#[path = "../../../tests/learners/conformance.rs"]
mod conformance;
#[macro_use]
#[path = "../../../tests/learners/continuous.rs"]
mod continuous;
#[path = "../../../tests/learners/gradients.rs"]
mod gradients;
#[path = "../../../tests/learners/reference.rs"]
mod reference;
#[path = "../../../tests/learners/torch.rs"]
mod torch;

impl continuous::Continuous for Ddpg {
    const MAGIC: &'static [u8] = DdpgConfig::MAGIC;
    const NETWORKS: usize = 1;
    type Policy = ();

    fn own_changes() -> Settings {
        vec![("loss", "Squared")]
    }

    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
        continuous::network_value(&mut self.agent, network, observation, action)
    }
}

conformance_tests!(Ddpg);
continuous_tests!(Ddpg);

#[test]
fn the_same_seed_learns_the_same_weights() {
    reference::the_same_seed_learns_the_same_weights::<Ddpg>();
}

#[test]
fn twelve_updates_equal_those_of_torch() {
    let plain = &[];
    torch::check::<Ddpg>("ddpg", plain, 1, |learner, _, given| learner.update(&given.batch).unwrap());
    let regularised = &[("layer_norm", "true"), ("weight_decay", "0.1"), ("dropout", "0.25")];
    torch::check::<Ddpg>("ddpg-regularised", regularised, 1, |learner, _, given| {
        learner.update(&given.batch).unwrap();
    });
}
