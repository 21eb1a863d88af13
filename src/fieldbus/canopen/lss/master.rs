//! The master's side of LSS.

use std::time::Duration;

use super::super::{CanopenError, Frame, NodeId, Outbox, cob, node_id};
use super::{FASTSCAN_ANYBODY, LssAddress, Payload, UNCONFIGURED, command, number, with_number};
use crate::time::Time;

/// Request of an LSS master. Devices have to be switched to configuration before any other request, one by one where the answer matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LssRequest {
    /// All devices to configuration, or back to waiting; nobody answers.
    SwitchAll {
        /// To configuration.
        to_configuration: bool,
    },
    /// The device with this address to configuration.
    SwitchOne(LssAddress),
    /// Whether a device with this address is there, in whatever mode; it stays in its own.
    Identify(LssAddress),
    /// The address of the device in configuration.
    InquireIdentity,
    /// The node id that the device in configuration has.
    InquireNodeId,
    /// A node id for the device in configuration, `None` for no node id. The id applies at the next reset. For a device without an id it
    /// applies when the device is switched to waiting.
    ConfigureNodeId(Option<NodeId>),
    /// A bit rate by its index in the table of CiA 301; see [`bit_rate`](super::bit_rate).
    ConfigureBitTiming {
        /// Index in the table.
        index: u8,
    },
    /// The configured bit rate takes effect; nobody answers. All devices and the master are silent for the delay before
    /// and after the change.
    ActivateBitTiming {
        /// Each of the two delays, in ms.
        delay_ms: u16,
    },
    /// The device in configuration keeps node id and bit rate beyond power-off.
    Store,
    /// Finds one device without node id and switches it to configuration. Takes up to 133 waiting times.
    Fastscan,
}

/// Result of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LssOutcome {
    /// Confirmed, or sent where nobody answers.
    Done,
    /// The address of the device in configuration, or of the one found.
    Identity(LssAddress),
    /// The node id of the device in configuration, if it has one.
    NodeId(Option<NodeId>),
    /// The device refused.
    Refused {
        /// 1: outside its range or not supported; 2: storage failed; 255: see the detail.
        error: u8,
        /// Vendor specific.
        detail: u8,
    },
    /// No device answered in time.
    NoAnswer,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Idle,
    /// One answer with this command ends it.
    Await(u8),
    Identity {
        part: u8,
        found: [u32; 4],
    },
    Anybody,
    /// Whether bit `bit` of number `part` is 0.
    Scan {
        part: u8,
        bit: u8,
        found: [u32; 4],
    },
    Confirm {
        part: u8,
        found: [u32; 4],
    },
}

/// One LSS master; one request at a time.
#[derive(Clone, Debug)]
pub struct LssMaster {
    timeout: Duration,
    phase: Phase,
    deadline: Time,
}

impl LssMaster {
    /// Waits up to `timeout` for each answer. In a fastscan silence is an answer, so that a short time makes it fast and
    /// one shorter than the slowest device's makes it wrong.
    pub fn new(timeout: Duration) -> Self {
        LssMaster { timeout, phase: Phase::Idle, deadline: Time::NEVER }
    }

    /// Whether a request is running.
    pub const fn is_busy(&self) -> bool {
        !matches!(self.phase, Phase::Idle)
    }

    /// Returns the time of the next poll.
    pub const fn next_deadline(&self) -> Time {
        self.deadline
    }

    /// Sends a request; the outcome at once if nobody answers to it.
    ///
    /// # Errors
    /// [`CanopenError::LssBusy`] while a request is running.
    pub fn start(
        &mut self,
        now: Time,
        request: LssRequest,
        out: &mut impl Outbox,
    ) -> Result<Option<LssOutcome>, CanopenError> {
        if self.is_busy() {
            return Err(CanopenError::LssBusy);
        }
        let with_byte = |command: u8, first: u8, second: u8| [command, first, second, 0, 0, 0, 0, 0];
        let (payload, awaited) = match request {
            LssRequest::SwitchAll { to_configuration } => {
                (with_byte(command::SWITCH_GLOBAL, to_configuration.into(), 0), Phase::Idle)
            }
            LssRequest::SwitchOne(address) => {
                let [vendor, product, revision, serial] = address.parts();
                for (command, part) in (command::SWITCH_SELECTIVE..).zip([vendor, product, revision]) {
                    out.push(Frame::new(cob::LSS_REQUEST, &with_number(command, part)));
                }
                (with_number(command::SWITCH_SELECTIVE + 3, serial), Phase::Await(command::SELECTED))
            }
            LssRequest::Identify(address) => {
                // Revision and serial number are asked for as ranges, from and to.
                let [vendor, product, revision, serial] = address.parts();
                for (command, part) in (command::IDENTIFY_FIRST..).zip([vendor, product, revision, revision, serial]) {
                    out.push(Frame::new(cob::LSS_REQUEST, &with_number(command, part)));
                }
                (with_number(command::IDENTIFY_LAST, serial), Phase::Await(command::IDENTIFIED))
            }
            LssRequest::InquireIdentity => {
                (with_number(command::INQUIRE_IDENTITY, 0), Phase::Identity { part: 0, found: [0; 4] })
            }
            LssRequest::InquireNodeId => {
                (with_number(command::INQUIRE_NODE_ID, 0), Phase::Await(command::INQUIRE_NODE_ID))
            }
            LssRequest::ConfigureNodeId(node) => {
                let raw = node.map_or(UNCONFIGURED, NodeId::raw);
                (with_byte(command::CONFIGURE_NODE_ID, raw, 0), Phase::Await(command::CONFIGURE_NODE_ID))
            }
            LssRequest::ConfigureBitTiming { index } => {
                (with_byte(command::CONFIGURE_BIT_TIMING, 0, index), Phase::Await(command::CONFIGURE_BIT_TIMING))
            }
            LssRequest::ActivateBitTiming { delay_ms } => {
                let [low, high] = delay_ms.to_le_bytes();
                (with_byte(command::ACTIVATE_BIT_TIMING, low, high), Phase::Idle)
            }
            LssRequest::Store => (with_number(command::STORE, 0), Phase::Await(command::STORE)),
            LssRequest::Fastscan => (fastscan(0, FASTSCAN_ANYBODY, 0, 0), Phase::Anybody),
        };
        self.ask(now, payload, awaited, out);
        Ok((!self.is_busy()).then_some(LssOutcome::Done))
    }

    /// Takes a frame from the bus and returns the outcome when the request ended.
    pub fn on_frame(&mut self, now: Time, frame: &Frame, out: &mut impl Outbox) -> Option<LssOutcome> {
        if frame.id() != cob::LSS_ANSWER || frame.len() != 8 {
            return None;
        }
        let payload = frame.bytes();
        match self.phase {
            Phase::Await(command) if payload[0] == command => {
                let outcome = match (command, payload[1]) {
                    (command::INQUIRE_NODE_ID, raw) => LssOutcome::NodeId(node_id(raw).ok()),
                    (command::SELECTED | command::IDENTIFIED, _) | (_, 0) => LssOutcome::Done,
                    (_, error) => LssOutcome::Refused { error, detail: payload[2] },
                };
                self.end(outcome)
            }
            Phase::Identity { part, mut found } if payload[0] == command::INQUIRE_IDENTITY + part => {
                put(&mut found, part, number(payload));
                if part == 3 {
                    return self.end(LssOutcome::Identity(LssAddress::of_parts(found)));
                }
                let part = part + 1;
                self.ask(now, with_number(command::INQUIRE_IDENTITY + part, 0), Phase::Identity { part, found }, out);
                None
            }
            Phase::Anybody if payload[0] == command::IDENTIFIED => {
                self.scan(now, 0, 31, [0; 4], out);
                None
            }
            Phase::Scan { part, bit, found } if payload[0] == command::IDENTIFIED => {
                self.next_bit(now, part, bit, found, out);
                None
            }
            Phase::Confirm { part: 3, found } if payload[0] == command::IDENTIFIED => {
                self.end(LssOutcome::Identity(LssAddress::of_parts(found)))
            }
            Phase::Confirm { part, found } if payload[0] == command::IDENTIFIED => {
                self.scan(now, part + 1, 31, found, out);
                None
            }
            _ => None,
        }
    }

    /// Does what silence leads to: the next question of a fastscan, or the end.
    pub fn poll(&mut self, now: Time, out: &mut impl Outbox) -> Option<LssOutcome> {
        if now < self.deadline {
            return None;
        }
        // Nobody has this bit at 0: it is 1. That nobody is there at all shows at the confirmation.
        let Phase::Scan { part, bit, mut found } = self.phase else { return self.end(LssOutcome::NoAnswer) };
        let so_far = found.get(usize::from(part)).copied().unwrap_or(0);
        put(&mut found, part, so_far | 1 << bit);
        self.next_bit(now, part, bit, found, out);
        None
    }

    fn next_bit(&mut self, now: Time, part: u8, bit: u8, found: [u32; 4], out: &mut impl Outbox) {
        if let Some(bit) = bit.checked_sub(1) {
            return self.scan(now, part, bit, found, out);
        }
        let own = found.get(usize::from(part)).copied().unwrap_or(0);
        // After the last number the device goes to configuration, told by a next number before this one.
        self.ask(now, fastscan(own, 0, part, (part + 1) % 4), Phase::Confirm { part, found }, out);
    }

    fn scan(&mut self, now: Time, part: u8, bit: u8, found: [u32; 4], out: &mut impl Outbox) {
        let own = found.get(usize::from(part)).copied().unwrap_or(0);
        self.ask(now, fastscan(own, bit, part, part), Phase::Scan { part, bit, found }, out);
    }

    fn ask(&mut self, now: Time, payload: Payload, awaited: Phase, out: &mut impl Outbox) {
        out.push(Frame::new(cob::LSS_REQUEST, &payload));
        self.phase = awaited;
        self.deadline = if self.is_busy() { now + self.timeout } else { Time::NEVER };
    }

    fn end(&mut self, outcome: LssOutcome) -> Option<LssOutcome> {
        (self.phase, self.deadline) = (Phase::Idle, Time::NEVER);
        Some(outcome)
    }
}

fn fastscan(own: u32, bit: u8, part: u8, next: u8) -> Payload {
    let [a, b, c, d] = own.to_le_bytes();
    [command::FASTSCAN, a, b, c, d, bit, part, next]
}

fn put(found: &mut [u32; 4], part: u8, value: u32) {
    if let Some(to) = found.get_mut(usize::from(part)) {
        *to = value;
    }
}
