//! `yieldwall calibrate`: properties of a machine, measured by a person with nothing enabled.

use std::f64::consts::TAU;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::bus::check_buses;
use super::ending::rig_failure;
use super::failure::{self, Exit, Failure};
use super::fit;
use super::interrupt::on_interrupt;
use super::on_bus::live_failure;
use super::output::Output;
use super::replace::Replace;
use yieldwall_config::{self as config, Loaded, Source};
use yieldwall_motion::elementary::sin_cos;
use yieldwall_motion::identification::{Estimate, Kinematics, Mistaken, Visited, kinematics, mistaken};
use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::{JointAngles, TipPoint};
use yieldwall_rig::EmbeddedRig;
use yieldwall_run::RunError;

/// Points of the simulated plate on each of two circles, and their radii as shares of the working radius.
const POINTS: u32 = 8;
const RADII: [f64; 2] = [0.45, 0.9];
/// Points at least.
const LEAST: usize = 8;
/// A point is mistaken if its error exceeds this multiple of the mean error, and this distance in m.
const MISTAKEN: f64 = 3.0;
const MISTAKEN_M: f64 = 5e-4;

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Identify link lengths and encoder zeros from hand-guided points; write nothing
    Kinematics(Arguments),
}

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Table of points with the columns x_m and y_m, in the base frame
    ///
    /// If it also has left_rad and right_rad, the angles measured there, nobody has to guide the arm.
    #[arg(long, value_name = "FILE.csv")]
    points: Option<PathBuf>,
    /// Save points and angles to a table of this format
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    #[command(flatten)]
    replace: Replace,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

pub(super) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let Command::Kinematics(arguments) = command;
    let rig = config::load_rig(Source::named(&arguments.rig))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    if let Some(out) = &arguments.out {
        arguments.replace.check_can_write(out)?;
    }
    let rows = arguments.points.as_deref().map(table).transpose()?;
    if let (Some(rows), Some(path)) = (&rows, &arguments.points) {
        check_points(rows, path, &rig.value)?;
    }
    let visited = match rows {
        Some(Rows::Visited(visited)) => visited,
        Some(Rows::Points(points)) => visit(arguments, &rig, &points, output)?,
        None => visit(arguments, &rig, &plate(arguments, &rig.value)?, output)?,
    };
    if let Some(out) = &arguments.out {
        arguments.replace.write(out, written(&visited).as_bytes())?;
        output.news(&format!("points    {}", out.display()))?;
    }
    let geometry = rig.value.linkage.geometry();
    let found = kinematics(&geometry, &visited).map_err(|error| {
        let what = match mistaken(&geometry, &visited, MISTAKEN_M) {
            Some(Mistaken::Point(at)) => format!("point {} does not fit the other points", at + 1),
            Some(Mistaken::Exchanged(one, other)) => {
                format!("points {} and {} look exchanged", one + 1, other + 1)
            }
            None => error.to_string(),
        };
        let help = "compare the points with the plate, and guide the tool to at least eight points that are spread over the working disc";
        Failure::new(Exit::OutOfTolerance, format!("nothing was identified: {what}"), help)
    })?;
    tell(&rig.value, &visited, &found, output)
}

/// Returns points of a plate that is only simulated.
fn plate(arguments: &Arguments, rig: &config::Rig) -> Result<Vec<TipPoint>, Failure> {
    #[cfg(target_os = "linux")]
    if arguments.on_bus.is_asked() {
        let message = "there is no table of points for the tool";
        let help = "measure or drill a plate, and write its points into a table: --points POINTS.csv with the columns x_m and y_m";
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let _ = arguments;
    let radius_m = rig.linkage.working_radius_m.get();
    let on = |share: f64| {
        (0..POINTS).map(move |at| {
            let (sin, cos) = sin_cos(TAU * f64::from(at) / f64::from(POINTS));
            TipPoint::new(share * radius_m * cos, share * radius_m * sin)
        })
    };
    Ok(RADII.into_iter().flat_map(on).collect())
}

/// Rows of a table.
enum Rows {
    Points(Vec<TipPoint>),
    Visited(Vec<Visited>),
}

/// Checks that there are enough points, and that the arm reaches each.
fn check_points(rows: &Rows, path: &Path, rig: &config::Rig) -> Result<(), Failure> {
    let points: Vec<TipPoint> = match rows {
        Rows::Points(points) => points.clone(),
        Rows::Visited(visited) => visited.iter().map(|(point, _)| *point).collect(),
    };
    if points.len() < LEAST {
        let message = format!("{} has {} points (at least {LEAST} needed)", path.display(), points.len());
        let help = "spread them over the working disc";
        return Err(Failure::about_file(Exit::ConfigInvalid, path, message, help));
    }
    // Errors of the linkage were reported when the rig was read.
    let Ok(linkage) = FiveBar::new(rig.linkage.geometry()) else { return Ok(()) };
    let beyond = (1..).zip(&points).find(|(_, point)| linkage.inverse(**point).is_err());
    beyond.map_or(Ok(()), |(number, point)| {
        let [x, y] = point.to_array();
        let message = format!("{}: the arm does not reach point {number}, x {x} m and y {y} m", path.display());
        let help = "points are in metres, in the base frame, whose origin is the middle of the working disc";
        Err(Failure::about_file(Exit::ConfigInvalid, path, message, help))
    })
}

/// Reads a table with a row of column names.
fn table(path: &Path) -> Result<Rows, Failure> {
    let about = |message: String| {
        let help = "write the columns x_m and y_m, and left_rad and right_rad if the angles were measured, separated by commas";
        Failure::about_file(Exit::ConfigInvalid, path, message, help)
    };
    let text = fs::read_to_string(path).map_err(|error| match error.kind() {
        ErrorKind::NotFound => Failure::about_file(
            Exit::ConfigInvalid,
            path,
            format!("{} does not exist", path.display()),
            "check the path",
        ),
        _ => Failure::about_file(Exit::ConfigInvalid, path, format!("{}: {error}", path.display()), ""),
    })?;
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let names: Vec<&str> = lines.next().map_or(Vec::new(), |(_, line)| line.split(',').map(str::trim).collect());
    let place = |column: &str| names.iter().position(|name| *name == column);
    let (Some(x), Some(y)) = (place("x_m"), place("y_m")) else {
        return Err(about(format!("{}: the first line does not name x_m and y_m", path.display())));
    };
    let angles = match (place("left_rad"), place("right_rad")) {
        (None, None) => None,
        (Some(left), Some(right)) => Some((left, right)),
        _ => return Err(about(format!("{}: the first line names the angle of one joint alone", path.display()))),
    };
    let (mut points, mut visited) = (Vec::new(), Vec::new());
    for (number, line) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let value = |at: usize| {
            let cell = cells.get(at).copied().unwrap_or_default();
            let value: Option<f64> = cell.parse().ok().filter(|value: &f64| value.is_finite() && value.abs() <= 1e3);
            value.ok_or_else(|| {
                let name = names.get(at).copied().unwrap_or_default();
                about(format!("{}:{number}: `{cell}` is no {name}", path.display()))
            })
        };
        let point = TipPoint::new(value(x)?, value(y)?);
        points.push(point);
        if let Some((left, right)) = angles {
            visited.push((point, JointAngles::new(value(left)?, value(right)?)));
        }
    }
    Ok(if angles.is_some() { Rows::Visited(visited) } else { Rows::Points(points) })
}

fn written(visited: &[Visited]) -> String {
    let row = |(point, angles): &Visited| {
        let ([x, y], [left, right]) = (point.to_array(), angles.to_array());
        format!("{x},{y},{left},{right}\n")
    };
    format!("x_m,y_m,left_rad,right_rad\n{}", visited.iter().map(row).collect::<String>())
}

/// Guides the tool to points, by a person or in the simulation.
fn visit(
    arguments: &Arguments,
    rig: &Loaded<config::Rig>,
    points: &[TipPoint],
    output: &mut Output,
) -> Result<Vec<Visited>, Failure> {
    #[cfg(target_os = "linux")]
    if arguments.on_bus.is_asked() {
        use super::at_the_arm::Typed;
        use super::first_motion::at_rest;
        let place = ("calibrate kinematics", arguments.rig.as_str());
        let angles = at_rest(&arguments.on_bus, place, rig, output, |on_bus, terms, is_interrupted, output, tell| {
            let typed = Typed::new(std::sync::Arc::clone(is_interrupted));
            let mut help = |task| typed.help(task);
            on_bus.visit(terms, points, &mut help, is_interrupted, |news| tell(output, news))
        })?;
        return Ok(points.iter().copied().zip(angles).collect());
    }
    let (rig, scene) = (&rig.value, rig.scene()?.value);
    let is_interrupted = on_interrupt()?;
    let machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed);
    let mut machine = machine.map_err(|error| rig_failure(&error))?;
    output.simulated("arm", rig, &format!("guided to {} points", points.len()));
    let angles = machine.visit(points, &is_interrupted).map_err(|error| rig_failure(&error))?;
    let angles = angles.map_err(|error| match error {
        RunError::Interrupted => Failure::new(Exit::Interrupted, "interrupted; nothing was enabled", ""),
        error => live_failure(&error),
    })?;
    Ok(points.iter().copied().zip(angles).collect())
}

/// A number of a rig: its key, its value in the file and its measured value.
type Row = (String, f64, Estimate);

fn rows(rig: &config::Rig, found: &Kinematics) -> Vec<Row> {
    let mut rows = Vec::new();
    for (at, name) in ["proximal_m", "distal_m"].into_iter().enumerate() {
        let (old, new) = [(rig.linkage.proximal_m, found.proximal_m), (rig.linkage.distal_m, found.distal_m)][at];
        for (chain, (old, new)) in old.into_iter().zip(new).enumerate() {
            rows.push((format!("linkage.{name}[{chain}]"), old.get(), new));
        }
    }
    for (joint, (drive, zero)) in rig.drives.iter().zip(found.zero_rad).enumerate() {
        // The zero of a drive that homes follows from its angle at home.
        let (key, old) = match drive.homing {
            Some(homing) => ("homing.angle_rad", homing.angle_rad.get()),
            None => ("zero_offset_rad", drive.zero_offset_rad.get()),
        };
        let Estimate { value, low, high } = zero;
        let new = Estimate { value: old + value, low: old + low, high: old + high };
        rows.push((format!("drives[{joint}].{key}"), old, new));
    }
    rows
}

fn tell(rig: &config::Rig, visited: &[Visited], found: &Kinematics, output: &mut Output) -> Result<(), Failure> {
    let rows = rows(rig, found);
    let [before_m, after_m] = found.residual_m;
    let (worst, worst_m) = found.worst;
    let mistaken = || {
        let message = format!(
            "point {} is {:.2} mm off, with {:.2} mm RMS of all points",
            worst + 1,
            1e3 * worst_m,
            1e3 * after_m
        );
        let help = "compare this point with the plate, and guide the tool there again; do not use these numbers";
        Failure::new(Exit::OutOfTolerance, message, help)
    };
    let judged = if worst_m > MISTAKEN * after_m && worst_m > MISTAKEN_M { Err(mistaken()) } else { Ok(()) };
    if output.is_json() {
        let number = |(key, old, new): &Row| json!({ "key": key, "old": old, "new": new.value, "low": new.low, "high": new.high });
        let document = json!({
            "points": visited.len(),
            "numbers": rows.iter().map(number).collect::<Vec<_>>(),
            "residual_before_m": before_m,
            "residual_m": after_m,
            "worst_point": worst + 1,
            "worst_m": worst_m,
        });
        return output.end(document, judged);
    }
    let limit_m = MISTAKEN_M.max(MISTAKEN * after_m);
    let mut text = format!(
        "{}\nerror     {:.3} mm RMS with the rig file, {:.3} mm RMS with the numbers below\nworst     point {}: {:.3} mm (limit {:.3} mm)\n",
        failure::verdict(&judged, || format!("{} points fit one arm", visited.len())),
        1e3 * before_m,
        1e3 * after_m,
        worst + 1,
        1e3 * worst_m,
        1e3 * limit_m
    );
    for (key, old, new) in &rows {
        text += &format!("  {key:32} {old:>10} -> {:.6} +- {:.6}\n", new.value, new.half_width());
    }
    let advice = "nothing written; copy each number that changed by more than its 95 % interval (+-) into the rig file";
    text += &format!("{}\n", fit::filled("", "", advice, fit::USUAL));
    output.result(&text)?;
    judged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_cannot_be_read_is_told_by_its_line() {
        let path = std::env::temp_dir().join(format!("yieldwall-points-{}.csv", std::process::id()));
        let told = |text: &str| {
            fs::write(&path, text).unwrap();
            table(&path).err().map(|failure| failure.report.diagnostics[0].message.clone()).unwrap_or_default()
        };
        assert!(told("x,y\n0,0\n").contains("does not name x_m and y_m"));
        assert!(told("y_m, x_m\n0.1,0.2\n0.1,\n").ends_with(":3: `` is no x_m"));
        assert!(told("x_m,y_m,left_rad\n0,0,0\n").ends_with("names the angle of one joint alone"));
        assert!(told("x_m,y_m,left_rad,right_rad\n0,0,NaN,0\n").ends_with(":2: `NaN` is no left_rad"));
        assert_eq!(told("y_m, x_m\n\n0.1,0.2\n"), "");
        let Ok(Rows::Points(points)) = table(&path) else { panic!("two columns are points") };
        assert_eq!(points, [TipPoint::new(0.2, 0.1)]);
        let visited = [(TipPoint::new(0.1, -0.2), JointAngles::new(2.0, 0.7))];
        fs::write(&path, written(&visited)).unwrap();
        assert!(matches!(table(&path), Ok(Rows::Visited(read)) if read == visited));
        fs::remove_file(&path).unwrap();
        let missing = table(&path).err().unwrap().report.diagnostics.remove(0);
        assert!(missing.message.ends_with(".csv does not exist"), "{missing:?}");
        assert_eq!(missing.help.as_deref(), Some("check the path"));
    }
}
