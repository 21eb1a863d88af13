//! Keys by which a person guides a joint, passed from the thread that reads them to the loop.

use std::sync::atomic::{AtomicU32, Ordering};

/// Request of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// Counter-clockwise, for as long as keys come.
    Forward,
    /// Clockwise, for as long as keys come.
    Backward,
    /// Rest.
    Rest,
    /// Rest, and the end.
    End,
}

impl Key {
    const ALL: [Self; 4] = [Self::Rest, Self::Forward, Self::Backward, Self::End];
}

/// The key that was pressed last, and the number of keys before it. A joint goes on for [`Keys::HOLDS_S`] after a key, so that it
/// rests when no more keys come, for whatever reason.
///
/// One thread presses, one loop reads.
#[derive(Debug, Default)]
pub struct Keys(AtomicU32);

impl Keys {
    /// How long a key holds, s.
    pub const HOLDS_S: f64 = 0.2;
    /// Bits of a key; the others count.
    const BITS: u32 = 2;

    /// Passes a key on. After [`Key::End`] further keys have no effect.
    pub fn press(&self, key: Key) {
        let before = self.0.load(Ordering::Relaxed);
        if Self::key(before) == Key::End {
            return;
        }
        let at = Key::ALL.iter().position(|known| *known == key).unwrap_or_default() as u32;
        let count = (before >> Self::BITS).wrapping_add(1);
        self.0.store(count << Self::BITS | at, Ordering::Relaxed);
    }

    /// Whether [`Key::End`] was pressed.
    pub(super) fn has_ended(&self) -> bool {
        self.last().1 == Key::End
    }

    /// Returns the key that was pressed last, with a number that differs from that of the key before.
    ///
    /// Real-time: yes.
    pub(super) fn last(&self) -> (u32, Key) {
        let word = self.0.load(Ordering::Relaxed);
        (word >> Self::BITS, Self::key(word))
    }

    fn key(word: u32) -> Key {
        let at = word & ((1 << Self::BITS) - 1);
        Key::ALL.get(at as usize).copied().unwrap_or(Key::End)
    }
}

/// Direction in which keys guide a joint, cycle by cycle.
#[derive(Debug)]
pub(super) struct Led<'a> {
    keys: &'a Keys,
    seen: u32,
    /// 1, -1 or 0.
    way: f64,
    /// Cycles for which the last key holds still, and for which one does.
    left: u32,
    holds: u32,
}

impl<'a> Led<'a> {
    /// Keys that were pressed before are not heard. `holds` is [`Keys::HOLDS_S`] in cycles.
    pub(super) fn new(keys: &'a Keys, holds: u32) -> Self {
        Self { keys, seen: keys.last().0, way: 0.0, left: 0, holds }
    }

    /// Returns the direction of the joint in this cycle: 1 counter-clockwise, -1 clockwise, 0 none; `None` at the end.
    ///
    /// Real-time: yes.
    pub(super) fn way(&mut self) -> Option<f64> {
        let (number, key) = self.keys.last();
        if number != self.seen {
            self.seen = number;
            self.left = self.holds;
            self.way = match key {
                Key::Forward => 1.0,
                Key::Backward => -1.0,
                Key::Rest | Key::End => 0.0,
            };
        } else {
            self.left = self.left.saturating_sub(1);
        }
        if self.left == 0 {
            self.way = 0.0;
        }
        (key != Key::End).then_some(self.way)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_holds_for_its_time_and_no_longer() {
        let keys = Keys::default();
        keys.press(Key::Forward);
        let mut led = Led::new(&keys, 3);
        assert_eq!(led.way(), Some(0.0), "one from before");
        keys.press(Key::Forward);
        let ways: Vec<_> = (0..5).map(|_| led.way()).collect();
        assert_eq!(ways, [1.0, 1.0, 1.0, 0.0, 0.0].map(Some));
        keys.press(Key::Backward);
        assert_eq!(led.way(), Some(-1.0));
        keys.press(Key::Backward);
        assert_eq!((0..4).map(|_| led.way()).collect::<Vec<_>>(), [-1.0, -1.0, -1.0, 0.0].map(Some));
        keys.press(Key::Forward);
        keys.press(Key::Rest);
        assert_eq!(led.way(), Some(0.0));
        keys.press(Key::End);
        keys.press(Key::Forward);
        assert_eq!(led.way(), None, "the end is the end");
    }
}
