//! The clock of a device, and how it follows the reference clock.

use yieldwall_fieldbus::time::Time;

/// Parts per billion.
const BILLION: i128 = 1_000_000_000;
/// How far a device trims its clock.
const MOST_TRIM_PPB: i64 = 1_000_000;
/// Shares of a difference by which the clock is corrected until the next comparison, and for good.
const PROPORTIONAL_SHIFT: u32 = 3;
const INTEGRAL_SHIFT: u32 = 7;
/// Times and rates up to which 64 bits are enough: a quarter of an hour, 4 per mille.
const SHORT_NS: i64 = 1 << 40;
const SMALL_PPB: i64 = 1 << 22;
/// The longest wait for which that is so, in ns.
const SHORT_WAIT_NS: i64 = 1 << 32;
/// Comparisons that are further apart than this say nothing about the rate.
const LONGEST_INTERVAL_NS: i64 = 1_000_000_000;

/// A clock with a rate of its own, which the comparison with the reference clock trims.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    /// A moment, and what the clock showed then, in ns.
    since: Time,
    shown: i64,
    drift_ppb: i64,
    /// Rate corrections from comparisons: permanent, and until the next comparison.
    trim_ppb: i64,
    push_ppb: i64,
    /// Mean difference in 1/256 ns.
    mean: i64,
    last_compared: Option<i64>,
}

impl Clock {
    /// A clock that starts at `start_ns` and runs so many parts per billion too fast.
    pub(super) fn new(now: Time, start_ns: i64, drift_ppb: i32) -> Self {
        Clock {
            since: now,
            shown: start_ns,
            drift_ppb: i64::from(drift_ppb),
            trim_ppb: 0,
            push_ppb: 0,
            mean: 0,
            last_compared: None,
        }
    }

    fn rate(&self) -> i64 {
        self.drift_ppb + self.trim_ppb + self.push_ppb
    }

    /// Returns the time of the clock, in ns.
    pub(super) fn at(&self, now: Time) -> i64 {
        let rate = self.rate();
        let short = now.0.wrapping_sub(self.since.0) as i64;
        if (0..SHORT_NS).contains(&short) && rate.abs() < SMALL_PPB {
            return self.shown.wrapping_add(short + (short * rate).div_euclid(BILLION as i64));
        }
        let elapsed = i128::from(now.0) - i128::from(self.since.0);
        let share = (elapsed * i128::from(rate)).div_euclid(BILLION);
        (i128::from(self.shown) + elapsed + share) as i64
    }

    /// The first moment at which the clock shows `shown` or later, at its present rate.
    pub(super) fn moment_of(&self, shown: i64) -> Time {
        let ahead = i128::from(shown) - i128::from(self.shown);
        if ahead <= 0 {
            return self.since;
        }
        let of_rate = BILLION + i128::from(self.rate());
        let wait = match i64::try_from(ahead) {
            Ok(ahead) if ahead < SHORT_WAIT_NS && self.rate().abs() < SMALL_PPB => {
                let of_rate = of_rate as i64;
                i128::from((ahead * BILLION as i64 + of_rate - 1) / of_rate)
            }
            _ => (ahead * BILLION + of_rate - 1) / of_rate,
        };
        let moment = i128::from(self.since.0) + wait;
        Time(u64::try_from(moment).unwrap_or(u64::MAX))
    }

    fn advance(&mut self, now: Time) {
        (self.shown, self.since) = (self.at(now), now);
    }

    /// The clock is fast by so many parts per billion from now on.
    pub(super) fn set_drift(&mut self, now: Time, drift_ppb: i32) {
        self.advance(now);
        self.drift_ppb = i64::from(drift_ppb);
    }

    /// The clock jumps by so many ns.
    pub(super) fn jump(&mut self, now: Time, by_ns: i64) {
        self.advance(now);
        self.shown = self.shown.wrapping_add(by_ns);
    }

    /// Forgets the mean difference, as writes to its filter do.
    pub(super) fn reset_filter(&mut self) {
        self.mean = 0;
        self.push_ppb = 0;
        self.last_compared = None;
    }

    /// Compares with the reference clock: `difference` is how far the own time is ahead, in ns. The mean of 2^`depth` comparisons trims
    /// the rate; the clock does not jump.
    pub(super) fn compare(&mut self, now: Time, difference: i64, depth: u8) {
        self.advance(now);
        let difference = difference.clamp(i64::from(i32::MIN), i64::from(i32::MAX));
        self.mean += ((difference << 8) - self.mean) >> depth.min(15);
        let interval = self.last_compared.replace(self.shown).map(|last| self.shown.wrapping_sub(last));
        let Some(interval) = interval.filter(|interval| (1..=LONGEST_INTERVAL_NS).contains(interval)) else { return };
        let mean = self.mean >> 8;
        let share = |shift: u32| (i128::from(mean) * BILLION / i128::from(interval) / (1 << shift)) as i64;
        let clamp = |ppb: i64| ppb.clamp(-MOST_TRIM_PPB, MOST_TRIM_PPB);
        self.trim_ppb = clamp(self.trim_ppb - share(INTEGRAL_SHIFT).clamp(-MOST_TRIM_PPB / 8, MOST_TRIM_PPB / 8));
        self.push_ppb = clamp(-share(PROPORTIONAL_SHIFT));
    }

    /// The mean difference as the register shows it: magnitude, and bit 31 if the own time is behind.
    pub(super) fn difference(&self) -> u32 {
        let mean = self.mean >> 8;
        let magnitude = mean.unsigned_abs().min(0x7fff_ffff) as u32;
        if mean < 0 { magnitude | 1 << 31 } else { magnitude }
    }
}

/// The sync signals of a device.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SyncSignals {
    /// Next SYNC0 in system time; `None` if there is none.
    pub(super) next: Option<i64>,
    /// SYNC0 pulses since activation.
    pub(super) count: u64,
}

impl SyncSignals {
    /// Bits of the activation.
    pub(super) const UNIT: u8 = 1;
    pub(super) const SYNC0: u8 = 2;
    pub(super) const SYNC1: u8 = 4;

    /// Starts or stops the signals as the registers say. A start that has passed waits for the system time to come round again: it
    /// never comes.
    pub(super) fn activate(&mut self, activation: u8, start: i64, system_time: i64) {
        let is_active = activation & (Self::UNIT | Self::SYNC0) == Self::UNIT | Self::SYNC0;
        *self = SyncSignals { next: (is_active && start >= system_time).then_some(start), count: 0 };
    }

    /// A pulse has come; the next one is a cycle later, or never for a cycle of 0.
    pub(super) fn fire(&mut self, cycle_ns: u32) {
        self.count += 1;
        self.next = self.next.filter(|_| cycle_ns > 0).map(|next| next.wrapping_add(i64::from(cycle_ns)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_fast_clock_gains_and_its_moments_are_those_of_the_wall() {
        let clock = Clock::new(Time(1000), 5, 50_000);
        assert_eq!(clock.at(Time(1000)), 5);
        assert_eq!(clock.at(Time(1_000_001_000)), 1_000_050_005);
        for shown in [6, 1000, 123_456_789, 5_000_000_000] {
            let moment = clock.moment_of(shown);
            assert!(clock.at(moment) >= shown && clock.at(Time(moment.0 - 1)) < shown, "{shown}");
        }
        assert_eq!(clock.moment_of(4), Time(1000));
    }

    proptest::proptest! {
        #[test]
        fn short_times_are_computed_as_long_ones_are(since in 0u64..1 << 45, for_ns in 0i64..1 << 42, shown in -5_000_000_000i64..1 << 50, ppb in -5_000_000i32..5_000_000) {
            let clock = Clock::new(Time(since), shown, ppb);
            let exact = i128::from(shown) + i128::from(for_ns) + (i128::from(for_ns) * i128::from(ppb)).div_euclid(BILLION);
            proptest::prop_assert_eq!(i128::from(clock.at(Time(since + for_ns as u64))), exact);
            let wanted = shown + for_ns;
            let moment = clock.moment_of(wanted);
            proptest::prop_assert!(clock.at(moment) >= wanted && (for_ns == 0 || clock.at(Time(moment.0 - 1)) < wanted));
        }
    }

    #[test]
    fn comparisons_bring_a_clock_to_the_reference() {
        for (drift_ppb, every_us, depth) in [(30_000, 1000, 4), (-80_000, 1000, 0), (50_000, 20, 0), (0, 250, 4)] {
            let reference = Clock::new(Time(0), 0, 0);
            let mut clock = Clock::new(Time(0), 3_000, drift_ppb);
            let mut now = Time(0);
            for _ in 0..4000 {
                now = now + Duration::from_micros(every_us);
                clock.compare(now, clock.at(now) - reference.at(now), depth);
            }
            let rest = clock.at(now) - reference.at(now);
            assert!(rest.abs() <= 20, "{drift_ppb} ppb every {every_us} us, depth {depth}: {rest} ns");
        }
    }

    #[test]
    fn the_difference_is_sign_and_magnitude() {
        let mut clock = Clock::new(Time(0), 0, 0);
        clock.compare(Time(1000), -5, 0);
        assert_eq!(clock.difference(), 0x8000_0005);
        clock.compare(Time(2000), 7, 0);
        assert_eq!(clock.difference(), 7);
    }

    #[test]
    fn a_start_in_the_past_never_comes() {
        let mut signals = SyncSignals::default();
        signals.activate(0x03, 999, 1000);
        assert_eq!(signals.next, None);
        signals.activate(0x03, 1000, 1000);
        signals.fire(250);
        assert_eq!((signals.next, signals.count), (Some(1250), 1));
        signals.fire(0);
        assert_eq!(signals.next, None);
        signals.activate(0x01, 5000, 1000);
        assert_eq!(signals.next, None);
    }
}
