//! Several interfaces as one link.
//!
//! Each interface keeps the order of its wire. Between interfaces the time stamps decide. The age of a sample on the second bus follows
//! from its own stamp, and no request on the first bus goes before process data of the second. The merge compares the frames at the head of
//! each queue, so that the work for one frame does not grow with the queues. The kernel may show a frame only after a later one of another
//! bus was handed out. Such a frame comes after it, with the time of that later frame.

use std::os::fd::{AsFd, BorrowedFd};

use rustix::event::{PollFd, PollFlags};

use super::SocketCan;
use crate::clock::{monotonic, wait_for_any};
use crate::{Arrival, CanLink, Received, SendError};
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::time::Time;

/// Most interfaces of one link.
const MOST: usize = 4;

/// Most sockets of one link.
pub(crate) const MOST_PORTS: usize = 2 * MOST;

/// One interface for each CAN bus of a rig, at the places of the buses: frames come with their bus and go
/// where theirs says ([`Frame::bus`]).
#[derive(Debug)]
pub struct SocketCans {
    links: Vec<Option<SocketCan>>,
    merge: Merge,
}

impl SocketCans {
    /// Combines these interfaces, with nothing in the place of a bus that is not CAN; more than four are left out.
    pub fn new(mut links: Vec<Option<SocketCan>>) -> Self {
        links.truncate(MOST);
        Self { links, merge: Merge::default() }
    }

    /// Returns the interfaces, in the order of the buses.
    pub fn links(&self) -> impl Iterator<Item = &SocketCan> {
        self.links.iter().flatten()
    }

    /// Whether something was taken from a socket and not handed out yet.
    pub(crate) fn has_pending(&self) -> bool {
        !self.merge.is_empty() || self.links().any(SocketCan::has_pending)
    }

    /// Returns the sockets, at most [`MOST_PORTS`].
    pub(crate) fn ports(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.links().flat_map(SocketCan::ports).map(AsFd::as_fd)
    }
}

/// Arrivals taken from the interfaces and not handed out yet: for each interface, the next of its process data and of its services.
#[derive(Debug, Default)]
struct Merge {
    heads: [[Option<Arrival>; MOST]; 2],
    latest: Time,
}

impl Merge {
    /// Returns the oldest arrival, process data before services; `take` gives the next one of a bus, of its process data or not.
    fn next(&mut self, mut take: impl FnMut(BusId, bool) -> Option<Arrival>) -> Option<Arrival> {
        for (heads, is_process) in self.heads.iter_mut().zip([true, false]) {
            for (bus, head) in BusId::all().zip(heads.iter_mut()) {
                if head.is_none() {
                    *head = take(bus, is_process).map(|arrival| of_bus(bus, arrival));
                }
            }
            // Of two at the same moment the one of the first bus.
            let oldest = heads.iter_mut().filter(|head| head.is_some());
            let oldest = oldest.min_by_key(|head| head.map_or(Time::NEVER, |arrival| arrival.time));
            if let Some(arrival) = oldest.and_then(Option::take) {
                self.latest = self.latest.max(arrival.time);
                return Some(Arrival { time: self.latest, ..arrival });
            }
        }
        None
    }

    fn is_empty(&self) -> bool {
        self.heads.iter().flatten().all(Option::is_none)
    }
}

fn of_bus(bus: BusId, arrival: Arrival) -> Arrival {
    let what = match arrival.what {
        Received::Frame(frame) => Received::Frame(frame.on_bus(bus)),
        Received::Echo(frame) => Received::Echo(frame.on_bus(bus)),
        other => other,
    };
    Arrival { bus, what, ..arrival }
}

impl CanLink for SocketCans {
    fn now(&self) -> Time {
        monotonic()
    }

    fn receive(&mut self) -> Option<Arrival> {
        let links = &mut self.links;
        self.merge.next(|bus, is_process| links.get_mut(bus.index())?.as_mut()?.take(is_process))
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        // A bus without an interface is one that is gone.
        let link = self.links.get_mut(frame.bus().index()).and_then(Option::as_mut);
        link.map_or(Err(SendError::Gone), |link| link.send(frame))
    }

    fn wait(&mut self, until: Time) -> bool {
        let Some(first) = self.links().next() else { return false };
        if self.has_pending() {
            return true;
        }
        let mut places = std::array::from_fn::<_, MOST_PORTS, _>(|_| PollFd::new(first, PollFlags::IN));
        let mut used = 0;
        for (place, port) in places.iter_mut().zip(self.ports()) {
            *place = PollFd::from_borrowed_fd(port, PollFlags::IN);
            used += 1;
        }
        wait_for_any(places.get_mut(..used).unwrap_or_default(), until)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use proptest::prelude::*;

    /// Process data and services of each bus, as (time in us, identifier).
    type Queues = [[VecDeque<(u64, u16)>; 2]; MOST];

    fn take(queues: &mut Queues, bus: BusId, is_process: bool) -> Option<Arrival> {
        let (us, id) = queues[bus.index()][usize::from(!is_process)].pop_front()?;
        let what = Received::Frame(Frame::new(id, &[]));
        Some(Arrival { time: Time::from_micros(us), bus: BusId::FIRST, what })
    }

    /// Returns all that comes out: time in us, bus and identifier.
    fn merged(mut queues: Queues) -> Vec<(u64, usize, u16)> {
        let mut merge = Merge::default();
        let all = std::iter::from_fn(|| merge.next(|bus, is_process| take(&mut queues, bus, is_process)));
        let all = all.map(|arrival| match arrival.what {
            Received::Frame(frame) if frame.bus() == arrival.bus => {
                (arrival.time.0 / 1000, arrival.bus.index(), frame.id())
            }
            other => panic!("{other:?} of bus {}", arrival.bus),
        });
        let all = all.collect();
        assert!(merge.is_empty());
        all
    }

    #[test]
    fn process_data_of_all_buses_come_in_the_order_of_time_and_then_services() {
        let mut queues = Queues::default();
        queues[0] =
            [VecDeque::from([(10, 0x181), (30, 0x182), (40, 0x183)]), VecDeque::from([(5, 0x701), (50, 0x581)])];
        queues[1] = [VecDeque::from([(20, 0x181), (30, 0x281)]), VecDeque::from([(45, 0x702)])];
        queues[3][0] = VecDeque::from([(35, 0x360)]);
        let process = [(10, 0, 0x181), (20, 1, 0x181), (30, 0, 0x182), (30, 1, 0x281), (35, 3, 0x360), (40, 0, 0x183)];
        // No arrival is before the one before it.
        let services = [(40, 0, 0x701), (45, 1, 0x702), (50, 0, 0x581)];
        assert_eq!(merged(queues), [&process[..], &services].concat());
    }

    #[test]
    fn what_no_frame_is_names_its_bus() {
        let mut merge = Merge::default();
        let mut down = Some(Arrival { time: Time(7), bus: BusId::FIRST, what: Received::Down });
        let arrival = merge.next(|bus, is_process| down.take_if(|_| bus == BusId::new(2) && is_process));
        assert_eq!(arrival, Some(Arrival { time: Time(7), bus: BusId::new(2), what: Received::Down }));
    }

    proptest! {
        #[test]
        fn nothing_is_lost_and_each_bus_keeps_its_order(times in prop::collection::vec((0..MOST, any::<bool>(), 0u64..50), 0..60)) {
            let mut queues = Queues::default();
            for (number, (bus, is_process, time)) in (0..).zip(&times) {
                queues[*bus][usize::from(!is_process)].push_back((*time, number));
            }
            for queue in queues.iter_mut().flatten() {
                let mut sorted: Vec<u64> = queue.iter().map(|(time, _)| *time).collect();
                sorted.sort_unstable();
                queue.iter_mut().zip(sorted).for_each(|(place, time)| place.0 = time);
            }
            let before = queues.clone();
            let after = merged(queues);
            prop_assert_eq!(after.len(), times.len());
            prop_assert!(after.is_sorted_by_key(|(time, ..)| *time));
            let is_process = |id: u16| times[usize::from(id)].1;
            prop_assert!(after.is_sorted_by_key(|(.., id)| !is_process(*id)));
            for (bus, [process, services]) in (0..).zip(&before) {
                let ids: Vec<u16> = process.iter().chain(services).map(|(_, id)| *id).collect();
                let found: Vec<u16> = after.iter().filter(|(_, of, _)| *of == bus).map(|(.., id)| *id).collect();
                prop_assert_eq!(found, ids);
            }
        }
    }
}
