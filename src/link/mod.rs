//! The bus as one participant sees it: frames that come with the moment of their arrival, own frames that are seen on the
//! wire, and what the controller tells of itself.
//!
//! [`CanLink`] is all that a loop needs of an interface. [`SocketCan`] is the one of Linux, behind the feature `socketcan`, and
//! [`SocketCans`] several of them, one for each bus.
//!
//! A link keeps no frame back: what [`CanLink::send`] refuses is gone and is never sent later. What is already in the
//! queue of the kernel or of the controller can no longer be taken back by anybody but the interface going down, which is why
//! [`Master`](crate::bus::Master) has at most one cycle in flight.

mod error_frame;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod linux;

pub use error_frame::ErrorFrame;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use linux::{
    CobFilter, ControllerState, Holder, InterfaceFacts, LinkError, Role, SocketCan, SocketCanSettings, SocketCans,
};

use crate::bus::LinkEvent;
use crate::canopen::{Frame, Outbox, Time};

/// What has come over a link, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Moment of the arrival on the clock of [`CanLink::now`]; not before that of the arrival before it.
    pub time: Time,
    /// Number of the bus, which a frame has as well ([`Frame::bus`]).
    pub bus: u8,
    /// What has come.
    pub what: Received,
}

/// What can come over a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A frame of another participant.
    Frame(Frame),
    /// A frame that this link has sent, now that it has been on the wire.
    Echo(Frame),
    /// What the controller tells.
    Error(ErrorFrame),
    /// So many frames were lost here since the last arrival, because nobody took them in time.
    Overflow {
        /// Number of frames.
        frames: u32,
    },
    /// The interface went down; it may come back.
    Down,
    /// The interface was removed; this link is of no more use.
    Gone,
}

impl Received {
    /// What the master has to know of it, beside the frames.
    pub fn link_event(&self) -> Option<LinkEvent> {
        match self {
            Received::Error(error) => error.link_event(),
            Received::Down | Received::Gone => Some(LinkEvent::SendFailed),
            Received::Frame(_) | Received::Echo(_) | Received::Overflow { .. } => None,
        }
    }
}

/// Why a frame was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SendError {
    /// The queue of the interface is full: nobody acknowledges, or the bus is too slow for what is sent.
    #[error("the transmit queue is full")]
    Full,
    /// The interface is down.
    #[error("the interface is down")]
    Down,
    /// The interface was removed.
    #[error("the interface is gone")]
    Gone,
    /// Anything else that the system refuses.
    #[error("error {errno} of the system")]
    System {
        /// Number of the error, as `errno` has it.
        errno: i32,
    },
}

/// One participant's access to a bus, or to several whose frames say which is theirs ([`Frame::bus`]).
pub trait CanLink {
    /// The time of the clock on which frames arrive.
    ///
    /// Real-time: yes.
    fn now(&self) -> Time;

    /// The next thing that has come; never waits. Process data come before services, each in the order of the wire, and of
    /// several wires in the order of time.
    ///
    /// Real-time: yes; a caller in a cycle bounds how often it asks.
    fn receive(&mut self) -> Option<Arrival>;

    /// Hands a frame to the interface; never waits.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// Why the frame is gone.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError>;

    /// Waits until there is something to receive or `until` has come; whether there is something to receive. May return
    /// early with nothing, after a signal.
    fn wait(&mut self, until: Time) -> bool;
}

/// A link as the place where an engine puts its frames.
///
/// After the first frame that could not be sent on a bus the rest for that bus is dropped: an order that arrives without what
/// led to it is worse than none. What is for other buses is sent all the same, such as the quick stop of the drive there.
#[derive(Debug)]
pub struct LinkOutbox<'a, L> {
    link: &'a mut L,
    /// The buses on which something could not be sent, a bit each.
    failed: u8,
    failure: Option<(u8, SendError)>,
}

impl<'a, L: CanLink> LinkOutbox<'a, L> {
    /// Sends over `link`.
    pub fn new(link: &'a mut L) -> Self {
        Self { link, failed: 0, failure: None }
    }

    /// Why the first of all was not sent, with the number of its bus.
    pub fn failure(&self) -> Option<(u8, SendError)> {
        self.failure
    }

    /// The buses on which something was not sent; the master wants to know it as [`LinkEvent::SendFailed`].
    pub fn failed_buses(&self) -> impl Iterator<Item = u8> + use<L> {
        let failed = self.failed;
        (0..8).filter(move |bus| failed >> bus & 1 == 1)
    }
}

impl<L: CanLink> Outbox for LinkOutbox<'_, L> {
    fn push(&mut self, frame: Frame) {
        let own = 1_u8.checked_shl(frame.bus().into()).unwrap_or_default();
        if self.failed & own != 0 {
            return;
        }
        if let Err(error) = self.link.send(&frame) {
            self.failed |= own;
            self.failure.get_or_insert((frame.bus(), error));
        }
    }
}
