//! A cable with the simulated devices at its far end, in one thread and on a clock of its own.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use yieldwall::canopen::{BusId, Frame};
use yieldwall::link::{Arrival, CanLink, Received, SendError, Wires};
use yieldwall::rig::DeviceServer;
use yieldwall::run::{Metronome, Permit, Place, Runner};
use yieldwall::time::Time;

/// What lets a rig on a cable in memory be enabled, until it is booted anew.
pub fn permit<P: Place>(rig: &Runner<P>) -> Permit {
    Permit::without_proof(rig, "the devices are simulated")
}

/// What becomes of a frame on the way; the flag says whether the master sent it.
pub type Passage = Box<dyn FnMut(Time, bool, &Frame) -> bool>;

/// What somebody else sends behind a frame of the master, if anything.
pub type Stranger = Box<dyn FnMut(&Frame) -> Option<Frame>>;

struct Inner {
    now: Time,
    server: DeviceServer,
    inbox: VecDeque<Arrival>,
    passes: Option<Passage>,
    stranger: Option<Stranger>,
    /// Which frames of the devices take longer, by how much, and those on their way.
    slow: Option<(Vec<u16>, Duration)>,
    on_the_way: VecDeque<Arrival>,
    late: Duration,
    is_down: bool,
    /// Frames of the master that wait in its interface, while it is stalled.
    stalled: Option<Vec<Frame>>,
}

/// Both ends of the cable and the clock. Clones are the same cable.
#[derive(Clone)]
pub struct Cable(Rc<RefCell<Inner>>);

impl Cable {
    /// A cable to devices that are switched on.
    ///
    /// # Panics
    /// Never: switching on does not fail.
    pub fn new(server: DeviceServer) -> Self {
        let mut inner = Inner {
            now: Time::from_micros(1_000_000),
            server,
            inbox: VecDeque::new(),
            passes: None,
            stranger: None,
            slow: None,
            on_the_way: VecDeque::new(),
            late: Duration::ZERO,
            is_down: false,
            stalled: None,
        };
        inner.serve(|server, now, out| {
            server.switch_on(now, out);
            true
        });
        Self(Rc::new(RefCell::new(inner)))
    }

    /// Has `passes` decide for every frame whether it arrives.
    pub fn set_passage(&self, passes: impl FnMut(Time, bool, &Frame) -> bool + 'static) {
        self.0.borrow_mut().passes = Some(Box::new(passes));
    }

    /// Has somebody else send what `sends` says behind each frame of the master.
    pub fn set_stranger(&self, sends: impl FnMut(&Frame) -> Option<Frame> + 'static) {
        self.0.borrow_mut().stranger = Some(Box::new(sends));
    }

    /// Has frames of the devices with these identifiers take so much longer from now on.
    pub fn set_slow(&self, ids: &[u16], by: Duration) {
        self.0.borrow_mut().slow = Some((ids.to_vec(), by));
    }

    /// Has the master wake up so much too late from now on.
    pub fn set_late(&self, late: Duration) {
        self.0.borrow_mut().late = late;
    }

    /// Takes the master's interface down, or up again.
    pub fn set_down(&self, is_down: bool) {
        let mut inner = self.0.borrow_mut();
        inner.is_down = is_down;
        if is_down {
            let time = inner.now;
            inner.inbox.push_back(Arrival { time, bus: BusId::FIRST, what: Received::Down });
        }
    }

    /// Has the master's frames wait in its interface, or lets them go; how many went.
    pub fn set_stalled(&self, is_stalled: bool) -> usize {
        let mut inner = self.0.borrow_mut();
        let waiting = if is_stalled { inner.stalled.replace(Vec::new()) } else { inner.stalled.take() };
        let waiting = waiting.unwrap_or_default();
        waiting.iter().for_each(|frame| inner.transmit(frame));
        waiting.len()
    }

    /// Lets the time of the wall pass while the master's process is stopped.
    pub fn pass(&self, time: Duration) {
        let mut inner = self.0.borrow_mut();
        let until = inner.now + time;
        inner.run_until(until);
    }

    /// Changes the devices.
    pub fn change(&self, change: impl FnOnce(&mut DeviceServer)) {
        change(&mut self.0.borrow_mut().server);
    }

    /// Looks at the devices.
    pub fn look<R>(&self, at: impl FnOnce(&DeviceServer) -> R) -> R {
        at(&self.0.borrow().server)
    }
}

impl Inner {
    fn serve(&mut self, act: impl FnOnce(&mut DeviceServer, Time, &mut Vec<Frame>) -> bool) {
        let mut out = Vec::new();
        assert!(act(&mut self.server, self.now, &mut out), "the simulated arm cannot go on");
        for frame in out {
            if !self.is_down && self.passes(false, &frame) {
                let what = Received::Frame(frame);
                match &self.slow {
                    Some((ids, by)) if ids.contains(&frame.id()) => {
                        self.on_the_way.push_back(Arrival { time: self.now + *by, bus: frame.bus(), what });
                    }
                    _ => self.inbox.push_back(Arrival { time: self.now, bus: frame.bus(), what }),
                }
            }
        }
    }

    fn transmit(&mut self, frame: &Frame) {
        let time = self.now;
        self.inbox.push_back(Arrival { time, bus: frame.bus(), what: Received::Echo(*frame) });
        if self.passes(true, frame) {
            self.serve(|server, now, out| server.on_frame(now, frame, out).is_ok());
        }
        if let Some(foreign) = self.stranger.as_mut().and_then(|sends| sends(frame)) {
            self.inbox.push_back(Arrival { time, bus: foreign.bus(), what: Received::Frame(foreign) });
            self.serve(|server, now, out| server.on_frame(now, &foreign, out).is_ok());
        }
    }

    fn passes(&mut self, is_master: bool, frame: &Frame) -> bool {
        let now = self.now;
        self.passes.as_mut().is_none_or(|passes| passes(now, is_master, frame))
    }

    fn step(&mut self, until: Time) {
        let next = self.on_the_way.front().map_or(Time::NEVER, |arrival| arrival.time);
        self.now = self.server.next_deadline().min(next).min(until).max(self.now);
        while self.on_the_way.front().is_some_and(|arrival| arrival.time <= self.now) {
            self.inbox.extend(self.on_the_way.pop_front());
        }
        self.serve(|server, now, out| server.poll(now, out).is_ok());
    }

    fn run_until(&mut self, until: Time) {
        while self.now < until {
            self.step(until);
        }
    }
}

impl CanLink for Cable {
    fn now(&self) -> Time {
        self.0.borrow().now
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.0.borrow_mut().inbox.pop_front()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let mut inner = self.0.borrow_mut();
        if inner.is_down {
            return Err(SendError::Down);
        }
        match &mut inner.stalled {
            Some(waiting) => waiting.push(*frame),
            None => inner.transmit(frame),
        }
        Ok(())
    }

    fn wait(&mut self, until: Time) -> bool {
        let mut inner = self.0.borrow_mut();
        if inner.inbox.is_empty() && inner.now < until {
            inner.step(until);
        }
        !inner.inbox.is_empty()
    }
}

impl Wires for Cable {}

impl Metronome for Cable {
    fn sleep_until(&mut self, moment: Time) {
        let mut inner = self.0.borrow_mut();
        let until = moment + inner.late;
        inner.run_until(until);
    }

    fn suspended(&self) -> Duration {
        Duration::ZERO
    }
}
