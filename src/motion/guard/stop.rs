//! The ramp along which the reference comes to rest.

use crate::quantity::{TipPoint, TipVelocity};

/// A straight, jerk-limited stop: the velocity falls by the smooth step `1 - 3 s^2 + 2 s^3` of the time share `s`.
///
/// With the greatest deceleration `a` the ramp from speed `v` takes `1.5 v / a` and covers `0.75 v^2 / a`; its jerk is
/// at most `4 a^2 / (1.5 v)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopRamp {
    start: TipPoint,
    velocity: TipVelocity,
    duration_s: f64,
    elapsed_s: f64,
}

impl StopRamp {
    /// Creates a ramp from `start` and `velocity` with at most `deceleration_m_per_s2` (positive).
    ///
    /// Real-time: yes.
    pub fn new(start: TipPoint, velocity: TipVelocity, deceleration_m_per_s2: f64) -> Self {
        let duration_s = 1.5 * velocity.norm() / deceleration_m_per_s2;
        Self { start, velocity, duration_s, elapsed_s: 0.0 }
    }

    /// Returns the reference `period_s` later.
    ///
    /// Real-time: yes.
    pub fn advance(&mut self, period_s: f64) -> TipPoint {
        self.elapsed_s = (self.elapsed_s + period_s).min(self.duration_s);
        if self.duration_s <= 0.0 {
            return self.start;
        }
        let s = self.elapsed_s / self.duration_s;
        // At its first velocity it would go as far in this time.
        let moving_s = self.duration_s * s * (1.0 - s * s * (1.0 - 0.5 * s));
        self.start + self.velocity.for_s(moving_s)
    }

    /// Whether the reference has come to rest.
    pub fn is_at_rest(&self) -> bool {
        self.elapsed_s >= self.duration_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_starts_at_its_velocity_and_stops_within_its_deceleration(vx in -1.0..1.0f64, vy in -1.0..1.0f64, a in 1.0..50.0f64) {
            let velocity = TipVelocity::new(vx, vy);
            let mut ramp = StopRamp::new(TipPoint::new(0.1, 0.2), velocity, a);
            let period = 1e-4;
            let mut last = TipPoint::new(0.1, 0.2);
            let mut last_velocity = velocity;
            let (mut cycles, longest) = (0.0, 1.5 * last_velocity.norm() / (a * period) + 1.0);
            while !ramp.is_at_rest() {
                let now = ramp.advance(period);
                let velocity = (now - last).over_s(period);
                let slack = if ramp.is_at_rest() { 2.0 } else { 1.0 };
                prop_assert!((velocity - last_velocity).norm() <= slack * a * period * (1.0 + 1e-6) + 1e-9);
                (last, last_velocity) = (now, velocity);
                cycles += 1.0;
                prop_assert!(cycles <= longest, "{cycles} cycles");
            }
            let speed = velocity.norm();
            let way = (last - TipPoint::new(0.1, 0.2)).norm();
            prop_assert!((way - 0.75 * speed * speed / a).abs() < 1e-9);
            prop_assert_eq!(ramp.advance(period), last);
        }
    }

    #[test]
    fn half_way_in_time_it_has_gone_thirteen_sixteenths_of_its_way() {
        // 1 m/s at 15 m/s^2 takes 0.1 s and 0.05 m: v T s (1 - s^2 (1 - s / 2)) at s = 1/2.
        let mut ramp = StopRamp::new(TipPoint::new(0.0, 0.0), TipVelocity::new(1.0, 0.0), 15.0);
        let way = ramp.advance(0.05).x();
        assert!((way - 0.05 * 13.0 / 16.0).abs() < 1e-12, "{way}");
    }

    #[test]
    fn at_rest_it_stays() {
        let mut ramp = StopRamp::new(TipPoint::new(0.1, 0.2), TipVelocity::default(), 10.0);
        assert!(ramp.is_at_rest());
        assert_eq!(ramp.advance(1e-3), TipPoint::new(0.1, 0.2));
    }
}
