//! A link in this process: simulated devices in virtual time at its other end.

use std::collections::VecDeque;
use std::time::Duration;

use crate::{DeviceServer, RigError};
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{Frame, Outbox};
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{Arrival, CanLink, Received, SendError};
use yieldwall_run::Pace;

/// Time of a frame of eight bytes on a bus of 1 Mbit/s, rounded up.
const FRAME: Duration = Duration::from_micros(130);

/// A rig's simulated devices behind a link. Its time advances only during a wait, and by the time of each frame.
#[derive(Debug)]
pub struct VirtualLink {
    server: DeviceServer,
    now: Time,
    arrivals: VecDeque<Arrival>,
    /// Whether the simulated arm cannot go on: then nothing comes or goes any more.
    has_failed: bool,
}

/// Frames that the devices send, one after the other.
struct Wire<'a> {
    now: Time,
    arrivals: &'a mut VecDeque<Arrival>,
}

impl Outbox for Wire<'_> {
    fn push(&mut self, frame: Frame) {
        self.now = self.now + FRAME;
        self.arrivals.push_back(Arrival { time: self.now, bus: frame.bus(), what: Received::Frame(frame) });
    }
}

impl VirtualLink {
    /// Creates the devices of a rig, switched on, with the arm where the scene's hand starts.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together, and for a scene without an arm.
    pub fn new(rig: &config::Rig, scene: &config::Scene, seed: u64) -> Result<Self, RigError> {
        let server = DeviceServer::new(rig, scene, seed, Pace::Free)?;
        let mut link = Self { server, now: Time(0), arrivals: VecDeque::new(), has_failed: false };
        link.act(|server, now, wire| {
            server.switch_on(now, wire);
            Ok(())
        });
        Ok(link)
    }

    fn act(&mut self, act: impl FnOnce(&mut DeviceServer, Time, &mut Wire<'_>) -> Result<(), RigError>) {
        let mut wire = Wire { now: self.now, arrivals: &mut self.arrivals };
        let acted = act(&mut self.server, self.now, &mut wire);
        self.now = wire.now;
        self.has_failed |= acted.is_err();
    }
}

impl CanLink for VirtualLink {
    fn now(&self) -> Time {
        self.now
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.arrivals.pop_front()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if self.has_failed {
            return Err(SendError::Gone);
        }
        self.now = self.now + FRAME;
        self.act(|server, now, wire| server.on_frame(now, frame, wire));
        Ok(())
    }

    fn wait(&mut self, until: Time) -> bool {
        while self.arrivals.is_empty() && !self.has_failed && self.now < until {
            let next = self.server.next_deadline();
            if next > until {
                self.now = until;
                break;
            }
            self.now = self.now.max(next);
            self.act(|server, now, wire| server.poll(now, wire));
        }
        !self.arrivals.is_empty()
    }
}
