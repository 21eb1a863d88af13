//! The object dictionary, alone and behind a node: SDO server, PDOs, NMT and emergencies.

use yieldwall::canopen::{
    CommunicationProfile, EmcyCode, ErrorRegister, Frame, NmtState, Node, PdoParameters, cob, node_id,
};
use yieldwall::objects::{Access, Address, DataType, DeviceIdentity, Mappable, Object, ObjectDictionary};
use yieldwall::time::Time;

use super::bytes::{Bytes, Script};
use super::laws::{assert_is_of_device, live};

/// Most frames that a node sends in answer to one: a TPDO each, or an SDO response and an emergency.
const MOST_PER_FRAME: usize = 4;
/// Most frames of one poll: a heartbeat, an emergency per watched node and per RPDO, the TPDOs, an SDO abort.
const MOST_PER_POLL: usize = 1 + 4 + 4 + 4 + 1;
/// Segments of a block, and its end.
const MOST_OF_BLOCK: usize = 128;

/// Objects that PDOs may carry, and how they are mapped.
pub(super) fn mappable_objects() -> Vec<(Object, (u16, u8, u8))> {
    vec![
        (Object::new(0x6040, 0, 0u16).mappable(Mappable::Rpdo), (0x6040, 0, 16)),
        (Object::new(0x6041, 0, 0x0250u16).access(Access::ReadOnly).mappable(Mappable::Tpdo), (0x6041, 0, 16)),
        (Object::new(0x6060, 0, 0i8).mappable(Mappable::Rpdo), (0x6060, 0, 8)),
        (Object::new(0x6064, 0, 0i32).access(Access::ReadOnly).mappable(Mappable::Tpdo), (0x6064, 0, 32)),
        (Object::new(0x607a, 0, 0i32).mappable(Mappable::Both), (0x607a, 0, 32)),
        (Object::new(0x2000, 0, 0u64).mappable(Mappable::Both), (0x2000, 0, 64)),
        (Object::new(0x2001, 0, false).mappable(Mappable::Both), (0x2001, 0, 1)),
        (Object::narrow(0x2002, 1, DataType::Integer24, -1i32).mappable(Mappable::Both), (0x2002, 1, 24)),
    ]
}

/// A node and the dictionary that it serves.
struct Served {
    node: Node,
    od: ObjectDictionary,
}

fn served() -> Served {
    let id = node_id(3).expect("a node id");
    let pdo = |cob_id, mapping: &[_]| PdoParameters::synchronous(cob_id, mapping);
    let identity = DeviceIdentity { name: "a device".into(), ..DeviceIdentity::default() };
    let communication = CommunicationProfile::new(id, &identity)
        .rpdo(1, &pdo(0x203, &[(0x6040, 0, 16), (0x607a, 0, 32)]))
        .rpdo(2, &PdoParameters::event_driven(0x303, &[(0x2000, 0, 64)]))
        .tpdo(1, &pdo(0x183, &[(0x6041, 0, 16), (0x6064, 0, 32)]))
        .tpdo(2, &PdoParameters { event_timer_ms: 20, ..PdoParameters::event_driven(0x283, &[(0x2001, 0, 1)]) })
        .rpdo(3, &pdo(0x403, &[]).unused())
        .tpdo(4, &pdo(0x483, &[]).unused());
    let od = ObjectDictionary::builder()
        .objects(communication.objects().expect("good PDOs"))
        .objects(mappable_objects().into_iter().map(|(object, _)| object))
        .object(Object::new(0x2003, 0, 0.5f32).limits(-1.0f32, 1.0))
        .object(Object::bytes(0x2004, 0, DataType::Domain, &[1, 2, 3], 100))
        .object(Object::bytes(0x2005, 0, DataType::OctetString, &[], 9).access(Access::WriteOnly))
        .build()
        .expect("a good dictionary");
    Served { node: Node::new(id, &od).expect("a good device"), od }
}

/// A device on a bus where anything is said: every request has one answer, a refused write changes nothing, and no frame
/// is one that the device was not configured to send.
///
/// # Panics
/// If a law is broken.
pub fn device(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let (mut served, mut now, mut out, mut has_blocks) = (served(), Time::default(), Vec::new(), false);
    served.node.boot(now, &mut served.od, &mut out);
    served.node.on_frame(now, &Frame::new(cob::NMT, &[1, 0]), &mut served.od, &mut out);
    while !bytes.is_empty() {
        out.clear();
        match bytes.u8() % 8 {
            0..5 => {
                let frame = bytes.frame(&[0x603, 0x603, 0x603, 0x080, 0x203, 0x303, 0x403, 0x000, 0x701]);
                let before = (served.node.state(), target(&served, &frame));
                served.node.on_frame(now, &frame, &mut served.od, &mut out);
                has_blocks |=
                    frame.id() == cob::sdo_request(served.node.id()) && matches!(frame.bytes()[0] >> 5, 5 | 6);
                if has_blocks {
                    // What is an answer to what depends on the transfer under way: its own tests know.
                    assert!(out.len() <= MOST_PER_FRAME + MOST_OF_BLOCK, "{frame:x?} gave {out:x?}");
                } else {
                    assert!(out.len() <= MOST_PER_FRAME, "{frame:x?} gave {out:x?}");
                    check_answer(&served, &frame, before, &out);
                }
            }
            5 => {
                now = now + bytes.wait();
                let most = MOST_PER_POLL + if has_blocks { MOST_OF_BLOCK } else { 0 };
                live(
                    &mut served,
                    now,
                    |served| served.node.next_deadline(),
                    |served, now| {
                        let mut out = Vec::new();
                        served.node.poll(now, &mut served.od, &mut out);
                        assert!(out.len() <= most && served.node.next_deadline() > now);
                        out.iter().for_each(|frame| check_sent(served, frame));
                    },
                );
            }
            6 => served.node.trigger_tpdo(now, bytes.u8(), &served.od, &mut out),
            _ => {
                let code = EmcyCode(bytes.u16());
                match bytes.u8() % 4 {
                    0 => served.node.clear_all_emergencies(&mut served.od, &mut out),
                    1 => served.node.clear_emergency(&mut served.od, code, &mut out),
                    _ => {
                        let (bits, source) = (ErrorRegister(bytes.u8()), bytes.u8());
                        served.node.raise_emergency(&mut served.od, code, bits, [source, 0, 0, 0, 0], &mut out);
                    }
                }
                assert!(out.len() <= 1);
            }
        }
        out.iter().for_each(|frame| check_sent(&served, frame));
    }
}

/// The object that an SDO request in `frame` names, and its bytes.
fn target(served: &Served, frame: &Frame) -> (Address, Option<Vec<u8>>) {
    let [_, low, high, sub, ..] = *frame.bytes();
    let at = Address::new(u16::from_le_bytes([low, high]), sub);
    (at, served.od.bytes(at).map(<[u8]>::to_vec))
}

fn check_answer(served: &Served, frame: &Frame, before: (NmtState, (Address, Option<Vec<u8>>)), out: &[Frame]) {
    let (state, (at, value)) = before;
    let responses: Vec<_> = out.iter().filter(|frame| frame.id() == cob::sdo_response(served.node.id())).collect();
    let is_served = matches!(state, NmtState::PreOperational | NmtState::Operational);
    let request = frame.bytes();
    let class = request[0] >> 5;
    if frame.id() != cob::sdo_request(served.node.id()) || frame.len() != 8 || !is_served || class == 4 {
        return assert!(responses.is_empty(), "{frame:x?} gave {out:x?}");
    }
    let [response] = responses[..] else { panic!("{frame:x?} gave {out:x?}") };
    let answer = response.bytes();
    let is_abort = answer[0] == 0x80;
    let expected = match class {
        0 => answer[0] & 0xef == 0x20,
        1 => answer[0] == 0x60,
        2 => matches!(answer[0], 0x41 | 0x43 | 0x47 | 0x4b | 0x4f),
        3 => answer[0] & 0xe0 == 0,
        _ => false,
    };
    assert!(is_abort || expected, "{frame:x?} gave {response:x?}");
    if matches!(class, 1 | 2) {
        assert_eq!(answer[1..4], request[1..4], "an answer for another object");
    }
    // An expedited write is carried out or leaves no trace.
    if class == 1 && request[0] & 2 != 0 {
        let now = served.od.bytes(at).map(<[u8]>::to_vec);
        if is_abort {
            assert_eq!(now, value, "{frame:x?} was refused");
        } else {
            let now = now.expect("an object that was written");
            assert_eq!(now, request[4..4 + now.len()], "{frame:x?} was confirmed");
        }
    }
}

/// Whether a frame is one that the device is configured to send.
fn check_sent(served: &Served, frame: &Frame) {
    assert_is_of_device(served.node.id(), frame);
    if frame.id() >= 0x580 {
        return;
    }
    assert!(matches!(served.node.state(), NmtState::PreOperational | NmtState::Operational), "{frame:x?}");
    let word = |index, sub| {
        let bytes = served.od.bytes(Address::new(index, sub)).unwrap_or_default();
        bytes.iter().rev().fold(0u64, |word, byte| word << 8 | u64::from(*byte))
    };
    let is_at = |cob_id: u64| cob_id >> 31 == 0 && cob_id & 0x7ff == u64::from(frame.id());
    let is_emergency = is_at(word(0x1014, 0)) && frame.len() == 8;
    let is_tpdo = (0..4).any(|place| {
        let bits: u64 = (1..=word(0x1a00 + place, 0)).map(|sub| word(0x1a00 + place, sub as u8) & 0xff).sum();
        is_at(word(0x1800 + place, 1)) && bits.div_ceil(8) == u64::from(frame.len())
    });
    assert!(is_emergency || (is_tpdo && served.node.state() == NmtState::Operational), "{frame:x?}");
}

fn sdo(script: Script, payload: &[u8; 8]) -> Script {
    script.raw(&[0]).frame(0x603, payload)
}

pub(super) fn conversations() -> Vec<Vec<u8>> {
    // Remaps RPDO 3, then uses it; reads and writes a long value in segments.
    let mut remap = Script::new();
    for payload in [
        [0x2f, 0x02, 0x16, 0, 0, 0, 0, 0],
        [0x23, 0x02, 0x16, 1, 0x08, 0, 0x60, 0x60],
        [0x23, 0x02, 0x16, 2, 0x20, 0, 0x7a, 0x60],
        [0x2f, 0x02, 0x16, 0, 2, 0, 0, 0],
        [0x2f, 0x02, 0x14, 2, 255, 0, 0, 0],
        [0x2b, 0x02, 0x14, 5, 20, 0, 0, 0],
        [0x23, 0x02, 0x14, 1, 0x03, 0x04, 0, 0],
    ] {
        remap = sdo(remap, &payload);
    }
    remap = remap.raw(&[0]).frame(0x403, &[8, 1, 2, 3, 4]).raw(&[5]).wait_us(50_000);
    let mut segments = Script::new();
    for payload in [
        [0x40, 0x08, 0x10, 0, 0, 0, 0, 0],
        [0x60, 0, 0, 0, 0, 0, 0, 0],
        [0x70, 0, 0, 0, 0, 0, 0, 0],
        [0x21, 0x04, 0x20, 0, 9, 0, 0, 0],
        [0x00, 1, 2, 3, 4, 5, 6, 7],
        [0x1b, 8, 9, 0, 0, 0, 0, 0],
        [0x40, 0x04, 0x20, 0, 0, 0, 0, 0],
    ] {
        segments = sdo(segments, &payload);
    }
    // Heartbeats of its own, and those of a node that falls silent; SYNC, a short RPDO, a trigger, an emergency.
    let mut watch = sdo(Script::new(), &[0x2b, 0x17, 0x10, 0, 20, 0, 0, 0]);
    watch = sdo(watch, &[0x23, 0x16, 0x10, 1, 50, 0, 1, 0]).raw(&[0]).frame(0x701, &[5]).raw(&[5]).wait_us(50_000);
    for (id, data) in
        [(0x080, &[][..]), (0x203, &[1, 2]), (0x203, &[6, 0, 1, 0, 0, 0]), (0x080, &[]), (0x000, &[0x80, 3])]
    {
        watch = watch.raw(&[0]).frame(id, data);
    }
    watch = watch.raw(&[6, 2, 7, 0x10, 0x42, 2, 1, 0, 7, 0x10, 0x42, 1]);
    vec![remap.finish(), segments.finish(), watch.finish()]
}

/// A type of the table and whether values of it may be limited.
const TYPES: [DataType; 8] = [
    DataType::Boolean,
    DataType::Integer24,
    DataType::Unsigned16,
    DataType::Real32,
    DataType::Real64,
    DataType::VisibleString,
    DataType::OctetString,
    DataType::Domain,
];

/// A dictionary of any objects: what is written is read, what is refused changes nothing, and no object changes another.
///
/// # Panics
/// If a law is broken.
pub fn dictionary(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let mut builder = ObjectDictionary::builder();
    let mut addresses = Vec::new();
    for _ in 0..bytes.u8() % 12 {
        let (index, sub) = (0x2000 + u16::from(bytes.u8() % 4), bytes.u8() % 4);
        let data_type = bytes.pick(&TYPES);
        let value = bytes.slice();
        let size = data_type.size().unwrap_or(value.len());
        let mut value = value.to_vec();
        value.resize(size, 0);
        let access =
            bytes.pick(&[Access::ReadWrite, Access::ReadWrite, Access::ReadOnly, Access::WriteOnly, Access::Const]);
        let object = Object::bytes(index, sub, data_type, &value, size + usize::from(bytes.u8()));
        builder =
            builder.object(if bytes.bool() { object.limits(bytes.f64(), bytes.f64()) } else { object }.access(access));
        addresses.push(Address::new(index, sub));
    }
    let Ok(mut od) = builder.build() else { return };
    let at_power_on = snapshot(&od, &addresses);
    while !bytes.is_empty() {
        let at = match bytes.u8() {
            0..32 => Address::new(bytes.u16(), bytes.u8()),
            place if addresses.is_empty() => Address::new(place.into(), 0),
            place => addresses[usize::from(place) % addresses.len()],
        };
        let before = snapshot(&od, &addresses);
        let value = bytes.slice();
        let is_forced = bytes.bool();
        let expected = od.check_write(at, value);
        let written = if is_forced { od.set_bytes(at, value) } else { od.write(at, value) };
        assert!(is_forced || written == expected);
        match written {
            Ok(()) => assert_eq!(od.bytes(at), Some(value)),
            Err(_) => assert_eq!(snapshot(&od, &addresses), before, "a refused write"),
        }
        for ((address, old), (_, new)) in before.iter().zip(snapshot(&od, &addresses)) {
            assert!(*address == at || *old == new, "a write to {at:?} changed {address:?}");
        }
        match od.read(at) {
            Ok(read) => assert_eq!(Some(read), od.bytes(at)),
            Err(code) => assert!(!code.name().is_empty()),
        }
    }
    od.restore_power_on_values(0, u16::MAX);
    assert_eq!(snapshot(&od, &addresses), at_power_on);
}

fn snapshot(od: &ObjectDictionary, addresses: &[Address]) -> Vec<(Address, Option<Vec<u8>>)> {
    addresses.iter().map(|at| (*at, od.bytes(*at).map(<[u8]>::to_vec))).collect()
}

pub(super) fn dictionaries() -> Vec<Vec<u8>> {
    let object = |script: Script, sub: u8, data_type: u8, value: &[u8]| {
        script.raw(&[0, sub, data_type, value.len() as u8]).raw(value).raw(&[0, 2, 0])
    };
    let script = object(object(object(Script::new().raw(&[3]), 0, 2, &[1, 2]), 1, 6, b"text"), 2, 1, &[3, 4, 5]);
    vec![script.raw(&[33, 2, 8, 9, 0]).raw(&[34, 6, 1, 2, 3, 4, 5, 6, 0]).raw(&[35, 2, 1, 2, 1]).finish()]
}
