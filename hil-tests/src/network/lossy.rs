//! A link that loses frames.

use yieldwall::canopen::Frame;
use yieldwall::link::{Arrival, CanLink, Received, SendError};
use yieldwall::time::Time;

/// Loses those frames of others and of its own for which `is_lost` (sent by itself or not).
pub struct Lossy<L, F> {
    link: L,
    is_lost: F,
    /// Number of frames that it has lost.
    pub lost: usize,
}

impl<L, F: FnMut(bool, &Frame) -> bool> Lossy<L, F> {
    /// Stands between `link` and who uses it.
    pub fn new(link: L, is_lost: F) -> Self {
        Self { link, is_lost, lost: 0 }
    }

    fn loses(&mut self, is_own: bool, frame: &Frame) -> bool {
        let is_lost = (self.is_lost)(is_own, frame);
        self.lost += usize::from(is_lost);
        is_lost
    }
}

impl<L: CanLink, F: FnMut(bool, &Frame) -> bool> CanLink for Lossy<L, F> {
    fn now(&self) -> Time {
        self.link.now()
    }

    fn receive(&mut self) -> Option<Arrival> {
        loop {
            let arrival = self.link.receive()?;
            match arrival.what {
                Received::Frame(frame) if self.loses(false, &frame) => {}
                _ => return Some(arrival),
            }
        }
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if self.loses(true, frame) { Ok(()) } else { self.link.send(frame) }
    }

    fn wait(&mut self, until: Time) -> bool {
        self.link.wait(until)
    }
}
