//! The segment as a master sees it.

mod devices;
mod rules;
mod scenarios;

use super::{Controller, ControllerSettings, Segment};
use std::time::Duration;
use yieldwall_fieldbus::ethercat::sii::{MailboxArea, Sii, protocols};
use yieldwall_fieldbus::ethercat::{frame, u16_at};
use yieldwall_fieldbus::objects::{Access, Mappable, Object, ObjectDictionary};
use yieldwall_fieldbus::time::Time;

/// A device with two bytes of outputs and two of inputs, or with four bytes of inputs alone.
fn dictionary(has_outputs: bool) -> ObjectDictionary {
    let shown = |object: Object| object.access(Access::ReadOnly).mappable(Mappable::Tpdo);
    let outputs = u8::from(has_outputs);
    let input = if has_outputs { 0x6041_0010u32 } else { 0x6000_0020 };
    ObjectDictionary::builder()
        .object(Object::new(0x1000, 0, 0x0002_0192u32).access(Access::ReadOnly))
        .object(Object::text(0x1008, 0, "a device with a name"))
        .object(Object::new(0x1600, 0, 1u8).limits(0u8, 1))
        .object(Object::new(0x1600, 1, 0x6040_0010u32))
        .object(Object::new(0x1a00, 0, 1u8).limits(0u8, 1))
        .object(Object::new(0x1a00, 1, input))
        .object(Object::new(0x1c12, 0, outputs).limits(0u8, 1))
        .object(Object::new(0x1c12, 1, 0x1600u16))
        .object(Object::new(0x1c13, 0, 1u8).limits(0u8, 1))
        .object(Object::new(0x1c13, 1, 0x1a00u16))
        .object(Object::highest_sub(0x1c32, 11))
        .object(Object::new(0x1c32, 1, 0u16))
        .object(Object::new(0x1c32, 2, 0u32))
        .object(Object::new(0x1c32, 5, 50_000u32).access(Access::ReadOnly))
        .object(Object::new(0x1c32, 11, 0u16).access(Access::ReadOnly))
        .object(Object::highest_sub(0x10f1, 2))
        .object(Object::new(0x10f1, 2, 0u16))
        .object(shown(Object::new(0x6000, 0, 0x0403_0201u32)))
        .object(Object::new(0x6040, 0, 0u16).mappable(Mappable::Rpdo))
        .object(shown(Object::new(0x6041, 0, 0x0250u16)))
        .build()
        .unwrap()
}

fn sii(alias: u16) -> Vec<u8> {
    Sii {
        alias,
        vendor_id: 0x0000_0732,
        product_code: 0x2648_3052,
        revision: 1,
        serial: 0x1234,
        receive_mailbox: MailboxArea { start: 0x1000, len: 64 },
        send_mailbox: MailboxArea { start: 0x1400, len: 64 },
        protocols: protocols::COE,
        ..Sii::default()
    }
    .write()
}

/// Two devices with outputs and one without. The second has the alias 5 and takes 1 ms for a mailbox.
fn three() -> Segment<ObjectDictionary> {
    let controller = |has_outputs, alias, mailbox_time| {
        let settings = ControllerSettings { mailbox_time, ..ControllerSettings::new(sii(alias)) };
        Controller::new(dictionary(has_outputs), settings)
    };
    let slow = Duration::from_millis(1);
    let devices =
        [controller(true, 0, Duration::ZERO), controller(true, 5, slow), controller(false, 0, Duration::ZERO)];
    Segment::new(Time(0), devices)
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

/// A frame with these datagrams, byte by byte.
fn framed(datagrams: &[u8]) -> Vec<u8> {
    let [low, high] = (datagrams.len() as u16 | 0x1000).to_le_bytes();
    [&[0xff; 6][..], &[0x10; 6], &[0x88, 0xa4, low, high], datagrams].concat()
}

/// One datagram through a segment: data and working counter.
fn ask(
    segment: &mut Segment<ObjectDictionary>,
    now: Time,
    command: frame::Command,
    adp: u16,
    ado: u16,
    data: &[u8],
) -> (Vec<u8>, u16) {
    let mut buffer = [0; 1514];
    let mut writer = frame::FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
    let at = writer.push(command, 1, frame::address(adp, ado), data).unwrap();
    let frame = writer.finish();
    segment.process(now, frame);
    (frame[at.clone()].to_vec(), u16_at(frame, at.end))
}
