//! Mailbox: messages of variable length through sync managers 0 and 1.
//!
//! # Source
//! ETG.1000.4, 5.6 (header, error reply).

mod client;

pub use client::MailboxClient;

use super::{EthercatError, array, u16_at};
use crate::time::Time;

/// Bytes of the header.
pub const HEADER: usize = 6;
/// Shortest mailbox that can hold an SDO: header, CoE header and eight bytes.
pub const SHORTEST: usize = HEADER + 10;
/// Longest mailbox.
pub const LONGEST: usize = 1486;

/// Protocol of a mailbox message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Protocol {
    /// An error reply.
    Error = 0,
    /// ADS over EtherCAT.
    Aoe = 1,
    /// Ethernet over EtherCAT.
    Eoe = 2,
    /// CANopen over EtherCAT.
    Coe = 3,
    /// Files over EtherCAT.
    Foe = 4,
    /// Sercos over EtherCAT.
    Soe = 5,
    /// Protocol of the vendor.
    Voe = 15,
}

impl Protocol {
    /// Returns the protocol of a number; `None` for a number without a protocol.
    pub const fn from_number(number: u8) -> Option<Protocol> {
        Some(match number {
            0 => Protocol::Error,
            1 => Protocol::Aoe,
            2 => Protocol::Eoe,
            3 => Protocol::Coe,
            4 => Protocol::Foe,
            5 => Protocol::Soe,
            15 => Protocol::Voe,
            _ => return None,
        })
    }
}

/// The header of a mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MailboxHeader {
    /// Bytes of the message behind the header.
    pub len: u16,
    /// Station address of the other side; 0 between master and device.
    pub address: u16,
    /// Channel (0) and priority (bits 6 and 7).
    pub channel: u8,
    /// Number of the protocol, 0 to 15.
    pub protocol: u8,
    /// Counter, 1 to 7; 0 where the sender does not count.
    pub counter: u8,
}

impl MailboxHeader {
    /// Returns the header in six bytes.
    pub const fn decode(bytes: &[u8; HEADER]) -> Self {
        MailboxHeader {
            len: u16::from_le_bytes([bytes[0], bytes[1]]),
            address: u16::from_le_bytes([bytes[2], bytes[3]]),
            channel: bytes[4],
            protocol: bytes[5] & 0x0f,
            counter: bytes[5] >> 4 & 0x07,
        }
    }

    /// Returns the six bytes of the header.
    pub const fn encode(&self) -> [u8; HEADER] {
        let ([a, b], [c, d]) = (self.len.to_le_bytes(), self.address.to_le_bytes());
        [a, b, c, d, self.channel, self.protocol & 0x0f | (self.counter & 0x07) << 4]
    }
}

/// Returns the header and the message of a mailbox; what lies behind the message does not count.
///
/// # Errors
/// If the mailbox is shorter than its header says.
pub fn decode(mailbox: &[u8]) -> Result<(MailboxHeader, &[u8]), EthercatError> {
    let short = |needed| EthercatError::Short { what: "the mailbox", len: mailbox.len(), needed };
    let header = MailboxHeader::decode(mailbox.first_chunk().ok_or(short(HEADER))?);
    let needed = HEADER + usize::from(header.len);
    mailbox.get(HEADER..needed).map(|message| (header, message)).ok_or(short(needed))
}

/// Puts a header before the message of `len` bytes that lies behind it in `mailbox`; gives the bytes of both, 0 if they do not fit.
///
/// Real-time: yes.
pub fn seal(mailbox: &mut [u8], protocol: Protocol, counter: Counter, len: usize) -> usize {
    if mailbox.len() < HEADER + len || len > usize::from(u16::MAX) {
        return 0;
    }
    let header =
        MailboxHeader { len: len as u16, address: 0, channel: 0, protocol: protocol as u8, counter: counter.number() };
    if let Some(to) = mailbox.first_chunk_mut() {
        *to = header.encode();
    }
    HEADER + len
}

/// The counter of one sender: 1 to 7, then 1 again. A receiver drops a message whose counter is that of the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counter(u8);

impl Counter {
    /// The first one.
    pub const FIRST: Counter = Counter(1);

    /// One by chance, which is the nanosecond, for a sender who does not know which one the device has heard last: of a process before this one.
    pub const fn of(now: Time) -> Counter {
        Counter((now.0 % 7) as u8 + 1)
    }

    /// Returns the counter as on the wire.
    pub const fn number(self) -> u8 {
        self.0
    }

    /// Returns this counter, and keeps the next one.
    pub fn take(&mut self) -> Counter {
        let taken = *self;
        self.0 = if self.0 >= 7 { 1 } else { self.0 + 1 };
        taken
    }
}

/// Reason why a device could not take a mailbox message.
///
/// # Source
/// ETG.1000.4, table of mailbox errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MailboxError(pub u16);

impl MailboxError {
    /// The header cannot be.
    pub const SYNTAX: MailboxError = MailboxError(1);
    /// The device does not speak the protocol.
    pub const UNSUPPORTED_PROTOCOL: MailboxError = MailboxError(2);
    /// The channel is not 0.
    pub const INVALID_CHANNEL: MailboxError = MailboxError(3);
    /// The protocol has no such service.
    pub const SERVICE_NOT_SUPPORTED: MailboxError = MailboxError(4);
    /// The header of the protocol cannot be.
    pub const INVALID_HEADER: MailboxError = MailboxError(5);
    /// The message is too short.
    pub const SIZE_TOO_SHORT: MailboxError = MailboxError(6);
    /// No memory.
    pub const NO_MORE_MEMORY: MailboxError = MailboxError(7);
    /// The length cannot be.
    pub const INVALID_SIZE: MailboxError = MailboxError(8);

    /// Returns the meaning of the number.
    pub const fn meaning(self) -> &'static str {
        match self.0 {
            1 => "syntax of the mailbox header wrong",
            2 => "protocol not supported",
            3 => "channel not valid",
            4 => "service not supported",
            5 => "header of the protocol wrong",
            6 => "message too short",
            7 => "no memory",
            8 => "length not valid",
            _ => "number not defined by the standard",
        }
    }

    /// Returns the message of an error reply.
    pub const fn encode(self) -> [u8; 4] {
        let [low, high] = self.0.to_le_bytes();
        [1, 0, low, high]
    }

    /// Reads the message of an error reply; `None` for another message.
    pub fn decode(message: &[u8]) -> Option<Self> {
        (message.len() >= 4 && array(message, 0) == [1, 0]).then(|| MailboxError(u16_at(message, 2)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_16_bytes() {
        let mut mailbox = [0; 32];
        mailbox[6..16].copy_from_slice(&[0x00, 0x20, 0x40, 0x18, 0x10, 0x01, 0, 0, 0, 0]);
        let mut counter = Counter::FIRST;
        counter.take();
        assert_eq!(seal(&mut mailbox, Protocol::Coe, counter, 10), 16);
        assert_eq!(mailbox[..8], [0x0a, 0x00, 0x00, 0x00, 0x00, 0x23, 0x00, 0x20]);
        let (header, message) = decode(&mailbox).unwrap();
        assert_eq!((header.counter, header.protocol, message.len()), (2, 3, 10));
        mailbox[0] = 27;
        let short = EthercatError::Short { what: "the mailbox", len: 32, needed: 33 };
        assert_eq!(decode(&mailbox), Err(short));
        assert_eq!(seal(&mut mailbox, Protocol::Coe, counter, 27), 0);
    }

    #[test]
    fn the_counter_leaves_out_zero() {
        let mut counter = Counter::FIRST;
        let taken: Vec<u8> = (0..9).map(|_| counter.take().number()).collect();
        assert_eq!(taken, [1, 2, 3, 4, 5, 6, 7, 1, 2]);
        let of_time: Vec<u8> = (5..13).map(|now| Counter::of(Time(now)).number()).collect();
        assert_eq!(of_time, [6, 7, 1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn an_error_reply_is_four_bytes() {
        assert_eq!(MailboxError::UNSUPPORTED_PROTOCOL.encode(), [1, 0, 2, 0]);
        assert_eq!(MailboxError::decode(&[1, 0, 6, 0]), Some(MailboxError::SIZE_TOO_SHORT));
        assert_eq!((MailboxError::decode(&[1, 0, 6]), MailboxError::decode(&[2, 0, 6, 0])), (None, None));
    }
}
