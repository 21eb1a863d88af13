//! A device as whatever speaks for it on a bus sees it.

use super::{AbortCode, Address, ObjectDictionary};
use crate::time::Time;

/// Extent of a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// Power-on, or as if: all objects are back at their power-on values.
    Node,
    /// Reset of the communication alone: objects 1000h to 1FFFh are back at their power-on values.
    Communication,
}

/// A device that owns one dictionary and lends it to what serves it on a bus, such as a CANopen node.
///
/// Methods but the two that lend have defaults that do nothing. To send an emergency or inputs, remember the wish; whoever owns
/// device and server calls the server afterwards.
pub trait ServedDevice {
    /// Returns the dictionary.
    fn od(&self) -> &ObjectDictionary;

    /// Returns the dictionary, to be written.
    fn od_mut(&mut self) -> &mut ObjectDictionary;

    /// Prepares a write of `data` (little-endian) by a client; access, length and limits are in order.
    ///
    /// # Errors
    /// The abort code with which to refuse.
    fn before_write(&mut self, _at: Address, _data: &[u8]) -> Result<(), AbortCode> {
        Ok(())
    }

    /// Handles an object after a client wrote it.
    fn after_write(&mut self, _at: Address) {}

    /// Updates an object before a client reads it.
    ///
    /// # Errors
    /// The abort code with which to refuse.
    fn before_read(&mut self, _at: Address) -> Result<(), AbortCode> {
        Ok(())
    }

    /// Outputs of the master, process data object `number` (1 and up), are in the dictionary. They are not checked against limits.
    fn outputs_applied(&mut self, _now: Time, _number: u8) {}

    /// The outputs of process data object `number` did not come within the time that they are watched for.
    fn outputs_late(&mut self, _now: Time, _number: u8) {}

    /// The common moment of all devices (SYNC): synchronous outputs have been applied, inputs are sent next.
    fn sample(&mut self, _now: Time) {}

    /// Power-on or reset: the values are restored, nothing has been sent yet.
    fn reset(&mut self, _now: Time, _reset: Reset) {}
}

/// A device that does nothing but communicate.
impl ServedDevice for ObjectDictionary {
    fn od(&self) -> &ObjectDictionary {
        self
    }

    fn od_mut(&mut self) -> &mut ObjectDictionary {
        self
    }
}
