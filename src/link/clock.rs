//! The clock of the loop, and waiting on it.

use std::time::Duration;

use rustix::event::{PollFd, Timespec, poll};
use rustix::time::{ClockId, clock_gettime};

use yieldwall_fieldbus::time::Time;

/// Returns the clock of the loop.
pub(super) fn monotonic() -> Time {
    Time(nanos(since_begin(ClockId::Monotonic)))
}

pub(super) fn since_begin(clock: ClockId) -> Duration {
    let time = clock_gettime(clock);
    // Neither clock is before its begin.
    Duration::new(time.tv_sec.max(0) as u64, time.tv_nsec as u32)
}

pub(super) fn nanos(time: Duration) -> u64 {
    time.as_nanos().min(u128::from(u64::MAX)) as u64
}

/// Waits until one of the sockets has something or `until` has come; whether one has.
pub(super) fn wait_for_any(sockets: &mut [PollFd<'_>], until: Time) -> bool {
    let wait = until.since(monotonic());
    let wait = Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: i64::from(wait.subsec_nanos()) };
    let timeout = (until != Time::NEVER).then_some(&wait);
    poll(sockets, timeout).is_ok_and(|ready| ready > 0)
}
