//! Injected faults in the frames of a segment, on their way and back.

use std::collections::VecDeque;
use std::time::Duration;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use yieldwall_config::injection::{Injection, Kind};
use yieldwall_fieldbus::ethercat::frame::{self, Command, FrameWriter, Span};
use yieldwall_fieldbus::ethercat::registers as register;
use yieldwall_fieldbus::time::Time;

/// Source address of frames that the master has not sent, and the number of their datagram.
const STRANGER: [u8; 6] = [0x02, 0, 0, 0, 0, 0x99];
const STRANGE_INDEX: u8 = 0xee;
/// Distance of foreign targets from the last own ones: in per mille of the rated torque, and in counts or counts per second.
const FOREIGN_TORQUE_PER_MILLE: i16 = 500;
const FOREIGN_COUNTS: i32 = 131_072;
/// Output frames that are kept: the oldest is of an earlier cycle, also where a cycle has two.
pub(super) const KEPT: usize = 4;
/// Devices of which one is written to, by their position.
const POSITIONS: u64 = 3;
/// Registers that safety rests on, and foreign values: no watchdog, the longest one, an address that no device of a rig has.
const REGISTERS: [(u16, u16); 3] =
    [(register::WATCHDOG_SYNC_MANAGER, 0), (register::WATCHDOG_DIVIDER, 0xffff), (register::STATION_ADDRESS, 0x1fff)];

/// Injections that act on frames.
#[derive(Debug)]
pub(super) struct FrameFaults {
    active: Vec<Injection>,
    /// Frames that come back later.
    held: Vec<(Time, Vec<u8>)>,
    /// The last output frames of the master, the oldest first.
    outputs: VecDeque<Vec<u8>>,
    noise: Xoshiro256PlusPlus,
}

impl FrameFaults {
    /// Creates the state without faults. Random values come from `seed`.
    pub(super) fn new(seed: u64) -> Self {
        let noise = Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xfa17_0000_0000_0003);
        Self { active: Vec::new(), held: Vec::new(), outputs: VecDeque::new(), noise }
    }

    /// Begins an injection, or ends it.
    pub(super) fn switch(&mut self, injection: Injection, is_on: bool) {
        if is_on {
            self.active.push(injection);
        } else {
            self.active.retain(|active| *active != injection);
        }
    }

    pub(super) fn clear(&mut self) {
        self.active.clear();
    }

    /// Returns the time at which the next held frame comes back.
    pub(super) fn next_back(&self) -> Time {
        self.held.iter().map(|(due, _)| *due).min().unwrap_or(Time::NEVER)
    }

    /// Sends a frame of the master through the devices, and the frames of a foreign node behind it. `process` lets the devices
    /// process a frame, and returns the moment at which it is back. `back` receives each frame that comes back.
    pub(super) fn pass<E>(
        &mut self,
        bytes: &mut [u8],
        mut process: impl FnMut(&mut [u8]) -> Result<Option<Time>, E>,
        back: &mut impl FnMut(Time, &[u8]),
    ) -> Result<(), E> {
        if self.active.iter().any(|injection| injection.kind == Kind::FrameLost) {
            return Ok(());
        }
        let mut foreign = self.behind(bytes);
        let mut last = Time(0);
        for bytes in [bytes].into_iter().chain(foreign.iter_mut().map(Vec::as_mut_slice)) {
            if let Some(at) = process(bytes)? {
                // A short frame does not overtake a long one.
                last = last.max(at);
                self.hand_back(last, bytes, &mut |bytes: &[u8]| back(last, bytes));
            }
        }
        Ok(())
    }

    /// Returns the frames with the master's source that a foreign node sends behind this frame of the master.
    fn behind(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut foreign = Vec::new();
        if !datagrams(bytes).any(|span| has_outputs(&span)) {
            return foreign;
        }
        let Self { active, outputs, noise, .. } = self;
        for injection in active.iter() {
            match injection.kind {
                Kind::ForeignOutputs => foreign.push(forged(bytes, noise.next_u64() as u8)),
                Kind::ReplayedOutputs => foreign.extend(outputs.front().cloned()),
                Kind::ForeignRegisterWrite => {
                    let source = bytes.get(6..12).and_then(|source| source.try_into().ok()).unwrap_or(STRANGER);
                    foreign.push(register_write(source, (noise.next_u64() % POSITIONS) as u16, injection.size));
                }
                _ => {}
            }
        }
        let mut kept = if outputs.len() < KEPT {
            Vec::with_capacity(frame::LONGEST)
        } else {
            outputs.pop_front().unwrap_or_default()
        };
        kept.clear();
        kept.extend_from_slice(bytes);
        outputs.push_back(kept);
        foreign
    }

    /// Hands the frames on that come back by now.
    pub(super) fn send_due(&mut self, now: Time, back: &mut impl FnMut(&[u8])) {
        self.held.retain(|(due, bytes)| {
            let waits = *due > now;
            if !waits {
                back(bytes);
            }
            waits
        });
    }

    /// Hands a frame on that comes back, as what acts on frames lets it.
    fn hand_back(&mut self, now: Time, bytes: &mut [u8], back: &mut impl FnMut(&[u8])) {
        let (mut delay, mut is_twice, mut length) = (None, false, bytes.len());
        for injection in &self.active {
            match injection.kind {
                Kind::FrameDelayed => delay = Some(Duration::from_secs_f64(injection.size)),
                Kind::FrameDuplicated => is_twice = true,
                Kind::FrameForeign => strange(back),
                Kind::FrameShort => length = frame::end(bytes).map_or(length, |end| end.saturating_sub(1)),
                Kind::FrameCorrupt => flip(bytes, injection.size as u32, &mut self.noise),
                _ => {}
            }
        }
        let bytes = bytes.get(..length).unwrap_or_default();
        for _ in 0..if is_twice { 2 } else { 1 } {
            match delay {
                Some(delay) => self.held.push((now + delay, bytes.to_vec())),
                None => back(bytes),
            }
        }
    }
}

/// Sends a frame with the type of EtherCAT that the master has not sent.
fn strange(back: &mut impl FnMut(&[u8])) {
    let mut buffer = [0; frame::SHORTEST];
    let Ok(mut writer) = FrameWriter::new(&mut buffer, STRANGER) else { return };
    if writer.push(Command::Nop, STRANGE_INDEX, 0, &[0; 4]).is_ok() {
        back(writer.finish());
    }
}

/// Returns the datagrams of a frame up to its end, or to the first invalid one.
fn datagrams(bytes: &[u8]) -> impl Iterator<Item = Span> {
    let end = frame::end(bytes).unwrap_or_default();
    let mut next = Some(frame::HEADER);
    std::iter::from_fn(move || {
        let span = frame::datagram_at(bytes, next?, end).ok()?;
        next = span.header.has_more.then_some(span.end());
        Some(span)
    })
}

/// Whether a datagram has outputs for devices.
fn has_outputs(span: &Span) -> bool {
    matches!(Command::from_byte(span.header.command), Some(Command::Lwr | Command::Lrw))
}

/// Outputs of the master with another number and other targets.
fn forged(outputs: &[u8], index: u8) -> Vec<u8> {
    let mut forged = outputs.to_vec();
    for span in datagrams(outputs) {
        if let Some(to) = forged.get_mut(span.start + 1) {
            *to = index;
        }
        let data = forged.get_mut(span.data.clone()).filter(|_| has_outputs(&span)).unwrap_or_default();
        // Controlword, then a torque of 16 bits, or a position or rate of 32.
        if let [_, _, low, high] = data {
            let torque = i16::from_le_bytes([*low, *high]).wrapping_add(FOREIGN_TORQUE_PER_MILLE);
            [*low, *high] = torque.to_le_bytes();
        } else if let [_, _, a, b, c, d, ..] = data {
            let counts = i32::from_le_bytes([*a, *b, *c, *d]).wrapping_add(FOREIGN_COUNTS);
            [*a, *b, *c, *d] = counts.to_le_bytes();
        }
    }
    forged
}

/// Returns a frame that writes to a register of the device at a position: 0420h, 0400h or 0010h, by its number from 0 to 2.
pub(super) fn register_write(source: [u8; 6], position: u16, number: f64) -> Vec<u8> {
    let mut buffer = [0; frame::SHORTEST];
    let Ok(mut writer) = FrameWriter::new(&mut buffer, source) else { return Vec::new() };
    let (register, value) = REGISTERS[(number.round().max(0.0) as usize).min(REGISTERS.len() - 1)];
    let at = frame::address(position.wrapping_neg(), register);
    let is_written = writer.push(Command::Apwr, STRANGE_INDEX, at, &value.to_le_bytes()).is_ok();
    if is_written { writer.finish().to_vec() } else { Vec::new() }
}

/// Flips random bits of the datagrams.
fn flip(bytes: &mut [u8], bits: u32, noise: &mut Xoshiro256PlusPlus) {
    let end = frame::end(bytes).unwrap_or_default();
    let Some(datagrams) = bytes.get_mut(frame::HEADER..end).filter(|datagrams| !datagrams.is_empty()) else { return };
    for _ in 0..bits {
        let bit = noise.next_u64() % (8 * datagrams.len() as u64);
        if let Some(byte) = datagrams.get_mut((bit / 8) as usize) {
            *byte ^= 1 << (bit % 8);
        }
    }
}
