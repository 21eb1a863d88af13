//! Emergency messages: frame, decoding, and what the codes mean.

mod codes;

use std::fmt;

use super::{ErrorRegister, Frame, NodeId, cob};

/// An emergency error code as it is on the bus; `Display` prints code and meaning.
///
/// # Source
/// CiA 301, emergency error codes; CiA 402, error codes of drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EmcyCode(pub u16);

impl EmcyCode {
    /// No error any more, or one error fewer.
    pub const RESET: EmcyCode = EmcyCode(0x0000);
    /// Generic error.
    pub const GENERIC: EmcyCode = EmcyCode(0x1000);
    /// A watched heartbeat did not come.
    pub const HEARTBEAT: EmcyCode = EmcyCode(0x8130);
    /// An RPDO was too short and not processed.
    pub const PDO_LENGTH: EmcyCode = EmcyCode(0x8210);
    /// A SYNC came with another length than the counter (1019h) asks for.
    pub const SYNC_LENGTH: EmcyCode = EmcyCode(0x8240);
    /// An RPDO did not come in time.
    pub const RPDO_TIMEOUT: EmcyCode = EmcyCode(0x8250);
    /// Following error.
    pub const FOLLOWING_ERROR: EmcyCode = EmcyCode(0x8611);

    /// Returns the codes that have a meaning of their own, ascending.
    pub fn listed() -> impl Iterator<Item = Self> {
        codes::LISTED.iter().map(|code| Self(*code))
    }

    /// Whether an error has gone.
    pub const fn is_reset(self) -> bool {
        self.0 == 0
    }

    /// Whether the node goes on as before after this: it lost a message, or reports a bus error that is over.
    ///
    /// Everything else may have changed what the node does, an unknown code too.
    pub const fn is_warning(self) -> bool {
        matches!(self.0, 0x8110 | 0x8120 | 0x8140 | 0x8220 | 0x8240)
    }

    /// Returns the short name, unique among codes with a meaning of their own; for another code, that of its class.
    pub const fn name(self) -> &'static str {
        codes::texts(self.0).name
    }

    /// Returns the meaning of the code; for a code that is not listed, the meaning of its class.
    pub const fn meaning(self) -> &'static str {
        codes::texts(self.0).meaning
    }

    /// Returns the usual cause.
    pub const fn likely_cause(self) -> &'static str {
        codes::texts(self.0).cause
    }

    /// Returns the next step for a person.
    pub const fn next(self) -> &'static str {
        codes::texts(self.0).next
    }
}

impl fmt::Display for EmcyCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}h {}", self.0, self.meaning())
    }
}

/// An emergency message from a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// Sender, from the default identifier 080h + node id.
    pub node: NodeId,
    /// Error code.
    pub code: EmcyCode,
    /// Error register 1001h at that moment.
    pub register: ErrorRegister,
    /// Vendor specific bytes.
    pub vendor: [u8; 5],
}

impl Emergency {
    /// Returns the emergency message in a frame with a default identifier (081h to 0FFh) and eight bytes; `None` otherwise.
    ///
    /// Real-time: yes.
    pub fn decode(frame: &Frame) -> Option<Self> {
        let raw = frame.id().checked_sub(0x080).filter(|raw| (1..=127).contains(raw))?;
        let message = canopen_rs::EmergencyMessage::decode(frame.data()).ok()?;
        Some(Emergency {
            node: NodeId::new(raw as u8).ok()?,
            code: EmcyCode(message.error_code),
            register: message.error_register,
            vendor: message.vendor_specific,
        })
    }

    /// Returns the message as a frame at 080h + node id.
    ///
    /// Real-time: yes.
    pub fn frame(&self) -> Frame {
        frame(cob::emcy(self.node), self.code, self.register, self.vendor)
    }
}

impl fmt::Display for Emergency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {}: {}, register {:02X}h", self.node.raw(), self.code, self.register.0)
    }
}

/// One entry of the error history of a device, 1003h:1 (the latest) to 1003h:254.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PastError {
    /// Error code.
    pub code: EmcyCode,
    /// Additional information of the manufacturer; devices of this project: the first two vendor bytes of the emergency message.
    pub information: u16,
}

impl PastError {
    /// Reads an entry as it is in the object.
    pub const fn from_entry(entry: u32) -> Self {
        PastError { code: EmcyCode(entry as u16), information: (entry >> 16) as u16 }
    }
}

impl fmt::Display for PastError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, information {:04X}h", self.code, self.information)
    }
}

/// Returns an emergency message at any identifier.
pub(super) fn frame(id: u16, code: EmcyCode, register: ErrorRegister, vendor: [u8; 5]) -> Frame {
    Frame::new(id, &canopen_rs::EmergencyMessage::new(code.0, register, vendor).encode())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_bytes_both_ways() {
        let node = cob::node_id(3).unwrap();
        let vendor = [1, 2, 3, 4, 5];
        let emergency = Emergency { node, code: EmcyCode::HEARTBEAT, register: ErrorRegister(0x11), vendor };
        assert_eq!(emergency.frame(), Frame::new(0x083, &[0x30, 0x81, 0x11, 1, 2, 3, 4, 5]));
        assert_eq!(Emergency::decode(&emergency.frame()), Some(emergency));
        assert_eq!(emergency.to_string(), "node 3: 8130h heartbeat or life guarding lost, register 11h");
    }

    #[test]
    fn other_frames_are_not_emergencies() {
        assert_eq!(Emergency::decode(&Frame::new(0x080, &[0; 8])), None);
        assert_eq!(Emergency::decode(&Frame::new(0x100, &[0; 8])), None);
        assert_eq!(Emergency::decode(&Frame::new(0x083, &[0; 7])), None);
    }

    #[test]
    fn what_a_node_overcomes_by_itself_is_a_warning() {
        for (code, is_warning) in [
            (0x8110, true),
            (0x8120, true),
            (0x8140, true),
            (0x8220, true),
            (0x8240, true),
            (0x8130, false),
            (0x8210, false),
            (0x8250, false),
            (0x4210, false),
            (0xff00, false),
            (0x1000, false),
        ] {
            assert_eq!(EmcyCode(code).is_warning(), is_warning, "{code:04X}h");
        }
    }

    #[test]
    fn the_history_of_a_device_reads_as_text() {
        let past = PastError::from_entry(0x007f_8130);
        assert_eq!((past.code, past.information), (EmcyCode::HEARTBEAT, 0x7f));
        assert_eq!(past.to_string(), "8130h heartbeat or life guarding lost, information 007Fh");
    }

    #[test]
    fn listed_codes_are_in_order_and_have_names_of_their_own() {
        assert!(codes::LISTED.windows(2).all(|pair| pair[0] < pair[1]));
        let names: std::collections::BTreeSet<&str> = codes::LISTED.iter().map(|code| EmcyCode(*code).name()).collect();
        assert_eq!(names.len(), codes::LISTED.len());
    }

    #[test]
    fn unlisted_codes_print_their_class() {
        assert_eq!(EmcyCode(0x2380).to_string(), "2380h current, output side");
        assert_eq!(EmcyCode(0xffff).to_string(), "FFFFh device specific");
        assert_eq!(EmcyCode(0xa000).to_string(), "A000h code not defined by CiA 301");
    }
}
