//! A force sensor with what is broken in it.

use nalgebra::Vector6;

use crate::canopen::{Frame, Outbox};
use crate::injection::{Injection, Kind};
use crate::rig::far_end::{Device, Transducer};
use crate::sensing::{Calibration, Wrench};
use crate::sim::ForceSensor;
use crate::time::Time;

/// Injections that act in the sensor.
const KINDS: [Kind; 9] = [
    Kind::NodeSilent,
    Kind::NodeReset,
    Kind::SensorInvalid,
    Kind::SensorStale,
    Kind::SensorClockDrift,
    Kind::SensorStuck,
    Kind::SensorSaturated,
    Kind::SensorJump,
    Kind::SensorDrift,
];

/// A force sensor whose channels may lie, whose clock may drift, and which may be switched off.
#[derive(Debug)]
pub(in crate::rig::embedded) struct InjectableSensor {
    pub(in crate::rig::embedded) sensor: ForceSensor,
    /// What its counts mean.
    calibration: Calibration,
    /// What acts on what it measures.
    active: Vec<Active>,
}

#[derive(Clone, Copy, Debug)]
struct Active {
    injection: Injection,
    /// When the scene began, in s.
    scene_from_s: f64,
    /// What the channels got stuck at.
    counts: Option<[i32; 6]>,
}

impl InjectableSensor {
    pub(in crate::rig::embedded) fn new(sensor: ForceSensor, calibration: Calibration) -> Self {
        Self { sensor, calibration, active: Vec::new() }
    }

    /// Whether an injection acts in the sensor.
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
        scene_from_s: f64,
        injection: Injection,
        is_on: bool,
        out: &mut impl Outbox,
    ) {
        let sensor = &mut self.sensor;
        match injection.kind {
            Kind::NodeSilent if is_on => sensor.switch_off(),
            Kind::NodeSilent | Kind::NodeReset => sensor.boot(now, out),
            Kind::SensorInvalid => sensor.set_invalid(is_on),
            Kind::SensorStale if is_on => sensor.set_clock_rate(0.0),
            Kind::SensorClockDrift if is_on => sensor.set_clock_rate(injection.size),
            Kind::SensorStale | Kind::SensorClockDrift => sensor.set_clock_rate(1.0),
            _ if is_on => self.active.push(Active { injection, scene_from_s, counts: None }),
            _ => {
                if let Some(at) = self.active.iter().position(|active| active.injection == injection) {
                    self.active.remove(at);
                }
            }
        }
    }
}

impl Device for InjectableSensor {
    fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        self.sensor.boot(now, out);
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        self.sensor.on_frame(now, frame, out);
    }

    fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        self.sensor.poll(now, out);
    }

    fn next_deadline(&self) -> Time {
        self.sensor.next_deadline()
    }
}

impl Transducer for InjectableSensor {
    fn measure(&mut self, now: Time, mut counts: [i32; 6]) {
        for active in &mut self.active {
            let Injection { kind, size, start_s, .. } = active.injection;
            let mut shift = |force_n: f64| {
                let wrench = Wrench(Vector6::new(force_n, 0.0, 0.0, 0.0, 0.0, 0.0));
                for (count, by) in counts.iter_mut().zip(self.calibration.counts_for(&wrench)) {
                    *count += by;
                }
            };
            match kind {
                Kind::SensorStuck => counts = *active.counts.get_or_insert(counts),
                Kind::SensorSaturated => counts[..2].fill(self.calibration.range_counts()),
                Kind::SensorJump => shift(size),
                Kind::SensorDrift => shift(size * (now.as_secs_f64() - active.scene_from_s - start_s)),
                _ => {}
            }
        }
        self.sensor.measure(counts);
    }
}
