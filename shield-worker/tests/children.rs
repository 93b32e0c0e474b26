//! Real children that behave and misbehave. Each is this test's own executable, started again for the one test
//! `a_process_without_a_behaviour_does_nothing`.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, reason = "tests")]

use std::{
    env, fs, io,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, getpid, kill_process};
use shield_worker::{CHANNEL_VARIABLE, Client, Ending, Options, Waiting, Worker, WorkerError};

const BEHAVIOUR: &str = "SHIELD_WORKER_TEST";
const LONG: Duration = Duration::from_secs(30);

fn this_test(behaviour: &str) -> Command {
    let mut command = Command::new(env::current_exe().unwrap());
    command
        .args(["--exact", "a_process_without_a_behaviour_does_nothing", "--nocapture", "--test-threads=1"])
        .env(BEHAVIOUR, behaviour);
    command
}

fn start(behaviour: &str) -> Worker {
    Worker::start(this_test(behaviour), Options::default()).unwrap()
}

/// What the children do. In the tests' own process it has nothing to do.
#[test]
fn a_process_without_a_behaviour_does_nothing() {
    let Ok(behaviour) = env::var(BEHAVIOUR) else { return };
    if behaviour == "parent" {
        return have_a_child_and_die();
    }
    if behaviour == "stray" {
        return println!("\nrefused: {}", Client::from_environment().unwrap_err());
    }
    let mut client = Client::from_environment().unwrap();
    while client.wait().unwrap() {
        let value: u64 = client.memory().get(0);
        match behaviour.as_str() {
            "double" => client.memory().write(0, &[2 * value]),
            "slow" => thread::sleep(Duration::from_millis(value)),
            "exit" => {
                eprintln!("no licence was found");
                std::process::exit(3)
            }
            // The first is caught by Rust's own handler, which then lets go of the signal.
            // A signal may come late, and the first one may be caught: it never answers.
            "fault" => loop {
                kill_process(getpid(), Signal::SEGV).unwrap();
            },
            "hang" => thread::sleep(LONG),
            "garbage" => {
                let noise: Vec<u8> = (0..200_000u32).map(|n| (n * 7919 % 251) as u8).collect();
                io::Write::write_all(&mut io::stdout(), &noise).unwrap();
                client.memory().write(0, &[value + 1]);
            }
            other => panic!("no such behaviour: {other}"),
        }
        client.answer().unwrap();
    }
}

/// Prints the number of its child and is killed while the child is busy.
fn have_a_child_and_die() {
    let mut worker = start("hang");
    println!("\nchild={}", worker.process());
    // The child dies although the thread that asked for it is gone already.
    thread::spawn(move || worker.call(LONG));
    thread::sleep(Duration::from_millis(300));
    kill_process(getpid(), Signal::KILL).unwrap();
}

fn is_alive(process: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{process}/stat"));
    status.is_ok_and(|text| !text.rsplit(')').next().unwrap_or_default().trim_start().starts_with('Z'))
}

fn eventually(condition: impl Fn() -> bool) -> bool {
    let start = Instant::now();
    while start.elapsed() < LONG {
        if condition() {
            return true;
        }
        thread::sleep(Duration::from_millis(5));
    }
    false
}

#[test]
fn every_answer_arrives() {
    let mut worker = start("double");
    for value in 0..20_000 {
        worker.memory().write(0, &[value]);
        worker.call(LONG).unwrap();
        assert_eq!(worker.memory().get::<u64>(0), 2 * value);
    }
}

#[test]
fn a_sleeping_side_is_woken() {
    // Pauses around the time after which a side goes to sleep, on both sides.
    let mut worker = start("slow");
    for pause in [0, 1, 2, 70, 0, 1] {
        thread::sleep(Duration::from_millis(pause));
        worker.memory().write(0, &[pause]);
        worker.call(LONG).unwrap();
    }
}

#[test]
fn the_exit_code_and_the_last_words_of_a_child_are_reported() {
    let mut worker = start("exit");
    let error = worker.call(LONG).unwrap_err();
    assert!(matches!(error, WorkerError::Died { ending: Ending::Exit(3), .. }), "{error:?}");
    let text = error.to_string();
    assert!(text.contains("exit code 3") && text.ends_with("no licence was found"), "{text}");
    assert_eq!(worker.call(LONG), Err(error), "a dead worker was asked again");
}

#[test]
fn the_signal_that_ended_a_child_is_reported() {
    let error = start("fault").call(LONG).unwrap_err();
    assert!(matches!(error, WorkerError::Died { ending: Ending::Signal(11), .. }), "{error:?}");
    assert!(error.to_string().contains("segmentation fault"), "{error}");
}

#[test]
fn a_child_that_hangs_is_ended_at_the_time_limit() {
    let mut worker = start("hang");
    let process = worker.process();
    let limit = Duration::from_millis(300);
    let error = worker.call(limit).unwrap_err();
    assert!(matches!(error, WorkerError::Hung { limit: told, .. } if told == limit), "{error:?}");
    assert!(!is_alive(process));
}

#[test]
fn what_a_child_prints_does_not_disturb_the_channel() {
    let mut worker = start("garbage");
    for value in 0..5 {
        worker.memory().write(0, &[value]);
        worker.call(LONG).unwrap();
        assert_eq!(worker.memory().get::<u64>(0), value + 1);
    }
}

#[test]
fn a_dropped_worker_leaves_no_process() {
    let mut worker = start("double");
    worker.call(LONG).unwrap();
    let process = worker.process();
    drop(worker);
    assert!(!fs::exists(format!("/proc/{process}")).unwrap(), "not even a zombie is left");
}

#[test]
fn a_child_ends_with_its_parent() {
    let output = this_test("parent").stdout(Stdio::piped()).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    let process: u32 = text.lines().find_map(|line| line.strip_prefix("child=")).unwrap().parse().unwrap();
    assert!(Pid::from_raw(process as i32).is_some());
    assert!(eventually(|| !is_alive(process)), "process {process} goes on");
}

#[test]
fn a_missing_program_is_refused_by_name() {
    let error = Worker::start(Command::new("/no/such/program"), Options::default()).unwrap_err();
    assert!(matches!(&error, WorkerError::Start { .. }), "{error:?}");
    assert!(error.to_string().contains("/no/such/program"), "{error}");
}

#[test]
fn a_process_without_a_channel_is_refused_as_a_worker() {
    assert!(env::var(CHANNEL_VARIABLE).is_err());
    let error = Client::from_environment().unwrap_err().to_string();
    assert!(error.contains(CHANNEL_VARIABLE), "{error}");
}

#[test]
fn a_channel_that_is_not_open_is_refused() {
    for (channel, reason) in [
        ("-1,-1,1048832", "Bad file descriptor"),
        ("0,-1,4096", "\"0,-1,4096\": "),
        ("12345,12346,4096", "Bad file descriptor"),
        ("3,4", "not three numbers"),
        ("3,4,99999999999999999999", "not three numbers"),
    ] {
        let mut command = this_test("stray");
        let output = command.env(CHANNEL_VARIABLE, channel).output().unwrap();
        let told = String::from_utf8_lossy(&output.stdout).into_owned();
        let refusal = told.lines().find_map(|line| line.strip_prefix("refused: "));
        assert!(refusal.is_some_and(|text| text.contains(reason)), "{channel}: {told}");
    }
}

/// The example of the README, filled in: adds one to the number in the payload.
const PYTHON: &str = "
import mmap, os, struct
memory, bell, length = map(int, os.environ['SHIELD_WORKER_CHANNEL'].split(','))
block = mmap.mmap(memory, length)
while os.read(bell, 1):
    struct.pack_into('=Q', block, 256, struct.unpack_from('=Q', block, 256)[0] + 1)
    struct.pack_into('=I', block, 64, struct.unpack_from('=I', block, 0)[0])
    os.write(bell, b'\\0')
";

fn python(script: &str) -> Worker {
    let mut command = Command::new("python3");
    command.args(["-c", script]);
    Worker::start(command, Options { waiting: Waiting::Blocking, ..Options::default() }).unwrap()
}

#[test]
fn a_child_may_wait_by_reading_the_bell() {
    let mut worker = python(PYTHON);
    for value in 0..1_000 {
        worker.memory().write(0, &[value]);
        worker.call(LONG).unwrap();
        assert_eq!(worker.memory().get::<u64>(0), value + 1);
    }
}

#[test]
fn a_child_that_rings_without_an_answer_is_an_error() {
    let script = PYTHON.replace("struct.pack_into('=I'", "(lambda *_: None)('=I'");
    let error = python(&script).call(LONG).unwrap_err();
    assert!(matches!(error, WorkerError::Protocol { .. }), "{error:?}");
}

/// Answers each request, but never reads its bell.
const DEAF: &str = "
import mmap, os, struct
memory, bell, length = map(int, os.environ['SHIELD_WORKER_CHANNEL'].split(','))
block = mmap.mmap(memory, length)
answered = 0
while True:
    request = struct.unpack_from('=I', block, 0)[0]
    if request != answered:
        answered = request
        struct.pack_into('=I', block, 64, request)
        os.write(bell, b'\\0')
";

#[test]
fn a_child_that_never_reads_its_bell_is_still_called_and_answers() {
    let mut worker = python(DEAF);
    let (sender, calls) = std::sync::mpsc::channel();
    // More calls than the bell has room for.
    thread::spawn(move || (0..2_000).for_each(|_| sender.send(worker.call(LONG)).unwrap()));
    for call in 0..2_000 {
        let answer = calls.recv_timeout(2 * LONG);
        assert!(matches!(answer, Ok(Ok(()))), "call {call}: {answer:?}");
    }
}

#[test]
fn a_child_cannot_shorten_the_memory() {
    let script = PYTHON.replace("while", "os.ftruncate(memory, 1)\nwhile");
    let error = python(&script).call(LONG).unwrap_err();
    assert!(error.to_string().contains("PermissionError"), "{error}");
}
