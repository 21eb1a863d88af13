//! A drive with what is broken in it.

use crate::far_end::{Actuator, Device};
use crate::misread::JointMisread;
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_fieldbus::canopen::{Frame, Outbox};
use yieldwall_fieldbus::time::Time;
use yieldwall_sim::{AxisView, Drive};

/// Axes of a device at most.
const AXES: usize = 8;

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
    /// Wrong measurement of the joint of each axis.
    misread: [JointMisread; AXES],
}

impl InjectableDrive {
    pub(in crate::embedded) fn new(drive: Drive) -> Self {
        Self { drive, misread: Default::default() }
    }

    /// Whether an injection acts in drives.
    pub(in crate::embedded) fn has(kind: Kind) -> bool {
        KINDS.contains(&kind)
    }

    pub(in crate::embedded) fn clear(&mut self) {
        self.misread.iter_mut().for_each(JointMisread::clear);
    }

    /// Begins an injection in an axis, or ends it.
    pub(in crate::embedded) fn switch(
        &mut self,
        now: Time,
        axis: usize,
        injection: Injection,
        is_on: bool,
        out: &mut impl Outbox,
    ) {
        let misread = self.misread.get_mut(axis);
        self.drive.on_axis(axis, |drive| match injection.kind {
            Kind::NodeSilent if is_on => drive.switch_off(),
            Kind::NodeSilent | Kind::NodeReset => drive.boot(now, out),
            Kind::DriveFault => drive.raise_fault(now, injection.size as u16, out),
            Kind::DriveLeavesOperation => drive.leave_operation(now, out),
            Kind::DriveWarning => drive.set_warning(is_on),
            Kind::DriveIgnoresCommand => drive.set_ignores_targets(is_on),
            Kind::DriveNotEnabling => drive.set_ignores_controlword(is_on),
            Kind::VoltageOff => drive.set_voltage(now, !is_on, out),
            _ => misread.into_iter().for_each(|misread| misread.switch(injection, is_on)),
        });
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
    fn measure(&mut self, axis: usize, angle_rad: f64, rate_rad_per_s: f64) {
        let misread = self.misread.get_mut(axis);
        let (angle_rad, rate_rad_per_s) =
            misread.map_or((angle_rad, rate_rad_per_s), |misread| misread.motion(angle_rad, rate_rad_per_s));
        self.drive.on_axis(axis, |drive| drive.measure(angle_rad, rate_rad_per_s));
    }

    fn axis(&self, axis: usize) -> AxisView {
        let view = self.drive.axis(axis);
        let misread = self.misread.get(axis);
        let torque_n_m = misread.map_or(view.torque_n_m, |misread| misread.torque_n_m(view.torque_n_m, view.state));
        AxisView { torque_n_m, ..view }
    }
}
