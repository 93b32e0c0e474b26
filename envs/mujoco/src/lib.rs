#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod cliff_cart;
mod cliff_cheetah;
mod reward;
mod simulation;
mod task;

use cliff_cart::CliffCart;
use cliff_cheetah::CliffCheetah;
use task::Robot;

shield_api::export_plugin! {
    environment "mujoco/cliff-cart" => Robot<CliffCart> {
        description: "A cart that must stop a hand's breadth before a table's edge",
        deterministic: true,
    }
    environment "mujoco/cliff-cheetah" => Robot<CliffCheetah> {
        description: "The half-cheetah on a cliff of 14 m (paper, section 6)",
        deterministic: true,
    }
}

#[cfg(test)]
mod suite;
