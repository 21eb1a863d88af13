//! Why a segment did not come up.

use std::fmt;
use thiserror::Error;
use yieldwall_fieldbus::ethercat::mailbox::MailboxError;
use yieldwall_fieldbus::ethercat::sii::SiiError;
use yieldwall_fieldbus::ethercat::{AlState, AlStatus, AlStatusCode};

/// Sign of another master on a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SegmentSign {
    /// A frame with this source address.
    Frame([u8; 6]),
    /// A device exchanges process data.
    State {
        /// Its position, 0 at the master.
        position: u16,
        /// Its state.
        status: AlStatus,
    },
}

impl fmt::Display for SegmentSign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SegmentSign::Frame([a, b, c, d, e, last]) => {
                write!(f, "an EtherCAT frame came from {a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{last:02x}")
            }
            SegmentSign::State { position, status } => {
                write!(f, "the device at position {position} is in {status}, where somebody has put it")
            }
        }
    }
}

/// Failure of one step of the bring-up of a segment.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SegmentFailure {
    /// Somebody else is the master.
    #[error("{}: {sign}", if *.has_written {
        "another master is on this segment; nothing was enabled"
    } else {
        "a master is on this segment; nothing was written"
    })]
    OtherMaster {
        /// Sign of the other master.
        sign: SegmentSign,
        /// Whether this master had written something before.
        has_written: bool,
    },
    /// No frame comes back.
    #[error(
        "{tries} frames were sent and none came back: plug in the cable, or name the interface that the devices are at"
    )]
    NoReply {
        /// Frames that were sent.
        tries: u8,
    },
    /// Frames come back, and no device has passed them on.
    #[error(
        "{tries} frames came back, and no device has processed them: unplug the cable that leads them back, or name the interface of \
         the devices"
    )]
    CameBack {
        /// Frames that were sent.
        tries: u8,
    },
    /// A device does not process a datagram.
    #[error(
        "no device processed {tries} datagrams for register {register:04X}h: the device is off, broken or not there any more"
    )]
    NotProcessed {
        /// First register.
        register: u16,
        /// How often it was tried.
        tries: u8,
    },
    /// The segment is shorter than the rig.
    #[error(
        "{found} devices answer, and this one would be the one at position {position}: look at the cable behind the last one that answers"
    )]
    Missing {
        /// Devices that answer.
        found: u16,
        /// Where the device should be.
        position: u16,
    },
    /// More devices than a segment can have here.
    #[error("{found} devices answer, of which at most {most} can be there")]
    TooMany {
        /// Devices that answer.
        found: u16,
        /// The greatest number.
        most: u16,
    },
    /// The number of devices changed while they were brought up.
    #[error("{before} devices answered and now {now}: a cable or a device has come or gone")]
    Changed {
        /// Devices at first.
        before: u16,
        /// Devices now.
        now: u16,
    },
    /// The device does not give its SII.
    #[error(
        "its SII cannot be read at word {word:04X}h (status {status:04X}h): its memory chip does not answer, so switch it off and on"
    )]
    SiiAccess {
        /// The word.
        word: u16,
        /// Register 0502h.
        status: u16,
    },
    /// The SII says nothing.
    #[error("its SII cannot be used: {0}: write the image of the vendor anew")]
    Sii(#[from] SiiError),
    /// The device is another one than the rig says.
    #[error("{what} is {found:#x} and should be {expected}{}", match *.fits_at {
        Some(position) => format!(": the device at position {position} fits, so look at the order of the cables"),
        None => String::new(),
    })]
    Identity {
        /// Part of the identity.
        what: &'static str,
        /// Value in the rig.
        expected: Box<str>,
        /// Value that the device reports.
        found: u32,
        /// Another position at which such a device is.
        fits_at: Option<u16>,
    },
    /// A register does not hold what was written to it.
    #[error("register {register:04X}h was set to {written} and reads back {received}")]
    ReadBack {
        /// First register.
        register: u16,
        /// Bytes that were written, in hexadecimal digits.
        written: Box<str>,
        /// Bytes that came back.
        received: Box<str>,
    },
    /// The controller lacks what the exchange needs.
    #[error("its controller has {has} {what}, and the exchange needs {needs}")]
    Lacks {
        /// Object or feature that it lacks.
        what: &'static str,
        /// How many it has.
        has: u8,
        /// How many are needed.
        needs: u8,
    },
    /// The device has no CoE.
    #[error("it has no mailbox with CoE (SII words 0018h to 001Ch), over which objects are read and written")]
    NoCoe,
    /// The device refused a mailbox.
    #[error("it refuses the mailbox: {} ({})", .0.meaning(), .0.0)]
    Mailbox(MailboxError),
    /// The device refused a state.
    #[error("{from} to {to} refused with {code}; {}", next(*.to, *.code))]
    Refused {
        /// The state in which it is.
        from: AlStatus,
        /// The state that was asked for.
        to: AlState,
        /// Why.
        code: AlStatusCode,
    },
    /// The device did not come to a state.
    #[error("it is in {is} {waited_ms} ms after the request of {to}, and reports no error; {}", next(*.to, AlStatusCode::NONE))]
    NotReached {
        /// The state in which it is.
        is: AlStatus,
        /// The state that was asked for.
        to: AlState,
        /// How long the master waited, in ms.
        waited_ms: u64,
    },
    /// The device has no clock for SYNC0.
    #[error("it has no distributed clock of 64 bits, which `sync0` needs: have its outputs act on arrival")]
    NoClock,
    /// SYNC0 was not set up in time.
    #[error(
        "SYNC0 was set up too late {tries} times, since frames are lost or this computer stands still: check the cable, or run on a \
         computer that wakes up in time"
    )]
    Sync0Late {
        /// How often it was tried.
        tries: u8,
    },
    /// The ports of the devices do not make a tree.
    #[error(
        "the ports of the device at position {position} (register 0110h: {links:04X}h) do not fit those before it: frames have to come \
         in at port 0"
    )]
    Topology {
        /// Its position.
        position: u16,
        /// Register 0110h.
        links: u16,
    },
    /// The clocks did not come together.
    #[error(
        "the clocks are {error_ns} ns apart after {waited_ms} ms: raise the cycle time, or run on a computer that wakes up in time. \
         Simulated devices need the same `--pace` as this program"
    )]
    Unsettled {
        /// The greatest difference, in ns.
        error_ns: i64,
        /// How long the master waited, in ms.
        waited_ms: u64,
    },
    /// A frame of a cycle would be too long.
    #[error("the {what} frame of a cycle would have {len} bytes, more than the 1514 of Ethernet")]
    FrameTooLong {
        /// Kind of frame.
        what: &'static str,
        /// Its bytes.
        len: usize,
    },
    /// A value of the process data is too long.
    #[error(
        "{index:04X}h:{sub} has {bits} bits, and values in process data have 1 to 32: compare its length with the profile"
    )]
    Bits {
        /// Index.
        index: u16,
        /// Sub-index.
        sub: u8,
        /// Its bits.
        bits: u8,
    },
    /// A mapping with more objects than it can hold.
    #[error("{index:04X}h would map {objects} objects, of which it can hold 254")]
    TooManyObjects {
        /// Index of the mapping.
        index: u16,
        /// Its objects.
        objects: usize,
    },
    /// Two devices of the rig have one position.
    #[error("position {position} is used twice")]
    Position {
        /// The position.
        position: u16,
    },
}

/// Returns the next thing to try when a device does not reach a state.
fn next(to: AlState, code: AlStatusCode) -> &'static str {
    match (to, code) {
        (_, AlStatusCode::INVALID_OUTPUTS | AlStatusCode::INVALID_INPUTS) => {
            "compare the process data of its profile with 1C12h, 1C13h and what they name"
        }
        (_, AlStatusCode::INVALID_DC | AlStatusCode::INVALID_SYNC1_CYCLE) => {
            "compare cycle.period_us and `sync1_us` of its profile with the modes of its clock in its ESI (AssignActivate 0700h wants SYNC1)"
        }
        (_, AlStatusCode::INVALID_CYCLE | AlStatusCode::INVALID_SYNC0_CYCLE) => {
            "compare cycle.period_us with 1C32h:05 and the modes in its ESI"
        }
        (_, AlStatusCode::NO_SYNC | AlStatusCode::FATAL_SYNC | AlStatusCode::SYNC_ERROR | AlStatusCode::PLL) => {
            "look whether its clock follows the reference clock (092Ch)"
        }
        (AlState::Init, _) => "switch it off and on",
        (AlState::PreOperational | AlState::Bootstrap, _) => "compare its SII with its ESI, words 0018h to 001Bh",
        (AlState::SafeOperational, _) => "compare its process data and synchronisation with its ESI",
        (AlState::Operational, _) => {
            "look whether output frames reach it and whether its own errors are gone (1001h, 603Fh)"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_says_code_cause_and_what_to_try() {
        let from = AlStatus::new(AlState::PreOperational, true);
        let failure =
            SegmentFailure::Refused { from, to: AlState::SafeOperational, code: AlStatusCode::INVALID_INPUTS };
        assert_eq!(
            failure.to_string(),
            "PRE-OP+ERR to SAFE-OP refused with 001Eh input configuration not valid (length of sync manager 3 and the mapping in \
             1C13h differ); compare the process data of its profile with 1C12h, 1C13h and what they name"
        );
    }

    #[test]
    fn another_master_is_told_by_what_was_heard() {
        let sign = SegmentSign::Frame([0x12, 0, 0, 0, 0, 0xff]);
        assert_eq!(
            SegmentFailure::OtherMaster { sign, has_written: false }.to_string(),
            "a master is on this segment; nothing was written: an EtherCAT frame came from 12:00:00:00:00:ff"
        );
    }
}
