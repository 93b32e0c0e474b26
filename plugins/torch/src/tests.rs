//! The suites of all learners, as far as torch promises what they ask.
use learner_kit::AgentConfig;
use shield_api::Plugin;

use conformance::Settings;

use crate::{Ddpg, F32, Td3, networks::numbers};

#[macro_use]
#[path = "../../../tests/learners/conformance.rs"]
#[allow(dead_code, reason = "what torch does not promise is not asked")]
mod conformance;
mod bf16;
#[allow(dead_code, unused_macros, reason = "as above")]
#[path = "../../../tests/learners/continuous.rs"]
mod continuous;
#[allow(dead_code, reason = "as above")]
#[path = "../../../tests/learners/gradients.rs"]
mod gradients;
#[path = "../../../tests/learners/reference.rs"]
mod reference;
mod torchscript;

/// What the tests know of a learner, and the tests themselves.
macro_rules! learner_tests {
    ($module:ident, $learner:ty, $networks:literal, plain: $plain:expr, changes: $changes:expr, impossible: $impossible:expr) => {
        mod $module {
            use super::*;

            impl continuous::Continuous for $learner {
                const MAGIC: &'static [u8] = <<$learner as Plugin>::Config as AgentConfig>::MAGIC;
                const NETWORKS: usize = $networks;
                type Policy = ();

                fn plain() -> Settings {
                    $plain
                }

                fn own_changes() -> Settings {
                    $changes
                }

                fn own_impossible() -> Settings {
                    $impossible
                }

                fn own_refused() -> &'static [&'static str] {
                    &["layer_norm", "dropout"]
                }

                fn network_value(&mut self, network: usize, observation: &[f32], action: &[f32]) -> f32 {
                    let seen = self.agent.rows_of(observation, 1).unwrap();
                    let unit = self.agent.rows_of(&continuous::to_unit(action), 1).unwrap();
                    numbers(&self.agent.critics.outputs(&seen, Some(&unit)).unwrap()).unwrap()[network]
                }
            }

            // Not those that count allocations or compare bits between numbers of threads: torch promises neither.
            conformance_tests! { $learner, conformance:
                every_configuration_field_changes_the_behaviour,
                the_manifest_states_the_defaults,
                impossible_settings_and_spaces_are_refused,
                a_broken_batch_is_refused_and_changes_nothing,
                wrong_arguments_are_refused,
                a_loaded_learner_continues_bit_for_bit,
                foreign_bytes_are_refused_and_change_nothing,
                a_greedy_action_draws_no_random_number,
                a_member_learns_only_what_its_mask_allows,
                values_begin_at_the_configured_one,
                a_loss_that_overflows_is_an_error_and_leaves_values_finite,
            }
            conformance_tests! { $learner, continuous:
                actions_stay_in_their_box_whatever_the_noise,
                gradients_match_finite_differences_of_the_values,
                the_learner_finds_the_best_action_of_one_step,
                the_gradient_of_the_actor_is_that_of_the_ensembles_mean,
            }
            conformance_tests! { $learner, gradients:
                the_gradient_of_the_critics_is_that_of_their_loss,
            }

            #[test]
            fn the_updates_match_the_reference() {
                reference::the_updates_match_the_reference::<$learner>();
            }
        }
    };
}

learner_tests!(ddpg, Ddpg<F32>, 1,
    plain: Settings::new(),
    changes: vec![("loss", "Squared")],
    impossible: Settings::new());
learner_tests!(td3, Td3<F32>, 2,
    plain: vec![("target_sigma", "0.0"), ("policy_delay", "1")],
    changes: vec![("policy_delay", "3"), ("target_sigma", "0.1"), ("target_clip", "0.1"), ("loss", "Huber")],
    impossible: vec![("policy_delay", "0"), ("target_sigma", "-0.1"), ("target_clip", "NaN")]);
