//! What devices have told of themselves by emergency messages, over whatever bus.

use yieldwall_fieldbus::canopen::{EmcyCode, ErrorRegister};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::Device;

/// Emergencies that are remembered.
const EMERGENCIES: usize = 8;

/// What a device has told by an emergency message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmergencyReport {
    /// When the message came.
    pub time: Time,
    /// The device. Its address alone does not tell which: each bus has its own.
    pub device: Device,
    /// Error code.
    pub code: EmcyCode,
    /// Error register 1001h at that moment.
    pub register: ErrorRegister,
    /// Vendor specific bytes.
    pub vendor: [u8; 5],
}

/// What the devices told last: a ring, and where the next one goes.
#[derive(Clone, Debug, Default)]
pub(super) struct LastTold {
    ring: [Option<EmergencyReport>; EMERGENCIES],
    next: usize,
}

impl LastTold {
    /// Remembers a message in place of the oldest one.
    ///
    /// Real-time: yes.
    pub(super) fn note(&mut self, told: EmergencyReport) {
        if let Some(place) = self.ring.get_mut(self.next) {
            *place = Some(told);
        }
        self.next = (self.next + 1) % EMERGENCIES;
    }

    /// Forgets them all.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }

    /// The last eight, the oldest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = EmergencyReport> {
        let (newer, older) = self.ring.split_at(self.next);
        older.iter().chain(newer).copied().flatten()
    }
}
