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

/// 1 at a distance of 0, 0 from `farthest` on: quadratic below 0.2, linear from there (1 − H(min(x, b)) / H(b), H Huber's loss).
pub fn huber_closeness(distance: f64, farthest: f64) -> f64 {
    const DELTA: f64 = 0.2;
    let loss = |x: f64| if x < DELTA { 0.5 * x * x } else { DELTA * (x - 0.5 * DELTA) };
    1.0 - loss(distance.min(farthest)) / loss(farthest)
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
    fn both_huber_functions_are_smooth_where_their_parts_meet() {
        assert_eq!(pseudo_huber(0.0, 0.1), 0.0);
        assert!((pseudo_huber(100.0, 0.1) - 99.9).abs() < 1e-3);
        assert!((pseudo_huber(0.001, 0.1) - 0.5e-6 / 0.1).abs() < 1e-9);
        assert_eq!([0.0, 0.7, 5.0].map(|distance| huber_closeness(distance, 0.7)), [1.0, 0.0, 0.0]);
        let (below, above) = (huber_closeness(0.2 - 1e-9, 0.7), huber_closeness(0.2, 0.7));
        assert!((below - above).abs() < 1e-8 && (above - (1.0 - 0.02 / 0.12)).abs() < 1e-12);
    }

    #[test]
    fn angles_are_wrapped_into_half_a_turn_either_way() {
        use std::f64::consts::{PI, TAU};
        for (angle, expected) in [(0.1, 0.1), (TAU + 0.1, 0.1), (-TAU - 0.1, -0.1), (PI + 0.5, 0.5 - PI)] {
            assert!((wrapped(angle) - expected).abs() < 1e-12, "{angle}");
        }
    }
}
