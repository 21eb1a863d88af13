//! From counts to force.

use nalgebra::{Matrix6, UnitComplex, Vector2, Vector6};
use yieldwall::elementary;
use yieldwall::sensing::{
    Calibration, MountedOn, Mounting, RawSample, Sensing, SensingParameters, TareParameters, TareState, Wrench,
};

use super::bytes::{Bytes, Script};

/// Most steps of one input, so that its length does not decide how long it takes.
const MOST_STEPS: usize = 500;

fn matrix(bytes: &mut Bytes<'_>) -> Matrix6<f64> {
    let mut matrix = Matrix6::identity() * 0.00625;
    for _ in 0..bytes.u8() % 8 {
        let (row, column) = (usize::from(bytes.u8() % 6), usize::from(bytes.u8() % 6));
        matrix[(row, column)] = bytes.f64();
    }
    matrix
}

/// Any sample.
pub(super) fn sample(bytes: &mut Bytes<'_>) -> RawSample {
    let counts = [0; 6].map(|_| if bytes.bool() { bytes.u32() as i32 } else { i32::from(bytes.u16() as i16) });
    let (sequence, flags) = (bytes.bool().then(|| bytes.u8()), bytes.u8());
    let age_ns = if bytes.bool() { bytes.u32() } else { 0 };
    RawSample { counts, sequence, overload: flags == 1, invalid: flags == 2, age_ns }
}

/// A calibration is refused, or makes finite wrenches of any counts and counts within the range of any wrench.
///
/// # Panics
/// If a law is broken.
pub fn calibration(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let (matrix, range) = (matrix(&mut bytes), bytes.u32() as i32);
    let Ok(calibration) = Calibration::new(matrix, range) else { return };
    assert!(range >= 1 && matrix.iter().all(|entry| entry.is_finite()));
    assert!(calibration.resolution().0.iter().all(|value| value.is_finite() && *value > 0.0));
    for _ in 0..MOST_STEPS {
        let raw = sample(&mut bytes);
        let wrench = calibration.wrench(&raw);
        assert!(wrench.0.iter().all(|value| value.is_finite()), "{raw:?}: {wrench:?}");
        assert!(calibration.is_saturated(&raw) || !raw.overload);
        let wanted = Wrench(Vector6::from_fn(|_, _| bytes.f64()));
        for wrench in [wrench, wanted] {
            let counts = calibration.counts_for(&wrench);
            assert!(counts.iter().all(|count| count.unsigned_abs() <= range as u32), "{wrench:?}: {counts:?}");
        }
        if bytes.is_empty() {
            break;
        }
    }
}

pub(super) fn calibrations() -> Vec<Vec<u8>> {
    let script =
        Script::new().raw(&[2, 0, 1]).number(0.0005).raw(&[4, 3]).number(-0.0002).raw(&32_000i32.to_le_bytes());
    vec![script.raw(&[0, 100, 0]).raw(&[0; 18]).raw(&[1, 0, 0]).number(10.0).number(-5.0).finish()]
}

/// A sensing chain is refused, or its readings are finite and say of themselves what they are.
///
/// # Panics
/// If a law is broken.
pub fn sensing(bytes: &[u8]) {
    let mut bytes = Bytes::new(bytes);
    let Ok(calibration) = Calibration::new(matrix(&mut bytes), 32_000) else { return };
    let link = bytes.pick(&[MountedOn::RightDistal, MountedOn::LeftDistal, MountedOn::Base]);
    let Ok(mounting) = Mounting::new(link, bytes.f64()) else { return };
    let parameters = SensingParameters {
        calibration,
        mounting,
        handle_mass_kg: bytes.f64(),
        low_pass_hz: bytes.bool().then(|| bytes.f64()),
        sample_rate_hz: bytes.f64(),
        cycle_period_s: bytes.f64(),
        force_step_limit_n: bytes.f64(),
    };
    let Ok(mut chain) = Sensing::new(parameters) else { return };
    assert!(chain.filter_delay_s().is_finite());
    for _ in 0..MOST_STEPS {
        if bytes.u8() == 1 {
            let _ = chain.start_tare(TareParameters {
                samples: u32::from(bytes.u8()),
                force_spread_limit_n: bytes.f64(),
                torque_spread_limit_n_m: bytes.f64(),
            });
        }
        let raw = (bytes.u8() >= 32).then(|| sample(&mut bytes));
        let distal = [bytes.f64(), bytes.f64()].map(|angle_rad| {
            let (sin, cos) = elementary::sin_cos(angle_rad);
            UnitComplex::from_cos_sin_unchecked(cos, sin)
        });
        let link = chain.mounting().link_rotation(distal);
        let acceleration = Vector2::new(bytes.f64(), bytes.f64());
        let reading = chain.step(raw.as_ref(), link, acceleration);
        let numbers = [reading.force.x(), reading.force.y(), reading.torque_z_n_m, reading.age_s];
        assert!(numbers.iter().all(|value| value.is_finite()), "{reading:?}");
        assert!(!reading.new_sample || raw.is_some());
        let age_s = raw.map_or(0.0, |raw| 1e-9 * f64::from(raw.age_ns));
        assert!(!reading.new_sample || (reading.missed_samples == 0 && !reading.stale && reading.age_s == age_s));
        if reading.new_sample && reading.valid {
            assert!(
                link.re.is_finite()
                    && link.im.is_finite()
                    && !matches!(chain.tare_state(), Some(TareState::Collecting { .. }))
            );
        }
        if let Some(TareState::Done(bias)) = chain.tare_state() {
            assert!(bias.0.iter().all(|value| value.is_finite()), "{bias:?}");
        }
        if bytes.is_empty() {
            break;
        }
    }
}

pub(super) fn chains() -> Vec<Vec<u8>> {
    let step = |script: Script, x: u8, sequence: u8| {
        let counts = [0, x, 0].iter().copied().chain([0; 15]).collect::<Vec<u8>>();
        script.raw(&[0, 255]).raw(&counts).raw(&[1, sequence, 0, 0]).number(0.1).number(0.2).number(0.0).number(1.0)
    };
    let script = Script::new().raw(&[0, 0]).number(0.3).number(0.5).raw(&[1]).number(30.0).number(1000.0).number(0.001);
    let script = (0..10).fold(script, |script, at| step(script, 10 * at, at));
    let tare = script.raw(&[1, 3]).number(0.5).number(0.02);
    // The tare takes the place of the first byte of a step.
    let tare = tare.raw(&[255]).raw(&[0; 18]).raw(&[1, 77, 0, 0]).number(0.1).number(0.2).number(0.0).number(0.0);
    vec![(0..5).fold(tare, |script, at| step(script, 100, 100 + at)).finish()]
}
