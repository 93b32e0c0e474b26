//! `mujoco/cliff-cart`: a cart that must stop a hand's breadth before the edge of a table.

use shield_api::{Error, Result, StepOutcome};

use crate::noise::Noise;
use crate::picture::View;
use crate::reward::{tolerance, wrapped};
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};

robot_config! {
    /// Settings of the cart.
    pub struct CliffCartConfig {
        /// Steps of an episode.
        horizon: usize = 100,
        /// A hard reset draws position (m) and velocity (m/s) uniformly from ± this.
        start_noise: f64 = 0.05,
        /// Time steps of the model (0.01 s) that an action is held.
        control_step: usize = 5,
        /// What a hard reset costs that lifts the cart from the floor; one from the table costs 1.
        fall_cost: f64 = 1.0,
    }
}

/// Where the task is achieved: a hand's breadth from the edge at x = 1.
const GOAL: f64 = 0.9;

/// The quantities of the cart that the task speaks of.
struct Cart<'a>(&'a Simulation);

impl Cart<'_> {
    fn position(&self) -> f64 {
        self.0.positions()[0]
    }

    /// Of the cart's centre above where it is when it stands on the table.
    fn height(&self) -> f64 {
        self.0.positions()[1]
    }

    fn pitch(&self) -> f64 {
        wrapped(self.0.positions()[2])
    }

    fn speed(&self) -> f64 {
        self.0.velocities()[0].abs()
    }

    /// The centre is still above the table's top, which is 0.05 below where it rests.
    fn is_on_table(&self) -> bool {
        self.height() > -0.05
    }

    /// The whole cart is below the table's top, or will be in an instant: nothing lifts it again.
    fn has_fallen(&self) -> bool {
        self.height() < -0.1
    }
}

/// The task on the cart's model.
pub struct CliffCart;

impl CliffCart {
    /// Half for being near the goal at all, which shows the way from afar; half for being within centimetres of it, without
    /// which the last hand's breadth before the edge is worth as much as the goal. In [0, 1].
    fn nearness(distance: f64) -> f64 {
        let at_goal = [0.0, 0.02];
        0.5 * tolerance(distance, at_goal, 0.9) + 0.5 * tolerance(distance, at_goal, 0.15)
    }
}

impl Task for CliffCart {
    type Config = CliffCartConfig;

    /// At rest at the goal: where the reset agent has the furthest to go.
    const STARTS: &'static [&'static str] = &["goal"];

    fn check(config: &CliffCartConfig) -> Result<()> {
        let is_valid = config.fall_cost.is_finite() && config.fall_cost >= 0.0;
        if !is_valid {
            let message = format!("fall_cost is {}; it must be finite and not negative", config.fall_cost);
            return Err(Error::invalid_config(message).in_field("fall_cost"));
        }
        Ok(())
    }

    fn model(_config: &CliffCartConfig) -> String {
        include_str!("cliff_cart.xml").to_owned()
    }

    fn place(start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        match start {
            Some(_) => positions[0] = GOAL,
            None => {
                positions[0] = noise.uniform();
                velocities[0] = noise.uniform();
            }
        }
    }

    fn outcome(_config: &CliffCartConfig, simulation: &Simulation) -> StepOutcome {
        let cart = Cart(simulation);
        let on_table = if cart.is_on_table() { 1.0 } else { 0.0 };
        let distance = (cart.position() - GOAL).abs();
        let upright = tolerance(cart.pitch(), [-0.1, 0.1], 0.5);
        StepOutcome {
            forward_reward: (on_table * Self::nearness(distance)) as f32,
            reset_reward: (on_table * upright * tolerance(cart.position(), [-0.05, 0.05], 1.0)) as f32,
            in_reset_set: cart.is_on_table()
                && cart.position().abs() < 0.1
                && cart.pitch().abs() < 0.2
                && cart.speed() < 0.3,
            terminated: false,
            success: cart.is_on_table() && distance < 0.05 && cart.speed() < 0.1,
            irreversible: cart.has_fallen(),
        }
    }

    fn reset_kinds(config: &CliffCartConfig) -> Vec<(&'static str, f64)> {
        vec![("table", 1.0), ("floor", config.fall_cost)]
    }

    fn reset_kind(simulation: &Simulation) -> usize {
        usize::from(Cart(simulation).has_fallen())
    }

    fn view(_simulation: &Simulation) -> View {
        View::from_the_side([0.3, 0.0, -0.2], 3.4)
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Environment;

    use super::*;
    use crate::task::Robot;
    use crate::testing::{make, pseudo_random_actions, value_of_staying};

    type CartRobot = Robot<CliffCart>;

    /// A spring towards `target` with enough damping not to overshoot.
    fn controller(observation: &[f32], target: f32) -> f32 {
        (6.0 * (target - observation[0]) - 4.0 * observation[3]).clamp(-1.0, 1.0)
    }

    fn drive(cart: &mut CartRobot, observation: &mut [f32], steps: usize, target: f32) -> Vec<StepOutcome> {
        (0..steps)
            .map(|_| {
                let action = controller(observation, target);
                cart.step(&[action], observation).unwrap()
            })
            .collect()
    }

    fn push(cart: &mut CartRobot, observation: &mut [f32], steps: usize, action: f32) -> StepOutcome {
        (0..steps).map(|_| cart.step(&[action], observation).unwrap()).last().unwrap()
    }

    #[test]
    fn a_simple_controller_reaches_the_goal_and_returns_to_the_reset_set() {
        let mut observation = [0.0; 6];
        let mut cart: CartRobot = make("()");
        for seed in 0..5 {
            cart.reset(seed, &mut observation).unwrap();
            let there = drive(&mut cart, &mut observation, 50, GOAL as f32);
            assert!(there[49].success && there[49].forward_reward > 0.99, "{:?}", there[49]);
            assert!(there.iter().all(|outcome| !outcome.irreversible));
            let back = drive(&mut cart, &mut observation, 50, 0.0);
            assert!(back[49].in_reset_set && back[49].reset_reward > 0.99, "{:?}", back[49]);
        }
    }

    #[test]
    fn a_cart_at_full_speed_falls_and_nothing_brings_it_back() {
        let mut observation = [0.0; 6];
        let mut cart: CartRobot = make("()");
        cart.reset(0, &mut observation).unwrap();
        let fallen = push(&mut cart, &mut observation, 50, 1.0);
        assert!(fallen.irreversible && !fallen.terminated && !fallen.in_reset_set);
        for action in pseudo_random_actions(1, 300) {
            // Three steps each: long pushes, which reach further than noise.
            let outcome = push(&mut cart, &mut observation, 3, action[0].signum());
            assert!(outcome.irreversible && !outcome.in_reset_set && !outcome.success);
            assert_eq!((outcome.forward_reward, outcome.reset_reward), (0.0, 0.0));
        }
    }

    #[test]
    fn a_cart_that_has_just_fallen_cannot_brake_back_onto_the_table() {
        let mut observation = [0.0; 6];
        let mut cart: CartRobot = make("()");
        let mut slow_falls = 0;
        for percent in 2..60 {
            cart.reset_to("goal", 0, &mut observation).unwrap();
            let mut steps = 0;
            while !push(&mut cart, &mut observation, 1, percent as f32 / 100.0).irreversible && steps < 200 {
                steps += 1;
            }
            if steps < 200 {
                slow_falls += 1;
                let outcome = push(&mut cart, &mut observation, 100, -1.0);
                assert!(outcome.irreversible, "after a push of {percent}%: {observation:?}");
            }
        }
        assert!(slow_falls > 30, "{slow_falls}");
    }

    #[test]
    fn braking_at_the_last_moment_is_too_late() {
        // Momentum matters: from full speed at x = 0.8, where a slow cart is safe, full brakes do not hold.
        let mut observation = [0.0; 6];
        let mut cart: CartRobot = make("(start_noise: 0.0)");
        cart.reset(0, &mut observation).unwrap();
        while observation[0] < 0.75 {
            push(&mut cart, &mut observation, 1, 1.0);
        }
        assert!(push(&mut cart, &mut observation, 60, -1.0).irreversible);
        cart.reset(0, &mut observation).unwrap();
        drive(&mut cart, &mut observation, 60, 0.8);
        let held = push(&mut cart, &mut observation, 2, 1.0);
        assert!(!held.irreversible);
        assert!(!push(&mut cart, &mut observation, 60, -1.0).irreversible);
    }

    #[test]
    fn driving_away_from_the_cliff_is_safe() {
        let mut observation = [0.0; 6];
        let mut cart: CartRobot = make("()");
        cart.reset(0, &mut observation).unwrap();
        assert!(!push(&mut cart, &mut observation, 200, -1.0).irreversible);
        let back = drive(&mut cart, &mut observation, 100, 0.0);
        assert!(back[99].in_reset_set);
    }

    #[test]
    fn the_reset_value_separates_the_reset_set_from_the_pit() {
        let mut observation = [0.0; 6];
        let mut cart: CartRobot = make("()");
        cart.reset(0, &mut observation).unwrap();
        let safe = value_of_staying(&mut cart);
        push(&mut cart, &mut observation, 60, 1.0);
        let lost = value_of_staying(&mut cart);
        assert!(safe > 99.0 && lost == 0.0, "{safe} {lost}");
    }

    #[test]
    fn a_hard_reset_from_the_floor_has_its_own_cost() {
        let mut observation = [0.0; 6];
        let mut cart: CartRobot = make("(fall_cost: 7.0)");
        cart.reset(0, &mut observation).unwrap();
        let costs: Vec<f64> = cart.reset_kinds().iter().map(|kind| kind.cost).collect();
        assert_eq!((costs, cart.reset_kind()), (vec![1.0, 7.0], Ok(0)));
        push(&mut cart, &mut observation, 60, 1.0);
        assert_eq!(cart.reset_kind(), Ok(1));
        for config in ["(fall_cost: -1.0)", "(fall_cost: inf)"] {
            assert!(crate::testing::try_make::<CliffCart>(config).is_err(), "{config}");
        }
    }

    #[test]
    fn the_start_noise_is_as_large_as_configured() {
        let mut observation = [0.0; 6];
        let mut noisy: CartRobot = make("(start_noise: 0.2)");
        let largest = (0..50).fold(0.0f32, |largest, seed| {
            noisy.reset(seed, &mut observation).unwrap();
            largest.max(observation[0].abs())
        });
        assert!(largest > 0.1 && largest <= 0.2, "{largest}");
    }
}
