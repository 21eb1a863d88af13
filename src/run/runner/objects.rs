//! Objects of the devices of a booted network, read and written one by one.

use std::time::Duration;

use super::Runner;
use crate::error::{RunError, Which};
use crate::permit::Ask;
use crate::place::Place;
use crate::proof::DriveIdentity;
use yieldwall_drives::objects;
use yieldwall_fieldbus::objects::{Address, ObjectAnswer, ObjectError, ObjectRequest, write_patience};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::Device;

/// How long a device is waited for beyond what its own time-outs allow.
const BEYOND_PATIENCE: Duration = Duration::from_secs(5);

impl<P: Place + ?Sized> Runner<P> {
    /// Reads an unsigned object of a device of a booted network, before the rig is enabled. Cycles of a segment that run already go on
    /// meanwhile; no other may run.
    ///
    /// # Errors
    /// [`RunError::Unread`] if it does not answer or refuses.
    pub fn read(&mut self, device: Device, index: u16, sub: u8) -> Result<u32, RunError> {
        self.read_bytes(device, Address::new(index, sub)).map(|data| unsigned(&data))
    }

    /// Reads the bytes of an object, the lowest first.
    ///
    /// # Errors
    /// As [`Runner::read`].
    pub(crate) fn read_bytes(&mut self, device: Device, at: Address) -> Result<Vec<u8>, RunError> {
        self.transfer(device, ObjectRequest::Read(at))
    }

    /// Writes the little-endian bytes of an object of a device of a booted network.
    ///
    /// # Errors
    /// As [`Runner::read`].
    pub(crate) fn write(&mut self, device: Device, at: Address, data: &[u8]) -> Result<(), RunError> {
        self.transfer(device, ObjectRequest::Write(at, data)).map(|_| ())
    }

    /// Runs one transfer, and returns the bytes that were read.
    fn transfer(&mut self, device: Device, request: ObjectRequest<'_>) -> Result<Vec<u8>, RunError> {
        let (ObjectRequest::Read(Address { index, sub }) | ObjectRequest::Write(Address { index, sub }, _)) = request;
        let unread = RunError::Unread { which: self.which(device), index, sub };
        // Time may stand still in lockstep, and a cycle that has panicked moves nothing on: the place's own clock goes on.
        let usual = self.patience.into_iter().max().unwrap_or_default();
        let patience = match request {
            ObjectRequest::Read(_) => usual,
            ObjectRequest::Write(at, _) => write_patience(at, usual),
        };
        let until = self.place.now() + patience + BEYOND_PATIENCE;
        let has_cycles = self.next_sync != Time::NEVER && self.master.networks().segment().is_some();
        let mut is_asked = false;
        loop {
            if self.has_panicked || self.place.now() >= until {
                return Err(unread);
            }
            if !is_asked {
                match self.send(|master, now, out| master.networks_mut().ask(now, device, request, out)) {
                    Ok(()) => is_asked = true,
                    // The other axis of the device has its turn, or the boot goes on.
                    Err(ObjectError::Busy) => {}
                    Err(_) => return Err(unread),
                }
            }
            if has_cycles {
                // Their frames carry what is asked.
                self.run_cycle(Ask::Nothing);
            } else {
                // The drives already wait for heartbeats.
                let sent =
                    self.send(|master, now, out| master.networks_mut().repeat_heartbeat(now, out).unwrap_or(now));
                let next = self.master.networks().next_deadline().min(sent + self.between_heartbeats());
                // The master's clock in lockstep is not the place's clock. A moment in the place's past would be no wait, and this loop would
                // take the processor from devices that share it.
                let wait = next.since(self.now());
                self.wait_until((self.place.now() + wait).min(until));
                self.drain();
                self.send(|master, now, out| master.networks_mut().poll(now, out));
            }
            if !is_asked {
                continue;
            }
            match self.master.networks().answer(device) {
                ObjectAnswer::Pending => {}
                ObjectAnswer::Done(data) => return Ok(data.to_vec()),
                ObjectAnswer::NotAsked | ObjectAnswer::Failed(_) => return Err(unread),
            }
        }
    }

    /// Returns the identities of both drives of a booted network.
    ///
    /// # Errors
    /// As [`Runner::read`].
    pub fn identities(&mut self) -> Result<[DriveIdentity; 2], RunError> {
        Ok([self.identity(Device::LeftDrive)?, self.identity(Device::RightDrive)?])
    }

    fn identity(&mut self, drive: Device) -> Result<DriveIdentity, RunError> {
        let node_id = self.master.networks().node_id(drive);
        let mut read = |sub| self.read(drive, objects::VENDOR_ID.index, sub);
        Ok(DriveIdentity {
            node_id,
            vendor_id: read(1)?,
            product_code: read(2)?,
            revision: read(3)?,
            serial_number: read(4)?,
        })
    }

    /// Returns the device as errors name it.
    pub(crate) fn which(&self, device: Device) -> Which {
        Which { device, node_id: self.master.networks().node_id(device) }
    }
}

/// Returns the first four bytes as a number, the lowest first.
fn unsigned(data: &[u8]) -> u32 {
    data.iter().take(4).rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
}
