//! `shield plugin check`: every check in a process of its own, so that a crash or a hang is a finding and nothing more.

use std::{
    env,
    io::Read as _,
    path::Path,
    process::{Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use clap::Args;
use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};
use shield_api::manifest::Manifest;
use shield_runtime::{
    environment_check::Verdict,
    plugin::{Kind, PluginError, Registry, Selection, read_manifests},
    plugin_check::{Candidate, Check, checks},
};

use super::super::Failure;

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
    let candidates = candidates(arguments, registry)?;
    if let Some(id) = &arguments.inside {
        return inside(arguments, registry, &candidates, id);
    }
    let progress = if arguments.json { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    let mut lines = Vec::new();
    for (selection, kind, manifest) in &candidates {
        for check in chosen(arguments, *kind)? {
            progress.set_message(format!("{}: {}", manifest.id, check.name));
            progress.tick();
            let (verdict, reason) = outside(arguments, selection, &check)?;
            let plugin = manifest.id.clone();
            lines.push(Line { plugin, check: check.name, rule: check.rule, verdict, reason });
        }
    }
    progress.finish_and_clear();
    report(arguments, &lines)
}

type Named = (Selection, Kind, Manifest);

fn candidates(arguments: &CheckArguments, registry: &Registry) -> Result<Vec<Named>, Failure> {
    let refused = |error: PluginError| Failure::Input(error.to_string());
    let path = Path::new(&arguments.plugin);
    let manifests: Vec<(std::path::PathBuf, Manifest)> = if path.is_file() {
        let found = read_manifests(path).map_err(refused)?;
        found.into_iter().map(|manifest| (path.to_owned(), manifest)).collect()
    } else {
        let found = registry.named(&arguments.plugin).map_err(refused)?;
        found.into_iter().map(|entry| (entry.path.clone(), entry.manifest.clone())).collect()
    };
    let named = |(path, manifest): (std::path::PathBuf, Manifest)| {
        let kind = Kind::from_name(&manifest.kind).ok_or_else(|| {
            Failure::Input(format!("{:?} is of the unknown kind {:?}", manifest.id, manifest.kind))
        })?;
        Ok((Selection::new(&manifest.id).at(path), kind, manifest))
    };
    manifests.into_iter().map(named).collect()
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
    candidates: &[Named],
    id: &str,
) -> Result<(), Failure> {
    let found = candidates.iter().find(|(selection, ..)| selection.id == id);
    let (selection, kind, manifest) =
        found.ok_or_else(|| Failure::Input(format!("there is no plugin {id:?}")))?;
    let (selection, config) = (selection.clone(), arguments.config.clone());
    let candidate =
        Candidate { registry, selection, kind: *kind, manifest, config, seed: arguments.reproduce };
    for check in chosen(arguments, *kind)? {
        let told = match check.run(&candidate) {
            Ok(Verdict::Passed(seen)) => Told::Passed(seen),
            Ok(Verdict::Skipped(why)) => Told::Skipped(why),
            Err(what) => Told::Failed(what),
        };
        let told = serde_json::to_string(&told).map_err(|error| Failure::Run(error.to_string()))?;
        println!("\n{MARK}{told}");
    }
    Ok(())
}

/// In the parent: runs the child and waits for what it tells, but not for ever.
fn outside(
    arguments: &CheckArguments,
    selection: &Selection,
    check: &Check,
) -> Result<(&'static str, String), Failure> {
    let failed = |error: std::io::Error| Failure::Run(format!("a check cannot be run: {error}"));
    let mut command = Command::new(env::current_exe().map_err(failed)?);
    command.args(["plugin", "check"]).arg(selection.path.as_deref().unwrap_or(Path::new("")));
    command.args(["--inside", &selection.id, "--only", check.name, "--config", &arguments.config]);
    command.args(["--reproduce", &arguments.reproduce.to_string()]);
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(failed)?;
    let (mut out, mut error) = (child.stdout.take(), child.stderr.take());
    let reader = thread::spawn(move || {
        let mut text = Vec::new();
        out.as_mut().map(|out| out.read_to_end(&mut text)).transpose().map(|_| text)
    });
    let complaints = thread::spawn(move || {
        let mut text = Vec::new();
        error.as_mut().map(|error| error.read_to_end(&mut text)).transpose().map(|_| text)
    });
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
    let text = |reader: thread::JoinHandle<std::io::Result<Vec<u8>>>| {
        let read = reader.join().map_err(|_| Failure::Run("a check cannot be read".into()))?;
        read.map(|text| String::from_utf8_lossy(&text).into_owned()).map_err(failed)
    };
    let (told, complaints) = (text(reader)?, text(complaints)?);
    Ok(match status {
        None => ("HANG", format!("it was still busy after {} s", limit.as_secs())),
        Some(status) => verdict(status, &told, &complaints),
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
            let last = complaints.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or_default();
            (
                "CRASH",
                format!("{}{}{last}", how_it_died(status), if last.is_empty() { "" } else { "; it said: " }),
            )
        }
    }
}

fn how_it_died(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        let name = match signal {
            4 => " (illegal instruction)",
            6 => " (abort)",
            7 => " (bus error)",
            8 => " (arithmetic)",
            11 => " (segmentation fault)",
            _ => "",
        };
        return format!("the process died of signal {signal}{name}");
    }
    format!("the process ended with {status} before the check did")
}

fn report(arguments: &CheckArguments, lines: &[Line]) -> Result<(), Failure> {
    if arguments.json {
        let json = serde_json::to_string_pretty(lines).map_err(|error| Failure::Run(error.to_string()))?;
        println!("{json}");
    } else {
        let mut table = Table::new();
        table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Dynamic);
        table.set_header(["PLUGIN", "CHECK", "VERDICT", "WHAT MUST HOLD", "WHAT WAS SEEN"]);
        for Line { plugin, check, rule, verdict, reason } in lines {
            table.add_row([plugin.as_str(), check, verdict, rule, reason]);
        }
        println!("{table}");
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
