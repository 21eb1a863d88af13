//! Outputs that are sent once more shortly before SYNC0.
//!
//! ```text
//! grid        compute_at                         repeat  SYNC0  next grid
//! |  inputs   |  outputs, service                |       |      |
//!             |<- a foreign frame would act ---->|<----->|
//! ```
//! A device acts at SYNC0 on the last outputs that came before. The repeat makes those of this master the last ones again; a foreign frame acts only
//! between the repeat and SYNC0.

use std::time::Duration;

use super::budget::Budget;
use super::setup::SegmentSetup;
use crate::axis::DriveOrders;

/// Share of a period that the repeat comes earlier than all known delays ask for: the grid moves by as much in a cycle.
const SPARE: u32 = 100;
/// Share of the greatest lateness that is forgotten in a cycle.
const FORGOTTEN: u32 = 1024;

/// The outputs of a cycle, and how long before SYNC0 they are sent once more.
#[derive(Clone, Debug)]
pub(super) struct Repeat {
    orders: Option<[DriveOrders; 2]>,
    sync0_phase: Duration,
    /// Time from the first bit of the frame to its last one at the last device.
    on_the_wire: Duration,
    spare: Duration,
    /// Greatest lateness of this computer, less what was forgotten since.
    late: Duration,
    /// Time that the frames of the control step leave before SYNC0.
    room: Duration,
}

impl Repeat {
    pub(super) fn new(setup: &SegmentSetup) -> Self {
        let budget = Budget::new(setup);
        let (on_the_wire, room) = (budget.repeat_delay(), budget.room());
        let (sync0_phase, spare) = (setup.sync0_phase, spare(setup.period));
        Repeat { orders: None, sync0_phase, on_the_wire, spare, late: Duration::ZERO, room }
    }

    /// Notes how late the computer was in this cycle.
    ///
    /// Real-time: yes.
    pub(super) fn note_late(&mut self, late: Duration) {
        self.late = late.max(self.late - self.late / FORGOTTEN);
    }

    /// Notes the outputs of a cycle.
    pub(super) fn take(&mut self, orders: [DriveOrders; 2]) {
        self.orders = Some(orders);
    }

    /// The outputs, which are not repeated any more.
    pub(super) fn forget(&mut self) -> Option<[DriveOrders; 2]> {
        self.orders.take()
    }

    /// Whether outputs wait to be repeated.
    pub(super) fn is_due(&self) -> bool {
        self.orders.is_some()
    }

    /// Time from the repeat to the next grid point, for devices that copy their outputs within `copying`. `None` where the outputs leave so late
    /// that a repeat would gain nothing.
    pub(super) fn before(&self, copying: Duration) -> Option<Duration> {
        let lead = copying.saturating_add(self.on_the_wire + self.spare + self.late);
        (lead <= self.room).then(|| self.sync0_phase + lead)
    }
}

/// Time that the repeat comes earlier than the known delays ask for.
pub(super) fn spare(period: Duration) -> Duration {
    period / SPARE
}
