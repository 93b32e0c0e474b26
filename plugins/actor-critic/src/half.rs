//! Copies of the weights in 16 bits, to value one (s, a) with half the reading.
//!
//! Valuing one row costs what reading the weights costs. A weight is kept as sign, five bits of exponent and ten of mantissa, as in IEEE's
//! half precision but with the exponents 2⁻²² to 2⁸, in which weights lie: rounded to within 2⁻¹¹ of its size, below 2⁻²² to zero. Sums and
//! biases stay in `f32`. Widening a weight is two integer operations, because its exponent is put right in the factor that it meets.

use crate::{
    Architecture,
    kernels::vectorised,
    layer::Side,
    pass::{finish, take_in},
    workspace::Workspace,
};

/// The difference between the exponents' biases.
const BIAS: u32 = 104;
/// 2¹⁰⁴: what a widened weight lacks.
const MISSING: f32 = f32::from_bits((BIAS + 127) << 23);
/// Bits of the mantissa that are given up.
const CUT: u32 = 13;

/// Copies of an ensemble's weights.
#[derive(Debug, Clone, Default)]
pub(crate) struct Copies {
    /// As the weights, one after the other.
    pub(crate) weights: Vec<u16>,
    /// Whether each network's weights all lie below 512. Where not, its values are computed in `f32`.
    pub(crate) fits: Vec<bool>,
    /// Whether the weights have changed since.
    pub(crate) is_stale: bool,
}

/// Copies weights; returns whether each was below 512 in size.
pub(crate) fn copy(copies: &mut [u16], weights: &[f32]) -> bool {
    vectorised(
        #[inline(always)]
        || {
            let mut largest = 0;
            for (copy, weight) in copies.iter_mut().zip(weights) {
                let bits = weight.to_bits();
                let rounded = (bits & 0x7fff_ffff) + (1 << (CUT - 1));
                largest = largest.max(rounded);
                let size = if rounded < (BIAS + 1) << 23 { 0 } else { rounded.wrapping_sub(BIAS << 23) };
                *copy = ((bits >> 16) & 0x8000 | (size >> CUT) & 0x7fff) as u16;
            }
            // NaN and infinity lie above as well.
            largest < (BIAS + 32) << 23
        },
    )
}

/// The weight times 2⁻¹⁰⁴.
#[inline(always)]
fn widen(weight: u16) -> f32 {
    const KEPT: i32 = 0x8fff_e000_u32 as i32;
    f32::from_bits(((i32::from(weight as i16) << CUT) & KEPT) as u32)
}

/// The network's outputs for one row, in the last layer's place of the workspace. Weights come from `copies`, biases and
/// normalisations from `parameters`.
pub(crate) fn forward(
    architecture: &Architecture,
    copies: &[u16],
    parameters: &[f32],
    observation: &[f32],
    action: &[f32],
    workspace: &mut Workspace<f32>,
) {
    workspace.resize(architecture, 1);
    for layer in &architecture.layers {
        let halves = layer.parts(copies);
        let io = workspace.io(layer, observation);
        io.output.fill(0.0);
        let input = take_in(layer, Side::Below, parameters, io.input, io.renormed, io.statistics);
        vectorised(
            #[inline(always)]
            || add_product(io.output, input, halves.weights),
        );
        if layer.action_inputs > 0 {
            let action = take_in(layer, Side::Action, parameters, action, io.renormed, io.statistics);
            vectorised(
                #[inline(always)]
                || add_product(io.output, action, halves.action_weights),
            );
        }
        finish(layer, parameters, workspace);
    }
}

/// `destination += left · right`, reading `right` once, four of its rows at a time.
#[inline(always)]
fn add_product(destination: &mut [f32], left: &[f32], right: &[u16]) {
    let columns = destination.len();
    if columns == 1 {
        destination[0] += dot(left, right);
        return;
    }
    let mut rows = right.chunks_exact(4 * columns);
    let mut factors = left.chunks_exact(4);
    for (rows, factors) in (&mut rows).zip(&mut factors) {
        let (first, rest) = rows.split_at(columns);
        let (second, rest) = rest.split_at(columns);
        let (third, fourth) = rest.split_at(columns);
        let factors: [f32; 4] = std::array::from_fn(|row| factors[row] * MISSING);
        let four = first.iter().zip(second).zip(third).zip(fourth);
        for (value, (((a, b), c), d)) in destination.iter_mut().zip(four) {
            let pair = widen(*a).mul_add(factors[0], widen(*b).mul_add(factors[1], *value));
            *value = widen(*c).mul_add(factors[2], widen(*d).mul_add(factors[3], pair));
        }
    }
    for (row, factor) in rows.remainder().chunks_exact(columns).zip(factors.remainder()) {
        for (value, weight) in destination.iter_mut().zip(row) {
            *value = widen(*weight).mul_add(factor * MISSING, *value);
        }
    }
}

#[inline(always)]
fn dot(left: &[f32], right: &[u16]) -> f32 {
    const LANES: usize = 16;
    let mut sums = [0.0_f32; LANES];
    let (left, left_rest) = left.as_chunks::<LANES>();
    let (right, right_rest) = right.as_chunks::<LANES>();
    for (a, b) in left.iter().zip(right) {
        for lane in 0..LANES {
            sums[lane] = (a[lane] * MISSING).mul_add(widen(b[lane]), sums[lane]);
        }
    }
    for (lane, (a, b)) in left_rest.iter().zip(right_rest).enumerate() {
        sums[lane] = (a * MISSING).mul_add(widen(*b), sums[lane]);
    }
    sums.into_iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(weight: f32) -> f32 {
        let mut copies = [0];
        assert!(copy(&mut copies, &[weight]), "{weight} does not fit");
        widen(copies[0]) * MISSING
    }

    #[test]
    fn a_half_precision_copy_is_within_its_stated_error() {
        for step in 0..400_000 {
            let weight = 2.0_f32.powf(step as f32 * 7.5e-5 - 21.9);
            for weight in [weight, -weight] {
                let error = (kept(weight) - weight).abs();
                assert!(error <= weight.abs() * 2.0_f32.powi(-11), "{weight:e}: {error:e}");
            }
        }
        for small in [0.0, -0.0, 1e-30, f32::MIN_POSITIVE, 2.3e-7, -2.3e-7] {
            assert!((kept(small) - small).abs() <= 2.0_f32.powi(-22), "{small:e}");
        }
        for exact in [0.5, -1.0, 0.75, 511.75, 256.0] {
            assert_eq!(kept(exact), exact);
        }
    }

    #[test]
    fn a_weight_outside_the_range_of_a_copy_is_reported() {
        for weight in [511.9, 512.0, -512.0, 1e30, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -f32::NAN] {
            assert!(!copy(&mut [0; 3], &[0.1, weight, 0.2]), "{weight}");
        }
    }
}
