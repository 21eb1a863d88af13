//! A six-axis sensor on EtherCAT, by its profile.

use std::sync::Arc;
use std::time::Duration;

use super::super::DeviceError;
use super::super::device::{entries, mark};
use super::super::ethercat::{Communication, EthercatApplication, PdoMapping};
use super::sampler::{CHANNELS, Sampler};
use super::shown::{self, Shown, Zeroing};
use super::{MOST_HZ, MOST_PPM};
use yieldwall_drives::profiles::{DeviceProfile, ForceSensor, MappedPdo, Revisions};
use yieldwall_fieldbus::objects::{
    Access, Address, DataType, DeviceIdentity, Object, ObjectDictionary, Reset, ServedDevice,
};
use yieldwall_fieldbus::time::Time;

/// The vendor whose sensors have a calibration record.
const WITH_CALIBRATION: u32 = 0x0000_0732;
/// The calibration record.
const CALIBRATION: u16 = 0x2040;
/// The calibration bytes as the value of one object, for masters without complete access; no sensor of ATI has it.
const CALIBRATION_BYTES: u16 = 0x2041;
/// Force in N and torque in N m, as the calibration record says it.
const UNIT_N: u8 = 2;
const UNIT_N_M: u8 = 3;
/// Shortest cycle that it works with, in ns.
const SHORTEST_CYCLE_NS: u32 = 62_500;
/// No object, of which writes would be another's business.
const NONE: u16 = 0;

/// Settings of a six-axis sensor on EtherCAT.
#[derive(Clone, Debug)]
pub struct ForceTorqueSettings {
    /// Device model, which has to be a force sensor.
    pub profile: Arc<DeviceProfile>,
    /// Serial number.
    pub serial: u32,
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
    pub fn new(profile: Arc<DeviceProfile>, serial: u32) -> Self {
        ForceTorqueSettings {
            profile,
            serial,
            sample_rate_hz: 8000,
            slow_ppm: 0,
            phase_us: 0,
            range_counts: 500_000_000,
            counts_per_n: 1_000_000,
            counts_per_n_m: 1_000_000,
        }
    }

    fn identity(&self) -> DeviceIdentity {
        let identity = &self.profile.identity;
        DeviceIdentity {
            device_type: identity.device_type.unwrap_or_default(),
            name: "six-axis force/torque sensor".to_owned(),
            vendor_id: identity.vendor_id,
            product_code: identity.product_codes.first().copied().unwrap_or_default(),
            revision: if identity.revisions == Revisions::Any { 1 } else { identity.revisions.example() },
            serial: self.serial,
        }
    }
}

/// A simulated six-axis sensor, to be put behind a [`Controller`](crate::ethercat::Controller), with the objects of its profile. One of ATI
/// has a calibration record of 278 bytes, 2040h, which 2041h has as one value.
///
/// It samples by its own clock. The physical side is [`ForceTorqueSensor::measure`].
#[derive(Clone, Debug)]
pub struct ForceTorqueSensor {
    od: ObjectDictionary,
    sampler: Sampler,
    shown: Shown,
    zeroing: Zeroing,
}

impl ForceTorqueSensor {
    /// A sensor.
    ///
    /// # Errors
    /// If the profile is not that of a force sensor, or a setting is out of its range.
    pub fn new(settings: &ForceTorqueSettings) -> Result<Self, DeviceError> {
        let profile = &settings.profile;
        let role = || DeviceError::Role { profile: profile.name().to_owned(), wanted: "force sensor" };
        let model = profile.force_sensor().ok_or_else(role)?;
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
        let od = build(settings, model)?;
        Ok(ForceTorqueSensor {
            shown: Shown::new(&od, model)?,
            od,
            sampler: Sampler::new(settings.range_counts, Some(period), phase),
            zeroing: Zeroing::new(model, NONE),
        })
    }

    /// Sets the present readings of the channels, in counts.
    pub fn measure(&mut self, counts: [i32; CHANNELS]) {
        self.sampler.measure(counts);
    }

    /// Sets the moment of the clock's next sample, and the period after it.
    pub fn set_clock(&mut self, next: Time, period: Duration) {
        self.sampler.set_clock(next, period);
    }

    /// Makes the clock run at a share of its rate, 0 (no samples any more) to 1.
    pub fn set_clock_rate(&mut self, share: f64) {
        self.sampler.set_clock_rate(share);
    }

    /// Makes the status report a hardware error, or no error.
    pub fn set_invalid(&mut self, is_invalid: bool) {
        self.sampler.set_invalid(is_invalid);
    }
}

fn build(settings: &ForceTorqueSettings, model: &ForceSensor) -> Result<ObjectDictionary, DeviceError> {
    let pdo = |pdo: &MappedPdo, first: u16| PdoMapping {
        index: first + pdo.number.saturating_sub(1),
        entries: entries(pdo),
        is_fixed: pdo.is_fixed,
        is_assigned: true,
    };
    let [rpdo, tpdo] = settings.profile.mapped(None).unwrap_or_default();
    let all = |pdos: &[MappedPdo], first| pdos.iter().map(|each| pdo(each, first)).collect();
    let identity = settings.identity();
    let communication = Communication {
        identity: &identity,
        outputs: all(&rpdo, 0x1600),
        inputs: all(&tpdo, 0x1a00),
        mapping_entries: model.mapping_entries,
        shortest_cycle_ns: SHORTEST_CYCLE_NS,
    };
    let builder = ObjectDictionary::builder().objects(communication.objects()).objects(mark());
    let record = if identity.vendor_id == WITH_CALIBRATION { calibration(settings) } else { Vec::new() };
    let counts_per_unit = [settings.counts_per_n, settings.counts_per_n_m].map(i32::unsigned_abs);
    Ok(shown::declare(builder.objects(record), model, counts_per_unit)?.build()?)
}

/// The calibration record: texts, the matrix in millionths, units, range, counts per unit, and what the sensor bears.
fn calibration(settings: &ForceTorqueSettings) -> Vec<Object> {
    let mut objects = Vec::new();
    let mut sub = 0..;
    let mut next = || sub.next().unwrap_or(u8::MAX);
    next();
    let shown = |object: Object, name| object.access(Access::ReadOnly).named(name);
    let serial = format!("FT{:06}", settings.serial % 1_000_000);
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
        self.zeroing.look(&self.od, &mut self.sampler, Some(at));
    }

    fn outputs_applied(&mut self, _now: Time, _number: u8) {
        self.zeroing.look(&self.od, &mut self.sampler, None);
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        if reset == Reset::Node {
            self.shown.reset();
            self.zeroing.reset();
            self.sampler.reset(now);
        }
    }
}

impl EthercatApplication for ForceTorqueSensor {
    fn poll(&mut self, now: Time) {
        if let Some(conversion) = self.sampler.poll(now) {
            self.shown.show(&mut self.od, &conversion);
        }
    }

    fn next_deadline(&self) -> Time {
        self.sampler.next_tick()
    }
}
