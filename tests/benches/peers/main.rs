//! Our learner against torch's best eager form of the same work, in one run: `cargo xtask bench --peers`.
//!
//! Both are measured in turn, round by round, because the speed of a shared machine drifts; the other one rests meanwhile. What
//! counts is the best time of each, next to it the median. The machine's peaks are measured between the rounds.
#![allow(clippy::print_stdout, reason = "a benchmark's report")]

mod bf16;
mod peaks;
mod stepping;
mod torch;
mod work;

use std::{env, fs, path::Path};

use serde_json::{Value, json};
use shield_tests::workspace;

use peaks::Peaks;
use torch::Torch;
use work::{Ours, update_bytes, update_flops, valued_bytes};

/// Rounds of each case.
const ROUNDS: usize = 8;

/// What one side took, in seconds.
#[derive(Default)]
struct Times(Vec<f64>);

impl Times {
    fn best(&mut self) -> f64 {
        self.0.sort_by(f64::total_cmp);
        self.0[0]
    }

    fn median(&mut self) -> f64 {
        self.0.sort_by(f64::total_cmp);
        self.0[self.0.len() / 2]
    }
}

fn main() {
    // Without it this is `cargo bench` over everything.
    let Some(python) = env::var_os("SHIELD_PEERS_PYTHON") else {
        println!("peers: `cargo xtask bench --peers` brings torch and compares with it");
        return;
    };
    let python = Path::new(&python);
    let mut torch = Torch::start(python);
    let mut report = vec![];
    for threads in [1, 2] {
        report.extend([64, 256].map(|size| update(&mut torch, size, threads)));
        report.extend(["F32", "Half"].map(|precision| value(&mut torch, precision, threads)));
    }
    let mut report = json!({ "torch": torch.version(), "cases": report });
    drop(torch);
    report["bf16"] = bf16();
    write(&report);
    report["stepping"] = stepping::measure(python).into();
    write(&report);
    println!("\nwritten to target/bench-peers.json");
}

/// What products in bf16 could gain on this processor.
fn bf16() -> Value {
    let mut peaks = Peaks::default();
    peaks.measure(1);
    let Some(flops) = bf16::peak() else { return Value::Null };
    println!("AVX512-BF16: {:.0} GFLOP/s on one thread, f32 {:.0}", flops / 1e9, peaks.flops / 1e9);
    json!({ "peak_flops_per_second": flops, "f32_peak_flops_per_second": peaks.flops })
}

fn write(report: &Value) {
    let file = workspace().join("target/bench-peers.json");
    fs::write(&file, format!("{report:#}\n")).expect("target/ can be written");
}

fn update(torch: &mut Torch, size: usize, threads: usize) -> Value {
    let mut ours = Ours::new(size, threads, "()");
    let (mut mine, mut theirs, mut peaks) = (Times::default(), Times::default(), Peaks::default());
    for _ in 0..ROUNDS {
        mine.0.extend(ours.updates(10));
        theirs.0.extend(torch.time(&format!("update {size} {threads} 5")));
        peaks.measure(threads);
    }
    let case = format!("update, batch {size}");
    let mut row = compare(&case, threads, &mut mine, &mut theirs);
    let (flops, bytes) = (update_flops(size), update_bytes());
    // What arithmetic at its peak and then the passes over memory at theirs would take together.
    let roofline = flops / peaks.flops + bytes / peaks.bandwidth;
    println!(
        "{:24} {:.2} GFLOP, {:.0} MB; peaks {:.0} GFLOP/s, {:.1} GB/s: at best {:.2} ms, reached {:.0}%",
        "",
        flops / 1e9,
        bytes / 1e6,
        peaks.flops / 1e9,
        peaks.bandwidth / 1e9,
        roofline * 1e3,
        100.0 * roofline / mine.best()
    );
    row["flops"] = json!(flops);
    row["bytes"] = json!(bytes);
    row["peak_flops_per_second"] = json!(peaks.flops);
    row["peak_bytes_per_second"] = json!(peaks.bandwidth);
    row["roofline_ms"] = json!(roofline * 1e3);
    row
}

fn value(torch: &mut Torch, precision: &str, threads: usize) -> Value {
    let mut ours = Ours::new(64, threads, &format!("(valuation: {precision})"));
    let (mut mine, mut theirs, mut peaks) = (Times::default(), Times::default(), Peaks::default());
    for _ in 0..ROUNDS {
        mine.0.extend(ours.valuations(200));
        theirs.0.extend(torch.time(&format!("value {threads} 200")));
        peaks.measure(threads);
    }
    let mut row = compare(&format!("value of one (s, a), {precision}"), threads, &mut mine, &mut theirs);
    let bytes = valued_bytes(if precision == "F32" { 4 } else { 2 });
    println!(
        "{:24} {:.1} MB at {:.1} GB/s: {:.0} µs",
        "",
        bytes / 1e6,
        peaks.bandwidth / 1e9,
        bytes / peaks.bandwidth * 1e6
    );
    row["bytes"] = json!(bytes);
    row["peak_bytes_per_second"] = json!(peaks.bandwidth);
    row
}

/// Prints a row and returns it.
fn compare(case: &str, threads: usize, mine: &mut Times, theirs: &mut Times) -> Value {
    let (best, median) = (theirs.best() / mine.best(), theirs.median() / mine.median());
    println!(
        "{case:24} {threads} threads: ours {:.3} ms (median {:.3}), torch {:.3} ms ({:.3}): {best:.2} times as fast ({median:.2})",
        mine.best() * 1e3,
        mine.median() * 1e3,
        theirs.best() * 1e3,
        theirs.median() * 1e3,
    );
    json!({
        "case": case, "threads": threads,
        "ours_ms": mine.best() * 1e3, "ours_median_ms": mine.median() * 1e3,
        "torch_ms": theirs.best() * 1e3, "torch_median_ms": theirs.median() * 1e3,
        "ratio": best, "ratio_of_medians": median,
    })
}
