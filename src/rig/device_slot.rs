//! A place for a device: here, or in another process.

use std::time::Duration;

use super::far_end::{Actuator, Device, Transducer};
use yieldwall_drives::cia402;
use yieldwall_fieldbus::canopen::{Frame, Outbox, cob};
use yieldwall_fieldbus::time::Time;
use yieldwall_sim::AxisView;

/// Longest simulated time in which a device elsewhere is not asked whether something has become due: frames that it gets
/// from the bus change that.
const ASKING: Duration = Duration::from_millis(1);

/// Call of a device in another process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Call {
    /// Simulated time.
    pub now: Time,
    /// Whether SYNC has come; otherwise something is due.
    pub is_sync: bool,
    /// Measured values: angle in rad and rate in rad/s of a drive's joint, or six counts of the force sensor.
    pub felt: [f64; 6],
}

/// Answer of the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Torque on the joint in N m; zero for the sensor.
    pub torque_n_m: f64,
    /// State of the drive; any for the sensor.
    pub state: cia402::State,
    /// When something is due next.
    pub next: Time,
}

/// A device in another process, which hears and sends on the bus by itself.
pub trait Peer: Send {
    /// Asks it; `None` if it has gone.
    fn call(&mut self, call: &Call) -> Option<Answer>;
}

const SILENT: Answer = Answer { torque_n_m: 0.0, state: cia402::State::NotReadyToSwitchOn, next: Time::NEVER };

/// A device that is elsewhere, or not there at all: then a joint has no torque.
pub(super) struct RemoteDevice {
    peer: Option<Box<dyn Peer>>,
    felt: [f64; 6],
    answer: Answer,
    ask_at: Time,
}

impl std::fmt::Debug for RemoteDevice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Away").field("is_there", &self.peer.is_some()).field("answer", &self.answer).finish()
    }
}

impl RemoteDevice {
    fn ask(&mut self, now: Time, is_sync: bool) {
        let Some(peer) = &mut self.peer else { return };
        match peer.call(&Call { now, is_sync, felt: self.felt }) {
            Some(answer) => (self.answer, self.ask_at) = (answer, answer.next.max(now).min(now + ASKING)),
            None => (self.peer, self.answer, self.ask_at) = (None, SILENT, Time::NEVER),
        }
    }
}

/// A place for a device.
#[derive(Debug)]
pub(super) enum DeviceSlot<D> {
    /// It is simulated here.
    Local(Box<D>),
    /// It is elsewhere.
    Remote(RemoteDevice),
}

impl<D> DeviceSlot<D> {
    /// Creates an empty slot.
    pub(super) fn empty() -> Self {
        Self::Remote(RemoteDevice { peer: None, felt: [0.0; 6], answer: SILENT, ask_at: Time::NEVER })
    }

    /// Attaches a device in another process from now on.
    pub(super) fn attach(&mut self, now: Time, peer: Box<dyn Peer>) {
        *self = Self::Remote(RemoteDevice { peer: Some(peer), felt: [0.0; 6], answer: SILENT, ask_at: now });
    }

    /// Returns the device that is simulated here.
    pub(super) fn here(&self) -> Option<&D> {
        match self {
            DeviceSlot::Local(device) => Some(device),
            DeviceSlot::Remote(_) => None,
        }
    }

    /// Returns the device that is simulated here, to change it.
    pub(super) fn local_mut(&mut self) -> Option<&mut D> {
        match self {
            DeviceSlot::Local(device) => Some(device),
            DeviceSlot::Remote(_) => None,
        }
    }
}

impl<D: Device> Device for DeviceSlot<D> {
    fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        if let DeviceSlot::Local(device) = self {
            device.boot(now, out);
        }
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        match self {
            DeviceSlot::Local(device) => device.on_frame(now, frame, out),
            DeviceSlot::Remote(remote) if frame.id() == cob::SYNC => remote.ask(now, true),
            DeviceSlot::Remote(_) => {}
        }
    }

    fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        match self {
            DeviceSlot::Local(device) => device.poll(now, out),
            DeviceSlot::Remote(remote) => remote.ask(now, false),
        }
    }

    fn next_deadline(&self) -> Time {
        match self {
            DeviceSlot::Local(device) => device.next_deadline(),
            DeviceSlot::Remote(remote) => remote.ask_at,
        }
    }
}

impl<D: Actuator> Actuator for DeviceSlot<D> {
    fn measure(&mut self, axis: usize, angle_rad: f64, rate_rad_per_s: f64) {
        match self {
            DeviceSlot::Local(device) => device.measure(axis, angle_rad, rate_rad_per_s),
            DeviceSlot::Remote(remote) => remote.felt = [angle_rad, rate_rad_per_s, 0.0, 0.0, 0.0, 0.0],
        }
    }

    /// Nobody asks a device elsewhere for its brake.
    fn axis(&self, axis: usize) -> AxisView {
        match self {
            DeviceSlot::Local(device) => device.axis(axis),
            DeviceSlot::Remote(RemoteDevice { answer: Answer { torque_n_m, state, .. }, .. }) => {
                AxisView { torque_n_m: *torque_n_m, state: *state, is_braked: false }
            }
        }
    }
}

impl<D: Transducer> Transducer for DeviceSlot<D> {
    fn measure(&mut self, now: Time, counts: [i32; 6]) {
        match self {
            DeviceSlot::Local(device) => device.measure(now, counts),
            DeviceSlot::Remote(remote) => remote.felt = counts.map(f64::from),
        }
    }
}
