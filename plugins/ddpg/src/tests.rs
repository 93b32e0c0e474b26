use shield_api::{ActMode, Learner, Space, Spaces};

use conformance::Settings;

use crate::Ddpg;

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

impl conformance::Subject for Ddpg {
    fn small() -> Settings {
        continuous::small()
    }

    fn changes() -> Settings {
        continuous::changes(&[("loss", "Squared")])
    }

    fn impossible() -> Settings {
        continuous::impossible(&[])
    }

    fn spaces() -> Spaces {
        continuous::spaces()
    }

    fn impossible_actions() -> Vec<Space> {
        continuous::impossible_actions()
    }
}

impl gradients::Inside for Ddpg {
    type State = continuous::State;
    const MAGIC: &'static [u8] = crate::MAGIC;
    const NETWORKS: usize = 1;

    fn plain() -> Settings {
        Settings::new()
    }

    fn critics(state: &mut continuous::State) -> &mut gradients::Networks {
        &mut state.critics
    }

    fn actor(state: &mut continuous::State) -> Option<&mut gradients::Networks> {
        Some(&mut state.actor)
    }

    fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
        let mut critic = self.agent.critics.member(network);
        critic.observe(observation);
        critic.values(&continuous::to_unit(action))[0]
    }

    fn next_value(&mut self, member: usize, observation: &[f32]) -> f32 {
        let mut action = [0.0; 2];
        self.act(observation, ActMode::Greedy, &mut action).unwrap();
        self.network_value(member, observation, &action)
    }
}

conformance_tests!(Ddpg);
continuous_tests!(Ddpg);

#[test]
fn the_same_seed_learns_the_same_weights() {
    reference::the_same_seed_learns_the_same_weights::<Ddpg>();
}
