//! What the commands print of the simulated segment, and of devices that are broken.

use super::*;
use crate::ethercat::AlStatusCode;
use crate::sim::ethercat::{Segment, SimulatedDevice};
use crate::time::Time;

/// The desk at the devices of the shipped rig, to which something was done.
fn desk(break_it: impl FnOnce(&mut Segment<SimulatedDevice>)) -> SegmentDesk {
    let rig = config::load_rig_on_any_bus(config::builtin("paper-ethercat.yaml")).unwrap();
    let scene = rig.scene().unwrap().value;
    let mut link = VirtualSegment::new(&rig.value, &scene, 1).unwrap();
    break_it(link.server_mut().segment_mut());
    SegmentDesk {
        service: SegmentService::new(Box::new(link), Arc::new(AtomicBool::new(false))),
        entries: entries(&rig.value),
        place: String::new(),
        arguments: String::new(),
        is_simulated: true,
    }
}

fn scanned(desk: &mut SegmentDesk) -> String {
    let found: Vec<_> = (0..desk.devices().unwrap()).map(|position| desk.service.present(position).unwrap()).collect();
    scan::text(desk, &found)
}

#[test]
fn devices_are_found_in_their_order() {
    insta::assert_snapshot!("segment-scan", scanned(&mut desk(|_| ())));
}

/// The checksum of one device is wrong, a category of another one is torn, and the third has an error.
#[test]
fn a_damaged_sii_names_word_and_meaning_and_leaves_the_others_legible() {
    let mut desk = desk(|segment| {
        segment.controller_mut(0).unwrap().sii_mut()[14] ^= 0x55;
        let sensor = segment.controller_mut(2).unwrap().sii_mut();
        sensor[2 * 0x41..2 * 0x42].copy_from_slice(&0x7000_u16.to_le_bytes());
        segment.controller_mut(1).unwrap().fail(Time(0), AlStatusCode::SYNC_ERROR);
    });
    insta::assert_snapshot!("segment-scan-damaged", scanned(&mut desk));
}

#[test]
fn a_device_is_meant_by_position_name_or_role() {
    let mut desk = desk(|_| ());
    for (word, position, words) in [
        ("0", 0, "left (position 0)"),
        ("right", 1, "right (position 1)"),
        ("wrist", 2, "wrist (position 2)"),
        ("sensor", 2, "wrist (position 2)"),
    ] {
        let device = desk.device(word).unwrap();
        assert_eq!((device.position, device.words().as_str()), (position, words), "{word}");
    }
    assert_eq!(desk.device("rihgt").unwrap_err().exit, Exit::Usage);
    let missing = desk.device("3").unwrap_err();
    assert_eq!(missing.exit, Exit::DeviceMismatch);
    let message = &missing.report.diagnostics[0].message;
    assert!(message.contains("3 devices answer, and this one would be the one at position 3"), "{message}");
}

#[test]
fn a_segment_of_which_nothing_comes_back_is_not_available() {
    let mut desk = desk(|segment| segment.set_cable(0, false));
    let failure = desk.devices().unwrap_err();
    assert_eq!(failure.exit, Exit::BusUnavailable);
    assert!(failure.report.diagnostics[0].message.contains("none came back"), "{failure:?}");
}
