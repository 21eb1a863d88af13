//! One implicit time step of dry friction, solved exactly: which joints stick, and the new rates of those that slip.

use nalgebra::{Matrix2, Vector2};

use yieldwall_motion::setvalued::gsat;

/// The rates `v'` of two coupled joints for which `inertia v' + limit Sgn(v')` contains `impulse`.
///
/// Arguments: `inertia` (kg m^2) is symmetric and positive definite. `impulse` (N m s) is the momentum that the joints would have
/// after the step without dry friction. `limit` (N m s, each >= 0) is the greatest impulse of dry friction within the step.
///
/// A joint that sticks gets exactly `0.0`. The solution exists, is unique and depends continuously on `impulse`. A NaN in
/// `impulse` or `inertia` gives NaN in a rate; an inertia that is not positive definite gives a meaningless but bounded amount of
/// work.
///
/// There is no iteration. With joint 2 free to slip or stick and joint 1 held, the torque impulse left over on joint 1 shows
/// whether it breaks away and in which direction. The reason: the sought rates minimise a strictly convex function, and its
/// minimum over `v2` alone is convex in `v1`.
///
/// Real-time: yes.
///
/// # Source
/// The implicit step of \[KTF08, eqs 7 and 8\] for two variables; elimination derived here.
#[inline]
pub fn slip_rates(inertia: &Matrix2<f64>, impulse: Vector2<f64>, limit: Vector2<f64>) -> Vector2<f64> {
    if impulse.x.abs() <= limit.x && impulse.y.abs() <= limit.y {
        return Vector2::zeros();
    }
    let coupling = inertia.m12;

    let second_alone = slip_rate(inertia.m22, impulse.y, limit.y);
    let on_first = impulse.x - coupling * second_alone;
    if on_first.abs() <= limit.x {
        return Vector2::new(0.0, second_alone);
    }

    let first_alone = slip_rate(inertia.m11, impulse.x, limit.x);
    let on_second = impulse.y - coupling * first_alone;
    if on_second.abs() <= limit.y {
        return Vector2::new(first_alone, 0.0);
    }

    let net = Vector2::new(impulse.x - limit.x.copysign(on_first), impulse.y - limit.y.copysign(on_second));
    let determinant = inertia.m11 * inertia.m22 - coupling * coupling;
    let first = (inertia.m22 * net.x - coupling * net.y) / determinant;
    let second = (inertia.m11 * net.y - coupling * net.x) / determinant;
    // On the border between slip and stick, rounding may turn a rate round: it is zero there.
    Vector2::new(if first * on_first < 0.0 { 0.0 } else { first }, if second * on_second < 0.0 { 0.0 } else { second })
}

/// The rate `v'` of one joint for which `inertia v' + limit Sgn(v')` contains `impulse`; units as in [`slip_rates`].
///
/// `inertia` is positive; exactly `0.0` when the joint sticks.
///
/// Real-time: yes.
///
/// # Source
/// \[KTF08, eq. 7\].
#[inline]
pub fn slip_rate(inertia: f64, impulse: f64, limit: f64) -> f64 {
    (impulse - gsat(-limit, impulse, limit)) / inertia
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use yieldwall_motion::elementary;

    /// Distance of `impulse - inertia v` from the set `limit Sgn(v)`, the larger of the two joints.
    fn residual(inertia: &Matrix2<f64>, impulse: Vector2<f64>, limit: Vector2<f64>, rates: Vector2<f64>) -> f64 {
        let friction = impulse - inertia * rates;
        let distance = |friction: f64, limit: f64, rate: f64| {
            if rate == 0.0 { (friction.abs() - limit).max(0.0) } else { (friction - limit.copysign(rate)).abs() }
        };
        distance(friction.x, limit.x, rates.x).max(distance(friction.y, limit.y, rates.y))
    }

    fn direction(rate: f64) -> i8 {
        if rate > 0.0 {
            1
        } else if rate < 0.0 {
            -1
        } else {
            0
        }
    }

    /// Symmetric positive definite with eigenvalues in 0.05 to 5, any axes.
    fn inertia() -> impl Strategy<Value = Matrix2<f64>> {
        (0.05..5.0, 0.05..5.0, 0.0..std::f64::consts::PI).prop_map(|(first, second, turn): (f64, f64, f64)| {
            let (s, c) = elementary::sin_cos(turn);
            let coupling = (first - second) * s * c;
            Matrix2::new(first * c * c + second * s * s, coupling, coupling, first * s * s + second * c * c)
        })
    }

    fn limit() -> impl Strategy<Value = Vector2<f64>> {
        (prop_oneof![Just(0.0), 0.0..2.0], prop_oneof![Just(0.0), 0.0..2.0]).prop_map(|(x, y)| Vector2::new(x, y))
    }

    fn pair(size: f64) -> impl Strategy<Value = Vector2<f64>> {
        (-size..size, -size..size).prop_map(|(x, y)| Vector2::new(x, y))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        #[test]
        fn the_inclusion_holds(inertia in inertia(), impulse in pair(6.0), limit in limit()) {
            let rates = slip_rates(&inertia, impulse, limit);
            prop_assert!(residual(&inertia, impulse, limit, rates) < 1e-12);
        }

        /// Each region is entered on purpose: from its rates and a friction that belongs to them.
        #[test]
        fn every_region_returns_the_rates_it_was_made_from(
            inertia in inertia(),
            limit in (0.1..2.0, 0.1..2.0),
            size in (0.1..3.0, 0.1..3.0),
            hold in (-0.999..0.999, -0.999..0.999),
        ) {
            let limit = Vector2::new(limit.0, limit.1);
            for first in [-1i8, 0, 1] {
                for second in [-1i8, 0, 1] {
                    let rates = Vector2::new(f64::from(first) * size.0, f64::from(second) * size.1);
                    let share = |region: i8, hold: f64| if region == 0 { hold } else { f64::from(region) };
                    let friction = Vector2::new(limit.x * share(first, hold.0), limit.y * share(second, hold.1));
                    let found = slip_rates(&inertia, inertia * rates + friction, limit);
                    prop_assert_eq!((direction(found.x), direction(found.y)), (first, second));
                    prop_assert!((found - rates).norm() < 1e-11);
                }
            }
        }

        /// Non-expansive in the metric of the inertia, so a small change never jumps across a border.
        #[test]
        fn nearby_impulses_give_nearby_rates(
            inertia in inertia(), impulse in pair(4.0), change in pair(1e-6), limit in limit(),
        ) {
            let step = slip_rates(&inertia, impulse + change, limit) - slip_rates(&inertia, impulse, limit);
            let work = change.dot(&step) - step.dot(&(inertia * step));
            prop_assert!(work > -1e-14);
            prop_assert!(step.norm() <= change.norm() / 0.05 * (1.0 + 1e-6) + 1e-14);
        }

        #[test]
        fn borders_between_regions_are_met_from_both_sides(
            inertia in inertia(), limit in (0.1..2.0, 0.1..2.0), slip in 0.1..3.0, sides in (any::<bool>(), any::<bool>()),
        ) {
            let limit = Vector2::new(limit.0, limit.1);
            let sign = |side: bool| if side { 1.0 } else { -1.0 };
            // Joint 1 just holds while joint 2 slips.
            let rates = Vector2::new(0.0, sign(sides.1) * slip);
            let border = inertia * rates + Vector2::new(sign(sides.0) * limit.x, sign(sides.1) * limit.y);
            for beside in [-1e-9, 0.0, 1e-9] {
                let impulse = border + Vector2::new(beside, 0.0);
                let found = slip_rates(&inertia, impulse, limit);
                prop_assert!((found - rates).norm() < 1e-9 / 0.05 * 1.1);
                prop_assert!(residual(&inertia, impulse, limit, found) < 1e-12);
            }
        }

        #[test]
        fn friction_never_gives_energy(inertia in inertia(), impulse in pair(6.0), limit in limit()) {
            let rates = slip_rates(&inertia, impulse, limit);
            let friction = impulse - inertia * rates;
            // The residual's rounding, times the rate.
            let rounding = 1e-12 * rates.amax();
            prop_assert!(friction.x * rates.x >= -rounding && friction.y * rates.y >= -rounding);
        }

        #[test]
        fn uncoupled_joints_are_two_single_joints(m in (0.05..5.0, 0.05..5.0), impulse in pair(6.0), limit in limit()) {
            let rates = slip_rates(&Matrix2::new(m.0, 0.0, 0.0, m.1), impulse, limit);
            prop_assert!((rates.x - slip_rate(m.0, impulse.x, limit.x)).abs() < 1e-13);
            prop_assert!((rates.y - slip_rate(m.1, impulse.y, limit.y)).abs() < 1e-13);
        }

        #[test]
        fn a_single_joint_solves_its_inclusion(m in 0.05..5.0, impulse in -6.0..6.0, limit in 0.0..2.0) {
            let rate: f64 = slip_rate(m, impulse, limit);
            let friction: f64 = impulse - m * rate;
            let distance = if rate == 0.0 { (friction.abs() - limit).max(0.0) } else { (friction - limit.copysign(rate)).abs() };
            prop_assert!(distance < 1e-12);
        }
    }

    #[test]
    fn a_held_pair_is_exactly_at_rest() {
        let inertia = Matrix2::new(0.3, 0.1, 0.1, 0.2);
        let rates = slip_rates(&inertia, Vector2::new(0.999, -1.0), Vector2::new(1.0, 1.0));
        assert_eq!(rates, Vector2::zeros());
    }

    #[test]
    fn a_bad_impulse_is_not_hidden() {
        let inertia = Matrix2::new(0.3, 0.1, 0.1, 0.2);
        let rates = slip_rates(&inertia, Vector2::new(f64::NAN, 0.1), Vector2::new(1.0, 1.0));
        assert!(rates.iter().any(|rate| rate.is_nan()));
    }
}
