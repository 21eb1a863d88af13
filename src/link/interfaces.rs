//! The interfaces of a rig as one link: those of its CAN buses, and that of its EtherCAT segment.

use rustix::event::{PollFd, PollFlags};

use super::clock::{monotonic, wait_for_any};
use super::{
    Arrival, CanLink, EthernetArrival, EthernetLink, PacketSocket, SendError, SocketCan, SocketCans, Wires,
    linux::MOST_PORTS,
};
use yieldwall_fieldbus::canopen::Frame;
use yieldwall_fieldbus::time::Time;

/// One interface for each bus of a rig.
#[derive(Debug)]
pub struct Interfaces {
    can: SocketCans,
    segment: Option<PacketSocket>,
}

impl Interfaces {
    /// Combines the interfaces of the CAN buses with the interface of the segment.
    pub fn new(can: SocketCans, segment: Option<PacketSocket>) -> Self {
        Self { can, segment }
    }

    /// Returns the interfaces of the CAN buses, in the order of the buses.
    pub fn can(&self) -> impl Iterator<Item = &SocketCan> {
        self.can.links()
    }

    /// Returns the CAN buses alone.
    pub fn can_mut(&mut self) -> &mut SocketCans {
        &mut self.can
    }

    /// Returns the interface of the segment.
    pub fn segment(&self) -> Option<&PacketSocket> {
        self.segment.as_ref()
    }
}

impl CanLink for Interfaces {
    fn now(&self) -> Time {
        monotonic()
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.can.receive()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.can.send(frame)
    }

    fn wait(&mut self, until: Time) -> bool {
        let Some(segment) = &self.segment else { return self.can.wait(until) };
        if self.can.has_pending() {
            return true;
        }
        let mut places = std::array::from_fn::<_, { MOST_PORTS + 1 }, _>(|_| PollFd::new(segment, PollFlags::IN));
        let mut used = 1;
        for (place, port) in places.iter_mut().skip(1).zip(self.can.ports()) {
            *place = PollFd::from_borrowed_fd(port, PollFlags::IN);
            used += 1;
        }
        wait_for_any(places.get_mut(..used).unwrap_or_default(), until)
    }
}

impl Wires for Interfaces {
    fn source(&self) -> [u8; 6] {
        self.segment.as_ref().map_or(yieldwall_fieldbus::ethercat::frame::SOURCE, EthernetLink::source)
    }

    fn receive_ethernet(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        self.segment.as_mut()?.receive(buffer)
    }

    fn send_ethernet(&mut self, bytes: &[u8]) -> Result<(), SendError> {
        self.segment.as_mut().map_or(Err(SendError::Gone), |segment| segment.send(bytes))
    }
}
