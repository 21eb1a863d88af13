//! The sensor on CANopen.

use yieldwall_drives::objects::{self as cia, AUTO_ZERO_SIGNATURE};
use yieldwall_drives::profiles::{DeviceProfile, ForceSensor};

use super::super::DeviceError;
use super::super::device::{declare, entries, identity, mark};
use super::sampler::{CHANNELS, Conversion, Sampler};
use super::shown::{self, Shown, Zeroing};
use yieldwall_fieldbus::canopen::{
    Application, CanopenError, CommunicationProfile, Frame, Node, NodeId, Outbox, PdoParameters, cob,
};
use yieldwall_fieldbus::objects::{AbortCode, Access, Address, Object, ObjectDictionary, Reset, ServedDevice};
use yieldwall_fieldbus::time::Time;

/// A CANopen node whose samples become six process values, a status and a counter at once; the TPDOs carry the newest sample.
#[derive(Clone, Debug)]
pub(super) struct CanopenSensor {
    node: Node,
    pub(super) device: Device,
}

#[derive(Clone, Debug)]
pub(super) struct Device {
    od: ObjectDictionary,
    pub(super) sampler: Sampler,
    shown: Shown,
    zeroing: Zeroing,
}

impl CanopenSensor {
    pub(super) fn new(
        node: NodeId,
        profile: &DeviceProfile,
        serial: u32,
        sampler: Sampler,
        counts_per_unit: [u32; 2],
    ) -> Result<Self, DeviceError> {
        let role = || DeviceError::Role { profile: profile.name().to_owned(), wanted: "force sensor" };
        let model = profile.force_sensor().ok_or_else(role)?;
        let od = build(node, profile, model, serial, counts_per_unit)?;
        let device = Device {
            shown: Shown::new(&od, model)?,
            od,
            sampler,
            // Auto zero is that of the simulated sensor, in each channel.
            zeroing: Zeroing::new(model, cia::AUTO_ZERO.index),
        };
        Ok(Self { node: Node::new(node, device.od())?, device })
    }

    pub(super) fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        self.node.boot(now, &mut self.device, out);
    }

    pub(super) fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        self.node.on_frame(now, frame, &mut self.device, out);
    }

    pub(super) fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if let Some(conversion) = self.device.sampler.poll(now) {
            self.device.show(&conversion);
        }
        self.node.poll(now, &mut self.device, out);
    }

    pub(super) fn next_deadline(&self) -> Time {
        self.node.next_deadline().min(self.device.sampler.next_tick())
    }
}

fn build(
    node: NodeId,
    profile: &DeviceProfile,
    model: &ForceSensor,
    serial: u32,
    counts_per_unit: [u32; 2],
) -> Result<ObjectDictionary, DeviceError> {
    let builder = ObjectDictionary::builder()
        .objects(communication(node, profile, model, serial)?)
        .objects(mark())
        .highest_sub(cia::AUTO_ZERO.index, CHANNELS as u8)
        .objects((1..=CHANNELS as u8).map(|sub| declare(cia::AUTO_ZERO.at(sub), 0).access(Access::WriteOnly)));
    Ok(shown::declare(builder, model, counts_per_unit)?.build()?)
}

/// Returns the CANopen declaration of the sensor. As delivered, its TPDOs are mapped but switched off: the master decides which
/// nodes send on its bus.
fn communication(
    node: NodeId,
    profile: &DeviceProfile,
    model: &ForceSensor,
    serial: u32,
) -> Result<Vec<Object>, CanopenError> {
    let own = CommunicationProfile::new(node, &identity(profile, serial)).mapping_entries(model.mapping_entries);
    let [_, tpdos] = profile.mapped(None).unwrap_or_default();
    let with_tpdos = tpdos.iter().try_fold(own, |own, tpdo| {
        let number = tpdo.canopen_number();
        let id = cob::tpdo(number, node).ok_or(CanopenError::PdoNumber(number))?;
        Ok::<_, CanopenError>(own.tpdo(number, &PdoParameters::synchronous(id, &entries(tpdo)).unused()))
    });
    with_tpdos?.objects()
}

impl Device {
    fn show(&mut self, conversion: &Conversion) {
        self.shown.show(&mut self.od, conversion);
    }
}

impl ServedDevice for Device {
    fn od(&self) -> &ObjectDictionary {
        &self.od
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.od
    }

    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        if at.index == cia::AUTO_ZERO.index && data != AUTO_ZERO_SIGNATURE.to_le_bytes() {
            return Err(AbortCode::VALUE);
        }
        Ok(())
    }

    fn after_write(&mut self, at: Address) {
        if at.index == cia::AUTO_ZERO.index {
            self.sampler.take_zero(usize::from(at.sub).wrapping_sub(1));
        }
        self.zeroing.look(&self.od, &mut self.sampler, Some(at));
    }

    fn sample(&mut self, _now: Time) {
        if !self.sampler.has_clock()
            && let Some(conversion) = self.sampler.tick()
        {
            self.show(&conversion);
        }
    }

    fn reset(&mut self, now: Time, reset: Reset) {
        if reset == Reset::Node {
            self.shown.reset();
            self.zeroing.reset();
            self.sampler.reset(now);
        }
    }
}

impl Application for Device {}
