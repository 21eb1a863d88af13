//! `yieldwall run --bus`: a rig with its scene on a real bus.

mod emergencies;
mod facts;
mod news;
mod proof;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc;
use std::thread;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::failure::{Exit, Failure};
use super::interfaces::Interfaces;
use super::keep::{Keep, Watched};
use super::output::Output;
use super::run::{Arguments, check_buses, exit_of, rig_failure, stopped_by, write_drawing};
use crate::assembly::bus_plan;
use crate::bus::{Heard, SensorLink, Sign};
use crate::canopen::{Emergency, cob};
use crate::config::{self, Source};
use crate::guard::Fault;
use crate::host::system::{Refusal, SystemMetronome, lock_memory, run_first};
use crate::host::{Kept as Timely, StageTimes, Untimely};
use crate::link::{CobFilter, LinkError, Role, SocketCan, SocketCans};
use crate::record::Row;
use crate::run::{Ended, LinkCounts, OnLink, Pace, Play, Played, RunError, Runner};
use crate::study::{Overrides, drawing, measured, replay};
pub(super) use emergencies::{different, with_emergencies};
use facts::Facts;
pub(super) use news::{News, boot_watch, print_news};
use proof::{Demanded, NotRun, proof, unproven, untimely};

/// Cycles of which figure and measures are made, from the first one on: ten minutes at 1 kHz. A recording holds all.
const LONGEST_TRACE: u64 = 600_000;

/// What the loop or the devices wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum PaceArgument {
    /// The clock on the wall
    Free,
    /// Each other: time advances by one period per SYNC, on a computer of any speed
    Lockstep,
}

impl PaceArgument {
    pub(super) fn pace(self) -> Pace {
        match self {
            PaceArgument::Free => Pace::Free,
            PaceArgument::Lockstep => Pace::Lockstep,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            PaceArgument::Free => "by the wall clock",
            PaceArgument::Lockstep => "in lockstep",
        }
    }
}

/// Set by Ctrl-C, by the wish of a service manager that the program ends, and by a terminal that goes away, unless the program
/// was started to outlive it (`nohup`).
pub(super) fn on_interrupt() -> Result<Arc<AtomicBool>, Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    // Where the system does not tell, a terminal that goes away stops the rig.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let hangup = Some(SIGHUP).filter(|signal| !is_ignored(*signal, &status));
    for signal in [SIGINT, SIGTERM].into_iter().chain(hangup) {
        signal_hook::flag::register(signal, Arc::clone(&flag))
            .map_err(|error| Failure::new(Exit::Internal, format!("signal {signal}: {error}"), ""))?;
    }
    Ok(flag)
}

/// Whether a process with this `/proc/PID/status` ignores a signal.
fn is_ignored(signal: i32, status: &str) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or_default();
    mask >> (signal - 1) & 1 == 1
}

/// The failure that an interface is which cannot be used.
pub(super) fn link_failure(error: &LinkError) -> Failure {
    Failure::new(Exit::BusUnavailable, error.to_string(), "")
}

/// The links of the only master of this computer, on each bus process data apart from the rest.
pub(super) fn open(interfaces: &Interfaces, rig: &config::Rig) -> Result<SocketCans, Failure> {
    let setup = bus_plan(rig).map_err(|error| rig_failure(&error.into()))?.0;
    let roles = |_| vec![Role::Master];
    interfaces.open(rig, roles, |bus| {
        let mut process = vec![CobFilter::only(cob::SYNC)];
        let mut nodes: Vec<u8> =
            setup.drives.iter().filter(|drive| drive.bus == bus).map(|drive| drive.node_id).collect();
        match &setup.sensor.link {
            _ if setup.sensor.bus != bus => {}
            SensorLink::Canopen(sensor) => nodes.push(sensor.node_id),
            SensorLink::PlainCan(sensor) => {
                let [first, second] = sensor.protocol.data_ids();
                process.extend([first, second, sensor.protocol.order_id()].map(CobFilter::only));
            }
        }
        let mut services = vec![CobFilter::only(cob::NMT), CobFilter::matching(0x700, 0x780)];
        for node in nodes.into_iter().filter_map(|node| cob::node_id(node).ok()) {
            let pdos = (1..=4).flat_map(|number| [cob::tpdo(number, node), cob::rpdo(number, node)]);
            process.extend(pdos.flatten().map(CobFilter::only));
            let answers = [cob::emcy(node), cob::sdo_request(node), cob::sdo_response(node)];
            services.extend(answers.map(CobFilter::only));
        }
        (process, services)
    })
}

/// What the loop leaves.
struct Outcome {
    /// What this computer has proved; nothing where nothing has to be in time.
    timing: Option<Result<Timely, Untimely>>,
    played: Result<Played, NotRun>,
    rows: Vec<Row>,
    stages: StageTimes,
    skipped: u64,
    counts: LinkCounts,
    priority: Result<(), Refusal>,
    /// What the devices told of themselves, the latest last.
    emergencies: Vec<Emergency>,
    /// Faults that held nothing, each with the number of cycles in which it was seen.
    counted: Vec<(Fault, u32)>,
    /// SDO downloads of somebody else to the rig's nodes.
    foreign_downloads: u32,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.warnings(&rig.warnings);
    let scene = config::load_scene(rig.source.relative(&rig.value.scene))?;
    check_buses(&rig, arguments.ignore_bus_budget, output)?;
    let overrides = Overrides { duration_s: arguments.duration, ..Overrides::default() };
    let file = rig;
    let rig = file.value.clone();
    let demanded = proof(arguments.pace, &rig, &scene.value)?;
    let is_interrupted = on_interrupt()?;
    let memory = lock_memory();
    refuse(arguments, &memory)?;
    let interfaces = Interfaces::of(&rig, &arguments.bus)?;
    let link = open(&interfaces, &rig)?;
    for facts in link.links().iter().map(SocketCan::facts) {
        facts.advice().into_iter().for_each(|advice| warn(output, advice));
        // In lockstep nothing has to be in time.
        if arguments.pace == PaceArgument::Free
            && let Some((why, help)) = facts.attachment.too_slow_for(rig.cycle.period_us)
        {
            let message = format!("`{}` {why}", facts.name);
            output.warnings(&[file.finding(config::Severity::Warning, "cycle.period_us", message, help, &[])]);
        }
    }
    warn_of(output, &memory);
    let mut about = replay::about(&rig, &scene.value, &overrides)
        .map_err(|error| Failure::new(Exit::Internal, format!("documents of the recording: {error}"), ""))?;
    if arguments.ignore_latency {
        about.overrides = format!("{} --ignore-latency", about.overrides).trim().to_owned();
    }
    let mut machine =
        Runner::on_link(&rig, link, SystemMetronome, arguments.pace.pace()).map_err(|error| live_failure(&error))?;
    let [candump, record, black_box] =
        [&arguments.candump, &arguments.record, &arguments.black_box].map(Option::as_deref);
    let watched = match arguments.pace {
        PaceArgument::Free => Watched::Interfaces(interfaces.names()),
        PaceArgument::Lockstep => Watched::Lockstep(interfaces.names()),
    };
    let (keep, watch) = Keep::start(watched, &rig, &about, candump, record, black_box)?;
    watch.tap.into_iter().for_each(|tap| machine.set_tap(tap));
    watch.observer.into_iter().for_each(|observer| machine.set_observer(observer));
    let period_s = machine.period().as_secs_f64();
    let duration_s = arguments.duration.unwrap_or(scene.value.duration_s.get());
    let play = Play::on_bus(&rig, duration_s);
    let demands = Demands {
        is_first: arguments.require_realtime,
        is_timely: !arguments.ignore_latency,
        has_locked_memory: memory.is_ok(),
    };
    let (news, told) = mpsc::channel();
    machine.set_boot_watch(boot_watch(news.clone(), Arc::clone(&is_interrupted)));
    let thread = thread::Builder::new().name("cycle".to_owned()).spawn({
        let (is_interrupted, rig) = (Arc::clone(&is_interrupted), rig.clone());
        move || {
            let priority = run_first();
            // Nobody listens if the thread that waits has died.
            let _ = priority.as_ref().map_err(|refusal| news.send(News::Refused(refusal.to_string())));
            run_loop(machine, &play, &is_interrupted, demands, &rig, &demanded, priority)
        }
    });
    let thread = thread.map_err(|error| Failure::new(Exit::Internal, format!("thread of the cycle: {error}"), ""))?;
    print_news(&told, arguments.require_realtime, output);
    let mut outcome =
        thread.join().map_err(|_| Failure::new(Exit::Internal, "the thread of the cycle has panicked", ""))?;
    let kept = keep.finish()?;
    output.warnings(&kept.warnings());
    refuse(arguments, &outcome.priority)?;
    let played = match &outcome.played {
        Ok(played) => *played,
        Err(NotRun::Run(error)) => {
            let failure = with_emergencies(live_failure(error), &outcome.emergencies, &rig);
            return Err(kept.point_to_black_box(failure));
        }
        Err(NotRun::Unproven(error)) => return Err(unproven(error, &interfaces.arguments(&rig), arguments)),
        Err(NotRun::Untimely(error)) => return Err(untimely(error, &rig)),
    };
    let time_s = played.cycles as f64 * period_s;
    let failure = match played.ended {
        Ended::Whole => None,
        Ended::Interrupted => {
            Some(Failure::new(Exit::Interrupted, format!("interrupted after {time_s:.3} s; the rig was stopped"), ""))
        }
        Ended::Stopped => Some(with_emergencies(stopped_by(played.cause, time_s, &rig), &outcome.emergencies, &rig)),
        Ended::StillMoving => Some(Failure::new(
            Exit::SafetyStop,
            "a drive says that it still makes torque after the rig was stopped",
            "look at the drive, and use the emergency stop if it moves",
        )),
        Ended::Panicked => Some(Failure::new(
            Exit::Internal,
            format!("after {time_s:.3} s the cycle panicked ({})", Fault::CyclePanicked.row().meaning),
            "a quick stop was sent; please report what was printed above",
        )),
    };
    let (trace, measures) = measured(&rig, &rig.fixture, std::mem::take(&mut outcome.rows));
    if let Some(path) = &arguments.figure {
        let drawing =
            drawing::run(&trace, Some(rig.rig.name.clone())).map_err(|error| super::run::drawing_failure(&error))?;
        write_drawing(&drawing, path)?;
    }
    let facts = Facts {
        interfaces: &interfaces,
        arguments,
        rig: &rig,
        outcome: &outcome,
        played: &played,
        memory: &memory,
        measures: &measures,
        kept: &kept,
    };
    let end = failure.map_or(Ok(()), |failure| Err(kept.point_to_black_box(failure)));
    if !output.is_json() {
        output.news(&facts.lines(time_s).join("\n"))?;
        return end;
    }
    output.end(facts.json(time_s), end)
}

/// What the person wants of this computer.
#[derive(Clone, Copy)]
struct Demands {
    /// Real-time priority.
    is_first: bool,
    /// The timing that the rig asks for, as proved.
    is_timely: bool,
    /// Not a demand: what was granted.
    has_locked_memory: bool,
}

/// On the thread of the cycle, from the boot to the end.
fn run_loop(
    mut machine: Runner<OnLink<SocketCans, SystemMetronome>>,
    play: &Play,
    is_interrupted: &AtomicBool,
    demands: Demands,
    rig: &config::Rig,
    demanded: &Demanded,
    priority: Result<(), Refusal>,
) -> Outcome {
    let timing = demanded.timing(rig, priority.is_ok(), demands.has_locked_memory);
    let mut outcome = Outcome {
        timing,
        played: Err(RunError::Interrupted.into()),
        rows: Vec::with_capacity(play.cycles.min(LONGEST_TRACE) as usize),
        stages: StageTimes::default(),
        skipped: 0,
        counts: LinkCounts::default(),
        priority,
        emergencies: Vec::new(),
        counted: Vec::new(),
        foreign_downloads: 0,
    };
    if demands.is_first && outcome.priority.is_err() {
        return outcome;
    }
    if demands.is_timely
        && let Some(Err(error)) = &outcome.timing
    {
        outcome.played = Err(error.clone().into());
        return outcome;
    }
    let Outcome { rows, stages, skipped, .. } = &mut outcome;
    let booted = machine.boot().map_err(NotRun::from);
    let permit = booted.and_then(|()| Ok(machine.prove(rig, &demanded.proof)?));
    let played = permit.and_then(|permit| {
        Ok(machine.play(play, &permit, is_interrupted, |record| {
            stages.add(&record.moment.stages, &record.inputs.timing);
            *skipped += u64::from(record.inputs.timing.skipped);
            // Without room the cycle would have to wait for memory.
            if rows.len() < rows.capacity() {
                rows.push(record.row());
            }
        })?)
    });
    machine.leave();
    (outcome.played, outcome.counts) = (played, machine.counts());
    outcome.counted = machine.master().cycle().faults().counted().collect();
    outcome.foreign_downloads = machine.master().foreign_downloads();
    outcome.emergencies = different(machine.master().emergencies().map(|(_, emergency)| emergency));
    outcome
}

/// Prints what a person should know before anything is sent.
pub(super) fn warn(output: &mut Output, message: String) {
    let finding = config::Diagnostic::about_file("", message, "");
    output.warnings(&[config::Diagnostic { severity: config::Severity::Warning, ..finding }]);
}

/// Prints what this computer did not grant.
pub(super) fn warn_of(output: &mut Output, granted: &Result<(), Refusal>) {
    if let Err(refusal) = granted {
        warn(output, refusal.to_string());
    }
}

/// With `--require-realtime` what was not granted is an error.
fn refuse(arguments: &Arguments, granted: &Result<(), Refusal>) -> Result<(), Failure> {
    match granted {
        Err(refusal) if arguments.require_realtime => Err(Failure::new(
            Exit::TimingMissed,
            refusal.to_string(),
            "nothing was sent; leave --require-realtime away to run without",
        )),
        _ => Ok(()),
    }
}

/// The failure that another master is.
pub(super) fn other_master(message: String, heard: &Heard) -> Failure {
    let help = match heard.sign {
        Sign::Master { .. } => {
            "end the other master, or give this rig's master a node id of its own (`master.node_id`) if it is a device"
        }
        _ => "end the other master, or run this one on a bus of its own; `candump` shows what is on a bus",
    };
    Failure::new(Exit::BusUnavailable, message, help)
}

/// The failure that an error of the loop is.
pub(super) fn live_failure(error: &RunError) -> Failure {
    match error {
        RunError::Assembly(error) => rig_failure(&error.clone().into()),
        RunError::Boot(error) => rig_failure(&error.clone().into()),
        RunError::OtherMaster { heard, .. } => other_master(error.to_string(), heard),
        RunError::Send { .. } => Failure::new(
            Exit::BusUnavailable,
            error.to_string(),
            "nobody acknowledges: look whether a device is switched on, at the cable, its termination and the bit rate",
        ),
        RunError::NotBooted => Failure::new(Exit::Internal, error.to_string(), "please report what was printed above"),
        RunError::OldPermit => Failure::new(Exit::Internal, error.to_string(), "please report what was printed above"),
        RunError::NotEnabled { cause, .. } | RunError::NotTried { cause, .. } => {
            let exit = cause.map_or(Exit::DeviceFault, exit_of);
            let help = cause.map_or("read the drives' error codes (603Fh)", |cause| cause.fault.row().next);
            Failure::new(exit, error.to_string(), help)
        }
        RunError::Unread { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "compare node ids and profiles with the devices on the bus",
        ),
        RunError::Pace { pace, .. } => {
            let pace = if *pace == Pace::Lockstep { "lockstep" } else { "free" };
            let help = format!("nothing was enabled; start `yieldwall sim` with --pace {pace} as well");
            Failure::new(Exit::DeviceMismatch, error.to_string(), help)
        }
        RunError::Unmarked { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "nothing was enabled; start the `yieldwall sim` of this version. A simulated device of somebody else says `simulated device` in \
             2012h:1 to 4, four letters each, the first one in the lowest byte; a real drive has the vendor of its maker",
        ),
        RunError::NotSimulated { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "nothing was enabled; leave --pace lockstep away and drill the drives",
        ),
        RunError::LedAway { .. } => Failure::new(
            Exit::OutOfTolerance,
            error.to_string(),
            "the rig was stopped; drill it again with nobody at the handle",
        ),
        RunError::Unwatched { .. } => Failure::new(
            Exit::OutOfTolerance,
            error.to_string(),
            "nothing was enabled; start `yieldwall sim` without --unwatched, or drill the rig by the wall clock",
        ),
        RunError::Interrupted => Failure::new(Exit::Interrupted, error.to_string(), ""),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_that_was_ignored_when_the_program_began_stays_ignored() {
        let status = |mask: &str| format!("Name:\tyieldwall\nSigBlk:\t0000000000000000\nSigIgn:\t{mask}\nSigCgt:\t0\n");
        for (mask, signal, expected) in [
            ("0000000000000001", SIGHUP, true),
            ("0000000000001000", SIGHUP, false),
            ("0000000000004002", SIGINT, true),
            ("0000000000004000", SIGTERM, true),
        ] {
            assert_eq!(is_ignored(signal, &status(mask)), expected, "{mask} {signal}");
        }
        assert!(!is_ignored(SIGHUP, ""), "a system that does not tell");
    }
}
