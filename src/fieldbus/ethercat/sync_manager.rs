//! Sync managers: buffers that bus and device share without tearing.

use super::fmmu::Direction;
use super::{array, u16_at};

/// Mode in which a sync manager guards its buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BufferMode {
    /// Three buffers: each side always has the newest whole one.
    Three,
    /// One buffer that is written, then read, then written: a mailbox.
    Mailbox,
}

/// Settings of a sync manager by the master: 8 bytes of registers. The status and the values that the device sets are not included.
///
/// # Source
/// ETG.1000.4, 6.7.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncManager {
    /// First byte of memory.
    pub start: u16,
    /// Bytes.
    pub len: u16,
    /// Control byte: see the constants.
    pub control: u8,
    /// Whether it is in use.
    pub is_enabled: bool,
    /// Toggles to ask for the last mailbox once more.
    pub repeat: bool,
}

impl SyncManager {
    /// Bytes of registers.
    pub const SIZE: usize = 8;
    /// Offset of the status.
    pub const STATUS: usize = 5;
    /// Offset of the activation, which the master sets.
    pub const ACTIVATE: usize = 6;
    /// Offset of what the device sets: bit 0 switches the sync manager off, bit 1 acknowledges a repeat.
    pub const PDI_CONTROL: usize = 7;
    /// Control: one buffer.
    pub const MAILBOX: u8 = 0x02;
    /// Control: the master writes.
    pub const WRITE: u8 = 0x04;
    /// Control: an access interrupts the device.
    pub const INTERRUPT: u8 = 0x20;
    /// Control: a write contents the watchdog.
    pub const WATCHDOG: u8 = 0x40;
    /// Status: the mailbox is full.
    pub const FULL: u8 = 0x08;

    /// Reads a sync manager from the registers.
    pub fn decode(bytes: &[u8; Self::SIZE]) -> Self {
        let [control, _, activate] = array(bytes, 4);
        SyncManager {
            start: u16_at(bytes, 0),
            len: u16_at(bytes, 2),
            control,
            is_enabled: activate & 1 != 0,
            repeat: activate & 2 != 0,
        }
    }

    /// Returns the registers as a master writes them.
    pub fn encode(&self) -> [u8; Self::SIZE] {
        let ([a, b], [c, d]) = (self.start.to_le_bytes(), self.len.to_le_bytes());
        [a, b, c, d, self.control, 0, u8::from(self.is_enabled) | u8::from(self.repeat) << 1, 0]
    }

    /// Returns the direction of the data; `None` for a reserved code.
    pub const fn direction(&self) -> Option<Direction> {
        match self.control >> 2 & 3 {
            0 => Some(Direction::Read),
            1 => Some(Direction::Write),
            _ => None,
        }
    }

    /// Returns the mode in which it guards its buffer; `None` for a reserved code.
    pub const fn mode(&self) -> Option<BufferMode> {
        match self.control & 3 {
            0 => Some(BufferMode::Three),
            2 => Some(BufferMode::Mailbox),
            _ => None,
        }
    }

    /// Whether a write contents the watchdog.
    pub const fn has_watchdog(&self) -> bool {
        self.control & Self::WATCHDOG != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_four_usual_ones() {
        for (bytes, mode, direction, watchdog) in [
            ([0x00, 0x10, 0x80, 0x00, 0x26, 0x00, 0x01, 0x00], BufferMode::Mailbox, Direction::Write, false),
            ([0x00, 0x14, 0x80, 0x00, 0x22, 0x00, 0x01, 0x00], BufferMode::Mailbox, Direction::Read, false),
            ([0x00, 0x18, 0x0d, 0x00, 0x64, 0x00, 0x01, 0x00], BufferMode::Three, Direction::Write, true),
            ([0x00, 0x1c, 0x0f, 0x00, 0x20, 0x00, 0x01, 0x00], BufferMode::Three, Direction::Read, false),
        ] {
            let manager = SyncManager::decode(&bytes);
            assert_eq!((manager.mode(), manager.direction()), (Some(mode), Some(direction)));
            assert_eq!((manager.has_watchdog(), manager.is_enabled, manager.encode()), (watchdog, true, bytes));
        }
        let reserved = SyncManager::decode(&[0, 0, 0, 0, 0x0b, 0, 2, 0]);
        assert_eq!(
            (reserved.mode(), reserved.direction(), reserved.is_enabled, reserved.repeat),
            (None, None, false, true)
        );
    }
}
