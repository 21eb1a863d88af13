//! The bus as one participant sees it: received frames with their arrival times, own frames that were sent, and the controller's reports
//! about itself.
//!
//! The traits and their implementations:
//!
//! - [`CanLink`] is the interface that a control loop needs. On Linux [`SocketCan`] implements it, behind the feature `socketcan`.
//! - [`SocketCans`] combines several of these, one for each bus.
//! - [`EthernetLink`] is the same interface for a wire that carries EtherCAT. On Linux [`PacketSocket`] implements it, behind the feature
//!   `ethernet`.
//! - [`Wires`] joins both for a rig that may have both. On Linux [`Interfaces`] implements it.
//! - [`CaptureWriter`] records the frames.
//!
//! A link holds no frame back: a frame that [`CanLink::send`] refuses is lost and is never sent later. A frame that is already in the queue
//! of the kernel or of the controller cannot be removed, unless the interface goes down. For this reason `bus::Master` has at most one
//! cycle in flight.

mod candump;
mod capture;
pub mod checkup;
#[cfg(all(feature = "ethernet", target_os = "linux"))]
mod clock;
mod error_frame;
mod ethernet;
#[cfg(all(feature = "ethernet", target_os = "linux"))]
mod hold;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod interfaces;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod linux;
mod other;
#[cfg(all(feature = "ethernet", target_os = "linux"))]
mod role;

pub use candump::CandumpWriter;
pub use capture::{CaptureWriter, CapturedBus, Whole, whole_blocks};
pub use error_frame::ErrorFrame;
pub use ethernet::{EthernetArrival, EthernetLink, EthernetReceived};
#[cfg(all(feature = "ethernet", target_os = "linux"))]
pub use ethernet::{EthernetError, PacketSocket, is_ethernet};
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use interfaces::Interfaces;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use linux::{
    Attachment, CobFilter, ControllerState, InterfaceFacts, LinkError, SocketCan, SocketCanSettings, SocketCans,
    Stamps, interfaces,
};
pub use other::{OtherFrame, OtherTraffic};
#[cfg(all(feature = "ethernet", target_os = "linux"))]
pub use role::{Holder, Role};

use yieldwall_fieldbus::LinkEvent;
pub use yieldwall_fieldbus::Packet;
use yieldwall_fieldbus::canopen::{BusId, Frame, Outbox};
use yieldwall_fieldbus::time::Time;

/// An event on a link, with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Moment of the arrival on the clock of [`CanLink::now`]; not before that of the arrival before it.
    pub time: Time,
    /// The bus, which a frame names as well ([`Frame::bus`]).
    pub bus: BusId,
    /// The event.
    pub what: Received,
}

/// Kinds of event on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A frame of another participant.
    Frame(Frame),
    /// A frame that this link has sent, now that it has been on the wire.
    Echo(Frame),
    /// A frame of another participant that is not a CANopen frame. A link reports them only on request.
    Other(OtherFrame),
    /// A report of the controller.
    Error(ErrorFrame),
    /// Number of frames lost here since the last arrival, because nobody took them in time.
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
    /// Returns the event, other than a frame, that the master has to know.
    pub fn link_event(&self) -> Option<LinkEvent> {
        match self {
            Received::Error(error) => error.link_event(),
            Received::Down | Received::Gone => Some(LinkEvent::SendFailed),
            Received::Frame(_) | Received::Echo(_) | Received::Other(_) | Received::Overflow { .. } => None,
        }
    }
}

/// Reason why a frame was not sent.
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
    /// Returns the time of the clock on which frames arrive.
    ///
    /// Real-time: yes.
    fn now(&self) -> Time;

    /// Returns the next thing that has come; never waits. Process data come before services, each in the order of the wire, and of
    /// several wires in the order of time.
    ///
    /// Real-time: yes; a caller in a cycle bounds how often it asks.
    fn receive(&mut self) -> Option<Arrival>;

    /// Hands a frame to the interface; never waits.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// Reason for the loss of the frame.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError>;

    /// Waits until there is something to receive or `until` has come; whether there is something to receive. May return
    /// early with nothing, after a signal.
    fn wait(&mut self, until: Time) -> bool;
}

/// One participant's access to all wires of a rig: its CAN buses, and its EtherCAT segment if it has one. [`CanLink::wait`] ends when an
/// event arrives on any of them.
pub trait Wires: CanLink {
    /// Returns the source address of frames over the segment; that of [`EthernetLink::source`] on an interface.
    fn source(&self) -> [u8; 6] {
        yieldwall_fieldbus::ethercat::frame::SOURCE
    }

    /// Returns the next thing that has come over the segment, a frame in `buffer`; never waits.
    ///
    /// Real-time: yes; a caller in a cycle bounds how often it asks.
    fn receive_ethernet(&mut self, _buffer: &mut [u8]) -> Option<EthernetArrival> {
        None
    }

    /// Hands a frame, from the destination on and without check sequence, to the interface of the segment; never waits.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// Reason for the loss of the frame.
    fn send_ethernet(&mut self, _bytes: &[u8]) -> Result<(), SendError> {
        Err(SendError::Gone)
    }
}

impl<L: CanLink + ?Sized> CanLink for Box<L> {
    fn now(&self) -> Time {
        (**self).now()
    }

    fn receive(&mut self) -> Option<Arrival> {
        (**self).receive()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        (**self).send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        (**self).wait(until)
    }
}

/// A link as the place where an engine puts its frames.
///
/// After the first frame that could not be sent on a bus, the outbox drops the rest for that bus. A command that arrives without the frames
/// before it is worse than none. Frames for other buses, such as the quick stop of a drive there, are still sent.
#[derive(Debug)]
pub struct LinkOutbox<'a, L: ?Sized> {
    link: &'a mut L,
    /// The buses on which something could not be sent, a bit each.
    failed: u8,
    failure: Option<(BusId, SendError)>,
}

impl<'a, L: CanLink + ?Sized> LinkOutbox<'a, L> {
    /// Sends over `link`.
    pub fn new(link: &'a mut L) -> Self {
        Self { link, failed: 0, failure: None }
    }

    /// Returns why the first frame of all was not sent, with its bus.
    pub fn failure(&self) -> Option<(BusId, SendError)> {
        self.failure
    }

    /// Returns the buses on which something was not sent; the master wants to know it as [`LinkEvent::SendFailed`].
    pub fn failed_buses(&self) -> impl Iterator<Item = BusId> + use<L> {
        let failed = self.failed;
        // Nearly always none, and asked after each frame.
        let buses = if failed == 0 { 0 } else { u8::BITS as usize };
        BusId::all().take(buses).filter(move |bus| failed & bus.bit() != 0)
    }
}

impl<L: CanLink + ?Sized> LinkOutbox<'_, L> {
    /// Sends a frame; returns the reason if it could not be sent, and nothing on a bus that has failed before.
    fn try_send(&mut self, frame: &Frame) -> Option<Result<(), SendError>> {
        let is_failed = self.failed & frame.bus().bit() != 0;
        (!is_failed).then(|| self.link.send(frame))
    }

    fn fail(&mut self, frame: &Frame, error: SendError) {
        self.failed |= frame.bus().bit();
        self.failure.get_or_insert((frame.bus(), error));
    }
}

impl<L: CanLink + ?Sized> Outbox for LinkOutbox<'_, L> {
    fn push(&mut self, frame: Frame) {
        if let Some(Err(error)) = self.try_send(&frame) {
            self.fail(&frame, error);
        }
    }

    /// A full queue refuses, and that is no failure.
    fn offer(&mut self, frame: Frame) -> bool {
        match self.try_send(&frame) {
            Some(Err(error)) => {
                if error != SendError::Full {
                    self.fail(&frame, error);
                }
                false
            }
            sent => sent.is_some(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link whose queue holds so many frames, or that has failed.
    struct Short {
        sent: Vec<Frame>,
        room: usize,
        error: SendError,
    }

    impl CanLink for Short {
        fn now(&self) -> Time {
            Time(0)
        }

        fn receive(&mut self) -> Option<Arrival> {
            None
        }

        fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
            if self.sent.len() >= self.room {
                return Err(self.error);
            }
            self.sent.push(*frame);
            Ok(())
        }

        fn wait(&mut self, _: Time) -> bool {
            false
        }
    }

    fn frame(id: u16) -> Frame {
        Frame::new(id, &[])
    }

    #[test]
    fn what_can_wait_is_refused_by_a_full_queue_without_failing() {
        let mut link = Short { sent: Vec::new(), room: 2, error: SendError::Full };
        let mut out = LinkOutbox::new(&mut link);
        assert_eq!([1, 2, 3].map(|id| out.offer(frame(id))), [true, true, false]);
        assert_eq!((out.failure(), out.failed_buses().count()), (None, 0));
        out.link.room = 3;
        assert!(out.offer(frame(3)));
        // What cannot wait fails, and nothing follows it.
        out.push(frame(4));
        assert_eq!(out.failure(), Some((BusId::FIRST, SendError::Full)));
        out.link.room = 9;
        assert!(!out.offer(frame(5)));
        assert_eq!(link.sent, [1, 2, 3].map(frame));
    }

    #[test]
    fn another_refusal_is_a_failure_for_what_can_wait_too() {
        let mut link = Short { sent: Vec::new(), room: 0, error: SendError::Down };
        let mut out = LinkOutbox::new(&mut link);
        assert!(!out.offer(frame(1).on_bus(BusId::new(2))));
        assert_eq!(out.failure(), Some((BusId::new(2), SendError::Down)));
    }
}
