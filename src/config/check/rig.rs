//! Relations between the keys of a rig: cycle and force sensor.

use nalgebra::Matrix6;
use yieldwall_drives::profiles::{self, Role};

use super::Findings;
use super::bus::{check_heartbeats, check_nodes, check_profiles};
use super::fixture::{Host, check_fixture};
use super::limits::{check_control, check_drive_limits, check_guard};
use super::reach::check_linkage;
use super::words::{round, shorten_numbers};
use crate::config::number::Finite;
use crate::config::tree::Rig;
use crate::sensing::{Calibration, SensingError};

/// Least squared sine of the angle between the rows Fx and Fy of a calibration; below it they say the same.
const LEAST_ROW_ANGLE: f64 = 1e-12;

/// All rules of a rig. `in_range` says that every single number is in its range, so that derived ones make sense.
pub(in crate::config) fn check_rig(findings: &mut Findings, rig: &Rig, in_range: bool) {
    check_cycle(findings, rig);
    check_nodes(findings, rig);
    check_heartbeats(findings, rig);
    check_profiles(findings, rig);
    check_sensor(findings, rig);
    check_control(findings, rig);
    check_guard(findings, rig);
    let period_s = if in_range { f64::from(rig.cycle.period_us) * 1e-6 } else { 0.0 };
    check_fixture(findings, "fixture", &rig.fixture, Host::Rig, period_s);
    if in_range {
        check_drive_limits(findings, rig);
        check_linkage(findings, rig);
    }
}

fn check_cycle(findings: &mut Findings, rig: &Rig) {
    let (period, compute) = (rig.cycle.period_us, rig.cycle.compute_at_us);
    if compute >= period {
        findings
            .error(
                "cycle.compute_at_us",
                format!(
                    "`cycle.compute_at_us` is {compute} us, not below `cycle.period_us` of {period} us: the control step \
                     would run after the next SYNC"
                ),
                "leave time for the TPDOs before it and for the RPDOs after it; 620 of 1000 us fits two drives at 1 Mbit/s",
            )
            .see("cycle.period_us", "period_us");
    }
    check_interpolation_time(findings, period);
    let inner = rig.plant.drive_position_loop.period_us;
    if inner == 0 || !period.is_multiple_of(inner) {
        findings
            .error(
                "plant.drive_position_loop.period_us",
                format!(
                    "`plant.drive_position_loop.period_us` is {inner} us, and `cycle.period_us` of {period} us is not a \
                     whole multiple of it"
                ),
                "drives close their position loop a whole number of times a cycle, such as every 125 of 1000 us",
            )
            .see("cycle.period_us", "period_us");
    }
}

/// Whether the drives can be told the period: 60C2h holds one byte and a power of ten of a second.
fn check_interpolation_time(findings: &mut Findings, period_us: u32) {
    let mut value = period_us;
    while value > 0 && value.is_multiple_of(10) {
        value /= 10;
    }
    if value > u32::from(u8::MAX) {
        findings.error(
            "cycle.period_us",
            format!("`cycle.period_us` is {period_us} us, and the drives are told it as 1 to 255 times a power of ten"),
            "write a rounder period, such as 500, 1000 or 1250",
        );
    }
}

fn check_sensor(findings: &mut Findings, rig: &Rig) {
    let sensor = &rig.sensor;
    let cycle_hz = 1e6 / f64::from(rig.cycle.period_us);
    if let Some(corner) = sensor.low_pass_hz
        && *corner >= cycle_hz / 2.0
    {
        findings
            .error(
                "sensor.low_pass_hz",
                format!(
                    "`sensor.low_pass_hz` is {} Hz, not below half of the {} Hz of `cycle.period_us`",
                    *corner,
                    round(cycle_hz)
                ),
                "lower it, or write null for no filter",
            )
            .see("cycle.period_us", "period_us");
    }
    check_sample_rate(findings, rig, cycle_hz);
    let [fx, fy] = [&sensor.calibration[0], &sensor.calibration[1]];
    let dot = |a: &[Finite; 6], b: &[Finite; 6]| a.iter().zip(b).map(|(a, b)| **a * **b).sum::<f64>();
    let (xx, yy, xy) = (dot(fx, fx), dot(fy, fy), dot(fx, fy));
    let determinant = xx * yy - xy * xy;
    // Entries so large that the product overflows are no calibration either.
    if determinant.is_nan() || determinant <= LEAST_ROW_ANGLE * xx * yy {
        findings.error(
            "sensor.calibration",
            "the rows Fx and Fy of `sensor.calibration` do not tell two directions of force apart",
            "copy the matrix from the sensor's calibration sheet: row by row, N and N m per count",
        );
        return;
    }
    let matrix = Matrix6::from_fn(|row, column| *sensor.calibration[row][column]);
    if let Err(error) = Calibration::new(matrix, sensor.range_counts.max(1).into()) {
        let message = match error {
            SensingError::CalibrationSingular { .. } => {
                "the rows of `sensor.calibration` do not tell six directions apart".to_owned()
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

/// Whether the sensor samples as often as it can without samples that no cycle sees.
fn check_sample_rate(findings: &mut Findings, rig: &Rig, cycle_hz: f64) {
    let sensor = &rig.sensor;
    let Some(Role::ForceSensor { sample_rates_hz, .. }) = profiles::find(&sensor.profile).map(|profile| profile.role)
    else {
        return;
    };
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

/// Whether the sensor can measure the forces that matter.
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
    use crate::config::load_rig;
    use crate::config::malformed;

    #[test]
    fn a_period_that_the_drives_cannot_be_told_is_refused() {
        // 1125 us is a multiple of the drives' 125 us, and its low byte would be another period.
        for (period, is_refused) in [("1125", true), ("1250", false)] {
            let text = malformed::base_text("rig.yaml").replace("period_us: 1000", &format!("period_us: {period}"));
            let report = load_rig(malformed::with("rig.yaml", "rig.yaml", &text)).err();
            let is_it = |report: &crate::config::Report| {
                report.diagnostics.iter().any(|finding| finding.message.contains("1 to 255 times"))
            };
            assert_eq!(report.as_ref().is_some_and(is_it), is_refused, "{period}: {report:?}");
        }
    }
}
