//! The watchdog drill of the simulated drives.

use std::time::Duration;

use super::embedded::EmbeddedRig;
use super::error::RigError;
use super::silence::Silence;
use yieldwall_config as config;
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_motion::guard::Request;
use yieldwall_run::{CYCLES_BEFORE_SILENCE, DRILL_LIMIT, Drilled, watchdogs};

/// Drills the simulated drives of a rig in virtual time; `prepare` may change each rig before it is enabled.
///
/// # Errors
/// If the rig cannot be built or enabled.
pub fn drill(
    rig: &config::Rig,
    scene: &config::Scene,
    mut prepare: impl FnMut(&mut EmbeddedRig),
) -> Result<Drilled, RigError> {
    let mut findings = Vec::new();
    for &watchdog in watchdogs(rig) {
        let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed)?;
        machine.clear_injections();
        prepare(&mut machine);
        machine.enable()?;
        *machine.silence_mut() = Some(Silence::new(watchdog, rig)?);
        for _ in 0..CYCLES_BEFORE_SILENCE {
            machine.run_cycle(Request::None)?;
        }
        let now = machine.now();
        if let Some(silence) = machine.silence_mut() {
            silence.begin(now);
        }
        if watchdog == Watchdog::Operational {
            machine.leave_op();
        }
        let limit = machine.now() + DRILL_LIMIT;
        while machine.now() < limit && machine.silence_mut().as_ref().is_some_and(Silence::is_awaited) {
            machine.run_cycle(Request::None)?;
        }
        findings.extend(machine.silence_mut().as_ref().map(Silence::finding));
    }
    // Every event is looked at.
    Ok(Drilled { findings, resolution: Duration::ZERO })
}
