//! Frames that others than the devices send.

use std::time::Duration;

use super::super::buses::{DEVICES, MASTER, STRANGER};
use super::held::Held;
use super::participant::{Participants, Speaks, is_set_point};
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_fieldbus::canopen::{Frame, NodeId, cob};
use yieldwall_fieldbus::time::Time;

/// Heartbeat of another master, node 126.
const SECOND_HEARTBEAT: u16 = 0x77e;
/// Enable Operation, as a foreign set-point carries it ...
const ENABLE_OPERATION: u64 = 0x000f;
/// ... and how far its target is from the last own one: 500 per mille of the rated torque in a frame of 4 bytes ...
const FOREIGN_TORQUE_PER_MILLE: u64 = 500;
/// ... and in one of 6 bytes so many counts, or counts per second: about a radian for the shipped drives.
const FOREIGN_COUNTS: u64 = 1 << 17;
/// Emergency of a drive: voltage of the DC link too high; of the sensor: device hardware.
const EMERGENCIES: [u16; 3] = [0x3210, 0x3210, 0x5000];
/// Emergency that is a warning: messages were lost.
const WARNING: u16 = 0x8110;
/// Download of 6007h = 0 in two bytes: the drive goes on when its master's heartbeat stays away.
const ABORT_CONNECTION_IGNORED: [u8; 8] = [0x2b, 0x07, 0x60, 0, 0, 0, 0, 0];

/// Somebody on the buses who is not of the rig.
#[derive(Debug, Default)]
pub(super) struct Stranger {
    active: Vec<Active>,
    /// The last set-points of the master, which it has overheard: noted from the beginning, so that it has some when it begins.
    set_points: [Option<Frame>; 2],
}

#[derive(Clone, Copy, Debug)]
struct Active {
    injection: Injection,
    /// Cycles so far.
    count: u32,
}

impl Stranger {
    /// Whether an injection is of what it sends cycle by cycle.
    pub(super) fn has(kind: Kind) -> bool {
        matches!(kind, Kind::ForeignSetPoint | Kind::SecondMaster | Kind::IntruderSync | Kind::DuplicateNode)
    }

    pub(super) fn clear(&mut self) {
        self.active.clear();
    }

    /// Begins an injection, or ends it.
    pub(super) fn switch(&mut self, injection: Injection, is_on: bool) {
        if is_on {
            self.active.push(Active { injection, count: 0 });
        } else if let Some(at) = self.active.iter().position(|active| active.injection == injection) {
            self.active.remove(at);
        }
    }

    /// Notes set-points.
    pub(super) fn overhear(&mut self, from: usize, frame: Frame, participants: &Participants) {
        if from == MASTER && is_set_point(&frame) {
            for (device, set_point) in participants.iter().zip(&mut self.set_points) {
                if device.is_addressed(&frame) {
                    *set_point = Some(frame);
                }
            }
        }
    }

    /// Sends what belongs to the cycle that begins at `sync_at`.
    pub(super) fn begin_cycle(
        &mut self,
        sync_at: Time,
        period: Duration,
        participants: &Participants,
        held: &mut Held,
    ) {
        let set_points = &self.set_points;
        for active in &mut self.active {
            let Injection { kind, target, size, .. } = active.injection;
            let mut send = |at: Time, frame: Frame| held.hold(at, STRANGER, frame);
            match kind {
                Kind::ForeignSetPoint => {
                    let own = set_points.iter().enumerate().filter(|(joint, _)| target.has_joint(*joint));
                    own.filter_map(|(_, frame)| *frame)
                        .for_each(|own| send(sync_at + period.mul_f64(size), foreign(own)));
                }
                Kind::SecondMaster => {
                    second_master(active.count == 0, sync_at, period, participants, &mut send);
                    let own = set_points.iter().flatten();
                    own.for_each(|own| send(sync_at + period * 3 / 4, foreign(*own)));
                }
                Kind::IntruderSync => {
                    let first = participants.iter().find(|device| device.is_on_can());
                    first.into_iter().for_each(|first| {
                        send(sync_at + period / 2, Frame::new(cob::SYNC, &[]).on_bus(first.bus));
                    });
                }
                Kind::DuplicateNode => {
                    for (_, device) in participants.iter().enumerate().filter(|(at, _)| target.has_device(*at)) {
                        let Speaks::Canopen { node, heartbeat } = device.speaks else { continue };
                        let cycles = (heartbeat.as_nanos() / period.as_nanos()).max(1) as u32;
                        if active.count.is_multiple_of(cycles) {
                            // Late in the cycle, where it is in nobody's way.
                            let heartbeat = Frame::new(cob::heartbeat(node), &[0x05]).on_bus(device.bus);
                            send(sync_at + period * 9 / 10, heartbeat);
                        }
                    }
                }
                _ => {}
            }
            active.count += 1;
        }
    }
}

/// Sends the frames of another master in a cycle to all nodes, first of all a heartbeat and a reset.
fn second_master(
    is_first: bool,
    sync_at: Time,
    period: Duration,
    participants: &Participants,
    send: &mut impl FnMut(Time, Frame),
) {
    let mut buses = participants.map(|device| device.bus).to_vec();
    buses.sort_unstable();
    buses.dedup();
    for bus in buses {
        if is_first {
            send(sync_at, Frame::new(SECOND_HEARTBEAT, &[0x00]).on_bus(bus));
            send(sync_at, Frame::new(cob::NMT, &[0x81, 0x00]).on_bus(bus));
        } else {
            send(sync_at + period / 4, Frame::new(SECOND_HEARTBEAT, &[0x05]).on_bus(bus));
        }
        send(sync_at + period / 2, Frame::new(cob::SYNC, &[]).on_bus(bus));
    }
}

/// Returns the frame that another master sends in place of a set-point.
fn foreign(own: Frame) -> Frame {
    let target = own.bits() >> 16;
    let target = match own.len() {
        4 => target.wrapping_add(FOREIGN_TORQUE_PER_MILLE) & 0xffff,
        _ => target.wrapping_add(FOREIGN_COUNTS) & 0xffff_ffff,
    };
    Frame::from_bits(own.id(), target << 16 | ENABLE_OPERATION, own.len()).on_bus(own.bus())
}

/// Makes a single frame arrive now, for each CANopen node that is named.
pub(super) fn send_once(now: Time, injection: Injection, participants: &Participants, held: &mut Held) {
    for (at, device) in participants.iter().enumerate().filter(|(at, _)| injection.target.has_device(*at)) {
        let Some(node) = device.node() else { continue };
        let (from, frame) = match injection.kind {
            Kind::Emergency => (DEVICES[at], emergency(node, EMERGENCIES[at])),
            Kind::EmergencyWarning => (DEVICES[at], emergency(node, WARNING)),
            Kind::IntruderNmt => (STRANGER, Frame::new(cob::NMT, &[0x80, node.raw()])),
            Kind::ForeignDownload => (STRANGER, Frame::new(cob::sdo_request(node), &ABORT_CONNECTION_IGNORED)),
            _ => continue,
        };
        held.hold(now, from, frame.on_bus(device.bus));
    }
}

fn emergency(node: NodeId, code: u16) -> Frame {
    let [low, high] = code.to_le_bytes();
    Frame::new(cob::emcy(node), &[low, high, 0x01, 0, 0, 0, 0, 0])
}
