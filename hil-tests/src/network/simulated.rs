//! The bus in virtual time.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use yieldwall::canopen::{BusId, Frame, Outbox};
use yieldwall::link::{Arrival, CanLink, Received, SendError};
use yieldwall::sim::can::{BitTiming, QueueOrder, VirtualBus};
use yieldwall::time::Time;

use super::{Network, Participant};

/// Devices and links together.
const PORTS: usize = 8;

enum Port {
    Free,
    Device(Box<dyn Participant>),
    Link(VecDeque<Arrival>),
}

struct World {
    bus: VirtualBus,
    ports: Vec<Port>,
    now: Time,
}

/// A bus of 1 Mbit/s in virtual time, which passes while a link waits.
pub struct Virtual(Rc<RefCell<World>>);

/// A participant of a [`Virtual`] bus.
pub struct VirtualLink {
    world: Rc<RefCell<World>>,
    port: usize,
}

impl Virtual {
    /// A bus without devices at time 0.
    #[expect(clippy::new_without_default, reason = "a bus is a thing, not a value")]
    pub fn new() -> Self {
        let timing = BitTiming::Arbitrated { bit_rate: 1_000_000 };
        let bus = VirtualBus::new(timing, &[QueueOrder::Fifo; PORTS]).expect("a bit rate of classic CAN");
        let ports = (0..PORTS).map(|_| Port::Free).collect();
        Self(Rc::new(RefCell::new(World { bus, ports, now: Time(0) })))
    }
}

impl Network for Virtual {
    type Link = VirtualLink;

    fn attach(&mut self, mut device: impl Participant + 'static) {
        let mut world = self.0.borrow_mut();
        let (port, now) = (world.free(), world.now);
        device.switch_on(now, &mut world.bus.outbox(port, now));
        world.ports[port] = Port::Device(Box::new(device));
    }

    fn link(&mut self) -> VirtualLink {
        let mut world = self.0.borrow_mut();
        let port = world.free();
        world.ports[port] = Port::Link(VecDeque::new());
        drop(world);
        VirtualLink { world: self.0.clone(), port }
    }
}

impl World {
    fn free(&self) -> usize {
        self.ports.iter().position(|port| matches!(port, Port::Free)).expect("a free port")
    }

    fn has_arrivals(&self, port: usize) -> bool {
        matches!(&self.ports[port], Port::Link(arrivals) if !arrivals.is_empty())
    }

    /// Lets the next thing happen that is due up to `until`; whether there was one.
    fn step(&mut self, until: Time) -> bool {
        let deadlines = self.ports.iter().map(|port| match port {
            Port::Device(device) => device.next_deadline(),
            Port::Free | Port::Link(_) => Time::NEVER,
        });
        let next = deadlines.fold(self.bus.next_event(), Time::min);
        if next > until || next == Time::NEVER {
            self.now = self.now.max(if until == Time::NEVER { self.now } else { until });
            return false;
        }
        self.now = self.now.max(next);
        let now = self.now;
        let delivery = self.bus.advance(now);
        for port in 0..self.ports.len() {
            match &mut self.ports[port] {
                Port::Device(device) => {
                    let mut out = self.bus.outbox(port, now);
                    if let Some(delivery) = delivery.filter(|delivery| delivery.from != port) {
                        device.on_frame(now, &delivery.frame, &mut out);
                    }
                    if device.next_deadline() <= now {
                        device.poll(now, &mut out);
                    }
                }
                Port::Link(arrivals) => arrivals.extend(delivery.map(|delivery| {
                    let is_own = delivery.from == port;
                    let what = if is_own { Received::Echo(delivery.frame) } else { Received::Frame(delivery.frame) };
                    Arrival { time: delivery.time, bus: BusId::FIRST, what }
                })),
                Port::Free => {}
            }
        }
        assert_eq!(self.bus.counters().overflowed, 0, "a queue is full");
        true
    }
}

impl CanLink for VirtualLink {
    fn now(&self) -> Time {
        self.world.borrow().now
    }

    fn receive(&mut self) -> Option<Arrival> {
        match &mut self.world.borrow_mut().ports[self.port] {
            Port::Link(arrivals) => arrivals.pop_front(),
            Port::Free | Port::Device(_) => None,
        }
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let mut world = self.world.borrow_mut();
        let now = world.now;
        if world.bus.outbox(self.port, now).offer(*frame) { Ok(()) } else { Err(SendError::Full) }
    }

    fn wait(&mut self, until: Time) -> bool {
        let mut world = self.world.borrow_mut();
        while !world.has_arrivals(self.port) && world.step(until) {}
        world.has_arrivals(self.port)
    }
}
