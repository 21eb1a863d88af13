//! A six-axis sensor on EtherCAT, with counts of 32 bits and a calibration that is read from the device.

use super::super::DeviceError;
use super::super::device::mark;
use super::super::ethercat::{Communication, EthercatApplication, PdoMapping};
use super::sampler::{CHANNELS, Conversion, Sampler};
use super::{MOST_HZ, MOST_PPM};
use std::time::Duration;
use yieldwall_fieldbus::objects::{
    Access, Address, DataType, DeviceIdentity, Handle, Mappable, Object, ObjectDictionary, Reset, ServedDevice,
};
use yieldwall_fieldbus::time::Time;

/// The calibration record.
const CALIBRATION: u16 = 0x2040;
/// The same bytes as the value of one object, for masters without complete access; no sensor of ATI has it.
const CALIBRATION_BYTES: u16 = 0x2041;
/// Force in N and torque in N m, as the calibration record says it.
const UNIT_N: u8 = 2;
const UNIT_N_M: u8 = 3;
/// Status bits: a channel is beyond its range; the hardware has an error; any error.
const STATUS_RANGE: u32 = 1 << 27;
const STATUS_HARDWARE: u32 = 1 << 5;
const STATUS_ANY: u32 = 1 << 31;
/// Bit of control word 1: what is measured becomes zero.
const CONTROL_BIAS: u32 = 1;
/// Shortest cycle that it works with, in ns.
const SHORTEST_CYCLE_NS: u32 = 62_500;
const NAMES: [&str; CHANNELS] = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"];

/// Settings of a six-axis sensor on EtherCAT.
#[derive(Clone, Debug)]
pub struct ForceTorqueSettings {
    /// Vendor, product, revision, serial number and name.
    pub identity: DeviceIdentity,
    /// Samples per second of its own clock, 1 to 10 000.
    pub sample_rate_hz: u32,
    /// By how much its clock is slow, in parts per million, 0 to 1000.
    pub slow_ppm: u32,
    /// When it takes its first sample after power-on, in us, less than its period.
    pub phase_us: u32,
    /// Counts of a channel before its zero from which on it is overloaded, 1 and up.
    pub range_counts: i32,
    /// Counts per N, 1 and up.
    pub counts_per_n: i32,
    /// Counts per N m, 1 and up.
    pub counts_per_n_m: i32,
}

impl ForceTorqueSettings {
    /// A sensor of 1 000 000 counts per N and N m, 8000 samples a second and a range of 500 N.
    pub fn new(serial: u32) -> Self {
        ForceTorqueSettings {
            identity: DeviceIdentity {
                device_type: 0,
                name: "six-axis force/torque sensor".to_owned(),
                vendor_id: 0x0000_0732,
                product_code: 0x2648_3052,
                revision: 1,
                serial,
            },
            sample_rate_hz: 8000,
            slow_ppm: 0,
            phase_us: 0,
            range_counts: 500_000_000,
            counts_per_n: 1_000_000,
            counts_per_n_m: 1_000_000,
        }
    }
}

/// A simulated six-axis sensor, to be put behind a [`Controller`](crate::ethercat::Controller), with the objects of an ATI
/// sensor: 6000h:1 to :6 counts, 6010h status, 6020h sample counter, 7010h control, 2040h calibration of 278 bytes, which 2041h has as one
/// value.
///
/// It samples by its own clock. The physical side is [`ForceTorqueSensor::measure`].
///
/// Control word 1 has the zero in bit 0; other bits are kept and do nothing.
#[derive(Clone, Debug)]
pub struct ForceTorqueSensor {
    od: ObjectDictionary,
    sampler: Sampler,
    channels: [Handle<i32>; CHANNELS],
    status: Handle<u32>,
    counter: Handle<u32>,
    control: Handle<u32>,
    last_control: u32,
}

impl ForceTorqueSensor {
    /// A sensor.
    ///
    /// # Errors
    /// If a setting is out of its range.
    pub fn new(settings: &ForceTorqueSettings) -> Result<Self, DeviceError> {
        let check = |setting, value: f64, is_good: bool, range| {
            if is_good { Ok(()) } else { Err(DeviceError::Setting { setting, value, range }) }
        };
        let rate = settings.sample_rate_hz;
        check("sample_rate_hz", rate.into(), (1..=MOST_HZ).contains(&rate), "1 to 10000")?;
        check("slow_ppm", settings.slow_ppm.into(), settings.slow_ppm <= MOST_PPM, "0 to 1000")?;
        for (setting, value) in [
            ("range_counts", settings.range_counts),
            ("counts_per_n", settings.counts_per_n),
            ("counts_per_n_m", settings.counts_per_n_m),
        ] {
            check(setting, value.into(), value >= 1, "1 and up")?;
        }
        let is_within = u64::from(settings.phase_us) * u64::from(rate) < 1_000_000;
        check("phase_us", settings.phase_us.into(), is_within, "less than the sample period")?;
        let period = Duration::from_nanos(1000 * u64::from(1_000_000 + settings.slow_ppm) / u64::from(rate));
        let phase = Duration::from_micros(settings.phase_us.into());
        let od = build(settings)?;
        let mut channels = [Handle::NOWHERE; CHANNELS];
        for (handle, sub) in channels.iter_mut().zip(1..) {
            *handle = od.handle(0x6000, sub)?;
        }
        Ok(ForceTorqueSensor {
            sampler: Sampler::new(settings.range_counts, Some(period), phase),
            channels,
            status: od.handle(0x6010, 0)?,
            counter: od.handle(0x6020, 0)?,
            control: od.handle(0x7010, 1)?,
            last_control: 0,
            od,
        })
    }

    /// What the channels read at this moment, in counts.
    pub fn measure(&mut self, counts: [i32; CHANNELS]) {
        self.sampler.measure(counts);
    }

    /// Has the clock take its next sample at this moment, and the others so long after one another.
    pub fn set_clock(&mut self, next: Time, period: Duration) {
        self.sampler.set_clock(next, period);
    }

    /// Has the clock run at a share of its rate, 0 (no samples any more) to 1.
    pub fn set_clock_rate(&mut self, share: f64) {
        self.sampler.set_clock_rate(share);
    }

    /// Has the status say that the hardware has an error, or no longer.
    pub fn set_invalid(&mut self, is_invalid: bool) {
        self.sampler.set_invalid(is_invalid);
    }

    fn show(&mut self, conversion: &Conversion) {
        for (&handle, &counts) in self.channels.iter().zip(&conversion.counts) {
            self.od.set(handle, counts);
        }
        let bit = |is_set: bool, mask: u32| if is_set { mask | STATUS_ANY } else { 0 };
        let status = bit(conversion.is_overloaded, STATUS_RANGE) | bit(conversion.is_invalid, STATUS_HARDWARE);
        self.od.set(self.status, status);
        self.od.set(self.counter, self.od.get(self.counter).wrapping_add(1));
    }

    fn take_control(&mut self) {
        let control = self.od.get(self.control);
        if control & !self.last_control & CONTROL_BIAS != 0 {
            (0..CHANNELS).for_each(|channel| self.sampler.take_zero(channel));
        }
        self.last_control = control;
    }
}

fn build(settings: &ForceTorqueSettings) -> Result<ObjectDictionary, DeviceError> {
    let channels = (1..=CHANNELS as u8).map(|sub| (0x6000, sub, 32));
    let inputs: Vec<_> = channels.chain([(0x6010, 0, 32), (0x6020, 0, 32)]).collect();
    let fixed = |index, entries| PdoMapping { index, entries, is_fixed: true, is_assigned: true };
    let communication = Communication {
        identity: &settings.identity,
        outputs: vec![fixed(0x1601, vec![(0x7010, 1, 32), (0x7010, 2, 32)])],
        inputs: vec![fixed(0x1a00, inputs)],
        mapping_entries: 0,
        shortest_cycle_ns: SHORTEST_CYCLE_NS,
    };
    let shown = |object: Object, name| object.access(Access::ReadOnly).mappable(Mappable::Tpdo).named(name);
    let commanded = |sub, name| Object::new(0x7010, sub, 0u32).mappable(Mappable::Rpdo).named(name);
    let builder = ObjectDictionary::builder()
        .objects(communication.objects())
        .objects(mark())
        .objects(calibration(settings))
        .object(Object::highest_sub(0x6000, CHANNELS as u8).named("Counts"))
        .objects(NAMES.into_iter().zip(1..).map(|(name, sub)| shown(Object::new(0x6000, sub, 0i32), name)))
        .object(shown(Object::new(0x6010, 0, 0u32), "Status"))
        .object(shown(Object::new(0x6020, 0, 0u32), "Sample counter"))
        .object(Object::highest_sub(0x7010, 2).named("Control"))
        .objects([commanded(1, "Control 1"), commanded(2, "Control 2")]);
    Ok(builder.build()?)
}

/// The calibration record: texts, the matrix in millionths, units, range, counts per unit, and what the sensor bears.
fn calibration(settings: &ForceTorqueSettings) -> Vec<Object> {
    let mut objects = Vec::new();
    let mut sub = 0..;
    let mut next = || sub.next().unwrap_or(u8::MAX);
    next();
    let shown = |object: Object, name| object.access(Access::ReadOnly).named(name);
    let serial = format!("FT{:06}", settings.identity.serial % 1_000_000);
    for (text, len, name) in [
        (serial.as_str(), 8, "Serial number"),
        ("SI-500-20", 30, "Calibration part number"),
        ("SIM", 8, "Calibration family"),
        ("2026-01-01", 30, "Calibration date"),
    ] {
        let mut bytes = text.as_bytes().to_vec();
        bytes.resize(len, 0);
        objects.push(shown(Object::bytes(CALIBRATION, next(), DataType::VisibleString, &bytes, len), name));
    }
    for place in 0..CHANNELS * CHANNELS {
        let value = if place % (CHANNELS + 1) == 0 { 1_000_000i32 } else { 0 };
        objects.push(shown(Object::new(CALIBRATION, next(), value), "Matrix"));
    }
    objects.push(shown(Object::new(CALIBRATION, next(), UNIT_N), "Force unit"));
    objects.push(shown(Object::new(CALIBRATION, next(), UNIT_N_M), "Torque unit"));
    for _ in 0..CHANNELS {
        objects.push(shown(Object::new(CALIBRATION, next(), settings.range_counts), "Maximum counts"));
    }
    objects.push(shown(Object::new(CALIBRATION, next(), settings.counts_per_n), "Counts per force"));
    objects.push(shown(Object::new(CALIBRATION, next(), settings.counts_per_n_m), "Counts per torque"));
    for _ in 0..CHANNELS {
        objects.push(shown(Object::new(CALIBRATION, next(), settings.range_counts), "Peak load"));
    }
    let highest = next() - 1;
    let bytes = objects.iter().flat_map(|object| object.value().iter().copied()).collect::<Vec<u8>>();
    let whole = Object::bytes(CALIBRATION_BYTES, 0, DataType::OctetString, &bytes, bytes.len());
    objects.insert(0, Object::highest_sub(CALIBRATION, highest).named("Calibration"));
    objects.push(shown(whole, "Calibration as one value"));
    objects
}

impl ServedDevice for ForceTorqueSensor {
    fn od(&self) -> &ObjectDictionary {
        &self.od
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.od
    }

    fn after_write(&mut self, at: Address) {
        if at.index == 0x7010 {
            self.take_control();
        }
    }

    fn outputs_applied(&mut self, _now: Time, _number: u8) {
        self.take_control();
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        if reset == Reset::Node {
            self.last_control = 0;
            self.sampler.reset(now);
        }
    }
}

impl EthercatApplication for ForceTorqueSensor {
    fn poll(&mut self, now: Time) {
        if let Some(conversion) = self.sampler.poll(now) {
            self.show(&conversion);
        }
    }

    fn next_deadline(&self) -> Time {
        self.sampler.next_tick()
    }
}
