//! `yieldwall run --bus`: a rig with its scene on a real bus.

mod facts;
mod proof;

use std::path::Path;
use std::sync::Arc;

use super::bus::check_buses;
use super::desk::journal::{journals, not_opened};
use super::desk::plan::{self, Sender};
use super::ending::{ended_held, stopped_by};
use super::events::{Event, Events, Listening};
use super::failure::{Exit, Failure};
use super::interfaces::Interfaces;
use super::interrupt::{interrupted, on_interrupt};
use super::keep::{Keep, described};
use super::on_bus::{
    after_standstill, different, live_failure, not_in_time, point_to_node, point_to_resets, standing, stood,
    thread_failure, told_before, warn, warn_of, with_findings, with_told,
};
use super::output::Output;
use super::pace::PaceArgument;
use super::page::{Page, PageOf};
use super::report_text::run_verdict;
use super::run::{Arguments, check, check_candump, check_loop, draw, view, with_files};
use super::tui::Screen;
use facts::Facts;
use proof::{check_measured_loop, measured_masses, unproven, untimely};
pub(super) use proof::{evidence, loops};
use yieldwall_config as config;
use yieldwall_motion::guard::{Cause, Fault, State};
use yieldwall_record::CycleRecord;
use yieldwall_record::recording::About;
use yieldwall_rig::report::{self, Overrides, measured, replay};
use yieldwall_run::host::system::Refusal;
use yieldwall_run::host::{HostedRun, News, NotRun, RigOnBus, StageTimes, Terms};
use yieldwall_run::recorder::Watched;
use yieldwall_run::{Ended, Orders, Play};

/// Cycles of which figure and measures are made, from the first one on: ten minutes at 1 kHz. A recording holds all.
const LONGEST_TRACE: u64 = 600_000;

/// Times that the cycles of the scene took.
struct LoopTimes {
    stages: StageTimes,
    skipped: u64,
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
    let rig = config::load_rig(arguments.source()?)?;
    check_scene_values(&arguments.set, &rig.value, &arguments.rig)?;
    check_candump(arguments, &rig)?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, Some(arguments.ignore_bus_budget), output)?;
    // The person who holds the tool is not the hand of the scene.
    check_loop(&rig, false, output)?;
    if arguments.dry_run {
        let buses = Interfaces::of(&rig.value, &arguments.bus)?.named(&rig.value);
        return plan::run(&rig, &buses, Sender::Run, output);
    }
    if arguments.pace == PaceArgument::Free {
        let buses = arguments.bus.iter().map(|bus| format!("--bus {bus}")).collect::<Vec<_>>().join(" ");
        check_measured_loop(&rig, &loops()?, &buses)?;
        output.configuration(&measured_masses(&rig, &loops()?)?)?;
    }
    // Devices in lockstep are simulated; on other devices a scene gives only the duration.
    let scene = match (&rig.value.simulation, arguments.pace) {
        (None, PaceArgument::Free) => None,
        _ => Some(rig.scene()?.value),
    };
    let Some(duration_s) = arguments.duration.or(scene.as_ref().map(|scene| scene.duration_s.get())) else {
        let message = format!("{} has no scene, so the duration is not known", arguments.rig);
        return Err(Failure::new(Exit::Usage, message, "give the duration in s with --duration"));
    };
    let file = rig;
    let rig = file.value.clone();
    let terms = Terms {
        evidence: evidence(arguments.pace, &rig, scene.as_ref())?,
        needs_realtime: arguments.require_realtime,
        ignores_latency: arguments.ignore_latency,
        ignores_bus_budget: arguments.ignore_bus_budget,
    };
    let is_interrupted = on_interrupt()?;
    page.open(&arguments.page, &rig, PageOf { command: "run", pace: arguments.pace.into() })?;
    let interfaces = Interfaces::of(&rig, &arguments.bus)?;
    let on_bus = RigOnBus::open(&rig, interfaces.names(), arguments.pace.pace(), &journals("run"));
    let mut on_bus = on_bus.map_err(|error| not_opened(&error, &rig, &arguments.rig, &interfaces))?;
    refuse(arguments, on_bus.memory())?;
    warn_of_interfaces(&on_bus, &file, arguments.pace, output);
    warn_of(output, on_bus.memory());
    let about = about(&rig, scene.as_ref(), arguments)?;
    let watched = match arguments.pace {
        PaceArgument::Free => Watched::Interfaces(interfaces.names()),
        PaceArgument::Lockstep => Watched::Lockstep(interfaces.names()),
    };
    let (keep, watch) = Keep::start(watched, &rig, &about, &arguments.wanted())?;
    let place = format!("{}, {}", interfaces.shown(&rig), arguments.pace.name());
    let view = arguments.tui.then(|| view(&rig, &place, duration_s));
    view.iter().for_each(|view| events.show_on(view));
    let (listening, heard) = Listening::start(events, watched, &rig)?;
    on_bus.set_watch(watch.and(heard).and(page.watch()));
    let period_s = f64::from(rig.cycle.period_us) * 1e-6;
    let mut scene_rows = report::RunLog::with_room(Play::on_bus(&rig, duration_s).cycles.min(LONGEST_TRACE) as usize);
    let mut seen = LoopTimes { stages: StageTimes::default(), skipped: 0 };
    let each = |record: &CycleRecord| {
        seen.stages.add(&record.moment.stages, &record.inputs.timing);
        seen.skipped += u64::from(record.inputs.timing.skipped);
        // Measures end with the fault that stops the rig, also where a person has it come back. Without room the cycle would have to
        // wait for memory.
        if !scene_rows.is_stopped() {
            scene_rows.take(record.row(), record.directive.state, record.cause);
        }
    };
    let tell = |news| match news {
        // Told as an error later.
        News::Refused(_) if arguments.require_realtime => {}
        News::Refused(refusal) if arguments.tui => {
            events.tell(&Event::new("warning", None, format!("this computer: {refusal}")))
        }
        News::Refused(refusal) => warn(output, refusal),
        news => events.news(news),
    };
    let orders = arguments.tui.then(Arc::<Orders>::default);
    orders.iter().for_each(|orders| on_bus.set_orders(Arc::clone(orders)));
    let screen = view.map(|view| Screen::start(&view, &is_interrupted, orders)).transpose()?;
    let outcome = on_bus.run(&terms, duration_s, &is_interrupted, each, tell);
    listening.finish()?;
    drop(screen);
    events.clear();
    let mut outcome = outcome.map_err(|error| thread_failure(&error))?;
    outcome.emergencies = different(outcome.emergencies.into_iter());
    let kept = keep.finish()?;
    output.warnings(&kept.warnings());
    refuse(arguments, &outcome.priority)?;
    let played = match &outcome.played {
        Ok(played) => *played,
        Err(error) => {
            let failure = not_run(error, &outcome, &interfaces, &rig, &arguments.rig);
            return Err(kept.point_to_black_box(failure));
        }
    };
    let time_s = played.cycles as f64 * period_s;
    let held = played.cause.filter(|_| played.state == State::Holding).map(|cause| ended_held(cause.fault));
    let failure = ended((played.ended, played.cause), time_s, &outcome, &rig)
        .map(|failure| point_to_resets(failure, &outcome.errors, &rig, &arguments.rig, &interfaces))
        .or(held);
    let (trace, measures) = measured(&rig, &rig.fixture, scene_rows);
    let drawn = draw(&trace, arguments.figure.as_deref());
    let facts = Facts {
        interfaces: &interfaces,
        arguments,
        rig: &rig,
        outcome: &outcome,
        seen: &seen,
        played: &played,
        measures: &measures,
        kept: &kept,
        figure: arguments.figure.as_deref().filter(|_| drawn.is_ok()),
    };
    let end = failure.map_or(Ok(()), |failure| Err(kept.point_to_black_box(failure)));
    let end = with_files(end, [drawn, kept.is_written()]);
    events.end(&end);
    if !output.is_json() {
        let mut lines = facts.lines(time_s);
        let stopped_by = played.cause.filter(|_| played.ended == Ended::Stopped).map(|cause| (cause, &rig));
        lines.insert(0, run_verdict(&end, (time_s, stopped_by), &measures));
        output.news(&lines.join("\n"))?;
        return end;
    }
    output.end(facts.json(time_s), end)
}

/// Refuses values for the scene of a rig that has none.
fn check_scene_values(values: &[config::SetValue], rig: &config::Rig, file: &str) -> Result<(), Failure> {
    let of_scene = values.iter().find(|value| value.is_of_scene()).filter(|_| rig.simulation.is_none());
    of_scene.map_or(Ok(()), |value| {
        let message = format!(
            "--set {}={}: {file} has no `simulation`, and so no scene whose value could be set",
            value.key(),
            value.value()
        );
        let help = "leave out this value; --duration sets how long the rig runs. For a scene write \
                    `simulation: FILE.yaml` into the rig";
        Err(Failure::about_file(Exit::ConfigInvalid, Path::new(file), message, help))
    })
}

/// Warns of features that the interfaces lack for this rig.
fn warn_of_interfaces(on_bus: &RigOnBus, rig: &config::Loaded<config::Rig>, pace: PaceArgument, output: &mut Output) {
    if let Some(interface) = on_bus.unplugged() {
        warn(output, format!("`{interface}` has no link: connect the cable, or switch on the first device"));
    }
    for facts in on_bus.facts() {
        facts.advice().into_iter().for_each(|advice| warn(output, advice));
        // In lockstep nothing has to be in time.
        if pace == PaceArgument::Free
            && let Some((why, help)) = facts.attachment.too_slow_for(rig.value.cycle.period_us)
        {
            let message = format!("`{}` {why}", facts.name);
            output.warnings(&[rig.finding(config::Severity::Warning, "cycle.period_us", message, help, &[])]);
        }
    }
}

/// Returns the description of the run for a recording.
fn about(rig: &config::Rig, scene: Option<&config::Scene>, arguments: &Arguments) -> Result<About, Failure> {
    let overrides = Overrides { duration_s: arguments.duration, ..Overrides::default() };
    let mut about = described(replay::about(rig, scene, &overrides))?;
    if arguments.ignore_latency {
        about.overrides = format!("{} --ignore-latency", about.overrides).trim().to_owned();
    }
    Ok(about)
}

/// Returns the failure of a rig that did not run.
pub(super) fn not_run<T>(
    error: &NotRun,
    outcome: &HostedRun<T>,
    interfaces: &Interfaces,
    rig: &config::Rig,
    file: &str,
) -> Failure {
    match error {
        NotRun::Run(error) => {
            let failure = point_to_node(live_failure(error), error, rig, file, interfaces);
            let failure = after_standstill(failure, outcome.standstill.map(stood));
            let told = told_before(error, &outcome.emergencies, rig);
            point_to_resets(with_told(failure, &told, &outcome.errors, rig), &outcome.errors, rig, file, interfaces)
        }
        NotRun::Unproven(error) => unproven(error, rig, &interfaces.arguments(rig), file),
        NotRun::Untimely(error) => untimely(error, rig),
        // Said with the line of the file before anything was opened.
        NotRun::Overfull { .. } => Failure::new(Exit::ConfigInvalid, error.to_string(), ""),
        NotRun::NotGranted => Failure::new(Exit::TimingMissed, error.to_string(), ""),
    }
}

/// Returns the failure of a run, if it has one.
pub(super) fn ended<T>(
    (ended, cause): (Ended, Option<Cause>),
    time_s: f64,
    outcome: &HostedRun<T>,
    rig: &config::Rig,
) -> Option<Failure> {
    let failure = match ended {
        Ended::Whole => return None,
        Ended::Interrupted => interrupted(time_s),
        Ended::Stopped => {
            let stopped = with_findings(stopped_by(cause, time_s, rig), &outcome.segment);
            let late = cause.and_then(|cause| not_in_time(cause.fault, outcome.standstill, rig));
            let stopped = after_standstill(stopped, late);
            with_told(stopped, &standing(&outcome.emergencies, cause), &outcome.errors, rig)
        }
        Ended::StillMoving => Failure::new(
            Exit::SafetyStop,
            "a drive still reports torque after the rig was stopped",
            "check the drive, and press the emergency stop if it moves",
        ),
        Ended::Panicked => Failure::new(
            Exit::Internal,
            format!("after {time_s:.3} s the cycle panicked ({})", Fault::CyclePanicked.row().meaning),
            "a quick stop was sent; please report what was printed above",
        ),
    };
    Some(failure)
}

/// Refuses a missing permission with `--require-realtime`.
fn refuse(arguments: &Arguments, granted: &Result<(), Refusal>) -> Result<(), Failure> {
    match granted {
        Err(refusal) if arguments.require_realtime => Err(Failure::new(
            Exit::TimingMissed,
            refusal.to_string(),
            "nothing was sent; omit --require-realtime to run without these permissions",
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{Source, load_rig};

    #[test]
    fn a_rig_without_scene_takes_no_values_of_a_scene() {
        let values = ["fixture.yield_n=25", "scene.duration_s=2.0"].map(|text| text.parse().unwrap());
        let text = "like: builtin:play.yaml\nsimulation: null\n";
        let rig = load_rig(Source::memory("real.yaml", text)).unwrap().value;
        let failure = check_scene_values(&values, &rig, "real.yaml").unwrap_err();
        assert_eq!((failure.exit, failure.report.diagnostics[0].file.as_str()), (Exit::ConfigInvalid, "real.yaml"));
        assert!(failure.report.diagnostics[0].message.contains("scene.duration_s=2.0: real.yaml has no"));
        assert!(check_scene_values(&values[..1], &rig, "real.yaml").is_ok());
        let simulated = load_rig(Source::named("builtin:play.yaml")).unwrap().value;
        assert!(check_scene_values(&values, &simulated, "play.yaml").is_ok());
    }
}
