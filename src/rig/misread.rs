//! Injected errors in what a joint's drive and the force sensor measure, and in the drive's torque.

use nalgebra::Vector6;

use yieldwall_config::injection::{Injection, Kind};
use yieldwall_drives::cia402;
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::sensing::{Calibration, Wrench};

/// The encoder of a drive that may lie, and its torque that may run away.
#[derive(Debug, Default)]
pub(super) struct JointMisread(Vec<Stuck<f64>>);

/// The channels of a force sensor, which may lie.
#[derive(Debug)]
pub(super) struct ForceMisread {
    /// Calibration of the counts.
    calibration: Calibration,
    active: Vec<Stuck<[i32; 6]>>,
    /// When the scene began, in s.
    scene_from_s: f64,
}

/// An injection that lasts, and where it got stuck if it does that.
#[derive(Clone, Copy, Debug)]
struct Stuck<T> {
    injection: Injection,
    at: Option<T>,
}

fn switch<T>(active: &mut Vec<Stuck<T>>, injection: Injection, is_on: bool) {
    if is_on {
        active.push(Stuck { injection, at: None });
    } else if let Some(at) = active.iter().position(|active| active.injection == injection) {
        active.remove(at);
    }
}

impl JointMisread {
    /// Begins an injection, or ends it.
    pub(super) fn switch(&mut self, injection: Injection, is_on: bool) {
        switch(&mut self.0, injection, is_on);
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns the joint's motion in rad and rad/s as the encoder reports it.
    pub(super) fn motion(&mut self, mut angle_rad: f64, mut rate_rad_per_s: f64) -> (f64, f64) {
        for active in &mut self.0 {
            match active.injection.kind {
                Kind::EncoderJump | Kind::EncoderOffset => angle_rad += active.injection.size,
                Kind::EncoderStuck => (angle_rad, rate_rad_per_s) = (*active.at.get_or_insert(angle_rad), 0.0),
                _ => {}
            }
        }
        (angle_rad, rate_rad_per_s)
    }

    /// Returns the true torque in N m for the torque that the drive means to make.
    pub(super) fn torque_n_m(&self, torque_n_m: f64, state: cia402::State) -> f64 {
        let mut active = self.0.iter().map(|active| active.injection);
        let runaway = active.find(|injection| injection.kind == Kind::DriveRunaway);
        runaway.filter(|_| state == cia402::State::OperationEnabled).map_or(torque_n_m, |injection| injection.size)
    }
}

impl ForceMisread {
    /// Creates the state without faults of a sensor with this calibration.
    pub(super) fn none(calibration: Calibration) -> Self {
        Self { calibration, active: Vec::new(), scene_from_s: 0.0 }
    }

    /// Begins an injection, or ends it.
    pub(super) fn switch(&mut self, scene_from_s: f64, injection: Injection, is_on: bool) {
        self.scene_from_s = scene_from_s;
        switch(&mut self.active, injection, is_on);
    }

    pub(super) fn clear(&mut self) {
        self.active.clear();
    }

    /// Returns the counts that the channels report.
    pub(super) fn counts(&mut self, now: Time, mut counts: [i32; 6]) -> [i32; 6] {
        let Self { calibration, active, scene_from_s } = self;
        for active in active {
            let Injection { kind, size, start_s, .. } = active.injection;
            let mut shift = |force_n: f64| {
                let wrench = Wrench(Vector6::new(force_n, 0.0, 0.0, 0.0, 0.0, 0.0));
                for (count, by) in counts.iter_mut().zip(calibration.counts_for(&wrench)) {
                    *count += by;
                }
            };
            match kind {
                Kind::SensorStuck => counts = *active.at.get_or_insert(counts),
                Kind::SensorSaturated => counts[..2].fill(calibration.range_counts()),
                Kind::SensorJump => shift(size),
                Kind::SensorDrift => shift(size * (now.as_secs_f64() - *scene_from_s - start_s)),
                _ => {}
            }
        }
        counts
    }
}
