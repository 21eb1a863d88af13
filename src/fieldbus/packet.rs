//! A frame of whatever bus.

use crate::canopen::{BusId, Frame};

/// A frame that went over a wire of a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packet<'a> {
    /// Over a CAN bus, which the frame names ([`Frame::bus`]).
    Can(&'a Frame),
    /// Over an EtherCAT segment.
    Ethernet {
        /// The segment.
        bus: BusId,
        /// From the destination on, without check sequence.
        bytes: &'a [u8],
    },
}

impl<'a> Packet<'a> {
    /// Returns the frame, if it went over a CAN bus.
    pub fn can(self) -> Option<&'a Frame> {
        match self {
            Packet::Can(frame) => Some(frame),
            Packet::Ethernet { .. } => None,
        }
    }
}
