//! Damaged files of a run.

use std::fs;

use shield_runtime::run::read_decisions;
use shield_tests::gridworld;

use crate::{first_run, ran};

#[test]
fn damaged_decisions_are_an_error_that_names_the_file() {
    let folder = ran(&gridworld(300, ""), &["--seeds", "0"]);
    let run = first_run(folder.path());
    let part = run.join("decisions/part-000000.parquet");
    let whole = fs::read(&part).unwrap();
    eprintln!("{} bytes", whole.len());
    let mut kinds = std::collections::BTreeMap::<String, (usize, u8, usize)>::new();
    for at in 0..whole.len() {
        for mask in [0x01, 0x80, 0xff] {
            let mut bytes = whole.clone();
            bytes[at] ^= mask;
            fs::write(&part, bytes).unwrap();
            let t = std::time::Instant::now();
            if let Err(error) = read_decisions(&run, |_| Ok(true)) {
                let message = format!("{error:#}");
                assert!(message.starts_with(&part.display().to_string()), "{at} {mask:#x}: {message}");
                let m = message.replace(&part.display().to_string(), "P");
                let m: String = m.chars().map(|c| if c.is_ascii_digit() { '#' } else { c }).collect();
                let e = kinds.entry(m.chars().take(200).collect()).or_insert((at, mask, 0));
                e.2 += 1;
            }
            if t.elapsed().as_millis() > 500 {
                eprintln!("slow {at} {mask:#x} {:?}", t.elapsed());
            }
        }
    }
    for (k, v) in kinds {
        eprintln!("{v:?} {k}");
    }
}
