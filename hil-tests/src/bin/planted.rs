//! Plants defects in a copy of the program, one at a time, and asks the soak to find each.
//!
//! The copy carries all defects at once, each behind a question to the environment, so that it is built only once:
//! `cargo run -p hil-tests --bin planted`. A defect that no seed finds, or a line that is not there any more, is a failure.
//! Without a defect the copy has to be clean: what finds defects where there are none proves nothing.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::atomic::AtomicBool;

use yieldwall::batch;

/// A defect: in `file` the text `from`, an expression or statements, becomes `to`.
struct Defect {
    name: &'static str,
    file: &'static str,
    from: &'static str,
    to: &'static str,
}

const fn defect(name: &'static str, file: &'static str, from: &'static str, to: &'static str) -> Defect {
    Defect { name, file, from, to }
}

/// What is planted in gate, supervisor, fault counts, cycle, fixture, master and process data.
const DEFECTS: [Defect; 18] = [
    defect(
        "the gate lets every torque through",
        "src/motion/guard/gate.rs",
        "JointTorques::new(torques.left().clamp(-left, left), torques.right().clamp(-right, right))",
        "JointTorques::new(torques.left() * (1.0 + 0.1 * f64::from(torques.left() > 0.9 * left)), torques.right().clamp(-right, right))",
    ),
    defect(
        "the gate lets every position target through",
        "src/motion/guard/gate.rs",
        "(*target - from).max_abs() > speed * self.limits.period_s",
        "false",
    ),
    defect(
        "a latched state is left when its fault has gone",
        "src/motion/guard/supervisor.rs",
        "if view.request == Request::Reset {",
        "if view.request == Request::Reset || view.worst.is_none() {",
    ),
    defect(
        "drives in fault are reset without a request",
        "src/bus/master.rs",
        "if self.last.directive.fault_reset {",
        "if self.last.directive.fault_reset || now.0 / 1_000_000 % 40 == 0 {",
    ),
    defect(
        "a reaction comes two observations late",
        "src/motion/guard/fault/counts.rs",
        "self.in_a_row >= times",
        "self.in_a_row >= times + 2",
    ),
    defect(
        "observations that are not in a row are counted as if they were",
        "src/motion/guard/fault/counts.rs",
        "count.in_a_row = if present { count.in_a_row.saturating_add(1) } else { 0 };",
        "count.in_a_row = count.in_a_row.saturating_add(u16::from(present));",
    ),
    defect(
        "the stop ramp is ten times too steep",
        "src/motion/guard/stop.rs",
        "1.5 * velocity.norm() / deceleration_m_per_s2",
        "0.15 * velocity.norm() / deceleration_m_per_s2",
    ),
    defect(
        "the reference of before the stop is kept for the next run",
        "src/motion/cycle/mod.rs",
        "        self.track.forget();\n        self.halt = None;\n",
        "        self.halt = None;\n",
    ),
    defect(
        "a quick stop is sent to the left drive alone",
        "src/bus/axis.rs",
        "right.order(goal, targets[1], releases)",
        "right.order(if goal == Goal::QuickStop { Goal::OperationEnabled } else { goal }, targets[1], releases)",
    ),
    defect(
        "set-points go out although the last ones have not left",
        "src/bus/master.rs",
        "if self.networks.is_mute() {",
        "if self.networks.is_silent() {",
    ),
    defect(
        "SYNC leaves although a stranger's set-point was heard",
        "src/bus/can/network.rs",
        "self.is_sync_held = self.is_mute() || self.is_overwritten;",
        "self.is_sync_held = self.is_mute();",
    ),
    defect(
        "the turn of an encoder is not looked for",
        "src/bus/axis.rs",
        "self.unwrapper.unwrap(position);",
        "self.unwrapper = CountUnwrapper::near(0); self.unwrapper.unwrap(position);",
    ),
    defect(
        "a heartbeat is missed too late",
        "src/bus/can/line.rs",
        "node.heartbeat * HEARTBEAT_PERIODS",
        "node.heartbeat * (HEARTBEAT_PERIODS + 1)",
    ),
    defect(
        "on EtherCAT the working counter of inputs is ignored",
        "src/bus/ethercat/exchange.rs",
        "inputs.working_counter == 1",
        "true",
    ),
    defect(
        "on EtherCAT a late reply is used",
        "src/fieldbus/ethercat/frame.rs",
        "(command, index, address, len, has_more, data)",
        "(command, 0, address, len, has_more, data)",
    ),
    defect(
        "a set-point loses its sign",
        "src/bus/can/image.rs",
        "target.put_signed(&mut word, i64::from(orders.target));",
        "target.put_signed(&mut word, i64::from(orders.target.abs()));",
    ),
    defect(
        "the wall yields at half as much again as its force",
        "src/motion/fixture/yield_set.rs",
        "yield_m: limits.yield_n / stiffness_n_per_m",
        "yield_m: 1.5 * limits.yield_n / stiffness_n_per_m",
    ),
    defect(
        "the proxy is held on the wrong side of a surface",
        "src/motion/fixture/proxy/mod.rs",
        "proxy = landed;",
        "proxy = landed - foot.normal * 1e-3;",
    ),
];

/// Seeds that a defect may take.
const SEEDS: u64 = 200;
/// Seeds in which the copy has to be clean without a defect.
const CLEAN_SEEDS: u64 = 6;
const CYCLES: u32 = 10_000;
const WHICH: &str = "YIELDWALL_PLANTED";
const PROGRAM: &str = "yieldwall-planted";

/// The program of the copy: seeds from 0 on to before the one that is named, up to the first that finds a violation. It prints that seed and the
/// invariants that did not hold. The command line is not built for it.
const MAIN: &str = r#"//! The soak alone.

use yieldwall_soak::{Shipped, run_seed};

fn main() {
    let number = |at: usize| std::env::args().nth(at).and_then(|text| text.parse::<u64>().ok()).expect("a number");
    let shipped = Shipped::load().unwrap_or_else(|_| panic!("the rigs do not load"));
    for seed in 0..number(1) {
        let violations = run_seed(&shipped, seed, number(2) as u32, None).violations;
        let mut names: Vec<_> = violations.iter().map(|found| found.invariant.name()).collect();
        names.sort_unstable();
        names.dedup();
        if !names.is_empty() {
            return println!("{seed} {}", names.join(" "));
        }
    }
}
"#;

/// What the copy asks; an expression of type `bool`.
fn question(number: usize) -> String {
    format!("(crate::planted() == {number})")
}

fn main() -> ExitCode {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new(".")).to_owned();
    match plant(&root, &root.join("target/planted")).and_then(|program| search(&program)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

/// Copies the program, plants all defects and builds it.
fn plant(root: &Path, folder: &Path) -> Result<PathBuf, String> {
    let tree = folder.join("tree");
    if tree.exists() {
        fs::remove_dir_all(&tree).map_err(|error| at(&tree, &error))?;
    }
    for part in ["src", "drives", "config", "examples", "hil-tests", "Cargo.toml", "Cargo.lock"] {
        copy(&root.join(part), &tree.join(part))?;
    }
    for (index, defect) in DEFECTS.iter().enumerate() {
        replace(&tree.join(defect.file), defect.from, &choice(index + 1, defect))?;
    }
    for package in ["src/bus", "src/fieldbus", "src/motion"] {
        let library = tree.join(package).join("lib.rs");
        let text = fs::read_to_string(&library).map_err(|error| at(&library, &error))?;
        let text = format!(
            "#![allow(warnings)]\n{text}\npub(crate) fn planted() -> usize {{\n    static WHICH: std::sync::OnceLock<usize> = std::sync::OnceLock::new();\n    \
             *WHICH.get_or_init(|| std::env::var(\"{WHICH}\").ok().and_then(|which| which.parse().ok()).unwrap_or(0))\n}}\n"
        );
        fs::write(&library, text).map_err(|error| at(&library, &error))?;
    }
    let main = tree.join("src/program/main.rs");
    fs::write(&main, MAIN).map_err(|error| at(&main, &error))?;
    // A program of another name without the command line, so that it can share the built dependencies.
    let program = tree.join("src/program/Cargo.toml");
    replace(&program, "name = \"yieldwall\"", &format!("name = \"{PROGRAM}\""))?;
    replace(&program, "full = [\"yieldwall-cli/full\"]", "full = []")?;
    replace(&program, "ethercrab = [\"yieldwall-cli/ethercrab\"]", "ethercrab = []")?;
    replace(&program, "view = [\"yieldwall-cli/view\"]", "view = []")?;
    replace(&program, "yieldwall-cli.workspace", "yieldwall-soak.workspace")?;
    // And of another version: cargo takes packages of one name and version in one folder of built files for the same, wherever
    // their sources lie, and would not build the program itself anew afterwards.
    let plain = "[workspace.package]\nversion = \"0.1.0";
    replace(&tree.join("Cargo.toml"), plain, &format!("{plain}+planted"))?;
    let lock = tree.join("Cargo.lock");
    let mut locked = fs::read_to_string(&lock).map_err(|error| at(&lock, &error))?;
    for package in locked.clone().split("[[package]]\n").filter(|package| !package.contains("\nsource = ")) {
        let mut planted = package.replace("version = \"0.1.0\"", "version = \"0.1.0+planted\"");
        if package.contains("\"yieldwall-program\"") {
            planted = planted.replace("\"yieldwall-cli\"", "\"yieldwall-soak\"");
        }
        locked = locked.replace(package, &planted);
    }
    fs::write(&lock, locked).map_err(|error| at(&lock, &error))?;
    let target = root.join("target");
    let status = Command::new(std::env::var("CARGO").unwrap_or_else(|_| "cargo".into()))
        .args(["build", "--locked", "--quiet", "--package", "yieldwall-program"])
        .current_dir(&tree)
        .env("CARGO_TARGET_DIR", &target)
        .status()
        .map_err(|error| format!("cargo: {error}"))?;
    if status.success() {
        Ok(target.join("debug").join(PROGRAM))
    } else {
        Err("the planted copy does not build".into())
    }
}

/// Replaces a text that stands once in a file.
fn replace(path: &Path, from: &str, to: &str) -> Result<(), String> {
    let text = fs::read_to_string(path).map_err(|error| at(path, &error))?;
    if text.matches(from).count() != 1 {
        return Err(format!("{}: `{from}` stands there not once", path.display()));
    }
    fs::write(path, text.replace(from, to)).map_err(|error| at(path, &error))
}

/// Both texts, the planted one if it is asked for.
fn choice(number: usize, defect: &Defect) -> String {
    let asked = question(number);
    let Defect { from, to, .. } = defect;
    if let (Some(from), Some(to)) = (block_head(from), block_head(to)) {
        return format!("if (if {asked} {{ {to} }} else {{ {from} }}) {{");
    }
    match (from.split_once(": "), to.split_once(": ")) {
        // A field of a literal.
        (Some((field, from)), Some((_, to))) if !from.contains(';') => {
            format!("{field}: if {asked} {{ {to} }} else {{ {from} }}")
        }
        _ if from.ends_with("let") => {
            let [from, to] = [from, to].map(|text| text.trim_end_matches("let").trim_end());
            format!("if {asked} {{ {to} }} else {{ {from} }}\nlet")
        }
        _ if from.trim_end().ends_with(';') => format!("if {asked} {{ {to} }} else {{ {from} }}\n"),
        _ => format!("(if {asked} {{ {to} }} else {{ {from} }})"),
    }
}

/// The condition of `if .. {`.
fn block_head(text: &str) -> Option<&str> {
    text.strip_prefix("if ")?.strip_suffix(" {")
}

fn copy(from: &Path, to: &Path) -> Result<(), String> {
    if from.is_file() {
        return fs::copy(from, to).map(|_| ()).map_err(|error| at(from, &error));
    }
    fs::create_dir_all(to).map_err(|error| at(to, &error))?;
    for entry in fs::read_dir(from).map_err(|error| at(from, &error))? {
        let name = entry.map_err(|error| at(from, &error))?.file_name();
        if name != "target" {
            copy(&from.join(&name), &to.join(&name))?;
        }
    }
    Ok(())
}

fn at(path: &Path, error: &std::io::Error) -> String {
    format!("{}: {error}", path.display())
}

/// Has every defect looked for, several at a time.
fn search(program: &Path) -> Result<(), String> {
    if let Some(found) = soak(program, 0, CLEAN_SEEDS)? {
        return Err(format!("seed {found} where nothing is planted"));
    }
    let numbers: Vec<u64> = (1..=DEFECTS.len() as u64).collect();
    let jobs = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let mut outcomes = BTreeMap::new();
    batch::run(
        &numbers,
        jobs,
        &AtomicBool::new(false),
        |number| soak(program, number, SEEDS),
        |number, outcome| {
            outcomes.insert(number, outcome?);
            Ok::<_, String>(())
        },
    )?;
    let mut missed = Vec::new();
    for (defect, found) in DEFECTS.iter().zip(outcomes.into_values()) {
        match found {
            Some(found) => println!("seed {found}: {}", defect.name),
            None => missed.push(defect.name),
        }
    }
    match missed.as_slice() {
        [] => {
            println!("planted: {} defects, all found", DEFECTS.len());
            Ok(())
        }
        missed => Err(format!("no seed of {SEEDS} finds: {}", missed.join("; "))),
    }
}

/// The first of so many seeds that finds a violation, and which invariants it names.
fn soak(program: &Path, number: u64, seeds: u64) -> Result<Option<String>, String> {
    let output = Command::new(program)
        .args([seeds.to_string(), CYCLES.to_string()])
        .env(WHICH, number.to_string())
        .output()
        .map_err(|error| at(program, &error))?;
    if !output.status.success() {
        return Err(format!("the soak failed: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let told = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    Ok(Some(told).filter(|told| !told.is_empty()))
}
