//! Node guarding on the side of a device: the older error control, in which a master asks by remote frame and devices watch being asked.
//!
//! # Source
//! CiA 301, node guarding protocol and objects 100Ch and 100Dh.

use std::time::Duration;

use super::{Frame, NmtState, NodeId, cob};
use crate::time::Time;

/// Answers with a toggle bit, and notices when nobody asks any more.
#[derive(Clone, Debug)]
pub(super) struct LifeGuard {
    toggle: bool,
    life_time: Duration,
    /// `NEVER` until the first request and after the loss.
    deadline: Time,
    is_lost: bool,
}

impl LifeGuard {
    pub(super) const fn new() -> Self {
        LifeGuard { toggle: false, life_time: Duration::ZERO, deadline: Time::NEVER, is_lost: false }
    }

    /// Starts anew with a guard time and a life time factor; either being zero switches the watch off.
    pub(super) fn configure(&mut self, guard_time: Duration, factor: u8) {
        *self = LifeGuard { life_time: guard_time * u32::from(factor), ..LifeGuard::new() };
    }

    pub(super) const fn deadline(&self) -> Time {
        self.deadline
    }

    /// Returns the answer to a request, and whether the master had been lost.
    pub(super) fn answer(&mut self, now: Time, node: NodeId, state: NmtState) -> (Frame, bool) {
        let frame = Frame::new(cob::heartbeat(node), &[canopen_rs::nmt::encode_node_guard(state, self.toggle)]);
        self.toggle = !self.toggle;
        if !self.life_time.is_zero() {
            self.deadline = now + self.life_time;
        }
        (frame, std::mem::take(&mut self.is_lost))
    }

    /// Whether the life time ran out, once each time.
    pub(super) fn is_late(&mut self, now: Time) -> bool {
        let is_late = now >= self.deadline;
        if is_late {
            (self.deadline, self.is_lost) = (Time::NEVER, true);
        }
        is_late
    }
}
