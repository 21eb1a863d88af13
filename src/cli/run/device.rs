//! `yieldwall run` with an impedance device, which has no bus.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use serde_json::json;

use super::super::ending::{SOFTER_COUPLING, above_bound, rig_failure};
use super::super::failure::{Exit, Failure};
use super::super::interrupt::{interrupted, on_interrupt, unless};
use super::super::keep::{Keep, described};
use super::super::output::Output;
use super::super::progress::Progress;
use super::super::report_text::{measures_text, run_verdict};
use super::{Arguments, draw, with_files};
use yieldwall_config::{Coupling, ImpedanceDevice, Loaded};
use yieldwall_rig::ImpedanceRig;
use yieldwall_rig::report::{Overrides, RunReport, replay, run_device};

pub(super) fn run(arguments: &Arguments, device: &Loaded<ImpedanceDevice>, output: &mut Output) -> Result<(), Failure> {
    check(arguments)?;
    // The warnings of the scene are among them.
    output.configuration(&device.warnings)?;
    let scene = device.scene()?.value;
    let overrides = Overrides { duration_s: arguments.duration, seed: arguments.seed, ..Overrides::default() };
    let seed = overrides.seed.unwrap_or(scene.seed);
    // Before anything is written: a device that is refused leaves no recording.
    ImpedanceRig::new(&device.value, &scene, &device.value.fixture, seed).map_err(|error| rig_failure(&error))?;
    let about = described(replay::about_device(&device.value, &scene, &overrides))?;
    let (keep, observer) = Keep::start_device(&device.value, &about, arguments.record.as_deref())?;
    let name = &device.value.device.name;
    let progress = Progress::new(output);
    progress.begin(name);
    let is_interrupted = on_interrupt()?;
    let mut onward = ControlFlow::Continue(());
    let started = Instant::now();
    let report = run_device(&device.value, &scene, &overrides, observer, |stage| {
        progress.at(stage);
        onward = unless(&is_interrupted);
        onward
    });
    let wall_s = started.elapsed().as_secs_f64();
    progress.end();
    // An interrupted run leaves the part that it has recorded.
    let kept = keep.finish()?;
    output.warnings(&kept.warnings());
    let report = report.map_err(|error| rig_failure(&error))?;
    let drawn = draw(&report.trace, arguments.figure.as_deref());
    let figure = arguments.figure.as_deref().filter(|_| drawn.is_ok());
    let end = match onward {
        ControlFlow::Break(()) => Err(interrupted(report.simulated_s())),
        ControlFlow::Continue(()) if report.measures.is_within_bound() => Ok(()),
        ControlFlow::Continue(()) => Err(above_bound(&report.measures, name, SOFTER_COUPLING)),
    };
    let end = with_files(end, [drawn, kept.is_written()]);
    if !output.is_json() {
        let mut lines = text(&device.value, &report, figure, seed, wall_s);
        lines.extend(kept.lines());
        lines.insert(0, run_verdict(&end, (report.simulated_s(), None), &report.measures));
        output.news(&lines.join("\n"))?;
        return end;
    }
    let document = json!({
        "device": name,
        "seed": seed,
        "simulated_s": report.simulated_s(),
        "wall_s": wall_s,
        "measures": report.measures,
        "figure": figure,
        "recorded": kept.files_json(),
    });
    output.end(document, end)
}

/// Refuses arguments that need a bus or the cycles of a rig.
fn check(arguments: &Arguments) -> Result<(), Failure> {
    let options = [
        ("--tui", arguments.tui),
        ("--view", arguments.page.view.is_some()),
        ("--fault", !arguments.fault.is_empty()),
        ("--candump", arguments.candump.is_some()),
        ("--pcapng", arguments.pcapng.is_some()),
        ("--black-box", arguments.black_box.is_some()),
        ("--ignore-bus-budget", arguments.ignore_bus_budget),
    ];
    match options.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => {
            let message = format!("{option} is for a rig, and {} is an impedance device, without a bus", arguments.rig);
            Err(Failure::new(Exit::Usage, message, "leave it out, or run a rig"))
        }
        None => Ok(()),
    }
}

/// Returns the text for a person, a line each.
fn text(device: &ImpedanceDevice, report: &RunReport, figure: Option<&Path>, seed: u64, wall_s: f64) -> Vec<String> {
    let (trace, simulated) = (&report.trace, report.simulated_s());
    let mut lines = vec![
        format!("device    {}: impedance type, {} ms", device.device.name, report.period_s * 1e3),
        format!(
            "scene     {}: {simulated:.1} s, seed {seed}, run in {wall_s:.2} s ({:.0} x real time)",
            device.scene,
            simulated / wall_s
        ),
    ];
    if let Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } = device.fixture.coupling {
        lines.push(format!(
            "fixture   K {} N/m, B {} N s/m, F {} N, R {} N, N_wait {}",
            *stiffness_n_per_m, *damping_n_s_per_m, trace.friction_n, trace.yield_n, trace.hold_steps
        ));
    }
    lines.extend(measures_text(&report.measures));
    lines.extend(figure.map(|path| format!("figure    {}", path.display())));
    lines
}
