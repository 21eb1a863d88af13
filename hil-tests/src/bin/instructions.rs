//! Counts the instructions of a control step and of a cycle of the whole rig, and compares them with what is on record.
//!
//! Times on a shared machine tell little; the number of instructions is the same on every run. valgrind counts a program that
//! does the work so often and once more often: the difference is the work's own. The record is `hil-tests/benches/instructions.csv`, made
//! with the profile and the compiler that it names: with another compiler nothing is judged.
//!
//! ```sh
//! cargo run -p hil-tests --bin instructions             # fails where a count is 5 % above its record
//! cargo run -p hil-tests --bin instructions -- --record "why it costs more"
//! ```

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use hil_tests::machine::Machine;
use hil_tests::tape::Tape;
use yieldwall::guard::Request;

/// Cycles of the scene before the first that counts: the tool is on its way to the circle.
const SKIP: usize = 400;
/// Cycles of a run that counts less, and of one that counts more. Between them the tool meets the circle.
const CYCLES: [usize; 2] = [200, 1200];
/// Growth above which a count is a failure.
const MOST_GROWTH: f64 = 0.05;

/// What is counted: name, rig, and whether the whole rig runs or the control step alone.
const WORK: [(&str, &str, bool); 4] = [
    ("control step, torque mode", "paper-admittance", false),
    ("control step, position mode", "paper-admittance-csp", false),
    ("cycle of the rig, torque mode", "paper-admittance", true),
    ("cycle of the rig, position mode", "paper-admittance-csp", true),
];

/// A line of the record.
struct Entry {
    name: String,
    instructions: f64,
    note: String,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words[..] {
        ["--work", name, cycles] => {
            cycles.parse().map_err(|_| format!("{cycles} is no count")).and_then(|n| work(name, n))
        }
        [] => compare(None),
        ["--record", note] => compare(Some(note)),
        _ => Err("usage: instructions [--record \"why it costs more\"]".to_owned()),
    };
    done.map_or_else(
        |error| {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        },
        |()| ExitCode::SUCCESS,
    )
}

/// Does the work of so many cycles; what comes before them is the same for any number.
fn work(name: &str, cycles: usize) -> Result<(), String> {
    let (_, rig, is_whole) =
        *WORK.iter().find(|work| work.0 == name).ok_or_else(|| format!("nothing is called {name}"))?;
    let machine = Machine::builtin(rig, "circle-tour");
    if is_whole {
        let mut rig = machine.enabled().map_err(|error| error.to_string())?;
        for _ in 0..SKIP + cycles {
            black_box(rig.run_cycle(Request::None).map_err(|error| error.to_string())?);
        }
        return Ok(());
    }
    let tape = Tape::record(machine, SKIP, CYCLES[1]).map_err(|error| error.to_string())?;
    let mut cycle = tape.cycle().clone();
    for period in tape.periods.iter().take(cycles) {
        black_box(cycle.step(black_box(&period.inputs)));
    }
    Ok(())
}

/// Counts everything; writes the record with this note, or holds the counts against it.
fn compare(note: Option<&str>) -> Result<(), String> {
    let compiler = compiler()?;
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/instructions.csv");
    let (made_with, entries) = read(&path)?;
    if note.is_none() && made_with != compiler {
        println!("SKIPPED: the record was made with {made_with}, this is {compiler}");
        return Ok(());
    }
    if Command::new("valgrind").arg("--version").output().is_err() {
        println!("SKIPPED: valgrind is missing (Debian: apt install valgrind)");
        return Ok(());
    }
    let mut lines = vec![format!("# {compiler}"), "work,instructions,note".to_owned()];
    let mut grown = Vec::new();
    for (name, ..) in WORK {
        let counts = CYCLES.map(|cycles| count(name, cycles));
        let [few, many] = counts;
        let each = (many? - few?) / (CYCLES[1] - CYCLES[0]) as f64;
        let before = entries.iter().find(|entry| entry.name == name);
        let growth = before.map_or(f64::INFINITY, |entry| each / entry.instructions - 1.0);
        let was = before.map_or(f64::NAN, |entry| entry.instructions);
        println!("{name:<32} {each:>9.0} instructions, {was:>9.0} on record, {:+.1} %", 100.0 * growth);
        if growth > MOST_GROWTH {
            grown.push(name);
        }
        let has_changed = growth.abs() > MOST_GROWTH;
        let kept = before.filter(|_| !has_changed).map(|entry| entry.note.clone());
        lines.push(format!("\"{name}\",{each:.0},{}", kept.or(note.map(str::to_owned)).unwrap_or_default()));
    }
    if note.is_some() {
        return std::fs::write(&path, lines.join("\n") + "\n").map_err(|error| format!("{}: {error}", path.display()));
    }
    if grown.is_empty() {
        return Ok(());
    }
    let names = grown.join("; ");
    Err(format!("more than 5 % above the record: {names}. Find out why; if it has to be, --record \"the reason\""))
}

/// Instructions of this program at this work.
fn count(name: &str, cycles: usize) -> Result<f64, String> {
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(program)
        .args(["--work", name, &cycles.to_string()])
        .output()
        .map_err(|error| format!("valgrind: {error}"))?;
    let told = String::from_utf8_lossy(&output.stderr);
    let collected = told.lines().find_map(|line| line.split("Collected :").nth(1)?.trim().parse().ok());
    collected.filter(|_| output.status.success()).ok_or_else(|| format!("valgrind counted nothing:\n{told}"))
}

/// The compiler and the kind of build, as the record names them.
fn compiler() -> Result<String, String> {
    let output = Command::new("rustc").arg("--version").output().map_err(|error| format!("rustc: {error}"))?;
    let version = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    let profile = if yieldwall::run::built::PROFILE == "debug" { "dev" } else { "release" };
    Ok(format!("{version}, {profile} profile, {}", std::env::consts::ARCH))
}

/// Compiler and lines of the record.
fn read(path: &PathBuf) -> Result<(String, Vec<Entry>), String> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let made_with = text.lines().next().unwrap_or_default().trim_start_matches("# ").to_owned();
    let entry = |line: &str| {
        let (name, rest) = line.strip_prefix('"')?.split_once("\",")?;
        let (count, note) = rest.split_once(',')?;
        Some(Entry { name: name.to_owned(), instructions: count.parse().ok()?, note: note.to_owned() })
    };
    let lines = text.lines().skip(2);
    let entries = lines.map(|line| entry(line).ok_or_else(|| format!("{}: {line:?} is no line of it", path.display())));
    Ok((made_with, entries.collect::<Result<_, _>>()?))
}
