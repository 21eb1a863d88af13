//! Whether the computer let the loop run when it was due.

use std::time::Duration;

use yieldwall_fieldbus::time::Time;
use yieldwall_record::Standstill;

/// A standstill shorter than this explains nothing where no cycle has to be in time.
pub(super) const LEAST: Duration = Duration::from_millis(100);
/// Faults that come later than this after a standstill have another cause: heartbeats are the slowest to be missed.
const MEMORY: Duration = Duration::from_secs(3);

/// The longest standstill of the last seconds, on the clock of the place.
#[derive(Clone, Copy, Debug)]
pub(super) struct StandstillWatch {
    /// Moment at which the loop is due next.
    due: Time,
    lasted: Duration,
    ended: Time,
}

impl StandstillWatch {
    /// Creates a watch; the loop is not due before it runs first.
    pub(super) fn new() -> Self {
        Self { due: Time::NEVER, lasted: Duration::ZERO, ended: Time(0) }
    }

    /// Notes that the loop waits until a moment, or until something comes before.
    ///
    /// Real-time: yes.
    pub(super) fn wait_until(&mut self, moment: Time) {
        self.due = self.due.max(moment);
    }

    /// Notes that the loop runs.
    ///
    /// Real-time: yes.
    pub(super) fn run(&mut self, now: Time) {
        let lasted = now.since(self.due);
        self.due = now;
        if lasted >= self.lasted || now.since(self.ended) > MEMORY {
            (self.lasted, self.ended) = (lasted, now);
        }
    }

    /// Returns the longest standstill of the last seconds that lasted for `least` or more.
    ///
    /// Real-time: yes.
    pub(super) fn last(&self, now: Time, least: Duration) -> Option<Standstill> {
        let ago = now.since(self.ended);
        let is_one = self.lasted >= least && ago <= MEMORY;
        is_one.then_some(Standstill { lasted: self.lasted, ago })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Time {
        Time(ms * 1_000_000)
    }

    #[test]
    fn waiting_is_no_standstill_and_being_late_is_one() {
        let mut watch = StandstillWatch::new();
        watch.run(ms(250));
        assert_eq!(watch.last(ms(300), LEAST), None, "the loop runs first");
        watch.wait_until(ms(500));
        watch.run(ms(300));
        watch.run(ms(301));
        assert_eq!(watch.last(ms(301), LEAST), None, "something came before the moment");
        watch.wait_until(ms(310));
        watch.run(ms(2410));
        let one = Standstill { lasted: Duration::from_millis(2100), ago: Duration::from_millis(90) };
        assert_eq!(watch.last(ms(2500), LEAST), Some(one));
        watch.run(ms(2560));
        assert_eq!(watch.last(ms(2560), LEAST).map(|one| one.lasted), Some(one.lasted), "a shorter one came after it");
        assert_eq!(watch.last(ms(5411), LEAST), None, "long ago");
        watch.wait_until(ms(5500));
        watch.run(ms(5503));
        assert_eq!(watch.last(ms(5503), LEAST), None);
        assert!(watch.last(ms(5503), Duration::from_millis(1)).is_some());
    }
}
