//! Frames that wait beside the buses.

use yieldwall_fieldbus::canopen::Frame;
use yieldwall_fieldbus::time::Time;

/// Frames that may wait; more are lost.
const FRAMES: usize = 64;

/// Frames that arrive later than they came, or come from nowhere.
#[derive(Debug, Default)]
pub(super) struct Held(Vec<Waiting>);

#[derive(Clone, Copy, Debug)]
struct Waiting {
    time: Time,
    from: usize,
    frame: Frame,
}

impl Held {
    /// Makes a frame arrive at a moment as if it came from a port.
    pub(super) fn hold(&mut self, time: Time, from: usize, frame: Frame) {
        if self.0.len() < FRAMES {
            self.0.push(Waiting { time, from, frame });
        }
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns the time of the next arrival.
    pub(super) fn next(&self) -> Time {
        self.0.iter().map(|waiting| waiting.time).min().unwrap_or(Time::NEVER)
    }

    /// Returns the next frame that has arrived by `now`, with its port; of frames at one moment, the one that was held first.
    pub(super) fn take(&mut self, now: Time) -> Option<(usize, Frame)> {
        let due = self.0.iter().enumerate().filter(|(_, waiting)| waiting.time <= now);
        let (at, _) = due.min_by_key(|(at, waiting)| (waiting.time, *at))?;
        let waiting = self.0.remove(at);
        Some((waiting.from, waiting.frame))
    }
}
