//! `yieldwall run`: a rig or an impedance device with its scene on the embedded simulation, and the arguments of both kinds of run.

mod device;
mod facts;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use self::facts::Facts;
use super::bus::check_buses;
use super::desk::plan::{self, Sender};
use super::ending::{self, above_bound, rig_failure};
use super::events::{Events, Listening, Stream};
use super::failure::{Exit, Failure};
use super::faults::FaultArgument;
use super::interrupt::{interrupted, on_interrupt, unless};
use super::keep::{Keep, described};
use super::margins::{Margins, has_other_inertia};
use super::masses::{Masses, advice};
use super::on_bus::{standing, told_at_boot, with_findings, with_told};
use super::output::Output;
use super::page::{Pace, Page, PageOf, ViewArgument};
use super::picture::{check_picture, drawing_failure, write_drawing};
use super::progress::Progress;
use super::replace::{Replace, Written};
use super::report_text::run_verdict;
use super::tui::{Screen, View, check_terminal};
use super::unsafe_drives::{NOTHING_ENABLED, judge};
use yieldwall_config::injection::{Injection, Kind, Lasts};
use yieldwall_config::{self as config, Diagnostic, Document, Loaded, Severity, Source};
use yieldwall_record::Trace;
use yieldwall_rig::report::{Overrides, RunReport, Shortcoming, replay, run_rig};
use yieldwall_rig::{self as rig, RigError};
use yieldwall_run::recorder::{Wanted, Watched};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig or impedance device; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    pub(super) rig: String,
    /// Run on this interface, not on the embedded simulation; for a rig with several buses once for each, as NAME=INTERFACE
    ///
    /// `yieldwall sim` provides a simulated rig for a first try.
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "INTERFACE", conflicts_with_all = ["seed", "fault"])]
    pub(super) bus: Vec<String>,
    /// Event that starts a cycle: the wall clock, or the process data (only with simulated devices in lockstep)
    #[cfg(target_os = "linux")]
    #[arg(long, value_enum, default_value_t = super::pace::PaceArgument::Free, requires = "bus")]
    pub(super) pace: super::pace::PaceArgument,
    /// Fail, instead of warning, if this computer grants no real-time priority or no locked memory
    #[cfg(target_os = "linux")]
    #[arg(long, requires = "bus")]
    pub(super) require_realtime: bool,
    /// Run by the wall clock even if this computer has not proved the required timing
    ///
    /// Recordings note this option.
    #[cfg(target_os = "linux")]
    #[arg(long, requires = "bus")]
    pub(super) ignore_latency: bool,
    /// Set a value of the rig, its simulation or, with the prefix `scene.`, its scene for this run; repeatable
    ///
    /// A drive has its name as key: --set drives.left.direction=-1. A value is YAML: --set 'fixture.law={ellipse: {}}'.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(super) set: Vec<config::SetValue>,
    /// Seconds to run; default: the scene's duration
    #[arg(long, value_name = "S", value_parser = super::usage::seconds, allow_negative_numbers = true)]
    pub(super) duration: Option<f64>,
    /// Seed of tremor and sensor noise; default: the scene's seed
    #[arg(long, value_name = "N", value_parser = super::usage::whole::<u64>, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Inject a fault during the run; repeatable, besides the scene's faults
    ///
    /// `yieldwall faults` lists names. TARGET is a device name from the rig, or a target that `yieldwall faults NAME` lists.
    #[arg(long, value_name = "NAME@TIME[+DURATION][:TARGET]")]
    fault: Vec<FaultArgument>,
    /// Draw trajectory, force and power into this .svg or .png file; missing folders are created
    #[arg(long, value_name = "PATH")]
    pub(super) figure: Option<PathBuf>,
    /// Write every CAN frame to this file, in the format of candump -L
    #[arg(long, value_name = "FILE")]
    pub(super) candump: Option<PathBuf>,
    /// Write every frame of all buses, CAN and EtherCAT, to this file, for Wireshark
    #[arg(long, value_name = "FILE")]
    pub(super) pcapng: Option<PathBuf>,
    /// Run even if the bus cannot keep the cycle; `yieldwall bus budget` shows which frame is late
    #[arg(long)]
    pub(super) ignore_bus_budget: bool,
    /// Record every cycle and every frame into this new folder
    ///
    /// The folder holds cycles.mcap, cycles.csv, bus.pcapng and, for CAN, bus.log. An impedance device has no bus: its samples are
    /// recorded. Existing recordings are never overwritten.
    #[arg(long, value_name = "DIR")]
    pub(super) record: Option<PathBuf>,
    /// Print what boot and start would send to each device, old -> new; only read objects
    #[arg(long, conflicts_with_all = ["fault", "figure", "candump", "pcapng", "record", "black_box", "view"])]
    pub(super) dry_run: bool,
    #[command(flatten)]
    pub(super) replace: Replace,
    #[command(flatten)]
    pub(super) stream: Stream,
    /// Show axes, force, lateness and events on the whole terminal; a key stops the rig
    ///
    /// The simulation then follows the wall clock.
    #[arg(long, conflicts_with_all = ["jsonl", "json", "quiet", "verbose", "view"])]
    pub(super) tui: bool,
    #[command(flatten)]
    pub(super) page: ViewArgument,
    /// Folder for the recordings around a fault; default: the folder of --record, or yieldwall/black-box in the state folder
    #[arg(long, value_name = "DIR")]
    pub(super) black_box: Option<PathBuf>,
}

impl Arguments {
    /// Returns the document of the rig, with the values that are set over it.
    pub(super) fn source(&self) -> Result<Source, Failure> {
        let source = Source::named(&self.rig).with_values(&self.set);
        source.map_err(|error| Failure::new(Exit::Usage, format!("--set: {error}"), "set each key once"))
    }

    /// Returns the files of a run.
    pub(super) fn wanted(&self) -> Wanted<'_> {
        let [candump, pcapng, record, black_box] =
            [&self.candump, &self.pcapng, &self.record, &self.black_box].map(Option::as_deref);
        Wanted { candump, pcapng, record, black_box }
    }
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let (events, mut page) = (Events::of(output), Page::default());
    let end = run_and_tell(arguments, &events, &mut page, output);
    events.end(&end);
    page.end(&end);
    end
}

fn run_and_tell(arguments: &Arguments, events: &Events, page: &mut Page, output: &mut Output) -> Result<(), Failure> {
    check(arguments)?;
    let source = arguments.source()?;
    let rig = match config::load(source.clone())? {
        Document::Rig(rig) => *rig,
        Document::Device(_) if arguments.dry_run => {
            let message = "an impedance device is on no bus: nothing is written to any device";
            return Err(Failure::new(Exit::Usage, message, "leave out --dry-run, or name a rig"));
        }
        Document::Device(device) => return device::run(arguments, &device, output),
        // The error names the kind of the document.
        Document::Scene(_)
        | Document::Figure(_)
        | Document::Profile(_)
        | Document::Simulation(_)
        | Document::ErrorCodes(_) => config::load_rig(source)?,
    };
    // The warnings of the scene are among them.
    output.configuration(&rig.warnings)?;
    check_buses(&rig, Some(arguments.ignore_bus_budget), output)?;
    let margins = check_loop(&rig, true, output)?;
    check_candump(arguments, &rig)?;
    if arguments.dry_run {
        return plan::run(&rig, &[], Sender::Run, output);
    }
    let scene = rig.scene()?;
    let faults = arguments.fault.iter().map(|fault| fault.of_rig(&rig.value)).collect::<Result<_, _>>()?;
    let overrides = Overrides { fixture: None, duration_s: arguments.duration, seed: arguments.seed, faults };
    let duration_s = overrides.duration_s.unwrap_or(scene.value.duration_s.get());
    overrides.faults.iter().try_for_each(|injection| check_start(injection, duration_s))?;
    let about = described(replay::about(&rig.value, Some(&scene.value), &overrides))?;
    // Before anything is written: a rig that is refused leaves no record.
    let drilled = rig::drill(&rig.value, &scene.value, |_| ()).map_err(|error| rig_failure(&error))?;
    judge(&drilled, &rig.value, NOTHING_ENABLED)?;
    page.open(&arguments.page, &rig.value, PageOf { command: "run", pace: Pace::Virtual })?;
    let interfaces = simulated_interfaces(&rig.value);
    let watched = Watched::Simulation(&interfaces);
    let view = arguments.tui.then(|| view(&rig.value, "on the embedded simulation", duration_s));
    view.iter().for_each(|view| events.show_on(view));
    let (listening, heard) = Listening::start(events, watched, &rig.value)?;
    let (keep, watch) = Keep::start(watched, &rig.value, &about, &arguments.wanted())?;
    let watch = watch.and(heard).and(page.watch());
    let is_looked_at = arguments.tui || page.is_open();
    let progress = if arguments.tui { Progress::hidden() } else { Progress::new(output) };
    progress.begin(&rig.value.rig.name);
    let is_interrupted = on_interrupt()?;
    let screen = view.map(|view| Screen::start(&view, &is_interrupted, None)).transpose()?;
    let mut onward = ControlFlow::Continue(());
    let started = Instant::now();
    let report = run_rig(&rig.value, &scene.value, &overrides, watch, |stage| {
        progress.at(stage);
        if is_looked_at {
            // Nobody can look at a scene that is over in a blink.
            std::thread::sleep(Duration::from_secs_f64(stage.time_s.max(0.0)).saturating_sub(started.elapsed()));
        }
        onward = unless(&is_interrupted);
        onward
    });
    let wall_s = started.elapsed().as_secs_f64();
    progress.end();
    listening.finish()?;
    drop(screen);
    // An interrupted run leaves the part that it has recorded.
    let kept = keep.finish()?;
    output.warnings(&kept.warnings());
    let report = report.map_err(|error| {
        kept.point_to_black_box(not_run(&error, arguments, &overrides.faults, &rig.value, &scene.value))
    })?;
    let drawn = draw(&report.trace, arguments.figure.as_deref());
    let figure = arguments.figure.as_deref().filter(|_| drawn.is_ok());
    let seed = overrides.seed.unwrap_or(scene.value.seed);
    let facts = Facts { rig: &rig.value, drilled, margins, report: &report, kept: &kept, figure, seed, wall_s };
    let end = match onward {
        ControlFlow::Break(()) => Err(interrupted(report.simulated_s())),
        ControlFlow::Continue(()) => judge_run(&report, &rig.value, &scene.value, &overrides.faults)
            .map_err(|failure| if report.is_stopped() { kept.point_to_black_box(failure) } else { failure }),
    };
    let end = with_files(end, [drawn, kept.is_written()]);
    events.end(&end);
    if !output.is_json() {
        let stopped_by = report.cause.filter(|_| report.is_stopped()).map(|cause| (cause, &rig.value));
        let stopped_at_s = report.trace.rows.last().filter(|_| stopped_by.is_some()).map(|row| row.time_s);
        let time_s = stopped_at_s.unwrap_or(report.simulated_s());
        let verdict = run_verdict(&end, (time_s, stopped_by), &report.measures);
        output.news(&format!("{verdict}\n{}", facts.text(arguments)))?;
        return end;
    }
    output.end(facts.json(arguments), end)
}

/// Refuses an injection that would begin after the end of the run.
fn check_start(injection: &Injection, duration_s: f64) -> Result<(), Failure> {
    let (row, start_s) = (injection.kind.row(), injection.start_s);
    if row.lasts == Lasts::FromBoot || start_s < duration_s {
        return Ok(());
    }
    let message = format!("--fault {}@{start_s}: the run ends at {duration_s} s", row.name);
    let help = match start_s.floor() + 1.0 {
        longer_s if longer_s <= config::MAX_DURATION_S => format!("begin earlier, or add --duration {longer_s}"),
        _ => "begin earlier".to_owned(),
    };
    Err(Failure::new(Exit::Usage, message, help))
}

/// Refuses a log of CAN frames of a rig that has no CAN.
pub(super) fn check_candump(arguments: &Arguments, rig: &Loaded<config::Rig>) -> Result<(), Failure> {
    let segment = rig.value.buses.keys().next();
    let (Some(_), false, Some(bus)) = (&arguments.candump, rig.value.is_on_can(), segment) else { return Ok(()) };
    let message = "--candump is for frames of CAN, and this rig has no bus but EtherCAT";
    let help = "--pcapng FILE writes the frames of every bus";
    let finding = rig.finding(Severity::Error, &format!("buses.{bus}"), message, help, &[]);
    Err(Failure { exit: Exit::Usage, report: finding.into() })
}

/// Returns the failure of a simulated rig that did not run.
fn not_run(
    error: &RigError,
    arguments: &Arguments,
    of_arguments: &[Injection],
    rig: &config::Rig,
    scene: &config::Scene,
) -> Failure {
    let failure = rig_failure(error);
    let RigError::Boot(boot) = error else { return failure };
    let failure = with_told(failure, &told_at_boot(boot, &[], rig), &[], rig);
    let of_scene = scene.faults.iter().filter_map(|fault| fault.injection().ok());
    let mut injected = of_scene.chain(of_arguments.iter().copied());
    // `doctor` knows these by the same names.
    let same = injected.find(|injection| matches!(injection.kind, Kind::WrongBitRate | Kind::WrongNodeId));
    let fault = same.map_or(String::new(), |injection| format!(" --fault {}", injection.kind.row().name));
    ending::point_to_node(failure, boot, rig, &format!(" --rig {}{fault}", arguments.rig))
}

/// Judges whether a run ended as it should, except for injected faults.
pub(super) fn judge_run(
    report: &RunReport,
    rig: &config::Rig,
    scene: &config::Scene,
    of_arguments: &[Injection],
) -> Result<(), Failure> {
    let Some(shortcoming) = report.shortcoming(scene, of_arguments) else { return Ok(()) };
    let simulated_s = report.simulated_s();
    Err(match shortcoming {
        Shortcoming::Stopped => {
            let stopped = with_findings(ending::stopped(report, rig), &report.segment);
            with_told(stopped, &standing(&report.emergencies, report.cause), &report.errors, rig)
        }
        Shortcoming::EndedHeld(fault) => ending::ended_held(fault),
        Shortcoming::HeldLong { fault, held_s } => ending::held_too_long(fault, held_s, simulated_s),
        Shortcoming::NeverCame(injection) => ending::never_came(&injection, simulated_s),
        Shortcoming::AtLimit { at_limit_s } => ending::at_limit_too_long(at_limit_s, simulated_s),
        Shortcoming::AboveBound => above_bound(&report.measures, &rig.rig.name, &advice(rig, scene)),
    })
}

/// Draws a run into a file, if one is requested.
pub(super) fn draw(trace: &Trace, figure: Option<&Path>) -> Result<(), Failure> {
    let Some(path) = figure else { return Ok(()) };
    let drawing = yieldwall_figures::run(trace, String::new()).map_err(|error| drawing_failure(&error))?;
    write_drawing(&drawing, path)
}

/// Combines a run's end with files that may not have been written. The error on a file is printed after the run's failure, whose
/// exit code counts.
pub(super) fn with_files(end: Result<(), Failure>, files: [Result<(), Failure>; 2]) -> Result<(), Failure> {
    files.into_iter().fold(end, |end, file| match (end, file) {
        (Err(mut failure), Err(unwritten)) => {
            failure.report.diagnostics.extend(unwritten.report.diagnostics);
            Err(failure)
        }
        (end, file) => end.and(file),
    })
}

/// Checks whether a run can have this duration.
pub(super) fn check_duration(duration_s: Option<f64>) -> Result<(), Failure> {
    let most = config::MAX_DURATION_S;
    let Some(duration) = duration_s.filter(|duration| !(*duration > 0.0 && *duration <= most)) else { return Ok(()) };
    let message = format!("--duration is {duration}: a run lasts more than 0 and at most {most} simulated seconds");
    Err(Failure::new(Exit::Usage, message, "give a number of seconds, such as --duration 5"))
}

/// Reports errors that are detectable before a run.
pub(super) fn check(arguments: &Arguments) -> Result<(), Failure> {
    check_duration(arguments.duration)?;
    if arguments.tui {
        check_terminal()?;
    }
    if let Some(path) = &arguments.figure {
        check_picture(path, arguments.replace)?;
    }
    let files = [(&arguments.candump, Written::BusLog), (&arguments.pcapng, Written::Capture)];
    let mut files = files.into_iter().filter_map(|(path, what)| Some((path.as_ref()?, what)));
    files.try_for_each(|(path, what)| arguments.replace.check(path, what))
}

/// Returns a rig's data for a screen.
pub(super) fn view(rig: &config::Rig, place: &str, duration_s: f64) -> Arc<Mutex<View>> {
    let names = rig.drives.each_ref().map(|drive| drive.name.as_str());
    Arc::new(Mutex::new(View::new(&rig.rig.name, names, place, duration_s)))
}

/// Checks that the rig's own loop is stable with enough margin, also with the hand of its scene if that is on the tool. Returns its
/// margins.
pub(super) fn check_loop(rig: &Loaded<config::Rig>, has_hand: bool, output: &mut Output) -> Result<Margins, Failure> {
    let is_known = !(has_hand && has_other_inertia(rig));
    let margins = Margins::of(&rig.value);
    let masses = (has_hand && is_known && !margins.is_unstable()).then(|| Masses::of_scene(rig).ok()).flatten();
    let of_loop = is_known.then(|| margins.finding(rig)).flatten();
    let findings: Vec<Diagnostic> = of_loop.into_iter().chain(masses.and_then(|masses| masses.finding(rig))).collect();
    output.configuration(&findings)?;
    Ok(margins)
}

/// Returns the names of the embedded simulation's buses in logs, so that `canplayer` finds them.
pub(super) fn simulated_interfaces(rig: &config::Rig) -> Vec<String> {
    (0..rig.buses.len()).map(|number| format!("vcan{number}")).collect()
}
