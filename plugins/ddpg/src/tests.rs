use shield_api::{Space, Spaces};

use crate::Ddpg;

#[macro_use]
#[path = "../../../tests/learners/conformance.rs"]
mod conformance;
#[macro_use]
#[path = "../../../tests/learners/continuous.rs"]
mod continuous;

impl conformance::Subject for Ddpg {
    const SMALL: &'static [(&'static str, &'static str)] = &[
        ("critics", "3"),
        ("actor_hidden", "[20, 15]"),
        ("critic_hidden", "[20, 15]"),
        ("random_steps", "1"),
        ("final_sigma", "Some(0.1)"),
        ("sigma_steps", "7"),
    ];
    const CHANGES: &'static [(&'static str, &'static str)] = &[
        ("critics", "4"),
        ("actor_hidden", "[20, 16]"),
        ("critic_hidden", "[20]"),
        ("activation", "Relu"),
        ("actor_rate", "2e-4"),
        ("critic_rate", "2e-3"),
        ("discount", "0.9"),
        ("tau", "0.5"),
        ("loss", "Squared"),
        ("noise", "OrnsteinUhlenbeck(theta: 0.5)"),
        ("sigma", "0.3"),
        ("final_sigma", "Some(0.05)"),
        ("sigma_steps", "5"),
        ("random_steps", "2"),
        ("initial_value", "Some(4.0)"),
        ("gradient_clip", "Some(1e-8)"),
        ("normalise_observations", "true"),
    ];
    const IMPOSSIBLE: &'static [(&'static str, &'static str)] = &[
        ("critics", "0"),
        ("actor_hidden", "[]"),
        ("critic_hidden", "[5, 0]"),
        ("actor_rate", "0.0"),
        ("critic_rate", "NaN"),
        ("discount", "1.5"),
        ("tau", "0.0"),
        ("tau", "1.5"),
        ("sigma", "-1.0"),
        ("final_sigma", "Some(NaN)"),
        ("noise", "OrnsteinUhlenbeck(theta: 2.0)"),
        ("initial_value", "Some(inf)"),
        ("gradient_clip", "Some(0.0)"),
    ];

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
