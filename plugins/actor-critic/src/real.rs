//! The two number types, and the transcendental function that the networks need.

use faer::traits::RealField;
use serde::{Serialize, de::DeserializeOwned};

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// `f32` for use, `f64` for checking gradients.
pub trait Real:
    sealed::Sealed + RealField + Copy + Default + Send + Sync + Serialize + DeserializeOwned + 'static
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// The nearest value.
    fn from_f64(value: f64) -> Self;
    /// The same value.
    fn to_f64(self) -> f64;
    /// `self · factor + summand`, rounded once.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// √.
    fn sqrt(self) -> Self;
    /// tanh; NaN stays NaN. For `f32` within 4e-7 of the exact value.
    fn tanh(self) -> Self;
    /// Neither NaN nor infinite.
    fn is_finite(self) -> bool;
}

impl Real for f32 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }

    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        f32::mul_add(self, factor, summand)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        rational_tanh(self)
    }

    #[inline(always)]
    fn is_finite(self) -> bool {
        f32::is_finite(self)
    }
}

impl Real for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        f64::mul_add(self, factor, summand)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }

    #[inline(always)]
    fn tanh(self) -> Self {
        f64::tanh(self)
    }

    #[inline(always)]
    fn is_finite(self) -> bool {
        f64::is_finite(self)
    }
}

/// tanh(x) ≈ x·P(x²)/Q(x²), the (13, 6) minimax approximation of Eigen (`generic_fast_tanh_float`); beyond the bound the
/// result rounds to ±1. The standard library's tanh costs some 20 ns; this one vectorises to below 1 ns.
#[inline(always)]
fn rational_tanh(x: f32) -> f32 {
    const BOUND: f32 = 7.905_311;
    const P: [f32; 7] = [
        -2.760_768_5e-16,
        2.000_188e-13,
        -8.604_672e-11,
        5.122_297e-8,
        1.485_722_4e-5,
        6.372_619_3e-4,
        4.893_524_6e-3,
    ];
    const Q: [f32; 4] = [1.198_258_4e-6, 1.185_347_1e-4, 2.268_434_6e-3, 4.893_525e-3];
    // `clamp` keeps NaN, where `max` and `min` would turn it into the bound.
    let x = x.clamp(-BOUND, BOUND);
    let square = x * x;
    let mut numerator = P[0];
    for coefficient in &P[1..] {
        numerator = numerator.mul_add(square, *coefficient);
    }
    let mut denominator = Q[0];
    for coefficient in &Q[1..] {
        denominator = denominator.mul_add(square, *coefficient);
    }
    x * numerator / denominator
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_approximate_tanh_is_within_its_stated_error() {
        let mut worst = 0.0_f64;
        let mut worst_relative = 0.0_f64;
        for step in -1_200_000..=1_200_000 {
            let x = step as f32 * 1e-5;
            let exact = f64::from(x).tanh();
            let error = (f64::from(Real::tanh(x)) - exact).abs();
            worst = worst.max(error);
            if exact != 0.0 {
                worst_relative = worst_relative.max(error / exact.abs());
            }
        }
        assert!(worst < 4e-7, "{worst:e}");
        assert!(worst_relative < 6e-7, "{worst_relative:e}");
    }

    #[test]
    fn tanh_is_bounded_and_odd_and_propagates_nan() {
        for x in [0.0, 1e-30, 1e-3, 0.5, 7.9, 7.91, 20.0, 1e30, f32::INFINITY] {
            let y = Real::tanh(x);
            assert!(y.abs() <= 1.0 + 1e-7, "{x} {y}");
            assert_eq!(Real::tanh(-x), -y);
        }
        assert!(Real::tanh(f32::NAN).is_nan());
    }
}
