//! Figures, alone and with the machines that they name.

use super::Findings;
use super::fixture::{Host, check_capture_beside_guard, check_fixture, check_hold, check_passivity_beside_guard};
use super::reach::check_surface_reach;
use super::scene::Machine;
use crate::tree::Figure;

/// Rules of a figure alone.
pub(crate) fn check_figure(findings: &mut Findings, figure: &Figure) {
    let help = "write either `rigs: {label: file}` or `device: file`";
    match (&figure.device, figure.rigs.is_empty()) {
        (None, true) => {
            findings.error("title", "the figure names no machine", help);
        }
        (Some(_), false) => {
            let message = "the figure names a device and rigs: they move in different spaces";
            findings.error("device", message, help).see("rigs", "rigs");
        }
        _ => {}
    }
    for (index, steps) in figure.hold_steps.iter().enumerate() {
        if figure.hold_steps.iter().take(index).any(|earlier| earlier == steps) {
            let key = format!("hold_steps[{index}]");
            findings.error(&key, format!("`{key}` is {steps} again"), "each run of a figure has its own hold");
        }
    }
}

/// Rules of the fixture and the holds that a figure puts in the place of the machine's.
pub(crate) fn check_override(findings: &mut Findings, figure: &Figure, machine: Machine<'_>) {
    let (host, period_us, own) = match machine {
        Machine::Rig(rig) => (Host::Rig, rig.cycle.period_us, &rig.fixture),
        Machine::Device(device) => (Host::Device, device.cycle.period_us, &device.fixture),
    };
    if let Some(fixture) = &figure.fixture {
        check_fixture(findings, "fixture", fixture, host, f64::from(period_us) * 1e-6);
        if let Machine::Rig(rig) = machine {
            check_passivity_beside_guard(findings, "fixture", fixture, &rig.guard);
            check_capture_beside_guard(findings, "fixture", fixture, &rig.guard, f64::from(period_us) * 1e-6);
            check_surface_reach(findings, "fixture", fixture, rig);
        }
    }
    let coupling = figure.fixture.as_ref().map_or(&own.coupling, |fixture| &fixture.coupling);
    for (index, steps) in figure.hold_steps.iter().enumerate() {
        check_hold(findings, "fixture", coupling, *steps, &format!("hold_steps[{index}]"));
    }
}
