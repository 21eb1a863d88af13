//! A drive with what is broken in it.

use crate::far_end::{Actuator, Device};
use crate::misread::JointMisread;
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_drives::cia402;
use yieldwall_fieldbus::canopen::{Frame, Outbox};
use yieldwall_fieldbus::time::Time;
use yieldwall_sim::Drive;

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
pub(in crate::embedded) struct InjectableDrive {
    pub(in crate::embedded) drive: Drive,
    misread: JointMisread,
}

impl InjectableDrive {
    pub(in crate::embedded) fn new(drive: Drive) -> Self {
        Self { drive, misread: JointMisread::default() }
    }

    /// Whether an injection acts in drives.
    pub(in crate::embedded) fn has(kind: Kind) -> bool {
        KINDS.contains(&kind)
    }

    pub(in crate::embedded) fn clear(&mut self) {
        self.misread.clear();
    }

    /// Begins an injection, or ends it.
    pub(in crate::embedded) fn switch(&mut self, now: Time, injection: Injection, is_on: bool, out: &mut impl Outbox) {
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
            _ => self.misread.switch(injection, is_on),
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
    fn measure(&mut self, angle_rad: f64, rate_rad_per_s: f64) {
        let (angle_rad, rate_rad_per_s) = self.misread.motion(angle_rad, rate_rad_per_s);
        self.drive.measure(angle_rad, rate_rad_per_s);
    }

    fn torque_n_m(&self) -> f64 {
        self.misread.torque_n_m(self.drive.torque_n_m(), self.drive.state())
    }

    fn state(&self) -> cia402::State {
        self.drive.state()
    }

    fn is_braked(&self) -> bool {
        self.drive.is_braked()
    }
}
