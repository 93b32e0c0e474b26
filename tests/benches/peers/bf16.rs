//! What this processor's bf16 instructions are worth: the dot product of pairs of AVX512-BF16, summed in `f32`.

/// Operations per second on one thread, a multiply-add counting as two; `None` where the processor has no such instruction.
pub fn peak() -> Option<f64> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bf16") {
        return Some(avx512::peak());
    }
    None
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::{
        arch::x86_64::{
            _mm512_cvtne2ps_pbh, _mm512_dpbf16_ps, _mm512_reduce_add_ps, _mm512_set1_ps, _mm512_setzero_ps,
        },
        hint::black_box,
        time::Instant,
    };

    /// Independent sums: enough to hide the latency.
    const SUMS: usize = 16;
    const ROUNDS: usize = 200_000;
    const REPEATS: usize = 8;

    pub fn peak() -> f64 {
        let time = |_| {
            let start = Instant::now();
            // SAFETY: the caller has asked the processor for these instructions.
            black_box(unsafe { multiply_add() });
            start.elapsed().as_secs_f64()
        };
        let best = (0..REPEATS).map(time).fold(f64::INFINITY, f64::min);
        // Each of 16 lanes takes up two products.
        (2 * 2 * 16 * SUMS * ROUNDS) as f64 / best
    }

    #[target_feature(enable = "avx512f,avx512bf16")]
    fn multiply_add() -> f32 {
        let (one, half) = (_mm512_set1_ps(1.0), _mm512_set1_ps(black_box(0.5)));
        let (left, right) = (_mm512_cvtne2ps_pbh(one, one), _mm512_cvtne2ps_pbh(half, half));
        let mut sums = [_mm512_setzero_ps(); SUMS];
        for _ in 0..ROUNDS {
            for sum in &mut sums {
                *sum = _mm512_dpbf16_ps(*sum, left, right);
            }
        }
        sums.into_iter().map(|sum| _mm512_reduce_add_ps(sum)).sum()
    }
}
