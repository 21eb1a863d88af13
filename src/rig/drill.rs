//! The watchdog drill of the simulated drives.

use std::time::Duration;

use super::embedded::EmbeddedRig;
use super::error::RigError;
use crate::assembly::device_buses;
use crate::canopen::{Frame, Time, cob};
use crate::config;
use crate::guard::Request;
use crate::run::{CYCLES_BEFORE_SILENCE, DRILL_LIMIT, Drilled, Finding};
use yieldwall_drives::cia402;
use yieldwall_drives::watchdog::Watchdog;

/// What keeps frames of the master from the drives of an embedded rig, and notes when these stop.
#[derive(Debug)]
pub(super) struct Silence {
    watchdog: Watchdog,
    /// Buses and identifiers of the set-points.
    set_points: [(u8, u16); 2],
    /// The set-points that are repeated, as the last cycle sent them.
    repeated: [Option<Frame>; 2],
    is_on: bool,
    last: Time,
    stopped_at: [Option<Time>; 2],
}

impl Silence {
    fn new(watchdog: Watchdog, rig: &config::Rig) -> Result<Self, RigError> {
        let mode = rig.rig.command_mode.operation_mode();
        let id = |drive: &config::Drive| {
            let number = drive.profile.get()?.pdos(Some(mode))?.rpdo.first()?.number;
            cob::node_id(drive.address.canopen.node_id).ok().and_then(|node| cob::rpdo(number, node))
        };
        let [left, right] = &rig.drives;
        let [left_bus, right_bus, _] = device_buses(rig)?;
        let set_points = [(left_bus, id(left).unwrap_or_default()), (right_bus, id(right).unwrap_or_default())];
        Ok(Self { watchdog, set_points, repeated: [None; 2], is_on: false, last: Time(0), stopped_at: [None; 2] })
    }

    /// What the devices get of a frame of the master.
    pub(super) fn pass(&mut self, now: Time, frame: Frame) -> Option<Frame> {
        let drive = self.set_points.iter().position(|own| *own == (frame.bus(), frame.id()));
        let is_watched = match self.watchdog {
            Watchdog::Sync => frame.id() == cob::SYNC,
            Watchdog::SetPoints => drive.is_some(),
            Watchdog::Heartbeat => cob::is_heartbeat(frame.id()),
        };
        if self.is_on {
            // A master that notices and stops the drives would hide what they do by themselves.
            let repeated = drive.and_then(|drive| self.repeated.get(drive).copied().flatten());
            return if is_watched { None } else { Some(repeated.unwrap_or(frame)) };
        }
        if let Some(place) = drive.and_then(|drive| self.repeated.get_mut(drive)) {
            *place = Some(frame);
        }
        if is_watched {
            self.last = now;
        }
        Some(frame)
    }

    /// Looks at the drives.
    pub(super) fn look(&mut self, now: Time, states: [cia402::State; 2]) {
        for (stopped_at, state) in self.stopped_at.iter_mut().zip(states) {
            if self.is_on && state != cia402::State::OperationEnabled {
                stopped_at.get_or_insert(now);
            }
        }
    }

    fn finding(&self) -> Finding {
        let stopped_after = self.stopped_at.map(|stopped_at| stopped_at.map(|at| at.since(self.last)));
        Finding { watchdog: self.watchdog, stopped_after }
    }
}

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
    for watchdog in Watchdog::ALL {
        let mut machine = EmbeddedRig::new(rig, scene, &rig.fixture, scene.seed)?;
        machine.clear_injections();
        prepare(&mut machine);
        machine.enable()?;
        *machine.silence_mut() = Some(Silence::new(watchdog, rig)?);
        for _ in 0..CYCLES_BEFORE_SILENCE {
            machine.run_cycle(Request::None)?;
        }
        if let Some(silence) = machine.silence_mut() {
            silence.is_on = true;
        }
        let limit = machine.now() + DRILL_LIMIT;
        while machine.now() < limit && machine.silence_mut().as_ref().is_some_and(|it| it.stopped_at.contains(&None)) {
            machine.run_cycle(Request::None)?;
        }
        findings.extend(machine.silence_mut().as_ref().map(Silence::finding));
    }
    // Every event is looked at.
    Ok(Drilled { findings, resolution: Duration::ZERO })
}
