//! Margins against published figures, against the time domain and against their own definition.

use crate::elementary;
use nalgebra::{Matrix2, Vector2};
use proptest::prelude::*;

use crate::control::stability::{is_stable_about_one, product};
use crate::control::*;

const PAPER_INERTIAS: [f64; 3] = [0.28, 0.345, 0.41];

fn servo(stiffness: f64, damping: f64, integral: f64, delay_cycles: f64) -> ServoLoop {
    ServoLoop { gains: Gains { stiffness, damping, integral }, period_s: 1e-3, delay_cycles }
}

fn scaled(servo: ServoLoop, db: f64) -> ServoLoop {
    let factor = elementary::powf(10.0, db / 20.0);
    let Gains { stiffness, damping, integral } = servo.gains;
    let gains = Gains { stiffness: stiffness * factor, damping: damping * factor, integral: integral * factor };
    ServoLoop { gains, ..servo }
}

#[test]
fn stiff_gains_lose_their_margins_to_one_cycle_of_delay() {
    for inertia in PAPER_INERTIAS {
        let at = |delay, viscous| margins(&servo(20000.0, 120.0, 200000.0, delay), inertia, viscous).unwrap();
        assert!((at(0.0, 0.5).phase_deg - 46.0).abs() < 1.5);
        let one = at(1.0, 0.5);
        assert!(one.stable && one.phase_deg > 17.5 && one.phase_deg < 27.0, "{one:?}");
        assert!(one.gain_db > 3.4 && one.gain_db < 6.8, "{one:?}");
        let two = at(2.0, 0.5);
        assert!(two.gain_db < 1.7 && two.phase_deg < 7.1, "{two:?}");
    }
    assert!(!worst_margins(&servo(20000.0, 120.0, 200000.0, 2.0), &PAPER_INERTIAS, 0.5).unwrap().stable);
}

#[test]
fn softer_gains_keep_6_db_and_about_45_degrees_at_one_cycle() {
    for damping in [60.0, 70.0, 80.0] {
        let worst = worst_margins(&servo(6000.0, damping, 30000.0, 1.0), &PAPER_INERTIAS, 5.0).unwrap();
        assert!(worst.stable && worst.gain_db > 8.0 && worst.phase_deg > 44.9, "{worst:?}");
        let bare = worst_margins(&servo(6000.0, damping, 30000.0, 1.0), &PAPER_INERTIAS, 0.0).unwrap();
        assert!(bare.stable && bare.gain_db > 6.0 && bare.phase_deg > 40.0, "{bare:?}");
    }
}

#[test]
fn proportional_and_derivative_action_without_delay_has_closed_forms() {
    // L(z) = (K + B (z-1)/(T z)) T^2 (z+1)/(2 J (z-1)^2). In w = z - 1 at the critical gain, with x = K T^2/(2 J) and
    // y = B T/(2 J): z (z-1)^2 + (x z + y (z-1)) (z+1) g = 0; the root leaves through z = -1 never, so by Jury's
    // conditions on z^3 + (g(x+y) - 2) z^2 + (1 + g x) z - g y: the critical g solves
    // 1 - (g y)^2 = |(1 + g x) + g y (g(x+y) - 2)|.
    let (k, b, t, j) = (6000.0, 70.0, 1e-3, 0.35);
    let (x, y) = (k * t * t / (2.0 * j), b * t / (2.0 * j));
    // (1 + g x) + g^2 y (x+y) - 2 g y = 1 - g^2 y^2 -> g = (2 y - x)/(y (x + 2 y)).
    let critical = (2.0 * y - x) / (y * (x + 2.0 * y));
    let found = margins(&servo(k, b, 0.0, 0.0), j, 0.0).unwrap();
    assert!((found.gain_db - 20.0 * elementary::log10(critical)).abs() < 1e-9, "{found:?} {critical}");
    assert_eq!(found.gain_reduction_db, f64::INFINITY);
}

#[test]
fn integral_action_needs_a_least_gain_that_viscous_friction_provides() {
    // Continuous limit: J s^3 + g (B s^2 + K s + L) is stable iff g > J L/(B K).
    let (k, b, l, j) = (6000.0, 70.0, 30000.0, 0.35);
    let fast = ServoLoop { period_s: 1e-6, ..servo(k, b, l, 0.0) };
    let found = margins(&fast, j, 0.0).unwrap();
    assert!((found.gain_reduction_db + 20.0 * elementary::log10(j * l / (b * k))).abs() < 1e-2, "{found:?}");
    // With friction b and K b > J L any small gain will do.
    assert_eq!(margins(&fast, j, 2.0).unwrap().gain_reduction_db, f64::INFINITY);
    assert!(margins(&fast, j, 1.7).unwrap().gain_reduction_db.is_finite());
}

#[test]
fn damping_alone_on_a_delayed_double_integrator_is_unstable_without_stiffness_margin() {
    // No damping at all: nothing stabilises a double integrator.
    let none = margins(&servo(6000.0, 0.0, 0.0, 1.0), 0.35, 0.0).unwrap();
    assert!(!none.stable && none.phase_deg < 0.0 && none.delay_margin_s == 0.0, "{none:?}");
    assert_eq!((none.gain_db, none.gain_reduction_db), (f64::NEG_INFINITY, f64::NEG_INFINITY));
}

#[test]
fn an_unstable_loop_says_how_far_its_gain_must_fall() {
    let hot = scaled(servo(6000.0, 70.0, 30000.0, 1.0), 20.0);
    let found = margins(&hot, 0.35, 0.0).unwrap();
    assert!(!found.stable && found.gain_db < 0.0 && found.gain_reduction_db > 0.0 && found.phase_deg < 0.0);
    assert!(margins(&scaled(hot, found.gain_db - 0.01), 0.35, 0.0).unwrap().stable);
    assert!(!margins(&scaled(hot, found.gain_db + 0.01), 0.35, 0.0).unwrap().stable);
}

/// Largest distance in each quarter of a run of the loop from a unit disturbance, the plant exact in substeps and the
/// torque late by a whole number of substeps.
fn simulate(servo: &ServoLoop, inertia: f64, viscous: f64, cycles: usize) -> [f64; 4] {
    const SUBSTEPS: usize = 10;
    let late = (servo.delay_cycles * SUBSTEPS as f64).round() as usize;
    let h = servo.period_s / SUBSTEPS as f64;
    let decay = viscous / inertia;
    let (keep, coast, drift) = if decay == 0.0 {
        (1.0, h, 0.5 * h * h)
    } else {
        let coast = (1.0 - elementary::exp(-decay * h)) / decay;
        (elementary::exp(-decay * h), coast, (h - coast) / decay)
    };
    let mut pid = Pid::new(servo.gains, servo.period_s).unwrap();
    let mut queue = std::collections::VecDeque::from(vec![0.0; late]);
    let (mut position, mut rate) = (1.0, 0.0);
    let mut quarters = [0.0_f64; 4];
    pid.reset(0.0);
    for i in 0..cycles {
        let held = pid.step(-position, EffortRange::symmetric(1e200)).effort.clamp(-1e199, 1e199);
        for _ in 0..SUBSTEPS {
            queue.push_back(held);
            let acceleration = queue.pop_front().unwrap() / inertia;
            position += coast * rate + drift * acceleration;
            rate = keep * rate + coast * acceleration;
        }
        let quarter = &mut quarters[4 * i / cycles];
        *quarter = quarter.max(position.abs());
        if position.abs() > 1e30 {
            return [0.0, 0.0, 1.0, 2.0];
        }
    }
    quarters
}

fn random_servo() -> impl Strategy<Value = ServoLoop> {
    (2000.0..40000.0, 0.001..0.03, prop_oneof![Just(0.0), 1.0..20.0], 0_u32..30).prop_map(
        |(stiffness, damping_s, integral_per_s, tenths)| {
            servo(stiffness, stiffness * damping_s, stiffness * integral_per_s, f64::from(tenths) / 10.0)
        },
    )
}

fn viscous() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), 0.1..10.0]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn stable_is_what_the_time_domain_says(servo in random_servo(), inertia in 0.2..0.6, viscous in viscous()) {
        let found = margins(&servo, inertia, viscous).unwrap();
        // Nearer than this to the boundary a run would have to be longer.
        prop_assume!(found.gain_db.abs() > 0.5 && found.gain_reduction_db.abs() > 0.5);
        let [_, _, third, fourth] = simulate(&servo, inertia, viscous, 8000);
        let decays = fourth < third || fourth < 1e-12;
        prop_assert_eq!(found.stable, decays, "{:?} {} {}", found, third, fourth);
    }

    #[test]
    fn gain_margins_are_where_stability_changes(servo in random_servo(), inertia in 0.2..0.6, viscous in viscous()) {
        let found = margins(&servo, inertia, viscous).unwrap();
        let stable_at = |db: f64| margins(&scaled(servo, db), inertia, viscous).unwrap().stable;
        prop_assert_eq!(found.stable, found.gain_db > 0.0 && found.gain_reduction_db > 0.0);
        prop_assert_eq!(found.stable, found.phase_deg > 0.0);
        if found.gain_db.is_finite() {
            prop_assert!(stable_at(found.gain_db - 0.01) && !stable_at(found.gain_db + 0.01), "{:?}", found);
        }
        if found.gain_reduction_db.is_finite() {
            prop_assert!(stable_at(0.01 - found.gain_reduction_db) && !stable_at(-0.01 - found.gain_reduction_db));
        }
    }

    #[test]
    fn the_delay_margin_is_the_delay_that_destabilises(inertia in 0.28..0.41, damping in 60.0..80.0) {
        let servo = servo(6000.0, damping, 30000.0, 1.0);
        let more = margins(&servo, inertia, 0.0).unwrap().delay_margin_s / servo.period_s;
        let stable_at = |delay_cycles| margins(&ServoLoop { delay_cycles, ..servo }, inertia, 0.0).unwrap().stable;
        prop_assert!(stable_at(1.0 + 0.99 * more) && !stable_at(1.0 + 1.01 * more), "{}", more);
    }

    #[test]
    fn two_coupled_joints_are_two_loops_with_the_eigenvalues(
        a in 0.2..0.6, d in 0.2..0.6, share in -0.8..0.8, angle in 0.0..6.3,
    ) {
        let off = share * f64::sqrt(a * d);
        let mass = Matrix2::new(a, off, off, d);
        let eigenvalues = principal_inertias(&mass).unwrap();
        let eigen = mass.symmetric_eigen();
        let gains = Gains { stiffness: 6000.0, damping: 70.0, integral: 30000.0 };
        let inverse = mass.try_inverse().unwrap();
        let start = Vector2::new(elementary::cos(angle), elementary::sin(angle));
        let coupled = free_run(gains, start, |torque| inverse * torque);
        for i in 0..2 {
            let direction = eigen.eigenvectors.column(i).into_owned();
            let inertia = eigen.eigenvalues[i];
            prop_assert!(eigenvalues.iter().any(|value| (value - inertia).abs() < 1e-12));
            let single = free_run(gains, Vector2::new(direction.dot(&start), 0.0), |torque| torque / inertia);
            // A loop that is too light for its gains grows, and its rounding with it.
            prop_assert!((direction.dot(&coupled) - single.x).abs() < 1e-9 * (1.0 + coupled.norm()));
        }
    }
}

/// Position of two joints after 50 cycles from rest at `start`, same controller on both, one cycle of delay.
fn free_run(gains: Gains, start: Vector2<f64>, accelerate: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Vector2<f64> {
    let t = 1e-3;
    let mut laws = [Pid::new(gains, t).unwrap(), Pid::new(gains, t).unwrap()];
    let (mut position, mut rate, mut torque) = (start, Vector2::zeros(), Vector2::zeros());
    for _ in 0..50 {
        let range = EffortRange::symmetric(1e9);
        let next = Vector2::new(laws[0].step(-position.x, range).effort, laws[1].step(-position.y, range).effort);
        let acceleration = accelerate(torque);
        position += rate * t + acceleration * (0.5 * t * t);
        rate += acceleration * t;
        torque = next;
    }
    position
}

#[test]
fn worst_is_the_least_of_each_figure() {
    let servo = servo(6000.0, 70.0, 30000.0, 1.0);
    let all = PAPER_INERTIAS.map(|inertia| margins(&servo, inertia, 0.0).unwrap());
    let worst = worst_margins(&servo, &PAPER_INERTIAS, 0.0).unwrap();
    let least = |figure: fn(&Margins) -> f64| all.iter().map(figure).fold(f64::INFINITY, f64::min);
    assert_eq!(worst.gain_db, least(|m| m.gain_db));
    assert_eq!(worst.gain_reduction_db, least(|m| m.gain_reduction_db));
    assert_eq!(worst.phase_deg, least(|m| m.phase_deg));
    assert_eq!(worst.delay_margin_s, least(|m| m.delay_margin_s));
    assert_eq!(worst.crossover_hz, all.iter().find(|m| m.phase_deg == worst.phase_deg).unwrap().crossover_hz);
    assert_eq!(worst_margins(&servo, &[], 0.0), Err(ControlError::NoInertia));
}

#[test]
fn bad_parameters_are_refused() {
    let good = servo(6000.0, 70.0, 30000.0, 1.0);
    for value in [f64::NAN, f64::INFINITY, -1.0] {
        assert!(margins(&good, value, 0.0).is_err() && margins(&good, 0.35, value).is_err());
        assert!(margins(&ServoLoop { period_s: value, ..good }, 0.35, 0.0).is_err());
        assert!(margins(&ServoLoop { delay_cycles: value, ..good }, 0.35, 0.0).is_err());
    }
    assert!(margins(&ServoLoop { delay_cycles: MAX_DELAY_CYCLES + 0.1, ..good }, 0.35, 0.0).is_err());
    assert!(margins(&ServoLoop { delay_cycles: MAX_DELAY_CYCLES, ..good }, 0.35, 0.0).is_ok());
    for bad in [
        Matrix2::new(1.0, 2.0, 2.0, 1.0),
        Matrix2::new(1.0, 0.1, 0.0, 1.0),
        Matrix2::new(f64::NAN, 0.0, 0.0, 1.0),
        Matrix2::new(f64::INFINITY, 0.0, 0.0, 1.0),
        Matrix2::zeros(),
        -Matrix2::identity(),
    ] {
        assert!(matches!(principal_inertias(&bad), Err(ControlError::NotPositiveDefinite { .. })), "{bad}");
    }
}

/// The polynomial in `z - 1` with the given real roots and pairs (real and imaginary part) in `z`.
fn with_roots(real: &[f64], pairs: &[(f64, f64)]) -> Vec<f64> {
    let linear = real.iter().map(|root| vec![1.0 - root, 1.0]);
    let quadratic = pairs.iter().map(|(re, im)| vec![(1.0 - re) * (1.0 - re) + im * im, 2.0 * (1.0 - re), 1.0]);
    linear.chain(quadratic).fold(vec![-2.0], |p, factor| product(&p, &factor))
}

#[test]
fn stability_test_on_known_roots() {
    let stable = |real: &[f64], pairs: &[(f64, f64)]| is_stable_about_one(&with_roots(real, pairs));
    assert!(stable(&[], &[]) && stable(&[0.0, 0.0, -0.999, 0.999], &[(0.6, 0.7), (-0.6, 0.79)]));
    assert!(!stable(&[0.0, 1.001], &[]) && !stable(&[0.0, -1.001], &[]) && !stable(&[0.0], &[(0.75, 0.7)]));
    assert!(!stable(&[1.0], &[]) && !stable(&[0.5, 1.0], &[]));
    // Where powers of z would drown: distances of 1e-9 and 1e-4 from one.
    assert!(stable(&[1.0 - 1e-9, 1.0 - 1e-4, 1.0 - 1e-4, 0.0], &[(1.0 - 1e-4, 1e-4)]));
    assert!(!stable(&[1.0 + 1e-9, 1.0 - 1e-4, 1.0 - 1e-4, 0.0], &[(1.0 - 1e-4, 1e-4)]));
    assert!(!is_stable_about_one(&[f64::NAN, 1.0]) && !is_stable_about_one(&[1.0, f64::INFINITY, 1.0]));
}

proptest! {
    #[test]
    fn stability_test_on_random_roots(
        real in prop::collection::vec(-1.2..1.2, 0..6), pairs in prop::collection::vec((-1.2..1.2, 0.0..1.2), 0..6),
    ) {
        let sizes = real.iter().map(|root: &f64| root.abs()).chain(pairs.iter().map(|(re, im)| elementary::hypot(*re, *im)));
        let radius = sizes.fold(0.0, f64::max);
        prop_assume!((radius - 1.0).abs() > 1e-3);
        prop_assert_eq!(is_stable_about_one(&with_roots(&real, &pairs)), radius < 1.0, "{}", radius);
    }
}
