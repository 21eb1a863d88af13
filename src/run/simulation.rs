//! What simulated drives on the bus say of themselves: what their time follows, and which watchdogs they lack.

use super::drill::DriveAddress;
use super::error::RunError;
use super::pace::Pace;
use super::place::Place;
use super::runner::Runner;
use yieldwall_drives::objects;
use yieldwall_drives::profiles::SIMULATED_VENDOR;
use yieldwall_drives::watchdog::{Clock, Watchdog};

impl<P: Place> Runner<P> {
    /// Asks the drives of a booted network, where they are simulated, whether they are simulated for this pace. In lockstep
    /// they also have to have all watchdogs: there time stands still without SYNC, so that no drill is possible.
    ///
    /// # Errors
    /// [`RunError::Pace`] and [`RunError::Unwatched`] if not; as [`Runner::read`].
    pub fn check_simulation(&mut self, drives: [DriveAddress; 2]) -> Result<(), RunError> {
        for drive in drives {
            let node_id = drive.node.raw();
            let mut read = |object: objects::Object| self.read(drive, object.index, object.sub);
            if read(objects::VENDOR_ID)? != SIMULATED_VENDOR {
                continue;
            }
            let clock = read(objects::SIMULATION_CLOCK)?;
            let lacks = read(objects::SIMULATION_LACKS)?;
            let other = match self.pace() {
                Pace::Lockstep => Clock::Wall,
                Pace::Free => Clock::Sync,
            };
            if clock == u32::from(other.code()) {
                return Err(RunError::Pace { node_id, pace: self.pace() });
            }
            let lacking = Watchdog::ALL.into_iter().find(|watchdog| lacks & u32::from(watchdog.bit()) != 0);
            if let (Pace::Lockstep, Some(watchdog)) = (self.pace(), lacking) {
                return Err(RunError::Unwatched { node_id, watchdog });
            }
        }
        Ok(())
    }

    /// Makes sure that both drives are simulated ones in lockstep, which need no drill on the bus.
    ///
    /// # Errors
    /// [`RunError::NotSimulated`] if not; as [`Runner::read`].
    pub(super) fn check_lockstep(&mut self, drives: [DriveAddress; 2]) -> Result<(), RunError> {
        for drive in drives {
            let vendor = self.read(drive, objects::VENDOR_ID.index, objects::VENDOR_ID.sub)?;
            if self.pace() != Pace::Lockstep || vendor != SIMULATED_VENDOR {
                return Err(RunError::NotSimulated { node_id: drive.node.raw() });
            }
        }
        Ok(())
    }
}
