//! Comparisons of literal and arbitrary readings, both masters on the simulated segment, and processes that end in all ways.

use std::cell::RefCell;
use std::process::Command;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use proptest::prelude::*;

use super::super::{entries, pdo};
use super::ethercrab::in_debug_output;
use super::process::converse;
use super::reading::Area;
use super::*;
use yieldwall_config as config;
use yieldwall_fieldbus::ethercat::registers as register;
use yieldwall_fieldbus::ethercat::{AlState, AlStatus, AlStatusCode};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{EthernetArrival, EthernetLink, SendError};
use yieldwall_rig::live::VirtualSegment;
use yieldwall_service::{ObjectAccess, SegmentService, number};
use yieldwall_sim::ethercat::{Segment, SimulatedDevice};

/// The simulated segment, at which two masters take turns.
#[derive(Clone)]
struct Shared(Rc<RefCell<VirtualSegment>>);

impl EthernetLink for Shared {
    fn now(&self) -> Time {
        self.0.borrow().now()
    }

    fn source(&self) -> [u8; 6] {
        self.0.borrow().source()
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        self.0.borrow_mut().receive(buffer)
    }

    fn send(&mut self, frame: &[u8]) -> Result<(), SendError> {
        self.0.borrow_mut().send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        self.0.borrow_mut().wait(until)
    }
}

impl Shared {
    /// The devices of the shipped rig.
    fn new() -> (Self, SegmentSession) {
        let rig = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap().value;
        let scene = config::load_rig(config::builtin("paper-ethercat.yaml")).unwrap().scene().unwrap().value;
        let link = Self(Rc::new(RefCell::new(VirtualSegment::new(&rig, &scene, 1).unwrap())));
        let desk = SegmentSession {
            service: SegmentService::new(Box::new(link.clone()), Arc::new(AtomicBool::new(false))),
            entries: entries(&rig).unwrap(),
            place: String::new(),
            arguments: " --bus eth0".to_owned(),
            is_simulated: true,
            heard: None,
        };
        (link, desk)
    }

    fn change(&self, change: impl FnOnce(&mut Segment<SimulatedDevice>)) {
        change(self.0.borrow_mut().server_mut().segment_mut().unwrap());
    }

    /// Changes the memory chip of a device.
    fn change_sii(&self, position: usize, change: impl FnOnce(&mut [u8])) {
        self.change(|segment| change(segment.controller_mut(position).unwrap().sii_mut()));
    }
}

/// The readings of this program and of ethercrab; between both something is done to the devices.
fn readings(between: impl FnOnce(&Shared)) -> (Vec<DeviceReading>, Vec<DeviceReading>) {
    let (mut link, mut desk) = Shared::new();
    let mut own = own::read(&mut desk).unwrap();
    between(&link);
    let Answer::Read { devices, without_process_data: None } = ethercrab::read(&mut link) else { panic!("an answer") };
    add_delays(&mut desk, &mut own).unwrap();
    (own, devices)
}

fn named(own: &[DeviceReading], other: &[DeviceReading]) -> Vec<(Option<u16>, Subject)> {
    differences(own, other).into_iter().map(|difference| (difference.position, difference.subject)).collect()
}

#[test]
fn both_masters_read_the_same_of_the_simulated_segment() {
    let (own, other) = readings(|_| ());
    assert_eq!(differences(&own, &other), []);
    assert_eq!(own.len(), 3);
    for (position, (own, other)) in own.iter().zip(&other).enumerate() {
        for ((subject, one), (_, another)) in own.values().into_iter().zip(other.values()) {
            // The first device has no parent, and everything else was compared.
            let is_compared = position > 0 || subject != Subject::Parent;
            assert_eq!((one.is_some(), another.is_some()), (is_compared, is_compared), "{position} {subject:?}");
        }
    }
    assert!(own[2].delay_ns > own[1].delay_ns && own[1].delay_ns > Some(0), "{own:?}");
    assert_eq!((own[0].ports.as_deref(), own[2].parent), (Some(&[0, 1][..]), Some(1)));
    assert!(own.iter().all(|device| device.outputs > Some(0) && device.inputs > Some(0)), "{own:?}");
}

#[test]
fn what_changes_between_the_readings_is_named() {
    // The product code stands in words 0Ah and 0Bh, the serial number in words 0Eh and 0Fh, the protocols of the mailbox in word 1Ch.
    let (own, other) = readings(|link| link.change_sii(1, |image| image[0x14] ^= 1));
    assert_eq!(named(&own, &other), [(Some(1), Subject::Product)]);
    let (own, other) = readings(|link| link.change_sii(0, |image| image[0x1c] ^= 1));
    assert_eq!(named(&own, &other), [(Some(0), Subject::Serial)]);
    let (own, other) = readings(|link| link.change_sii(2, |image| image[0x38] ^= 0x08));
    assert_eq!(named(&own, &other), [(Some(2), Subject::Protocols)]);
    let (own, other) = readings(|link| {
        link.change_sii(0, |image| {
            // The first string.
            let at = (0x80..image.len()).find(|at| image[*at..].starts_with(&[10, 0])).unwrap() + 6;
            image[at] = if image[at] == b'X' { b'Y' } else { b'X' };
        });
    });
    assert!(matches!(named(&own, &other)[..], [(Some(0), Subject::Name | Subject::FullName), ..]), "{own:?} {other:?}");
    let (own, other) = readings(|link| link.change(|segment| segment.set_cable(2, false)));
    let named = named(&own, &other);
    assert!(named.starts_with(&[(None, Subject::Devices)]) && named.contains(&(Some(1), Subject::Ports)), "{named:?}");
}

#[test]
fn devices_get_back_states_addresses_and_registers() {
    let (mut link, mut desk) = Shared::new();
    desk.service.change_state(1, AlState::PreOperational).unwrap();
    let address = |position: u16| (0x2100 + position).to_le_bytes();
    for position in 0..3 {
        desk.service.write(position, register::STATION_ADDRESS, &address(position)).unwrap();
        desk.service.write(position, register::DC_OFFSET, &[7; 8]).unwrap();
    }
    let before = kept::keep(&mut desk).unwrap();
    assert!(matches!(ethercrab::read(&mut link), Answer::Read { .. }));
    let changed = desk.service.read(2, register::STATION_ADDRESS, 2).unwrap();
    assert_eq!(changed, 0x1002_u16.to_le_bytes(), "ethercrab gives addresses of its own");
    assert_eq!(desk.service.state(2).unwrap().0, AlStatus::new(AlState::PreOperational, false));
    assert!(kept::give_back(&mut desk, &before).is_empty());
    for position in 0..3 {
        assert_eq!(desk.service.read(position, register::STATION_ADDRESS, 2).unwrap(), address(position));
    }
    let after = kept::keep(&mut desk).unwrap();
    assert_eq!(
        after.iter().map(kept::Kept::given).collect::<Vec<_>>(),
        before.iter().map(kept::Kept::given).collect::<Vec<_>>()
    );
    // Its objects answer as before.
    let device = desk.at(1);
    pdo::read(&mut |at| Ok(desk.objects(&device)?.read(at).ok().map(|bytes| number(&bytes)))).unwrap();
}

/// The length of a mailbox, which the device does not take, stands in word 19h.
#[test]
fn a_device_that_does_not_come_to_pre_op_is_an_answer_too() {
    let (mut link, _) = Shared::new();
    link.change_sii(2, |image| image[0x32] ^= 0x40);
    let Answer::Failed(why) = ethercrab::read(&mut link) else { panic!("no failure") };
    assert!(why.contains("state transition"), "{why}");
}

#[test]
fn a_device_beyond_pre_op_or_with_an_error_is_refused() {
    let (link, mut desk) = Shared::new();
    for (status, told) in [
        (AlStatus::new(AlState::SafeOperational, false), "`yieldwall state all init --take-over --bus eth0` takes"),
        (AlStatus::new(AlState::Operational, false), "`yieldwall state all init --take-over --bus eth0` takes"),
        (AlStatus::new(AlState::PreOperational, true), "`yieldwall state 1 ack --bus eth0` acknowledges its error"),
    ] {
        let refused = kept::refused(&desk, &desk.at(1), status);
        let help = refused.report.diagnostics[0].help.as_deref().unwrap();
        assert!(help.contains(told), "{help}");
    }
    link.change(|segment| segment.controller_mut(1).unwrap().fail(Time(0), AlStatusCode::SYNC_ERROR));
    let refused = kept::keep(&mut desk).unwrap_err();
    assert_eq!(refused.exit, Exit::BusUnavailable);
    let message = &refused.report.diagnostics[0].message;
    assert!(message.starts_with("right (position 1) is in ") && message.contains("+ERR"), "{message}");
}

/// A device with all values.
fn literal() -> DeviceReading {
    DeviceReading {
        identity: [0x2a, 0x402, 3, 7].map(Some),
        name: Some("DRIVE-1".to_owned()),
        full_name: Some("A drive µ".to_owned()),
        mailboxes: [Some(Area { start: 0x1000, len: 128 }), Some(Area { start: 0x1080, len: 128 })],
        protocols: Some(vec!["COE".to_owned(), "FOE".to_owned()]),
        outputs: Some(13),
        inputs: Some(15),
        ports: Some(vec![0, 1]),
        parent: Some(0),
        delay_ns: Some(660),
    }
}

#[test]
fn each_value_is_compared_and_shown() {
    let other = DeviceReading {
        identity: [0x2b, 0x403, 4, 8].map(Some),
        name: Some("DRIVE-2".to_owned()),
        full_name: Some(String::new()),
        mailboxes: [Some(Area { start: 0x1000, len: 256 }), Some(Area::default())],
        protocols: Some(vec![]),
        outputs: Some(12),
        inputs: Some(14),
        ports: Some(vec![0]),
        parent: Some(1),
        delay_ns: Some(725),
    };
    let found = differences(&[literal(), literal()], &[literal(), other]);
    assert!(found.iter().all(|difference| difference.position == Some(1)));
    let shown: Vec<String> =
        found.iter().map(|found| format!("{}: {} / {}", found.subject.word(), found.own, found.other)).collect();
    let expected = [
        "vendor: 0000002Ah / 0000002Bh",
        "product: 00000402h / 00000403h",
        "revision: 00000003h / 00000004h",
        "serial: 00000007h / 00000008h",
        "name: `DRIVE-1` / `DRIVE-2`",
        "full name: `A drive ?` / none",
        "mailbox to: 1000h, 128 bytes / 1000h, 256 bytes",
        "mailbox from: 1080h, 128 bytes / none",
        "protocols: COE, FOE / none",
        "outputs: 13 bytes / 12 bytes",
        "inputs: 15 bytes / 14 bytes",
        "ports: 0, 1 / 0",
        "parent: position 0 / position 1",
        "delay: 660 ns / 725 ns",
    ];
    assert_eq!(shown, expected);
    let fewer = differences(&[literal(), literal()], &[literal()]);
    assert_eq!(named(&[literal(), literal()], &[literal()]), [(None, Subject::Devices)]);
    assert_eq!((fewer[0].own.as_str(), fewer[0].other.as_str()), ("2", "1"));
}

#[test]
fn rounding_letters_of_others_and_what_one_does_not_read_are_no_difference() {
    let as_ethercrab = DeviceReading {
        full_name: Some("A drive ??".to_owned()),
        delay_ns: Some(660 + 64),
        outputs: None,
        ..literal()
    };
    assert_eq!(differences(&[literal()], std::slice::from_ref(&as_ethercrab)), []);
    let [unread] = &compared(&literal(), &as_ethercrab, false)[..] else { panic!("one line") };
    assert_eq!(unread.found, "read by one alone: outputs (not by ethercrab)");
}

/// Changes one value of a reading, which has all; returns which.
fn change(reading: &mut DeviceReading, value: usize) -> Subject {
    let count = |count: &mut Option<u32>| *count = count.map(|count| count ^ 1);
    let text = |text: &mut Option<String>| text.as_mut().unwrap().push('x');
    let area = |area: &mut Option<Area>| area.as_mut().unwrap().len += 1;
    match value {
        0..4 => count(&mut reading.identity[value]),
        4 => text(&mut reading.name),
        5 => text(&mut reading.full_name),
        6 | 7 => area(&mut reading.mailboxes[value - 6]),
        8 => reading.protocols.as_mut().unwrap().push("VOE".to_owned()),
        9 => count(&mut reading.outputs),
        10 => count(&mut reading.inputs),
        11 => reading.ports.as_mut().unwrap().push(3),
        12 => reading.parent = reading.parent.map(|parent| parent ^ 1),
        _ => reading.delay_ns = reading.delay_ns.map(|delay| delay + 65),
    }
    reading.values()[value].0
}

fn any_reading() -> impl Strategy<Value = DeviceReading> {
    let area = || (any::<u16>(), 1..2000_u16).prop_map(|(start, len)| Some(Area { start, len }));
    let protocols = proptest::sample::subsequence(vec!["AOE", "EOE", "COE", "FOE", "SOE"], 0..5);
    let ports = proptest::sample::subsequence(vec![0_u8, 1, 2], 0..3);
    let texts = ("[ -~]{0,12}", "[ -~]{0,12}");
    let counts = (0..2000_u32, 0..2000_u32, any::<u16>(), 0..1_000_000_u32);
    (any::<[u32; 4]>(), texts, [area(), area()], protocols, ports, counts).prop_map(
        |(identity, (name, full_name), mailboxes, protocols, ports, (outputs, inputs, parent, delay))| DeviceReading {
            identity: identity.map(Some),
            name: Some(name),
            full_name: Some(full_name),
            mailboxes,
            protocols: Some(protocols.into_iter().map(str::to_owned).collect()),
            outputs: Some(outputs),
            inputs: Some(inputs),
            ports: Some(ports),
            parent: Some(parent),
            delay_ns: Some(delay),
        },
    )
}

proptest! {
    #[test]
    fn equal_readings_never_differ_and_each_changed_value_is_named(
        readings in proptest::collection::vec(any_reading(), 1..6),
        place in any::<proptest::sample::Index>(),
        value in 0..14_usize,
    ) {
        prop_assert_eq!(differences(&readings, &readings), []);
        let mut other = readings.clone();
        let place = place.index(readings.len());
        let subject = change(&mut other[place], value);
        let expected = [(Some(place as u16), subject)];
        prop_assert_eq!(named(&readings, &other), expected);
        prop_assert_eq!(named(&other, &readings), expected);
        // The way between the processes changes nothing.
        let answer = Answer::Read { devices: readings, without_process_data: None };
        let text = serde_json::to_string(&answer).unwrap();
        prop_assert_eq!(serde_json::from_str::<Answer>(&text).unwrap(), answer);
    }

    #[test]
    fn any_debug_output_is_survived(text in "\\PC{0,80}", cut in any::<proptest::sample::Index>()) {
        in_debug_output(&text);
        in_debug_output(&DEBUG_OUTPUT[..cut.index(DEBUG_OUTPUT.len())]);
    }
}

/// As ethercrab 0.7.1 prints a device, whose name imitates what stands behind it.
const DEBUG_OUTPUT: &str = "SubDevice { configured_address: 4097, alias_address: 0, config: SubDeviceConfig { io: IoRanges { \
    input: PdiSegment { bytes: 0..0 }, output: PdiSegment { bytes: 0..0 } }, mailbox: MailboxConfig { read: Some(Mailbox { \
    address: 5120, len: 128, sync_manager: 1 }), write: Some(Mailbox { address: 4096, len: 256, sync_manager: 0 }), \
    supported_protocols: MailboxProtocols(COE | FOE), has_coe: true, complete_access: true } }, identity: SubDeviceIdentity { \
    vendor_id: 0x0000002a, product_id: 0x00000402, revision: 0x00000003 (3), serial: 7 }, name: \"ports: Ports([Port { active: \
    true, number: 2 }]) parent_index: Some(9)\", ports: Ports([Port { active: true, dc_receive_time: 11, number: 0, \
    downstream_to: None }, Port { active: true, dc_receive_time: 12, number: 3, downstream_to: Some(3) }, Port { active: true, \
    dc_receive_time: 13, number: 1, downstream_to: Some(2) }, Port { active: false, dc_receive_time: 0, number: 2, \
    downstream_to: None }]), dc_support: Bits64, dc_receive_time: 5, index: 1, parent_index: Some(0), propagation_delay: 660, \
    mailbox_counter: 1, dc_sync: Disabled, oversampling_config: [] }";

#[test]
fn the_debug_output_shows_what_nothing_else_does() {
    let expected = DeviceReading {
        mailboxes: [Some(Area { start: 4096, len: 256 }), Some(Area { start: 5120, len: 128 })],
        protocols: Some(vec!["COE".to_owned(), "FOE".to_owned()]),
        ports: Some(vec![0, 1, 3]),
        parent: Some(0),
        ..DeviceReading::default()
    };
    assert_eq!(in_debug_output(DEBUG_OUTPUT), expected);
    let bare = "mailbox: MailboxConfig { read: None, write: None, supported_protocols: MailboxProtocols(0x0), has_coe: false }";
    let none = Some(Area::default());
    let expected = DeviceReading { mailboxes: [none; 2], protocols: Some(vec![]), ..DeviceReading::default() };
    assert_eq!(in_debug_output(bare), expected);
}

fn shell(script: &str, limit: Duration, is_over: bool) -> Result<Answer, NoAnswer> {
    let mut command = Command::new("sh");
    command.args(["-c", script]);
    converse(command, limit, &AtomicBool::new(is_over))
}

#[test]
fn a_process_that_panics_hangs_or_fails_is_reported() {
    let long = Duration::from_secs(60);
    let told = |answer: Result<Answer, NoAnswer>| answer.unwrap_err().to_string();
    assert_eq!(shell("echo '{\"failed\": \"no frame\"}'", long, false).unwrap(), Answer::Failed("no frame".to_owned()));
    let panic = "printf \"\\nthread 'main' panicked at src/eeprom.rs:7:9:\\nindex out of bounds\\nnote: run with\\n\" >&2; exit 101";
    assert_eq!(told(shell(panic, long, false)), "it panicked: src/eeprom.rs:7:9: index out of bounds");
    let hung = told(shell("exec sleep 600", Duration::from_millis(50), false));
    assert_eq!(hung, "it did not end within 0 s, and its process was ended");
    let failed = "its process ended with exit status: 4 and without an answer: the wire is down";
    assert_eq!(told(shell("echo the wire is down >&2; exit 4", long, false)), failed);
    assert!(matches!(shell("exec sleep 600", long, true), Err(NoAnswer::Interrupted)));
    assert!(told(shell("kill -SEGV $$", long, false)).contains("signal: 11"));
}

#[test]
fn differences_and_a_failure_are_wrong_with_the_next_command() {
    let other = DeviceReading { identity: [0x2a, 0x403, 3, 7].map(Some), ..literal() };
    let answer = Ok(Answer::Read { devices: vec![other], without_process_data: None });
    let words = |position: u16| format!("left (position {position})");
    let sections = judged("second opinion on eth0", &[literal()], &answer, words, " --bus eth0");
    let [section] = &sections[..] else { panic!("{sections:?}") };
    assert_eq!(
        (section.about.as_str(), section.exit),
        ("second opinion on eth0: left (position 0)", Exit::DeviceMismatch)
    );
    let [check] = &section.checks[..] else { panic!("{section:?}") };
    assert_eq!(check.found, "this program reads 00000402h, ethercrab 00000403h");
    assert_eq!(check.fix.as_deref(), Some("yieldwall sii check 0 --bus eth0"));
    let hung = Err(NoAnswer::Hung(Duration::from_secs(60)));
    let sections = judged("second opinion on eth0", &[literal()], &hung, words, " --bus eth0");
    assert!(sections[0].is_wrong() && sections[0].checks[0].found.contains("did not end within 60 s"), "{sections:?}");
    let equal = Ok(Answer::Read { devices: vec![literal()], without_process_data: Some("no FMMU".to_owned()) });
    let sections = judged("second opinion on eth0", &[literal()], &equal, words, " --bus eth0");
    assert!(sections[0].checks[0].found.contains("no FMMU") && !sections[1].is_wrong(), "{sections:?}");
}
