//! Runs of experiments: the joint loop, evaluation, run folders, checkpoints and replay.

pub mod checkpoint;
pub mod evaluation;
pub mod joint_loop;
pub mod lanes;
pub mod loop_state;
pub mod observer;
pub mod reliability;
pub mod run;
