mod emergency;
mod heartbeat;
mod mapping;
mod network;
mod pdo;
mod states;
mod synchrony;

use proptest::prelude::*;

use super::*;
use crate::canopen::time::TimeOfDay;
use crate::canopen::{CommunicationProfile, PdoParameters, node_id};
use crate::objects::{AbortCode, Access, Address, DeviceIdentity, Handle, Mappable, Object, ServedDevice};

const MS: u64 = 1_000_000;
const SYNC: (u16, &[u8]) = (0x080, &[]);

/// Records the calls of the node; the position follows the target at SYNC.
struct Recorder {
    od: ObjectDictionary,
    log: Vec<String>,
    refusal: Option<AbortCode>,
    target: Option<Handle<i32>>,
    position: Option<Handle<i32>>,
}

impl ServedDevice for Recorder {
    fn od(&self) -> &ObjectDictionary {
        &self.od
    }
    fn od_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.od
    }
    fn before_write(&mut self, at: Address, data: &[u8]) -> Result<(), AbortCode> {
        self.log.push(format!("before write {:04X}:{} {data:?}", at.index, at.sub));
        self.refusal.map_or(Ok(()), Err)
    }
    fn after_write(&mut self, at: Address) {
        self.log.push(format!("after write {:04X}:{}", at.index, at.sub));
    }
    fn before_read(&mut self, at: Address) -> Result<(), AbortCode> {
        if at.index == 0x6064 {
            self.od.set(self.position.unwrap(), 0x1234);
        }
        self.refusal.map_or(Ok(()), Err)
    }
    fn outputs_applied(&mut self, _: Time, number: u8) {
        self.log.push(format!("rpdo {number} target {}", self.od.get(self.target.unwrap())));
    }
    fn outputs_late(&mut self, _: Time, number: u8) {
        self.log.push(format!("late rpdo {number}"));
    }
    fn sample(&mut self, _: Time) {
        let target = self.od.get(self.target.unwrap());
        self.od.set(self.position.unwrap(), target);
        self.log.push("sync".into());
    }
    fn reset(&mut self, _: Time, reset: Reset) {
        self.log.push(format!("reset {reset:?}"));
    }
}

impl Application for Recorder {
    fn on_nmt(&mut self, _: Time, state: NmtState) {
        self.log.push(format!("{state:?}"));
    }
    fn on_heartbeat_event(&mut self, _: Time, event: HeartbeatEvent) {
        self.log.push(format!("heartbeat of {} {:?}", event.node.raw(), event.change));
    }
    fn on_life_guarding(&mut self, _: Time, is_lost: bool) {
        self.log.push(format!("guarding lost {is_lost}"));
    }
    fn on_time(&mut self, _: Time, time: TimeOfDay) {
        self.log.push(format!("day {} ms {}", time.days, time.milliseconds));
    }
    fn on_bit_rate(&mut self, _: Time, bit_rate: u32, delay: Duration) {
        self.log.push(format!("{bit_rate} bit/s after {delay:?}"));
    }
}

/// Node 3 with a target, a position and two PDOs of each direction; RPDO 1 and TPDO 1 are synchronous, the others
/// unused.
struct Device {
    node: Node,
    app: Recorder,
}

fn communication() -> CommunicationProfile {
    let id = node_id(3).unwrap();
    let rpdo = PdoParameters::default_rpdo(1, id, &[(0x6040, 0, 16), (0x607a, 0, 32)]).unwrap();
    let tpdo = PdoParameters::default_tpdo(1, id, &[(0x6041, 0, 16), (0x6064, 0, 32)]).unwrap();
    CommunicationProfile::new(id, &DeviceIdentity { device_type: 402, ..DeviceIdentity::default() })
        .rpdo(1, &rpdo)
        .tpdo(1, &tpdo)
        .rpdo(2, &PdoParameters::default_rpdo(2, id, &[]).unwrap().unused())
        .tpdo(2, &PdoParameters::default_tpdo(2, id, &[]).unwrap().unused())
}

fn dictionary(communication: CommunicationProfile) -> ObjectDictionary {
    ObjectDictionary::builder()
        .objects(communication.objects().unwrap())
        .object(Object::new(0x6040, 0, 0u16).mappable(Mappable::Rpdo))
        .object(Object::new(0x6041, 0, 0x0250u16).access(Access::ReadOnly).mappable(Mappable::Tpdo))
        .object(Object::new(0x6060, 0, 0i8).mappable(Mappable::Rpdo))
        .object(Object::new(0x6064, 0, 0i32).access(Access::ReadOnly).mappable(Mappable::Tpdo))
        .object(Object::new(0x607a, 0, 0i32).mappable(Mappable::Both))
        .object(Object::new(0x2000, 0, 0u64).mappable(Mappable::Both))
        .object(Object::new(0x2001, 0, false).mappable(Mappable::Both))
        .build()
        .unwrap()
}

fn silent() -> Device {
    let od = dictionary(communication());
    let node = Node::new(node_id(3).unwrap(), &od).unwrap();
    let (target, position) = (od.handle(0x607a, 0).ok(), od.handle(0x6064, 0).ok());
    Device { node, app: Recorder { od, log: Vec::new(), refusal: None, target, position } }
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
        self.app.od.raw(index, sub)
    }

    fn emergencies(frames: &[Frame]) -> Vec<[u8; 8]> {
        frames.iter().filter(|frame| frame.id() == 0x083).map(|frame| *frame.bytes()).collect()
    }
}

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
        let communication = communication()
            .rpdo(3, &PdoParameters::event_driven(0x403, &mapping))
            .tpdo(3, &PdoParameters::synchronous(0x383, &mapping));
        let mut od = dictionary(communication);
        let mut node = Node::new(id, &od).unwrap();
        let mut out = Vec::new();
        node.boot(Time(0), &mut od, &mut out);
        let word = (value & 0xffff_ffff) | u64::from(flag) << 32;
        for frame in [Frame::new(0, &[1, 3]), Frame::from_bits(0x403, word, 5), Frame::new(0x080, &[])] {
            node.on_frame(Time(0), &frame, &mut od, &mut out);
        }
        prop_assert_eq!(out.last(), Some(&Frame::from_bits(0x383, word, 5)));
    }
}
