//! A force sensor with what is broken in it.

use crate::far_end::{Device, Transducer};
use crate::misread::ForceMisread;
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_fieldbus::canopen::{Frame, Outbox};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::sensing::Calibration;
use yieldwall_sim::ForceSensor;

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
pub(in crate::embedded) struct InjectableSensor {
    pub(in crate::embedded) sensor: ForceSensor,
    misread: ForceMisread,
}

impl InjectableSensor {
    pub(in crate::embedded) fn new(sensor: ForceSensor, calibration: Calibration) -> Self {
        Self { sensor, misread: ForceMisread::none(calibration) }
    }

    /// Whether an injection acts in the sensor.
    pub(in crate::embedded) fn has(kind: Kind) -> bool {
        KINDS.contains(&kind)
    }

    pub(in crate::embedded) fn clear(&mut self) {
        self.misread.clear();
    }

    /// Begins an injection, or ends it.
    pub(in crate::embedded) fn switch(
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
            _ => self.misread.switch(scene_from_s, injection, is_on),
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
    fn measure(&mut self, now: Time, counts: [i32; 6]) {
        let counts = self.misread.counts(now, counts);
        self.sensor.measure(counts);
    }
}
