#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod ball_in_cup;
mod cheetah;
mod cliff_cart;
mod cliff_cheetah;
mod cliff_walker;
mod half_cheetah;
mod inverted_pendulum;
mod noise;
mod peg_insertion;
mod picture;
mod pusher;
mod reward;
mod scenery;
mod simulation;
mod task;
mod walker;
mod walker2d;

use ball_in_cup::BallInCup;
use cliff_cart::CliffCart;
use cliff_cheetah::CliffCheetah;
use cliff_walker::CliffWalker;
use half_cheetah::HalfCheetah;
use inverted_pendulum::InvertedPendulum;
use peg_insertion::PegInsertion;
use pusher::Pusher;
use task::Robot;
use walker::Walker;

shield_api::export_plugin! {
    environment "mujoco/ball-in-cup" => Robot<BallInCup> {
        description: "A ball on a string that must be swung into its cup (paper, section 6.1)",
        deterministic: true,
    }
    environment "mujoco/cliff-cart" => Robot<CliffCart> {
        description: "A cart that must stop a hand's breadth before a table's edge",
        deterministic: true,
    }
    environment "mujoco/cliff-cheetah" => Robot<CliffCheetah> {
        description: "The half-cheetah on a cliff of 14 m (paper, section 6)",
        deterministic: true,
    }
    environment "mujoco/cliff-walker" => Robot<CliffWalker> {
        description: "The planar walker on a cliff of 6 m (paper, appendix A)",
        deterministic: true,
    }
    environment "mujoco/half-cheetah" => Robot<HalfCheetah> {
        description: "The half-cheetah on a plane, with Gymnasium's reward",
        deterministic: true,
    }
    environment "mujoco/inverted-pendulum" => Robot<InvertedPendulum> {
        description: "A pole on a cart, with Gymnasium's reward",
        deterministic: true,
    }
    environment "mujoco/peg-insertion" => Robot<PegInsertion> {
        description: "An arm that pulls a peg out of a hole; putting it back is the reset (paper, section 6.6)",
        deterministic: true,
    }
    environment "mujoco/pusher" => Robot<Pusher> {
        description: "An arm that must push a puck to a goal without losing it (paper, section 6)",
        deterministic: true,
    }
    environment "mujoco/walker" => Robot<Walker> {
        description: "The planar walker on a plane, with Gymnasium's reward",
        deterministic: true,
    }
}

#[cfg(test)]
mod peers;
#[cfg(test)]
mod suite;
#[cfg(test)]
mod testing;
