//! Injected faults of a frame between the wire and its receivers.

use std::time::Duration;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::super::buses::{DEVICES, MASTER};
use super::held::Held;
use super::participant::{Participants, is_set_point};
use yieldwall_config::injection::{Injection, Kind};
use yieldwall_fieldbus::canopen::{Frame, cob};
use yieldwall_fieldbus::time::Time;

/// Vendor id (1018h, sub-index 1) and greatest torque (6072h), as an SDO answer names them.
const VENDOR_ID: [u8; 3] = [0x18, 0x10, 1];
const MAX_TORQUE: [u8; 3] = [0x72, 0x60, 0];

/// Frames pass, or are lost, held, doubled, exchanged or changed.
#[derive(Debug)]
pub(super) struct Disturbance {
    active: Vec<Active>,
    noise: Xoshiro256PlusPlus,
}

#[derive(Clone, Copy, Debug)]
struct Active {
    injection: Injection,
    /// Frames so far.
    count: u32,
    /// The one that the next one overtakes.
    overtaken: Option<Frame>,
}

/// Relation of a frame to the target of an injection.
struct Relation {
    /// A device of the target has sent it ...
    is_from: bool,
    /// ... as process data ...
    is_data: bool,
    /// ... or as its heartbeat.
    is_heartbeat: bool,
    /// The master has sent it to a device of the target.
    is_to: bool,
}

impl Relation {
    fn of(injection: &Injection, participants: &Participants, from: usize, frame: &Frame) -> Self {
        let is_named = |at: usize| injection.target.has_device(at);
        let sender = DEVICES.iter().position(|port| *port == from).filter(|at| is_named(*at));
        let sender = sender.and_then(|at| participants.get(at));
        let mut named = participants.iter().enumerate().filter(|(at, _)| is_named(*at));
        Self {
            is_from: sender.is_some(),
            is_data: sender.is_some_and(|device| device.is_data(frame)),
            is_heartbeat: sender.is_some_and(|device| device.is_heartbeat(frame)),
            is_to: from == MASTER && named.any(|(_, device)| device.is_addressed(frame)),
        }
    }
}

impl Disturbance {
    /// Creates a passage without faults. Random values come from `seed`.
    pub(super) fn none(seed: u64) -> Self {
        Self { active: Vec::new(), noise: Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xfa17_0000_0000_0002) }
    }

    pub(super) fn clear(&mut self) {
        self.active.clear();
    }

    /// Begins an injection, or ends it.
    pub(super) fn switch(&mut self, injection: Injection, is_on: bool) {
        if is_on {
            self.active.push(Active { injection, count: 0, overtaken: None });
        } else if let Some(at) = self.active.iter().position(|active| active.injection == injection) {
            self.active.remove(at);
        }
    }

    /// Returns the frame that receivers get now for a frame that was on the wire.
    pub(super) fn pass(
        &mut self,
        now: Time,
        from: usize,
        frame: Frame,
        participants: &Participants,
        held: &mut Held,
    ) -> Option<Frame> {
        let Self { active, noise } = self;
        active.iter_mut().try_fold(frame, |frame, active| {
            let relation = Relation::of(&active.injection, participants, from, &frame);
            let changed = match active.injection.kind {
                Kind::PdoDelayed | Kind::PdoJitter | Kind::PdoDuplicated | Kind::PdoReordered => {
                    active.hold(now, from, frame, &relation, held)
                }
                _ => active.change(frame, &relation, noise),
            };
            changed.map(|changed| changed.on_bus(frame.bus()))
        })
    }
}

impl Active {
    /// Returns the frame that receivers get now; others may come later.
    fn hold(&mut self, now: Time, from: usize, frame: Frame, relation: &Relation, held: &mut Held) -> Option<Frame> {
        if !relation.is_data {
            return Some(frame);
        }
        let later = now + Duration::from_secs_f64(self.injection.size.max(0.0));
        match self.injection.kind {
            Kind::PdoDelayed => {
                held.hold(later, from, frame);
                return None;
            }
            Kind::PdoJitter => {
                self.count += 1;
                if self.count.is_multiple_of(3) {
                    held.hold(later, from, frame);
                    return None;
                }
            }
            Kind::PdoDuplicated => held.hold(now, from, frame),
            _ => match self.overtaken.take() {
                Some(earlier) => held.hold(now, from, earlier),
                None => {
                    self.overtaken = Some(frame);
                    return None;
                }
            },
        }
        Some(frame)
    }

    /// Returns the frame that receivers get instead of a frame.
    fn change(&self, frame: Frame, relation: &Relation, noise: &mut Xoshiro256PlusPlus) -> Option<Frame> {
        let Relation { is_from, is_data, is_heartbeat, is_to } = *relation;
        let is_set_point = is_to && is_set_point(&frame);
        Some(match self.injection.kind {
            Kind::PdoLost | Kind::SensorSilent if is_data => return None,
            Kind::SetPointsLost if is_set_point => return None,
            Kind::SyncLost if frame.id() == cob::SYNC => return None,
            Kind::HeartbeatSilent if is_heartbeat => return None,
            Kind::WrongBitRate if is_from || is_to => return None,
            Kind::WrongNodeId if is_to && !is_set_point => return None,
            Kind::WrongNodeId if is_from => {
                Frame::from_bits(frame.id() & 0x780 | (frame.id() + 0x20) & 0x7f, frame.bits(), frame.len())
            }
            Kind::PdoCorrupt if is_data => {
                let bits = 8 * u64::from(frame.len()).max(1);
                let flips = (0..self.injection.size as u32).fold(0, |flips, _| flips ^ 1 << (noise.next_u64() % bits));
                Frame::from_bits(frame.id(), frame.bits() ^ flips, frame.len())
            }
            Kind::PdoShort if is_data => Frame::from_bits(frame.id(), frame.bits(), frame.len().saturating_sub(1)),
            Kind::IdentityMismatch if is_from => lie(frame, VENDOR_ID),
            Kind::ConfigDrift if is_from => lie(frame, MAX_TORQUE),
            _ => frame,
        })
    }
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
