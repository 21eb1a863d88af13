//! The device's side of LSS.

use std::time::Duration;

use super::super::NodeId;
use super::{FASTSCAN_ANYBODY, LssAddress, Payload, UNCONFIGURED, bit_rate, command, number, with_number};

/// Action of the device after a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum LssEvent {
    /// A device without node id has got one and may start.
    Configured,
    /// Change to `bit_rate` (bit/s): stop sending, change after `delay`, and send again after `delay` once more.
    BitRate { bit_rate: u32, delay: Duration },
}

/// A device as LSS sees it.
#[derive(Clone, Debug)]
pub(in super::super) struct LssSlave {
    address: LssAddress,
    is_configuring: bool,
    /// Numbers of the address that matched so far, in a selective switch and in an identification.
    selected: u8,
    identified: u8,
    fastscan_part: u8,
    active: Option<NodeId>,
    pending: Option<NodeId>,
    stored: Option<NodeId>,
    bit_timing: Option<u8>,
}

impl LssSlave {
    /// Creates a device that was delivered with a node id, or without one.
    pub(in super::super) fn new(address: LssAddress, stored: Option<NodeId>) -> Self {
        LssSlave {
            address,
            is_configuring: false,
            selected: 0,
            identified: 0,
            fastscan_part: 0,
            active: stored,
            pending: stored,
            stored,
            bit_timing: None,
        }
    }

    /// Makes it a device that was delivered without a node id.
    pub(in super::super) fn forget_node_id(&mut self) {
        *self = Self::new(self.address, None);
    }

    /// Forgets what was not stored.
    pub(in super::super) fn power_on(&mut self) {
        *self = Self::new(self.address, self.stored);
    }

    /// Takes over the configured node id, as a reset does; `None` if none is configured.
    pub(in super::super) fn activate(&mut self) -> Option<NodeId> {
        self.active = self.pending;
        self.active
    }

    /// Returns the answer to a request, and what the device has to do.
    pub(in super::super) fn on_request(&mut self, payload: &Payload) -> (Option<Payload>, Option<LssEvent>) {
        match payload[0] {
            command::SWITCH_GLOBAL => (None, self.switch(payload[1])),
            command::SWITCH_SELECTIVE..command::SELECTED => (self.select(payload), None),
            command::IDENTIFY_FIRST..=command::IDENTIFY_LAST => (self.identify(payload), None),
            command::IDENTIFY_UNCONFIGURED if self.pending.is_none() => {
                (Some(with_number(command::UNCONFIGURED_IDENTIFIED, 0)), None)
            }
            command::FASTSCAN => (self.fastscan(payload), None),
            _ if self.is_configuring => self.configure(payload),
            _ => (None, None),
        }
    }

    fn switch(&mut self, mode: u8) -> Option<LssEvent> {
        let was_configuring = self.is_configuring;
        match mode {
            0 => self.is_configuring = false,
            1 => self.is_configuring = true,
            _ => return None,
        }
        self.selected = 0;
        let is_new = was_configuring && !self.is_configuring && self.active.is_none() && self.pending.is_some();
        is_new.then_some(LssEvent::Configured)
    }

    /// Takes one of the four numbers of an address, which have to come in order.
    fn select(&mut self, payload: &Payload) -> Option<Payload> {
        let part = payload[0] - command::SWITCH_SELECTIVE;
        let is_equal = self.address.parts().get(usize::from(part)) == Some(&number(payload));
        self.selected = match (is_equal, part) {
            (true, 0) => 1,
            (true, _) if part == self.selected => part + 1,
            _ => 0,
        };
        if self.selected < 4 {
            return None;
        }
        (self.selected, self.is_configuring) = (0, true);
        Some(with_number(command::SELECTED, 0))
    }

    /// Takes one number of an identification. Vendor and product have to be equal, revision and serial number within bounds.
    fn identify(&mut self, payload: &Payload) -> Option<Payload> {
        let part = payload[0] - command::IDENTIFY_FIRST;
        let wanted = number(payload);
        let LssAddress { vendor_id, product_code, revision, serial } = self.address;
        let is_in = match part {
            0 => vendor_id == wanted,
            1 => product_code == wanted,
            2 => revision >= wanted,
            3 => revision <= wanted,
            4 => serial >= wanted,
            _ => serial <= wanted,
        };
        self.identified = match (is_in, part) {
            (true, 0) => 1,
            (true, _) if part == self.identified => part + 1,
            _ => 0,
        };
        if self.identified < 6 {
            return None;
        }
        self.identified = 0;
        Some(with_number(command::IDENTIFIED, 0))
    }

    fn fastscan(&mut self, payload: &Payload) -> Option<Payload> {
        if self.pending.is_some() || self.is_configuring {
            return None;
        }
        let [.., bit, part, next] = *payload;
        let answer = Some(with_number(command::IDENTIFIED, 0));
        if bit == FASTSCAN_ANYBODY {
            self.fastscan_part = 0;
            return answer;
        }
        let own = *self.address.parts().get(usize::from(part))?;
        if bit > 31 || part != self.fastscan_part || own >> bit != number(payload) >> bit {
            return None;
        }
        if bit == 0 {
            self.fastscan_part = next;
            self.is_configuring = part == 3 && next < part;
        }
        answer
    }

    fn configure(&mut self, payload: &Payload) -> (Option<Payload>, Option<LssEvent>) {
        let done = |error: u8| (Some([payload[0], error, 0, 0, 0, 0, 0, 0]), None);
        match payload[0] {
            command::CONFIGURE_NODE_ID => match (payload[1], NodeId::new(payload[1])) {
                (UNCONFIGURED, _) => {
                    self.pending = None;
                    done(0)
                }
                (1..=127, Ok(node)) => {
                    self.pending = Some(node);
                    done(0)
                }
                _ => done(1),
            },
            command::CONFIGURE_BIT_TIMING => {
                let is_known = payload[1] == 0 && bit_rate(payload[2]).is_some();
                self.bit_timing = if is_known { Some(payload[2]) } else { self.bit_timing };
                done(u8::from(!is_known))
            }
            command::ACTIVATE_BIT_TIMING => {
                let delay = Duration::from_millis(u64::from(u16::from_le_bytes([payload[1], payload[2]])));
                let chosen = self.bit_timing.and_then(bit_rate);
                (None, chosen.map(|bit_rate| LssEvent::BitRate { bit_rate, delay }))
            }
            command::STORE => {
                self.stored = self.pending;
                done(0)
            }
            command::INQUIRE_NODE_ID => {
                let node = self.active.map_or(UNCONFIGURED, NodeId::raw);
                (Some([command::INQUIRE_NODE_ID, node, 0, 0, 0, 0, 0, 0]), None)
            }
            part => {
                let place = part.checked_sub(command::INQUIRE_IDENTITY).map(usize::from);
                let own = place.and_then(|place| self.address.parts().get(place).copied());
                (own.map(|own| with_number(part, own)), None)
            }
        }
    }
}
