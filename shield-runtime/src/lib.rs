//! The host of the shield: a façade over its crates, so that a program depends on one.
//!
//! | crate | what it is | feature |
//! |---|---|---|
//! | `shield-core` | ladder, rules, projection, reset cycle, experience, agents, [`drop_in`], [`shielded`] | |
//! | `shield-host` | [`plugin`]s: registry, trust, calls, isolation | |
//! | `shield-config` | [`experiment`]s and drop-ins in RON | |
//! | `shield-decisions` | the [`record`] of a drop-in's decisions | `decisions` |
//! | `shield-lab` | runs: the joint loop, evaluation, folders, checkpoints | `lab` |
//! | `shield-report` | records, figures, pages, films | `report` |
//! | `shield-check` | checks and benchmarks for authors of plugins | `check` |

#[cfg(feature = "check")]
pub use shield_check::{environment_check, plugin_bench, plugin_check};
pub use shield_config::{atomic_file, drop_in_files, experiment};
pub use shield_core::{
    agent, controller, critic, cycle, decision, diagnosis, drop_in, events, examination, experience,
    plugin_state, settings, shield, shielded, world,
};
#[cfg(feature = "decisions")]
pub use shield_decisions::record;
pub use shield_host::plugin;
#[cfg(feature = "lab")]
pub use shield_lab::{checkpoint, evaluation, joint_loop, lanes, loop_state, observer, reliability, run};
#[cfg(feature = "report")]
pub use shield_report::{film, report};
