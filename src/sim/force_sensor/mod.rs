//! A simulated six-axis force sensor with its own sample clock, on CANopen or on plain CAN.

mod ethercat;
mod node;
mod plain;
mod sampler;
mod shown;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::Duration;

use yieldwall_drives::profiles::DeviceProfile;

pub use ethercat::{ForceTorqueSensor, ForceTorqueSettings};

use super::DeviceError;
use node::CanopenSensor;
use plain::PlainSensor;
use sampler::{CHANNELS, Sampler};
use yieldwall_fieldbus::canopen::{Frame, NodeId, Outbox};
use yieldwall_fieldbus::plain_can::Protocol;
use yieldwall_fieldbus::time::Time;

/// The rate at which the CANopen sensor has no clock of its own but takes a sample at each SYNC.
pub const SYNC_RATE_HZ: u32 = 1000;
/// Greatest sample rate of the sensors on plain CAN.
const MOST_HZ: u32 = 10_000;
/// Greatest error of a free-running clock, in parts per million.
const MOST_PPM: u32 = 1000;

/// Settings of a simulated force sensor.
#[derive(Clone, Debug)]
pub struct ForceSensorSettings {
    /// Protocol of the sensor, with its settings.
    pub speaks: Speaks,
    /// Samples per second: one of the rates of a CANopen model, or 1 to 10 000 for a sensor on plain CAN. A CANopen model at
    /// 1000 takes one sample at each SYNC; in all other cases a free-running clock triggers the samples.
    pub sample_rate_hz: u32,
    /// When the free-running clock takes its first sample after power-on, in us, less than its period.
    pub phase_us: u32,
    /// Counts of a channel before its zero from which on it is overloaded, 1 to what its channels can send; 32767 on plain CAN.
    pub range_counts: i32,
}

/// Protocol of a simulated force sensor, with its settings.
#[derive(Clone, Debug)]
pub enum Speaks {
    /// CANopen.
    Canopen {
        /// Node id.
        node: NodeId,
        /// Device model, which has to be a force sensor.
        profile: Arc<DeviceProfile>,
        /// Serial number, 1018h:4.
        serial: u32,
        /// Counts per N and per N m that its objects of the scaling hold, if it has them.
        counts_per_unit: [u32; 2],
    },
    /// Plain CAN.
    PlainCan {
        /// Its codec.
        protocol: Protocol,
        /// By how much its clock is slow, in parts per million, 0 to 1000.
        slow_ppm: u32,
    },
}

/// A simulated six-axis force sensor.
///
/// The bus side is that of a device; the physical side is [`ForceSensor::measure`], to be given at each moment before
/// the frame or deadline of that moment.
#[derive(Clone, Debug)]
pub struct ForceSensor {
    speaker: Speaker,
    is_powered: bool,
}

#[derive(Clone, Debug)]
enum Speaker {
    Canopen(Box<CanopenSensor>),
    PlainCan(PlainSensor),
}

impl ForceSensor {
    /// A sensor that is switched off until [`ForceSensor::boot`].
    ///
    /// # Errors
    /// If the profile is not that of a force sensor, does not have the sample rate, or a setting is out of its range.
    pub fn new(settings: ForceSensorSettings) -> Result<Self, DeviceError> {
        let check = |setting, value: f64, is_good: bool, range| {
            if is_good { Ok(()) } else { Err(DeviceError::Setting { setting, value, range }) }
        };
        let ForceSensorSettings { speaks, sample_rate_hz: rate, phase_us, range_counts } = settings;
        let (has_clock, slow_ppm, most_counts) = match &speaks {
            Speaks::Canopen { profile, .. } => {
                let Some(sensor) = profile.force_sensor() else {
                    return Err(DeviceError::Role { profile: profile.name().to_owned(), wanted: "force sensor" });
                };
                let rates = &sensor.sample_rates_hz;
                let has_rate = if rates.is_empty() { (1..=MOST_HZ).contains(&rate) } else { rates.contains(&rate) };
                check("sample_rate_hz", rate.into(), has_rate, "a rate of the model")?;
                (rate != SYNC_RATE_HZ, 0, sensor.most_counts())
            }
            &Speaks::PlainCan { slow_ppm, .. } => {
                check("sample_rate_hz", rate.into(), (1..=MOST_HZ).contains(&rate), "1 to 10000")?;
                check("slow_ppm", slow_ppm.into(), slow_ppm <= MOST_PPM, "0 to 1000")?;
                (true, slow_ppm, i16::MAX as u32)
            }
        };
        let is_positive = range_counts >= 1 && range_counts.unsigned_abs() <= most_counts;
        check("range_counts", range_counts.into(), is_positive, "1 to what its channels can send")?;
        let is_within = u64::from(phase_us) * u64::from(rate) < 1_000_000;
        check("phase_us", phase_us.into(), is_within, "less than the sample period")?;
        // 1e9 / rate, longer by the share that the clock is slow.
        let period_ns = 1000 * u64::from(1_000_000 + slow_ppm) / u64::from(rate);
        let period = has_clock.then_some(Duration::from_nanos(period_ns));
        let sampler = Sampler::new(range_counts, period, Duration::from_micros(phase_us.into()));
        let speaker = match speaks {
            Speaks::Canopen { node, profile, serial, counts_per_unit } => {
                Speaker::Canopen(Box::new(CanopenSensor::new(node, &profile, serial, sampler, counts_per_unit)?))
            }
            Speaks::PlainCan { protocol, .. } => Speaker::PlainCan(PlainSensor::new(protocol, sampler)),
        };
        Ok(ForceSensor { speaker, is_powered: false })
    }

    fn sampler(&mut self) -> &mut Sampler {
        match &mut self.speaker {
            Speaker::Canopen(sensor) => &mut sensor.device.sampler,
            Speaker::PlainCan(sensor) => &mut sensor.sampler,
        }
    }

    /// Switches the sensor on. A sensor on plain CAN sends nothing until a command starts it.
    pub fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        self.is_powered = true;
        match &mut self.speaker {
            Speaker::Canopen(sensor) => sensor.boot(now, out),
            Speaker::PlainCan(sensor) => sensor.boot(now),
        }
    }

    /// Switches the sensor off: silent and deaf.
    pub fn switch_off(&mut self) {
        self.is_powered = false;
    }

    /// Sets the reading of the channels at this moment, in counts.
    pub fn measure(&mut self, counts: [i32; CHANNELS]) {
        self.sampler().measure(counts);
    }

    /// Sets the clock to a share of its rate, 0 (no samples any more) to 1. A sensor whose clock is SYNC leaves
    /// samples out.
    pub fn set_clock_rate(&mut self, share: f64) {
        self.sampler().set_clock_rate(share);
    }

    /// Restarts a free-running clock at this moment, with a sample at once. Its phase then counts from this moment.
    pub fn begin_clock(&mut self, now: Time) {
        self.sampler().begin_clock(now);
    }

    /// If the sensor has a free-running clock, sets the time of the next sample to `next` and the period to `period`.
    pub fn set_clock(&mut self, next: Time, period: Duration) {
        self.sampler().set_clock(next, period);
    }

    /// Makes the status report invalid samples, or valid samples again. A streaming sensor can show an overload alone.
    pub fn set_invalid(&mut self, is_invalid: bool) {
        self.sampler().set_invalid(is_invalid);
    }

    /// Takes one frame from the bus.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        match &mut self.speaker {
            _ if !self.is_powered => {}
            Speaker::Canopen(sensor) => sensor.on_frame(now, frame, out),
            Speaker::PlainCan(sensor) => sensor.on_frame(frame, out),
        }
    }

    /// Does what is due: timers of the node, and a sample of the free-running clock.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        match &mut self.speaker {
            _ if !self.is_powered => {}
            Speaker::Canopen(sensor) => sensor.poll(now, out),
            Speaker::PlainCan(sensor) => sensor.poll(now, out),
        }
    }

    /// When to poll next.
    pub fn next_deadline(&self) -> Time {
        match &self.speaker {
            _ if !self.is_powered => Time::NEVER,
            Speaker::Canopen(sensor) => sensor.next_deadline(),
            Speaker::PlainCan(sensor) => sensor.sampler.next_tick(),
        }
    }
}
