//! What a device does with its objects.

use std::time::Duration;

use super::super::nmt::HeartbeatEvent;
use super::super::time::TimeOfDay;
use super::super::{AbortCode, Address, NmtState, ObjectDictionary, Time};

/// How far a reset goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// Power-on or NMT reset node: all objects are back at their power-on values.
    Node,
    /// NMT reset communication: objects 1000h to 1FFFh are back at their power-on values.
    Communication,
}

/// The device behind a [`Node`](super::Node). All methods have defaults that do nothing.
///
/// Methods get the dictionary; to send an emergency or a TPDO, remember the wish and call the node afterwards.
pub trait Application {
    /// A client writes `data` (little-endian) to an object; access, length and limits are in order.
    ///
    /// # Errors
    /// The abort code with which to refuse.
    fn before_write(&mut self, _od: &mut ObjectDictionary, _at: Address, _data: &[u8]) -> Result<(), AbortCode> {
        Ok(())
    }

    /// A client wrote an object.
    fn after_write(&mut self, _od: &mut ObjectDictionary, _at: Address) {}

    /// A client reads an object: the last chance to bring its value up to date.
    ///
    /// # Errors
    /// The abort code with which to refuse.
    fn before_read(&mut self, _od: &mut ObjectDictionary, _at: Address) -> Result<(), AbortCode> {
        Ok(())
    }

    /// SYNC came (Pre-operational or Operational): synchronous RPDOs have been applied, TPDOs are sampled next.
    fn on_sync(&mut self, _now: Time, _od: &mut ObjectDictionary) {}

    /// RPDO `number` (1 to 4) was applied to the dictionary: at once if event-driven, else at SYNC before
    /// [`Application::on_sync`]. Values from PDOs are not checked against limits.
    fn on_rpdo(&mut self, _now: Time, _od: &mut ObjectDictionary, _number: u8) {}

    /// The NMT state changed.
    fn on_nmt(&mut self, _now: Time, _od: &mut ObjectDictionary, _state: NmtState) {}

    /// Power-on or reset; values are restored, the boot-up message follows.
    fn on_reset(&mut self, _now: Time, _od: &mut ObjectDictionary, _reset: Reset) {}

    /// Something happened to a node watched by 1016h. When it was lost, emergency 8130h has been sent and the error
    /// behaviour 1029h:1 has been carried out.
    fn on_heartbeat_event(&mut self, _now: Time, _od: &mut ObjectDictionary, _event: HeartbeatEvent) {}

    /// The master has not asked for the whole life time (100Ch times 100Dh), or asks again. When it was lost, emergency
    /// 8130h has been sent and the error behaviour 1029h:1 has been carried out.
    fn on_life_guarding(&mut self, _now: Time, _od: &mut ObjectDictionary, _is_lost: bool) {}

    /// TIME came; only if 1012h makes the device a consumer.
    fn on_time(&mut self, _now: Time, _od: &mut ObjectDictionary, _time: TimeOfDay) {}

    /// LSS activates a bit rate in bit/s: send nothing for `delay`, change, and send nothing for `delay` once more.
    fn on_bit_rate(&mut self, _now: Time, _od: &mut ObjectDictionary, _bit_rate: u32, _delay: Duration) {}

    /// RPDO `number` did not come within its event timer; emergency 8250h has been sent.
    fn on_rpdo_timeout(&mut self, _now: Time, _od: &mut ObjectDictionary, _number: u8) {}
}

/// A device that does nothing but communicate.
impl Application for () {}
