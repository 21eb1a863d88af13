//! `yieldwall run`: a rig with its scene on the embedded simulation.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::{Value, json};

use super::bus::plans;
use super::failure::{Exit, Failure};
use super::faults::FaultArgument;
use super::keep::{Keep, Kept, LOG_STARTS_AT, Watched};
use super::margins::Margins;
use super::output::Output;
use super::progress::Progress;
use crate::config::{self, Loaded, Report, Severity, Source};
use crate::fixture::prediction;
use crate::guard::{Cause, DeviceSet, Fault};
use crate::record::figure::Drawing;
use crate::rig::{self, Drilled, Finding, RigError};
use crate::study::measures::Measures;
use crate::study::{Overrides, RunReport, drawing, replay, run_rig};

/// Width of PNG pictures: 160 mm at 300 dots per inch.
pub(super) const PICTURE_WIDTH_PX: u32 = 1890;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The rig; `builtin:paper-admittance.yaml` names the copy inside the program
    #[arg(value_name = "RIG.yaml")]
    pub(super) rig: String,
    /// Run on this interface instead of the embedded simulation; for a rig with several buses once for each, as NAME=INTERFACE
    ///
    /// `yieldwall sim` is a rig to try it on.
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "INTERFACE", conflicts_with_all = ["seed", "fault"])]
    pub(super) bus: Vec<String>,
    /// What a cycle waits for: the wall clock, or (simulated devices in lockstep alone) the process data
    #[cfg(target_os = "linux")]
    #[arg(long, value_enum, default_value_t = super::live::PaceArgument::Free, requires = "bus")]
    pub(super) pace: super::live::PaceArgument,
    /// Fail instead of warning when this computer grants no real-time priority or no locked memory
    #[cfg(target_os = "linux")]
    #[arg(long, requires = "bus")]
    pub(super) require_realtime: bool,
    /// Run by the wall clock also if this computer has not proved the timing that the rig asks for; recordings say so
    #[cfg(target_os = "linux")]
    #[arg(long, requires = "bus")]
    pub(super) ignore_latency: bool,
    /// Seconds to run, in place of the scene's duration
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub(super) duration: Option<f64>,
    /// Seed of tremor and sensor noise, in place of the scene's
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Break something on the way, once or again and again, beside what the scene says; `yieldwall faults` lists names
    #[arg(long, value_name = "NAME@TIME[+DURATION][:TARGET]")]
    fault: Vec<FaultArgument>,
    /// Draw trajectory, force and power into this file, an .svg or a .png; folders on the way are made
    #[arg(long, value_name = "PATH")]
    pub(super) figure: Option<PathBuf>,
    /// Write every frame that went over the bus into this file, in the format of candump -L
    #[arg(long, value_name = "FILE")]
    pub(super) candump: Option<PathBuf>,
    /// Run also if the bus cannot keep the cycle; `yieldwall bus budget` tells which frame comes too late
    #[arg(long)]
    pub(super) ignore_bus_budget: bool,
    /// Record every cycle and every frame into this folder, which is made: cycles.mcap, cycles.csv and bus.log
    #[arg(long, value_name = "DIR")]
    pub(super) record: Option<PathBuf>,
    /// Where the time around a fault is kept, in place of the record's folder or yieldwall/black-box in the state folder
    #[arg(long, value_name = "DIR")]
    pub(super) black_box: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    check(arguments)?;
    #[cfg(target_os = "linux")]
    if !arguments.bus.is_empty() {
        return super::live::run(arguments, output);
    }
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    // Those of the scene are among them.
    output.warnings(&rig.warnings);
    check_buses(&rig, arguments.ignore_bus_budget, output)?;
    let scene = config::load_scene(rig.source.relative(&rig.value.scene))?;
    let faults = arguments.fault.iter().map(|fault| fault.0).collect();
    let overrides = Overrides { fixture: None, duration_s: arguments.duration, seed: arguments.seed, faults };
    let margins = Margins::of(&rig.value);
    let about = replay::about(&rig.value, &scene.value, &overrides)
        .map_err(|error| Failure::new(Exit::Internal, format!("documents of the recording: {error}"), ""))?;
    let [candump, record, black_box] =
        [&arguments.candump, &arguments.record, &arguments.black_box].map(Option::as_deref);
    // Before anything is written: a rig that is refused leaves no record.
    let drilled = rig::drill(&rig.value, &scene.value, |_| ()).map_err(|error| rig_failure(&error))?;
    judge(&drilled, &rig.value)?;
    let (keep, watch) = Keep::start(
        Watched::Simulation(&simulated_interfaces(&rig.value)),
        &rig.value,
        &about,
        candump,
        record,
        black_box,
    )?;
    let progress = Progress::new(output);
    progress.begin(&rig.value.rig.name);
    let started = Instant::now();
    let report = run_rig(&rig.value, &scene.value, &overrides, watch, |stage| progress.at(stage));
    let wall_s = started.elapsed().as_secs_f64();
    progress.end();
    // A run that broke off leaves what there is of it.
    let kept = keep.finish()?;
    output.warnings(&kept.warnings());
    let report = report.map_err(|error| kept.point_to_black_box(rig_failure(&error)))?;
    if let Some(path) = &arguments.figure {
        let heading = Some(rig.value.rig.name.clone());
        let drawing = drawing::run(&report.trace, heading).map_err(|error| drawing_failure(&error))?;
        write_drawing(&drawing, path)?;
    }
    let seed = overrides.seed.unwrap_or(scene.value.seed);
    let facts = Facts { rig: &rig.value, drilled, margins, report: &report, kept: &kept, seed, wall_s };
    let is_disturbed = !(overrides.faults.is_empty() && scene.value.faults.is_empty());
    let failure = match report.state {
        Some(state) if state.is_latched() => Some(kept.point_to_black_box(stopped(&report, &rig.value))),
        // A push by injection is no fault of the loop.
        _ if report.measures.is_within_bound() || is_disturbed => None,
        _ => Some(above_bound(&report.measures, &rig.value.rig.name)),
    };
    if !output.is_json() {
        output.news(&facts.text(arguments))?;
        return failure.map_or(Ok(()), Err);
    }
    let mut document = facts.json(arguments);
    let Some(Failure { exit, report }) = failure else { return output.json(&document) };
    // One document: what stopped the rig stands beside what was measured.
    document["exit_code"] = json!(exit.code());
    document["diagnostics"] = json!(report);
    output.json(&document)?;
    Err(Failure { exit, report: Report { diagnostics: Vec::new() } })
}

/// What can be known to be wrong before anything is run.
fn check(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(duration) = arguments.duration
        && !(duration > 0.0 && duration <= config::MAX_DURATION_S)
    {
        let most = config::MAX_DURATION_S;
        let message = format!("--duration is {duration}: a run lasts more than 0 and at most {most} simulated seconds");
        return Err(Failure::new(Exit::Usage, message, "give a number of seconds, such as --duration 5"));
    }
    if let Some(path) = &arguments.figure {
        check_picture(path)?;
    }
    Ok(())
}

/// Whether the buses keep the cycle: of a bus with timing an error, unless it is to be ignored.
pub(super) fn check_buses(rig: &Loaded<config::Rig>, is_ignored: bool, output: &mut Output) -> Result<(), Failure> {
    for plan in plans(&rig.value).map_err(|error| rig_failure(&error))? {
        let Some(mut finding) = plan.finding(rig) else { continue };
        if finding.severity == Severity::Error && !is_ignored {
            finding.help = finding.help.map(|help| format!("{help}, --ignore-bus-budget runs the rig all the same"));
            return Err(Report::from(finding).into());
        }
        finding.severity = Severity::Warning;
        output.warnings(&[finding]);
    }
    Ok(())
}

/// What the buses of the embedded simulation are called in logs, so that `canplayer` finds them.
fn simulated_interfaces(rig: &config::Rig) -> Vec<String> {
    (0..rig.buses.len()).map(|number| format!("vcan{number}")).collect()
}

struct Facts<'a> {
    rig: &'a config::Rig,
    drilled: Drilled,
    margins: Margins,
    report: &'a RunReport,
    kept: &'a Kept,
    seed: u64,
    wall_s: f64,
}

impl Facts<'_> {
    fn simulated_s(&self) -> f64 {
        self.report.trace.rows.len() as f64 * self.report.period_s
    }

    fn json(&self, arguments: &Arguments) -> Value {
        json!({
            "rig": self.rig.rig.name,
            "mode": self.rig.rig.command_mode,
            "seed": self.seed,
            "simulated_s": self.simulated_s(),
            "wall_s": self.wall_s,
            "state": self.report.state.map(|state| format!("{state:?}")),
            "cause": self.report.cause.map(|cause| cause.fault.row().name),
            "cause_stage": self.report.cause.map(|cause| format!("{:?}", cause.fault.row().stage).to_lowercase()),
            "cause_devices": self.report.cause.map(|cause| devices_text(cause.devices, &bus_names(self.rig))),
            "margins": self.margins.to_json(),
            "watchdogs": watchdogs_json(&self.drilled),
            "bus_loads": self.report.bus_loads.iter().cloned().collect::<BTreeMap<_, _>>(),
            "held_s": self.report.held_s,
            "measures": self.report.measures,
            "figure": arguments.figure,
            "candump": arguments.candump,
            "recording": arguments.record,
            "recorded": self.kept.files_json(),
            "black_boxes": self.kept.black_boxes_json(),
        })
    }

    fn text(&self, arguments: &Arguments) -> String {
        let mut lines = Vec::new();
        let period_ms = self.report.period_s * 1e3;
        let simulated = self.simulated_s();
        let mode = mode_text(self.rig.rig.command_mode);
        lines.push(format!("rig       {}: {mode}, {period_ms} ms", self.rig.rig.name));
        lines.push(format!(
            "scene     {}: {simulated:.1} s, seed {}, run in {:.2} s ({:.0} x real time)",
            self.rig.scene,
            self.seed,
            self.wall_s,
            simulated / self.wall_s
        ));
        for (at, line) in self.margins.lines().into_iter().enumerate() {
            lines.push(format!("{:9} {line}", if at == 0 { "margins" } else { "" }));
        }
        lines.push(watchdogs_text(&self.drilled));
        let trace = &self.report.trace;
        let fixture = &self.rig.fixture;
        let contrast = fixture.law.filter(|law| law.guidance().is_some());
        if let Some(law) = contrast {
            lines.push(format!("fixture   {}, F {} N, R {} N", law.name(), trace.friction_n, trace.yield_n));
        } else if let config::Coupling::Admittance { mass_kg } = fixture.coupling {
            let capture = prediction::capture_speed_m_per_s(trace.yield_n, mass_kg.get(), self.report.period_s);
            let outward = trace.side_yield.map_or(String::new(), |side| format!(", {} N outward", side.yield_n));
            let hold = match fixture.automatic_hold {
                Some(hold) => format!("automatic hold for hands up to {} kg", *hold.hand_mass_kg),
                None => format!("N_wait {}", trace.hold_steps),
            };
            lines.push(format!(
                "fixture   M {} kg, F {} N, R {} N{outward}, {hold}; without a hold it catches impacts up to {:.0} mm/s",
                mass_kg.get(),
                trace.friction_n,
                trace.yield_n,
                1e3 * capture
            ));
        }
        lines.extend(measures_text(&self.report.measures));
        if let Some(counters) = self.report.bus {
            let loads = &self.report.bus_loads;
            let load = |(name, load): &(String, f64)| {
                let of = if loads.len() > 1 { format!(" of {name}") } else { String::new() };
                format!(", load{of} {:.1} %", 100.0 * load)
            };
            lines.push(format!("bus       {} frames{}", counters.frames, loads.iter().map(load).collect::<String>()));
        }
        lines.extend(arguments.figure.as_ref().map(|path| format!("figure    {}", path.display())));
        if let (Some(path), Some(start_s)) = (&arguments.candump, self.report.started_at_s) {
            let start_s = start_s + LOG_STARTS_AT.as_secs_f64();
            let buses = self.rig.buses.keys().zip(simulated_interfaces(self.rig));
            let named = match self.rig.buses.len() {
                1 => String::new(),
                _ => buses.map(|(name, interface)| format!(", {interface} is {name}")).collect(),
            };
            lines.push(format!("candump   {}; time 0 of the scene is {start_s:.3} in it{named}", path.display()));
        }
        lines.extend(self.kept.lines());
        if self.report.held_s > 0.0 {
            let by =
                self.report.cause.map_or(String::new(), |cause| format!(", in the end by {}", cause.fault.row().name));
            lines.push(format!("held      {:.3} s at rest by a fault{by}", self.report.held_s));
        }
        lines.join("\n")
    }
}

/// Refuses drives that would go on when their master has died.
pub(super) fn judge(drilled: &Drilled, rig: &config::Rig) -> Result<(), Failure> {
    let is_torque = rig.rig.command_mode == config::CommandMode::Torque;
    let help = "nothing was enabled; give the drive this watchdog, or a shorter cycle or heartbeat; in position mode the \
                drive may take longer";
    drilled.judge(is_torque).map_err(|error| Failure::new(Exit::OutOfTolerance, error.to_string(), help))
}

/// How soon the drives stop by themselves, the slower one.
pub(super) fn watchdogs_text(drilled: &Drilled) -> String {
    let after = |finding: &Finding| {
        let slowest = finding.stopped_after.iter().copied().collect::<Option<Vec<_>>>();
        let slowest = slowest.and_then(|times| times.into_iter().max());
        let time = slowest.map_or("never".to_owned(), |time| format!("{:.1} ms", 1e3 * time.as_secs_f64()));
        format!("{} {time}", finding.watchdog.name())
    };
    let findings: Vec<_> = drilled.findings.iter().map(after).collect();
    let resolution = match 1e3 * drilled.resolution.as_secs_f64() {
        0.0 => String::new(),
        ms => format!(", seen every {ms:.1} ms"),
    };
    format!("watchdogs stop the drives without {}{resolution}", findings.join(", "))
}

/// The same as data.
pub(super) fn watchdogs_json(drilled: &Drilled) -> Value {
    let ms = |time: std::time::Duration| 1e3 * time.as_secs_f64();
    let finding = |finding: &Finding| {
        json!({
            "without": finding.watchdog.name(),
            "left_stops_after_ms": finding.stopped_after[0].map(ms),
            "right_stops_after_ms": finding.stopped_after[1].map(ms),
        })
    };
    json!({
        "findings": drilled.findings.iter().map(finding).collect::<Vec<_>>(),
        "resolution_ms": ms(drilled.resolution),
    })
}

/// What a command mode is.
pub(super) fn mode_text(mode: config::CommandMode) -> &'static str {
    match mode {
        config::CommandMode::Torque => "torque mode (CST), the loop closes here",
        config::CommandMode::Velocity => "velocity mode (CSV)",
        config::CommandMode::Position => "position mode (CSP), the loop closes in the drives",
    }
}

/// What was measured, a line each.
pub(super) fn measures_text(measures: &Measures) -> Vec<String> {
    let mut lines = Vec::new();
    lines.push(impacts_text(measures));
    lines.extend(tool_text(measures));
    if let Some(share) = measures.on_surface_fraction_when_pressed {
        lines.push(format!(
            "contact   pressed below R the proxy is on the surface in {:.1} % of the time, {} unintended releases",
            100.0 * share,
            measures.unintended_releases
        ));
    }
    let scope = if measures.stop_energy_j.is_some() { "in all" } else { "at most in one go" };
    let bound = if measures.energy_bound_j.is_infinite() {
        "without a bound: a spring or a moving surface gives of its own".to_owned()
    } else {
        let keeps = if measures.is_within_bound() { "within" } else { "ABOVE" };
        format!("{keeps} the bound of {:.1} mJ", 1e3 * measures.energy_bound_j)
    };
    lines.push(format!(
        "energy    given to the hand {:.1} mJ {scope}, {bound}; taken from it {:.0} mJ",
        1e3 * measures.bounded_energy_j(),
        1e3 * measures.energy_taken_j
    ));
    if let (Some(mean), Some(most)) = (measures.force_age_mean_ms, measures.force_age_max_ms) {
        lines.push(format!("force     its sample is {mean:.2} ms old on average, {most:.2} ms at most"));
    }
    if let (Some(torque), Some(limit_s), Some(apart_s)) =
        (measures.peak_torque_n_m, measures.torque_limit_s, measures.torque_limit_apart_s)
    {
        let at_limit = match (1e3 * limit_s, 1e3 * apart_s) {
            (0.0, _) => String::new(),
            (ms, 0.0) => format!(", at the limit for {ms:.0} ms, where impacts stop the arm"),
            (ms, apart_ms) => format!(", at the limit for {ms:.0} ms, {apart_ms:.0} ms of it other than after impacts"),
        };
        lines.push(format!("torque    at most {torque:.1} N m{at_limit}"));
    }
    lines
}

/// How far the tool was from the surface, if it was on it.
pub(super) fn tool_text(measures: &Measures) -> Option<String> {
    let (tracing, whole) = (measures.tool_rms_tracing_mm?, measures.tool_rms_on_surface_mm?);
    let most = measures.tool_max_on_surface_mm?;
    Some(format!(
        "tool      off the surface by {tracing:.3} mm RMS tracing it steadily, {whole:.3} mm RMS and {most:.2} mm at \
         most in all contacts"
    ))
}

fn impacts_text(measures: &Measures) -> String {
    let Some(deepest) = measures.impacts.iter().max_by(|one, other| one.depth_mm.total_cmp(&other.depth_mm)) else {
        return "impacts   none".to_owned();
    };
    let fastest = measures.impacts.iter().map(|impact| impact.speed_m_per_s).fold(0.0, f64::max);
    let count = measures.impacts.len();
    if deepest.depth_mm == 0.0 {
        return format!(
            "impacts   {count} at up to {:.0} mm/s, the proxy never beyond the surface before R is reached",
            1e3 * fastest
        );
    }
    let law = deepest.predicted_depth_mm.map_or(String::new(), |depth| format!(", by the law {depth:.2} mm"));
    format!(
        "impacts   {count} at up to {:.0} mm/s; the deepest at {:.0} mm/s, {:.2} mm beyond the surface{law}",
        1e3 * fastest,
        1e3 * deepest.speed_m_per_s,
        deepest.depth_mm
    )
}

/// The failure of a run that gave the hand more energy than a fixture that stores none can.
pub(super) fn above_bound(measures: &Measures, what: &str) -> Failure {
    let message = format!(
        "{what} gave the hand {:.1} mJ, above the bound of {:.1} mJ: the loop of hand, fixture and arm swings",
        1e3 * measures.bounded_energy_j(),
        1e3 * measures.energy_bound_j
    );
    let help = "raise fixture.coupling's mass_kg, or look at the loop's margins with `yieldwall config check`";
    Failure::new(Exit::OutOfTolerance, message, help)
}

fn stopped(report: &RunReport, rig: &config::Rig) -> Failure {
    stopped_by(report.cause, report.trace.rows.last().map_or(0.0, |row| row.time_s), rig)
}

/// The failure of a rig that `cause` stopped so long after its scene began; without a cause its process died.
pub(super) fn stopped_by(cause: Option<Cause>, time_s: f64, rig: &config::Rig) -> Failure {
    let (exit, message, help) = match cause {
        Some(cause) => {
            let row = cause.fault.row();
            let exit = exit_of(cause);
            let at = describe(cause, &bus_names(rig));
            (exit, format!("stopped by {} ({at}): {} ({})", row.name, row.meaning, row.cause), row.next)
        }
        None => (
            Exit::SafetyStop,
            "left alone: its process died, and the drives stopped by their own watchdogs".to_owned(),
            "start the program anew",
        ),
    };
    Failure::new(exit, format!("after {time_s:.3} s the rig was {message}"), help)
}

/// The exit code of a rig that a fault stopped or kept from running.
pub(super) fn exit_of(cause: Cause) -> Exit {
    match cause.fault {
        Fault::DriveFault => Exit::DeviceFault,
        Fault::SyncJitter | Fault::Overrun | Fault::Stalled | Fault::Suspended => Exit::TimingMissed,
        Fault::DuplicateNode => Exit::DeviceMismatch,
        _ => Exit::SafetyStop,
    }
}

/// Where a fault showed: the stage, and the devices if there are any.
pub(super) fn describe(cause: Cause, buses: &[String]) -> String {
    let stage = format!("{:?}", cause.fault.row().stage).to_lowercase();
    if cause.devices.is_empty() { stage } else { format!("{stage}, {}", devices_text(cause.devices, buses)) }
}

/// The devices, interfaces by the names of their buses.
pub(super) fn devices_text(devices: DeviceSet, buses: &[String]) -> String {
    (0..).zip(buses).fold(devices.to_string(), |text, (number, bus)| {
        text.replace(&DeviceSet::interface(number).to_string(), &format!("interface of bus `{bus}`"))
    })
}

/// The names of the buses, by number.
pub(super) fn bus_names(rig: &config::Rig) -> Vec<String> {
    rig.buses.keys().cloned().collect()
}

/// The failure that a rig's error is.
pub(super) fn rig_failure(error: &RigError) -> Failure {
    let (exit, help) = match error {
        RigError::Boot(_) => {
            (Exit::DeviceMismatch, "compare node ids and profiles in the rig file with the devices on the bus")
        }
        RigError::NotEnabled { .. } => (Exit::DeviceFault, "read the drives' error codes (603Fh)"),
        RigError::Arm(_) => (Exit::SafetyStop, "the scene leads the simulated arm where it cannot go"),
        _ => (Exit::ConfigInvalid, "run `yieldwall config check` on the rig"),
    };
    Failure::new(exit, error.to_string(), help)
}

/// The failure of a drawing, with all causes that the error names.
pub(super) fn drawing_failure(error: &dyn std::error::Error) -> Failure {
    let mut message = format!("figure: {error}");
    let mut source = error.source();
    while let Some(cause) = source {
        message.push_str(&format!(": {cause}"));
        source = cause.source();
    }
    Failure::new(Exit::Usage, message, "choose a file that can be written, and a run with something to draw")
}

/// Whether a picture can have this name.
pub(super) fn check_picture(path: &Path) -> Result<(), Failure> {
    picture_kind(path).map(|_| ())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PictureKind {
    Svg,
    Png,
}

fn picture_kind(path: &Path) -> Result<PictureKind, Failure> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("svg") => Ok(PictureKind::Svg),
        Some("png") => Ok(PictureKind::Png),
        _ => {
            let ending = ending.map_or("no ending".to_owned(), |ending| format!("the ending .{ending}"));
            let message = format!("--figure {} has {ending}: only .svg and .png are drawn", path.display());
            Err(Failure::new(Exit::Usage, message, "end the name in .svg or .png"))
        }
    }
}

/// Writes a drawing as its file's ending says, and makes the folders on the way.
pub(super) fn write_drawing(drawing: &Drawing, path: &Path) -> Result<(), Failure> {
    make_folder_of(path)?;
    let written = match picture_kind(path)? {
        PictureKind::Svg => drawing.write_svg(path),
        PictureKind::Png => drawing.write_png(path, PICTURE_WIDTH_PX),
    };
    written.map_err(|error| drawing_failure(&error))
}

pub(super) fn make_folder_of(path: &Path) -> Result<(), Failure> {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => std::fs::create_dir_all(folder).map_err(|error| {
            Failure::new(
                Exit::Usage,
                format!("folder {}: {error}", folder.display()),
                "choose a folder you can write to",
            )
        }),
        _ => Ok(()),
    }
}
