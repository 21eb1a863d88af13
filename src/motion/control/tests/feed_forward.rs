//! Feed-forward terms, the direction of the Coulomb term, and what they are worth on a joint that sticks.

use crate::elementary;
use nalgebra::{Matrix2, Vector2};
use proptest::prelude::*;

use super::joint::{Joint, PERIOD_S};
use crate::control::*;
use crate::quantity::JointRates;

const PARAMETERS: FeedForwardParameters = FeedForwardParameters {
    coulomb_n_m: [10.0, 8.0],
    viscous_n_m_s_per_rad: [0.5, 2.0],
    coulomb_transition_rad: FeedForwardParameters::DEFAULT_TRANSITION_RAD,
};

fn feed_forward() -> FeedForward {
    FeedForward::new(PARAMETERS, PERIOD_S).unwrap()
}

#[test]
fn the_terms_add_up() {
    let mut ff = feed_forward();
    let term = InertiaTerm {
        mass_matrix: Matrix2::new(0.4, 0.1, 0.1, 0.3),
        accelerations: Vector2::new(10.0, -20.0),
        bias_n_m: Vector2::new(0.25, -0.5),
    };
    let step = ff.step(JointRates::new(1.0, -2.0), Some(&term));
    assert_eq!(step.coulomb.to_array(), [10.0, -8.0]);
    // 10 + 0.5 + (4 - 2 + 0.25), -8 - 4 + (1 - 6 - 0.5)
    let [left, right] = step.torques.to_array();
    assert!(step.valid && (left - 12.75).abs() < 1e-12 && (right + 17.5).abs() < 1e-12, "{left} {right}");
}

#[test]
fn the_direction_follows_travel_and_is_kept_at_rest() {
    let mut ff = feed_forward();
    let mut coulomb = |rate: f64| ff.step(JointRates::new(rate, 0.0), None).coulomb.left();
    // 12.5 microradians per period: a quarter of the transition.
    for expected in [2.5, 5.0, 7.5, 10.0, 10.0] {
        assert!((coulomb(0.0125) - expected).abs() < 1e-12);
    }
    for _ in 0..10_000 {
        assert_eq!(coulomb(0.0), 10.0);
    }
    for expected in [7.5, 5.0, 2.5, 0.0, -2.5, -5.0, -7.5, -10.0, -10.0] {
        assert!((coulomb(-0.0125) - expected).abs() < 1e-12);
    }
    assert_eq!(coulomb(1.0), 10.0);
    ff.reset();
    assert_eq!(ff.step(JointRates::default(), None).torques.to_array(), [0.0, 0.0]);
}

#[test]
fn rounding_of_a_resting_proxy_does_not_chatter() {
    let mut ff = feed_forward();
    let mut last = 0.0;
    for i in 0..1000 {
        let rate = if i % 2 == 0 { 1e-13 } else { -1e-13 };
        let torque = ff.step(JointRates::new(rate, 0.0), None).torques.left();
        assert!((torque - last).abs() < 1e-10);
        last = torque;
    }
}

#[test]
fn an_impact_is_cut_by_the_range() {
    let mut ff = feed_forward();
    // A proxy stopped from 1 rad/s within one period.
    let term = InertiaTerm {
        mass_matrix: Matrix2::identity() * 0.35,
        accelerations: Vector2::new(-1000.0, 0.0),
        bias_n_m: Vector2::zeros(),
    };
    let torque = ff.step(JointRates::default(), Some(&term)).torques.left();
    assert_eq!(torque, -350.0);
    let (fed, range) = EffortRange::around(60.0, torque);
    assert_eq!((fed, range), (-60.0, EffortRange::new(0.0, 120.0)));
}

proptest! {
    #[test]
    fn torques_are_finite_for_any_input(
        steps in prop::collection::vec((any::<[f64; 2]>(), any::<[f64; 4]>(), any::<[f64; 2]>(), any::<[f64; 2]>()), 1..10),
    ) {
        let mut ff = feed_forward();
        for (rates, mass, acceleration, bias) in steps {
            let term = InertiaTerm {
                mass_matrix: Matrix2::from_row_slice(&mass),
                accelerations: Vector2::from(acceleration),
                bias_n_m: Vector2::from(bias),
            };
            let step = ff.step(JointRates::from(rates), Some(&term));
            prop_assert!(step.torques.is_finite() && step.coulomb.is_finite());
            prop_assert!(step.valid || step.torques.to_array() == [0.0, 0.0]);
            let [left, right] = step.coulomb.to_array();
            prop_assert!(left.abs() <= 10.0 && right.abs() <= 8.0);
        }
        let after = ff.step(JointRates::new(1.0, 1.0), None);
        prop_assert!(after.valid);
    }
}

#[test]
fn parameters_are_checked() {
    for value in [f64::NAN, f64::INFINITY, -1.0] {
        for bad in [
            FeedForwardParameters { coulomb_n_m: [0.0, value], ..PARAMETERS },
            FeedForwardParameters { viscous_n_m_s_per_rad: [value, 0.0], ..PARAMETERS },
            FeedForwardParameters { coulomb_transition_rad: value, ..PARAMETERS },
        ] {
            assert!(FeedForward::new(bad, PERIOD_S).is_err());
        }
        assert!(FeedForward::new(PARAMETERS, value).is_err());
    }
    let zero = FeedForwardParameters { coulomb_transition_rad: 0.0, ..PARAMETERS };
    assert!(FeedForward::new(zero, PERIOD_S).is_err());
}

/// Largest error (rad) and total change of the Coulomb term (N m/s) over 4 s of a desired motion, with one cycle of delay.
fn follow(coulomb_n_m: f64, real_coulomb_n_m: f64, desired: impl Fn(f64) -> f64) -> (f64, f64) {
    let gains = Gains { stiffness: 6000.0, damping: 70.0, integral: 30000.0 };
    let mut law = Psmc::new(gains, 0.02, PERIOD_S).unwrap();
    let parameters =
        FeedForwardParameters { coulomb_n_m: [coulomb_n_m, 0.0], viscous_n_m_s_per_rad: [0.5, 0.0], ..PARAMETERS };
    let mut ff = FeedForward::new(parameters, PERIOD_S).unwrap();
    let mut joint = Joint::at_rest(0.35, real_coulomb_n_m, 0.5);
    let (mut torque, mut before, mut coulomb) = (0.0, desired(0.0), 0.0);
    let (mut worst, mut change) = (0.0_f64, 0.0);
    for i in 0..4000 {
        let now = desired(f64::from(i) * PERIOD_S);
        let step = ff.step(JointRates::new((now - before) / PERIOD_S, 0.0), None);
        before = now;
        change += (step.coulomb.left() - coulomb).abs() / 4.0;
        coulomb = step.coulomb.left();
        let (fed, range) = EffortRange::around(60.0, step.torques.left());
        let error = now - joint.angle;
        worst = worst.max(error.abs());
        let next = fed + law.step(error, range).effort;
        joint.advance(torque);
        torque = next;
    }
    (worst, change)
}

fn slow_start(t: f64) -> f64 {
    1e-3 * (t - 0.5).clamp(0.0, 1.0) + 0.5e-3 * (t - 2.5).max(0.0)
}

fn swings(t: f64) -> f64 {
    0.05 * (1.0 - elementary::cos(std::f64::consts::PI * t))
}

#[test]
fn coulomb_feed_forward_takes_the_error_out_of_starts_and_reversals() {
    let (without, _) = follow(0.0, 10.0, slow_start);
    let (with, change) = follow(10.0, 10.0, slow_start);
    assert!(without > 0.6e-3 && with < 0.06e-3 && change < 3.0, "{without} {with} {change}");
    let (without, _) = follow(0.0, 10.0, swings);
    let (with, change) = follow(10.0, 10.0, swings);
    assert!(without > 2.5e-3 && with < 0.15e-3 && change < 20.0, "{without} {with} {change}");
}

#[test]
fn wrong_friction_by_a_fifth_still_takes_out_most_of_the_error() {
    for real in [8.0, 12.0] {
        let (without, _) = follow(0.0, real, swings);
        let (with, _) = follow(10.0, real, swings);
        assert!(with < 0.3 * without, "{real}: {without} {with}");
    }
}
