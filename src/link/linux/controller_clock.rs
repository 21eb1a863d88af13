//! The clock of a CAN controller, in which it stamps frames, against the one that the loop lives on.
//!
//! A frame arrives with two stamps. The controller's stamp marks the end of the frame on the wire; the kernel's marks the moment at which
//! it took the frame from the controller. The kernel's stamp is later by the delay of interrupt, driver and USB, 5 us as well as 500 us,
//! and never earlier. The controller's stamp is precise, on a clock that begins anywhere and drifts. The least difference of both over a
//! short window is therefore the offset of the two clocks plus the shortest such delay in the window, and
//!
//! ```text
//! moment = hardware + least (software - hardware)
//! ```
//! The delay that remains is the shortest one of the window. It is the same for all frames of the window, so that times between frames are
//! those on the wire. A slow clock puts a frame too early: by at most 10 us at 100 ppm, more than CAN allows a node, since no difference is
//! older than 100 ms. A clock that is fast is corrected at once. No line is fitted: a fit would know the drift, but would need to detect
//! every jump of the clock.

use std::time::Duration;

use yieldwall_fieldbus::time::Time;

/// Half of the longest time for which a difference counts.
const HALF: Duration = Duration::from_millis(50);
/// Longest delay that is believed. Above it one of the clocks has jumped, or the computer stood still, and the software stamp
/// is as good as any.
const LONGEST_DELAY_NS: i64 = 10_000_000;

/// The distance of the two clocks, as the last frames show it.
///
/// Differences are `software - hardware` in ns. The window is two halves of [`HALF`], each with its least difference alone, so
/// that neither work nor memory grows with the number of frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ControllerClock {
    /// Start of the present half.
    began: Time,
    /// Least difference of the present half.
    present: Option<i64>,
    /// Least difference of the half before.
    before: Option<i64>,
}

impl ControllerClock {
    /// Returns the moment of a frame on the clock of `software`, at which the kernel had it. The moment is not after `software`, and at
    /// most 10 ms before it, whatever `hardware` says.
    ///
    /// Real-time: yes.
    pub(super) fn moment_of(&mut self, software: Time, hardware: Duration) -> Time {
        let hardware_ns = hardware.as_nanos().min(u128::from(u64::MAX)) as u64;
        // A clock may begin anywhere: the difference has a sign, and of two that are apart by more than it can hold one is
        // wrong anyway.
        let difference = software.0.wrapping_sub(hardware_ns).cast_signed();
        self.turn(software);
        let least = [self.present, self.before].into_iter().flatten().fold(difference, i64::min);
        let delay = difference.saturating_sub(least);
        if delay > LONGEST_DELAY_NS {
            *self = Self { began: software, present: Some(difference), before: None };
            return software;
        }
        self.present = Some(self.present.map_or(difference, |present| present.min(difference)));
        Time(software.0.saturating_sub(delay.unsigned_abs()))
    }

    /// Begins a new half when the present one is over.
    fn turn(&mut self, now: Time) {
        let age = now.since(self.began);
        if age >= HALF {
            let before = if age < 2 * HALF { self.present } else { None };
            *self = Self { began: now, present: None, before };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Delays of one frame after the other in us; the shortest comes once in a cycle.
    const DELAYS_US: [u64; 5] = [220, 7, 60, 900, 35];
    const SHORTEST_NS: i64 = 7_000;

    /// Five frames a cycle of 1 ms for so many cycles, over a controller's clock with an offset and a drift; how much too late
    /// each moment is, in ns.
    fn errors(clock: &mut ControllerClock, from_ms: u64, cycles: u64, offset_ns: u64, drift_ppm: i64) -> Vec<i64> {
        let mut errors = Vec::new();
        for cycle in 0..cycles {
            for (number, delay_us) in (0..).zip(DELAYS_US) {
                let true_ns = (from_ms + cycle) * 1_000_000 + number * 130_000;
                let drifted = true_ns.cast_signed() * drift_ppm / 1_000_000;
                let hardware = Duration::from_nanos(true_ns.wrapping_add(offset_ns).wrapping_add_signed(drifted));
                let moment = clock.moment_of(Time(true_ns + delay_us * 1000), hardware);
                errors.push(moment.0.cast_signed() - true_ns.cast_signed());
            }
        }
        errors
    }

    /// Once every delay was seen.
    fn settled(errors: &[i64]) -> (i64, i64) {
        let settled = &errors[DELAYS_US.len()..];
        (*settled.iter().min().unwrap(), *settled.iter().max().unwrap())
    }

    #[test]
    fn what_is_left_is_the_shortest_delay() {
        for offset_ns in [0, 1_700_000_000_000_000_000, u64::MAX - 1000] {
            let errors = errors(&mut ControllerClock::default(), 5000, 3000, offset_ns, 0);
            assert_eq!(errors[0], 220_000, "the first frame has its software stamp");
            assert_eq!(settled(&errors), (SHORTEST_NS, SHORTEST_NS), "offset {offset_ns}");
        }
    }

    #[test]
    fn a_drift_costs_what_it_gathers_in_a_window() {
        // Fast: the newest difference is the least one, but for what it drifts until the next short delay.
        let fast = errors(&mut ControllerClock::default(), 0, 3000, 0, 100);
        let (least, most) = settled(&fast);
        assert!(least >= SHORTEST_NS && most <= SHORTEST_NS + 150, "{least} to {most} ns");
        // Slow: the least difference is up to 100 ms old.
        let slow = errors(&mut ControllerClock::default(), 0, 3000, 0, -100);
        let (least, most) = settled(&slow);
        assert!((SHORTEST_NS - 10_150..SHORTEST_NS - 9_000).contains(&least), "{least} ns");
        assert!(most <= SHORTEST_NS, "{most} ns");
    }

    #[test]
    fn a_clock_that_jumps_or_wraps_is_followed() {
        let mut clock = ControllerClock::default();
        let mut from_ms = 0;
        // Ahead, back to zero as after a restart of the controller, and by the range of a counter of 32 bits in us.
        for offset_ns in [40_000_000, 7_000_000_000, 0, 4_294_967_296_000, 0] {
            let errors = errors(&mut clock, from_ms, 500, offset_ns, 0);
            assert!(errors.iter().all(|error| (SHORTEST_NS..=900_000).contains(error)), "never before the frame");
            assert_eq!(settled(&errors), (SHORTEST_NS, SHORTEST_NS), "offset {offset_ns}");
            from_ms += 500;
        }
        // Too little to be told from a delay: wrong by the jump, and over after a window.
        let errors = errors(&mut clock, from_ms, 500, u64::MAX - 2_999_999, 0);
        assert_eq!(errors[20] - SHORTEST_NS, -3_000_000);
        assert!(errors[5 * 101..].iter().all(|error| *error == SHORTEST_NS));
    }

    #[test]
    fn a_stamp_that_is_none_spoils_no_other() {
        let mut clock = ControllerClock::default();
        errors(&mut clock, 0, 100, 1000, 0);
        for nonsense in [Duration::ZERO, Duration::MAX, Duration::from_secs(1)] {
            let software = Time(100_000_000);
            assert_eq!(clock.moment_of(software, nonsense), software);
            let errors = errors(&mut clock, 100, 2, 1000, 0);
            assert_eq!(settled(&errors), (SHORTEST_NS, SHORTEST_NS));
        }
    }

    #[test]
    fn frames_without_a_stamp_and_a_quiet_bus_leave_nothing_old() {
        let mut clock = ControllerClock::default();
        errors(&mut clock, 0, 100, 5_001_000, 0);
        // The clock has lost 5 ms meanwhile, without a stamp to show it.
        let errors = errors(&mut clock, 60_000, 10, 1000, 0);
        assert_eq!(settled(&errors), (SHORTEST_NS, SHORTEST_NS), "{errors:?}");
    }

    #[test]
    fn software_stamps_that_run_backwards_do_no_harm() {
        let mut clock = ControllerClock::default();
        errors(&mut clock, 1000, 10, 0, 0);
        let errors = errors(&mut clock, 900, 10, 0, 0);
        assert_eq!(settled(&errors), (SHORTEST_NS, SHORTEST_NS));
    }

    proptest! {
        #[test]
        fn whatever_comes_a_moment_is_near_its_software_stamp(
            stamps in prop::collection::vec((any::<u64>(), any::<u64>(), any::<u32>()), 1..60),
        ) {
            let mut clock = ControllerClock::default();
            for (software, seconds, nanos) in stamps {
                let moment = clock.moment_of(Time(software), Duration::new(seconds, nanos % 1_000_000_000));
                prop_assert!(moment.0 <= software && software - moment.0 <= LONGEST_DELAY_NS.unsigned_abs());
            }
        }
    }
}
