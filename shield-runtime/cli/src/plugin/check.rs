//! `shield plugin check`: every check in a process of its own, so that a crash or a hang is a finding and nothing more.

use std::{
    env,
    io::Read,
    process::{Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};
use shield_check::{
    environment_check::Verdict,
    plugin_check::{Candidate, Check, checks},
};
use shield_host::plugin::{Entry, Kind, Registry, Selection};

use shield_worker::Ending;

use super::super::{Failure, output};

/// Arguments of `shield plugin check`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct CheckArguments {
    /// An id, such as ddpg, or a library, such as target/release/libmine.so, whose plugins are all checked.
    plugin: String,
    /// The plugin's configuration, for one that needs some, for example '(path: "walk.onnx")'.
    #[arg(long, default_value = "")]
    config: String,
    /// Asks exactly what an earlier check with this seed asked.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    reproduce: u64,
    /// Seconds that one check may take before it counts as hanging.
    #[arg(long, default_value_t = 120)]
    time_limit: u64,
    /// One check alone.
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// Prints JSON instead of a table: a list of objects with plugin, check, rule, verdict and reason.
    #[arg(long)]
    json: bool,
    /// Runs one check of one plugin in this process.
    #[arg(long, hide = true, value_name = "ID")]
    inside: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  shield plugin check target/release/libmine.so
  shield plugin check ddpg --config '(critics: 5)' --only state
  shield plugin check acme/arm --json > check.json

Each check is a process with a time limit. Verdicts: pass, FAIL, CRASH (the process died), HANG (the time limit), skip (it cannot be told).
Exit codes: 0 nothing failed, 1 something failed, 2 the input is wrong.";

/// What became of one check.
#[derive(Debug, Clone, Serialize)]
struct Line {
    plugin: String,
    check: &'static str,
    rule: &'static str,
    verdict: &'static str,
    reason: String,
}

/// How a child tells its parent, in its last line.
#[derive(Debug, Serialize, Deserialize)]
enum Told {
    Passed(String),
    Skipped(String),
    Failed(String),
}

/// Marks the line among whatever the plugin prints.
const MARK: &str = "\u{1e}shield-check ";

pub fn check(arguments: &CheckArguments, registry: &Registry) -> Result<(), Failure> {
    let candidates = registry.named(&arguments.plugin).map_err(|error| Failure::Input(error.to_string()))?;
    if let Some(id) = &arguments.inside {
        return inside(arguments, registry, &candidates, id);
    }
    let progress = if arguments.json { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    let mut lines = Vec::new();
    for entry in &candidates {
        for check in chosen(arguments, entry.kind)? {
            let plugin = entry.manifest.id.clone();
            progress.set_message(format!("{plugin}: {}", check.name));
            progress.tick();
            let (verdict, reason) = outside(arguments, entry, &check)?;
            lines.push(Line { plugin, check: check.name, rule: check.rule, verdict, reason });
        }
    }
    progress.finish_and_clear();
    report(arguments, &lines)
}

fn chosen(arguments: &CheckArguments, kind: Kind) -> Result<Vec<Check>, Failure> {
    let mut all = checks(kind);
    let Some(only) = &arguments.only else { return Ok(all) };
    let known = all.iter().map(|check| check.name).collect::<Vec<_>>().join(", ");
    all.retain(|check| check.name == only);
    if all.is_empty() {
        return Err(Failure::Input(format!(
            "there is no check {only:?} of a plugin of kind {kind}; there are {known}"
        )));
    }
    Ok(all)
}

/// In the child: runs the check and tells.
fn inside(
    arguments: &CheckArguments,
    registry: &Registry,
    candidates: &[Entry],
    id: &str,
) -> Result<(), Failure> {
    let found = candidates.iter().find(|entry| entry.manifest.id == id);
    let entry = found.ok_or_else(|| Failure::Input(format!("there is no plugin {id:?}")))?;
    let candidate = Candidate {
        registry,
        selection: Selection::new(id).at(&entry.path),
        kind: entry.kind,
        manifest: &entry.manifest,
        config: arguments.config.clone(),
        seed: arguments.reproduce,
    };
    for check in chosen(arguments, entry.kind)? {
        let told = match check.run(&candidate) {
            Ok(Verdict::Passed(seen)) => Told::Passed(seen),
            Ok(Verdict::Skipped(why)) => Told::Skipped(why),
            Err(what) => Told::Failed(what),
        };
        let told = serde_json::to_string(&told).map_err(|error| Failure::Run(error.to_string()))?;
        output::result(format_args!("\n{MARK}{told}"))?;
    }
    Ok(())
}

/// In the parent: runs the child and waits for what it tells, but not for ever.
fn outside(
    arguments: &CheckArguments,
    entry: &Entry,
    check: &Check,
) -> Result<(&'static str, String), Failure> {
    let failed = |error: std::io::Error| Failure::Run(format!("a check cannot be run: {error}"));
    let mut command = Command::new(env::current_exe().map_err(failed)?);
    command.args(["plugin", "check"]).arg(&entry.path);
    command.args(["--inside", &entry.manifest.id, "--only", check.name, "--config", &arguments.config]);
    command.args(["--reproduce", &arguments.reproduce.to_string()]);
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(failed)?;
    let (told, complaints) = match (reader(child.stdout.take()), reader(child.stderr.take())) {
        (Ok(told), Ok(complaints)) => (told, complaints),
        (Err(error), _) | (_, Err(error)) => {
            child.kill().and_then(|()| child.wait()).map_err(failed)?;
            return Err(failed(error));
        }
    };
    let limit = Duration::from_secs(arguments.time_limit);
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().map_err(failed)? {
            break Some(status);
        }
        if start.elapsed() > limit {
            child.kill().and_then(|()| child.wait()).map_err(failed)?;
            break None;
        }
        thread::sleep(Duration::from_millis(5));
    };
    let text = |reader: Reader| {
        let read = reader.join().map_err(|_| Failure::Run("a check cannot be read".into()))?;
        read.map(|text| String::from_utf8_lossy(&text).into_owned()).map_err(failed)
    };
    let (told, complaints) = (text(told)?, text(complaints)?);
    Ok(match status {
        None => ("HANG", format!("it was still busy after {} s", limit.as_secs())),
        Some(status) => verdict(status, &told, &complaints),
    })
}

type Reader = thread::JoinHandle<std::io::Result<Vec<u8>>>;

/// Reads a stream to its end on a thread of its own: a child whose pipe is full would wait for ever.
fn reader(stream: Option<impl Read + Send + 'static>) -> std::io::Result<Reader> {
    thread::Builder::new().spawn(move || {
        let mut text = Vec::new();
        stream.map(|mut stream| stream.read_to_end(&mut text)).transpose().map(|_| text)
    })
}

fn verdict(status: ExitStatus, told: &str, complaints: &str) -> (&'static str, String) {
    let line = told.lines().rev().find_map(|line| line.strip_prefix(MARK));
    let told = line.and_then(|line| serde_json::from_str(line).ok());
    match told {
        Some(told) if status.success() => match told {
            Told::Passed(seen) => ("pass", seen),
            Told::Skipped(why) => ("skip", why),
            Told::Failed(what) => ("FAIL", what),
        },
        _ => {
            let last = complaints.lines().rev().find(|line| !line.trim().is_empty());
            let said = last.map_or(String::new(), |last| format!("; it said: {last}"));
            let ending = Ending::from(status);
            ("CRASH", format!("the process {ending} before the check had an answer{said}"))
        }
    }
}

fn report(arguments: &CheckArguments, lines: &[Line]) -> Result<(), Failure> {
    if arguments.json {
        let json = serde_json::to_string_pretty(lines).map_err(|error| Failure::Run(error.to_string()))?;
        output::result(json)?;
    } else {
        let mut table = Table::new();
        table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Dynamic);
        table.set_header(["PLUGIN", "CHECK", "VERDICT", "WHAT MUST HOLD", "WHAT WAS SEEN"]);
        for Line { plugin, check, rule, verdict, reason } in lines {
            table.add_row([plugin.as_str(), check, verdict, rule, reason]);
        }
        output::result(table)?;
    }
    let is_bad = |line: &&Line| !["pass", "skip"].contains(&line.verdict);
    let bad: Vec<String> =
        lines.iter().filter(is_bad).map(|line| format!("{} {}", line.plugin, line.check)).collect();
    if bad.is_empty() {
        return Ok(());
    }
    let seed = arguments.reproduce;
    Err(Failure::Run(format!(
        "{} of {} checks failed: {}; --reproduce {seed} --only <check> asks the same again",
        bad.len(),
        lines.len(),
        bad.join(", ")
    )))
}
