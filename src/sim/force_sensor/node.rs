//! The sensor on CANopen.

use std::collections::BTreeMap;

use yieldwall_drives::objects::{self as cia, AUTO_ZERO_SIGNATURE};
use yieldwall_drives::profiles::{DeviceProfile, Entry, ForceSensor, StatusBits};

use super::super::DeviceError;
use super::super::device::{declare, identity, mapping, mark};
use super::sampler::{CHANNELS, Conversion, Sampler};
use yieldwall_fieldbus::canopen::{
    Application, CanopenError, CommunicationProfile, Frame, Node, NodeId, Outbox, PdoParameters, cob,
};
use yieldwall_fieldbus::objects::{
    AbortCode, Access, Address, DictionaryError, Handle, Mappable, Object, ObjectDictionary, Reset, ServedDevice,
};
use yieldwall_fieldbus::time::Time;

/// A CANopen node whose samples become six process values (7130h), a status byte and a counter at once; the TPDOs carry
/// the newest sample.
#[derive(Clone, Debug)]
pub(super) struct CanopenSensor {
    node: Node,
    pub(super) device: Device,
}

#[derive(Clone, Debug)]
pub(super) struct Device {
    od: ObjectDictionary,
    pub(super) sampler: Sampler,
    process: [Handle<i16>; CHANNELS],
    status: Option<Handle<u8>>,
    status_bits: StatusBits,
    counter: Option<Handle<u8>>,
    sample_count: u8,
}

impl CanopenSensor {
    pub(super) fn new(
        node: NodeId,
        profile: &DeviceProfile,
        serial: u32,
        sampler: Sampler,
    ) -> Result<Self, DeviceError> {
        let role = || DeviceError::Role { profile: profile.name().to_owned(), wanted: "force sensor" };
        let model = profile.force_sensor().ok_or_else(role)?;
        let device = Device::new(build(node, profile, model, serial)?, model, sampler)?;
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
) -> Result<ObjectDictionary, CanopenError> {
    let objects = &model.objects;
    let bytes =
        objects.status.iter().chain(&objects.sample_counter).map(|entry| Object::new(entry.index, entry.sub, 0u8));
    let channels = objects.channels.iter().map(|entry| Object::new(entry.index, entry.sub, 0i16));
    let mut builder = ObjectDictionary::builder()
        .objects(communication(node, profile, model, serial)?)
        .objects(mark())
        .objects(bytes.chain(channels).map(|object| object.access(Access::ReadOnly).mappable(Mappable::Tpdo)))
        .highest_sub(cia::AUTO_ZERO.index, CHANNELS as u8)
        .objects((1..=CHANNELS as u8).map(|sub| declare(cia::AUTO_ZERO.at(sub), 0).access(Access::WriteOnly)));
    // What lies at sub-indices says how many there are.
    let mut records = BTreeMap::new();
    for entry in objects.channels.iter().filter(|entry| entry.sub > 0) {
        let highest = records.entry(entry.index).or_insert(entry.sub);
        *highest = entry.sub.max(*highest);
    }
    for (index, highest) in records {
        builder = builder.highest_sub(index, highest);
    }
    Ok(builder.build()?)
}

/// What the sensor declares for CANopen. As delivered, its TPDOs are mapped but switched off: the master decides who talks on its
/// bus.
fn communication(
    node: NodeId,
    profile: &DeviceProfile,
    model: &ForceSensor,
    serial: u32,
) -> Result<Vec<Object>, CanopenError> {
    let own = CommunicationProfile::new(node, &identity(profile, serial)).mapping_entries(model.mapping_entries);
    let mut tpdos = model.process_data.tpdo.iter();
    let with_tpdos = tpdos.try_fold(own, |own, tpdo| {
        let number = tpdo.canopen_number();
        let id = cob::tpdo(number, node).ok_or(CanopenError::PdoNumber(number))?;
        Ok::<_, CanopenError>(own.tpdo(number, &PdoParameters::synchronous(id, &mapping(profile, tpdo)).unused()))
    });
    with_tpdos?.objects()
}

impl Device {
    fn new(od: ObjectDictionary, model: &ForceSensor, sampler: Sampler) -> Result<Self, DictionaryError> {
        let objects = &model.objects;
        let mut process = [Handle::NOWHERE; CHANNELS];
        for (entry, to) in objects.channels.iter().zip(&mut process) {
            *to = od.handle(entry.index, entry.sub)?;
        }
        let byte = |entry: &Option<Entry>| entry.as_ref().map(|entry| od.handle(entry.index, entry.sub)).transpose();
        Ok(Device {
            sampler,
            process,
            status: byte(&objects.status)?,
            status_bits: model.status_bits,
            counter: byte(&objects.sample_counter)?,
            sample_count: 0,
            od,
        })
    }

    fn show(&mut self, conversion: &Conversion) {
        self.sample_count = self.sample_count.wrapping_add(1);
        if let Some(counter) = self.counter {
            self.od.set(counter, self.sample_count);
        }
        for (&handle, counts) in self.process.iter().zip(conversion.narrow()) {
            self.od.set(handle, counts);
        }
        if let Some(status) = self.status {
            let bit = |is_set: bool, mask: u8| if is_set { mask } else { 0 };
            let StatusBits { overload, invalid } = self.status_bits;
            self.od.set(status, bit(conversion.is_overloaded, overload) | bit(conversion.is_invalid, invalid));
        }
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
            self.sample_count = 0;
            self.sampler.reset(now);
        }
    }
}

impl Application for Device {}
