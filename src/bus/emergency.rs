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
    /// Whether the device has said since that no error is left: code 0000h with an error register of 0.
    ///
    /// # Source
    /// CiA 301, emergency error codes: 0000h is "error reset or no error". The register has the errors that are left.
    pub is_withdrawn: bool,
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
    fn note(&mut self, told: EmergencyReport) {
        if let Some(place) = self.ring.get_mut(self.next) {
            *place = Some(told);
        }
        self.next = (self.next + 1) % EMERGENCIES;
    }

    /// Takes a message of a device: one that says that no error is left withdraws all that it told before. One of fewer errors does not say
    /// which one has gone. Whether it tells of an error.
    ///
    /// Real-time: yes.
    pub(super) fn hear(&mut self, told: EmergencyReport) -> bool {
        if !told.code.is_reset() {
            self.note(told);
            return true;
        }
        if told.register.0 == 0 {
            let of_device = self.ring.iter_mut().flatten().filter(|known| known.device == told.device);
            of_device.for_each(|known| known.is_withdrawn = true);
        }
        false
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
