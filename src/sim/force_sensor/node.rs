//! The sensor on CANopen.

use yieldwall_drives::objects::{self as cia, AUTO_ZERO_SIGNATURE};
use yieldwall_drives::profiles::DeviceProfile;

use super::super::DeviceError;
use super::super::device::{declare, dictionary, handle, mapping, shown};
use super::sampler::{CHANNELS, Conversion, Sampler};
use crate::canopen::{
    AbortCode, Access, Address, Application, CanopenError, Frame, Handle, Node, NodeId, ObjectDictionary, Outbox,
    PdoParameters, Reset, Time, cob,
};

/// A CANopen node whose samples become six process values (7130h), a status byte and a counter at once; the TPDOs carry
/// the newest sample.
#[derive(Clone, Debug)]
pub(super) struct CanopenSensor {
    node: Node,
    pub(super) device: Device,
}

#[derive(Clone, Debug)]
pub(super) struct Device {
    pub(super) sampler: Sampler,
    process: [Handle<i16>; CHANNELS],
    status: Handle<u8>,
    counter: Handle<u8>,
    sample_count: u8,
}

impl CanopenSensor {
    pub(super) fn new(
        node: NodeId,
        profile: &DeviceProfile,
        serial: u32,
        sampler: Sampler,
    ) -> Result<Self, DeviceError> {
        let od = build(node, profile, serial)?;
        let device = Device::new(&od, sampler)?;
        Ok(Self { node: Node::new(node, od)?, device })
    }

    pub(super) fn boot(&mut self, now: Time, out: &mut impl Outbox) {
        self.node.boot(now, &mut self.device, out);
    }

    pub(super) fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) {
        self.node.on_frame(now, frame, &mut self.device, out);
    }

    pub(super) fn poll(&mut self, now: Time, out: &mut impl Outbox) {
        if let Some(conversion) = self.device.sampler.poll(now) {
            self.device.show(self.node.od_mut(), &conversion);
        }
        self.node.poll(now, &mut self.device, out);
    }

    pub(super) fn next_deadline(&self) -> Time {
        self.node.next_deadline().min(self.device.sampler.next_tick())
    }
}

fn build(node: NodeId, profile: &DeviceProfile, serial: u32) -> Result<ObjectDictionary, CanopenError> {
    let channels = 1..=CHANNELS as u8;
    let mut builder = dictionary(node, profile, serial)
        .object(shown(cia::SENSOR_STATUS))
        .object(shown(cia::SENSOR_SAMPLE_COUNTER))
        .highest_sub(cia::AUTO_ZERO.index, CHANNELS as u8)
        .objects(channels.clone().map(|sub| declare(cia::AUTO_ZERO.at(sub), 0).access(Access::WriteOnly)))
        .highest_sub(cia::PROCESS_VALUE.index, CHANNELS as u8)
        .objects(channels.map(|sub| shown(cia::PROCESS_VALUE.at(sub))));
    // As delivered, the TPDOs are mapped but switched off: the master decides who talks on its bus.
    for tpdo in profile.pdos(None).map_or(&[][..], |pdos| pdos.tpdo) {
        let id = cob::tpdo(tpdo.number, node).unwrap_or_default();
        builder = builder.tpdo(tpdo.number, &PdoParameters::synchronous(id, &mapping(tpdo.entries)).unused());
    }
    builder.build()
}

impl Device {
    fn new(od: &ObjectDictionary, sampler: Sampler) -> Result<Self, CanopenError> {
        let mut process = [Handle::NOWHERE; CHANNELS];
        for (sub, to) in (1..).zip(&mut process) {
            *to = handle(od, cia::PROCESS_VALUE.at(sub))?;
        }
        Ok(Device {
            sampler,
            process,
            status: handle(od, cia::SENSOR_STATUS)?,
            counter: handle(od, cia::SENSOR_SAMPLE_COUNTER)?,
            sample_count: 0,
        })
    }

    fn show(&mut self, od: &mut ObjectDictionary, conversion: &Conversion) {
        self.sample_count = self.sample_count.wrapping_add(1);
        od.set(self.counter, self.sample_count);
        for (&handle, &counts) in self.process.iter().zip(&conversion.counts) {
            od.set(handle, counts);
        }
        od.set(self.status, conversion.status);
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
        if at.index == cia::AUTO_ZERO.index {
            self.sampler.take_zero(usize::from(at.subindex).wrapping_sub(1));
        }
    }

    fn on_sync(&mut self, _now: Time, od: &mut ObjectDictionary) {
        if !self.sampler.has_clock()
            && let Some(conversion) = self.sampler.tick()
        {
            self.show(od, &conversion);
        }
    }

    fn on_reset(&mut self, now: Time, _od: &mut ObjectDictionary, reset: Reset) {
        if reset == Reset::Node {
            self.sample_count = 0;
            self.sampler.reset(now);
        }
    }
}
