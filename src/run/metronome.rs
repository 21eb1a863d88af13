//! Sleeping until a grid point.

use std::time::Duration;

use yieldwall_fieldbus::time::Time;

/// Wakes the loop at its grid points.
pub trait Metronome {
    /// Sleeps until a moment on the clock of the link; returns at once if it has passed.
    ///
    /// Real-time: yes.
    fn sleep_until(&mut self, moment: Time);

    /// Returns how long the computer was suspended since it was switched on; the clock of the link stood still meanwhile.
    ///
    /// Real-time: yes.
    fn suspended(&self) -> Duration;
}
