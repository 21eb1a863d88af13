//! Relations between the keys of the force sensor, and to the rest of the rig.

use nalgebra::Matrix6;
use yieldwall_drives::profiles::{ForceSensor, Scaling};

use super::Findings;
use super::models::refuse_profile;
use super::sensor_bus::{check_plain_can, check_rate};
use super::words::{round, shorten_numbers};
use crate::number::{Finite, Positive};
use crate::tree::{Fitting, ProfileName, Rig, SensorProtocol};
use yieldwall_motion::sensing::{Calibration, SensingError};

/// Smallest squared sine of the angle between the rows Fx and Fy of a calibration; below it the rows are equivalent.
const LEAST_ROW_ANGLE: f64 = 1e-12;

/// Checks that the largest force of a tare is small enough.
fn check_tare(findings: &mut Findings, rig: &Rig) {
    let Some(most_n) = rig.sensor.tare_up_to_n.map(Positive::get) else { return };
    let (friction_n, limit_n) = (rig.fixture.friction_n.get(), rig.guard.force_limit_n.get());
    let key = "sensor.tare_up_to_n";
    if most_n >= limit_n {
        let message = format!("`{key}` is {most_n} N, not below the {limit_n} N of `guard.force_limit_n`");
        findings
            .error(key, message, "write a zero that the sensor can have, such as 1")
            .see("guard.force_limit_n", "force_limit_n");
    } else if friction_n > 0.0 && most_n > friction_n {
        let message = format!("`{key}` is {most_n} N, above the {friction_n} N of `fixture.friction_n`");
        let help = "write less: a hand that rests while the rig is tared becomes part of the zero, and the arm moves as soon as it \
                    lets go";
        findings.warning(key, message, help).see("fixture.friction_n", "friction_n");
    }
}

/// Checks that the force sensor suits its bus, the cycle and the relevant forces.
pub(super) fn check_sensor(findings: &mut Findings, rig: &Rig) {
    let sensor = &rig.sensor;
    let cycle_hz = 1e6 / f64::from(rig.cycle.period_us);
    if let Some(corner) = sensor.low_pass_hz
        && *corner >= cycle_hz / 2.0
    {
        findings
            .error(
                "sensor.low_pass_hz",
                format!(
                    "`sensor.low_pass_hz` is {} Hz, at or above half of the cycle rate of {} Hz",
                    *corner,
                    round(cycle_hz)
                ),
                "lower it, or write null for no filter",
            )
            .see("cycle.period_us", "period_us");
    }
    check_tare(findings, rig);
    match &sensor.protocol {
        SensorProtocol::Canopen { profile, .. } | SensorProtocol::Ethercat { profile, .. } => {
            check_profile(findings, rig, profile, cycle_hz);
        }
        _ => check_plain_can(findings, rig, cycle_hz),
    }
    let [fx, fy] = [&sensor.calibration[0], &sensor.calibration[1]];
    let dot = |a: &[Finite; 6], b: &[Finite; 6]| a.iter().zip(b).map(|(a, b)| **a * **b).sum::<f64>();
    let (xx, yy, xy) = (dot(fx, fx), dot(fy, fy), dot(fx, fy));
    let determinant = xx * yy - xy * xy;
    // Entries so large that the product overflows are no calibration either.
    if determinant.is_nan() || determinant <= LEAST_ROW_ANGLE * xx * yy {
        findings.error(
            "sensor.calibration",
            "the rows Fx and Fy of `sensor.calibration` do not separate two directions of force",
            "copy the matrix from the sensor's calibration sheet: row by row, N and N m per count",
        );
        return;
    }
    let matrix = Matrix6::from_fn(|row, column| *sensor.calibration[row][column]);
    if let Err(error) = Calibration::new(matrix, i32::try_from(sensor.range_counts.max(1)).unwrap_or(i32::MAX)) {
        let message = match error {
            SensingError::CalibrationSingular { .. } => {
                "the rows of `sensor.calibration` do not separate six directions".to_owned()
            }
            error => format!("`sensor.calibration` is no calibration: {}", shorten_numbers(&error.to_string())),
        };
        findings.error(
            "sensor.calibration",
            message,
            "copy all six rows of the matrix from the sensor's calibration sheet; an axis that is not used still has one",
        );
        return;
    }
    check_force_range(findings, rig);
}

/// Checks that the device model is known, is a model of a sensor, and has the features that the rig and its bus need.
fn check_profile(findings: &mut Findings, rig: &Rig, name: &ProfileName, cycle_hz: f64) {
    let is_on_can = rig.sensor.protocol.position().is_none();
    let protocol = if is_on_can { "sensor.protocol.canopen" } else { "sensor.protocol.ethercat" };
    let key = &format!("{protocol}.profile");
    let (Some(profile), name) = (name.get(), name.as_str()) else { return };
    let Some(model) = profile.force_sensor() else {
        return refuse_profile(findings, key, name, "is not one of a force sensor", Fitting::on(false, !is_on_can));
    };
    check_counter(findings, rig, key, name, model);
    check_scaling(findings, rig, key, name, model);
    if rig.sensor.protocol.zero_at_start() && model.zero.is_empty() {
        let at = format!("{protocol}.zero_at_start");
        let message = format!("`{at}` is set, and the profile `{name}` does not say how the sensor zeroes itself");
        findings
            .error(&at, message, "write `zero` in the profile by the manual, or tare with `sensor.tare_up_to_n`")
            .see(key, "profile");
    }
    let rates = &model.sample_rates_hz;
    let rate = *rig.sensor.sample_rate_hz;
    if rates.is_empty() {
        check_rate(findings, rig, cycle_hz);
    } else if !rates.iter().any(|known| f64::from(*known) == rate) {
        let known: Vec<String> = rates.iter().map(u32::to_string).collect();
        let message = format!("`sensor.sample_rate_hz` is {rate}, which the profile `{name}` does not have");
        let help = format!("write one of {}", known.join(", "));
        findings.error("sensor.sample_rate_hz", message, help).see(key, "profile");
    } else if is_on_can {
        check_sample_rate(findings, rig, rates, cycle_hz);
    }
}

/// Warns about a sensor without a counter of samples: it does not show which samples are new.
fn check_counter(findings: &mut Findings, rig: &Rig, key: &str, name: &str, model: &ForceSensor) {
    if model.objects.sample_counter.is_some() {
        return;
    }
    let message = format!(
        "the profile `{name}` has no sample counter: each sample that arrives counts as new. `sensor-stale` does not show a sensor that \
         repeats its last sample, and each age may be {} us greater than reported",
        round(1e6 / *rig.sensor.sample_rate_hz)
    );
    let help = "use a sensor or firmware with a counter if there is one; else `sensor-stuck` shows a sensor with noise that sends 50 equal \
                samples";
    findings.warning(key, message, help);
}

/// Checks that `calibration` has about the counts per unit of the profile.
fn check_scaling(findings: &mut Findings, rig: &Rig, key: &str, name: &str, model: &ForceSensor) {
    let Some(Scaling::Constant { per_n, per_n_m }) = model.scaling else { return };
    let units = [("N", per_n), ("N m", per_n_m)];
    for ((unit, counts), here) in units.into_iter().zip(rig.sensor.counts_per_unit()) {
        // What is 0 is refused in the profile.
        if counts > 0 && !Scaling::agrees(counts, here) {
            let message = format!(
                "`sensor.calibration` has {} counts per {unit}, and the profile `{name}` has {counts}",
                round(here)
            );
            let help =
                format!("write {:e} {unit} per count in the rows of `sensor.calibration`", f64::from(counts).recip());
            findings.error("sensor.calibration", message, help).see(key, "profile");
        }
    }
}

/// Checks that a sensor samples as often as possible, without samples that no cycle sees.
fn check_sample_rate(findings: &mut Findings, rig: &Rig, sample_rates_hz: &[u32], cycle_hz: f64) {
    let sensor = &rig.sensor;
    let rates = sample_rates_hz.iter().map(|rate| f64::from(*rate));
    // A rate that is meant to be that of the cycle may differ by the rounding of its period.
    let fitting = rates.clone().filter(|rate| *rate <= cycle_hz * 1.001).fold(0.0, f64::max);
    let best = if fitting > 0.0 { fitting } else { rates.fold(f64::INFINITY, f64::min) };
    let rate = *sensor.sample_rate_hz;
    let key = "sensor.sample_rate_hz";
    let head = format!("`{key}` is {rate} Hz, and the cycle has {} Hz", round(cycle_hz));
    let help = format!("write {best}, the fastest rate of the profile that suits this cycle");
    if rate > best {
        findings.error(key, format!("{head}: samples between two SYNCs are lost"), help)
    } else if rate < best {
        findings.warning(key, format!("{head}: the force that it sees is older than it has to be"), help)
    } else {
        return;
    }
    .see("cycle.period_us", "period_us");
}

/// Checks that the sensor can measure the relevant forces.
fn check_force_range(findings: &mut Findings, rig: &Rig) {
    let sensor = &rig.sensor;
    let largest = |row: &[Finite; 6]| row.iter().map(|gain| gain.abs()).sum::<f64>() * f64::from(sensor.range_counts);
    let [x, y] = [largest(&sensor.calibration[0]), largest(&sensor.calibration[1])];
    let (axis, largest) = if x < y { ("Fx", x) } else { ("Fy", y) };
    let (yield_n, limit) = (*rig.fixture.yield_n, *rig.guard.force_limit_n);
    if largest < yield_n {
        findings
            .error(
                "sensor.range_counts",
                format!(
                    "the sensor saturates at {} N in {axis}, below `fixture.yield_n` of {yield_n} N: the surface could \
                     never yield",
                    round(largest)
                ),
                "check `calibration` and `range_counts`, or lower `yield_n`",
            )
            .see("fixture.yield_n", "yield_n");
    } else if largest < limit {
        findings
            .warning(
                "guard.force_limit_n",
                format!(
                    "`guard.force_limit_n` is {limit} N, and the sensor saturates at {} N in {axis}: the limit is never \
                     seen",
                    round(largest)
                ),
                "lower the limit below what the sensor can measure",
            )
            .see("sensor.range_counts", "range_counts");
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::sync::Arc;

    use crate::{Source, load_rig};

    #[test]
    fn a_zero_above_the_friction_is_warned_of() {
        let rig = Source::named("builtin:paper-admittance.yaml").read().unwrap();
        let warned = |most_n: f64| {
            let text = rig.replace("range_counts: 32000", &format!("range_counts: 32000\n  tare_up_to_n: {most_n}"));
            let files = [(PathBuf::from("rig.yaml"), Arc::from(text))];
            let warnings = load_rig(Source::among("rig.yaml", files)).unwrap().warnings;
            warnings.iter().filter(|warning| warning.message.contains("tare_up_to_n")).count()
        };
        assert_eq!([1.0, 3.0, 3.1, 100.0].map(warned), [0, 0, 1, 1]);
    }
}
