//! The virtual CAN bus.

mod wire;

pub use wire::{INTERFRAME_BITS, frame_bits};

use std::collections::VecDeque;
use std::time::Duration;

use yieldwall_fieldbus::canopen::{Frame, Outbox};
use yieldwall_fieldbus::time::Time;

/// Frames that one port can have waiting. More are lost and counted, as with the transmit queue of a real interface.
pub const QUEUE_FRAMES: usize = 64;
const NS_PER_S: u64 = 1_000_000_000;

/// Error of [`VirtualBus::new`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CanError {
    /// A bit rate that classic CAN does not have.
    #[error("bit rate {bit_rate} bit/s is not between 1 and 1000000")]
    BitRate {
        /// The bit rate in bit/s.
        bit_rate: u32,
    },
}

/// Whether bits cost time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BitTiming {
    /// Frames last as long as their bits, and wait for each other by priority.
    Arbitrated {
        /// Bit rate in bit/s, 1 to 1 000 000.
        bit_rate: u32,
    },
    /// Frames arrive at the moment they are sent, those of one moment by priority.
    Ideal,
}

/// Choice of the waiting frame that a port offers for arbitration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueueOrder {
    /// The oldest, like a network interface behind a FIFO queueing discipline: a frame of low priority holds up those
    /// behind it.
    Fifo,
    /// The one with the lowest identifier, like a controller with a mailbox per message.
    Priority,
}

/// A frame that has been on the wire: every port but `from` has received it, and `from` may take it as its echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// End of the frame, when receivers have it and the sender knows that it was acknowledged.
    pub time: Time,
    /// The port that sent it.
    pub from: usize,
    /// Frame that receivers got.
    pub frame: Frame,
}

/// May change or lose frames between sender and receivers, for fault injection.
pub trait Tamper {
    /// Returns the frame that receivers get instead of `frame`, or `None` for nothing (and no echo). The time on the bus stays
    /// that of the sent frame.
    fn pass(&mut self, time: Time, from: usize, frame: Frame) -> Option<Frame>;
}

impl<F: FnMut(Time, usize, Frame) -> Option<Frame>> Tamper for F {
    fn pass(&mut self, time: Time, from: usize, frame: Frame) -> Option<Frame> {
        self(time, from, frame)
    }
}

/// Counters of the bus since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// Frames that were sent.
    pub frames: u64,
    /// Bits that they took, stuff bits and interframe space included.
    pub bits: u64,
    /// Frames lost because the queue of their port was full.
    pub overflowed: u64,
    /// Frames that the tamper hook lost.
    pub dropped: u64,
    /// Frames that the tamper hook changed.
    pub altered: u64,
    /// Arbitrations in which two ports offered the same identifier; on a real bus that is an error frame unless the
    /// payloads are equal. Here the lower port number goes first.
    pub identifier_clashes: u64,
    /// Most frames that ever waited in one port.
    pub queue_high_water: usize,
}

impl BusCounters {
    /// Share of the time `elapsed` that the bits sent since `earlier` took at `bit_rate` bit/s.
    pub fn load_since(&self, earlier: &BusCounters, elapsed: Duration, bit_rate: u32) -> f64 {
        (self.bits - earlier.bits) as f64 / (f64::from(bit_rate) * elapsed.as_secs_f64())
    }
}

impl<'a> std::iter::Sum<&'a BusCounters> for BusCounters {
    /// Sums the counters of several buses; the longest queue is the longest of all.
    fn sum<I: Iterator<Item = &'a BusCounters>>(counters: I) -> Self {
        counters.fold(BusCounters::default(), |sum, one| BusCounters {
            frames: sum.frames + one.frames,
            bits: sum.bits + one.bits,
            overflowed: sum.overflowed + one.overflowed,
            dropped: sum.dropped + one.dropped,
            altered: sum.altered + one.altered,
            identifier_clashes: sum.identifier_clashes + one.identifier_clashes,
            queue_high_water: sum.queue_high_water.max(one.queue_high_water),
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Queued {
    ready: Time,
    frame: Frame,
    bits: u32,
}

#[derive(Debug)]
struct Port {
    order: QueueOrder,
    queue: VecDeque<Queued>,
    /// Whether nothing leaves it.
    is_held: bool,
}

impl Port {
    /// Position of the frame that this port offers at `start`.
    #[inline]
    fn offer(&self, start: Time) -> Option<(usize, &Queued)> {
        let first = self.queue.front().filter(|_| !self.is_held)?;
        if self.queue.len() == 1 {
            return (first.ready <= start).then_some((0, first));
        }
        self.offer_of_several(start)
    }

    fn offer_of_several(&self, start: Time) -> Option<(usize, &Queued)> {
        let mut waiting = self.queue.iter().enumerate().take_while(|(_, queued)| queued.ready <= start);
        match self.order {
            QueueOrder::Fifo => waiting.next(),
            QueueOrder::Priority => waiting.min_by_key(|(_, queued)| queued.frame.id()),
        }
    }
}

/// The frame that is sent next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Next {
    port: usize,
    position: usize,
    id: u16,
    bits: u32,
    start: Time,
    /// When receivers have it.
    end: Time,
}

/// A CAN bus in virtual time, with the timing and arbitration of classic CAN.
///
/// Whenever the bus is idle, the ports' offered frames compete, and the bus sends the lowest identifier. A frame occupies the bus
/// for its exact number of bits ([`frame_bits`]). It is delivered when its last bit before the interframe space has passed. There
/// are no error frames, no clock tolerance and no propagation delay.
///
/// Virtual time must not run backwards: call [`VirtualBus::advance`] up to `now` until it gives nothing before
/// submitting frames of a later moment. A frame that is submitted at a delivery takes part in the arbitration that
/// follows it.
pub struct VirtualBus {
    timing: BitTiming,
    /// Duration of a bit in ns if it is a whole number; otherwise 0.
    bit_ns: u64,
    ports: Vec<Port>,
    idle_from: Time,
    waiting: usize,
    /// Present result of the arbitration, kept up to date because it is read far more often than it changes.
    next: Option<Next>,
    counters: BusCounters,
    tamper: Option<Box<dyn Tamper + Send>>,
    witness: Option<Witness>,
}

/// One frame's way over the bus, as nobody on it can see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passage {
    /// End of the frame.
    pub time: Time,
    /// The port that sent it.
    pub from: usize,
    /// Frame that was sent.
    pub sent: Frame,
    /// Frame that receivers get; `None` if it was lost on the way.
    pub received: Option<Frame>,
}

/// Gets the passage of every frame.
pub type Witness = Box<dyn FnMut(&Passage) + Send>;

impl std::fmt::Debug for VirtualBus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("VirtualBus")
            .field("timing", &self.timing)
            .field("ports", &self.ports)
            .field("idle_from", &self.idle_from)
            .field("counters", &self.counters)
            .finish_non_exhaustive()
    }
}

impl VirtualBus {
    /// An idle bus at time 0 with one port for each entry of `ports`, numbered from 0.
    ///
    /// # Errors
    /// If the bit rate is 0 or above 1 Mbit/s.
    pub fn new(timing: BitTiming, ports: &[QueueOrder]) -> Result<Self, CanError> {
        if let BitTiming::Arbitrated { bit_rate } = timing
            && !(1..=1_000_000).contains(&bit_rate)
        {
            return Err(CanError::BitRate { bit_rate });
        }
        let ports = ports
            .iter()
            .map(|&order| Port { order, queue: VecDeque::with_capacity(QUEUE_FRAMES), is_held: false })
            .collect();
        let bit_ns = match timing {
            BitTiming::Arbitrated { bit_rate } if NS_PER_S.is_multiple_of(bit_rate.into()) => {
                NS_PER_S / u64::from(bit_rate)
            }
            _ => 0,
        };
        Ok(VirtualBus {
            timing,
            bit_ns,
            ports,
            idle_from: Time(0),
            waiting: 0,
            next: None,
            counters: BusCounters::default(),
            tamper: None,
            witness: None,
        })
    }

    /// Sends every frame through `tamper`; replaces an earlier one.
    pub fn set_tamper(&mut self, tamper: impl Tamper + Send + 'static) {
        self.tamper = Some(Box::new(tamper));
    }

    /// Reports the passage of every frame to `witness` from now on.
    pub fn set_witness(&mut self, witness: Witness) {
        self.witness = Some(witness);
    }

    /// Whether `port` has room for one more frame. An unknown port has none.
    pub fn has_room(&self, port: usize) -> bool {
        self.ports.get(port).is_some_and(|port| port.queue.len() < QUEUE_FRAMES)
    }

    /// Queues `frame` in `port` at the moment `now`; whether there was room. An unknown port has none.
    pub fn submit(&mut self, port: usize, now: Time, frame: Frame) -> bool {
        let Some(sender) = self.ports.get_mut(port).filter(|port| port.queue.len() < QUEUE_FRAMES) else {
            self.counters.overflowed += 1;
            return false;
        };
        let bits = frame_bits(&frame);
        let position = sender.queue.len();
        sender.queue.push_back(Queued { ready: now, frame, bits });
        self.counters.queue_high_water = self.counters.queue_high_water.max(sender.queue.len());
        self.waiting += 1;
        if sender.is_held {
            return true;
        }
        let is_offered = position == 0 || sender.order == QueueOrder::Priority;
        let start = match self.next {
            // It comes too late for this arbitration, waits behind others, or loses.
            Some(next) if now > next.start || !is_offered || (next.id, next.port) <= (frame.id(), port) => return true,
            Some(next) => next.start,
            None => self.idle_from.max(now),
        };
        self.next = Some(self.sending(port, position, start, &Queued { ready: now, frame, bits }));
        true
    }

    /// The port as a place where an engine puts its frames at `now`.
    pub fn outbox(&mut self, port: usize, now: Time) -> PortOutbox<'_> {
        PortOutbox { bus: self, port, now }
    }

    /// When the next frame will be delivered if nothing else is submitted; [`Time::NEVER`] if nothing waits.
    pub fn next_event(&self) -> Time {
        self.next.map_or(Time::NEVER, |next| next.end)
    }

    /// The next frame that is delivered not later than `until`. Call it again until it gives nothing; the order of
    /// deliveries is that on the wire.
    pub fn advance(&mut self, until: Time) -> Option<Delivery> {
        while let Some(next) = self.next.filter(|next| next.end <= until) {
            let queue = &mut self.ports.get_mut(next.port)?.queue;
            let sent = if next.position == 0 { queue.pop_front() } else { queue.remove(next.position) }?.frame;
            self.waiting -= 1;
            self.counters.frames += 1;
            self.counters.bits += u64::from(next.bits);
            self.idle_from = self.after(next.start, next.bits);
            self.count_clashes(&next);
            self.next = self.arbitrate();
            let passed = match &mut self.tamper {
                Some(tamper) => tamper.pass(next.end, next.port, sent),
                None => Some(sent),
            };
            if let Some(witness) = &mut self.witness {
                witness(&Passage { time: next.end, from: next.port, sent, received: passed });
            }
            match passed {
                Some(frame) => {
                    self.counters.altered += u64::from(frame != sent);
                    return Some(Delivery { time: next.end, from: next.port, frame });
                }
                None => self.counters.dropped += 1,
            }
        }
        None
    }

    /// Loses what waits in `port`, as taking an interface down does.
    pub fn clear(&mut self, port: usize) {
        if let Some(port) = self.ports.get_mut(port) {
            self.waiting -= port.queue.len();
            port.queue.clear();
            self.next = self.arbitrate();
        }
    }

    /// Holds the frames in `port`, as if nobody acknowledged them, or releases them from `now` on.
    pub fn hold(&mut self, port: usize, now: Time, is_held: bool) {
        if let Some(port) = self.ports.get_mut(port)
            && port.is_held != is_held
        {
            port.is_held = is_held;
            for queued in &mut port.queue {
                queued.ready = queued.ready.max(now);
            }
            self.next = self.arbitrate();
        }
    }

    /// Number of frames that wait in `port`, one that is on the wire included.
    pub fn queued(&self, port: usize) -> usize {
        self.ports.get(port).map_or(0, |port| port.queue.len())
    }

    /// Returns the counters so far.
    pub const fn counters(&self) -> &BusCounters {
        &self.counters
    }

    /// The moment when `bits` bits from `start` on are over, rounded down to a nanosecond.
    fn after(&self, start: Time, bits: u32) -> Time {
        let bits = u64::from(bits);
        let takes_ns = match self.timing {
            BitTiming::Ideal => 0,
            // Frames are many and divisions slow.
            BitTiming::Arbitrated { .. } if self.bit_ns > 0 => bits * self.bit_ns,
            BitTiming::Arbitrated { bit_rate } => bits * NS_PER_S / u64::from(bit_rate),
        };
        Time(start.0.saturating_add(takes_ns))
    }

    fn sending(&self, port: usize, position: usize, start: Time, queued: &Queued) -> Next {
        let Queued { frame, bits, .. } = queued;
        let end = self.after(start, bits - INTERFRAME_BITS);
        Next { port, position, id: frame.id(), bits: *bits, start, end }
    }

    /// Returns the next sender and its time: the winner of the frames that are ready when the bus is next free and wanted.
    fn arbitrate(&self) -> Option<Next> {
        if self.waiting == 0 {
            return None;
        }
        // Mostly frames have waited for the bus to become free.
        self.arbitrate_at(self.idle_from).or_else(|| {
            let free = self.ports.iter().filter(|port| !port.is_held);
            let first_ready = free.filter_map(|port| port.queue.front()).map(|queued| queued.ready).min()?;
            self.arbitrate_at(first_ready)
        })
    }

    /// Returns the sender among the frames that are ready at `start`.
    fn arbitrate_at(&self, start: Time) -> Option<Next> {
        let offers = self.ports.iter().enumerate().filter_map(|(port, queue)| Some((port, queue.offer(start)?)));
        // Of equal identifiers the first, so that the lower port number goes first.
        let (port, (position, queued)) = offers.min_by_key(|(_, (_, queued))| queued.frame.id())?;
        Some(self.sending(port, position, start, queued))
    }

    fn count_clashes(&mut self, sent: &Next) {
        if self.waiting == 0 {
            return;
        }
        let others = self.ports.iter().enumerate().filter(|(port, _)| *port != sent.port);
        let clashes =
            others.filter(|(_, port)| port.offer(sent.start).is_some_and(|(_, queued)| queued.frame.id() == sent.id));
        self.counters.identifier_clashes += clashes.count() as u64;
    }
}

/// One port at one moment, as an outgoing queue.
#[derive(Debug)]
pub struct PortOutbox<'a> {
    bus: &'a mut VirtualBus,
    port: usize,
    now: Time,
}

impl Outbox for PortOutbox<'_> {
    fn push(&mut self, frame: Frame) {
        self.bus.submit(self.port, self.now, frame);
    }

    fn offer(&mut self, frame: Frame) -> bool {
        self.bus.has_room(self.port) && self.bus.submit(self.port, self.now, frame)
    }
}

#[cfg(test)]
mod tests;
