//! Behaviour of an EtherCAT device besides its objects.

use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_fieldbus::objects::{ObjectDictionary, ServedDevice};
use yieldwall_fieldbus::time::Time;

/// The device that a [`Controller`](super::Controller) speaks for. All methods have defaults that do nothing.
///
/// In synchronous operation [`ServedDevice::outputs_applied`] and [`ServedDevice::sample`] are called at SYNC0, otherwise when outputs
/// come. There is one process data object of outputs, number 1, that holds all of them.
pub trait EthercatApplication: ServedDevice {
    /// The device enters OP, or leaves it for whatever reason.
    fn set_operational(&mut self, _now: Time, _is_operational: bool) {}

    /// Does what is due.
    fn poll(&mut self, _now: Time) {}

    /// When to poll next.
    fn next_deadline(&self) -> Time {
        Time::NEVER
    }

    /// Brings all objects that inputs carry up to date.
    fn refresh(&mut self) {}

    /// Time from SYNC0 to SYNC1, ns, of a device that works with both alone.
    fn sync1_ns(&self) -> Option<u32> {
        None
    }

    /// An emergency that is to be sent.
    fn take_emergency(&mut self) -> Option<CoeEmergency> {
        None
    }
}

/// A device that does nothing but communicate.
impl EthercatApplication for ObjectDictionary {}
