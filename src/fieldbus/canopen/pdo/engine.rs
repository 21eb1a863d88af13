//! The PDOs of a device while it is Operational.

use std::time::Duration;

use super::super::{Frame, cob};
use super::parameters::{Mapping, Pdo, is_served};
use crate::objects::ObjectDictionary;
use crate::time::Time;

/// Identifier of a PDO that is not used: no frame has it.
pub(in super::super) const NO_ID: u16 = u16::MAX;

/// Reads the parameters that both directions use.
fn configure(od: &ObjectDictionary, pdo: Pdo) -> (u16, u8, Mapping) {
    let cob_id = od.raw(pdo.communication(), 1) as u32;
    let transmission_type = od.raw(pdo.communication(), 2) as u8;
    let count = od.raw(pdo.mapping(), 0) as usize;
    match Mapping::compile(od, pdo, count) {
        Ok(mapping)
            if cob_id != 0 && cob_id & cob::INVALID == 0 && mapping.bytes() > 0 && is_served(transmission_type) =>
        {
            ((cob_id & 0x7ff) as u16, transmission_type, mapping)
        }
        _ => (NO_ID, transmission_type, Mapping::default()),
    }
}

/// Result of a frame for an RPDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Reception {
    /// Shorter than the mapping: dropped.
    TooShort,
    /// Kept until SYNC.
    Latched,
    /// In the dictionary.
    Applied,
}

/// A receive PDO.
#[derive(Clone, Debug)]
pub(in super::super) struct Rpdo {
    id: u16,
    is_synchronous: bool,
    mapping: Mapping,
    latched: Option<u64>,
    timeout: Duration,
    /// `NEVER` until the first frame and after a timeout.
    deadline: Time,
}

impl Rpdo {
    /// Creates the PDO from the parameters of place `place`, counted from 0; unused if the dictionary has none.
    pub(in super::super) fn new(od: &ObjectDictionary, place: u8) -> Self {
        let (id, transmission_type, mapping) = configure(od, Pdo::Receive(place));
        let timeout = Duration::from_millis(od.raw(Pdo::Receive(place).communication(), 5));
        let is_synchronous = transmission_type <= 240;
        Rpdo { id, is_synchronous, mapping, latched: None, timeout, deadline: Time::NEVER }
    }

    pub(in super::super) const fn id(&self) -> u16 {
        self.id
    }

    pub(in super::super) const fn deadline(&self) -> Time {
        self.deadline
    }

    pub(in super::super) const fn is_synchronous(&self) -> bool {
        self.is_synchronous
    }

    /// Forgets what was received.
    pub(in super::super) fn stop(&mut self) {
        (self.latched, self.deadline) = (None, Time::NEVER);
    }

    /// Takes a frame. Bytes beyond the mapping do not count.
    pub(in super::super) fn receive(&mut self, now: Time, frame: &Frame, od: &mut ObjectDictionary) -> Reception {
        if frame.len() < self.mapping.bytes() {
            return Reception::TooShort;
        }
        if !self.timeout.is_zero() {
            self.deadline = now + self.timeout;
        }
        if self.is_synchronous {
            self.latched = Some(frame.bits());
            Reception::Latched
        } else {
            self.mapping.apply(frame.bits(), od);
            Reception::Applied
        }
    }

    /// Applies the latest frame before SYNC; whether there was one.
    pub(in super::super) fn on_sync(&mut self, od: &mut ObjectDictionary) -> bool {
        let Some(word) = self.latched.take() else { return false };
        self.mapping.apply(word, od);
        true
    }

    /// Whether the event timer ran out, once each time.
    pub(in super::super) fn is_late(&mut self, now: Time) -> bool {
        let is_late = now >= self.deadline;
        if is_late {
            self.deadline = Time::NEVER;
        }
        is_late
    }
}

/// A transmit PDO.
#[derive(Clone, Debug)]
pub(in super::super) struct Tpdo {
    id: u16,
    transmission_type: u8,
    start_count: u8,
    mapping: Mapping,
    inhibit: Duration,
    period: Duration,
    is_started: bool,
    syncs: u8,
    last_word: Option<u64>,
    is_triggered: bool,
    inhibited_until: Time,
    event_at: Time,
}

impl Tpdo {
    /// Creates the PDO from the parameters of place `place`, counted from 0; unused if the dictionary has none.
    pub(in super::super) fn new(od: &ObjectDictionary, place: u8) -> Self {
        let pdo = Pdo::Transmit(place);
        let (id, transmission_type, mapping) = configure(od, pdo);
        Tpdo {
            id,
            transmission_type,
            start_count: od.raw(pdo.communication(), 6) as u8,
            mapping,
            inhibit: Duration::from_micros(100 * od.raw(pdo.communication(), 3)),
            period: Duration::from_millis(od.raw(pdo.communication(), 5)),
            is_started: false,
            syncs: 0,
            last_word: None,
            is_triggered: false,
            inhibited_until: Time::default(),
            event_at: Time::NEVER,
        }
    }

    const fn is_event_driven(&self) -> bool {
        self.id != NO_ID && self.transmission_type >= 254
    }

    /// Enters Operational.
    pub(in super::super) fn start(&mut self, now: Time) {
        self.stop();
        if self.is_event_driven() && !self.period.is_zero() {
            self.event_at = now + self.period;
        }
    }

    /// Leaves Operational.
    pub(in super::super) fn stop(&mut self) {
        (self.is_started, self.syncs, self.last_word) = (self.start_count == 0, 0, None);
        (self.is_triggered, self.inhibited_until, self.event_at) = (false, Time::default(), Time::NEVER);
    }

    /// Returns the frame to send at this SYNC, whose counter is `count`.
    ///
    /// Real-time: yes.
    pub(in super::super) fn on_sync(&mut self, count: Option<u8>, od: &ObjectDictionary) -> Option<Frame> {
        if self.id == NO_ID || self.transmission_type > 240 {
            return None;
        }
        if self.transmission_type == 0 {
            let word = self.mapping.sample(od);
            let is_wanted = self.is_triggered || self.last_word != Some(word);
            (self.is_triggered, self.last_word) = (false, Some(word));
            return is_wanted.then(|| Frame::from_bits(self.id, word, self.mapping.bytes()));
        }
        if !self.is_started {
            // The SYNC with the start value is the first one that counts; a SYNC without a counter starts at once.
            self.is_started = count.is_none_or(|count| count == self.start_count);
            if !self.is_started {
                return None;
            }
        }
        self.syncs = self.syncs.saturating_add(1);
        if self.syncs < self.transmission_type {
            return None;
        }
        self.syncs = 0;
        Some(self.frame(od))
    }

    /// Asks for transmission; [`Tpdo::poll`] or SYNC carries it out.
    pub(in super::super) fn trigger(&mut self) {
        self.is_triggered = self.id != NO_ID;
    }

    /// Returns the frame that is due by trigger or event timer.
    ///
    /// Real-time: yes.
    pub(in super::super) fn poll(&mut self, now: Time, od: &ObjectDictionary) -> Option<Frame> {
        if !self.is_event_driven() || now < self.deadline() {
            return None;
        }
        if !self.period.is_zero() {
            let on_grid = self.event_at + self.period;
            let is_by_timer = self.event_at <= now;
            self.event_at = if is_by_timer && on_grid > now { on_grid } else { now + self.period };
        }
        self.is_triggered = false;
        self.inhibited_until = now + self.inhibit;
        Some(self.frame(od))
    }

    /// Returns the time at which an event-driven PDO is due.
    pub(in super::super) fn deadline(&self) -> Time {
        if !self.is_event_driven() {
            return Time::NEVER;
        }
        let wanted = if self.is_triggered { Time::default() } else { self.event_at };
        wanted.max(self.inhibited_until)
    }

    fn frame(&self, od: &ObjectDictionary) -> Frame {
        Frame::from_bits(self.id, self.mapping.sample(od), self.mapping.bytes())
    }
}
