//! The registers that safety rests on, as the bring-up has set them: address, sync managers, FMMUs, watchdog, SYNC0. They are read back
//! beside the cycle, since whoever writes to a device from behind it is not heard here.

use std::time::Duration;

use super::budget;
use super::flight::Datagramer;
use super::writes::{Altered, Write};
use yieldwall_fieldbus::ethercat::frame::{self, Command, Datagrams, address};
use yieldwall_fieldbus::ethercat::registers as register;
use yieldwall_fieldbus::time::Time;

/// Time in which the registers of all devices are read back once.
const ROUND: Duration = Duration::from_millis(800);
/// Registers that the master writes back at once when a foreign master may have set them. Without its watchdog a drive goes on
/// when this master ends; without its address nobody hears its state.
const RESTORED: [u16; 3] = [register::STATION_ADDRESS, register::WATCHDOG_DIVIDER, register::WATCHDOG_SYNC_MANAGER];

/// The registers of one device.
#[derive(Clone, Debug, Default)]
pub(super) struct Held {
    areas: Vec<Write>,
}

impl Held {
    /// Nothing has been written.
    pub(super) fn forget(&mut self) {
        self.areas.clear();
    }

    /// Notes what was written and read back. Registers that follow one another are one area, and the later write counts.
    pub(super) fn note(&mut self, writes: &[Write]) {
        for write in writes.iter().filter(|write| write.is_compared) {
            let (start, end) = (usize::from(write.register), write.end());
            let area = self.areas.iter_mut().find(|area| usize::from(area.register) <= start && start <= area.end());
            let Some(area) = area else {
                self.areas.push(write.clone());
                continue;
            };
            let at = start - usize::from(area.register);
            area.bytes.resize(area.bytes.len().max(end - usize::from(area.register)), 0);
            area.bytes.iter_mut().skip(at).zip(&write.bytes).for_each(|(to, byte)| *to = *byte);
        }
    }

    /// The areas from `first` on that go into one frame, which is not longer than the others beside the cycle.
    fn part(&self, first: usize) -> impl Iterator<Item = &Write> {
        let mut left = budget::MAILBOX;
        self.areas.iter().skip(first).take_while(move |area| {
            let len = area.bytes.len() + frame::DATAGRAM_HEADER + frame::WORKING_COUNTER;
            let fits = len <= left;
            left = left.saturating_sub(len);
            fits
        })
    }

    /// Frames that read all areas.
    fn parts(&self) -> u32 {
        let (mut first, mut parts) = (0, 0);
        while first < self.areas.len() {
            first += self.part(first).count().max(1);
            parts += 1;
        }
        parts
    }

    /// Adds the datagrams that write address and watchdog of the device at a position back.
    ///
    /// Real-time: yes.
    pub(super) fn restore(&self, position: u16, to: &mut Datagramer<'_>) {
        for area in self.areas.iter().filter(|area| RESTORED.contains(&area.register)) {
            to.push(Command::Apwr, address(position.wrapping_neg(), area.register), &area.bytes);
        }
    }
}

/// Whose registers are read next, and when.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    /// Place of the device, and the first of its areas.
    pub(super) place: usize,
    first: usize,
    at: Time,
    every: Duration,
}

impl Turn {
    /// The first device comes first, at once.
    pub(super) const START: Self = Turn { place: 0, first: 0, at: Time(0), every: ROUND };

    /// All devices within the time of a round.
    pub(super) fn of<'a>(held: impl Iterator<Item = &'a Held>) -> Self {
        let parts: u32 = held.map(Held::parts).sum();
        Turn { every: ROUND / parts.max(1), ..Self::START }
    }

    /// Whether one is due; the next one is due a while later then.
    ///
    /// Real-time: yes.
    pub(super) fn is_due(&mut self, now: Time) -> bool {
        let is_due = now >= self.at;
        if is_due {
            self.at = now + self.every;
        }
        is_due
    }

    /// Adds the datagrams of this turn.
    ///
    /// Real-time: yes.
    pub(super) fn ask(&self, held: &Held, (position, station): (u16, u16), to: &mut Datagramer<'_>) {
        for area in held.part(self.first) {
            // A device that has another address now does not answer by its own.
            let (command, by) = match area.register {
                register::STATION_ADDRESS => (Command::Aprd, position.wrapping_neg()),
                _ => (Command::Fprd, station),
            };
            to.read(command, address(by, area.register), area.bytes.len());
        }
    }

    /// Takes what has come back, and goes on to the next turn of so many devices. The first register that differs, if one does.
    ///
    /// Real-time: yes.
    pub(super) fn take(&mut self, held: &Held, devices: usize, mut back: Datagrams<'_>) -> Option<Altered> {
        let (mut altered, mut read) = (None, 0);
        for area in held.part(self.first) {
            read += 1;
            // An area that no device has answered for, or two have, says nothing of this one.
            let back = back.next().and_then(Result::ok).filter(|datagram| datagram.working_counter == 1);
            altered = altered.or_else(|| area.first_difference(back?.data));
        }
        self.first += read.max(1);
        if self.first >= held.areas.len() {
            (self.place, self.first) = ((self.place + 1) % devices.max(1), 0);
        }
        altered
    }
}
