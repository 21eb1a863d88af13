//! Faults of received or sent EtherCAT bytes.

/// A fault found while bytes are read or written; what a device reports is an [`AlStatusCode`](super::AlStatusCode) or an
/// [`AbortCode`](crate::objects::AbortCode).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EthercatError {
    /// Not an EtherCAT frame: another Ethernet type, or another protocol type than 1.
    #[error("this is no EtherCAT frame with datagrams")]
    NotEthercat,
    /// A frame, a datagram, a mailbox or a service ends before its own length says so.
    #[error("{what} ends after {len} bytes, but needs {needed}")]
    Short {
        /// The part that ends.
        what: &'static str,
        /// Bytes that are there.
        len: usize,
        /// Bytes that it needs.
        needed: usize,
    },
    /// The data to send do not fit into the room.
    #[error("{what} of {len} bytes does not fit {room}")]
    Full {
        /// The part to write.
        what: &'static str,
        /// Its bytes.
        len: usize,
        /// Bytes that are left.
        room: usize,
    },
    /// A command of a datagram that the standard does not define.
    #[error("datagram command {0} is not defined")]
    Command(u8),
    /// A mailbox protocol or a service of CoE that this engine does not speak.
    #[error("{what} {number} is not supported")]
    Unsupported {
        /// The part that is not supported.
        what: &'static str,
        /// Its number on the wire.
        number: u16,
    },
    /// A request while another one runs.
    #[error("a request to this device is still running")]
    Busy,
}
