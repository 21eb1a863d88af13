//! What is broken at the moment, and what becomes of frames, samples and angles by it.

use std::time::Duration;

use nalgebra::Vector6;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::{MASTER, STRANGER};
use crate::bus::LinkEvent;
use crate::canopen::{Frame, NodeId, Time, cob};
use crate::injection::{Injection, Kind, Target};
use crate::rig::far_end::{SENSOR, Senses};
use crate::sensing::{Calibration, Wrench};
use yieldwall_drives::cia402;

/// Frames that may wait to arrive later; more are lost.
const HELD_FRAMES: usize = 64;
/// Heartbeat of another master, node 126.
const SECOND_HEARTBEAT: u16 = 0x77e;
/// Enable Operation, as somebody else's set-point tells it ...
const ENABLE_OPERATION: u64 = 0x000f;
/// ... and how far its target is from the last own one: 500 per mille of the rated torque in a frame of 4 bytes ...
const FOREIGN_TORQUE_PER_MILLE: u64 = 500;
/// ... and in one of 6 bytes so many counts, or counts per second: about a radian for the shipped drives.
const FOREIGN_COUNTS: u64 = 1 << 17;

/// A device that can be the target.
#[derive(Clone, Copy, Debug)]
pub(super) enum Device {
    /// A CANopen node: its identifier and how often its heartbeat comes.
    Node { node: NodeId, heartbeat: Duration },
    /// A sensor on plain CAN, and whether it can say that its samples are not valid.
    Plain { can_be_invalid: bool },
}

impl Device {
    fn node(self) -> Option<NodeId> {
        match self {
            Device::Node { node, .. } => Some(node),
            Device::Plain { .. } => None,
        }
    }

    /// Whether a frame that it sent is process data.
    fn is_data(self, frame: &Frame) -> bool {
        matches!(self, Device::Plain { .. }) || is_tpdo(frame)
    }
}

/// One injection that acts, and what it has to remember.
#[derive(Clone, Copy, Debug)]
pub(super) struct Active {
    pub(super) injection: Injection,
    /// Frames or cycles so far.
    count: u32,
    counts: Option<[i32; 6]>,
    angle_rad: Option<f64>,
    frame: Option<Frame>,
}

#[derive(Clone, Copy, Debug)]
struct Held {
    time: Time,
    from: usize,
    frame: Frame,
}

/// How the computer that runs the master does in one cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Host {
    pub(super) is_stopped: bool,
    pub(super) is_suspended: bool,
    pub(super) sync_late: Duration,
    pub(super) compute_late: Duration,
    pub(super) compute_takes: Duration,
}

/// What is broken at the moment.
#[derive(Debug)]
pub(super) struct Troubles {
    /// The left drive, the right drive, the sensor.
    devices: [Device; 3],
    /// Numbers of their buses.
    buses: [u8; 3],
    active: Vec<Active>,
    held: Vec<Held>,
    /// The last set-points of the master.
    set_points: [Option<Frame>; 2],
    noise: Xoshiro256PlusPlus,
}

impl Troubles {
    /// Nothing is broken. Whatever is random in what follows comes from `seed`.
    pub(super) fn new(devices: [Device; 3], buses: [u8; 3], seed: u64) -> Self {
        let noise = Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xfa17_0000_0000_0002);
        Self { devices, buses, active: Vec::new(), held: Vec::new(), set_points: [None; 2], noise }
    }

    pub(super) fn clear(&mut self) {
        self.active.clear();
        self.held.clear();
    }

    pub(super) fn begin(&mut self, injection: Injection) {
        self.active.push(Active { injection, count: 0, counts: None, angle_rad: None, frame: None });
    }

    /// The first of the active injections for which `is_over`, which ends.
    pub(super) fn end_one(&mut self, is_over: impl Fn(&Injection) -> bool) -> Option<Injection> {
        let at = self.active.iter().position(|active| is_over(&active.injection))?;
        Some(self.active.remove(at).injection)
    }

    /// When the first of the active injections ends, in s since the scene began.
    pub(super) fn next_end_s(&self) -> f64 {
        self.active.iter().map(|active| active.injection.end_s()).fold(f64::INFINITY, f64::min)
    }

    pub(super) fn node(&self, device: usize) -> Option<NodeId> {
        self.devices.get(device).and_then(|device| device.node())
    }

    /// Why the injection is not possible with the devices of this rig.
    pub(super) fn refuse(&self, injection: Injection) -> Option<&'static str> {
        let is_plain = self.devices.iter().enumerate().find_map(|(at, device)| match *device {
            Device::Plain { can_be_invalid } if is_at(injection.target, at) => Some(can_be_invalid),
            _ => None,
        })?;
        match injection.kind {
            Kind::SensorInvalid if !is_plain => Some("a sensor with a bit of its status for it"),
            Kind::HeartbeatSilent
            | Kind::DuplicateNode
            | Kind::IntruderNmt
            | Kind::ForeignDownload
            | Kind::Emergency
            | Kind::EmergencyWarning
            | Kind::IdentityMismatch
            | Kind::WrongNodeId => Some("a CANopen node, and the sensor speaks plain CAN"),
            _ => None,
        }
    }

    /// Frames that others than the devices send in the cycle that begins at `sync_at`.
    pub(super) fn begin_cycle(&mut self, sync_at: Time, period: Duration) {
        let Self { devices, buses, active, held, set_points, .. } = self;
        for active in active {
            let Injection { kind, target, size, .. } = active.injection;
            match kind {
                Kind::ForeignSetPoint => {
                    let own = set_points.iter().enumerate().filter(|(joint, _)| target.has_joint(*joint));
                    for frame in own.filter_map(|(_, frame)| *frame) {
                        hold(held, sync_at + period.mul_f64(size), STRANGER, foreign(frame));
                    }
                }
                Kind::SecondMaster => {
                    let mut on: Vec<u8> = buses.to_vec();
                    on.sort_unstable();
                    on.dedup();
                    for bus in on {
                        let mut send = |at: Time, frame: Frame| hold(held, at, STRANGER, frame.on_bus(bus));
                        if active.count == 0 {
                            send(sync_at, Frame::new(SECOND_HEARTBEAT, &[0x00]));
                            send(sync_at, Frame::new(cob::NMT, &[0x81, 0x00]));
                        } else {
                            send(sync_at + period / 4, Frame::new(SECOND_HEARTBEAT, &[0x05]));
                        }
                        send(sync_at + period / 2, Frame::new(cob::SYNC, &[]));
                    }
                    for frame in set_points.iter().flatten() {
                        hold(held, sync_at + period * 3 / 4, STRANGER, foreign(*frame));
                    }
                    active.count += 1;
                }
                Kind::IntruderSync => {
                    hold(held, sync_at + period / 2, STRANGER, Frame::new(cob::SYNC, &[]).on_bus(buses[0]));
                }
                Kind::DuplicateNode => {
                    for (at, (device, bus)) in devices.iter().zip(&*buses).enumerate() {
                        let Device::Node { node, heartbeat } = *device else { continue };
                        let cycles = (heartbeat.as_nanos() / period.as_nanos()).max(1) as u32;
                        if is_at(target, at) && active.count.is_multiple_of(cycles) {
                            // Late in the cycle, where it is in nobody's way.
                            let heartbeat = Frame::new(cob::heartbeat(node), &[0x05]).on_bus(*bus);
                            hold(held, sync_at + period * 9 / 10, STRANGER, heartbeat);
                        }
                    }
                    active.count += 1;
                }
                _ => {}
            }
        }
    }

    /// A frame of somebody else, to arrive now.
    pub(super) fn send(&mut self, now: Time, from: usize, frame: Frame) {
        hold(&mut self.held, now, from, frame);
    }

    /// When the next of the frames arrives that wait here.
    pub(super) fn next_held(&self) -> Time {
        self.held.iter().map(|held| held.time).min().unwrap_or(Time::NEVER)
    }

    /// The next of the frames that have arrived by `now`, with its port.
    pub(super) fn take_held(&mut self, now: Time) -> Option<(usize, Frame)> {
        let due = self.held.iter().enumerate().filter(|(_, held)| held.time <= now);
        let (at, _) = due.min_by_key(|(at, held)| (held.time, *at))?;
        let held = self.held.remove(at);
        Some((held.from, held.frame))
    }

    /// What receivers get of a frame that was on the wire.
    pub(super) fn pass(&mut self, now: Time, from: usize, mut frame: Frame) -> Option<Frame> {
        let Self { devices, buses, active, held, set_points, noise } = self;
        let bus = frame.bus();
        if from == MASTER && is_rpdo(&frame) {
            for ((device, its_bus), set_point) in devices.iter().zip(&*buses).zip(set_points) {
                let is_it = |node: NodeId| frame.id() & 0x7f == u16::from(node.raw());
                if *its_bus == bus && device.node().is_some_and(is_it) {
                    *set_point = Some(frame);
                }
            }
        }
        for active in active {
            let Injection { kind, target, size, .. } = active.injection;
            let sender = from.checked_sub(1).filter(|at| is_at(target, *at)).and_then(|at| devices.get(at));
            let is_data = sender.is_some_and(|device| device.is_data(&frame));
            let addressee = devices.iter().zip(&*buses).enumerate().find(|(at, (device, its_bus))| {
                let is_it = |node: NodeId| frame.id() & 0x7f == u16::from(node.raw());
                from == MASTER && **its_bus == bus && is_at(target, *at) && device.node().is_some_and(is_it)
            });
            let is_set_point = addressee.is_some() && is_rpdo(&frame);
            let later = now + Duration::from_secs_f64(size.max(0.0));
            match kind {
                Kind::PdoLost | Kind::SensorSilent if is_data => return None,
                Kind::SetPointsLost if is_set_point => return None,
                Kind::SyncLost if frame.id() == cob::SYNC => return None,
                Kind::HeartbeatSilent
                    if sender
                        .and_then(|device| device.node())
                        .is_some_and(|node| frame.id() == cob::heartbeat(node)) =>
                {
                    return None;
                }
                Kind::PdoDelayed if is_data => {
                    hold(held, later, from, frame);
                    return None;
                }
                Kind::PdoJitter if is_data => {
                    active.count += 1;
                    if active.count.is_multiple_of(3) {
                        hold(held, later, from, frame);
                        return None;
                    }
                }
                Kind::PdoDuplicated if is_data => hold(held, now, from, frame),
                Kind::PdoReordered if is_data => match active.frame.take() {
                    Some(earlier) => hold(held, now, from, earlier),
                    None => {
                        active.frame = Some(frame);
                        return None;
                    }
                },
                Kind::PdoCorrupt if is_data => {
                    let bits = 8 * u64::from(frame.len()).max(1);
                    let flips = (0..size as u32).fold(0, |flips, _| flips ^ 1 << (noise.next_u64() % bits));
                    frame = Frame::from_bits(frame.id(), frame.bits() ^ flips, frame.len());
                }
                Kind::PdoShort if is_data => {
                    frame = Frame::from_bits(frame.id(), frame.bits(), frame.len().saturating_sub(1));
                }
                Kind::IdentityMismatch if sender.is_some() => frame = lie(frame, [0x18, 0x10, 1]),
                Kind::ConfigDrift if sender.is_some() => frame = lie(frame, [0x72, 0x60, 0]),
                Kind::WrongBitRate if sender.is_some() || addressee.is_some() => return None,
                Kind::WrongNodeId if addressee.is_some() && !is_set_point => return None,
                Kind::WrongNodeId if sender.is_some() => {
                    frame =
                        Frame::from_bits(frame.id() & 0x780 | (frame.id() + 0x20) & 0x7f, frame.bits(), frame.len());
                }
                _ => {}
            }
            frame = frame.on_bus(bus);
        }
        Some(frame)
    }

    /// How the computer does in the next cycle.
    pub(super) fn host(&mut self) -> Host {
        let mut host = Host::default();
        for active in &mut self.active {
            active.count += u32::from(active.injection.target == Target::Host);
            let time = Duration::from_secs_f64(active.injection.size.max(0.0));
            let is_second = active.count.is_multiple_of(2);
            match active.injection.kind {
                Kind::MasterStopped => host.is_stopped = true,
                Kind::Suspend => (host.is_stopped, host.is_suspended) = (true, true),
                Kind::SyncLate if is_second => host.sync_late += time,
                Kind::ComputeLate if is_second => host.compute_late += time,
                Kind::CycleOverrun if is_second => host.compute_takes += time,
                _ => {}
            }
        }
        host
    }

    /// Whether one of `kinds` acts on the master's interface to a bus: that of the target, or every one.
    fn is_any_on(&self, bus: u8, kinds: &[Kind]) -> bool {
        self.active.iter().map(|active| active.injection).filter(|injection| kinds.contains(&injection.kind)).any(
            |injection| {
                let is_it = |(device, on): (usize, &u8)| *on == bus && is_at(injection.target, device);
                injection.target == Target::Link || self.buses.iter().enumerate().any(is_it)
            },
        )
    }

    /// Whether the bit rate of the master's interfaces is another one than that of the devices.
    fn is_alone(&self) -> bool {
        let is_it = |injection: Injection| injection.kind == Kind::WrongBitRate && injection.target == Target::Link;
        self.active.iter().any(|active| is_it(active.injection))
    }

    /// Whether frames of others reach the master from a bus.
    pub(super) fn hears(&self, bus: u8) -> bool {
        !self.is_alone() && !self.is_any_on(bus, &[Kind::InterfaceDown, Kind::BusOff, Kind::CableOut])
    }

    /// Whether the master can hand frames to its interface to a bus.
    pub(super) fn sends(&self, bus: u8) -> bool {
        !self.is_any_on(bus, &[Kind::SendFailed, Kind::InterfaceDown, Kind::BusOff])
    }

    /// Whether frames stay in the master's interface to a bus.
    pub(super) fn is_transmit_held(&self, bus: u8) -> bool {
        self.is_alone() || self.is_any_on(bus, &[Kind::TransmitStalled, Kind::CableOut])
    }

    /// What the master's interfaces tell of themselves in every cycle, with the number of the bus.
    pub(super) fn link_events(&self) -> impl Iterator<Item = (u8, LinkEvent)> {
        self.buses.into_iter().filter_map(|bus| match bus {
            _ if self.is_any_on(bus, &[Kind::BusOff]) => Some((bus, LinkEvent::BusOff)),
            _ if self.is_alone() || self.is_any_on(bus, &[Kind::ErrorPassive, Kind::CableOut]) => {
                Some((bus, LinkEvent::ErrorPassive))
            }
            _ => None,
        })
    }
}

impl Senses for Troubles {
    fn counts(&mut self, time_s: f64, counts: [i32; 6], calibration: &Calibration) -> [i32; 6] {
        let mut counts = counts;
        for active in &mut self.active {
            let Injection { kind, size, start_s, .. } = active.injection;
            let mut shift = |force_n: f64| {
                let wrench = Wrench(Vector6::new(force_n, 0.0, 0.0, 0.0, 0.0, 0.0));
                for (count, by) in counts.iter_mut().zip(calibration.counts_for(&wrench)) {
                    *count += by;
                }
            };
            match kind {
                Kind::SensorStuck => counts = *active.counts.get_or_insert(counts),
                Kind::SensorSaturated => counts[..2].fill(calibration.range_counts()),
                Kind::SensorJump => shift(size),
                Kind::SensorDrift => shift(size * (time_s - start_s)),
                _ => {}
            }
        }
        counts
    }

    fn encoder(&mut self, joint: usize, angle_rad: f64, rate_rad_per_s: f64) -> (f64, f64) {
        let (mut angle_rad, mut rate_rad_per_s) = (angle_rad, rate_rad_per_s);
        for active in self.active.iter_mut().filter(|active| active.injection.target.has_joint(joint)) {
            match active.injection.kind {
                Kind::EncoderJump | Kind::EncoderOffset => angle_rad += active.injection.size,
                Kind::EncoderStuck => {
                    (angle_rad, rate_rad_per_s) = (*active.angle_rad.get_or_insert(angle_rad), 0.0);
                }
                _ => {}
            }
        }
        (angle_rad, rate_rad_per_s)
    }

    fn torque_n_m(&self, joint: usize, state: cia402::State, torque_n_m: f64) -> f64 {
        let runaway = self.active.iter().find(|active| {
            active.injection.kind == Kind::DriveRunaway
                && active.injection.target.has_joint(joint)
                && state == cia402::State::OperationEnabled
        });
        runaway.map_or(torque_n_m, |active| active.injection.size)
    }
}

/// Whether `target` names the device: 0 the left drive, 1 the right drive, 2 the sensor.
pub(super) fn is_at(target: Target, device: usize) -> bool {
    target.has_joint(device) || (target == Target::Sensor && device == SENSOR)
}

fn hold(held: &mut Vec<Held>, time: Time, from: usize, frame: Frame) {
    if held.len() < HELD_FRAMES {
        held.push(Held { time, from, frame });
    }
}

/// Function codes of TPDO 1 to 4.
fn is_tpdo(frame: &Frame) -> bool {
    matches!(frame.id() >> 7, 3 | 5 | 7 | 9)
}

/// Function codes of RPDO 1 to 4.
fn is_rpdo(frame: &Frame) -> bool {
    matches!(frame.id() >> 7, 4 | 6 | 8 | 10)
}

/// What another master sends in place of a set-point.
fn foreign(own: Frame) -> Frame {
    let target = own.bits() >> 16;
    let target = match own.len() {
        4 => target.wrapping_add(FOREIGN_TORQUE_PER_MILLE) & 0xffff,
        _ => target.wrapping_add(FOREIGN_COUNTS) & 0xffff_ffff,
    };
    Frame::from_bits(own.id(), target << 16 | ENABLE_OPERATION, own.len()).on_bus(own.bus())
}

/// Changes the value in an expedited SDO answer about an object.
fn lie(frame: Frame, object: [u8; 3]) -> Frame {
    let mut data = *frame.bytes();
    let is_it = frame.id() & 0x780 == 0x580 && data[0] & 0xe0 == 0x40 && data[1..4] == object;
    if is_it {
        data[4] ^= 1;
    }
    if is_it { Frame::new(frame.id(), &data) } else { frame }
}
