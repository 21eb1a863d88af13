//! `yieldwall sensor calibrate`: the readings of the force sensor under known forces.

use serde_json::json;

use super::{Calibrate, columns, document, ended, simulated};
use crate::failure::{self, Exit, Failure};
use crate::first_motion::at_rest;
use crate::interrupt::on_interrupt;
use crate::output::Output;
use yieldwall_config::{self as config, Loaded};
use yieldwall_motion::identification::{ForceMap, force_map};
use yieldwall_run::Pulled;

/// Largest deviation of a gain from 1, rotation of the axes in degrees, and share of a force along the other axis. Beyond these
/// limits the rig does not run with the values of its file.
const GAIN: f64 = 0.1;
const TURN_DEG: f64 = 10.0;
const CROSS_TALK: f64 = 0.1;
/// Smallest ratio of a pull to the noise, and largest share of the pull that a map may leave.
const NOISES: f64 = 20.0;
const RESIDUAL: f64 = 0.05;
/// Smallest share of a pull that the sensor has to feel along each axis; below it there is no calibration.
const FELT: f64 = 0.05;

pub(super) fn run(arguments: &Calibrate, rig: &Loaded<config::Rig>, output: &mut Output) -> Result<(), Failure> {
    let force_n = arguments.force.get();
    let most_n = rig.value.guard.force_limit_n.get();
    if force_n > most_n {
        let message = format!("--force {force_n}: above `guard.force_limit_n` of {most_n} N");
        return Err(Failure::new(Exit::Usage, message, "pull as hard as a hand does, for example --force 8"));
    }
    #[cfg(target_os = "linux")]
    let is_on_bus = arguments.on_bus.is_asked();
    #[cfg(not(target_os = "linux"))]
    let is_on_bus = false;
    let pulled = if is_on_bus {
        use crate::at_the_arm::Typed;
        let place = ("sensor calibrate", arguments.rig.as_str());
        at_rest(&arguments.on_bus, place, rig, output, |on_bus, terms, is_interrupted, output, tell| {
            let typed = Typed::new(std::sync::Arc::clone(is_interrupted));
            let mut help = |task| typed.help(task);
            on_bus.pulls(terms, force_n, &mut help, is_interrupted, |news| tell(output, news))
        })?
    } else {
        let (mut machine, is_interrupted) = (simulated(rig, output)?, on_interrupt()?);
        let pulled = machine.pulls(&rig.value, force_n, &is_interrupted);
        ended(pulled.map_err(|error| super::rig_failure(&error))?)?
    };
    let sensor = &rig.value.sensor;
    if pulled.iter().any(|pulled| pulled.shown.count() == 0) {
        let help = "check the sensor with `yieldwall sensor monitor`";
        let message = format!("{} has sent no valid sample", sensor.name);
        return Err(Failure::new(Exit::DeviceMismatch, message, help));
    }
    let pulls: Vec<_> = pulled
        .iter()
        .map(|pulled| {
            let (expected, felt) = (pulled.expected.0, pulled.shown.mean().0);
            ([expected.x, expected.y], [felt.x, felt.y])
        })
        .collect();
    let map = force_map(&pulls).map_err(|error| Failure::new(Exit::OutOfTolerance, error.to_string(), ""))?;
    let noise_n =
        pulled.iter().flat_map(|pulled| pulled.shown.deviation().0.iter().take(2).copied().collect::<Vec<_>>());
    let noise_n = noise_n.fold(0.0, f64::max);
    let is_felt = map.gains().into_iter().all(|gain| gain >= FELT);
    let is_clear = is_felt
        && force_n >= NOISES * noise_n
        && map.residual_n <= RESIDUAL * force_n
        && pulled.iter().all(|pulled| pulled.shown.saturated == 0);
    let rows = corrected(&sensor.calibration, &map).filter(|_| is_clear);
    let judged = match (is_felt, is_clear) {
        (false, _) => Err(unfelt(force_n, &map)),
        (_, true) => judge(&map, rows.is_some()),
        _ => Err(unclear(force_n, noise_n, &map)),
    };
    if output.is_json() {
        let one = |pulled: &Pulled| {
            json!({
                "force_n": pulled.force.to_array(), "expected": document(pulled.expected),
                "mean": document(pulled.shown.mean()), "deviation": document(pulled.shown.deviation()),
                "saturated": pulled.shown.saturated,
            })
        };
        let document = json!({
            "sensor": sensor.name, "pulls": pulled.iter().map(one).collect::<Vec<_>>(), "zero_n": map.zero_n, "gains": map.gains(),
            "turn_rad": map.turn_rad(), "cross_talk": map.cross_talk(), "is_mirrored": map.is_mirrored(),
            "residual_n": map.residual_n, "rows_of_fx_and_fy": rows,
        });
        return output.end(document, judged);
    }
    let verdict = failure::verdict(&judged, || "gain, rotation and cross-talk within their limits".to_owned());
    let text = text(&rig.value, &pulled, (force_n, is_felt.then_some(&map)), rows.as_ref());
    output.result(&format!("{verdict}\n{text}"))?;
    judged
}

/// Returns the first two rows of a calibration that makes the readings correct; `None` if the map has no inverse.
fn corrected(calibration: &[[config::Finite; 6]; 6], map: &ForceMap) -> Option<[[f64; 6]; 2]> {
    let inverse = map.inverse()?;
    let [along_x, along_y, ..] = calibration.map(|row| row.map(config::Finite::get));
    let row = |[x, y]: [f64; 2]| std::array::from_fn(|at| x * along_x[at] + y * along_y[at]);
    Some(inverse.map(row))
}

/// Returns the result as text; without `map`, of pulls that the sensor did not feel.
fn text(
    rig: &config::Rig,
    pulled: &[Pulled],
    (force_n, map): (f64, Option<&ForceMap>),
    rows: Option<&[[f64; 6]; 2]>,
) -> String {
    let heading = super::AXES.map(|(axis, unit)| format!("{:>10}", format!("{axis} {unit}"))).concat();
    let mut text = format!("{:>16}{heading}\n", "pull x, y N");
    for pulled in pulled {
        let [x, y] = pulled.force.to_array();
        text += &format!("{:>16}{}\n", format!("{x}, {y}"), columns(pulled.shown.mean()));
    }
    let Some(map) = map else { return text };
    let [gain_x, gain_y] = map.gains();
    let [zero_x, zero_y] = map.zero_n.map(unsigned_zero);
    let range = rig.sensor.range_counts as f64;
    let most = rig.sensor.calibration.map(|row| row.iter().map(|value| value.get().abs()).fold(0.0, f64::max) * range);
    let saturated: u64 = pulled.iter().map(|pulled| pulled.shown.saturated).sum();
    text += &format!("sensor    {}, in its own frame\n", rig.sensor.name);
    text += &format!("gain      x {gain_x:.3}, y {gain_y:.3} (limits {:.1} to {:.1})\n", 1.0 - GAIN, 1.0 + GAIN);
    text += &format!("rotation  {:.2} deg (limit {TURN_DEG} deg)\n", map.turn_rad().to_degrees().abs());
    text += &format!("crosstalk {:.1} % (limit {:.0} %)\n", 100.0 * map.cross_talk(), 100.0 * CROSS_TALK);
    text += &format!("offset    x {zero_x:.3} N, y {zero_y:.3} N\n");
    text += &format!("residual  {:.3} N (limit {:.3} N)\n", map.residual_n, RESIDUAL * force_n);
    text += &format!("range     x {:.0} N, y {:.0} N\n", most[0], most[1]);
    text += &format!("saturated {saturated} samples (limit 0)\n");
    if let Some(rows) = rows {
        text += "nothing written; replace the rows of Fx and Fy in `sensor.calibration` by:\n";
        for row in rows {
            let numbers: Vec<String> = row.iter().map(|value| number(*value)).collect();
            text += &format!("    - [{}]\n", numbers.join(", "));
        }
    }
    text
}

/// Returns a force in N rounded to three decimals, without the sign of a zero.
fn unsigned_zero(force_n: f64) -> f64 {
    if force_n.abs() < 5e-4 { 0.0 } else { force_n }
}

/// Returns a number of a calibration, as YAML reads it.
fn number(value: f64) -> String {
    if value == 0.0 { "0.0".to_owned() } else { format!("{value:.6e}") }
}

/// Returns the failure for pulls that the sensor hardly felt.
fn unfelt(force_n: f64, map: &ForceMap) -> Failure {
    let [x, y] = map.gains().map(|gain| force_n * gain);
    let message = format!(
        "the sensor reads {x:.2} N along x and {y:.2} N along y under pulls of {force_n} N (limit {:.2} N)",
        FELT * force_n
    );
    let help = "check that the force acts on the handle beyond the sensor, along each axis, and watch `yieldwall sensor monitor`; if the readings \
                have another size, `sensor.calibration` belongs to another sensor";
    Failure::new(Exit::OutOfTolerance, message, help)
}

/// Returns the failure for inconclusive pulls.
fn unclear(force_n: f64, noise_n: f64, map: &ForceMap) -> Failure {
    let message = format!(
        "pulls of {force_n} N are inconclusive: noise {noise_n:.3} N (limit {:.3} N), residual {:.3} N (limit {:.3} N), no sample may be saturated",
        force_n / NOISES,
        map.residual_n,
        RESIDUAL * force_n
    );
    let help = "pull harder or more steadily, let the arm rest, and watch `yieldwall sensor monitor`";
    Failure::new(Exit::OutOfTolerance, message, help)
}

fn judge(map: &ForceMap, has_rows: bool) -> Result<(), Failure> {
    let refused = |message: String, help: &str| Err(Failure::new(Exit::OutOfTolerance, message, help));
    if map.is_mirrored() || !has_rows {
        let message = "an axis has the wrong sign, axes are swapped, or one axis reads nothing".to_owned();
        return refused(message, "check the cable and `mounted_on`; to keep the wiring, use the rows above");
    }
    let off = map.gains().map(|gain| (gain - 1.0).abs()).into_iter().fold(0.0, f64::max);
    let (turn_deg, talk) = (map.turn_rad().to_degrees().abs(), map.cross_talk());
    if off > GAIN || turn_deg > TURN_DEG || talk > CROSS_TALK {
        let message = format!(
            "readings are wrong: gain error {:.0} %, rotation {turn_deg:.1} deg, cross-talk {:.0} %",
            100.0 * off,
            100.0 * talk
        );
        return refused(
            message,
            "copy the rows above into the rig file, or correct `mounting_angle_rad` if only the rotation is wrong",
        );
    }
    Ok(())
}
