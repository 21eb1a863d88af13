//! The clock that every engine takes as an argument.

use std::ops::{Add, Sub};
use std::time::Duration;

/// Monotonic time in nanoseconds since an arbitrary start; virtual in simulation, `CLOCK_MONOTONIC` on a machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(pub u64);

impl Time {
    /// Later than every moment that an engine waits for.
    pub const NEVER: Time = Time(u64::MAX);

    /// Returns the whole microseconds since the start.
    #[inline]
    pub const fn from_micros(us: u64) -> Self {
        Time(us * 1000)
    }

    /// Seconds since the start, for reports and simulation; not for comparing deadlines.
    #[inline]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Returns the time elapsed since `earlier`, zero if `earlier` is later.
    #[inline]
    pub const fn since(self, earlier: Time) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }
}

impl Add<Duration> for Time {
    type Output = Time;
    #[inline]
    fn add(self, wait: Duration) -> Time {
        Time(self.0.saturating_add(wait.as_nanos().min(u128::from(u64::MAX)) as u64))
    }
}

impl Sub<Time> for Time {
    type Output = Duration;
    #[inline]
    fn sub(self, earlier: Time) -> Duration {
        self.since(earlier)
    }
}
