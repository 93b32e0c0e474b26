//! Loops over slices, vectorised for the machine at hand, and matrix products. All matrices are row-major.

use faer::{Accum, MatMut, MatRef, Par, linalg::matmul::matmul};

use crate::{Activation, Real};

/// Runs `work` with the machine's vector instructions. The closure and what it calls must be `#[inline(always)]`: a call
/// from it is compiled for the oldest machine, where `mul_add` is a slow function.
#[inline(always)]
pub(crate) fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

/// `destination (rows × columns) = [destination +] left (rows × inner) · right (inner × columns)`.
pub(crate) fn product<T: Real>(
    destination: &mut [T],
    accumulate: Accum,
    left: &[T],
    right: &[T],
    (rows, inner, columns): (usize, usize, usize),
) {
    if rows == 1 {
        // A packed matrix product is several times slower than reading the weights once.
        if accumulate == Accum::Replace {
            destination.fill(T::ZERO);
        }
        return vectorised(
            #[inline(always)]
            || vector_matrix(destination, left, right),
        );
    }
    matmul(
        MatMut::from_row_major_slice_mut(destination, rows, columns),
        accumulate,
        MatRef::from_row_major_slice(left, rows, inner),
        MatRef::from_row_major_slice(right, inner, columns),
        T::ONE,
        Par::Seq,
    );
}

/// `destination (inner × columns) = leftᵀ · right` with `left (rows × inner)` and `right (rows × columns)`.
pub(crate) fn product_left_transposed<T: Real>(
    destination: &mut [T],
    left: &[T],
    right: &[T],
    (rows, inner, columns): (usize, usize, usize),
) {
    matmul(
        MatMut::from_row_major_slice_mut(destination, inner, columns),
        Accum::Replace,
        MatRef::from_row_major_slice(left, rows, inner).transpose(),
        MatRef::from_row_major_slice(right, rows, columns),
        T::ONE,
        Par::Seq,
    );
}

/// `destination (rows × inner) = left · rightᵀ` with `left (rows × columns)` and `right (inner × columns)`.
pub(crate) fn product_right_transposed<T: Real>(
    destination: &mut [T],
    left: &[T],
    right: &[T],
    (rows, inner, columns): (usize, usize, usize),
) {
    if rows == 1 {
        return vectorised(
            #[inline(always)]
            || {
                for (value, row) in destination.iter_mut().zip(right.chunks_exact(columns)) {
                    *value = dot(left, row);
                }
            },
        );
    }
    matmul(
        MatMut::from_row_major_slice_mut(destination, rows, inner),
        Accum::Replace,
        MatRef::from_row_major_slice(left, rows, columns),
        MatRef::from_row_major_slice(right, inner, columns).transpose(),
        T::ONE,
        Par::Seq,
    );
}

/// `destination += left · right`, reading `right` once, four of its rows at a time.
#[inline(always)]
fn vector_matrix<T: Real>(destination: &mut [T], left: &[T], right: &[T]) {
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
        let four = first.iter().zip(second).zip(third).zip(fourth);
        for (value, (((a, b), c), d)) in destination.iter_mut().zip(four) {
            let pair = a.mul_add(factors[0], b.mul_add(factors[1], *value));
            *value = c.mul_add(factors[2], d.mul_add(factors[3], pair));
        }
    }
    for (row, factor) in rows.remainder().chunks_exact(columns).zip(factors.remainder()) {
        for (value, weight) in destination.iter_mut().zip(row) {
            *value = weight.mul_add(*factor, *value);
        }
    }
}

#[inline(always)]
fn dot<T: Real>(left: &[T], right: &[T]) -> T {
    const LANES: usize = 16;
    let mut sums = [T::ZERO; LANES];
    let (left, left_rest) = left.as_chunks::<LANES>();
    let (right, right_rest) = right.as_chunks::<LANES>();
    for (a, b) in left.iter().zip(right) {
        for lane in 0..LANES {
            sums[lane] = a[lane].mul_add(b[lane], sums[lane]);
        }
    }
    for (lane, (a, b)) in left_rest.iter().zip(right_rest).enumerate() {
        sums[lane] = a.mul_add(*b, sums[lane]);
    }
    sums.into_iter().fold(T::ZERO, |sum, lane| sum + lane)
}

/// √Σx², summed in 16 lanes.
pub(crate) fn norm<T: Real>(values: &[T]) -> T {
    let square = vectorised(
        #[inline(always)]
        || dot(values, values),
    );
    square.sqrt()
}

/// `values *= factor`.
pub(crate) fn scale<T: Real>(values: &mut [T], factor: T) {
    vectorised(
        #[inline(always)]
        || values.iter_mut().for_each(|value| *value *= factor),
    );
}

/// `y = activation(y + bias)` for each row of `y`.
pub(crate) fn activate<T: Real>(values: &mut [T], bias: &[T], activation: Option<Activation>) {
    match activation {
        None => map_rows(values, bias, |x| x),
        Some(Activation::Tanh) => map_rows(values, bias, T::tanh),
        // Written so that NaN stays NaN.
        Some(Activation::Relu) => map_rows(values, bias, |x| if x < T::ZERO { T::ZERO } else { x }),
    }
}

/// `y = activation(y)`, where biases were added before.
pub(crate) fn activate_sums<T: Real>(values: &mut [T], activation: Option<Activation>) {
    match activation {
        None => {}
        Some(Activation::Tanh) => vectorised(
            #[inline(always)]
            || values.iter_mut().for_each(|x| *x = T::tanh(*x)),
        ),
        Some(Activation::Relu) => vectorised(
            #[inline(always)]
            || values.iter_mut().for_each(|x| *x = if *x < T::ZERO { T::ZERO } else { *x }),
        ),
    }
}

#[inline(always)]
fn map_rows<T: Real>(values: &mut [T], bias: &[T], function: impl Fn(T) -> T) {
    vectorised(
        #[inline(always)]
        || {
            for row in values.chunks_exact_mut(bias.len()) {
                for (value, bias) in row.iter_mut().zip(bias) {
                    *value = function(*value + *bias);
                }
            }
        },
    );
}

/// Turns ∂L/∂y into ∂L/∂z where y = activation(z), from the values of y.
pub(crate) fn differentiate<T: Real>(deltas: &mut [T], outputs: &[T], activation: Option<Activation>) {
    match activation {
        None => {}
        Some(Activation::Tanh) => vectorised(
            #[inline(always)]
            || {
                for (delta, y) in deltas.iter_mut().zip(outputs) {
                    *delta *= T::ONE - *y * *y;
                }
            },
        ),
        Some(Activation::Relu) => vectorised(
            #[inline(always)]
            || {
                for (delta, y) in deltas.iter_mut().zip(outputs) {
                    *delta = if *y > T::ZERO { *delta } else { T::ZERO };
                }
            },
        ),
    }
}

/// `sums = Σ rows`.
pub(crate) fn sum_rows<T: Real>(sums: &mut [T], rows: &[T]) {
    sums.fill(T::ZERO);
    vectorised(
        #[inline(always)]
        || {
            for row in rows.chunks_exact(sums.len()) {
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += *value;
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(length: usize, seed: u32) -> Vec<f64> {
        (0..length as u32).map(|i| f64::from((i * 37 + seed * 11) % 23) / 7.0 - 1.5).collect()
    }

    fn plain(left: &[f64], right: &[f64], (rows, inner, columns): (usize, usize, usize)) -> Vec<f64> {
        let mut out = vec![0.0; rows * columns];
        for (row, column, k) in
            (0..rows).flat_map(|r| (0..columns).flat_map(move |c| (0..inner).map(move |k| (r, c, k))))
        {
            out[row * columns + column] += left[row * inner + k] * right[k * columns + column];
        }
        out
    }

    fn transposed(matrix: &[f64], rows: usize, columns: usize) -> Vec<f64> {
        (0..rows * columns).map(|i| matrix[(i % rows) * columns + i / rows]).collect()
    }

    fn assert_close(left: &[f64], right: &[f64]) {
        assert_eq!(left.len(), right.len());
        for (a, b) in left.iter().zip(right) {
            assert!((a - b).abs() < 1e-10, "{a} {b}");
        }
    }

    #[test]
    fn products_of_one_row_and_of_many_match_the_definition() {
        for shape @ (rows, inner, columns) in
            [(1, 7, 5), (1, 9, 1), (1, 35, 33), (3, 7, 5), (2, 1, 3), (4, 5, 1)]
        {
            let (left, right) = (numbers(rows * inner, 1), numbers(inner * columns, 2));
            let expected = plain(&left, &right, shape);
            let mut out = vec![9.0; rows * columns];
            product(&mut out, Accum::Replace, &left, &right, shape);
            assert_close(&out, &expected);
            product(&mut out, Accum::Add, &left, &right, shape);
            assert_close(&out, &expected.iter().map(|x| 2.0 * x).collect::<Vec<_>>());

            let delta = numbers(rows * columns, 3);
            let mut out = vec![9.0; inner * columns];
            product_left_transposed(&mut out, &left, &delta, shape);
            assert_close(&out, &plain(&transposed(&left, rows, inner), &delta, (inner, rows, columns)));
            let mut out = vec![9.0; rows * inner];
            product_right_transposed(&mut out, &delta, &right, shape);
            assert_close(&out, &plain(&delta, &transposed(&right, inner, columns), (rows, columns, inner)));
        }
    }

    #[test]
    fn relu_propagates_nan() {
        let mut values = [f32::NAN, -1.0, 2.0];
        activate(&mut values, &[0.0; 3], Some(Activation::Relu));
        assert!(values[0].is_nan());
        assert_eq!(values[1..], [0.0, 2.0]);
    }
}
