//! The state of one sync manager: which buffer is whose, and whether a mailbox is full.

use std::ops::Range;
use yieldwall_fieldbus::ethercat::{BufferMode, Direction, SyncManager};

/// One sync manager.
#[derive(Clone, Copy, Debug)]
pub(super) struct Manager {
    pub(super) settings: SyncManager,
    /// The device has switched it off.
    pub(super) is_held: bool,
    /// The last toggle of a repeat that the device has answered.
    pub(super) repeat_answered: bool,
    /// The bus has touched the first byte and not yet the last one.
    is_open: bool,
    pub(super) is_full: bool,
    /// Numbers of the buffers of the bus, of the newest whole one, and of the device.
    bus: u8,
    newest: u8,
    device: u8,
    /// The newest whole one has not been taken.
    is_fresh: bool,
    /// Whether anything was ever written.
    is_written: bool,
}

/// Event that an access of the bus has completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// Nothing: the last byte was not touched.
    Nothing,
    /// A whole buffer was written.
    Written,
    /// A whole buffer was read.
    Read,
}

impl Manager {
    pub(super) fn new() -> Self {
        let settings = SyncManager { start: 0, len: 0, control: 0, is_enabled: false, repeat: false };
        let (is_held, is_open, is_full) = (false, false, false);
        let (bus, newest, device, is_fresh, is_written) = (0, 1, 2, false, false);
        Manager {
            settings,
            is_held,
            repeat_answered: false,
            is_open,
            is_full,
            bus,
            newest,
            device,
            is_fresh,
            is_written,
        }
    }

    /// Takes new settings; when they switch it on or off, its buffers are empty again.
    pub(super) fn set(&mut self, settings: SyncManager) {
        if settings.is_enabled != self.settings.is_enabled {
            let (is_held, repeat_answered) = (self.is_held, self.repeat_answered);
            *self = Manager { is_held, repeat_answered, ..Manager::new() };
        }
        self.settings = settings;
    }

    /// Empties its buffers.
    pub(super) fn empty(&mut self) {
        let settings = self.settings;
        let (is_held, repeat_answered) = (self.is_held, self.repeat_answered);
        *self = Manager { settings, is_held, repeat_answered, ..Manager::new() };
    }

    pub(super) fn is_active(&self) -> bool {
        self.settings.is_enabled && !self.is_held && self.settings.len > 0
    }

    /// The addresses at which the bus sees it.
    pub(super) fn seen(&self) -> Range<usize> {
        let start = usize::from(self.settings.start);
        start..start + usize::from(self.settings.len)
    }

    /// The addresses that it takes up.
    pub(super) fn taken(&self) -> Range<usize> {
        let buffers = if self.settings.mode() == Some(BufferMode::Mailbox) { 1 } else { 3 };
        let start = usize::from(self.settings.start);
        start..start + buffers * usize::from(self.settings.len)
    }

    /// The memory of one of the three buffers.
    fn buffer(&self, number: u8) -> Range<usize> {
        let Range { start, end } = self.seen();
        let shift = usize::from(number) * (end - start);
        start + shift..end + shift
    }

    /// Where in memory an access of the bus goes, which lies within what it sees; `None` if it is refused.
    pub(super) fn bus_access(&mut self, access: &Range<usize>, direction: Direction) -> Option<usize> {
        let (seen, mode) = (self.seen(), self.settings.mode()?);
        if self.is_held || self.settings.direction() != Some(direction) {
            return None;
        }
        if mode == BufferMode::Mailbox && self.is_full != (direction == Direction::Read) {
            return None;
        }
        if access.start == seen.start {
            if mode == BufferMode::Three && direction == Direction::Read && self.is_fresh {
                std::mem::swap(&mut self.bus, &mut self.newest);
                self.is_fresh = false;
            }
            self.is_open = true;
        }
        if !self.is_open {
            return None;
        }
        let buffer = if mode == BufferMode::Three { self.buffer(self.bus) } else { seen.clone() };
        Some(buffer.start + (access.start - seen.start))
    }

    /// After an access of the bus.
    pub(super) fn bus_done(&mut self, access: &Range<usize>, direction: Direction) -> Ended {
        if access.end != self.seen().end {
            return Ended::Nothing;
        }
        self.is_open = false;
        let is_mailbox = self.settings.mode() == Some(BufferMode::Mailbox);
        match direction {
            Direction::Write if is_mailbox => self.is_full = true,
            Direction::Write => self.publish_from_bus(),
            Direction::Read if is_mailbox => self.is_full = false,
            Direction::Read => {}
        }
        if direction == Direction::Write { Ended::Written } else { Ended::Read }
    }

    fn publish_from_bus(&mut self) {
        std::mem::swap(&mut self.bus, &mut self.newest);
        (self.is_fresh, self.is_written) = (true, true);
    }

    /// The memory that the device reads: the newest whole buffer, and whether it is a new one.
    pub(super) fn device_read(&mut self) -> (Range<usize>, bool) {
        if self.settings.mode() == Some(BufferMode::Mailbox) {
            return (self.seen(), self.is_full);
        }
        let is_new = std::mem::take(&mut self.is_fresh);
        if is_new {
            std::mem::swap(&mut self.device, &mut self.newest);
        }
        (self.buffer(self.device), is_new)
    }

    /// The memory that the device writes next.
    pub(super) fn device_write(&self) -> Range<usize> {
        if self.settings.mode() == Some(BufferMode::Mailbox) { self.seen() } else { self.buffer(self.device) }
    }

    /// The device has written a whole buffer.
    pub(super) fn device_done(&mut self) {
        if self.settings.mode() == Some(BufferMode::Mailbox) {
            self.is_full = true;
        } else {
            std::mem::swap(&mut self.device, &mut self.newest);
            (self.is_fresh, self.is_written) = (true, true);
        }
    }

    /// The status as the register shows it.
    pub(super) fn status(&self) -> u8 {
        match self.settings.mode() {
            Some(BufferMode::Mailbox) if self.is_full => SyncManager::FULL,
            Some(BufferMode::Mailbox) => 0,
            _ if !self.is_written => 3 << 4,
            _ => (self.newest & 3) << 4,
        }
    }
}
