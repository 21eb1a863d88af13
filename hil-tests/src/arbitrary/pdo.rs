//! PDO mappings: where objects lie in a frame, and what devices make of any parameters.

use yieldwall::canopen::pdo::is_dummy;
use yieldwall::canopen::{CanopenError, CommunicationProfile, Frame, Layout, Node, PdoParameters, node_id};
use yieldwall::objects::{DeviceIdentity, ObjectDictionary};
use yieldwall::time::Time;

use super::bytes::{Bytes, Script};
use super::device::mappable_objects;
use super::laws::assert_is_of_device;

/// A layout is refused, or its fields follow each other without a gap within 64 bits and keep what is put into them.
///
/// # Panics
/// If a law is broken.
pub fn pdo_layout(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let word = bytes.u64();
    let mut objects = Vec::new();
    while !bytes.is_empty() {
        objects.push((bytes.u16(), bytes.u8(), bytes.u8()));
    }
    let total: usize = objects.iter().map(|object| usize::from(object.2)).sum();
    let layout = match Layout::new(&objects) {
        Ok(layout) => layout,
        Err(CanopenError::PdoBits(bits)) => return assert!(total > 64 && bits as usize == total),
        Err(CanopenError::NotMappable { bits: 0, .. }) => return assert!(objects.iter().any(|object| object.2 == 0)),
        Err(other) => panic!("{other}"),
    };
    assert!(total <= 64 && objects.iter().all(|object| object.2 > 0));
    assert_eq!((usize::from(layout.bits()), usize::from(layout.len())), (total, total.div_ceil(8)));
    let (mut next, mut packed) = (0, word);
    for ((entry, field), &(index, sub, bits)) in layout.entries().iter().zip(&objects) {
        assert_eq!((entry.address.index, entry.address.subindex, entry.bit_length), (index, sub, bits));
        assert_eq!((field.shift(), field.bits()), (next, bits));
        next += bits;
        let before = packed;
        field.put_unsigned(&mut packed, word.rotate_left(u32::from(next)));
        let kept = field.get_unsigned(packed);
        field.put_unsigned(&mut packed, kept);
        let signed = field.get_signed(packed);
        field.put_signed(&mut packed, signed);
        assert_eq!(field.get_unsigned(packed), kept);
        let mask = if bits == 64 { u64::MAX } else { ((1 << bits) - 1) << field.shift() };
        assert_eq!((before ^ packed) & !mask, 0, "a neighbour has changed");
        let first = objects.iter().position(|object| (object.0, object.1) == (index, sub));
        let expected = first.map(|place| layout.entries()[place].1).filter(|_| !is_dummy(index));
        assert_eq!(layout.field(index, sub), expected);
    }
}

pub(super) fn layouts() -> Vec<Vec<u8>> {
    let entry = |script: Script, index: u16, sub: u8, bits: u8| script.raw(&index.to_le_bytes()).raw(&[sub, bits]);
    let script = entry(entry(Script::new().raw(&[0xa5; 8]), 0x6040, 0, 16), 0x607a, 0, 32);
    vec![entry(entry(script, 0x0005, 0, 8), 0x6060, 0, 8).finish()]
}

/// A device with any PDO parameters is refused, or its PDOs have the length of their mapping.
///
/// # Panics
/// If a law is broken.
pub fn pdo_parameters(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let id = node_id(3).expect("a node id");
    let objects = mappable_objects();
    let mut profile = CommunicationProfile::new(id, &DeviceIdentity::default());
    let mut tpdos = Vec::new();
    let mut rpdos = Vec::new();
    for _ in 0..bytes.u8() % 9 {
        let (is_tpdo, number) = (bytes.bool(), bytes.u8() % 6);
        let mut parameters = PdoParameters {
            cob_id: bytes.pick(&[0x183, 0x203, 0x303, 0x283, 0x8000_0183, 0x4000_0203, 0x603, 0x2000_0183]),
            transmission_type: bytes.u8(),
            inhibit_time_100_us: bytes.u16(),
            event_timer_ms: bytes.u16(),
            mapping: Vec::new(),
        };
        if bytes.bool() {
            parameters.cob_id = bytes.u32();
        }
        for _ in 0..bytes.u8() % 10 {
            let known = bytes.pick(&objects.iter().map(|(_, entry)| *entry).collect::<Vec<_>>());
            parameters.mapping.push(if bytes.u8() < 32 { (bytes.u16(), bytes.u8(), bytes.u8()) } else { known });
        }
        let bits: usize = parameters.mapping.iter().map(|entry| usize::from(entry.2)).sum();
        (if is_tpdo { &mut tpdos } else { &mut rpdos }).push((parameters.cob_id as u16, bits.div_ceil(8)));
        profile = if is_tpdo { profile.tpdo(number, &parameters) } else { profile.rpdo(number, &parameters) };
    }
    let Ok(declared) = profile.objects() else { return };
    let own = objects.into_iter().map(|(object, _)| object);
    let Ok(mut od) = ObjectDictionary::builder().objects(declared).objects(own).build() else { return };
    let Ok(mut node) = Node::new(id, &od) else { return };
    let mut out = Vec::new();
    node.boot(Time(0), &mut od, &mut out);
    assert_eq!(out, [Frame::new(0x703, &[0])]);
    out.clear();
    let word = bytes.u64();
    for (rpdo, _) in &rpdos {
        node.on_frame(Time(0), &Frame::from_bits(*rpdo, word, bytes.u8() % 9), &mut od, &mut out);
    }
    // What was meant for an RPDO may be a SYNC with a length that is unexpected.
    let is_sync_length = |frame: &Frame| frame.id() == 0x083 && frame.data().starts_with(&[0x40, 0x82]);
    out.retain(|frame| !is_sync_length(frame));
    assert!(out.is_empty(), "no PDO before Operational: {out:x?}");
    node.on_frame(Time(0), &Frame::new(0x000, &[1, 3]), &mut od, &mut out);
    for (rpdo, _) in &rpdos {
        node.on_frame(Time(0), &Frame::from_bits(*rpdo, word, bytes.u8() % 9), &mut od, &mut out);
    }
    node.on_frame(Time(0), &Frame::new(0x080, &[]), &mut od, &mut out);
    node.poll(Time(1_000_000_000), &mut od, &mut out);
    assert!(node.next_deadline() > Time(1_000_000_000));
    for frame in &out {
        assert_is_of_device(id, frame);
        if frame.id() == 0x583 {
            continue; // What was meant for an RPDO was a request.
        }
        let is_emergency = frame.id() == 0x083 && frame.len() == 8;
        let len = usize::from(frame.len());
        assert!(is_emergency || tpdos.iter().any(|tpdo| *tpdo == (frame.id(), len)), "{frame:x?} of {tpdos:x?}");
    }
}

pub(super) fn parameters() -> Vec<Vec<u8>> {
    // TPDO 1 at 183h at every SYNC and RPDO 1 at 203h, with two objects each.
    let pdo = |is_tpdo: u8, cob_id: u8, objects: [u8; 2]| {
        let [first, second] = objects;
        [is_tpdo, 1, cob_id, 1, 0, 0, 0, 0, 0, 2, first, 1, second, 1]
    };
    let script = Script::new().raw(&[2]).raw(&pdo(1, 0, [1, 3])).raw(&pdo(0, 1, [0, 4]));
    vec![script.raw(&[1, 2, 3, 4, 5, 6, 7, 8]).raw(&[6; 4]).finish()]
}
