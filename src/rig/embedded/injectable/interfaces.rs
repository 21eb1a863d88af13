//! The master's interfaces to the buses, with what is broken in them.

use super::participant::Participants;
use yieldwall_bus::LinkEvent;
use yieldwall_config::injection::{Injection, Kind, Target};
use yieldwall_fieldbus::canopen::BusId;

/// Faults of the master's interfaces. An injection acts on the interfaces to the buses of the named devices, or on all.
#[derive(Debug, Default)]
pub(super) struct Interfaces(Vec<Injection>);

impl Interfaces {
    /// Whether an injection acts here.
    pub(super) fn has(injection: Injection) -> bool {
        match injection.kind {
            Kind::SendFailed | Kind::InterfaceDown | Kind::BusOff | Kind::ErrorPassive => true,
            Kind::TransmitStalled | Kind::CableOut => true,
            Kind::WrongBitRate => injection.target == Target::Link,
            _ => false,
        }
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Begins an injection, or ends it.
    pub(super) fn switch(&mut self, injection: Injection, is_on: bool) {
        if is_on {
            self.0.push(injection);
        } else if let Some(at) = self.0.iter().position(|active| *active == injection) {
            self.0.remove(at);
        }
    }

    /// Whether frames of others reach the master from a bus.
    pub(super) fn hears(&self, participants: &Participants, bus: BusId) -> bool {
        !self.is_alone() && !self.is_any_on(participants, bus, &[Kind::InterfaceDown, Kind::BusOff, Kind::CableOut])
    }

    /// Whether the master can hand frames to its interface to a bus.
    pub(super) fn sends(&self, participants: &Participants, bus: BusId) -> bool {
        !self.is_any_on(participants, bus, &[Kind::SendFailed, Kind::InterfaceDown, Kind::BusOff])
    }

    /// Whether frames stay in the master's interface to a bus.
    pub(super) fn is_transmit_held(&self, participants: &Participants, bus: BusId) -> bool {
        self.is_alone() || self.is_any_on(participants, bus, &[Kind::TransmitStalled, Kind::CableOut])
    }

    /// Returns the event that the interface to a bus reports in every cycle.
    pub(super) fn event(&self, participants: &Participants, bus: BusId) -> Option<LinkEvent> {
        match () {
            () if self.is_any_on(participants, bus, &[Kind::BusOff]) => Some(LinkEvent::BusOff),
            () if self.is_alone() => Some(LinkEvent::ErrorPassive),
            () => self
                .is_any_on(participants, bus, &[Kind::ErrorPassive, Kind::CableOut])
                .then_some(LinkEvent::ErrorPassive),
        }
    }

    /// Whether the bit rate of all of them is another one than that of the devices.
    fn is_alone(&self) -> bool {
        self.0.iter().any(|injection| injection.kind == Kind::WrongBitRate)
    }

    /// Whether one of `kinds` acts on the interface to a bus: that of the target, or every one.
    fn is_any_on(&self, participants: &Participants, bus: BusId, kinds: &[Kind]) -> bool {
        self.0.iter().filter(|injection| kinds.contains(&injection.kind)).any(|injection| {
            let mut devices = participants.iter().enumerate();
            injection.target == Target::Link
                || devices.any(|(at, device)| device.bus == bus && injection.target.has_device(at))
        })
    }
}
