//! A drive with what is broken in it.

use crate::canopen::{Frame, Outbox};
use crate::injection::{Injection, Kind};
use crate::rig::far_end::{Actuator, Device};
use crate::sim::Drive;
use crate::time::Time;
use yieldwall_drives::cia402;

/// Injections that act in drives.
const KINDS: [Kind; 12] = [
    Kind::NodeSilent,
    Kind::NodeReset,
    Kind::VoltageOff,
    Kind::DriveFault,
    Kind::DriveWarning,
    Kind::DriveRunaway,
    Kind::DriveLeavesOperation,
    Kind::DriveIgnoresCommand,
    Kind::DriveNotEnabling,
    Kind::EncoderJump,
    Kind::EncoderStuck,
    Kind::EncoderOffset,
];

/// A drive whose encoder may lie, whose torque may run away, and which may be switched off or act against its master.
#[derive(Debug)]
pub(in crate::rig::embedded) struct InjectableDrive {
    pub(in crate::rig::embedded) drive: Drive,
    /// What acts on what it measures and makes.
    active: Vec<Active>,
}

#[derive(Clone, Copy, Debug)]
struct Active {
    injection: Injection,
    /// Where the encoder got stuck.
    angle_rad: Option<f64>,
}

impl InjectableDrive {
    pub(in crate::rig::embedded) fn new(drive: Drive) -> Self {
        Self { drive, active: Vec::new() }
    }

    /// Whether an injection acts in drives.
    pub(in crate::rig::embedded) fn has(kind: Kind) -> bool {
        KINDS.contains(&kind)
    }

    pub(in crate::rig::embedded) fn clear(&mut self) {
        self.active.clear();
    }

    /// Begins an injection, or ends it.
    pub(in crate::rig::embedded) fn switch(
        &mut self,
        now: Time,
        injection: Injection,
        is_on: bool,
        out: &mut impl Outbox,
    ) {
        let drive = &mut self.drive;
        match injection.kind {
            Kind::NodeSilent if is_on => drive.switch_off(),
            Kind::NodeSilent | Kind::NodeReset => drive.boot(now, out),
            Kind::DriveFault => drive.raise_fault(now, injection.size as u16, out),
            Kind::DriveLeavesOperation => drive.leave_operation(now, out),
            Kind::DriveWarning => drive.set_warning(is_on),
            Kind::DriveIgnoresCommand => drive.set_ignores_targets(is_on),
            Kind::DriveNotEnabling => drive.set_ignores_controlword(is_on),
            Kind::VoltageOff => drive.set_voltage(now, !is_on, out),
            _ if is_on => self.active.push(Active { injection, angle_rad: None }),
            _ => {
                if let Some(at) = self.active.iter().position(|active| active.injection == injection) {
                    self.active.remove(at);
                }
            }
        }
    }
}

impl Device for InjectableDrive {
    fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        self.drive.boot(now, out);
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        self.drive.on_frame(now, frame, out);
    }

    fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        self.drive.poll(now, out);
    }

    fn next_deadline(&self) -> Time {
        self.drive.next_deadline()
    }
}

impl Actuator for InjectableDrive {
    fn measure(&mut self, mut angle_rad: f64, mut rate_rad_per_s: f64) {
        for active in &mut self.active {
            match active.injection.kind {
                Kind::EncoderJump | Kind::EncoderOffset => angle_rad += active.injection.size,
                Kind::EncoderStuck => {
                    (angle_rad, rate_rad_per_s) = (*active.angle_rad.get_or_insert(angle_rad), 0.0);
                }
                _ => {}
            }
        }
        self.drive.measure(angle_rad, rate_rad_per_s);
    }

    fn torque_n_m(&self) -> f64 {
        let mut active = self.active.iter().map(|active| active.injection);
        let runaway = active.find(|injection| {
            injection.kind == Kind::DriveRunaway && self.drive.state() == cia402::State::OperationEnabled
        });
        runaway.map_or_else(|| self.drive.torque_n_m(), |injection| injection.size)
    }

    fn state(&self) -> cia402::State {
        self.drive.state()
    }
}
