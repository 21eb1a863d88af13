//! A CANopen device without I/O: NMT slave, error control, emergencies, SDO server and PDOs over one dictionary.

mod application;

use std::time::Duration;

pub use application::{Application, Reset};

use super::nmt::HeartbeatEvent;
use super::{CanopenError, EmcyCode, ErrorRegister, Frame, NmtState, NodeId, ObjectDictionary, Outbox, Time};

/// A CANopen device (NMT slave).
#[derive(Clone, Debug)]
pub struct Node {
    id: NodeId,
    od: ObjectDictionary,
    state: NmtState,
}

impl Node {
    /// A device with a dictionary that contains
    /// [`communication_profile`](super::dictionary::Builder::communication_profile); it is silent until
    /// [`Node::boot`].
    ///
    /// # Errors
    /// [`CanopenError::NoObject`] or [`CanopenError::TypeMismatch`] for a missing communication object,
    /// [`CanopenError::NotMappable`], [`CanopenError::PdoBits`], [`CanopenError::CobId`] or
    /// [`CanopenError::TransmissionType`] for bad default PDOs.
    pub fn new(id: NodeId, od: ObjectDictionary) -> Result<Self, CanopenError> {
        Ok(Node { id, od, state: NmtState::Initialising })
    }

    /// Node id.
    pub fn id(&self) -> NodeId {
        self.id
    }

    /// NMT state; Initialising before [`Node::boot`].
    pub fn state(&self) -> NmtState {
        self.state
    }

    /// The dictionary.
    pub fn od(&self) -> &ObjectDictionary {
        &self.od
    }

    /// The dictionary, for the device itself. Call [`Node::reload`] after changing communication objects (1000h to
    /// 1FFFh).
    pub fn od_mut(&mut self) -> &mut ObjectDictionary {
        &mut self.od
    }

    /// Takes over changed communication objects.
    pub fn reload(&mut self, _now: Time) {}

    /// How long the SDO server waits for the next request of a transfer before it aborts; 1 s unless set.
    pub fn set_sdo_timeout(&mut self, _timeout: Duration) {}

    /// Power-on: all values back to those the dictionary was built with, boot-up message, then Pre-operational. Also
    /// what a reset command does.
    pub fn boot(&mut self, _now: Time, _app: &mut impl Application, _out: &mut impl Outbox) {}

    /// Takes one frame from the bus.
    ///
    /// Real-time: yes, for PDOs, SYNC and heartbeats.
    pub fn on_frame(&mut self, _now: Time, _frame: &Frame, _app: &mut impl Application, _out: &mut impl Outbox) {}

    /// Does what is due: heartbeat, heartbeat watch, RPDO and TPDO event timers, SDO timeout.
    ///
    /// Real-time: yes.
    pub fn poll(&mut self, _now: Time, _app: &mut impl Application, _out: &mut impl Outbox) {}

    /// When to poll next: possibly earlier than the next thing due, never later. After a poll it lies in the future.
    pub fn next_deadline(&self) -> Time {
        Time::NEVER
    }

    /// Asks for event-driven TPDO `number` (type 254 or 255) now, or as soon as its inhibit time has passed, and for
    /// TPDO of type 0 at the next SYNC. Does nothing outside Operational.
    pub fn trigger_tpdo(&mut self, _now: Time, _number: u8, _out: &mut impl Outbox) {}

    /// Reports an error: sets `bits` in 1001h (and the generic bit), enters 1003h and sends the emergency message.
    /// An error that is already active (same code and same first vendor byte) is not reported again.
    pub fn raise_emergency(&mut self, _code: EmcyCode, _bits: ErrorRegister, _vendor: [u8; 5], _out: &mut impl Outbox) {
    }

    /// Reports that all errors with `code` have gone: recomputes 1001h and sends an emergency message 0000h; nothing
    /// if there were none.
    pub fn clear_emergency(&mut self, _code: EmcyCode, _out: &mut impl Outbox) {}

    /// Reports that all errors have gone; nothing if there were none.
    pub fn clear_all_emergencies(&mut self, _out: &mut impl Outbox) {}
}

#[allow(dead_code)]
fn unused(_: HeartbeatEvent) {}
