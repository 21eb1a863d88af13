//! A wire in this process: the simulated devices of an EtherCAT segment in virtual time at its other end.

use std::collections::VecDeque;
use std::time::Duration;

use crate::{RigError, SegmentServer};
use yieldwall_config as config;
use yieldwall_fieldbus::ethercat::frame::SOURCE;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{EthernetArrival, EthernetLink, EthernetReceived, SendError};
use yieldwall_run::Pace;

/// Time of a frame on its way there and back: 100 bytes past three devices, rounded up.
const FRAME: Duration = Duration::from_micros(20);

/// A rig's simulated devices behind a link. Its time advances only during a wait, and by the time of each frame.
#[derive(Debug)]
pub struct VirtualSegment {
    server: SegmentServer,
    now: Time,
    arrivals: VecDeque<(Time, Vec<u8>)>,
    /// Whether the simulated arm cannot go on: then nothing comes or goes any more.
    has_failed: bool,
}

impl VirtualSegment {
    /// Creates the devices of a rig, switched on, with the arm where the scene's hand starts.
    ///
    /// # Errors
    /// If parts of the configuration do not fit together, and for a scene without an arm.
    pub fn new(rig: &config::Rig, scene: &config::Scene, seed: u64) -> Result<Self, RigError> {
        let server = SegmentServer::new(rig, scene, seed, Pace::Free, [true; 3], Time(0))?;
        Ok(Self { server, now: Time(0), arrivals: VecDeque::new(), has_failed: false })
    }

    /// Returns the devices, to inspect them or to inject faults.
    pub fn server_mut(&mut self) -> &mut SegmentServer {
        &mut self.server
    }

    fn act(&mut self, act: impl FnOnce(&mut SegmentServer, Time, &mut dyn FnMut(&[u8])) -> Result<(), RigError>) {
        let (now, arrivals) = (self.now, &mut self.arrivals);
        let acted = act(&mut self.server, now, &mut |bytes| arrivals.push_back((now, bytes.to_vec())));
        self.has_failed |= acted.is_err();
    }
}

impl EthernetLink for VirtualSegment {
    fn now(&self) -> Time {
        self.now
    }

    fn source(&self) -> [u8; 6] {
        SOURCE
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<EthernetArrival> {
        let (time, bytes) = self.arrivals.pop_front()?;
        let length = bytes.len();
        let what = match buffer.get_mut(..length) {
            Some(to) => {
                to.copy_from_slice(&bytes);
                EthernetReceived::Frame { length }
            }
            None => EthernetReceived::TooLong { length },
        };
        Some(EthernetArrival { time, what })
    }

    fn send(&mut self, frame: &[u8]) -> Result<(), SendError> {
        if self.has_failed {
            return Err(SendError::Gone);
        }
        self.now = self.now + FRAME;
        let mut bytes = frame.to_vec();
        self.act(|server, now, back| server.on_frame(now, &mut bytes, back));
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
            self.act(|server, now, back| server.poll(now, back));
        }
        !self.arrivals.is_empty()
    }
}
