//! The stable virtual masses against closed forms, other computations and their own laws.

use crate::elementary;
use proptest::prelude::*;

use super::super::stability::{is_stable_about_one, product, sum};
use super::*;

const PERIOD_S: f64 = 1e-3;
const GAINS: Gains = Gains { stiffness: 4000.0, damping: 45.0, integral: 0.0 };
/// A drive that is on its line all the time.
const STIFF: Follower =
    Follower::Drive { gains: Gains { stiffness: 1.6e9, damping: 4e4, integral: 0.0 }, period_s: 1e-5 };

fn host(factor: f64, delay_cycles: f64) -> Follower {
    let gains = Gains { stiffness: factor * GAINS.stiffness, damping: factor * GAINS.damping, integral: 0.0 };
    Follower::Host { gains, delay_cycles }
}

fn pose(inertia: f64, lever_m: f64) -> Pose {
    Pose {
        mass: Matrix2::identity() * inertia,
        viscous: Matrix2::zeros(),
        jacobian: Matrix2::new(-lever_m, -lever_m, -lever_m, lever_m) / 2.0_f64.sqrt(),
        forward_mass: Matrix2::zeros(),
        forward_viscous: Matrix2::zeros(),
        gears: None,
    }
}

/// Forces that are so many cycles old.
fn outer(age_cycles: f64) -> Outer {
    let sampling = Sampling { oldest_s: age_cycles * PERIOD_S, ..Sampling::at_sync(PERIOD_S) };
    Outer { period_s: PERIOD_S, sampling, low_pass: None, damping_n_s_per_m: 0.0, handle_kg: 0.0, compensation: None }
}

fn grip(stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> Grip {
    Grip { stiffness_n_per_m, damping_n_s_per_m, mass_kg: 0.0 }
}

fn masses(follower: &Follower, pose: &Pose, grip: &Grip, outer: &Outer) -> Option<StableMasses> {
    let phases = outer.sampling.phases;
    let loops: Vec<_> = (0..phases).map(|phase| HeldLoop::new(follower, pose, grip, outer, phase).unwrap()).collect();
    stable_masses(&loops)
}

fn least_kg(follower: &Follower, pose: &Pose, grip: &Grip, outer: &Outer) -> f64 {
    masses(follower, pose, grip, outer).map_or(f64::INFINITY, |found| found.least_kg)
}

/// The tool is on the line, so `h = -K r3 - B (r3 - r4)/T` for a force of SYNC, with `r3` the end of the line of the cycle before. By
/// Jury's test `z^3 - 2 z^2 + (1 + k + b) z - b` is stable from `M = B^2 T/(B - K T)` on.
#[test]
fn a_drive_that_is_on_its_line_has_a_closed_form() {
    let heavy = pose(1.0, 0.25);
    for (stiffness, damping) in [(500.0, 15.0), (2000.0, 10.0), (5000.0, 8.0)] {
        let expected = damping * damping * PERIOD_S / (damping - stiffness * PERIOD_S);
        let found = masses(&STIFF, &heavy, &grip(stiffness, damping), &outer(0.0)).unwrap();
        assert!((found.least_kg / expected - 1.0).abs() < 0.01, "{} {expected}", found.least_kg);
        assert_eq!(found.greatest_kg, f64::INFINITY);
    }
    assert_eq!(masses(&STIFF, &heavy, &grip(5000.0, 4.9), &outer(0.0)), None, "B < K T");
}

/// Whether the reference on its own polynomial is stable: the force is felt `age` of a cycle before SYNC, on the line of then.
fn on_the_line(mass_kg: f64, grip: &Grip, age: f64) -> bool {
    let t = PERIOD_S;
    let [k, b] = [grip.stiffness_n_per_m * t * t, grip.damping_n_s_per_m * t].map(|force| force / mass_kg);
    // In d = z - 1: z d^2, and position and rate on the line from z^0 to z^1 at the share 1 - age.
    let inertia = product(&[1.0, 1.0], &[0.0, 0.0, 1.0]);
    let position = sum(&[1.0], 1.0 - age, &[0.0, 1.0]);
    is_stable_about_one(&sum(&sum(&inertia, k, &position), b, &[0.0, 1.0]))
}

#[test]
fn a_sensor_with_its_own_clock_is_as_old_as_its_phase_says() {
    let heavy = pose(1.0, 0.25);
    let hand = grip(3000.0, 6.0);
    for (oldest, phases, phase, age) in [(1.0, 5, 1, 0.75), (1.0, 3, 1, 0.5), (1.0, 17, 15, 0.0625), (0.8, 5, 4, 0.8)] {
        let sampling = Sampling { oldest_s: oldest * PERIOD_S, phases, ..Sampling::at_sync(PERIOD_S) };
        let outer = Outer { sampling, ..outer(0.0) };
        let held = HeldLoop::new(&STIFF, &heavy, &hand, &outer, phase).unwrap();
        let found = stable_masses(&[held]).unwrap().least_kg;
        assert!(on_the_line(1.05 * found, &hand, age) && !on_the_line(0.95 * found, &hand, age), "{age}: {found}");
    }
}

/// Bound from both sides: the samples of a slow sensor are no older than the oldest and no younger than the youngest.
#[test]
fn a_slow_sensor_is_between_its_ages() {
    let hand = grip(400.0, 15.0);
    let slow =
        Outer { sampling: Sampling { interval_s: 5.0 * PERIOD_S, oldest_s: 5.0 * PERIOD_S, phases: 1 }, ..outer(0.0) };
    let of = |outer: &Outer| least_kg(&STIFF, &pose(1.0, 0.25), &hand, outer);
    let [young, found, old] = [of(&outer(1.0)), of(&slow), of(&outer(5.0))];
    assert!(young < found && found < old, "{young} {found} {old}");
}

#[test]
fn two_samples_in_three_cycles_have_one_pattern() {
    let sampling = Sampling { interval_s: 1.5 * PERIOD_S, oldest_s: 1.5 * PERIOD_S, phases: 3 };
    let hand = grip(400.0, 15.0);
    let of = |outer: &Outer| least_kg(&STIFF, &pose(1.0, 0.25), &hand, outer);
    let [young, found, old] = [of(&outer(0.5)), of(&Outer { sampling, ..outer(0.0) }), of(&outer(1.5))];
    assert!(young < found && found < old, "{young} {found} {old}");
}

/// A stiff hand holds a servo with an integral. Only the heaviest masses drift, above the mass where the lag by the integral uses up the
/// damping, and the lag predicts this.
#[test]
fn an_integral_makes_heavy_masses_drift_and_leaves_the_others() {
    let servo =
        Follower::Host { gains: Gains { stiffness: 10_000.0, damping: 95.0, integral: 150_000.0 }, delay_cycles: 1.0 };
    let pose = pose(0.35, 0.3);
    let stiff = grip(8000.0, 25.0);
    let found = masses(&servo, &pose, &stiff, &outer(0.0)).unwrap();
    assert!(found.greatest_kg.is_finite() && found.greatest_kg > 10.0 && found.least_kg < 2.0, "{found:?}");
    // 8000 N/m over 150 000 N m/(rad s) at 0.3 m, less the cycle that the fixture is ahead.
    let lag = lag_s(&servo, &pose, &stiff, &outer(0.0)).unwrap();
    assert!((lag - (8000.0 * 0.09 / 150_000.0 - PERIOD_S)).abs() < 1e-12, "{lag}");
    for factor in [0.8, 1.25] {
        let hand = grip(8000.0, factor * lag * 8000.0);
        let found = masses(&servo, &pose, &hand, &outer(0.0)).unwrap();
        assert_eq!(found.greatest_kg.is_finite(), factor < 1.0, "{factor}: {found:?}");
    }
}

#[test]
fn a_low_pass_lags_by_its_delay() {
    let pose = pose(0.28, 0.25);
    let slow = Outer { low_pass: Some((10.0, PERIOD_S)), ..outer(0.0) };
    // 15.4 ms of low pass less a cycle.
    let lag = lag_s(&host(1.0, 0.0), &pose, &grip(50.0, 1.0), &slow).unwrap();
    assert!((lag - (1e-3 / elementary::exp_m1(std::f64::consts::TAU * 0.01) - 1e-3)).abs() < 1e-12, "{lag}");
    for factor in [0.9, 1.1] {
        let found = masses(&host(1.0, 0.0), &pose, &grip(50.0, factor * lag * 50.0), &slow);
        assert_eq!(found.is_some_and(|found| found.greatest_kg == f64::INFINITY), factor > 1.0, "{found:?}");
    }
}

#[test]
fn a_servo_that_is_unstable_by_itself_carries_no_mass() {
    assert_eq!(masses(&host(4.0, 8.0), &pose(0.28, 0.25), &grip(300.0, 15.0), &outer(0.0)), None);
}

#[test]
fn the_range_is_that_of_the_worst_of_all_loops() {
    let of = |lever_m: f64| HeldLoop::new(&host(1.0, 1.0), &pose(0.28, lever_m), &grip(3000.0, 15.0), &outer(0.0), 0);
    let [long, short] = [of(0.3).unwrap(), of(0.2).unwrap()];
    let alone = [&long, &short].map(|one| stable_masses(std::slice::from_ref(one)).unwrap());
    let worst = alone[0].least_kg.max(alone[1].least_kg);
    let again = alone[0].narrowed(1, &long).unwrap();
    assert_eq!((again.least_at, again.greatest_kg), (0, f64::INFINITY));
    for (order, worst_at) in [([long.clone(), short.clone()], 0), ([short, long], 1)] {
        let both = stable_masses(&order).unwrap();
        assert!((both.least_kg / worst - 1.0).abs() < 0.003, "{both:?} {alone:?}");
        let is_first_worst = alone[0].least_kg > alone[1].least_kg;
        assert_eq!(both.least_at, if is_first_worst { worst_at } else { 1 - worst_at });
    }
    assert_eq!(stable_masses(&[]), None);
}

#[test]
fn the_longest_run_is_found() {
    assert_eq!(longest_run(&[true, false, true, true, false, true]), Some([2, 3]));
    assert_eq!(longest_run(&[false, true]), Some([1, 1]));
    assert_eq!(longest_run(&[false; 3]), None);
}

#[test]
fn a_passive_mass_is_that_of_the_arm() {
    let pose = Pose { mass: Matrix2::new(0.3, 0.02, 0.02, 0.25), ..pose(0.28, 0.25) };
    // J^-T M J^-1 by hand: eigenvalues of M over 0.25^2.
    let heaviest = passive_mass_kg(&pose).unwrap();
    assert!((heaviest - (0.275 + elementary::hypot(0.025, 0.02)) / 0.0625).abs() < 1e-12, "{heaviest}");
}

/// A mass that moves slowly leaves the servo alone: it is stable where its own polynomial says so, at delays that are no whole cycles too.
#[test]
fn a_servo_is_stable_with_a_heavy_mass_where_it_is_by_itself() {
    let is_stable_alone = |factor: f64, delay_cycles: f64| {
        let Follower::Host { gains, .. } = host(factor, delay_cycles) else { unreachable!() };
        super::super::is_stable(&super::super::ServoLoop { gains, period_s: PERIOD_S, delay_cycles }, 0.28, 0.0)
            .unwrap()
    };
    for delay_cycles in [0.0, 0.1, 0.25, 0.5, 0.9, 1.0, 1.3, 2.75] {
        let (mut stable, mut unstable) = (1.0, 100.0);
        assert!(is_stable_alone(stable, delay_cycles) && !is_stable_alone(unstable, delay_cycles));
        while unstable / stable > 1.001 {
            let middle: f64 = (stable * unstable).sqrt();
            if is_stable_alone(middle, delay_cycles) { stable = middle } else { unstable = middle }
        }
        let held = |factor: f64| {
            let one = HeldLoop::new(&host(factor, delay_cycles), &pose(0.28, 0.25), &grip(1.0, 1.0), &outer(0.0), 0);
            one.unwrap().spectral_radius(1e3).unwrap()
        };
        assert!(held(0.98 * stable) < 1.0 && held(1.02 * unstable) > 1.0, "{delay_cycles}: {stable}");
    }
}

#[test]
fn nonsense_is_refused() {
    let (servo, pose, grip) = (host(1.0, 0.0), pose(0.28, 0.25), grip(1000.0, 15.0));
    let refused = |pose: &Pose, grip: &Grip, outer: &Outer| HeldLoop::new(&servo, pose, grip, outer, 0).is_err();
    assert!(!refused(&pose, &grip, &outer(0.0)));
    assert!(refused(&Pose { jacobian: Matrix2::zeros(), ..pose }, &grip, &outer(0.0)));
    assert!(refused(&Pose { mass: -pose.mass, ..pose }, &grip, &outer(0.0)));
    assert!(refused(&pose, &Grip { stiffness_n_per_m: f64::NAN, ..grip }, &outer(0.0)));
    assert!(refused(&pose, &grip, &outer(f64::NAN)));
    assert!(refused(&pose, &grip, &outer(-2.0)), "a sample after the cycle");
    let sampling =
        |interval_s, phases| Outer { sampling: Sampling { interval_s, oldest_s: 0.0, phases }, ..outer(0.0) };
    assert!(refused(&pose, &grip, &sampling(0.0, 1)) && refused(&pose, &grip, &sampling(PERIOD_S, 0)));
    assert!(refused(&pose, &grip, &Outer { low_pass: Some((0.0, PERIOD_S)), ..outer(0.0) }));
    for delay_cycles in [17.0, -0.5, f64::NAN] {
        let late = Follower::Host { gains: GAINS, delay_cycles };
        assert!(HeldLoop::new(&late, &pose, &grip, &outer(0.0), 0).is_err());
    }
    let frozen = Follower::Drive { gains: GAINS, period_s: 0.0 };
    assert!(HeldLoop::new(&frozen, &pose, &grip, &outer(0.0), 0).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Forces and masses have one unit: a hand, a servo and an arm that are all as many times stronger carry that many
    /// times the mass. The coordinates of the controllers do not matter where these are the same in all.
    #[test]
    fn the_least_mass_scales_with_all_forces(
        factor in 0.2_f64..5.0, stiffness in 500.0_f64..5000.0, damping in 12.0_f64..40.0, age in 0.0_f64..3.0,
    ) {
        let grip_by = |factor: f64| grip(factor * stiffness, factor * damping);
        let radius = |factor: f64, lever_m: f64, servo: f64, mass_kg: f64| {
            let pose = if lever_m == 1.0 {
                Pose { jacobian: Matrix2::identity(), ..pose(0.28 / 0.0625, 1.0) }
            } else {
                pose(0.28 * factor, lever_m)
            };
            let held = HeldLoop::new(&host(servo, 1.0), &pose, &grip_by(factor), &outer(age), 0).unwrap();
            held.spectral_radius(mass_kg).unwrap()
        };
        let one = radius(1.0, 0.25, 1.0, 0.5);
        prop_assert!((radius(factor, 0.25, factor, 0.5 * factor) - one).abs() < 1e-6, "{one}");
        prop_assert!((radius(1.0, 1.0, 16.0, 0.5) - one).abs() < 1e-6, "{one}");
    }
}

/// The servo's rate grows a thousand times in each of its periods: no power of that over a cycle is a number.
#[test]
fn a_servo_beyond_all_bounds_is_unstable_and_comes_to_an_end() {
    let gains = Gains { stiffness: 2e4, damping: 4e8, integral: 0.0 };
    let wild = Follower::Drive { gains, period_s: 1.25e-5 };
    assert_eq!(masses(&wild, &pose(1.0, 0.25), &grip(400.0, 15.0), &outer(0.0)), None);
}
