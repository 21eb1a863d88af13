//! This computer: its clock, and what it grants to a loop that has to be in time.

mod facts;
mod limits;
mod load;
mod network_card;
mod readiness;
mod scheduler;

use std::time::Duration;

use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};

use super::timing::Computer;
use crate::Metronome;
use yieldwall_fieldbus::time::Time;

pub use facts::ComputerFacts;
pub use limits::{Limits, limits};
pub use load::Load;
pub use network_card::{CardError, Coalescing, coalescing, coalescing_check};
pub use readiness::Readiness;
pub use scheduler::{PRIORITY, Refusal, lock_memory, run_first};

/// Sleeps on CLOCK_MONOTONIC until absolute moments, so that lateness does not add up.
#[derive(Clone, Copy, Debug, Default)]
pub struct SystemMetronome;

impl Metronome for SystemMetronome {
    fn sleep_until(&mut self, moment: Time) {
        let request = Timespec { tv_sec: (moment.0 / 1_000_000_000) as _, tv_nsec: (moment.0 % 1_000_000_000) as _ };
        // A signal wakes it early; there is no other error with this clock and a time that is whole.
        while clock_nanosleep_absolute(ClockId::Monotonic, &request).is_err() {}
    }

    fn suspended(&self) -> Duration {
        // CLOCK_BOOTTIME goes on while the computer is suspended, CLOCK_MONOTONIC does not.
        duration(ClockId::Boottime).saturating_sub(duration(ClockId::Monotonic))
    }
}

impl SystemMetronome {
    /// Returns the present time on the clock that it sleeps on.
    pub fn now(&self) -> Time {
        Time(duration(ClockId::Monotonic).as_nanos() as u64)
    }
}

/// This computer, with what it grants to the loop.
pub fn computer(has_priority: bool, has_locked_memory: bool) -> Computer {
    let of = |name: &str| {
        let text = std::fs::read_to_string(format!("/proc/sys/kernel/{name}")).unwrap_or_default();
        text.trim().to_owned()
    };
    let kernel = format!("{} {}", of("osrelease"), of("version"));
    let profile = crate::built::PROFILE.to_owned();
    Computer { name: of("hostname"), kernel, profile, has_priority, has_locked_memory }
}

fn duration(clock: ClockId) -> Duration {
    let Timespec { tv_sec, tv_nsec } = clock_gettime(clock);
    Duration::new(tv_sec.max(0) as u64, tv_nsec as u32)
}
