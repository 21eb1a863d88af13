//! Bus access to registers, memory, and logical addresses.

use super::super::application::EthercatApplication;
use super::{Clock, Controller, Ended, FMMUS, INPUTS, MAILBOX_IN, MAILBOX_OUT, MANAGERS, OUTPUTS, RAM_END};
use std::ops::Range;
use yieldwall_fieldbus::ethercat::registers as register;
use yieldwall_fieldbus::ethercat::{Direction, Fmmu, SyncManager, array, u16_at, u32_at};

const REGISTERS_END: usize = register::PROCESS_DATA as usize;
const FMMU_REGISTERS: Range<usize> = register::FMMU as usize..register::FMMU as usize + FMMUS * Fmmu::SIZE;
const MANAGER_REGISTERS: Range<usize> =
    register::SYNC_MANAGER as usize..register::SYNC_MANAGER as usize + MANAGERS * SyncManager::SIZE;

fn touches(range: &Range<usize>, at: u16, len: usize) -> bool {
    let at = usize::from(at);
    range.start < at + len && at < range.end
}

/// Registers that the master may simply set.
const fn is_plain(at: usize) -> bool {
    matches!(at,
        0x0010..=0x0011 | 0x0100..=0x0103 | 0x0120..=0x0121 | 0x0200..=0x0201 | 0x0400..=0x0401 | 0x0410..=0x0411
        | 0x0420..=0x0421 | 0x0500 | 0x0504..=0x050f | 0x0920..=0x092b | 0x0930..=0x0931 | 0x0934..=0x0935 | 0x0980..=0x0981
        | 0x0990..=0x0997 | 0x09a0..=0x09a9)
        || at >= FMMU_REGISTERS.start && at < FMMU_REGISTERS.end
}

impl<D: EthercatApplication> Controller<D> {
    /// Reads into a datagram, with OR where all devices answer; gives what the working counter rises by.
    pub(super) fn read(&mut self, ado: u16, data: &mut [u8], is_or: bool) -> u16 {
        let mut read = std::mem::take(&mut self.scratch);
        let mut added = 0;
        if let Some(read) = read.get_mut(..data.len())
            && self.fetch(ado.into(), read)
        {
            data.iter_mut().zip(read.iter()).for_each(|(to, from)| *to = if is_or { *to | *from } else { *from });
            added = 1;
        }
        self.scratch = read;
        added
    }

    /// Writes from a datagram.
    pub(super) fn write(&mut self, ado: u16, data: &[u8]) -> u16 {
        u16::from(self.store(ado.into(), data))
    }

    /// Reads, then writes what the datagram had.
    pub(super) fn read_write(&mut self, ado: u16, data: &mut [u8], is_or: bool) -> u16 {
        let mut read = std::mem::take(&mut self.scratch);
        let mut added = 0;
        if let Some(read) = read.get_mut(..data.len()) {
            let is_read = self.fetch(ado.into(), read);
            let is_written = self.store(ado.into(), data);
            if is_read {
                data.iter_mut().zip(read.iter()).for_each(|(to, from)| *to = if is_or { *to | *from } else { *from });
            }
            added = u16::from(is_read) + 2 * u16::from(is_written);
        }
        self.scratch = read;
        added
    }

    /// Reads or writes by logical address; gives what the working counter rises by.
    pub(super) fn logical(&mut self, logical: u32, data: &mut [u8], reads: bool, writes: bool) -> u16 {
        let mut sent = std::mem::take(&mut self.scratch);
        let (mut is_read, mut is_written) = (false, false);
        if let Some(sent) = sent.get_mut(..data.len()) {
            if writes {
                sent.copy_from_slice(data);
            }
            for place in 0..FMMUS {
                let fmmu = self.fmmus[place];
                if !fmmu.is_active {
                    continue;
                }
                if reads && fmmu.reads {
                    is_read |= self.map(&fmmu, logical, data, Direction::Read);
                }
                if writes && fmmu.writes {
                    is_written |= self.map(&fmmu, logical, sent, Direction::Write);
                }
            }
        }
        self.scratch = sent;
        let weight = if reads { 2 } else { 1 };
        u16::from(is_read) + weight * u16::from(is_written)
    }

    /// Moves what an FMMU maps of a datagram; whether it was allowed.
    fn map(&mut self, fmmu: &Fmmu, logical: u32, data: &mut [u8], direction: Direction) -> bool {
        // Logical addresses go round at 2^32: the difference says where one lies in the other.
        let (start, end) = (u64::from(logical), u64::from(logical) + data.len() as u64);
        let (first, last) = (u64::from(fmmu.logical), u64::from(fmmu.logical) + u64::from(fmmu.len));
        let (from, to) = (start.max(first), end.min(last));
        if from >= to {
            return false;
        }
        if !fmmu.is_bytewise() {
            return self.map_bits(fmmu, logical, data, direction);
        }
        let Some(part) = data.get_mut((from - start) as usize..(to - start) as usize) else { return false };
        let physical = usize::from(fmmu.physical) + (from - first) as usize;
        match direction {
            Direction::Read => self.fetch(physical, part),
            Direction::Write => self.store(physical, part),
        }
    }

    /// As [`Controller::map`], bit by bit: the bits that both datagram and FMMU have, through the bytes of memory that they touch.
    fn map_bits(&mut self, fmmu: &Fmmu, logical: u32, data: &mut [u8], direction: Direction) -> bool {
        // Bits are counted from the first logical bit of the FMMU on.
        let origin = 8 * i64::from(fmmu.logical) + i64::from(fmmu.start_bit);
        let begin = (8 * i64::from(logical) - origin).max(0);
        let end = (8 * (i64::from(logical) + data.len() as i64) - origin).min(i64::from(fmmu.bit_len()));
        if begin >= end {
            return false;
        }
        let physical_bit = |bit: i64| (bit + i64::from(fmmu.physical_bit)) as usize;
        let start = usize::from(fmmu.physical) + physical_bit(begin) / 8;
        let bytes = physical_bit(end - 1) / 8 - physical_bit(begin) / 8 + 1;
        // A datagram has 2047 bytes at most, and shifted bits reach into one more.
        let mut image = [0; 2048];
        let Some(image) = image.get_mut(..bytes) else { return false };
        let is_read = match direction {
            Direction::Read => self.fetch(start, image),
            // What lies beside the bits stays as it is.
            Direction::Write => {
                self.peek(start, image);
                true
            }
        };
        if !is_read {
            return false;
        }
        for bit in begin..end {
            let there = physical_bit(bit) - 8 * (physical_bit(begin) / 8);
            let here = (bit + origin - 8 * i64::from(logical)) as usize;
            let (Some(memory), Some(wire)) = (image.get_mut(there / 8), data.get_mut(here / 8)) else { return false };
            let (memory_mask, wire_mask) = (1 << (there % 8), 1 << (here % 8));
            let (from, to, mask) = match direction {
                Direction::Read => (*memory & memory_mask != 0, wire, wire_mask),
                Direction::Write => (*wire & wire_mask != 0, memory, memory_mask),
            };
            *to = if from { *to | mask } else { *to & !mask };
        }
        match direction {
            Direction::Read => true,
            Direction::Write => self.store(start, image),
        }
    }

    /// Copies the content of memory, whoever may read it.
    fn peek(&self, start: usize, data: &mut [u8]) {
        let from = self.memory.get(start..).unwrap_or_default();
        data.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
    }

    /// The sync manager that an access touches, if there is one; one that the device has switched off locks its memory.
    fn manager_of(&self, access: &Range<usize>) -> Option<usize> {
        self.managers.iter().position(|manager| {
            let taken = manager.taken();
            !taken.is_empty() && manager.settings.is_enabled && access.start < taken.end && taken.start < access.end
        })
    }

    /// Reads for the bus; whether it was allowed.
    fn fetch(&mut self, start: usize, data: &mut [u8]) -> bool {
        let access = start..start + data.len();
        if access.end <= REGISTERS_END {
            self.bring_up_to_date(&access);
            self.peek(start, data);
            return true;
        }
        if start < REGISTERS_END || access.end > RAM_END {
            return false;
        }
        let Some(place) = self.manager_of(&access) else {
            self.peek(start, data);
            return true;
        };
        let manager = &mut self.managers[place];
        let seen = manager.seen();
        if access.start < seen.start || access.end > seen.end {
            return false;
        }
        let Some(at) = manager.bus_access(&access, Direction::Read) else { return false };
        let ended = manager.bus_done(&access, Direction::Read);
        self.peek(at, data);
        if ended == Ended::Read {
            self.touched.mailbox |= place == MAILBOX_IN;
            self.touched.inputs |= place == INPUTS;
            self.show_manager(place);
        }
        true
    }

    /// Writes for the bus; whether it was allowed.
    fn store(&mut self, start: usize, data: &[u8]) -> bool {
        let access = start..start + data.len();
        if access.end <= REGISTERS_END {
            self.set_registers(&access, data);
            return true;
        }
        if start < REGISTERS_END || access.end > RAM_END {
            return false;
        }
        let Some(place) = self.manager_of(&access) else {
            self.memory.get_mut(access).unwrap_or_default().copy_from_slice(data);
            return true;
        };
        let manager = &mut self.managers[place];
        let seen = manager.seen();
        if access.start < seen.start || access.end > seen.end {
            return false;
        }
        let Some(at) = manager.bus_access(&access, Direction::Write) else { return false };
        let ended = manager.bus_done(&access, Direction::Write);
        if let Some(to) = self.memory.get_mut(at..at + data.len()) {
            to.copy_from_slice(data);
        }
        if ended == Ended::Written {
            self.touched.mailbox |= place == MAILBOX_OUT;
            self.touched.outputs |= place == OUTPUTS;
            self.show_manager(place);
        }
        true
    }

    /// Updates the registers of an access to the present moment.
    fn bring_up_to_date(&mut self, access: &Range<usize>) {
        if touches(access, register::SII_CONTROL, 14) {
            let (status, data) = (self.chip.status(self.frame_at), self.chip.data);
            self.set_word(register::SII_CONTROL, status);
            self.set_bytes(register::SII_DATA, &data);
        }
        if access.end <= usize::from(register::DC_RECEIVE_TIME) || !self.has_dc {
            return;
        }
        if touches(access, register::DC_SYSTEM_TIME, 8) {
            let time = self.system_time_ns(self.frame_at);
            self.set_bytes(register::DC_SYSTEM_TIME, &time.to_le_bytes());
        }
        if touches(access, register::DC_DIFFERENCE, 4) {
            let difference = self.clock.difference();
            self.set_bytes(register::DC_DIFFERENCE, &difference.to_le_bytes());
        }
        if touches(access, register::DC_START_TIME, 8)
            && let Some(next) = self.signals.next
        {
            self.set_bytes(register::DC_START_TIME, &next.to_le_bytes());
        }
        if touches(access, register::DC_ACTIVATION_STATUS, 1) {
            let is_pending = self.signals.next.is_some() && self.signals.count == 0;
            self.set_byte(register::DC_ACTIVATION_STATUS, u8::from(is_pending));
        }
    }

    /// Sets registers as far as the master may.
    fn set_registers(&mut self, access: &Range<usize>, data: &[u8]) {
        for (at, byte) in access.clone().zip(data) {
            if is_plain(at) || self.is_free_manager_register(at) {
                self.memory.get_mut(at).into_iter().for_each(|to| *to = *byte);
            }
        }
        self.touched.al_control |= touches(access, register::AL_CONTROL, 1);
        if touches(access, register::RX_ERROR, 13) {
            // A write to one of a group clears all of them.
            self.set_bytes(register::RX_ERROR, &[0; 13]);
        }
        if touches(access, register::LOST_LINK, 4) {
            self.set_bytes(register::LOST_LINK, &[0; 4]);
        }
        if touches(access, register::WATCHDOG_COUNTER, 2) {
            self.set_bytes(register::WATCHDOG_COUNTER, &[0; 2]);
        }
        if touches(access, register::SII_CONFIGURATION, 1) && self.byte(register::SII_CONFIGURATION) & 2 != 0 {
            // Taken back by force.
            self.set_byte(register::SII_CONFIGURATION, 0);
        }
        if access.start <= usize::from(register::SII_CONTROL) && access.end >= usize::from(register::SII_CONTROL) + 2 {
            let at = usize::from(register::SII_CONTROL) - access.start;
            self.command_sii(u16_at(data, at));
        }
        self.take_fmmus(access);
        self.take_managers(access);
        if access.end > usize::from(register::DC_RECEIVE_TIME) && self.has_dc {
            self.set_clock_registers(access, data);
        }
    }

    /// Sync managers are set while they are off; they can be switched on and off at any time.
    fn is_free_manager_register(&self, at: usize) -> bool {
        if !MANAGER_REGISTERS.contains(&at) {
            return false;
        }
        let (place, offset) = ((at - MANAGER_REGISTERS.start) / SyncManager::SIZE, at % SyncManager::SIZE);
        let is_enabled = self.managers.get(place).is_some_and(|manager| manager.settings.is_enabled);
        offset == SyncManager::ACTIVATE || offset < SyncManager::STATUS && !is_enabled
    }

    fn take_fmmus(&mut self, access: &Range<usize>) {
        if access.start >= FMMU_REGISTERS.end || access.end <= FMMU_REGISTERS.start {
            return;
        }
        for (place, fmmu) in self.fmmus.iter_mut().enumerate() {
            *fmmu = Fmmu::decode(&array(&self.memory, FMMU_REGISTERS.start + place * Fmmu::SIZE));
        }
    }

    fn take_managers(&mut self, access: &Range<usize>) {
        if access.start >= MANAGER_REGISTERS.end || access.end <= MANAGER_REGISTERS.start {
            return;
        }
        for place in 0..MANAGERS {
            let at = MANAGER_REGISTERS.start + place * SyncManager::SIZE;
            let settings = SyncManager::decode(&array(&self.memory, at));
            let asks = settings.repeat != self.managers[place].repeat_answered;
            self.managers[place].set(settings);
            self.touched.mailbox |= place == MAILBOX_IN && asks;
            self.show_manager(place);
        }
    }

    /// Carries out a command for the chip, unless the device has it.
    fn command_sii(&mut self, command: u16) {
        if self.byte(register::SII_CONFIGURATION) & 1 != 0 {
            return;
        }
        let (word, data) = (self.double(register::SII_ADDRESS), array(&self.memory, register::SII_DATA.into()));
        if let Some(alias) = self.chip.command(self.frame_at, command, word, data) {
            self.set_word(register::STATION_ALIAS, alias);
        }
    }

    fn set_clock_registers(&mut self, access: &Range<usize>, data: &[u8]) {
        let (arrived, back) = (self.clock.at(self.frame_at), self.clock.at(self.frame_back));
        if touches(access, register::DC_RECEIVE_TIME, 1) {
            self.set_bytes(register::DC_RECEIVE_TIME, &(arrived as u32).to_le_bytes());
            self.set_bytes(register::DC_RECEIVE_TIME_UNIT, &arrived.to_le_bytes());
            if self.links.away {
                self.set_bytes(register::DC_RECEIVE_TIME + 4, &(back as u32).to_le_bytes());
            }
        }
        if touches(access, register::DC_SYSTEM_TIME, 4) && access.start == usize::from(register::DC_SYSTEM_TIME) {
            self.compare_time(data);
        }
        if touches(access, register::DC_SPEED_START, 6) {
            self.clock.reset_filter();
        }
        if touches(access, register::DC_ACTIVATION, 1) {
            let activation = self.byte(register::DC_ACTIVATION);
            let start = i64::from_le_bytes(array(&self.memory, register::DC_START_TIME.into()));
            self.signals.activate(activation, start, self.system_time_ns(self.frame_at));
        }
    }

    /// A reference time has come: 8 bytes, or the lower 4 of them.
    fn compare_time(&mut self, data: &[u8]) {
        let delay = i64::from(u32_at(&self.memory, register::DC_DELAY.into()));
        let own = self.system_time_ns(self.frame_at).wrapping_sub(delay);
        let difference = match data.len() {
            8.. => own.wrapping_sub(i64::from_le_bytes(array(data, 0))),
            4..8 => i64::from((own as u32).wrapping_sub(u32_at(data, 0)) as i32),
            _ => return,
        };
        let depth = self.byte(register::DC_FILTER_DEPTH) & 0x0f;
        Clock::compare(&mut self.clock, self.frame_at, difference, depth);
    }
}
