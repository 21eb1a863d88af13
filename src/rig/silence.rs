//! Frames that a drill keeps from the simulated drives.

use super::error::RigError;
use yieldwall_config as config;
use yieldwall_drives::cia402;
use yieldwall_drives::watchdog::Watchdog;
use yieldwall_fieldbus::canopen::{BusId, Frame, cob};
use yieldwall_fieldbus::ethercat::frame::{Command, Datagrams};
use yieldwall_fieldbus::time::Time;
use yieldwall_run::Finding;
use yieldwall_run::assembly::device_buses;

/// Filter that keeps frames of the master from the drives of an embedded rig, and notes when these stop.
#[derive(Debug)]
pub(super) struct Silence {
    watchdog: Watchdog,
    /// Buses and identifiers of the set-points.
    set_points: [(BusId, u16); 2],
    /// The set-points that are repeated, as the last cycle sent them.
    repeated: [Option<Frame>; 2],
    is_on: bool,
    last: Time,
    stopped_at: [Option<(Time, cia402::State)>; 2],
}

impl Silence {
    pub(super) fn new(watchdog: Watchdog, rig: &config::Rig) -> Result<Self, RigError> {
        let mode = rig.rig.command_mode.operation_mode();
        let id = |drive: &config::Drive| {
            let [rpdos, _] = rig.model(drive)?.mapped(Some(mode))?;
            let number = rpdos.first()?.identifier;
            cob::node_id(drive.address.node_id()?).ok().and_then(|node| cob::rpdo(number, node))
        };
        let [left, right] = &rig.drives;
        let [left_bus, right_bus, _] = device_buses(rig)?;
        let set_points = [(left_bus, id(left).unwrap_or_default()), (right_bus, id(right).unwrap_or_default())];
        Ok(Self { watchdog, set_points, repeated: [None; 2], is_on: false, last: Time(0), stopped_at: [None; 2] })
    }

    /// Returns the frame that the devices get for a frame of the master.
    pub(super) fn pass(&mut self, now: Time, frame: Frame) -> Option<Frame> {
        let drive = self.set_points.iter().position(|own| *own == (frame.bus(), frame.id()));
        let is_watched = match self.watchdog {
            Watchdog::Sync => frame.id() == cob::SYNC,
            Watchdog::SetPoints => drive.is_some(),
            Watchdog::Heartbeat => cob::is_heartbeat(frame.id()),
            // No frame of CAN.
            Watchdog::Outputs | Watchdog::Operational => false,
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

    /// Whether the devices of a segment get a frame of the master: outputs are kept from them.
    pub(super) fn passes(&mut self, now: Time, bytes: &[u8]) -> bool {
        let carries_outputs = Datagrams::of(bytes)
            .is_ok_and(|mut all| all.any(|one| one.is_ok_and(|one| one.header.command == Command::Lwr as u8)));
        if self.watchdog != Watchdog::Outputs || !carries_outputs {
            return true;
        }
        if !self.is_on {
            self.last = now;
        }
        !self.is_on
    }

    /// Looks at the drives.
    pub(super) fn look(&mut self, now: Time, states: [cia402::State; 2]) {
        for (stopped_at, state) in self.stopped_at.iter_mut().zip(states) {
            if self.is_on && state != cia402::State::OperationEnabled {
                stopped_at.get_or_insert((now, state));
            }
        }
    }

    /// Begins the silence.
    pub(super) fn begin(&mut self, now: Time) {
        self.is_on = true;
        if self.watchdog == Watchdog::Operational {
            self.last = now;
        }
    }

    /// Whether a drive has not stopped.
    pub(super) fn is_awaited(&self) -> bool {
        self.stopped_at.iter().any(Option::is_none)
    }

    /// Returns the finding.
    pub(super) fn finding(&self) -> Finding {
        Finding {
            watchdog: self.watchdog,
            stopped_after: self.stopped_at.map(|stopped| stopped.map(|(at, _)| at.since(self.last))),
            stopped_in: self.stopped_at.map(|stopped| stopped.map(|(_, state)| state)),
        }
    }
}
