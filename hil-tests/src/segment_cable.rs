//! A cable with a simulated EtherCAT segment at its far end, in one thread and on a clock of its own.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use yieldwall::canopen::Frame;
use yieldwall::link::{Arrival, CanLink, EthernetArrival, EthernetReceived, SendError, Wires};
use yieldwall::rig::SegmentServer;
use yieldwall::run::Metronome;
use yieldwall::time::Time;

struct Inner {
    now: Time,
    server: SegmentServer,
    inbox: VecDeque<(Time, Vec<u8>)>,
    /// Whether the cable is out.
    is_out: bool,
}

/// Both ends of the cable and the clock. Clones are the same cable.
#[derive(Clone)]
pub struct SegmentCable(Rc<RefCell<Inner>>);

impl SegmentCable {
    /// A cable to a segment that was made at the same moment.
    pub fn new(server: SegmentServer, now: Time) -> Self {
        Self(Rc::new(RefCell::new(Inner { now, server, inbox: VecDeque::new(), is_out: false })))
    }

    /// Pulls the cable, or plugs it in again.
    pub fn set_out(&self, is_out: bool) {
        self.0.borrow_mut().is_out = is_out;
    }

    /// Looks at the segment, or breaks something on it.
    pub fn change<R>(&self, change: impl FnOnce(&mut SegmentServer) -> R) -> R {
        change(&mut self.0.borrow_mut().server)
    }
}

impl Inner {
    fn step(&mut self, until: Time) {
        self.now = self.server.next_deadline().min(until).max(self.now);
        let Self { server, inbox, now, .. } = self;
        server.poll(*now, |bytes| inbox.push_back((*now, bytes.to_vec()))).expect("the simulated arm can go on");
    }
}

impl CanLink for SegmentCable {
    fn now(&self) -> Time {
        self.0.borrow().now
    }

    fn receive(&mut self) -> Option<Arrival> {
        None
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        panic!("a frame of CAN for a segment: {frame:?}")
    }

    fn wait(&mut self, until: Time) -> bool {
        let mut inner = self.0.borrow_mut();
        if inner.inbox.is_empty() && inner.now < until {
            inner.step(until);
        }
        !inner.inbox.is_empty()
    }
}

impl Wires for SegmentCable {
    fn receive_ethernet(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        let (time, bytes) = self.0.borrow_mut().inbox.pop_front()?;
        buffer[..bytes.len()].copy_from_slice(&bytes);
        Some(EthernetArrival { time, what: EthernetReceived::Frame { length: bytes.len() } })
    }

    fn send_ethernet(&mut self, bytes: &[u8]) -> Result<(), SendError> {
        let inner = &mut *self.0.borrow_mut();
        if !inner.is_out {
            let (now, inbox) = (inner.now, &mut inner.inbox);
            let back = |back: &[u8]| inbox.push_back((now, back.to_vec()));
            inner.server.on_frame(now, &mut bytes.to_vec(), back).expect("the simulated arm can go on");
        }
        Ok(())
    }
}

impl Metronome for SegmentCable {
    fn sleep_until(&mut self, moment: Time) {
        let mut inner = self.0.borrow_mut();
        while inner.now < moment {
            inner.step(moment);
        }
    }

    fn suspended(&self) -> Duration {
        Duration::ZERO
    }
}
