//! `yieldwall new`: a rig from flags, or from a few questions on a terminal.

mod choice;
mod geometry;
mod template;

use std::io::{IsTerminal, stderr, stdin};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::json;

use self::choice::{BusKind, Choice, Law, Mode, Person, Protocol, ask};
use self::geometry::Geometry;
use super::bus::{Plan, plans};
use super::config::Checked;
use super::ending::rig_failure;
use super::failure::{Exit, Failure};
use super::fit;
use super::masses::Masses;
use super::output::Output;
use super::replace::Replace;
use yieldwall_config::{self as config, Bus, Document, Loaded, Rig, Severity, Source};
use yieldwall_drives::profiles::{DeviceProfile, EncoderKind, Reaction, Servo, SetPointWatch, SyncWatch, Tried};
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_rig::analysis::{pose_margins, proposed_gains};

/// Virtual masses that are tried, kg, the first one unless it swings with the scene's hand.
const MASSES_KG: [f64; 6] = [2.0, 3.0, 4.0, 6.0, 8.0, 12.0];

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig file to create; its simulation and scene are created beside it
    #[arg(value_name = "RIG.yaml")]
    rig: PathBuf,
    /// Command mode of the drives: torque, velocity or position
    #[arg(long, value_enum)]
    mode: Option<Mode>,
    /// Cycle time in us, 500 to 10000; at most 2000 in torque mode
    #[arg(long, value_name = "US", value_parser = choice::parse_period)]
    period_us: Option<u32>,
    /// Control law of torque mode
    #[arg(long, value_enum)]
    law: Option<Law>,
    /// Bus of the devices
    #[arg(long, value_enum)]
    bus: Option<BusKind>,
    /// Protocol of the force sensor on CAN
    #[arg(long, value_enum)]
    sensor: Option<Protocol>,
    /// Device profiles of the left and the right drive, as names or files; a single one applies to both
    #[arg(long, value_name = "PROFILE", value_delimiter = ',')]
    drives: Vec<String>,
    /// Encoder type of the drives, if their profile does not state it: multi_turn or single_turn at power-on
    #[arg(long, value_name = "KIND", value_parser = choice::parse_encoder)]
    encoder: Option<EncoderKind>,
    /// Node ids of the left drive, the right drive, and a CANopen sensor
    #[arg(long, value_name = "ID", value_delimiter = ',', value_parser = clap::value_parser!(u8).range(1..=126))]
    nodes: Vec<u8>,
    /// Lengths of the proximal and the distal links in m
    #[arg(long, value_name = "M", value_delimiter = ',', value_parser = choice::parse_length)]
    links: Vec<f64>,
    /// Distance of the base joints in m; default: two thirds of the proximal links' length
    #[arg(long, value_name = "M", value_parser = choice::parse_length)]
    base: Option<f64>,
    /// Ask nothing, and use the default of each missing value; automatic without a terminal
    #[arg(long, short)]
    yes: bool,
    #[command(flatten)]
    replace: Replace,
}

/// The files of a new rig.
struct Files {
    /// Path and text of rig, simulation and scene.
    texts: [(PathBuf, String); 3],
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let names = names(&arguments.rig)?;
    // The check comes before any question.
    for path in &names {
        arguments.replace.check_new(path)?;
    }
    let is_asked = !arguments.yes && !output.is_json() && stdin().is_terminal();
    let (mut answers, mut questions) = (stdin().lock(), stderr());
    let columns = fit::columns(stderr()).unwrap_or(fit::USUAL);
    let person = Person { answers: &mut answers, questions: &mut questions, columns };
    let choice = ask(arguments, is_asked.then_some(person))?;
    let files = compose(&choice, &names)?;
    for (path, text) in &files.texts {
        arguments.replace.write(path, text.as_bytes())?;
    }
    let mut checked = Checked::of(Source::disk(&arguments.rig));
    checked.rehearse();
    output.warnings(&checked.findings);
    let rig = arguments.rig.display().to_string();
    if output.is_json() {
        let is_ok = checked.findings.is_empty();
        let written: Vec<_> = names.iter().map(|path| path.display().to_string()).collect();
        return output.end(json!({ "files": written, "check": checked.to_json(&rig, is_ok) }), Ok(()));
    }
    for path in &names {
        output.news(&format!("written   {}", path.display()))?;
    }
    for line in checked.lines() {
        output.news(&format!("    {line}"))?;
    }
    next(&rig, &checked).iter().try_for_each(|paragraph| output.news(&fit::fitted(paragraph, fit::USUAL)))
}

/// Returns the next steps for a new rig, a paragraph each.
fn next(name: &str, checked: &Checked) -> Vec<String> {
    let edit = format!("next      edit these files, then `yieldwall config check {name}`");
    let rig = match &checked.result {
        Ok(Document::Rig(rig)) => Some(&rig.value),
        _ => None,
    };
    let drives = rig.iter().flat_map(|rig| &rig.drives);
    let servos: Vec<&DeviceProfile> = drives.filter_map(|drive| Some(&**drive.profile.get()?)).collect();
    let is_on_ethercat = rig.is_some_and(Rig::has_drives_on_ethercat);
    let (mut paragraphs, mut is_open) = (vec![edit], false);
    for (index, profile) in servos.iter().enumerate() {
        // SYNC and set-points are watched on CAN alone.
        let gaps = profile.servo().filter(|_| !is_on_ethercat).map(gaps).unwrap_or_default();
        if !gaps.is_empty() && !servos.iter().take(index).any(|other| other.name() == profile.name()) {
            is_open = true;
            paragraphs.push(format!("open      missing in the profile `{}`: {}", profile.name(), gaps.join("; ")));
        }
    }
    if checked.has_passed() {
        paragraphs.push(format!("run       `yieldwall run {name}` runs it on the embedded simulation"));
    } else {
        let why = if is_open { "; simulated drives do only what their profile states" } else { "" };
        paragraphs.push(format!("run       `yieldwall run {name}` refuses it, for the reason above{why}"));
    }
    if servos.iter().any(|profile| profile.profile.tried != Tried::Simulation) {
        let (interface, signals) = match is_on_ethercat {
            true => ("eth0", "stops the outputs and leaves OP"),
            false => ("can0", "stops SYNC, set-points and heartbeat"),
        };
        paragraphs.push(format!(
            "bus       with the drives on a bus: `yieldwall doctor {name} --bus {interface}`, then `yieldwall drill {name} --bus {interface}`. \
             The drill {signals} while the rig rests, and measures whether the drives stop. It refuses drives that continue, and prints the \
             lines for the profile. Then `yieldwall run {name} --bus {interface}`"
        ));
    }
    paragraphs
}

/// Returns the watchdogs that a drive lacks by its profile, and the missing entries on the others.
fn gaps(servo: &Servo) -> Vec<String> {
    let mut gaps = Vec::new();
    for (watchdog, found) in [
        (
            Watchdog::Sync,
            match &servo.watchdogs.sync {
                SyncWatch::None => None,
                SyncWatch::BuiltIn(watch) => Some((watch.periods.is_some(), watch.reaction)),
                SyncWatch::Object(timed) => Some((true, timed.reaction)),
            },
        ),
        (
            Watchdog::SetPoints,
            match &servo.watchdogs.set_points {
                SetPointWatch::None => None,
                SetPointWatch::BuiltIn(watch) => Some((watch.periods.is_some(), watch.reaction)),
                SetPointWatch::EventTimer { reaction, .. } => Some((true, *reaction)),
                SetPointWatch::Object(timed) => Some((true, timed.reaction)),
            },
        ),
    ] {
        let name = watchdog.name();
        match found {
            None => gaps.push(format!("the drive has no watchdog for {name}")),
            Some((knows_time, reaction)) => {
                if !knows_time {
                    gaps.push(format!("time until the drive stops without {name}"));
                }
                match reaction {
                    Reaction::Unknown => gaps.push(format!("reaction of the drive without {name}")),
                    Reaction::Nothing => gaps.push(format!("the drive does not stop without {name}")),
                    Reaction::AbortConnection | Reaction::Fault => {}
                }
            }
        }
    }
    gaps
}

/// Returns the paths of rig, simulation and scene.
fn names(rig: &Path) -> Result<[PathBuf; 3], Failure> {
    let is_yaml = rig.extension().is_some_and(|ending| ending == "yaml" || ending == "yml");
    let stem = rig.file_stem().and_then(|stem| stem.to_str()).filter(|_| is_yaml);
    let Some(stem) = stem else {
        let message = format!("{} is not a name for a rig file", rig.display());
        return Err(Failure::new(Exit::Usage, message, "write a name that ends in .yaml, such as my-rig.yaml"));
    };
    let beside = |what: &str| rig.with_file_name(format!("{stem}-{what}.yaml"));
    Ok([rig.to_owned(), beside("simulation"), beside("scene")])
}

/// Returns the files, with the values that follow from the choices: time of the control step, gains, virtual mass.
fn compose(choice: &Choice, names: &[PathBuf; 3]) -> Result<Files, Failure> {
    let geometry = Geometry::of(choice.links_m, choice.base_m)?;
    let files_of = |numbers: &template::Numbers| {
        let [rig, simulation, scene] = names;
        let name_of = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Files {
            texts: [
                (rig.clone(), template::rig(choice, &geometry, numbers, &name_of(rig), &name_of(simulation))),
                (simulation.clone(), template::simulation(&name_of(rig), &name_of(scene))),
                (scene.clone(), template::scene(&geometry, &name_of(rig))),
            ],
        }
    };
    let mut numbers = template::Numbers::first(choice);
    let rig = files_of(&numbers).load(choice)?;
    numbers.compute_at_us = control_step_us(&rig)?;
    if choice.mode == Mode::Torque {
        let found = pose_margins(&rig.value).map_err(|error| rig_failure(&error))?;
        let tuned = found.and_then(|found| proposed_gains(&rig.value, &found));
        let tuned = tuned.ok_or_else(|| {
            let message = "no gains found with margins of 6 dB and 45 degrees at this cycle";
            Failure::new(Exit::ConfigInvalid, message, "give a shorter --period-us, or another --mode")
        })?;
        numbers.gains = tuned.gains;
    }
    for mass_kg in MASSES_KG {
        numbers.mass_kg = mass_kg;
        let rig = files_of(&numbers).load(choice)?;
        let masses = Masses::of_scene(&rig).map_err(|error| rig_failure(&error))?;
        if masses.finding(&rig).is_none() {
            return Ok(files_of(&numbers));
        }
    }
    let message = "no virtual mass up to 12 kg is stable with the hand of the scene";
    Err(Failure::new(Exit::ConfigInvalid, message, "give a shorter --period-us, or another --mode"))
}

/// Returns the middle of the time window of the control step.
fn control_step_us(rig: &Loaded<Rig>) -> Result<u32, Failure> {
    let plans = plans(&rig.value).map_err(|error| rig_failure(&error))?;
    let advice = plans.first().and_then(Plan::advice);
    let (bus, period_us) = (rig.value.buses.values().next(), rig.value.cycle.period_us);
    let bit_rate = bus.and_then(Bus::canopen).map(|bus| bus.bit_rate_bit_per_s);
    match advice {
        Some((rate, period, [earliest, latest])) if rate == bit_rate && period.as_micros() == u128::from(period_us) => {
            Ok(((earliest + latest) / 2) as u32)
        }
        other => {
            let longer_us = other.map_or(2 * u128::from(period_us), |(_, period, _)| period.as_micros());
            let bus = if bit_rate.is_some() { "a bus of 1 Mbit/s" } else { "an EtherCAT segment" };
            let message =
                format!("{bus} cannot keep a cycle of {period_us} us with these devices in this mode: a frame is late");
            Err(Failure::new(Exit::Usage, message, format!("give --period-us {longer_us} or another --sensor")))
        }
    }
}

impl Files {
    /// Returns the rig as it will be on disk.
    fn source(&self, choice: &Choice) -> Result<Source, Failure> {
        let own = self
            .texts
            .iter()
            .map(|(path, text)| (PathBuf::from(path.file_name().unwrap_or_default()), Arc::from(text.as_str())));
        let mut texts: Vec<(PathBuf, Arc<str>)> = own.collect();
        let name = texts.first().map(|(name, _)| name.clone()).unwrap_or_default();
        for (written, path) in &choice.profile_files {
            texts.push((PathBuf::from(written), Source::disk(path).read()?));
        }
        Ok(Source::among(name, texts))
    }

    /// Reads the rig as it will be on disk.
    fn load(&self, choice: &Choice) -> Result<Loaded<Rig>, Failure> {
        let rig = config::load_rig(self.source(choice)?).map_err(|report| {
            let mut failure = Failure::from(report);
            // No file was written, so a finding has no place to show.
            failure.report.diagnostics.retain(|finding| finding.severity == Severity::Error);
            for finding in &mut failure.report.diagnostics {
                (finding.place, finding.text) = (None, None);
                if finding.message.contains("where their zero is") {
                    let help =
                        "give --encoder multi_turn or --encoder single_turn if the drives' motors have such encoders";
                    finding.help = Some(help.to_owned());
                }
            }
            // Both drives have the same profile.
            failure.report.diagnostics.dedup_by(|one, other| one.message == other.message);
            failure
        })?;
        Ok(rig)
    }
}

#[cfg(test)]
mod tests;
