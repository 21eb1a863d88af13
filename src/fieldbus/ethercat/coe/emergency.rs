//! Emergencies over the mailbox.

use super::super::{array, u16_at};
use super::wire::{HEADER, Service, Writer};

/// An emergency of a device, eight bytes behind the CoE header.
///
/// # Source
/// ETG.1000.6, 5.6.4; the codes are those of CiA 301 and CiA 402, and A0xxh for the state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoeEmergency {
    /// Error code; 0 when an error has gone.
    pub code: u16,
    /// Error register 1001h.
    pub register: u8,
    /// Data of the vendor.
    pub vendor: [u8; 5],
}

impl CoeEmergency {
    /// Reads a message; `None` if it is no emergency.
    pub fn decode(message: &[u8]) -> Option<Self> {
        if Service::of(message) != Some(Service::Emergency) || message.len() < HEADER + 8 {
            return None;
        }
        let [register] = array(message, HEADER + 2);
        Some(CoeEmergency { code: u16_at(message, HEADER), register, vendor: array(message, HEADER + 3) })
    }

    /// Writes the message; returns its number of bytes, 0 if it does not fit.
    pub fn encode(&self, message: &mut [u8]) -> usize {
        let written = Writer::new(message, Service::Emergency).put(&self.code.to_le_bytes());
        written.put(&[self.register]).put(&self.vendor).finish()
    }
}
