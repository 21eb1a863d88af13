//! The chain from counts to force and back, its flags, and what it refuses.

use crate::elementary;
use nalgebra::{Matrix6, UnitComplex, Vector2, Vector6};
use proptest::prelude::*;

use super::*;
use crate::quantity::Force;

const RANGE: i32 = 32000;
const STILL: Vector2<f64> = Vector2::new(0.0, 0.0);

fn matrix() -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::new(0.00625, 0.00625, 0.00625, 0.0003, 0.0003, 0.0003))
}

fn calibration() -> Calibration {
    Calibration::new(matrix(), RANGE).unwrap()
}

fn parameters() -> SensingParameters {
    SensingParameters {
        calibration: calibration(),
        mounting: mounted(MountedOn::RightDistal, 0.0),
        handle_mass_kg: 0.0,
        low_pass_hz: None,
        sample_rate_hz: 1000.0,
        cycle_period_s: 1e-3,
        force_step_limit_n: f64::INFINITY,
    }
}

fn mounted(link: MountedOn, angle_rad: f64) -> Mounting {
    Mounting::new(link, angle_rad).unwrap()
}

/// The rotation by an angle.
fn turned(angle_rad: f64) -> UnitComplex<f64> {
    let (sine, cosine) = elementary::sin_cos(angle_rad);
    UnitComplex::from_cos_sin_unchecked(cosine, sine)
}

fn sensing(parameters: SensingParameters) -> Sensing {
    Sensing::new(parameters).unwrap()
}

fn sample(counts: [i32; 6]) -> RawSample {
    RawSample { counts, ..RawSample::default() }
}

fn newton(x: f64) -> RawSample {
    sample([(x / 0.00625) as i32, 0, 0, 0, 0, 0])
}

#[test]
fn counts_become_newtons_and_newton_metres() {
    let wrench = calibration().wrench(&sample([1600, -3200, 160, 1000, -2000, 10000]));
    let expected = Vector6::new(10.0, -20.0, 1.0, 0.3, -0.6, 3.0);
    assert!((wrench.0 - expected).amax() < 1e-12);
    let reading = sensing(parameters()).step(Some(&sample([1600, -3200, 160, 1000, -2000, 10000])), turned(0.0), STILL);
    assert!((reading.force - Force::new(10.0, -20.0)).norm() < 1e-12 && (reading.torque_z_n_m - 3.0).abs() < 1e-12);
    assert!(reading.is_usable() && reading.new_sample && reading.age_s == 0.0 && reading.identical_samples == 1);
}

#[test]
fn the_force_turns_with_link_and_mounting() {
    let quarter = std::f64::consts::FRAC_PI_2;
    // Sensor x along base y with the link at 90 degrees; along base -x with 90 degrees of mounting on top.
    let mut chain = sensing(parameters());
    assert!((chain.step(Some(&newton(10.0)), turned(quarter), STILL).force - Force::new(0.0, 10.0)).norm() < 1e-12);
    let mounting = mounted(MountedOn::LeftDistal, quarter);
    let mut chain = sensing(SensingParameters { mounting, ..parameters() });
    assert!((chain.step(Some(&newton(10.0)), turned(quarter), STILL).force - Force::new(-10.0, 0.0)).norm() < 1e-12);
    let distal = [turned(1.0), turned(2.0)];
    assert_eq!(mounting.link_rotation(distal), distal[0]);
    assert_eq!(mounted(MountedOn::RightDistal, quarter).link_rotation(distal), distal[1]);
    assert_eq!(mounted(MountedOn::Base, quarter).link_rotation(distal), turned(0.0));
}

#[test]
fn the_handle_does_not_push_its_own_inertia() {
    let mut chain = sensing(SensingParameters { handle_mass_kg: 0.5, ..parameters() });
    // A hand pushes with 10 N and the handle accelerates at 4 m/s^2 under it: 2 N never reach the sensor.
    let reading = chain.step(Some(&newton(8.0)), turned(0.0), Vector2::new(4.0, 0.0));
    assert!((reading.force - Force::new(10.0, 0.0)).norm() < 1e-12);
    // Nobody pushes; the link drags the handle along at -6 m/s^2 and the sensor feels it lag: still no hand.
    let reading = chain.step(Some(&newton(3.0)), turned(0.0), Vector2::new(-6.0, 0.0));
    assert!(reading.force.norm() < 1e-12);
}

#[test]
fn saturation_starts_at_98_percent_of_the_range_or_with_the_overload_bit() {
    let calibration = calibration();
    assert!(!calibration.is_saturated(&sample([0, 0, 31359, 0, -31359, 0])));
    assert!(calibration.is_saturated(&sample([0, 0, 31360, 0, 0, 0])));
    assert!(calibration.is_saturated(&sample([0, 0, 0, 0, -31360, 0])));
    assert!(calibration.is_saturated(&sample([0, 0, 0, 0, 0, i32::MIN])));
    assert!(calibration.is_saturated(&RawSample { overload: true, ..RawSample::default() }));
    let mut chain = sensing(parameters());
    let reading = chain.step(Some(&sample([31360, 0, 0, 0, 0, 0])), turned(0.0), STILL);
    assert!(reading.saturated && reading.valid && !reading.is_usable());
    // It is the last sample's flag until the next sample.
    assert!(
        chain.step(None, turned(0.0), STILL).saturated && !chain.step(Some(&newton(1.0)), turned(0.0), STILL).saturated
    );
}

/// Missed samples and the stale flag in `cycles` cycles of 1 ms after one sample.
fn after_one_sample(sample_rate_hz: f64, cycle_period_s: f64, cycles: usize) -> Vec<(u32, bool)> {
    let mut chain = sensing(SensingParameters { sample_rate_hz, cycle_period_s, ..parameters() });
    chain.step(Some(&newton(1.0)), turned(0.0), STILL);
    (0..cycles)
        .map(|_| chain.step(None, turned(0.0), STILL))
        .map(|reading| (reading.missed_samples, reading.stale))
        .collect()
}

#[test]
fn stale_counts_samples_that_should_have_come() {
    assert_eq!(after_one_sample(1000.0, 1e-3, 4), [(1, false), (2, false), (3, true), (4, true)]);
    let slow = after_one_sample(200.0, 1e-3, 15);
    let missed: Vec<u32> = slow.iter().map(|(missed, _)| *missed).collect();
    assert_eq!(missed, [0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 3]);
    assert_eq!(slow.iter().position(|(_, stale)| *stale), Some(14));
    // No more than one sample per cycle can be seen, however fast the sensor.
    assert_eq!(after_one_sample(7000.0, 1e-3, 3), [(1, false), (2, false), (3, true)]);
    // Every interval that is a whole number of cycles is due in its very cycle, in spite of rounding.
    for cycles in 1..50 {
        let last = *after_one_sample(1.0 / (0.001 * f64::from(cycles)), 1e-3, 3 * cycles as usize).last().unwrap();
        assert_eq!(last, (3, true), "{cycles}");
    }
}

#[test]
fn a_slow_sensor_is_never_stale_while_it_keeps_its_rate() {
    let mut chain = sensing(SensingParameters { sample_rate_hz: 200.0, ..parameters() });
    let mut ages = 0.0_f64;
    for cycle in 0..1000 {
        let sample = newton(f64::from(cycle % 100));
        let reading = chain.step((cycle % 5 == 0).then_some(&sample), turned(0.0), STILL);
        assert!(reading.is_usable() && reading.missed_samples == 0 && reading.new_sample == (cycle % 5 == 0));
        ages = ages.max(reading.age_s);
    }
    assert!((ages - 0.004).abs() < 1e-12);
}

#[test]
fn a_repeated_counter_is_no_new_sample() {
    let mut chain = sensing(parameters());
    let with = |sequence, x| RawSample { sequence: Some(sequence), ..newton(x) };
    assert!(chain.step(Some(&with(255, 1.0)), turned(0.0), STILL).new_sample);
    for missed in 1..=3 {
        let reading = chain.step(Some(&with(255, 2.0)), turned(0.0), STILL);
        assert!(!reading.new_sample && reading.missed_samples == missed && reading.stale == (missed == 3));
        assert!((reading.force.x() - 1.0).abs() < 1e-12);
    }
    let reading = chain.step(Some(&with(0, 2.0)), turned(0.0), STILL);
    assert!(reading.new_sample && !reading.stale && (reading.force.x() - 2.0).abs() < 1e-12);
    // A sensor that stops sending its counter is taken at its word.
    assert!(chain.step(Some(&newton(3.0)), turned(0.0), STILL).new_sample);
}

#[test]
fn identical_samples_are_counted_on_all_six_axes() {
    let mut chain = sensing(parameters());
    assert_eq!(chain.step(None, turned(0.0), STILL).identical_samples, 0);
    for count in 1..=60 {
        let sequence = Some(count as u8);
        let sample = RawSample { sequence, ..sample([5, 4, 3, 2, 1, 0]) };
        assert_eq!(chain.step(Some(&sample), turned(0.0), STILL).identical_samples, count);
        // Neither silence nor a repetition is another sample.
        assert_eq!(chain.step(None, turned(0.0), STILL).identical_samples, count);
        assert_eq!(chain.step(Some(&sample), turned(0.0), STILL).identical_samples, count);
    }
    assert_eq!(chain.step(Some(&sample([5, 4, 3, 2, 1, 1])), turned(0.0), STILL).identical_samples, 1);
}

#[test]
fn bad_angles_and_accelerations_hold_the_last_force() {
    let mut chain = sensing(SensingParameters { handle_mass_kg: 1e10, low_pass_hz: Some(30.0), ..parameters() });
    assert!(!chain.step(Some(&newton(1.0)), turned(f64::NAN), STILL).valid);
    assert_eq!(chain.step(Some(&newton(1.0)), turned(f64::INFINITY), STILL).force, Force::default());
    let good = chain.step(Some(&newton(1.0)), turned(0.0), STILL);
    assert!(good.is_usable() && good.refused_samples == 0);
    // The last two are finite as forces, and their difference is not.
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, 1.5e298, -1.5e298];
    for (refused, bad) in bad.into_iter().enumerate() {
        let reading = chain.step(Some(&newton(2.0)), turned(0.0), Vector2::new(bad, 0.0));
        assert!(!reading.valid && reading.force == good.force && reading.refused_samples == refused as u32 + 1);
    }
    // Silence does not make it valid again.
    assert!(!chain.step(None, turned(0.0), STILL).valid && chain.step(Some(&newton(2.0)), turned(0.0), STILL).valid);
}

#[test]
fn the_low_pass_lags_by_its_stated_delay() {
    let mut chain = sensing(SensingParameters { low_pass_hz: Some(30.0), ..parameters() });
    let delay = chain.filter_delay_s();
    // 1/(2 pi 30 Hz) - T/2 = 4.8 ms.
    assert!((delay - (1.0 / (std::f64::consts::TAU * 30.0) - 0.5e-3)).abs() < 2e-5, "{delay}");
    // A ramp of 160 counts per ms, 1000 N/s: the output runs behind by the delay.
    let mut reading = chain.step(Some(&newton(0.0)), turned(0.0), STILL);
    for i in 1..=190 {
        reading = chain.step(Some(&sample([160 * i, 0, 0, 0, 0, 0])), turned(0.0), STILL);
    }
    assert!((190.0 - reading.force.x() - 1000.0 * delay).abs() < 1e-9, "{reading:?}");
    assert_eq!(sensing(parameters()).filter_delay_s(), 0.0);
    // At its cut-off, over the interval of the samples and not of the cycles, it lets 0.7 through.
    let mut chain = sensing(SensingParameters { low_pass_hz: Some(5.0), sample_rate_hz: 200.0, ..parameters() });
    let mut peak = 0.0_f64;
    for cycle in 0..3000 {
        let x = 100.0 * elementary::sin(std::f64::consts::TAU * 5e-3 * f64::from(cycle));
        let reading = chain.step((cycle % 5 == 0).then_some(&newton(x)), turned(0.0), STILL);
        peak = if cycle > 1000 { peak.max(reading.force.x()) } else { 0.0 };
    }
    assert!((peak - 70.7).abs() < 4.0, "{peak}");
}

const TARE: TareParameters = TareParameters { samples: 100, force_spread_limit_n: 0.5, torque_spread_limit_n_m: 0.02 };

#[test]
fn a_tare_takes_the_mean_out_of_what_follows() {
    let mut chain = sensing(parameters());
    assert!(chain.tare_state().is_none() && chain.step(Some(&newton(7.0)), turned(0.0), STILL).is_usable());
    chain.start_tare(TARE).unwrap();
    assert!(!chain.step(None, turned(0.0), STILL).valid);
    for i in 0..100 {
        assert_eq!(chain.tare_state(), Some(TareState::Collecting { remaining: 100 - i }));
        // 800 and 810 counts in turn: mean 805 counts, 5.03125 N; the torque stays at 0.3 N m.
        let reading = chain.step(Some(&sample([800 + 10 * (i as i32 % 2), 0, 0, 0, 0, 1000])), turned(1.0), STILL);
        assert!(!reading.valid && reading.force == Force::default());
        // Cycles without a sample do not count.
        chain.step(None, turned(1.0), STILL);
    }
    let Some(TareState::Done(bias)) = chain.tare_state() else { panic!("{:?}", chain.tare_state()) };
    assert!((bias.0 - Vector6::new(5.03125, 0.0, 0.0, 0.0, 0.0, 0.3)).amax() < 1e-12 && bias == chain.bias());
    let reading = chain.step(Some(&sample([805, 0, 0, 0, 0, 2000])), turned(1.0), STILL);
    assert!(reading.is_usable() && reading.force.norm() < 1e-12 && (reading.torque_z_n_m - 0.3).abs() < 1e-12);
}

#[test]
fn a_tare_fails_when_somebody_holds_the_handle_and_leaves_the_bias() {
    let mut chain = sensing(parameters());
    let tare = |chain: &mut Sensing, bad: RawSample| {
        chain.start_tare(TARE).unwrap();
        for i in 0..100 {
            chain.step(Some(&if i == 50 { bad } else { newton(2.0) }), turned(0.0), STILL);
        }
        chain.tare_state()
    };
    assert!(matches!(tare(&mut chain, newton(2.4)), Some(TareState::Done(_))));
    let bias = chain.bias();
    match tare(&mut chain, newton(2.6)) {
        Some(TareState::Failed(TareFault::Moving { force_spread_n, torque_spread_n_m })) => {
            assert!((force_spread_n - 0.6).abs() < 1e-12 && torque_spread_n_m == 0.0);
        }
        other => panic!("{other:?}"),
    }
    assert_eq!(chain.bias(), bias);
    assert!(chain.step(Some(&newton(2.0)), turned(0.0), STILL).valid);
    let twisted = sample([320, 0, 0, 0, 100, 0]);
    assert!(matches!(tare(&mut chain, twisted), Some(TareState::Failed(TareFault::Moving { .. }))));
    let overload = RawSample { overload: true, ..newton(2.0) };
    assert_eq!(tare(&mut chain, overload), Some(TareState::Failed(TareFault::Saturated)));
    assert_eq!(chain.bias(), bias);
}

#[test]
fn bad_calibrations_are_refused_with_their_numbers() {
    for (value, row, column) in [(f64::NAN, 2, 3), (f64::INFINITY, 6, 6)] {
        let mut bad = matrix();
        bad[(row - 1, column - 1)] = value;
        let error = Calibration::new(bad, RANGE).unwrap_err();
        let text = format!("calibration matrix: row {row}, column {column} is {value}, not a finite number");
        assert_eq!(error.to_string(), text);
    }
    let mut zero_row = matrix();
    zero_row[(2, 2)] = 0.0;
    let mut twins = matrix();
    twins.set_row(4, &(matrix().row(3) * 2.0));
    let mut nearly = matrix();
    nearly.set_row(4, &(matrix().row(3) * 2.0));
    nearly[(4, 4)] = 1e-15;
    for bad in [zero_row, twins, nearly, Matrix6::zeros()] {
        assert!(matches!(Calibration::new(bad, RANGE), Err(SensingError::CalibrationSingular { .. })), "{bad}");
    }
    assert!(matches!(Calibration::new(matrix() * 1e100, RANGE), Err(SensingError::OutOfRange { .. })));
    for received in [0, -1, i32::MIN] {
        assert_eq!(Calibration::new(matrix(), received).unwrap_err(), SensingError::Range { received });
    }
    // N beside uN m is no reason to refuse.
    let units = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 1e-9, 1e-9, 1e-9));
    assert!(Calibration::new(units * matrix(), RANGE).is_ok());
}

#[test]
fn bad_parameters_are_refused() {
    for value in [f64::NAN, f64::INFINITY, -1.0] {
        for bad in [
            SensingParameters { handle_mass_kg: value, ..parameters() },
            SensingParameters { low_pass_hz: Some(value), ..parameters() },
            SensingParameters { sample_rate_hz: value, ..parameters() },
            SensingParameters { cycle_period_s: value, ..parameters() },
        ] {
            assert!(matches!(Sensing::new(bad), Err(SensingError::OutOfRange { .. })));
        }
        assert!(Tare::new(TareParameters { force_spread_limit_n: value, ..TARE }).is_err());
        assert!(Tare::new(TareParameters { torque_spread_limit_n_m: value, ..TARE }).is_err());
    }
    for zero in [
        SensingParameters { low_pass_hz: Some(0.0), ..parameters() },
        SensingParameters { low_pass_hz: Some(1e-320), ..parameters() },
        SensingParameters { sample_rate_hz: 0.0, ..parameters() },
        SensingParameters { sample_rate_hz: 1e-320, ..parameters() },
        SensingParameters { cycle_period_s: 1e300, ..parameters() },
    ] {
        assert!(matches!(Sensing::new(zero), Err(SensingError::OutOfRange { .. })));
    }
    for angle_rad in [f64::NAN, f64::INFINITY] {
        assert!(matches!(Mounting::new(MountedOn::Base, angle_rad), Err(SensingError::OutOfRange { .. })));
    }
    for samples in [0, 60_001] {
        let error = Tare::new(TareParameters { samples, ..TARE }).unwrap_err();
        assert_eq!(error, SensingError::TareSamples { received: samples, most: 60_000 });
    }
    assert!(sensing(parameters()).start_tare(TareParameters { samples: 0, ..TARE }).is_err());
}

/// A sensor with cross-talk of up to a tenth of each channel's size.
fn coupled_calibration() -> impl Strategy<Value = Calibration> {
    prop::collection::vec(-0.1..0.1, 36).prop_map(|cross| {
        let mix = Matrix6::from_iterator(cross) + Matrix6::identity();
        Calibration::new(matrix() * mix, RANGE).unwrap()
    })
}

proptest! {
    #[test]
    fn wrench_to_counts_and_back_is_within_half_a_count(
        calibration in coupled_calibration(), force in prop::array::uniform3(-80.0..80.0), torque in prop::array::uniform3(-4.0..4.0),
    ) {
        let wrench = Wrench(Vector6::new(force[0], force[1], force[2], torque[0], torque[1], torque[2]));
        let raw = sample(calibration.counts_for(&wrench));
        prop_assert!(!calibration.is_saturated(&raw));
        let error = (calibration.wrench(&raw).0 - wrench.0).abs();
        let bound = calibration.resolution().0.map(|limit| limit * (1.0 + 1e-9));
        prop_assert!((bound - error).min() >= 0.0, "{error} {bound}");
    }

    #[test]
    fn counts_survive_the_round_trip(
        calibration in coupled_calibration(), counts in prop::array::uniform6(-RANGE..=RANGE),
    ) {
        prop_assert_eq!(calibration.counts_for(&calibration.wrench(&sample(counts))), counts);
    }

    #[test]
    fn counts_stay_in_the_range_for_any_wrench(wrench in any::<[f64; 6]>()) {
        let counts = calibration().counts_for(&Wrench(Vector6::from(wrench)));
        prop_assert!(counts.iter().all(|count| (-RANGE..=RANGE).contains(count)));
    }

    #[test]
    fn base_frame_to_sensor_frame_and_back(
        x in -200.0..200.0, y in -200.0..200.0, torque in -9.0..9.0, link in -10.0..10.0, angle in -4.0..4.0,
    ) {
        let (mounting, link) = (mounted(MountedOn::RightDistal, angle), turned(link));
        let wrench = mounting.to_sensor(Force::new(x, y), torque, link);
        prop_assert!((mounting.to_base(&wrench, link) - Force::new(x, y)).norm() < 1e-10);
        prop_assert_eq!(wrench.0.b, torque);
    }

    #[test]
    fn a_reading_is_always_finite(
        mass in prop_oneof![Just(0.0), 0.0..1e300],
        low_pass_hz in prop::option::of(1e-6..1e6),
        steps in prop::collection::vec(
            (prop::option::of((any::<[i32; 6]>(), prop::option::of(any::<u8>()))), any::<f64>(), any::<[f64; 2]>()), 1..40),
        tare_at in 0_usize..40,
    ) {
        let mut chain = sensing(SensingParameters { handle_mass_kg: mass, low_pass_hz, ..parameters() });
        for (i, (raw, angle, acceleration)) in steps.into_iter().enumerate() {
            if i == tare_at {
                chain.start_tare(TareParameters { samples: 2, ..TARE }).unwrap();
            }
            let raw = raw.map(|(counts, sequence)| RawSample { counts, sequence, ..RawSample::default() });
            let reading = chain.step(raw.as_ref(), turned(angle), Vector2::from(acceleration));
            prop_assert!(reading.force.is_finite() && reading.torque_z_n_m.is_finite() && reading.age_s.is_finite());
            prop_assert!(!(reading.new_sample && reading.valid) || angle.is_finite());
        }
    }
}

#[test]
fn an_invalid_sample_is_not_used() {
    let mut chain = sensing(parameters());
    let before = chain.step(Some(&newton(10.0)), turned(0.0), STILL);
    let invalid = RawSample { invalid: true, ..newton(20.0) };
    for count in 1..=3 {
        let reading = chain.step(Some(&invalid), turned(0.0), STILL);
        assert_eq!((reading.force, reading.valid, reading.new_sample), (before.force, false, true));
        assert_eq!(reading.refused_samples, count);
    }
    let after = chain.step(Some(&newton(20.0)), turned(0.0), STILL);
    assert!(after.valid && after.refused_samples == 0 && (after.force.x() - 20.0).abs() < 1e-9);
    chain.start_tare(TareParameters { samples: 3, force_spread_limit_n: 1.0, torque_spread_limit_n_m: 1.0 }).unwrap();
    chain.step(Some(&invalid), turned(0.0), STILL);
    assert!(matches!(chain.tare_state(), Some(TareState::Failed(_))), "nor is a tare made of it");
}

#[test]
fn a_step_of_the_force_goes_by_its_limit() {
    let mut chain = sensing(SensingParameters { force_step_limit_n: 15.0, ..parameters() });
    let mut force = |newtons: Option<f64>| {
        let sample = newtons.map(newton);
        let reading = chain.step(sample.as_ref(), turned(0.0), STILL);
        (reading.force.x().round(), reading.stepped)
    };
    assert_eq!(force(Some(100.0)), (100.0, false), "the first sample has none before it");
    assert_eq!(force(Some(114.0)), (114.0, false));
    assert_eq!(force(Some(150.0)), (129.0, true));
    assert_eq!(force(Some(150.0)), (144.0, true));
    assert_eq!(force(Some(150.0)), (150.0, false));
    assert_eq!(force(None), (150.0, false));
    assert_eq!(force(Some(122.0)), (122.0, false), "a sample is missing between them");
    // One wild sample moves the force there and back by the limit.
    assert_eq!(force(Some(-190.0)), (107.0, true));
    assert_eq!(force(Some(122.0)), (122.0, false));
}

proptest! {
    /// The force never changes by more than the limit from sample to sample, and is the sensed force when that is near.
    #[test]
    fn the_force_is_bounded_in_its_rate(counts in proptest::collection::vec(-20_000..20_000i32, 2..60)) {
        let mut chain = sensing(SensingParameters { force_step_limit_n: 10.0, ..parameters() });
        let mut last: Option<Force> = None;
        for count in counts {
            let reading = chain.step(Some(&sample([count, 0, 0, 0, 0, 0])), turned(0.0), STILL);
            let sensed = f64::from(count) * 0.00625;
            if let Some(last) = last {
                prop_assert!((reading.force - last).norm() <= 10.0 * (1.0 + 1e-12));
                prop_assert_eq!(reading.stepped, (sensed - last.0.x).abs() > 10.0);
                prop_assert!(reading.stepped || (reading.force.x() - sensed).abs() < 1e-9);
            }
            last = Some(reading.force);
        }
    }
}

#[test]
fn a_sensor_that_hangs_is_stuck_only_if_its_noise_was_seen_at_rest() {
    // Counts at rest, one after the other, then the same ones for long.
    let longest_clean_run = |at_rest: &[i32]| {
        let mut chain = sensing(parameters());
        chain.set_resting(true);
        for &count in at_rest {
            assert!(!chain.step(Some(&sample([count, 0, 0, 0, 0, 0])), turned(0.0), STILL).stuck);
        }
        chain.set_resting(false);
        (1..=300).find(|_| chain.step(Some(&sample([7, 8, 9, 0, 0, 0])), turned(0.0), STILL).stuck)
    };
    let noisy: Vec<i32> = (0..20).map(|at| at % 3).collect();
    assert_eq!(longest_clean_run(&noisy), Some(50));
    assert_eq!(longest_clean_run(&noisy[..8]), None, "too few to tell");
    assert_eq!(longest_clean_run(&[0; 64]), None, "a still sensor without noise repeats itself");
    // Noise far below a count shows now and then only.
    let rare: Vec<i32> = (0..64).map(|at| i32::from(at % 8 == 0)).collect();
    assert_eq!(longest_clean_run(&rare), None);
}
