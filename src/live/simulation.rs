//! What simulated drives on the bus say of themselves: what their time follows, and which watchdogs they lack.

use super::drill::DriveAddress;
use super::error::LiveError;
use super::metronome::Metronome;
use super::rig::LiveRig;
use crate::link::CanLink;
use crate::rig::Pace;
use crate::sim::{Clock, Watchdog};
use yieldwall_drives::objects;
use yieldwall_drives::profiles::SIMULATED_VENDOR;

impl<L: CanLink, M: Metronome> LiveRig<L, M> {
    /// Asks the drives of a booted network, where they are simulated, whether they are simulated for this pace. In lockstep
    /// they also have to have all watchdogs: there time stands still without SYNC, so that no drill is possible.
    ///
    /// # Errors
    /// [`LiveError::Pace`] and [`LiveError::Unwatched`] if not; as [`LiveRig::read`].
    pub fn check_simulation(&mut self, drives: [DriveAddress; 2]) -> Result<(), LiveError> {
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
                return Err(LiveError::Pace { node_id, pace: self.pace() });
            }
            let lacking = Watchdog::ALL.into_iter().find(|watchdog| lacks & u32::from(watchdog.bit()) != 0);
            if let (Pace::Lockstep, Some(watchdog)) = (self.pace(), lacking) {
                return Err(LiveError::Unwatched { node_id, watchdog });
            }
        }
        Ok(())
    }
}
