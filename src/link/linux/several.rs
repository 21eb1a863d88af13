//! Several interfaces as one link.

use rustix::event::{PollFd, PollFlags};

use super::wall::monotonic;
use super::{SocketCan, wait_for_any};
use crate::canopen::{Frame, Time};
use crate::link::{Arrival, CanLink, Received, SendError};

/// Most interfaces of one link.
const MOST: usize = 4;

/// One interface for each bus of a rig, in the order of the buses' numbers: frames come with the number of their bus and go
/// where theirs says ([`Frame::bus`]).
#[derive(Debug)]
pub struct SocketCans {
    links: Vec<SocketCan>,
    latest: Time,
}

impl SocketCans {
    /// These interfaces; more than four are left out.
    pub fn new(mut links: Vec<SocketCan>) -> Self {
        links.truncate(MOST);
        Self { links, latest: Time(0) }
    }

    /// The interfaces, by number of the bus.
    pub fn links(&self) -> &[SocketCan] {
        &self.links
    }
}

impl CanLink for SocketCans {
    fn now(&self) -> Time {
        monotonic()
    }

    fn receive(&mut self) -> Option<Arrival> {
        let each = (0..).zip(&mut self.links);
        let (bus, arrival) = each.into_iter().find_map(|(bus, link)| Some((bus, link.receive()?)))?;
        // Of two interfaces the second may hold what is older.
        self.latest = self.latest.max(arrival.time);
        let what = match arrival.what {
            Received::Frame(frame) => Received::Frame(frame.on_bus(bus)),
            Received::Echo(frame) => Received::Echo(frame.on_bus(bus)),
            other => other,
        };
        Some(Arrival { time: self.latest, what })
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        // A bus without an interface is one that is gone.
        self.links.get_mut(usize::from(frame.bus())).map_or(Err(SendError::Gone), |link| link.send(frame))
    }

    fn wait(&mut self, until: Time) -> bool {
        let Some(first) = self.links.first() else { return false };
        if self.links.iter().any(SocketCan::has_pending) {
            return true;
        }
        let mut places = std::array::from_fn::<_, { 2 * MOST }, _>(|_| PollFd::new(first, PollFlags::IN));
        let mut used = 0;
        for (place, port) in places.iter_mut().zip(self.links.iter().flat_map(SocketCan::ports)) {
            *place = PollFd::new(port, PollFlags::IN);
            used += 1;
        }
        wait_for_any(places.get_mut(..used).unwrap_or_default(), until)
    }
}
