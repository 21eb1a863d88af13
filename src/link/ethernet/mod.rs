//! A wire that carries EtherCAT, as one participant sees it.

#[cfg(all(feature = "ethernet", target_os = "linux"))]
mod error;
#[cfg(all(feature = "ethernet", target_os = "linux"))]
mod packet;
#[cfg(all(feature = "ethernet", target_os = "linux"))]
mod system;

#[cfg(all(feature = "ethernet", target_os = "linux"))]
pub use error::EthernetError;
#[cfg(all(feature = "ethernet", target_os = "linux"))]
pub use packet::{PacketSocket, is_ethernet};

use super::SendError;
use yieldwall_fieldbus::time::Time;

/// An event on a wire, with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EthernetArrival {
    /// Moment of the arrival on the clock of [`EthernetLink::now`].
    pub time: Time,
    /// The event.
    pub what: EthernetReceived,
}

/// Kinds of event on a wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EthernetReceived {
    /// A frame of another participant; so many bytes of the buffer are its own, from the destination on, without check sequence.
    Frame {
        /// Number of bytes.
        length: usize,
    },
    /// A frame that is longer than the buffer; it is gone.
    TooLong {
        /// Its number of bytes.
        length: usize,
    },
    /// The interface went down; it may come back.
    Down,
    /// The interface was removed; this link is of no more use.
    Gone,
}

/// One participant's access to a wire. It hears the frames of others with the type of EtherCAT (88A4h), and not its own.
pub trait EthernetLink {
    /// Returns the time of the clock on which frames arrive.
    ///
    /// Real-time: yes.
    fn now(&self) -> Time;

    /// Returns the source address of frames that leave by this link: another one for each master on an interface.
    fn source(&self) -> [u8; 6];

    /// Returns the next thing that has come, a frame in `buffer`; never waits.
    ///
    /// Real-time: yes; a caller in a cycle bounds how often it asks.
    fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival>;

    /// Hands a frame, from the destination on and without check sequence, to the interface; never waits.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// Reason for the loss of the frame.
    fn send(&mut self, frame: &[u8]) -> Result<(), SendError>;

    /// Waits until there is something to receive or `until` has come; whether there is something to receive. May return
    /// early with nothing, after a signal.
    fn wait(&mut self, until: Time) -> bool;
}

impl<L: EthernetLink + ?Sized> EthernetLink for Box<L> {
    fn now(&self) -> Time {
        (**self).now()
    }

    fn source(&self) -> [u8; 6] {
        (**self).source()
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        (**self).receive(buffer)
    }

    fn send(&mut self, frame: &[u8]) -> Result<(), SendError> {
        (**self).send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        (**self).wait(until)
    }
}
