use learner_kit::AgentConfig;

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

impl continuous::Continuous for Ddpg {
    const MAGIC: &'static [u8] = DdpgConfig::MAGIC;
    const NETWORKS: usize = 1;

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
#[ignore = "a measurement: run with --release --nocapture --test-threads 1"]
fn how_long_it_takes() {
    continuous::print_how_long_it_takes::<Ddpg>("(random_steps: 0)");
}

#[test]
#[ignore = "run by `cargo xtask test --torch`"]
fn a_reference_is_written() {
    reference::a_reference_is_written::<Ddpg>();
}
