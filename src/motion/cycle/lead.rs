//! A reference that goes along the joints: each to a target of its own, within a rate and an acceleration.

use crate::quantity::{JointAngles, JointRates};

/// An angle that is no way, rad: below it a joint is at its target.
const NO_WAY_RAD: f64 = 1e-12;

/// Limits of the motion of guided joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeadLimits {
    /// Greatest rate of a joint in rad/s, positive.
    pub rate_rad_per_s: f64,
    /// Greatest acceleration of a joint in rad/s^2, positive.
    pub acceleration_rad_per_s2: f64,
}

impl LeadLimits {
    /// Returns the largest distance of a guided joint from its reference, rad: the lag of a drive in a few periods, and a little more. A
    /// joint that does not follow is stopped soon, whatever the reason.
    pub(super) fn following_error_rad(&self, period_s: f64) -> f64 {
        const LITTLE_RAD: f64 = 5e-3;
        const PERIODS: f64 = 3.0;
        LITTLE_RAD + PERIODS * period_s * self.rate_rad_per_s
    }

    /// Returns the angle and the rate of one joint after a period. The joint moves as fast as the limits let it come to rest at its target.
    /// A target that stays is reached exactly.
    ///
    /// With `v` the rate, `a` the acceleration and `T` the period, the way that is left has to be `v T + v^2 / (2 a)` at least, which
    /// gives `v = a (sqrt(T^2 + 2 d / a) - T)` for a way `d`.
    fn approach(&self, from_rad: f64, rate: f64, target_rad: f64, period_s: f64) -> (f64, f64) {
        let Self { rate_rad_per_s, acceleration_rad_per_s2: most } = *self;
        let way = target_rad - from_rad;
        let change = most * period_s;
        if way.abs() <= NO_WAY_RAD && rate.abs() <= change {
            return (target_rad, 0.0);
        }
        let stops = most * ((period_s * period_s + 2.0 * way.abs() / most).sqrt() - period_s);
        let wanted = stops.min(rate_rad_per_s).copysign(way);
        let rate = wanted.clamp(rate - change, rate + change);
        (from_rad + rate * period_s, rate)
    }
}

/// Targets of the guided joints, and their rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lead {
    limits: LeadLimits,
    targets: Option<JointAngles>,
    rates: JointRates,
}

impl Lead {
    /// Creates joints that are not guided yet.
    pub(super) fn new(limits: LeadLimits) -> Self {
        Self { limits, targets: None, rates: JointRates::default() }
    }

    /// Returns the same as [`LeadLimits::following_error_rad`].
    pub(super) fn following_error_rad(&self, period_s: f64) -> f64 {
        self.limits.following_error_rad(period_s)
    }

    /// Sets the angles at which the joints rest until they are guided elsewhere.
    pub(super) fn rest(&mut self, at: JointAngles) {
        (self.targets, self.rates) = (Some(at), JointRates::default());
    }

    /// Stops the guiding of all joints.
    pub(super) fn forget(&mut self) {
        (self.targets, self.rates) = (None, JointRates::default());
    }

    /// Guides joints that rest, or are guided already, to other targets.
    pub(super) fn lead_to(&mut self, targets: JointAngles) {
        self.targets = self.targets.map(|before| if targets.is_finite() { targets } else { before });
    }

    /// Whether the joints have reached their targets.
    pub(super) fn is_there(&self, at: JointAngles) -> bool {
        let is_near = |targets: JointAngles| (targets - at).norm() <= 2.0 * NO_WAY_RAD;
        self.targets.is_some_and(is_near) && self.rates == JointRates::default()
    }

    /// Returns the angles one period after `from`, the present reference of the joints.
    pub(super) fn step(&mut self, from: JointAngles, period_s: f64) -> JointAngles {
        let Some(targets) = self.targets else { return from };
        let of = |from, rate, target| self.limits.approach(from, rate, target, period_s);
        let (left, left_rate) = of(from.left(), self.rates.left(), targets.left());
        let (right, right_rate) = of(from.right(), self.rates.right(), targets.right());
        self.rates = JointRates::new(left_rate, right_rate);
        JointAngles::new(left, right)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_S: f64 = 1e-3;

    proptest! {
        #[test]
        fn each_joint_comes_to_rest_at_its_target_within_its_limits(
            way in -0.5..0.5f64, other in -0.5..0.5f64, most_rate in 0.01..1.0f64, most in 0.1..20.0f64,
            changed_after in 0usize..400, then in -0.3..0.3f64,
        ) {
            let mut lead = Lead::new(LeadLimits { rate_rad_per_s: most_rate, acceleration_rad_per_s2: most });
            let mut at = JointAngles::new(0.7, -0.2);
            lead.rest(at);
            lead.lead_to(JointAngles::new(0.7 + way, -0.2 + other));
            let mut rates = [0.0; 2];
            let mut cycles = 0usize;
            while cycles <= changed_after || !lead.is_there(at) {
                if cycles == changed_after {
                    lead.lead_to(JointAngles::new(0.7 + then, -0.2));
                }
                let next = lead.step(at, PERIOD_S);
                for (joint, rate) in rates.iter_mut().enumerate() {
                    let now = (next.to_array()[joint] - at.to_array()[joint]) / PERIOD_S;
                    prop_assert!(now.abs() <= most_rate + 1e-9);
                    prop_assert!((now - *rate).abs() <= most * PERIOD_S + 1e-9, "{now} after {rate}");
                    *rate = now;
                }
                at = next;
                cycles += 1;
                prop_assert!(cycles < 200_000, "it never arrives: {lead:?} {at:?}");
            }
            prop_assert_eq!(at, JointAngles::new(0.7 + then, -0.2));
        }
    }

    #[test]
    fn joints_that_are_not_led_stay_and_no_number_is_no_target() {
        let mut lead = Lead::new(LeadLimits { rate_rad_per_s: 0.1, acceleration_rad_per_s2: 1.0 });
        let at = JointAngles::new(0.1, 0.2);
        lead.lead_to(JointAngles::new(1.0, 1.0));
        assert_eq!(lead.step(at, PERIOD_S), at);
        lead.rest(at);
        lead.lead_to(JointAngles::new(f64::NAN, 1.0));
        assert_eq!(lead.step(at, PERIOD_S), at);
        assert!(lead.is_there(at));
    }

    #[test]
    fn a_way_takes_the_time_of_a_trapezoid() {
        let mut lead = Lead::new(LeadLimits { rate_rad_per_s: 0.1, acceleration_rad_per_s2: 1.0 });
        let mut at = JointAngles::new(0.0, 0.0);
        lead.rest(at);
        lead.lead_to(JointAngles::new(0.05, 0.0));
        let cycles = (1..1000_u32).find(|_| {
            at = lead.step(at, PERIOD_S);
            lead.is_there(at)
        });
        // 0.05 / 0.1 s, and 0.1 / 1 s for the two ramps.
        assert!(cycles.unwrap().abs_diff(600) <= 6, "{cycles:?}");
    }
}
