//! Queue of the frames that devices on CAN send.

use std::collections::VecDeque;

use crate::far_end::{DEVICES, Wire};
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::time::Time;

/// Number of frames that wait for the interface before a device has to keep a frame that can wait.
const ROOM: usize = 8;

/// Frames in their order.
#[derive(Debug)]
pub(super) struct Queue {
    frames: VecDeque<Frame>,
    buses: [BusId; DEVICES],
}

impl Queue {
    /// Creates an empty queue; the buses are those of left drive, right drive and sensor.
    pub(super) fn new(buses: [BusId; DEVICES]) -> Self {
        Self { frames: VecDeque::new(), buses }
    }

    /// Passes frames on up to the first that is not taken, and returns their number.
    pub(super) fn drain(&mut self, send: &mut impl FnMut(&Frame) -> bool) -> u64 {
        let mut taken = 0;
        while self.frames.front().is_some_and(&mut *send) {
            self.frames.pop_front();
            taken += 1;
        }
        taken
    }
}

impl Wire for Queue {
    fn submit(&mut self, device: usize, _now: Time, frame: Frame) {
        self.frames.push_back(frame.on_bus(self.buses.get(device).copied().unwrap_or_default()));
    }

    fn offer(&mut self, device: usize, now: Time, frame: Frame) -> bool {
        let has_room = self.frames.len() < ROOM;
        if has_room {
            self.submit(device, now, frame);
        }
        has_room
    }
}
