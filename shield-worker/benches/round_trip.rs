//! A round trip to a child, against the same work called directly. The child is this program, started again.
#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark")]

use std::{env, hint::black_box, process::Command, time::Duration};

use criterion::Criterion;
use shield_worker::{CHANNEL_VARIABLE, Client, Options, Waiting, Worker};

const LIMIT: Duration = Duration::from_secs(10);
/// As many numbers as a robot's observation has.
const NUMBERS: usize = 18;

fn work(numbers: &mut [f32; NUMBERS]) {
    numbers.iter_mut().for_each(|number| *number += 1.0);
}

fn serve() {
    let mut client = Client::from_environment().unwrap();
    let mut numbers = [0.0; NUMBERS];
    while client.wait().unwrap() {
        client.memory().read(0, &mut numbers);
        work(&mut numbers);
        client.memory().write(0, &numbers);
        client.answer().unwrap();
    }
}

const PYTHON: &str = "
import mmap, os, struct
memory, bell, length = map(int, os.environ['SHIELD_WORKER_CHANNEL'].split(','))
block = mmap.mmap(memory, length)
while os.read(bell, 1):
    struct.pack_into('=I', block, 64, struct.unpack_from('=I', block, 0)[0])
    os.write(bell, b'\\0')
";

fn main() {
    if env::var_os(CHANNEL_VARIABLE).is_some() {
        return serve();
    }
    let mut criterion = Criterion::default().configure_from_args();
    let mut numbers = [0.0_f32; NUMBERS];
    criterion.bench_function("direct", |bencher| bencher.iter(|| work(black_box(&mut numbers))));
    let mut python = Command::new("python3");
    python.args(["-c", PYTHON]);
    let children = [
        ("child in Rust", Command::new(env::current_exe().unwrap()), Waiting::Looking),
        ("child in Python", python, Waiting::Blocking),
    ];
    for (name, command, waiting) in children {
        let mut worker = Worker::start(command, Options { waiting, ..Options::default() }).unwrap();
        criterion.bench_function(name, |bencher| {
            bencher.iter(|| {
                worker.memory().write(0, &numbers);
                worker.call(LIMIT).unwrap();
                worker.memory().read(0, &mut numbers);
            });
        });
    }
    criterion.final_summary();
}
