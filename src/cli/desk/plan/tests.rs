//! Listed writes against those of the boot itself.

use std::sync::{Arc, Mutex, atomic::AtomicBool};

use super::*;
use yieldwall_config::{Source, load_rig};
use yieldwall_fieldbus::Packet;
use yieldwall_fieldbus::canopen::cob;
use yieldwall_fieldbus::ethercat::frame::{Command, DatagramHeader, Datagrams};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, CanLink, SendError};
use yieldwall_rig::EmbeddedRig;
use yieldwall_rig::live::VirtualLink;
use yieldwall_service::Service;

/// A link that refuses to send anything that does more than read an object.
struct Reading(VirtualLink);

impl CanLink for Reading {
    fn now(&self) -> Time {
        self.0.now()
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.0.receive()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let command = frame.data().first().map(|byte| byte >> 5);
        assert!(frame.id() & 0x780 == 0x600 && matches!(command, Some(2 | 3)), "{frame:?} is no upload");
        self.0.send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.0.wait(until)
    }
}

/// The plan of a shipped rig, made by reading alone.
fn planned(rig: &Loaded<Rig>) -> Vec<Line> {
    let plan = master(&rig.value, &rig.value.fixture).unwrap().networks().plan().unwrap();
    let scene = rig.scene().unwrap().value;
    let link: Box<dyn CanLink> = Box::new(Reading(VirtualLink::new(&rig.value, &scene, 1).unwrap()));
    let mut desk = DeviceSession::of_rig(rig, None).unwrap();
    desk.service = Service::new(link, BusId::FIRST, Arc::new(AtomicBool::new(false)));
    let (lines, end) = lines(&rig.value, &plan, &mut [desk]).unwrap();
    assert!(end.is_ok());
    lines
}

fn node_of(line: &Line) -> Option<u8> {
    match line.owner.as_ref()?.place {
        Place::Node(id) => Some(id),
        Place::Position(_) => None,
    }
}

/// The frames of the master of a rig that is booted, enabled, stopped and left on the embedded simulation.
fn sent(rig: &Loaded<Rig>) -> Vec<Frame> {
    let frames = Arc::new(Mutex::new(Vec::new()));
    let scene = rig.scene().unwrap().value;
    let mut machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, 1).unwrap();
    let taken = Arc::clone(&frames);
    machine.set_tap(Box::new(move |_, packet| taken.lock().unwrap().extend(packet.can())));
    machine.enable().unwrap();
    drop(machine);
    Arc::try_unwrap(frames).unwrap().into_inner().unwrap()
}

/// An expedited SDO download, as object and bytes.
fn download(frame: &Frame) -> Option<(Address, Vec<u8>)> {
    let &[command, low, high, sub, ref data @ ..] = frame.data() else { return None };
    let bytes = 4 - usize::from(command >> 2 & 3);
    (command >> 5 == 1).then(|| (Address::new(u16::from_le_bytes([low, high]), sub), data[..bytes].to_vec()))
}

#[test]
fn what_is_told_is_what_the_boot_sends_and_nothing_is_written_to_tell_it() {
    for name in ["", "-csp", "-csv", "-two-buses", "-polled", "-streaming"] {
        let rig = load_rig(Source::named(&format!("builtin:paper-admittance{name}.yaml"))).unwrap();
        let (planned, sent) = (planned(&rig), sent(&rig));
        let of_boot: Vec<&Line> = planned.iter().filter(|line| line.part != "leave").collect();
        let commands = |frame: &Frame| {
            let (command, node) = nmt::decode_command(frame)?;
            Some((frame.bus(), command, node.map(|node| node.raw())))
        };
        let told: Vec<_> = of_boot
            .iter()
            .filter_map(|line| match line.what {
                What::Command(command) => Some((line.bus, command, node_of(line))),
                _ => None,
            })
            .collect();
        // Each bus has an order of its own.
        let by_bus = |mut all: Vec<(BusId, NmtCommand, Option<u8>)>| {
            all.sort_by_key(|(bus, ..)| *bus);
            all
        };
        let sent_commands = by_bus(sent.iter().filter_map(commands).collect());
        assert_eq!(by_bus(told), sent_commands, "{name}: network management");
        let mut nodes: Vec<(BusId, u8)> = of_boot.iter().filter_map(|line| Some((line.bus, node_of(line)?))).collect();
        nodes.sort();
        nodes.dedup();
        assert!(nodes.len() >= 2);
        for (bus, id) in nodes {
            let is_of = |line: &&&Line| line.bus == bus && node_of(line) == Some(id);
            let told: Vec<_> = of_boot
                .iter()
                .filter(is_of)
                .filter_map(|line| match &line.what {
                    What::Write(write) => {
                        assert!(write.old.is_some(), "{name} {id} {}", write.at);
                        (!write.stands).then(|| (write.at, write.new.clone().unwrap()))
                    }
                    _ => None,
                })
                .collect();
            let node = yieldwall_fieldbus::canopen::node_id(id).unwrap();
            let of_node = |cob: u16| sent.iter().filter(move |frame| frame.bus() == bus && frame.id() == cob);
            let written: Vec<_> = of_node(cob::sdo_request(node)).filter_map(download).collect();
            assert_eq!(told, written, "{name}: node {id}");
            let words: Vec<u16> = of_boot
                .iter()
                .filter(is_of)
                .filter_map(|line| match line.what {
                    What::Controlword { new, .. } => Some(new),
                    _ => None,
                })
                .collect();
            let mut controlwords: Vec<u16> = of_node(cob::rpdo(1, node).unwrap())
                .filter_map(|frame| frame.data().get(..2).map(|word| u16::from_le_bytes([word[0], word[1]])))
                .collect();
            controlwords.dedup();
            assert_eq!(words, controlwords, "{name}: controlwords of node {id}");
        }
        // A sensor on plain CAN is told by frames of its own.
        let told: Vec<Frame> = of_boot
            .iter()
            .filter(|line| line.part == "start")
            .filter_map(|line| match &line.what {
                What::Frame(frame, _) => Some(*frame),
                _ => None,
            })
            .collect();
        let same = |frame: &Frame| (frame.bus(), frame.id(), frame.data().to_vec());
        let mut rest = sent.iter().map(same);
        assert!(told.iter().all(|frame| rest.any(|sent| sent == same(frame))), "{name}: {told:?}");
    }
}

/// The expedited SDO downloads in a frame of a segment: station address, object and bytes.
fn coe_downloads(bytes: &[u8]) -> Vec<(u16, Address, Vec<u8>)> {
    let Ok(datagrams) = Datagrams::of(bytes) else { return Vec::new() };
    let of_mailbox = datagrams.filter_map(Result::ok).filter(|datagram| {
        let DatagramHeader { command, address, .. } = datagram.header;
        // The simulated devices have their mailboxes there.
        command == Command::Fpwr as u8 && address >> 16 == 0x1000 && datagram.data.len() >= 16
    });
    let told = of_mailbox.filter_map(|datagram| {
        let data = datagram.data;
        // CoE, the service of a request, and an expedited download.
        let is_download = data[5] & 0x0f == 3 && data[7] >> 4 == 2 && data[8] & 0xe2 == 0x22;
        let at = Address::new(u16::from_le_bytes([data[9], data[10]]), data[11]);
        let len = 4 - usize::from(data[8] >> 2 & 3);
        is_download.then(|| (datagram.header.address as u16, at, data[12..12 + len].to_vec()))
    });
    told.collect()
}

#[test]
fn of_a_segment_too_what_is_told_is_what_the_boot_sends() {
    for name in
        ["paper-ethercat", "paper-ethercat-can-sensor", "vendors/ethercat-fixed-assignment", "vendors/float-sensor"]
    {
        let rig = load_rig(Source::named(&format!("builtin:{name}.yaml"))).unwrap();
        let mut desk = SegmentSession::of_rig(&rig, None).unwrap();
        let (lines, end) = segment::lines(&rig.value, &mut desk).unwrap();
        assert!(end.is_ok(), "{name}");
        let told = lines.iter().filter_map(|line| match (&line.what, line.owner.as_ref()?.place) {
            (What::Write(write), Place::Position(position)) => {
                assert!(write.old.is_some(), "{name} {position} {}", write.at);
                (!write.stands).then(|| (0x1000 + position, write.at, write.new.clone().unwrap()))
            }
            _ => None,
        });
        let mut told: Vec<_> = told.collect();
        let frames = Arc::new(Mutex::new(Vec::new()));
        let scene = rig.scene().unwrap().value;
        let mut machine = EmbeddedRig::new(&rig.value, &scene, &rig.value.fixture, 1).unwrap();
        let taken = Arc::clone(&frames);
        machine.set_tap(Box::new(move |_, packet| {
            if let Packet::Ethernet { bytes, .. } = packet {
                taken.lock().unwrap().push(bytes.to_vec());
            }
        }));
        machine.enable().unwrap();
        drop(machine);
        let frames = Arc::try_unwrap(frames).unwrap().into_inner().unwrap();
        let mut sent: Vec<_> = frames.iter().flat_map(|bytes| coe_downloads(bytes)).collect();
        // A frame passes the tap on its way out and back.
        sent.dedup();
        // The boot writes to devices at the same time; each has an order of its own.
        told.sort_by_key(|(station, ..)| *station);
        sent.sort_by_key(|(station, ..)| *station);
        sent.dedup();
        assert_eq!(told, sent, "{name}");
        assert!(told.len() > 10 || name.contains("fixed"), "{name}: {told:?}");
    }
}

#[test]
fn a_device_that_the_boot_refuses_is_told_after_the_list() {
    let text = "like: builtin:paper-admittance.yaml\ndrives: [{name: left}, {name: right, profile: maxon-epos4, encoder: multi_turn}]\n";
    let other = load_rig(Source::memory("rig.yaml", text)).unwrap();
    let shipped = load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap();
    let plan = master(&other.value, &other.value.fixture).unwrap().networks().plan().unwrap();
    let (lines, end) = lines(&shipped.value, &plan, &mut [DeviceSession::of_rig(&shipped, None).unwrap()]).unwrap();
    assert!(lines.len() > 50);
    let failure = end.unwrap_err();
    assert_eq!(failure.exit, Exit::DeviceMismatch);
    assert!(failure.report.diagnostics[0].message.contains("check the vendor"), "{failure:?}");
}

#[test]
fn a_torque_limit_in_a_unit_of_its_own_is_shown_in_newton_metres() {
    let drive = |side: &str| format!("{{name: {side}, profile: maxon-epos4, encoder: multi_turn}}");
    let text = format!("like: builtin:paper-admittance.yaml\ndrives: [{}, {}]\n", drive("left"), drive("right"));
    let rig = load_rig(Source::memory("rig.yaml", text)).unwrap();
    let plan = master(&rig.value, &rig.value.fixture).unwrap().networks().plan().unwrap();
    let mut desks = [DeviceSession::of_rig(&rig, None).unwrap()];
    let (lines, end) = lines(&rig.value, &plan, &mut desks).unwrap();
    end.unwrap();
    let scalings = scalings(&None, &desks);
    let limit = lines.iter().map(|line| line.words(&rig.value, &scalings)).find(|words| words.contains("3001h:2"));
    let limit = limit.unwrap();
    assert!(limit.contains("torque-limit") && limit.contains("unchanged (60") && limit.ends_with(" N m)"), "{limit}");
}
