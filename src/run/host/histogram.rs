//! Times of one kind, counted.

use std::time::Duration;

/// Classes in each doubling of the time: a class is at most 1/16 of its time wide.
const CLASSES: usize = 16;
/// Doublings above the first, which counts in steps of 1 ns: up to 2^40 ns, about 18 minutes.
const DOUBLINGS: usize = 36;

/// How often times of one kind occurred, in classes of 6 %.
///
/// Real-time: yes; it is of fixed size.
#[derive(Clone, Debug)]
pub struct Histogram {
    counts: Box<[u64; CLASSES * (DOUBLINGS + 1)]>,
    count: u64,
    max: Duration,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: Box::new([0; CLASSES * (DOUBLINGS + 1)]), count: 0, max: Duration::ZERO }
    }
}

impl Histogram {
    /// Counts one more.
    pub fn add(&mut self, time: Duration) {
        let ns = time.as_nanos().min(u128::from(u64::MAX)) as u64;
        if let Some(count) = self.counts.get_mut(class_of(ns)) {
            *count += 1;
        }
        self.count += 1;
        self.max = self.max.max(time);
    }

    /// Returns the number of times.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the longest time.
    pub fn max(&self) -> Duration {
        self.max
    }

    /// Returns the time that a share of them does not exceed, at the upper end of its class; zero if there are none.
    pub fn quantile(&self, share: f64) -> Duration {
        let wanted = (share * self.count as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (class, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= wanted {
                return Duration::from_nanos(end_of(class)).min(self.max);
            }
        }
        self.max
    }

    /// Returns the classes that are not empty: their longest time, and the number of times in them.
    pub fn classes(&self) -> impl Iterator<Item = (Duration, u64)> {
        let filled = self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        filled.map(|(class, count)| (Duration::from_nanos(end_of(class)), *count))
    }
}

fn class_of(ns: u64) -> usize {
    if ns < CLASSES as u64 {
        return ns as usize;
    }
    // The leading bit tells the doubling, the four bits behind it the class.
    let doubling = ns.ilog2() as usize - 3;
    let class = (ns >> (doubling - 1)) as usize - CLASSES;
    (doubling * CLASSES + class).min(CLASSES * (DOUBLINGS + 1) - 1)
}

/// Returns the longest time of a class in ns.
fn end_of(class: usize) -> u64 {
    let (doubling, place) = (class / CLASSES, (class % CLASSES) as u64);
    if doubling == 0 { place } else { ((CLASSES as u64 + place + 1) << (doubling - 1)) - 1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_time_lies_in_its_class(ns in 0_u64..1 << 39) {
            let end = end_of(class_of(ns));
            prop_assert!(end >= ns && end - ns <= ns / 16, "{} in the class up to {}", ns, end);
        }
    }

    #[test]
    fn quantiles_are_those_of_the_times() {
        let mut times = Histogram::default();
        assert_eq!((times.quantile(0.5), times.count()), (Duration::ZERO, 0));
        (1..=1000).for_each(|us| times.add(Duration::from_micros(us)));
        for (share, us) in [(0.5, 500.0), (0.9, 900.0), (0.999, 999.0)] {
            let found = times.quantile(share).as_secs_f64() * 1e6;
            assert!((us..us * 1.07).contains(&found), "{share}: {found} us");
        }
        assert_eq!((times.quantile(1.0), times.max()), (Duration::from_micros(1000), Duration::from_micros(1000)));
        assert_eq!(times.classes().map(|(_, count)| count).sum::<u64>(), 1000);
    }

    #[test]
    fn no_time_is_too_long() {
        let mut times = Histogram::default();
        times.add(Duration::MAX);
        assert_eq!((times.count(), times.max()), (1, Duration::MAX));
    }
}
