//! States of a device: acknowledging its error, and asking for INIT, PRE-OP or SAFE-OP.

use std::time::Duration;

use super::{LOOK_AGAIN, SegmentError, SegmentService};
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_fieldbus::ethercat::sii::Sii;
use yieldwall_fieldbus::ethercat::{AlControl, AlState, AlStatus, SyncManager, registers as register};
use yieldwall_link::EthernetLink;

/// How long a device may take to a state: the longest of the times that ETG.1020 gives.
const CHANGING: Duration = Duration::from_secs(10);
/// How long it may take to take back an error.
const ACKNOWLEDGING: Duration = Duration::from_secs(1);

impl<L: EthernetLink> SegmentService<L> {
    /// Acknowledges the error of a device, if it has one; its state afterwards.
    ///
    /// # Errors
    /// If the error stays, and as [`SegmentService::read`].
    pub fn acknowledge(&mut self, position: u16) -> Result<AlStatus, SegmentError> {
        let (status, _) = self.state(position)?;
        match status.state() {
            Some(state) if status.has_error() => self.ask(position, AlControl::acknowledge(state), state),
            _ => Ok(status),
        }
    }

    /// Brings a device to a state, by PRE-OP where there is no other way, with its error acknowledged before. On the way to PRE-OP
    /// its mailboxes are put where its SII says. The state is not OP: only what exchanges process data brings a device there.
    ///
    /// # Errors
    /// If it refuses a step or does not come to a state, and as [`SegmentService::read`].
    pub fn change_state(&mut self, position: u16, to: AlState) -> Result<AlStatus, SegmentError> {
        let mut status = match to {
            // INIT takes back errors, whatever they are, and forgets what was said over the mailbox.
            AlState::Init => {
                self.mailboxes.remove(&position);
                return self.ask(position, AlControl::acknowledge(to), to);
            }
            _ => self.acknowledge(position)?,
        };
        if to == AlState::Operational {
            return Ok(status);
        }
        if status.state() == Some(AlState::Init) {
            self.set_up_mailboxes(position)?;
            status = self.ask(position, AlControl::request(AlState::PreOperational), AlState::PreOperational)?;
        }
        if status.state() == Some(to) { Ok(status) } else { self.ask(position, AlControl::request(to), to) }
    }

    /// Sync managers 0 and 1 as the SII wants them, where that is legible and has a mailbox.
    fn set_up_mailboxes(&mut self, position: u16) -> Result<(), SegmentError> {
        let image = match self.sii_image(position) {
            Ok(image) => image,
            Err(SegmentError::Failed(_)) => return Ok(()),
            Err(error) => return Err(error),
        };
        let Some(managers) = Sii::read(&image).ok().and_then(|sii| sii.mailbox_managers()) else { return Ok(()) };
        for (number, manager) in (0..).zip(managers) {
            let at = register::SYNC_MANAGER + number * SyncManager::SIZE as u16;
            self.write(position, at, &manager.encode())?;
        }
        // Some devices read their memory chip on the way to PRE-OP.
        self.write(position, register::SII_CONFIGURATION, &[1])
    }

    /// Writes AL control and waits until the device is in this state without an error.
    fn ask(&mut self, position: u16, control: AlControl, to: AlState) -> Result<AlStatus, SegmentError> {
        self.write(position, register::AL_CONTROL, &control.0.to_le_bytes())?;
        let since = self.now();
        loop {
            let (status, code) = self.state(position)?;
            if status == AlStatus::new(to, false) {
                return Ok(status);
            }
            let waited = self.now().since(since);
            // An error that is being acknowledged takes a while to go.
            if status.has_error() && (!control.acknowledges() || waited >= ACKNOWLEDGING) {
                return Err(SegmentFailure::Refused { from: status, to, code }.into());
            }
            if waited >= CHANGING {
                let waited_ms = waited.as_millis() as u64;
                return Err(SegmentFailure::NotReached { is: status, to, waited_ms }.into());
            }
            self.pause(LOOK_AGAIN);
        }
    }
}
