//! PSMC against PID and against the inclusion it solves; saturation, reset and bad input of all laws.

use crate::elementary;
use proptest::prelude::*;

use crate::control::*;

const WIDE: f64 = 1e12;

fn gains() -> impl Strategy<Value = Gains> {
    // Stiffness in powers of ten; damping and integral by their time constants.
    (2.0..5.0, 0.0..0.05, prop_oneof![Just(0.0), 0.1..20.0]).prop_map(|(k, b, l)| {
        let stiffness = elementary::powf(10.0, k);
        Gains { stiffness, damping: stiffness * b, integral: stiffness * l }
    })
}

fn sliding_time() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), 0.001..0.2]
}

/// A smooth error that starts at zero.
fn error_at(i: u32, frequency: f64) -> f64 {
    let t = f64::from(i) * 1e-3;
    0.01 * elementary::sin(frequency * t) * (1.0 + 0.3 * elementary::cos(1.7 * frequency * t))
}

/// Returns the largest difference between PSMC and PID over 2 s from zero error, divided by the largest sum of PID's terms. The scale is
/// the sum of the terms, since a backward difference subtracts two large numbers.
fn difference_from_pid(gains: Gains, h: f64, frequency: f64) -> f64 {
    let (mut psmc, mut pid) = (Psmc::new(gains, h, 1e-3).unwrap(), Pid::new(gains, 1e-3).unwrap());
    let (mut worst, mut size, mut before) = (0.0_f64, 0.0_f64, 0.0_f64);
    for i in 0..2000 {
        let e = error_at(i, frequency);
        let (a, b) = (psmc.step(e, EffortRange::symmetric(WIDE)), pid.step(e, EffortRange::symmetric(WIDE)));
        assert!(a.valid && b.valid && !a.saturated && !b.saturated);
        worst = worst.max((a.effort - b.effort).abs());
        let difference = gains.damping * (e.abs() + before.abs()) / 1e-3;
        size = size.max(gains.stiffness * e.abs() + difference + pid.integral_effort().abs());
        before = e;
    }
    worst / size
}

#[test]
fn psmc_is_the_pid_below_saturation() {
    let stiff = Gains { stiffness: 20000.0, damping: 120.0, integral: 200000.0 };
    for (gains, h) in [(STIFF, 0.02), (stiff, 0.02), (STIFF, 0.0), (Gains { integral: 0.0, ..STIFF }, 0.02)] {
        let difference = difference_from_pid(gains, h, 10.0);
        assert!(difference <= 1e-14, "{gains:?} {h}: {difference:e}");
    }
}

proptest! {
    #[test]
    fn psmc_is_the_pid_for_any_gains(gains in gains(), h in sliding_time(), frequency in 1.0..200.0) {
        let difference = difference_from_pid(gains, h, frequency);
        // The proxy forgets rounding with the time constant H: it gathers that of H/T steps.
        prop_assert!(difference <= 1e-14 + f64::EPSILON * h / 1e-3, "{:e}", difference);
    }
}

/// The inclusion itself, solved for the proxy's position by bisection, with positions instead of increments as state.
struct Inclusion {
    gains: Gains,
    h: f64,
    t: f64,
    desired_1: f64,
    measured_1: f64,
    proxy_1: f64,
    integral_1: f64,
}

impl Inclusion {
    fn step(&mut self, desired: f64, measured: f64, lower: f64, upper: f64) -> f64 {
        let t = self.t;
        let coupling = |q: f64| {
            let rate = ((q - self.proxy_1) - (measured - self.measured_1)) / t;
            let integral = self.integral_1 + t * (q - measured);
            self.gains.stiffness * (q - measured) + self.gains.damping * rate + self.gains.integral * integral
        };
        let sigma = |q: f64| desired - q + self.h * (desired - self.desired_1 - q + self.proxy_1) / t;
        // Greater than zero where q is too far out: the coupling rises with q, the sliding force falls.
        let excess = |q: f64| coupling(q) - if sigma(q) > 0.0 { upper } else { lower };
        let (mut low, mut high) = (-1e3, 1e3);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if excess(middle) > 0.0 { high = middle } else { low = middle }
        }
        let q = 0.5 * (low + high);
        let effort = coupling(q).clamp(lower, upper);
        self.integral_1 += t * (q - measured);
        (self.desired_1, self.measured_1, self.proxy_1) = (desired, measured, q);
        effort
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]
    #[test]
    fn psmc_solves_the_inclusion(
        gains in gains(),
        h in sliding_time(),
        lower in -60.0..-1.0,
        upper in 1.0..60.0,
        path in prop::collection::vec((-0.01..0.01, -0.01..0.01), 20),
    ) {
        let mut psmc = Psmc::new(gains, h, 1e-3).unwrap();
        psmc.reset(0.0);
        let (desired_1, measured_1, proxy_1, integral_1) = (0.0, 0.0, 0.0, 0.0);
        let mut oracle = Inclusion { gains, h, t: 1e-3, desired_1, measured_1, proxy_1, integral_1 };
        let (mut desired, mut measured) = (0.0, 0.0);
        for (desired_step, measured_step) in path {
            desired += desired_step;
            measured += measured_step;
            let expected = oracle.step(desired, measured, lower, upper);
            let got = psmc.step(desired - measured, EffortRange::new(lower, upper));
            prop_assert!((got.effort - expected).abs() <= 7.6e-7, "{:?} against {}", got, expected);
            prop_assert!((measured + psmc.proxy_offset() - oracle.proxy_1).abs() <= 1e-9);
        }
    }

    #[test]
    fn every_effort_is_finite_and_within_the_range(
        law in prop_oneof![Just(Law::Psmc), Just(Law::Pid)],
        gains in gains(),
        h in sliding_time(),
        steps in prop::collection::vec((any::<f64>(), limit(), any::<f64>()), 1..30),
    ) {
        let mut axis = law.controller(gains, h, 1e-3).unwrap();
        for (error, limit, feed_forward) in steps {
            let (fed, range) = EffortRange::around(limit, feed_forward);
            let step = axis.step(error, range);
            let bound = if limit.is_finite() && limit > 0.0 { limit } else { 0.0 };
            prop_assert!(step.effort >= range.lower() && step.effort <= range.upper());
            // To the rounding of limit - feed-forward.
            prop_assert!((step.effort + fed).abs() <= bound * (1.0 + 4.0 * f64::EPSILON), "{} {}", step.effort, fed);
            prop_assert!(error.is_finite() || !step.valid);
            prop_assert!(step.valid || step == AxisStep::REFUSED);
        }
        // The difference from a last error near the largest number may overflow; after that all is well again.
        axis.step(0.0, EffortRange::symmetric(60.0));
        prop_assert!(axis.step(0.0, EffortRange::symmetric(60.0)).valid);
    }
}

fn limit() -> impl Strategy<Value = f64> {
    prop_oneof![4 => 0.0..1000.0, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY), 1 => Just(-1.0)]
}

const STIFF: Gains = Gains { stiffness: 6000.0, damping: 70.0, integral: 30000.0 };

#[test]
fn one_step_by_hand() {
    // T = 0.1, K = 2, B = 1, L = 10, H = 0.1: G = 1.3. sigma = 1 + 0.1 (1 - 0.5)/0.1 = 1.5; f = 1.3/0.2 * 1.5 = 9.75.
    let gains = Gains { stiffness: 2.0, damping: 1.0, integral: 10.0 };
    let mut psmc = Psmc::new(gains, 0.1, 0.1).unwrap();
    psmc.reset(0.5);
    let step = psmc.step(1.0, EffortRange::symmetric(100.0));
    assert!((step.effort - 9.75).abs() < 1e-14 && !step.saturated);
    // da = 0.01 * 9.75/1.3 = 0.075, so the proxy leads by 0.75. Then sigma = 1 and
    // f = 6.5 + 0.75 + (0.2 + 0.1 - 1)/0.02 * 0.075 = 4.625.
    assert!((psmc.proxy_offset() - 0.75).abs() < 1e-14 && (psmc.integral_effort() - 0.75).abs() < 1e-14);
    assert!((psmc.step(1.0, EffortRange::symmetric(100.0)).effort - 4.625).abs() < 1e-14);
    // PID: 2 * 1 + (1 - 0.5)/0.1 + 10 * 0.1 = 8.
    let mut pid = Pid::new(gains, 0.1).unwrap();
    pid.reset(0.5);
    assert!((pid.step(1.0, EffortRange::symmetric(100.0)).effort - 8.0).abs() < 1e-14);
}

#[test]
fn a_start_away_from_the_target_leaves_the_stated_transient_and_offset() {
    let (e, h, t) = (0.01, 0.02, 1e-3);
    let mut psmc = Psmc::new(STIFF, h, t).unwrap();
    let mut pid = Pid::new(STIFF, t).unwrap();
    psmc.reset(e);
    pid.reset(e);
    let range = EffortRange::symmetric(WIDE);
    let mut gap = e;
    for i in 0..1000 {
        let difference = pid.step(e, range).effort - psmc.step(e, range).effort;
        // The proxy closes its gap by the factor H/(T + H), the discrete exp(-T/H).
        gap *= h / (t + h);
        assert!((e - psmc.proxy_offset() - gap).abs() < 1e-12);
        if i > 600 {
            assert!((difference - STIFF.integral * h * e).abs() < 1e-8, "{difference}");
        }
    }
}

#[test]
fn psmc_does_not_wind_up() {
    let mut psmc = Psmc::new(STIFF, 0.02, 1e-3).unwrap();
    for _ in 0..100_000 {
        let step = psmc.step(1.0, EffortRange::symmetric(60.0));
        assert!(step.effort == 60.0 && step.saturated);
        assert!(psmc.integral_effort() <= 60.0 * (1.0 + 1e-12));
    }
    assert!((psmc.integral_effort() - 60.0).abs() < 1e-9);
}

#[test]
fn pid_does_not_integrate_out_of_its_range_and_does_integrate_back() {
    let mut pid = Pid::new(STIFF, 1e-3).unwrap();
    for _ in 0..10_000 {
        pid.step(0.005, EffortRange::symmetric(60.0));
        assert!(pid.integral_effort() <= 30.0 + 1e-9);
    }
    assert!(pid.integral_effort() > 29.8);
    // Back into the range, and out of it on the side from which the error leads back.
    pid.step(-0.001, EffortRange::symmetric(60.0));
    let before = pid.integral_effort();
    pid.step(-0.001, EffortRange::symmetric(60.0));
    pid.step(-0.001, EffortRange::symmetric(1.0));
    assert!((pid.integral_effort() - before + 0.06).abs() < 1e-12);
}

#[test]
fn the_range_is_what_the_feed_forward_leaves() {
    let (fed, range) = EffortRange::around(60.0, 25.0);
    assert_eq!((fed, range.lower(), range.upper()), (25.0, -85.0, 35.0));
    let (fed, range) = EffortRange::around(60.0, -1e9);
    assert_eq!((fed, range.lower(), range.upper()), (-60.0, 0.0, 120.0));
    for limit in [f64::NAN, f64::INFINITY, -1.0] {
        assert_eq!(EffortRange::around(limit, 5.0), (0.0, EffortRange::symmetric(0.0)));
    }
    assert_eq!(EffortRange::around(60.0, f64::NAN), (0.0, EffortRange::symmetric(60.0)));
    assert_eq!(EffortRange::new(3.0, -2.0), EffortRange::symmetric(0.0));
    let mut psmc = Psmc::new(STIFF, 0.02, 1e-3).unwrap();
    assert_eq!(psmc.step(1.0, EffortRange::new(-85.0, 35.0)).effort, 35.0);
    assert_eq!(psmc.step(-3.0, EffortRange::new(-85.0, 35.0)).effort, -85.0);
}

#[test]
fn bad_input_is_refused_and_leaves_no_kick() {
    for law in [Law::Psmc, Law::Pid] {
        let mut axis = law.controller(STIFF, 0.02, 1e-3).unwrap();
        let range = EffortRange::symmetric(WIDE);
        let mut steady = 0.0;
        for _ in 0..50 {
            steady = axis.step(1e-3, range).effort;
        }
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(axis.step(bad, range), AxisStep { effort: 0.0, wanted: 0.0, saturated: false, valid: false });
        }
        let step = axis.step(2e-3, range);
        // A difference over the gap would add 70 N m s/rad * 1 rad/s.
        assert!(step.valid && step.effort > steady && step.effort < steady + 10.0, "{law:?} {steady} {step:?}");
    }
}

#[test]
fn reset_is_bumpless() {
    for law in [Law::Psmc, Law::Pid] {
        let mut axis = law.controller(STIFF, 0.0, 1e-3).unwrap();
        let range = EffortRange::symmetric(WIDE);
        for i in 0..50 {
            axis.step(f64::from(i), range);
        }
        axis.reset(0.0);
        assert_eq!(axis.step(0.0, range).effort, 0.0);
        axis.reset(f64::NAN);
        assert!(axis.step(0.0, range) == AxisStep { effort: 0.0, wanted: 0.0, saturated: false, valid: true });
    }
}

#[test]
fn parameters_are_checked() {
    let bad = |gains: Gains, h: f64, t: f64| {
        assert!(matches!(Psmc::new(gains, h, t), Err(ControlError::OutOfRange { .. })), "{gains:?} {h} {t}");
    };
    for value in [f64::NAN, f64::INFINITY, -1.0] {
        bad(Gains { stiffness: value, ..STIFF }, 0.02, 1e-3);
        bad(Gains { damping: value, ..STIFF }, 0.02, 1e-3);
        bad(Gains { integral: value, ..STIFF }, 0.02, 1e-3);
        bad(STIFF, value, 1e-3);
        bad(STIFF, 0.02, value);
        assert!(
            Pid::new(STIFF, value).is_err() && RateLaw::new(value, 1.0).is_err() && RateLaw::new(1.0, value).is_err()
        );
    }
    bad(Gains { stiffness: 0.0, ..STIFF }, 0.02, 1e-3);
    let error = Psmc::new(STIFF, -0.5, 1e-3).unwrap_err();
    assert_eq!(error.to_string(), "sliding time is -0.5; it must be finite and not negative");
    assert!(Psmc::new(Gains { integral: 0.0, damping: 0.0, ..STIFF }, 0.0, 1e-3).is_ok());
}

/// Distance travelled past the target of an ideal velocity drive that obeys one cycle late.
fn rate_law_overshoot(gain_times_period: f64) -> f64 {
    let law = RateLaw::new(gain_times_period / 1e-3, 1e6).unwrap();
    let (mut position, mut commanded, mut over) = (0.0, 0.0, 0.0_f64);
    for _ in 0..400 {
        let next = law.command(1.0 - position, 0.0).rate;
        position += 1e-3 * commanded;
        commanded = next;
        over = over.max(position - 1.0);
    }
    over
}

#[test]
fn rate_law_follows_limits_and_states_its_bounds() {
    let law = RateLaw::new(20.0, 2.0).unwrap();
    assert_eq!(law.command(0.01, 0.5), RateStep { rate: 0.7, saturated: false, valid: true });
    assert_eq!(law.command(-1.0, 0.5), RateStep { rate: -2.0, saturated: true, valid: true });
    for (error, rate) in [(f64::NAN, 0.0), (0.0, f64::INFINITY), (f64::INFINITY, f64::NEG_INFINITY)] {
        assert_eq!(law.command(error, rate), RateStep { rate: 0.0, saturated: false, valid: false });
    }
    assert!(rate_law_overshoot(0.25) < 1e-9 && rate_law_overshoot(0.4) > 1e-3);
    assert!(rate_law_overshoot(0.99) < 2.0 && rate_law_overshoot(1.05) > 1e3);
}
