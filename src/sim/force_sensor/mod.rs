//! A simulated six-axis force sensor: a CANopen device with its own sample clock.

#[cfg(test)]
mod tests;

use std::time::Duration;

use yieldwall_drives::objects::{self as cia, AUTO_ZERO_SIGNATURE};
use yieldwall_drives::profiles::{DeviceProfile, Role, STATUS_OVERLOAD};

use super::DeviceError;
use super::device::{declare, dictionary, handle, mapping, shown};
use crate::canopen::{
    AbortCode, Access, Address, Application, CanopenError, Frame, Handle, Node, NodeId, ObjectDictionary, Outbox,
    PdoParameters, Reset, Time, cob,
};

/// Channels: Fx Fy Fz Tx Ty Tz.
const CHANNELS: usize = 6;

/// The rate at which the sensor has no clock of its own but takes a sample at each SYNC.
const SYNC_RATE_HZ: u32 = 1000;

/// Settings of a simulated force sensor.
#[derive(Clone, Copy, Debug)]
pub struct ForceSensorSettings {
    /// Node id.
    pub node: NodeId,
    /// Device model, which has to be a force sensor.
    pub profile: &'static DeviceProfile,
    /// Serial number, 1018h:4.
    pub serial: u32,
    /// Samples per second, one of the model's: at 1000 one at each SYNC, else from a free-running clock.
    pub sample_rate_hz: u32,
    /// When the free-running clock takes its first sample after power-on, in us, less than its period.
    pub phase_us: u32,
    /// Counts of a channel before its zero from which on it is overloaded, 1 to 32767.
    pub range_counts: i32,
}

/// A simulated six-axis force sensor.
///
/// The bus side is that of a device; the physical side is [`ForceSensor::measure`], to be given at each moment before
/// the frame or deadline of that moment. A sample becomes six process values (7130h), a status byte and a counter at
/// once; the TPDOs carry the newest sample.
#[derive(Clone, Debug)]
pub struct ForceSensor {
    node: Node,
    device: Device,
    is_powered: bool,
}

#[derive(Clone, Debug)]
struct Device {
    process: [Handle<i16>; CHANNELS],
    status: Handle<u8>,
    counter: Handle<u8>,
    range_counts: i32,
    /// `None` if SYNC is the clock.
    period: Option<Duration>,
    phase: Duration,
    next_sample: Time,
    present: [i32; CHANNELS],
    zero: [i32; CHANNELS],
    sample_count: u8,
    clock_rate: f64,
    /// Share of a sample period that has passed since the last sample.
    clock_phase: f64,
    status_bits: u8,
}

impl ForceSensor {
    /// A sensor that is switched off until [`ForceSensor::boot`].
    ///
    /// # Errors
    /// If the profile is not that of a force sensor, does not have the sample rate, or the range is not 1 to 32767.
    pub fn new(settings: ForceSensorSettings) -> Result<Self, DeviceError> {
        let Role::ForceSensor { sample_rates_hz, .. } = settings.profile.role else {
            return Err(DeviceError::Role { profile: settings.profile.name, wanted: "force sensor" });
        };
        let check = |setting, value: f64, is_good: bool, range| {
            if is_good { Ok(()) } else { Err(DeviceError::Setting { setting, value, range }) }
        };
        let rate = settings.sample_rate_hz;
        check("sample_rate_hz", rate.into(), sample_rates_hz.contains(&rate), "a rate of the model")?;
        let is_positive = (1..=i32::from(i16::MAX)).contains(&settings.range_counts);
        check("range_counts", settings.range_counts.into(), is_positive, "1 to 32767")?;
        let is_within = u64::from(settings.phase_us) * u64::from(rate) < 1_000_000;
        check("phase_us", settings.phase_us.into(), is_within, "less than the sample period")?;
        let od = build(&settings)?;
        let device = Device::new(&od, &settings)?;
        Ok(ForceSensor { node: Node::new(settings.node, od)?, device, is_powered: false })
    }

    /// Switches the sensor on.
    pub fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        self.is_powered = true;
        self.node.boot(now, &mut self.device, out);
    }

    /// Switches the sensor off: silent and deaf.
    pub fn switch_off(&mut self) {
        self.is_powered = false;
    }

    /// What the channels read at this moment, in counts.
    pub fn measure(&mut self, counts: [i32; CHANNELS]) {
        self.device.present = counts;
    }

    /// Has the clock run at a share of its rate, 0 (no samples any more) to 1. A sensor whose clock is SYNC leaves
    /// samples out.
    pub fn set_clock_rate(&mut self, share: f64) {
        self.device.clock_rate = share.clamp(0.0, 1.0);
    }

    /// Has the status byte show these bits beside its own.
    pub fn set_status_bits(&mut self, bits: u8) {
        self.device.status_bits = bits;
    }

    /// Takes one frame from the bus.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        if self.is_powered {
            self.node.on_frame(now, frame, &mut self.device, out);
        }
    }

    /// Does what is due: timers of the node, and a sample of the free-running clock.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if self.is_powered {
            self.device.poll(now, self.node.od_mut());
            self.node.poll(now, &mut self.device, out);
        }
    }

    /// When to poll next.
    pub fn next_deadline(&self) -> Time {
        if self.is_powered { self.node.next_deadline().min(self.device.next_sample) } else { Time::NEVER }
    }
}

fn build(settings: &ForceSensorSettings) -> Result<ObjectDictionary, CanopenError> {
    let channels = 1..=CHANNELS as u8;
    let mut builder = dictionary(settings.node, settings.profile, settings.serial)
        .object(shown(cia::SENSOR_STATUS))
        .object(shown(cia::SENSOR_SAMPLE_COUNTER))
        .highest_sub(cia::AUTO_ZERO.index, CHANNELS as u8)
        .objects(channels.clone().map(|sub| declare(cia::AUTO_ZERO.at(sub), 0).access(Access::WriteOnly)))
        .highest_sub(cia::PROCESS_VALUE.index, CHANNELS as u8)
        .objects(channels.map(|sub| shown(cia::PROCESS_VALUE.at(sub))));
    // As delivered, the TPDOs are mapped but switched off: the master decides who talks on its bus.
    for tpdo in settings.profile.pdos(None).map_or(&[][..], |pdos| pdos.tpdo) {
        let id = cob::tpdo(tpdo.number, settings.node).unwrap_or_default();
        builder = builder.tpdo(tpdo.number, &PdoParameters::synchronous(id, &mapping(tpdo.entries)).unused());
    }
    builder.build()
}

impl Device {
    fn new(od: &ObjectDictionary, settings: &ForceSensorSettings) -> Result<Self, CanopenError> {
        let mut process = [Handle::NOWHERE; CHANNELS];
        for (sub, to) in (1..).zip(&mut process) {
            *to = handle(od, cia::PROCESS_VALUE.at(sub))?;
        }
        let has_clock = settings.sample_rate_hz != SYNC_RATE_HZ;
        Ok(Device {
            process,
            status: handle(od, cia::SENSOR_STATUS)?,
            counter: handle(od, cia::SENSOR_SAMPLE_COUNTER)?,
            range_counts: settings.range_counts,
            period: has_clock.then(|| Duration::from_nanos(1_000_000_000 / u64::from(settings.sample_rate_hz))),
            phase: Duration::from_micros(settings.phase_us.into()),
            next_sample: Time::NEVER,
            present: [0; CHANNELS],
            zero: [0; CHANNELS],
            sample_count: 0,
            clock_rate: 1.0,
            clock_phase: 0.0,
            status_bits: 0,
        })
    }

    fn poll(&mut self, now: Time, od: &mut ObjectDictionary) {
        if let Some(period) = self.period
            && self.next_sample <= now
        {
            self.tick(od);
            self.next_sample = (self.next_sample + period).max(now + Duration::from_nanos(1));
        }
    }

    /// One period of the clock at its true rate.
    fn tick(&mut self, od: &mut ObjectDictionary) {
        self.clock_phase += self.clock_rate;
        if self.clock_phase >= 1.0 {
            self.clock_phase -= 1.0;
            self.sample(od);
        }
    }

    fn sample(&mut self, od: &mut ObjectDictionary) {
        self.sample_count = self.sample_count.wrapping_add(1);
        od.set(self.counter, self.sample_count);
        let mut status = self.status_bits;
        for ((&handle, &present), &zero) in self.process.iter().zip(&self.present).zip(&self.zero) {
            // At the end of the range the converter is cut off before the zero is taken.
            let raw = present.clamp(-self.range_counts, self.range_counts);
            if raw.abs() == self.range_counts {
                status |= STATUS_OVERLOAD;
            }
            od.set(handle, (raw - zero).clamp(i16::MIN.into(), i16::MAX.into()) as i16);
        }
        od.set(self.status, status);
    }
}

impl Application for Device {
    fn before_write(&mut self, _od: &mut ObjectDictionary, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        if at.index == cia::AUTO_ZERO.index && data != AUTO_ZERO_SIGNATURE.to_le_bytes() {
            return Err(AbortCode::VALUE);
        }
        Ok(())
    }

    fn after_write(&mut self, _od: &mut ObjectDictionary, at: Address) {
        let channel = usize::from(at.subindex).wrapping_sub(1);
        if at.index == cia::AUTO_ZERO.index
            && let (Some(zero), Some(present)) = (self.zero.get_mut(channel), self.present.get(channel))
        {
            *zero = (*present).clamp(-self.range_counts, self.range_counts);
        }
    }

    fn on_sync(&mut self, _now: Time, od: &mut ObjectDictionary) {
        if self.period.is_none() {
            self.tick(od);
        }
    }

    fn on_reset(&mut self, now: Time, _od: &mut ObjectDictionary, reset: Reset) {
        if reset == Reset::Node {
            self.zero = [0; CHANNELS];
            self.sample_count = 0;
            self.next_sample = if self.period.is_some() { now + self.phase } else { Time::NEVER };
        }
    }
}
