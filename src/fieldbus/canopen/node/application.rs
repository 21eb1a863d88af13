//! Behaviour of a CANopen device beside its objects.

use std::time::Duration;

use super::super::NmtState;
use super::super::nmt::HeartbeatEvent;
use super::super::time::TimeOfDay;
use crate::objects::{ObjectDictionary, ServedDevice};
use crate::time::Time;

/// The device that a [`Node`](super::Node) speaks for. All methods have defaults that do nothing.
///
/// Synchronous RPDOs are applied at SYNC, before [`ServedDevice::sample`]; the others at once.
pub trait Application: ServedDevice {
    /// Handles a change of the NMT state.
    fn on_nmt(&mut self, _now: Time, _state: NmtState) {}

    /// Handles an event of a node watched by 1016h. When it was lost, emergency 8130h has been sent and the error
    /// behaviour 1029h:1 has been carried out.
    fn on_heartbeat_event(&mut self, _now: Time, _event: HeartbeatEvent) {}

    /// The master has not asked for the whole life time (100Ch times 100Dh), or asks again. When it was lost, emergency
    /// 8130h has been sent and the error behaviour 1029h:1 has been carried out.
    fn on_life_guarding(&mut self, _now: Time, _is_lost: bool) {}

    /// Handles a TIME message; only if 1012h makes the device a consumer.
    fn on_time(&mut self, _now: Time, _time: TimeOfDay) {}

    /// LSS activates a bit rate in bit/s: send nothing for `delay`, change, and send nothing for `delay` once more.
    fn on_bit_rate(&mut self, _now: Time, _bit_rate: u32, _delay: Duration) {}
}

/// A device that does nothing but communicate.
impl Application for ObjectDictionary {}
