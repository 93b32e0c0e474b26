//! Shaping functions that the tasks share.

/// How near `value` is to the interval `[low, high]`: 1 inside, falling smoothly outside, 0.05 at a distance of `margin`.
///
/// 1 − tanh²(w d), with d the distance to the interval and w = artanh(√0.95) / margin. This is the long-tailed tolerance of the
/// DeepMind control suite.
pub fn tolerance(value: f64, [low, high]: [f64; 2], margin: f64) -> f64 {
    let distance = (low - value).max(value - high).max(0.0);
    let weight = 0.95f64.sqrt().atanh() / margin;
    1.0 - (weight * distance).tanh().powi(2)
}

/// √(x² + p²) − p: like x²/2p near 0, like |x| far from it.
pub fn pseudo_huber(x: f64, p: f64) -> f64 {
    x.hypot(p) - p
}

/// An angle in radians as the equivalent one in [−π, π): a robot that turned over completely stands upright again.
pub fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tolerance_is_one_inside_and_a_twentieth_at_the_margin() {
        assert_eq!(tolerance(9.5, [9.0, 11.0], 7.0), 1.0);
        for value in [2.0, 18.0] {
            assert!((tolerance(value, [9.0, 11.0], 7.0) - 0.05).abs() < 1e-12);
        }
        // Published: the cheetah's reward at rest and at 1.3 m/s.
        assert!((tolerance(0.0, [9.0, 11.0], 7.0) - 0.0147).abs() < 1e-4);
        assert!(tolerance(1.3, [9.0, 11.0], 7.0) > 0.03);
    }

    #[test]
    fn a_full_turn_is_no_turn() {
        use std::f64::consts::{PI, TAU};
        for (angle, expected) in [(0.1, 0.1), (TAU + 0.1, 0.1), (-TAU - 0.1, -0.1), (PI + 0.5, 0.5 - PI)] {
            assert!((wrapped(angle) - expected).abs() < 1e-12, "{angle}");
        }
    }
}
