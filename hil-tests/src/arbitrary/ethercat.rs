//! The EtherCAT segment, SII images and the CoE client.

use std::collections::BTreeMap;
use std::time::Duration;

use yieldwall::bus::Phase;
use yieldwall::ethercat::coe::{CoeAnswer, CoeClient, CoeEvent, CoeRequest, ListKind, MOST_BYTES};
use yieldwall::ethercat::sii::{Sii, categories};
use yieldwall::ethercat::{frame, mailbox};
use yieldwall::objects::{Address, ServedDevice};
use yieldwall::sim::ethercat::{Controller, ControllerSettings, Segment, SimulatedDevice, esi, sii};
use yieldwall::time::Time;
use yieldwall_drives::esi::Esi;

use super::bytes::{Bytes, Script};
use crate::segment::{self, Mastered};

thread_local! {
    /// A drive and a sensor that is slow, so that an hour that nobody has polled is soon made up for.
    static DEVICES: [SimulatedDevice; 2] = {
        let mut rig = segment::shipped();
        rig.value.sensor.sample_rate_hz = 100.0.try_into().expect("above 0");
        let segment = segment::segment(&rig);
        [0, 2].map(|place| segment.controller(place).expect("it is there").device().clone())
    };
    /// A master that has sent nothing yet.
    static MASTERED: Mastered = Mastered::default();
}

/// A drive and a sensor; the drive has this SII image, or its own.
fn drive_and_sensor(image: Option<&[u8]>) -> Segment<SimulatedDevice> {
    let controllers = DEVICES.with(Clone::clone).into_iter().enumerate().map(|(place, device)| {
        let own = sii(device.od()).write();
        let image = image.filter(|_| place == 0).map_or(own, <[u8]>::to_vec);
        Controller::new(device, ControllerSettings::new(image))
    });
    Segment::new(Time(0), controllers)
}

/// A segment that any frames are sent through: what comes back is as long as what was sent and comes later, and nothing stays due.
///
/// # Panics
/// If a law is broken.
pub fn ethercat_frames(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let mut segment = drive_and_sensor(None);
    let mut now = Time(0);
    while !bytes.is_empty() {
        now = now + bytes.wait();
        let kind = bytes.u8();
        let datagrams = bytes.slice();
        let mut sent = match kind % 8 {
            0 => datagrams.to_vec(),
            1 => {
                let place = usize::from(bytes.u8());
                match bytes.u8() % 4 {
                    0 => segment.set_cable(place, bytes.bool()),
                    1 => segment.set_power(now, place, bytes.bool()),
                    2 => segment.controllers_mut().for_each(|controller| controller.jump_clock(now, 1_000_000)),
                    _ => segment.controllers_mut().for_each(|controller| controller.set_silent(false)),
                }
                continue;
            }
            _ => {
                let [low, high] = (datagrams.len() as u16 | 0x1000).to_le_bytes();
                [&[0xff; 6][..], &[0x10; 6], &[0x88, 0xa4, low, high], datagrams].concat()
            }
        };
        let before = sent.clone();
        match segment.process(now, &mut sent) {
            Some(back) => assert!(back > now),
            None => assert_eq!(sent, before),
        }
        assert_eq!(sent.len(), before.len());
        segment.poll(now);
        assert!(segment.next_deadline() > now, "something stays due");
    }
}

pub(super) fn frames() -> Vec<Vec<u8>> {
    let datagram = |command: u8, adp: u16, ado: u16, data: &[u8]| {
        let mut buffer = [0; 300];
        let mut writer = frame::FrameWriter::new(&mut buffer, [0x10; 6]).expect("room");
        let command = frame::Command::from_byte(command).expect("a command");
        writer.push(command, 1, frame::address(adp, ado), data).expect("room");
        writer.finish()[frame::HEADER..].to_vec()
    };
    let sent = |script: Script, datagram: &[u8]| script.wait_us(100).raw(&[2, datagram.len() as u8]).raw(datagram);
    let sdo = |request: &[u8]| [&[10, 0, 0, 0, 0, 3][..], request, &[0; 112]].concat();
    let boot = [
        datagram(8, 0, 0x0900, &[0; 4]),
        datagram(8, 0, 0x0800, &[0, 0x10, 128, 0, 0x26, 0, 1, 0, 0, 0x14, 128, 0, 0x22, 0, 1, 0]),
        datagram(8, 0, 0x0120, &[2, 0]),
        datagram(2, 0, 0x1000, &sdo(&[0, 0x20, 0x50, 0x18, 0x10, 0, 0, 0, 0, 0])),
        datagram(1, 0, 0x1400, &[0; 128]),
        datagram(2, 0xffff, 0x1000, &sdo(&[0, 0x20, 0x50, 0x40, 0x20, 1, 0, 0, 0, 0])),
        datagram(1, 0xffff, 0x1400, &[0; 128]),
        datagram(2, 0, 0x0810, &[0, 0x18, 13, 0, 0x64, 0, 1, 0, 0, 0x1c, 15, 0, 0x20, 0, 1, 0]),
        datagram(2, 0, 0x09a0, &[0x40, 0x42, 0x0f, 0]),
        datagram(2, 0, 0x0990, &[0, 0x2d, 0x31, 1, 0, 0, 0, 0]),
        datagram(2, 0, 0x0981, &[3]),
        datagram(2, 0, 0x0120, &[4, 0]),
        datagram(2, 0, 0x1800, &[6, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 8]),
        datagram(2, 0, 0x0120, &[8, 0]),
        datagram(1, 0, 0x0130, &[0; 6]),
    ];
    vec![boot.iter().fold(Script::new(), |script, datagram| sent(script, datagram)).finish()]
}

/// A master of a segment whose frames are lost, late, doubled and changed, between those of somebody else: it sends a frame for each that comes
/// at most and one a poll beside those of a cycle, and what has failed stays so.
///
/// # Panics
/// If a law is broken.
pub fn ethercat_master(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let Mastered { mut network, mut segment, mut now, mut out } = MASTERED.with(Clone::clone);
    network.start(now, &mut out);
    let mut late: Vec<Vec<u8>> = Vec::new();
    while !bytes.is_empty() {
        let kind = bytes.u8();
        let mut replies: Vec<Vec<u8>> = Vec::new();
        for frame in std::mem::take(&mut out).drain() {
            if segment.process(now, frame).is_some() {
                replies.push(frame.to_vec());
            }
        }
        match kind % 8 {
            0 => replies.clear(),
            1 => late.append(&mut replies),
            2 => replies.append(&mut late),
            3 => replies.extend_from_within(..),
            4 => {
                let (at, change) = (bytes.u16(), bytes.slice());
                for reply in &mut replies {
                    let at = usize::from(at) % reply.len().max(1);
                    reply.iter_mut().skip(at).zip(change).for_each(|(to, byte)| *to ^= byte);
                }
            }
            5 => {
                let datagrams = bytes.slice();
                let [low, high] = (datagrams.len() as u16 | 0x1000).to_le_bytes();
                let source = if bytes.bool() { 0x12 } else { 0x02 };
                let foreign = [&[0xff; 6][..], &[source, 16, 16, 16, 16, 16], &[0x88, 0xa4, low, high], datagrams];
                replies.push(foreign.concat());
            }
            // More often than not all is well, for as many frames as one byte says.
            _ => {}
        }
        let has_failed = matches!(network.phase(), Phase::Failed(_));
        let sent = network.counts().sent;
        for reply in &replies {
            network.on_frame(now, reply, &mut out);
        }
        assert!(network.counts().sent <= sent + replies.len() as u64);
        late.truncate(8);
        if kind % 8 == 6 {
            now = now + bytes.wait();
        }
        for _ in 0..if kind % 8 == 7 { bytes.u8() } else { 1 } {
            now = now + Duration::from_micros(20);
            segment.poll(now);
            network.poll(now, &mut out);
            let mut sent = std::mem::take(&mut out);
            if kind % 8 != 7 {
                out = sent;
                break;
            }
            for frame in sent.drain() {
                if segment.process(now, frame).is_some() {
                    network.on_frame(now, frame, &mut out);
                }
            }
        }
        assert!(!has_failed || matches!(network.phase(), Phase::Failed(_)));
    }
}

pub(super) fn masters() -> Vec<Vec<u8>> {
    let well = |script: Script, times: usize| script.raw(&[7, 255].repeat(times));
    let up = well(Script::new(), 40).finish();
    let disturbed =
        [&[7u8, 255].repeat(10)[..], &[0, 3, 1, 7, 20, 2, 7, 255, 4, 20, 0, 2, 1, 255, 7, 255, 5, 4, 7, 0, 0, 0, 1]];
    vec![up, disturbed.concat()]
}

/// Any SII image: it is read or refused, what was read can be written and read again, and a device that has it takes part.
///
/// # Panics
/// If a law is broken.
pub fn ethercat_sii(bytes: &[u8]) {
    let parts = categories(bytes).count();
    assert!(parts <= bytes.len() / 4);
    if let Ok(sii) = Sii::read(bytes) {
        Sii::read(&sii.write()).expect("what was written");
    }
    let mut segment = drive_and_sensor(Some(bytes));
    for command in [1u8, 2, 4, 8] {
        let datagram = [8, 1, 0, 0, 0x20, 0x01, 2, 0, 0, 0, command, 0, 0, 0];
        let mut sent = [&[0xff; 6][..], &[0x10; 6], &[0x88, 0xa4, 14, 0x10], &datagram].concat();
        assert!(segment.process(Time(u64::from(command)), &mut sent).is_some());
    }
}

pub(super) fn images() -> Vec<Vec<u8>> {
    let sensor = DEVICES.with(|[_, sensor]| sensor.clone());
    vec![sii(sensor.od()).write()]
}

/// A CoE client that is answered anything: it ends by an answer, a refusal or its time-out.
///
/// # Panics
/// If a law is broken.
pub fn coe_client(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let mut client = CoeClient::new(Duration::from_millis(20));
    let mut now = Time(0);
    while !bytes.is_empty() {
        let at = Address::new(bytes.u16(), bytes.u8());
        let data = bytes.slice();
        let request = match bytes.u8() % 5 {
            0 => CoeRequest::Read { at, complete: bytes.bool() },
            1 => CoeRequest::Write { at, complete: bytes.bool(), data },
            2 => CoeRequest::List(ListKind::All),
            3 => CoeRequest::Object(at.index),
            _ => CoeRequest::Entry(at),
        };
        client.start(now, request).expect("nothing runs");
        while client.is_busy() {
            let mut message = [0; 128 - mailbox::HEADER];
            let len = client.message(&mut message);
            assert!(len <= message.len());
            if bytes.is_empty() {
                now = client.next_deadline();
                client.poll(now);
                assert!(!client.is_busy());
                break;
            }
            now = now + bytes.wait();
            let heard = client.on_message(now, bytes.slice());
            assert!(heard != CoeEvent::Answer || len == 0 || *client.answer() != CoeAnswer::Idle);
            client.poll(now);
        }
        if let CoeAnswer::Value(value) = client.answer() {
            assert!(value.len() <= MOST_BYTES);
        }
    }
}

pub(super) fn answers() -> Vec<Vec<u8>> {
    let answer = |script: Script, message: &[u8]| script.wait_us(100).raw(&[message.len() as u8]).raw(message);
    let read = Script::new().raw(&[0x41, 0x60, 0, 0, 0, 0]);
    let read = answer(read, &[0, 0x10, 0x10, 0x23, 1, 0, 0, 0, 0, 0]);
    let read = answer(read, &[0, 0x30, 0x41, 0x41, 0x60, 0, 9, 0, 0, 0, 1, 2]);
    let read = answer(read, &[0, 0x30, 0x01, 3, 4, 5, 6, 7, 8, 9]);
    let list = answer(Script::new().raw(&[0, 0, 0, 0, 2]), &[0, 0x80, 0x82, 0, 1, 0, 1, 0, 0, 0x10]);
    let list = answer(list, &[0, 0x80, 2, 0, 0, 0, 0x41, 0x60]);
    vec![read.finish(), list.finish()]
}

/// Any text for a device description: it is read or refused, what was read can be written and read again, and modules are plugged or refused.
///
/// # Panics
/// If a law is broken.
pub fn ethercat_description(bytes: &[u8]) {
    if let Ok(read) = Esi::read(bytes) {
        let written = Esi::read(read.write().as_bytes()).expect("what was written");
        assert_eq!((written.devices.len(), written.modules.len()), (read.devices.len(), read.modules.len()));
        for device in &read.devices {
            if let Ok(plugged) = read.plugged(device, &BTreeMap::new()) {
                let _: Result<_, _> = device.with_modules(&plugged);
            }
        }
    }
}

pub(super) fn descriptions() -> Vec<Vec<u8>> {
    let sensor = DEVICES.with(|[_, sensor]| sensor.clone());
    let plain = esi(sensor.od(), "vendor").write();
    let slots = "<Slots SlotPdoIncrement=\"1\"><Slot MinInstances=\"2\" MaxInstances=\"2\"><ModuleIdent Default=\"1\">1</ModuleIdent></Slot></Slots><Eeprom>";
    let module = "</Devices><Modules><Module><Type ModuleIdent=\"1\"/><TxPdo><Index DependOnSlot=\"1\">#x1A10</Index></TxPdo></Module></Modules>";
    let modular = plain.replace("<Eeprom>", slots).replace("</Devices>", module);
    vec![plain.into_bytes(), modular.into_bytes()]
}
