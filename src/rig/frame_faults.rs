//! What is broken in the frames of a segment, on their way and back.

use std::time::Duration;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use crate::ethercat::frame::{self, Command, FrameWriter};
use crate::injection::{Injection, Kind};
use crate::time::Time;

/// Who sends frames that the master has not sent, and the number of their datagram.
const STRANGER: [u8; 6] = [0x02, 0, 0, 0, 0, 0x99];
const STRANGE_INDEX: u8 = 0xee;

/// What acts on frames.
#[derive(Debug)]
pub(super) struct FrameFaults {
    active: Vec<Injection>,
    /// Frames that come back later.
    held: Vec<(Time, Vec<u8>)>,
    noise: Xoshiro256PlusPlus,
}

impl FrameFaults {
    /// None. Whatever is random in what follows comes from `seed`.
    pub(super) fn new(seed: u64) -> Self {
        let noise = Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xfa17_0000_0000_0003);
        Self { active: Vec::new(), held: Vec::new(), noise }
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

    /// When a frame comes back next that was held.
    pub(super) fn next_back(&self) -> Time {
        self.held.iter().map(|(due, _)| *due).min().unwrap_or(Time::NEVER)
    }

    /// Whether a frame reaches the first device.
    pub(super) fn lets_in(&self) -> bool {
        !self.active.iter().any(|injection| injection.kind == Kind::FrameLost)
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
    pub(super) fn hand_back(&mut self, now: Time, bytes: &mut [u8], back: &mut impl FnMut(&[u8])) {
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

/// A frame with the type of EtherCAT that the master has not sent.
fn strange(back: &mut impl FnMut(&[u8])) {
    let mut buffer = [0; frame::SHORTEST];
    let Ok(mut writer) = FrameWriter::new(&mut buffer, STRANGER) else { return };
    if writer.push(Command::Nop, STRANGE_INDEX, 0, &[0; 4]).is_ok() {
        back(writer.finish());
    }
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
