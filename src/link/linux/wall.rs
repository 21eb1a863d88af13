//! The clock on the wall, in which the kernel stamps frames, against the one that the loop lives on.

use std::time::Duration;

use rustix::time::ClockId;

use crate::clock::{monotonic, nanos, since_begin};
use yieldwall_fieldbus::time::Time;

/// Validity of a comparison of the clocks. A clock that is slewed drifts by at most 5 us in this time, and a clock that is set shifts only
/// the stamps of this time.
const FRESH: Duration = Duration::from_millis(10);
/// Time between the looks at the clocks with which a comparison is kept; more, and something came in between.
const CLOSE: Duration = Duration::from_micros(20);

/// Lead of the wall clock over the loop's clock. Reading it anew for each frame costs a system call where the kernel has no
/// shared page for that, such as in a virtual machine without a stable clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wall {
    ahead: Duration,
    /// On the wall.
    compared_at: Option<Duration>,
}

impl Wall {
    /// Returns the time of a stamp. The stamp itself shows the age of the comparison.
    pub(super) fn moment_of(&mut self, stamp: Duration) -> Time {
        if self.compared_at.is_none_or(|at| stamp.abs_diff(at) >= FRESH) {
            let before = monotonic();
            let wall = since_begin(ClockId::Realtime);
            let between = monotonic().since(before);
            self.ahead = wall.saturating_sub(since_start(before) + between / 2);
            self.compared_at = (between <= CLOSE).then_some(wall);
        }
        Time(nanos(stamp.saturating_sub(self.ahead)))
    }
}

fn since_start(time: Time) -> Duration {
    Duration::from_nanos(time.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_of_now_is_now() {
        let mut wall = Wall::default();
        for _ in 0..3 {
            let before = monotonic();
            let stamp = since_begin(ClockId::Realtime);
            let after = monotonic();
            let moment = wall.moment_of(stamp);
            // Whatever came between the looks, unless the comparison itself was torn apart.
            let slack = if wall.compared_at.is_some() { CLOSE } else { Duration::from_secs(60) };
            assert!(moment + slack >= before && moment <= after + slack, "{before:?} {moment:?} {after:?}");
        }
    }

    #[test]
    fn a_comparison_is_made_anew_when_it_is_old() {
        let now = since_begin(ClockId::Realtime);
        let mut wall = Wall { ahead: Duration::from_secs(1), compared_at: Some(now.saturating_sub(FRESH)) };
        wall.moment_of(now);
        assert!(wall.ahead > Duration::from_secs(1));
        let at = Duration::from_secs(3);
        let mut wall = Wall { ahead: Duration::from_secs(1), compared_at: Some(at) };
        assert_eq!(wall.moment_of(at), Time(2_000_000_000));
    }
}
