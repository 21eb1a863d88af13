//! Properties that simulated drives on the bus report: that they are simulated, their time base, and the watchdogs that they lack.

use super::error::RunError;
use super::pace::Pace;
use super::place::Place;
use super::runner::Runner;
use yieldwall_drives::objects;
use yieldwall_drives::watchdog::{Clock, Watchdog};
use yieldwall_motion::guard::Device;

impl<P: Place + ?Sized> Runner<P> {
    /// Asks the drives of a booted network whether they are simulated, by their object 2012h, and if so, whether for this pace. In
    /// lockstep they have to be simulated and have all watchdogs: there time stands still without SYNC, so that no drill is possible.
    ///
    /// # Errors
    /// [`RunError::Unmarked`], [`RunError::NotSimulated`], [`RunError::Pace`] and [`RunError::Unwatched`] if not; as [`Runner::read`].
    pub fn check_simulation(&mut self) -> Result<(), RunError> {
        for (drive, has_simulated_profile) in Device::DRIVES.into_iter().zip(self.has_simulated_profile) {
            let which = self.which(drive);
            if !self.is_marked(drive) {
                if has_simulated_profile {
                    return Err(RunError::Unmarked { which });
                }
                if self.pace() == Pace::Lockstep {
                    return Err(RunError::NotSimulated { which });
                }
                continue;
            }
            let mut read = |object: objects::Object| self.read(drive, object.index, object.sub);
            let clock = read(objects::SIMULATION_CLOCK)?;
            let lacks = read(objects::SIMULATION_LACKS)?;
            let other = match self.pace() {
                Pace::Lockstep => Clock::Wall,
                Pace::Free => Clock::Sync,
            };
            if clock == u32::from(other.code()) {
                return Err(RunError::Pace { which, pace: self.pace() });
            }
            let lacking = Watchdog::ALL.into_iter().find(|watchdog| lacks & u32::from(watchdog.bit()) != 0);
            if let (Pace::Lockstep, Some(watchdog)) = (self.pace(), lacking) {
                return Err(RunError::Unwatched { which, watchdog });
            }
        }
        Ok(())
    }

    /// Whether a drive reports the whole text that only simulated drives have. A drive without the object is not simulated.
    fn is_marked(&mut self, drive: Device) -> bool {
        let mark = objects::SIMULATION_MARK;
        let mut words = (mark.sub..).zip(objects::SIMULATED_DEVICE);
        words.all(|(sub, word)| self.read(drive, mark.index, sub) == Ok(word))
    }
}
