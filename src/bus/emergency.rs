//! Emergency messages of devices, over any bus.

use yieldwall_fieldbus::canopen::{EmcyCode, ErrorRegister};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::Device;

/// Emergencies that are remembered.
const EMERGENCIES: usize = 8;

/// Content of an emergency message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmergencyReport {
    /// When the message came.
    pub time: Time,
    /// The device. Its address alone does not identify it: each bus has its own addresses.
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

/// Last emergencies: a ring, and the place of the next entry.
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

    /// Takes an emergency message of a device. A message without error withdraws all earlier ones of the device; a message with
    /// fewer errors does not say which error has gone. Returns whether the message reports an error.
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
