//! The machine's peaks: multiply-adds and reading from memory.

use std::{hint::black_box, thread, time::Instant};

use pulp::{Arch, Simd, WithSimd};

/// Independent sums: enough to hide the latency of a multiply-add in two units.
const SUMS: usize = 16;
/// Milliseconds of work, so that starting a thread and moving it to a free core do not count.
const ROUNDS: usize = 4_000_000;
/// As many weights as 20 critics have: they lie beyond the second-level cache.
const WEIGHTS: usize = 2_600_000;
const PASSES: usize = 40;

/// The best seen so far.
#[derive(Default)]
pub struct Peaks {
    /// Floating-point operations per second; a multiply-add counts as two.
    pub flops: f64,
    /// Bytes read per second.
    pub bandwidth: f64,
}

impl Peaks {
    /// Measures both once on this many threads.
    pub fn measure(&mut self, threads: usize) {
        let lanes = Arch::new().dispatch(Lanes);
        let seconds = on_threads(threads, &|_| {
            black_box(Arch::new().dispatch(MultiplyAdd));
        });
        let flops = 2.0 * (threads * SUMS * ROUNDS * lanes) as f64 / seconds;
        self.flops = self.flops.max(flops);

        let memory: Vec<Vec<f32>> = (0..threads).map(|_| vec![1.0; WEIGHTS / threads]).collect();
        let seconds = on_threads(threads, &|thread| {
            for _ in 0..PASSES {
                black_box(Arch::new().dispatch(Sum(black_box(&memory[thread]))));
            }
        });
        let bandwidth = (4 * WEIGHTS * PASSES) as f64 / seconds;
        self.bandwidth = self.bandwidth.max(bandwidth);
    }
}

fn on_threads(threads: usize, work: &(impl Fn(usize) + Sync)) -> f64 {
    let start = Instant::now();
    thread::scope(|scope| {
        for thread in 1..threads {
            scope.spawn(move || work(thread));
        }
        work(0);
    });
    start.elapsed().as_secs_f64()
}

struct Lanes;

impl WithSimd for Lanes {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> usize {
        S::F32_LANES
    }
}

struct MultiplyAdd;

impl WithSimd for MultiplyAdd {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let (factor, summand) = (simd.splat_f32s(black_box(0.5)), simd.splat_f32s(black_box(1.0)));
        let mut sums = [simd.splat_f32s(0.0); SUMS];
        for _ in 0..ROUNDS {
            for sum in &mut sums {
                *sum = simd.mul_add_f32s(*sum, factor, summand);
            }
        }
        sums.into_iter().map(|sum| simd.reduce_sum_f32s(sum)).sum()
    }
}

struct Sum<'a>(&'a [f32]);

impl WithSimd for Sum<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let (vectors, _) = S::as_simd_f32s(self.0);
        let mut sums = [simd.splat_f32s(0.0); 8];
        for eight in vectors.chunks_exact(8) {
            for (sum, vector) in sums.iter_mut().zip(eight) {
                *sum = simd.add_f32s(*sum, *vector);
            }
        }
        sums.into_iter().map(|sum| simd.reduce_sum_f32s(sum)).sum()
    }
}
