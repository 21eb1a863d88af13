//! The grid of the cycles follows the reference clock of the segment.

use std::time::Duration;

/// Shares of an error by which the next grid point is moved, at once and for good. Together they settle in about 30 cycles without
/// overshooting.
const PROPORTIONAL: f64 = 1.0 / 8.0;
const INTEGRAL: f64 = 1.0 / 128.0;
/// Share of a period by which a grid point is moved at most.
const MOST_SHIFT: f64 = 0.01;
/// Weight of the newest error in the mean.
const MEAN: f64 = 1.0 / 64.0;
/// Share of a period within which the mean error has to be before outputs act, and for how many cycles.
const SETTLED: f64 = 0.001;
const SETTLED_CYCLES: u32 = 64;
/// Share of a period beyond which an error is that of a clock that has jumped, and for how many cycles in a row.
const LOST: f64 = 0.05;
const LOST_CYCLES: u32 = 3;

/// A PI controller of the grid.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GridServo {
    period_ns: f64,
    wanted_ns: f64,
    integral_ns: f64,
    mean_ns: f64,
    last_ns: f64,
    shift_ns: i64,
    settled_for: u32,
    wrong_for: u32,
    has_settled: bool,
    /// Time stands still between the cycles, so that no shift has any effect: the first phase is the wanted one.
    is_in_lockstep: bool,
    has_time: bool,
    /// Whether the grid was moved since the last error was seen.
    has_jumped: bool,
    /// How late the input frame was sent, against its grid point.
    late_ns: u64,
}

impl GridServo {
    /// One whose input frames have to pass the reference clock at `phase` after SYNC0, which comes every `period`, whenever system time is
    /// a multiple of it.
    pub(super) fn new(period: Duration, phase: Duration) -> Self {
        GridServo { period_ns: period.as_nanos() as f64, wanted_ns: phase.as_nanos() as f64, ..GridServo::default() }
    }

    /// Returns a servo that has seen nothing.
    pub(super) fn anew(&self) -> Self {
        let Self { period_ns, wanted_ns, is_in_lockstep, .. } = *self;
        GridServo { period_ns, wanted_ns, is_in_lockstep, ..GridServo::default() }
    }

    /// One whose clocks stand still between the cycles.
    pub(super) fn in_lockstep(&self) -> Self {
        GridServo { is_in_lockstep: true, ..self.anew() }
    }

    /// How far a moment of system time is behind the wanted one, -period/2 to period/2, in ns.
    pub(super) fn error_ns(&self, system_time_ns: u64) -> f64 {
        let phase = (system_time_ns % self.period_ns.max(1.0) as u64) as f64 - self.wanted_ns;
        phase - self.period_ns * (phase / self.period_ns).round()
    }

    /// How late the next input frame is sent, against its grid point. In lockstep there is no such thing.
    ///
    /// Real-time: yes.
    pub(super) fn note_late(&mut self, late: Duration) {
        if !self.is_in_lockstep {
            self.late_ns = late.as_nanos().min(u128::from(u32::MAX)) as u64;
        }
    }

    /// Takes the system time at which the input frame passed the reference clock.
    ///
    /// Real-time: yes.
    pub(super) fn on_time(&mut self, system_time_ns: u64) {
        let system_time_ns = system_time_ns.saturating_sub(self.late_ns);
        if self.is_in_lockstep && !self.has_time {
            self.wanted_ns = (system_time_ns % self.period_ns.max(1.0) as u64) as f64;
        }
        self.has_time = true;
        let error = self.error_ns(system_time_ns);
        (self.last_ns, self.has_jumped) = (error, false);
        self.mean_ns += (error - self.mean_ns) * MEAN;
        let most = MOST_SHIFT * self.period_ns;
        // While the grid moves as fast as it may, an error says nothing about the rate.
        if (error * PROPORTIONAL + self.integral_ns).abs() < most {
            self.integral_ns = (self.integral_ns + error * INTEGRAL).clamp(-most, most);
        }
        let shift = -(error * PROPORTIONAL + self.integral_ns);
        self.shift_ns = shift.clamp(-most, most) as i64;
        let is_near = self.mean_ns.abs() <= SETTLED * self.period_ns && error.abs() <= LOST * self.period_ns;
        self.settled_for = if is_near { self.settled_for.saturating_add(1) } else { 0 };
        self.has_settled |= self.settled_for >= SETTLED_CYCLES;
        self.wrong_for = if error.abs() > LOST * self.period_ns { self.wrong_for.saturating_add(1) } else { 0 };
    }

    /// Nothing came of the reference clock in this cycle: the grid goes on at the rate that was found.
    ///
    /// Real-time: yes.
    pub(super) fn on_silence(&mut self) {
        let most = MOST_SHIFT * self.period_ns;
        self.shift_ns = (-self.integral_ns).clamp(-most, most) as i64;
    }

    /// By how much the next grid point is moved, in ns: at most 1 % of a period.
    pub(super) fn shift_ns(&self) -> i64 {
        if self.is_in_lockstep { 0 } else { self.shift_ns }
    }

    /// By how much a grid that nothing depends on yet is moved to be where the clock wants it, in ns; `None` where it is near enough.
    pub(super) fn jump_ns(&mut self) -> Option<i64> {
        let is_far = self.last_ns.abs() > LOST * self.period_ns;
        if self.is_in_lockstep || self.has_settled || self.has_jumped || !is_far {
            return None;
        }
        (self.mean_ns, self.integral_ns, self.has_jumped) = (0.0, 0.0, true);
        Some(-self.last_ns as i64)
    }

    /// Last error, in ns.
    pub(super) fn last_ns(&self) -> i64 {
        self.last_ns as i64
    }

    /// Whether the grid has come to the clock.
    pub(super) fn has_settled(&self) -> bool {
        self.has_settled
    }

    /// Whether the clock is somewhere else than the grid.
    pub(super) fn is_lost(&self) -> bool {
        self.has_settled && self.wrong_for >= LOST_CYCLES
    }

    /// Share of a period beyond which two clocks of a segment are apart, in ns.
    pub(super) fn lost_ns(&self) -> i64 {
        (LOST * self.period_ns) as i64
    }

    /// How near the clocks of a segment have to be before outputs act, in ns.
    pub(super) fn settled_ns(&self) -> i64 {
        (SETTLED * self.period_ns) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(1);
    const PHASE: Duration = Duration::from_micros(100);

    /// Runs the servo against a clock that is fast by so many ppb, from a start phase; the errors.
    fn run(drift_ppb: f64, start_ns: f64, cycles: usize, mut jump: impl FnMut(usize) -> f64) -> (GridServo, Vec<f64>) {
        let mut servo = GridServo::new(PERIOD, PHASE);
        let mut host_ns = 1e9;
        let mut jumped = 0.0;
        let mut errors = Vec::new();
        for cycle in 0..cycles {
            jumped += jump(cycle);
            let system = host_ns * (1.0 + drift_ppb * 1e-9) + start_ns + jumped;
            servo.on_time(system as u64);
            errors.push(servo.error_ns(system as u64));
            host_ns += 1e6 + servo.shift_ns() as f64;
        }
        (servo, errors)
    }

    #[test]
    fn the_grid_comes_to_the_clock_and_stays() {
        for drift_ppb in [-50_000.0, 0.0, 50_000.0] {
            for start_ns in [0.0, 123_456.0, 600_000.0, 999_999.0] {
                let (servo, errors) = run(drift_ppb, start_ns, 1000, |_| 0.0);
                assert!(servo.has_settled() && !servo.is_lost());
                let worst = errors[600..].iter().fold(0.0f64, |worst, error| worst.max(error.abs()));
                assert!(worst <= 5.0, "{drift_ppb} ppb from {start_ns}: {worst} ns");
            }
        }
    }

    #[test]
    fn a_grid_that_nothing_depends_on_is_there_in_100_cycles_at_any_period() {
        for period_ns in [1_000_000_u64, 20_000_000] {
            let mut servo = GridServo::new(Duration::from_nanos(period_ns), PHASE);
            let mut now = 700_000;
            let cycles = (1..=100).find(|_| {
                servo.on_time(now);
                let shift_ns = servo.jump_ns().unwrap_or(servo.shift_ns());
                now = (now + period_ns).saturating_add_signed(shift_ns);
                servo.has_settled()
            });
            assert!(cycles.is_some(), "{period_ns}: {servo:?}");
            servo.on_time(now + period_ns / 3);
            assert_eq!(servo.jump_ns(), None, "drives may be enabled");
        }
    }

    #[test]
    fn a_grid_point_is_moved_by_one_hundredth_of_a_period_at_most() {
        let mut servo = GridServo::new(PERIOD, PHASE);
        for time in (0..3_000_000u64).step_by(7919) {
            servo.on_time(time);
            assert!(servo.shift_ns().abs() <= 10_000);
        }
    }

    #[test]
    fn a_jump_of_100_us_is_seen_and_jitter_is_not() {
        let (servo, _) = run(0.0, 0.0, 603, |cycle| if cycle == 600 { 100_000.0 } else { 0.0 });
        assert!(servo.is_lost());
        let (servo, _) = run(0.0, 0.0, 2000, |cycle| if cycle > 300 { [40_000.0, -40_000.0][cycle % 2] } else { 0.0 });
        assert!(!servo.is_lost());
    }

    #[test]
    fn while_the_clock_is_silent_the_grid_keeps_its_rate() {
        let (mut servo, _) = run(50_000.0, 0.0, 1000, |_| 0.0);
        servo.on_silence();
        assert!((servo.shift_ns() + 50).abs() <= 2, "{}", servo.shift_ns());
    }
}
