mod network;
mod synchrony;

use proptest::prelude::*;

use super::*;
use crate::canopen::time::TimeOfDay;
use crate::canopen::{AbortCode, Access, Address, DeviceIdentity, Handle, Mappable, Object, PdoParameters, node_id};

const MS: u64 = 1_000_000;
const SYNC: (u16, &[u8]) = (0x080, &[]);

/// Writes down what the node told it; the position follows the target at SYNC.
#[derive(Default)]
struct Recorder {
    log: Vec<String>,
    refusal: Option<AbortCode>,
    target: Option<Handle<i32>>,
    position: Option<Handle<i32>>,
}

impl Application for Recorder {
    fn before_write(&mut self, _: &mut ObjectDictionary, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        self.log.push(format!("before write {:04X}:{} {data:?}", at.index, at.subindex));
        self.refusal.map_or(Ok(()), Err)
    }
    fn after_write(&mut self, _: &mut ObjectDictionary, at: Address) {
        self.log.push(format!("after write {:04X}:{}", at.index, at.subindex));
    }
    fn before_read(&mut self, od: &mut ObjectDictionary, at: Address) -> Result<(), AbortCode> {
        if at.index == 0x6064 {
            od.set(self.position.unwrap(), 0x1234);
        }
        self.refusal.map_or(Ok(()), Err)
    }
    fn on_sync(&mut self, _: Time, od: &mut ObjectDictionary) {
        let target = od.get(self.target.unwrap());
        od.set(self.position.unwrap(), target);
        self.log.push("sync".into());
    }
    fn on_rpdo(&mut self, _: Time, od: &mut ObjectDictionary, number: u8) {
        self.log.push(format!("rpdo {number} target {}", od.get(self.target.unwrap())));
    }
    fn on_nmt(&mut self, _: Time, _: &mut ObjectDictionary, state: NmtState) {
        self.log.push(format!("{state:?}"));
    }
    fn on_reset(&mut self, _: Time, _: &mut ObjectDictionary, reset: Reset) {
        self.log.push(format!("reset {reset:?}"));
    }
    fn on_heartbeat_event(&mut self, _: Time, _: &mut ObjectDictionary, event: HeartbeatEvent) {
        self.log.push(format!("heartbeat of {} {:?}", event.node.raw(), event.change));
    }
    fn on_life_guarding(&mut self, _: Time, _: &mut ObjectDictionary, is_lost: bool) {
        self.log.push(format!("guarding lost {is_lost}"));
    }
    fn on_time(&mut self, _: Time, _: &mut ObjectDictionary, time: TimeOfDay) {
        self.log.push(format!("day {} ms {}", time.days, time.milliseconds));
    }
    fn on_bit_rate(&mut self, _: Time, _: &mut ObjectDictionary, bit_rate: u32, delay: Duration) {
        self.log.push(format!("{bit_rate} bit/s after {delay:?}"));
    }
    fn on_rpdo_timeout(&mut self, _: Time, _: &mut ObjectDictionary, number: u8) {
        self.log.push(format!("late rpdo {number}"));
    }
}

/// Node 3 with a target, a position and two PDOs of each direction; RPDO 1 and TPDO 1 are synchronous, the others
/// unused.
struct Device {
    node: Node,
    app: Recorder,
}

fn dictionary() -> crate::canopen::dictionary::Builder {
    let id = node_id(3).unwrap();
    let rpdo = PdoParameters::default_rpdo(1, id, &[(0x6040, 0, 16), (0x607a, 0, 32)]).unwrap();
    let tpdo = PdoParameters::default_tpdo(1, id, &[(0x6041, 0, 16), (0x6064, 0, 32)]).unwrap();
    ObjectDictionary::builder()
        .communication_profile(id, &DeviceIdentity { device_type: 402, ..DeviceIdentity::default() })
        .object(Object::new(0x6040, 0, 0u16).mappable(Mappable::Rpdo))
        .object(Object::new(0x6041, 0, 0x0250u16).access(Access::ReadOnly).mappable(Mappable::Tpdo))
        .object(Object::new(0x6060, 0, 0i8).mappable(Mappable::Rpdo))
        .object(Object::new(0x6064, 0, 0i32).access(Access::ReadOnly).mappable(Mappable::Tpdo))
        .object(Object::new(0x607a, 0, 0i32).mappable(Mappable::Both))
        .object(Object::new(0x2000, 0, 0u64).mappable(Mappable::Both))
        .object(Object::new(0x2001, 0, false).mappable(Mappable::Both))
        .rpdo(1, &rpdo)
        .tpdo(1, &tpdo)
        .rpdo(2, &PdoParameters::default_rpdo(2, id, &[]).unwrap().unused())
        .tpdo(2, &PdoParameters::default_tpdo(2, id, &[]).unwrap().unused())
}

fn silent() -> Device {
    let node = Node::new(node_id(3).unwrap(), dictionary().build().unwrap()).unwrap();
    let target = node.od().handle(0x607a, 0).ok();
    let position = node.od().handle(0x6064, 0).ok();
    Device { node, app: Recorder { target, position, ..Recorder::default() } }
}

fn booted() -> Device {
    let mut device = silent();
    let mut out = Vec::new();
    device.node.boot(Time(0), &mut device.app, &mut out);
    assert_eq!(out, [Frame::new(0x703, &[0])]);
    assert_eq!(device.log(), ["reset Node", "PreOperational"]);
    device
}

fn operational() -> Device {
    let mut device = booted();
    assert_eq!(device.at(0, (0, &[1, 3])), []);
    assert_eq!(device.log(), ["Operational"]);
    device
}

impl Device {
    /// The frames sent in answer to one frame at `ms`.
    fn at(&mut self, ms: u64, (id, data): (u16, &[u8])) -> Vec<Frame> {
        let mut out = Vec::new();
        self.node.on_frame(Time(ms * MS), &Frame::new(id, data), &mut self.app, &mut out);
        out
    }

    /// The frames sent in answer to one frame at time 0.
    fn take(&mut self, id: u16, data: &[u8]) -> Vec<Frame> {
        self.at(0, (id, data))
    }

    fn poll(&mut self, ms: u64) -> Vec<Frame> {
        let mut out = Vec::new();
        self.node.poll(Time(ms * MS), &mut self.app, &mut out);
        out
    }

    fn log(&mut self) -> Vec<String> {
        std::mem::take(&mut self.app.log)
    }

    /// Writes 1 to 4 bytes by SDO at `ms`; the abort code if refused.
    fn write_at(&mut self, ms: u64, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        let [low, high] = index.to_le_bytes();
        let mut request = [0x23 | ((4 - data.len()) << 2) as u8, low, high, sub, 0, 0, 0, 0];
        request[4..4 + data.len()].copy_from_slice(data);
        let answers = self.at(ms, (0x603, &request));
        let bytes = answers.first().expect("an answer").data();
        match bytes[0] {
            0x60 => Ok(()),
            _ => Err(AbortCode(u32::from_le_bytes(bytes[4..8].try_into().unwrap()))),
        }
    }

    fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        self.write_at(0, index, sub, data)
    }

    fn write_u32(&mut self, index: u16, sub: u8, value: u32) -> Result<(), AbortCode> {
        self.write(index, sub, &value.to_le_bytes())
    }

    fn value(&self, index: u16, sub: u8) -> u64 {
        self.node.od().raw(index, sub)
    }

    fn emergencies(frames: &[Frame]) -> Vec<[u8; 8]> {
        frames.iter().filter(|frame| frame.id() == 0x083).map(|frame| *frame.bytes()).collect()
    }
}

// NMT.

#[test]
fn is_silent_and_deaf_before_boot() {
    let mut device = silent();
    for frame in [(0, &[1, 3][..]), SYNC, (0x203, &[0; 6]), (0x603, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]), (0x705, &[5])] {
        assert_eq!(device.at(0, frame), []);
    }
    assert_eq!(device.poll(1_000_000), []);
    assert_eq!((device.node.state(), device.log().len()), (NmtState::Initialising, 0));
    assert_eq!(device.node.next_deadline(), Time::NEVER);
}

#[test]
fn commands_move_through_the_states() {
    let mut device = booted();
    let steps = [
        (&[0x01, 3][..], NmtState::Operational),
        (&[0x02, 3], NmtState::Stopped),
        (&[0x80, 0], NmtState::PreOperational),
        (&[0x01, 0], NmtState::Operational),
        (&[0x02, 4], NmtState::Operational),
        (&[0x03, 3], NmtState::Operational),
        (&[0x02], NmtState::Operational),
    ];
    for (data, state) in steps {
        assert_eq!(device.take(0, data), []);
        assert_eq!(device.node.state(), state);
    }
    assert_eq!(device.log(), ["Operational", "Stopped", "PreOperational", "Operational"]);
}

#[test]
fn resets_restore_values_and_boot_up_again() {
    let mut device = booted();
    device.write_u32(0x607a, 0, 77).unwrap();
    device.write(0x1017, 0, &[100, 0]).unwrap();
    device.take(0, &[1, 3]);
    device.log();
    assert_eq!(device.take(0, &[0x82, 3]), [Frame::new(0x703, &[0])]);
    assert_eq!(device.log(), ["reset Communication", "PreOperational"]);
    assert_eq!((device.value(0x1017, 0), device.value(0x607a, 0)), (0, 77));
    assert_eq!(device.node.next_deadline(), Time::NEVER);
    assert_eq!(device.take(0, &[0x81, 0]), [Frame::new(0x703, &[0])]);
    assert_eq!((device.value(0x607a, 0), device.node.state()), (0, NmtState::PreOperational));
}

#[test]
fn stopped_serves_no_sdo_and_no_sync() {
    let mut device = operational();
    device.take(0, &[2, 3]);
    device.log();
    assert_eq!(device.take(0x603, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]), []);
    assert_eq!(device.at(0, SYNC), []);
    assert_eq!(device.log(), [""; 0]);
}

// Heartbeat.

#[test]
fn heartbeat_keeps_to_its_grid_and_tells_the_state() {
    let mut device = booted();
    device.write_at(10, 0x1017, 0, &[100, 0]).unwrap();
    assert_eq!(device.node.next_deadline(), Time(110 * MS));
    assert_eq!(device.poll(109), []);
    assert_eq!(device.poll(113), [Frame::new(0x703, &[0x7f])]);
    assert_eq!(device.node.next_deadline(), Time(210 * MS));
    device.at(200, (0, &[1, 3]));
    assert_eq!(device.poll(210), [Frame::new(0x703, &[0x05])]);
    device.at(300, (0, &[2, 3]));
    assert_eq!(device.poll(310), [Frame::new(0x703, &[0x04])]);
    // After a long pause one heartbeat, not a burst.
    assert_eq!(device.poll(1000).len(), 1);
    assert_eq!((device.poll(1001), device.node.next_deadline()), (vec![], Time(1100 * MS)));
}

fn watching_127() -> Device {
    let mut device = operational();
    device.write_u32(0x1016, 1, 127 << 16 | 50).unwrap();
    assert_eq!(device.poll(500), []);
    assert_eq!(device.at(1000, (0x77f, &[5])), []);
    device.log();
    device
}

#[test]
fn a_lost_heartbeat_gives_an_emergency_and_leaves_operational() {
    let mut device = watching_127();
    assert_eq!(device.poll(1049), []);
    assert_eq!(device.poll(1050), [Frame::new(0x083, &[0x30, 0x81, 0x11, 127, 0, 0, 0, 0])]);
    assert_eq!(device.log(), ["PreOperational", "heartbeat of 127 Lost"]);
    assert_eq!((device.value(0x1001, 0), device.value(0x1003, 1)), (0x11, 0x007f_8130));
    assert_eq!(device.at(1200, (0x77f, &[5])), [Frame::new(0x083, &[0; 8])]);
    assert_eq!(device.value(0x1001, 0), 0);
    assert_eq!(device.log(), ["heartbeat of 127 Present(Operational)"]);
}

#[test]
fn configuring_the_watch_anew_clears_its_errors() {
    let mut device = watching_127();
    device.poll(1050);
    let request = [0x23, 0x16, 0x10, 1, 0, 0, 0, 0];
    assert_eq!(Device::emergencies(&device.at(1060, (0x603, &request))), [[0; 8]]);
    assert_eq!((device.value(0x1001, 0), device.poll(9000)), (0, vec![]));
}

#[test]
fn error_behaviour_decides_what_a_lost_heartbeat_does() {
    for (behaviour, state) in [(0, NmtState::PreOperational), (1, NmtState::Operational), (2, NmtState::Stopped)] {
        let mut device = watching_127();
        device.write_at(1000, 0x1029, 1, &[behaviour]).unwrap();
        assert_eq!(device.poll(1050).len(), 1);
        assert_eq!(device.node.state(), state);
    }
    assert_eq!(booted().write(0x1029, 1, &[3]), Err(AbortCode(0x0609_0031)));
}

#[test]
fn several_producers_are_watched_but_none_twice() {
    let mut device = booted();
    assert_eq!(device.write_u32(0x1016, 1, 127 << 16 | 50), Ok(()));
    assert_eq!(device.write_u32(0x1016, 2, 126 << 16 | 100), Ok(()));
    assert_eq!(device.write_u32(0x1016, 3, 127 << 16 | 70), Err(AbortCode(0x0604_0043)));
    assert_eq!(device.write_u32(0x1016, 3, 200 << 16 | 70), Err(AbortCode(0x0609_0030)));
    assert_eq!(device.write_u32(0x1016, 1, 127 << 16 | 60), Ok(()));
    assert_eq!(device.write_u32(0x1016, 5, 0), Err(AbortCode(0x0609_0011)));
    device.at(0, (0x77f, &[5]));
    device.at(0, (0x77e, &[5]));
    assert_eq!(Device::emergencies(&device.poll(60)), [[0x30, 0x81, 0x11, 127, 0, 0, 0, 0]]);
    assert_eq!(Device::emergencies(&device.poll(100)), [[0x30, 0x81, 0x11, 126, 0, 0, 0, 0]]);
    // One back, one still lost: the register keeps its bits.
    assert_eq!(Device::emergencies(&device.at(110, (0x77f, &[5]))), [[0, 0, 0x11, 0, 0, 0, 0, 0]]);
}

// Emergencies.

#[test]
fn emergencies_are_sent_once_remembered_and_cleared() {
    let mut device = booted();
    let mut out = Vec::new();
    let voltage = ErrorRegister(ErrorRegister::VOLTAGE);
    device.node.raise_emergency(EmcyCode(0x3210), voltage, [0; 5], &mut out);
    device.node.raise_emergency(EmcyCode(0x3210), voltage, [0; 5], &mut out);
    device.node.raise_emergency(EmcyCode::FOLLOWING_ERROR, ErrorRegister(0x20), [1, 2, 3, 4, 5], &mut out);
    device.node.clear_emergency(EmcyCode(0x3210), &mut out);
    device.node.clear_emergency(EmcyCode(0x3210), &mut out);
    device.node.clear_all_emergencies(&mut out);
    device.node.clear_all_emergencies(&mut out);
    let expected = [
        [0x10, 0x32, 0x05, 0, 0, 0, 0, 0],
        [0x11, 0x86, 0x25, 1, 2, 3, 4, 5],
        [0, 0, 0x21, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0],
    ];
    assert_eq!(Device::emergencies(&out), expected);
    assert_eq!([0, 1, 2, 3].map(|sub| device.value(0x1003, sub)), [2, 0x0201_8611, 0x3210, 0]);
    let read = |sub| [0x40, 0x03, 0x10, sub, 0, 0, 0, 0];
    assert_eq!(device.take(0x603, &read(2))[0].data(), [0x43, 0x03, 0x10, 2, 0x10, 0x32, 0, 0]);
    assert_eq!(device.take(0x603, &read(3))[0].data(), [0x80, 0x03, 0x10, 3, 0x24, 0, 0, 0x08]);
    assert_eq!(device.write(0x1003, 0, &[1]), Err(AbortCode(0x0609_0030)));
    assert_eq!(device.write(0x1003, 0, &[0]), Ok(()));
    assert_eq!([0, 1, 2].map(|sub| device.value(0x1003, sub)), [0; 3]);
}

#[test]
fn history_keeps_the_latest_eight() {
    let mut device = booted();
    for code in 0..20 {
        let mut out = Vec::new();
        device.node.raise_emergency(EmcyCode(0xff00 + code), ErrorRegister(0x80), [0; 5], &mut out);
        assert_eq!(out.len(), 1);
    }
    assert_eq!((device.value(0x1003, 0), device.value(0x1003, 1), device.value(0x1003, 8)), (8, 0xff13, 0xff0c));
}

#[test]
fn emergencies_are_not_sent_when_stopped_or_switched_off() {
    let mut device = booted();
    let mut out = Vec::new();
    assert_eq!(device.write_u32(0x1014, 0, 0x0a0), Err(AbortCode(0x0609_0030)));
    device.write_u32(0x1014, 0, 0x8000_0083).unwrap();
    device.node.raise_emergency(EmcyCode::GENERIC, ErrorRegister(0), [0; 5], &mut out);
    assert_eq!((out.len(), device.value(0x1001, 0)), (0, 1));
    device.write_u32(0x1014, 0, 0x0a0).unwrap();
    device.node.clear_all_emergencies(&mut out);
    assert_eq!(out, [Frame::new(0x0a0, &[0; 8])]);
    device.take(0, &[2, 3]);
    device.node.raise_emergency(EmcyCode::GENERIC, ErrorRegister(0), [0; 5], &mut out);
    assert_eq!((out.len(), device.value(0x1001, 0)), (1, 1));
}

// PDOs.

#[test]
fn fault_11_synchronous_rpdos_apply_at_the_next_sync() {
    let mut device = operational();
    for target in [5u8, 9] {
        assert_eq!(device.take(0x203, &[0x0f, 0, target, 0, 0, 0]), []);
        assert_eq!((device.value(0x6040, 0), device.value(0x607a, 0)), (0, 0));
    }
    // The latest one counts; TPDOs are sampled after the device has reacted.
    assert_eq!(device.at(1, SYNC), [Frame::new(0x183, &[0x50, 0x02, 9, 0, 0, 0])]);
    assert_eq!(device.value(0x6040, 0), 0x0f);
    assert_eq!(device.log(), ["rpdo 1 target 9", "sync"]);
    device.at(2, SYNC);
    assert_eq!(device.log(), ["sync"]);
}

#[test]
fn every_synchronous_type_latches_and_event_driven_types_do_not() {
    for (transmission_type, latches) in [(0, true), (1, true), (240, true), (254, false), (255, false)] {
        let mut device = operational();
        device.write(0x1400, 2, &[transmission_type]).unwrap();
        device.log();
        device.take(0x203, &[0x0f, 0, 5, 0, 0, 0]);
        assert_eq!(device.value(0x607a, 0), if latches { 0 } else { 5 });
        assert_eq!(device.log().len(), usize::from(!latches));
        device.at(0, SYNC);
        assert_eq!(device.value(0x607a, 0), 5);
    }
}

#[test]
fn pdos_exist_in_operational_only() {
    let mut device = booted();
    device.take(0x203, &[0x0f, 0, 5, 0, 0, 0]);
    assert_eq!(device.at(0, SYNC), []);
    assert_eq!((device.value(0x607a, 0), device.log()), (0, vec!["sync".to_string()]));
    // What was latched before leaving Operational is not applied on return.
    device.take(0, &[1, 3]);
    device.take(0x203, &[0x0f, 0, 5, 0, 0, 0]);
    device.take(0, &[0x80, 3]);
    device.take(0, &[1, 3]);
    assert_eq!(device.at(0, SYNC), [Frame::new(0x183, &[0x50, 0x02, 0, 0, 0, 0])]);
}

#[test]
fn fault_10_a_tpdo_of_type_n_is_sent_at_every_nth_sync() {
    let mut device = operational();
    device.write(0x1800, 2, &[10]).unwrap();
    let sent: Vec<usize> = (1..=30).filter(|&ms| !device.at(ms, SYNC).is_empty()).map(|ms| ms as usize).collect();
    assert_eq!(sent, [10, 20, 30]);
}

#[test]
fn sync_start_value_aligns_tpdos_to_the_counter() {
    let mut device = booted();
    device.write_u32(0x1800, 1, 0x8000_0183).unwrap();
    device.write(0x1800, 2, &[2]).unwrap();
    device.write(0x1800, 6, &[3]).unwrap();
    device.write_u32(0x1800, 1, 0x183).unwrap();
    assert_eq!(device.write(0x1800, 6, &[4]), Err(AbortCode(0x0800_0022)));
    device.take(0, &[1, 3]);
    let sent: Vec<u8> = (1..=8).filter(|&count| !device.at(0, (0x080, &[count])).is_empty()).collect();
    assert_eq!(sent, [4, 6, 8]);
}

#[test]
fn type_0_is_sent_at_sync_when_the_value_changed_or_the_device_asks() {
    let mut device = operational();
    device.write(0x1800, 2, &[0]).unwrap();
    assert_eq!(device.at(0, SYNC).len(), 1);
    assert_eq!(device.at(0, SYNC).len(), 0);
    device.take(0x203, &[0, 0, 1, 0, 0, 0]);
    assert_eq!(device.at(0, SYNC), [Frame::new(0x183, &[0x50, 0x02, 1, 0, 0, 0])]);
    let mut out = Vec::new();
    device.node.trigger_tpdo(Time(0), 1, &mut out);
    assert_eq!((out.len(), device.at(0, SYNC).len(), device.at(0, SYNC).len()), (0, 1, 0));
}

#[test]
fn event_driven_tpdos_obey_trigger_event_timer_and_inhibit_time() {
    let mut device = booted();
    device.write_u32(0x1800, 1, 0x8000_0183).unwrap();
    device.write(0x1800, 2, &[255]).unwrap();
    device.write(0x1800, 3, &[20, 0]).unwrap();
    device.write(0x1800, 5, &[10, 0]).unwrap();
    device.write_u32(0x1800, 1, 0x183).unwrap();
    assert_eq!(device.write(0x1800, 3, &[30, 0]), Err(AbortCode(0x0800_0022)));
    device.take(0, &[1, 3]);
    let mut out = Vec::new();
    // Timer at 10 and 20 ms, on its grid even if polled late.
    assert_eq!(device.node.next_deadline(), Time(10 * MS));
    assert_eq!((device.poll(9).len(), device.poll(11).len(), device.poll(12).len()), (0, 1, 0));
    assert_eq!((device.node.next_deadline(), device.poll(20).len()), (Time(20 * MS), 1));
    // A trigger within 2 ms waits; afterwards the timer runs from the triggered frame.
    device.node.trigger_tpdo(Time(21 * MS), 1, &mut out);
    assert_eq!((out.len(), device.node.next_deadline()), (0, Time(22 * MS)));
    assert_eq!((device.poll(22).len(), device.node.next_deadline()), (1, Time(32 * MS)));
    device.node.trigger_tpdo(Time(25 * MS), 1, &mut out);
    assert_eq!(out.len(), 1);
    device.node.trigger_tpdo(Time(28 * MS), 0, &mut out);
    device.node.trigger_tpdo(Time(28 * MS), 5, &mut out);
    device.take(0, &[0x80, 3]);
    device.node.trigger_tpdo(Time(30 * MS), 1, &mut out);
    assert_eq!((out.len(), device.node.next_deadline()), (1, Time::NEVER));
}

#[test]
fn a_short_rpdo_is_dropped_with_one_emergency_until_a_good_one_comes() {
    let mut device = operational();
    assert_eq!(device.take(0x203, &[1, 2, 3]), [Frame::new(0x083, &[0x10, 0x82, 0x11, 1, 0, 0, 0, 0])]);
    assert_eq!(device.take(0x203, &[1, 2, 3, 4, 5]), []);
    device.at(0, SYNC);
    assert_eq!(device.value(0x6040, 0), 0);
    // Bytes beyond the mapping do not matter.
    assert_eq!(device.take(0x203, &[6, 0, 1, 0, 0, 0, 9, 9]), [Frame::new(0x083, &[0; 8])]);
    device.at(0, SYNC);
    assert_eq!((device.value(0x6040, 0), device.value(0x607a, 0)), (6, 1));
}

#[test]
fn an_rpdo_that_does_not_come_in_time_is_reported_once() {
    let mut device = operational();
    device.write(0x1400, 5, &[5, 0]).unwrap();
    device.log();
    assert_eq!(device.poll(100), []);
    device.at(100, (0x203, &[6, 0, 1, 0, 0, 0]));
    device.at(103, (0x203, &[6, 0, 1, 0, 0, 0]));
    assert_eq!((device.poll(105), device.poll(107)), (vec![], vec![]));
    assert_eq!(device.node.next_deadline(), Time(108 * MS));
    assert_eq!(device.poll(108), [Frame::new(0x083, &[0x50, 0x82, 0x11, 1, 0, 0, 0, 0])]);
    assert_eq!((device.poll(200), device.node.next_deadline()), (vec![], Time::NEVER));
    assert_eq!(device.log(), ["late rpdo 1"]);
    assert_eq!(device.at(201, (0x203, &[6, 0, 1, 0, 0, 0])), [Frame::new(0x083, &[0; 8])]);
    // Leaving Operational ends the watch.
    device.at(202, (0, &[0x80, 3]));
    assert_eq!((device.poll(1000), device.node.next_deadline()), (vec![], Time::NEVER));
}

#[test]
fn sync_identifier_is_configurable() {
    let mut device = operational();
    device.write_u32(0x1005, 0, 0x0c0).unwrap();
    assert_eq!((device.at(0, SYNC).len(), device.take(0x0c0, &[]).len()), (0, 1));
    let report = [[0x40, 0x82, 0x11, 0, 0, 0, 0, 0]];
    assert_eq!(Device::emergencies(&device.take(0x0c0, &[1, 2])), report);
    assert_eq!(device.write_u32(0x1005, 0, 0x4000_0080), Err(AbortCode(0x0609_0030)));
    assert_eq!(device.write_u32(0x1005, 0, 0x601), Err(AbortCode(0x0609_0030)));
}

// Remapping.

/// The order of CiA 301 for RPDO 2 and these entries; stops at the first refusal.
fn remap(device: &mut Device, entries: &[u32], transmission_type: u8) -> Result<(), AbortCode> {
    device.write_u32(0x1401, 1, 0x8000_0303)?;
    device.write(0x1601, 0, &[0])?;
    for (sub, &entry) in (1..).zip(entries) {
        device.write_u32(0x1601, sub, entry)?;
    }
    device.write(0x1601, 0, &[entries.len() as u8])?;
    device.write(0x1401, 2, &[transmission_type])?;
    device.write_u32(0x1401, 1, 0x303)
}

#[test]
fn fault_12_dummy_entries_skip_their_bits() {
    let mut device = booted();
    let entries = [0x0006_0010, 0x607a_0020, 0x0001_0001, 0x2001_0001, 0x0002_0008];
    remap(&mut device, &entries, 255).unwrap();
    device.take(0, &[1, 3]);
    device.take(0x303, &[0xaa, 0xbb, 1, 2, 3, 4, 0b10, 0]);
    assert_eq!((device.value(0x607a, 0), device.value(0x2001, 0), device.value(0x6040, 0)), (0x0403_0201, 1, 0));
    device.take(0x303, &[0xaa, 0xbb, 1, 2, 3, 4, 0b01, 0]);
    assert_eq!(device.value(0x2001, 0), 0);
}

#[test]
fn remapping_in_order_takes_effect_at_once() {
    let mut device = operational();
    remap(&mut device, &[0x6060_0008, 0x6040_0010], 255).unwrap();
    device.take(0x303, &[8, 0x0f, 0x01]);
    assert_eq!((device.value(0x6060, 0), device.value(0x6040, 0)), (8, 0x010f));
    // Switched off again, it hears nothing.
    device.write_u32(0x1401, 1, 0x8000_0303).unwrap();
    assert_eq!(device.take(0x303, &[9]), []);
    assert_eq!(device.value(0x6060, 0), 8);
}

#[test]
fn remapping_out_of_order_is_refused() {
    let mut device = booted();
    let (value, state) = (Err(AbortCode(0x0609_0030)), Err(AbortCode(0x0800_0022)));
    // RPDO 1 is in use: neither mapping nor identifier may change.
    assert_eq!(device.write(0x1600, 0, &[0]), state);
    assert_eq!(device.write_u32(0x1600, 1, 0x6060_0008), state);
    assert_eq!(device.write_u32(0x1400, 1, 0x204), value);
    assert_eq!(device.write_u32(0x1400, 1, 0x203), Ok(()));
    // Switched off, but entries still count.
    assert_eq!(device.write_u32(0x1400, 1, 0x8000_0203), Ok(()));
    assert_eq!(device.write_u32(0x1600, 1, 0x6060_0008), state);
    assert_eq!(device.write(0x1600, 0, &[0]), Ok(()));
    assert_eq!(device.write_u32(0x1600, 1, 0x6060_0008), Ok(()));
    assert_eq!(device.write(0x1600, 0, &[1]), Ok(()));
    // Restricted, extended and too wide identifiers.
    for cob_id in [0x000, 0x07f, 0x181 - 1, 0x601, 0x701, 0x2000_0203, 0x800] {
        assert_eq!(device.write_u32(0x1400, 1, cob_id), value, "{cob_id:X}");
    }
    assert_eq!(device.write_u32(0x1400, 1, 0x204), Ok(()));
}

#[test]
fn bad_mappings_have_their_own_abort_codes() {
    let mut device = booted();
    let not_mappable = Err(AbortCode(0x0604_0041));
    for (entry, expected) in [
        (0x5fff_0010, Err(AbortCode(0x0602_0000))),
        (0x6040_0110, Err(AbortCode(0x0609_0011))),
        (0x6041_0010, not_mappable),
        (0x1017_0010, not_mappable),
        (0x6040_0020, not_mappable),
        (0x0006_0008, not_mappable),
        (0x0006_0110, not_mappable),
        (0x2001_0008, not_mappable),
    ] {
        assert_eq!(remap(&mut device, &[entry], 1), expected, "{entry:08X}");
    }
    let too_long = Err(AbortCode(0x0604_0042));
    assert_eq!(remap(&mut device, &[0x2000_0040, 0x6060_0008], 1), too_long);
    assert_eq!(device.write(0x1601, 0, &[9]), too_long);
    // A gap in the record: entry 3 is empty.
    assert!(device.write(0x1601, 0, &[3]).is_err());
    assert_eq!(device.value(0x1601, 0), 0);
    for reserved in [241, 251, 252, 253] {
        assert_eq!(device.write(0x1401, 2, &[reserved]), Err(AbortCode(0x0609_0030)));
    }
    // TPDOs take what the master reads, and no dummies.
    device.write_u32(0x1801, 1, 0x8000_0283).unwrap();
    assert_eq!(device.write_u32(0x1a01, 1, 0x6040_0010), not_mappable);
    assert_eq!(device.write_u32(0x1a01, 1, 0x0006_0010), not_mappable);
    assert_eq!(device.write_u32(0x1a01, 1, 0x6041_0010), Ok(()));
}

#[test]
fn bad_default_pdos_are_found_at_construction() {
    let id = node_id(3).unwrap();
    let with = |parameters: &PdoParameters| Node::new(id, dictionary().rpdo(3, parameters).build().unwrap()).err();
    let pdo = |mapping: &[(u16, u8, u8)]| PdoParameters::default_rpdo(3, id, mapping).unwrap();
    assert_eq!(with(&pdo(&[(0x607a, 0, 32)])), None);
    let not_mappable = CanopenError::NotMappable { index: 0x6041, sub: 0, bits: 16 };
    assert_eq!(with(&pdo(&[(0x6041, 0, 16)])), Some(not_mappable));
    assert_eq!(with(&pdo(&[(0x2000, 0, 64), (0x6060, 0, 8)])), Some(CanopenError::PdoBits(72)));
    assert_eq!(with(&PdoParameters { cob_id: 0x601, ..pdo(&[]) }), Some(CanopenError::CobId(0x601)));
    let reserved = PdoParameters { transmission_type: 252, ..pdo(&[]) };
    assert_eq!(with(&reserved), Some(CanopenError::TransmissionType(252)));
    let bare = ObjectDictionary::builder().build().unwrap();
    assert!(matches!(Node::new(id, bare), Err(CanopenError::NoObject { .. })));
}

// The device behind the node.

#[test]
fn the_device_may_refuse_writes_and_refresh_reads() {
    let mut device = booted();
    assert_eq!(device.write_u32(0x607a, 0, 5), Ok(()));
    assert_eq!(device.log(), ["before write 607A:0 [5, 0, 0, 0]", "after write 607A:0"]);
    let read = device.take(0x603, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]);
    assert_eq!(read[0].data(), [0x43, 0x64, 0x60, 0, 0x34, 0x12, 0, 0]);
    device.app.refusal = Some(AbortCode::DEVICE_STATE);
    assert_eq!(device.write_u32(0x607a, 0, 6), Err(AbortCode::DEVICE_STATE));
    assert_eq!((device.value(0x607a, 0), device.log().len()), (5, 1));
    let read = device.take(0x603, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]);
    assert_eq!(read[0].data()[4..], [0x22, 0, 0, 0x08]);
}

proptest! {
    #[test]
    fn no_frame_breaks_a_device_and_polling_always_gets_somewhere(
        frames in proptest::collection::vec(
            (
                prop_oneof![
                    Just(0u16), Just(0x080), Just(0x100), Just(0x7e5), Just(0x7e5), Just(0x203), Just(0x303), Just(0x603), Just(0x603), Just(0x77f), 0..0x800u16
                ],
                proptest::collection::vec(any::<u8>(), 0..=8),
                0..20u64,
            ),
            0..80,
        ),
        is_configured: bool,
        remotes in proptest::collection::vec(0..0x800u16, 0..8),
        objects in proptest::collection::vec((0usize..20, 0u8..8, any::<u32>(), 0usize..4), 0..40),
    ) {
        const INDICES: [u16; 20] = [
            0x1006, 0x1007, 0x100c, 0x100d, 0x1012, 0x1019, 0x1003, 0x1005, 0x1014, 0x1016, 0x1017, 0x1029, 0x1400, 0x1401, 0x1600, 0x1601, 0x1800, 0x1801, 0x1a00, 0x1a01,
        ];
        let mut device = operational();
        let mut now = 0;
        for (place, sub, value, unused) in objects {
            let [low, high] = INDICES[place].to_le_bytes();
            let [a, b, c, d] = value.to_le_bytes();
            device.take(0x603, &[0x23 | (unused << 2) as u8, low, high, sub, a, b, c, d]);
        }
        if !is_configured {
            device.node.forget_node_id();
            device.node.boot(Time(0), &mut device.app, &mut Vec::new());
        }
        for id in remotes {
            device.node.on_frame(Time(0), &Frame::remote(id, 1), &mut device.app, &mut Vec::new());
        }
        for (id, data, wait) in frames {
            now += wait;
            device.at(now, (id, &data));
            device.poll(now);
            prop_assert!(device.node.next_deadline() > Time(now * MS));
        }
    }

    #[test]
    fn an_rpdo_mapped_like_a_tpdo_returns_the_same_bytes(value: u64, flag: bool) {
        let id = node_id(3).unwrap();
        let mapping = [(0x607a, 0, 32), (0x2001, 0, 1)];
        let od = dictionary()
            .rpdo(3, &PdoParameters::event_driven(0x403, &mapping))
            .tpdo(3, &PdoParameters::synchronous(0x383, &mapping))
            .build()
            .unwrap();
        let mut node = Node::new(id, od).unwrap();
        let mut out = Vec::new();
        node.boot(Time(0), &mut (), &mut out);
        let word = (value & 0xffff_ffff) | u64::from(flag) << 32;
        for frame in [Frame::new(0, &[1, 3]), Frame::from_bits(0x403, word, 5), Frame::new(0x080, &[])] {
            node.on_frame(Time(0), &frame, &mut (), &mut out);
        }
        prop_assert_eq!(out.last(), Some(&Frame::from_bits(0x383, word, 5)));
    }
}
