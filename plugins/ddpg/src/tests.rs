use shield_api::{Space, Spaces};

use conformance::Settings;

use crate::Ddpg;

#[macro_use]
#[path = "../../../tests/learners/conformance.rs"]
mod conformance;
#[macro_use]
#[path = "../../../tests/learners/continuous.rs"]
mod continuous;

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

conformance_tests!(Ddpg);
continuous_tests!(Ddpg);

#[test]
#[ignore = "a measurement: run with --release --nocapture --test-threads 1"]
fn how_long_it_takes() {
    continuous::print_how_long_it_takes::<Ddpg>("(random_steps: 0)");
}
