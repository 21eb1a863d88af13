//! `yieldwall sensor`: the readings of a rig's force sensor while nothing is enabled.

mod calibrate;

use std::sync::atomic::Ordering;

use serde_json::{Value, json};

use super::bus::check_buses;
use super::ending::rig_failure;
use super::failure::{Exit, Failure};
use super::first_motion::at_rest;
use super::interrupt::on_interrupt;
use super::on_bus::live_failure;
use super::output::Output;
use yieldwall_config::{self as config, Loaded, Positive, Source};
use yieldwall_motion::sensing::Wrench;
use yieldwall_rig::EmbeddedRig;
use yieldwall_run::{RunError, Wrenches};

/// Time from one line to the next, s.
const ROW_S: f64 = 0.5;
/// Share of the yield force that a zero may be, unless said otherwise.
const ZERO_SHARE: f64 = 0.25;
/// The axes, with their units.
const AXES: [(&str, &str); 6] = [("Fx", "N"), ("Fy", "N"), ("Fz", "N"), ("Tx", "N m"), ("Ty", "N m"), ("Tz", "N m")];

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Show readings every half second, then mean, deviation and range of each axis
    Monitor(Monitor),
    /// Show the zero that `sensor.tare_up_to_n` would take, or why not; save nothing
    Tare(Tare),
    /// Calibrate the sensor from known pulls along x and y; write nothing
    ///
    /// The command measures sign, gain, direction and cross-talk of the axes in the plane of the arm. It prints the calibration
    /// that they give.
    Calibrate(Calibrate),
}

#[derive(Debug, clap::Args)]
pub(super) struct Monitor {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Duration in s
    #[arg(long = "for", value_name = "S", default_value_t = 10.0, value_parser = seconds, allow_hyphen_values = true)]
    seconds: f64,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

#[derive(Debug, clap::Args)]
pub(super) struct Tare {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Largest force in N that counts as a zero; default: the value in the rig file, or else a quarter of its yield force
    #[arg(long, value_name = "N", value_parser = force, allow_hyphen_values = true)]
    up_to: Option<Positive>,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

#[derive(Debug, clap::Args)]
pub(super) struct Calibrate {
    /// Rig file; `builtin:paper-admittance.yaml` is the copy in the program
    #[arg(value_name = "RIG.yaml")]
    rig: String,
    /// Force of each pull on the tool in N: a known weight over a pulley, or a spring balance
    #[arg(long, value_name = "N", value_parser = force, default_value = "8", allow_hyphen_values = true)]
    force: Positive,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    on_bus: super::first_motion::OnBus,
}

fn seconds(text: &str) -> Result<f64, String> {
    let wanted = || format!("write seconds from 0.1 to 100000, such as 10, not `{text}`");
    text.parse().ok().filter(|seconds| (0.1..=1e5).contains(seconds)).ok_or_else(wanted)
}

fn force(text: &str) -> Result<Positive, String> {
    let value = text.parse().ok().and_then(Positive::new);
    value.ok_or_else(|| format!("write a force in N above 0, such as 3, not `{text}`"))
}

pub(super) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let file = match command {
        Command::Monitor(monitor) => &monitor.rig,
        Command::Tare(tare) => &tare.rig,
        Command::Calibrate(calibrate) => &calibrate.rig,
    };
    let rig = config::load_rig(Source::named(file))?;
    output.configuration(&rig.warnings)?;
    check_buses(&rig, None, output)?;
    match command {
        Command::Monitor(monitor) => watch(monitor, &rig, output),
        Command::Tare(tare) => zero(tare, &rig, output),
        Command::Calibrate(arguments) => calibrate::run(arguments, &rig, output),
    }
}

fn simulated(rig: &Loaded<config::Rig>, output: &Output) -> Result<EmbeddedRig, Failure> {
    let (rig, scene) = (&rig.value, rig.scene()?.value);
    let machine = EmbeddedRig::new(rig, &scene, &rig.fixture, scene.seed);
    let machine = machine.map_err(|error| rig_failure(&error))?;
    output.simulated("sensor", rig, "hands off");
    Ok(machine)
}

fn watch(arguments: &Monitor, rig: &Loaded<config::Rig>, output: &mut Output) -> Result<(), Failure> {
    let times_s = [arguments.seconds, ROW_S];
    let heading = AXES.map(|(axis, unit)| format!("{:>10}", format!("{axis} {unit}"))).concat();
    let mut rows = Vec::new();
    let (mut printed, mut has_asked) = (Ok(()), false);
    let mut told = |output: &mut Output, from_s: f64, row: Wrenches| {
        let mean = (row.count() > 0).then(|| row.mean());
        let values = mean.map_or_else(|| format!("{:>10}", "-").repeat(AXES.len()), columns);
        let above = if rows.is_empty() { format!("{:>8}{heading}\n", "time s") } else { String::new() };
        rows.push(json!({ "from_s": from_s, "samples": row.count(), "mean": mean.map(document) }));
        let line = output.news(&format!("{above}{from_s:8.1}{values}"));
        printed = std::mem::replace(&mut printed, Ok(())).and(line);
    };
    #[cfg(target_os = "linux")]
    let is_on_bus = arguments.on_bus.is_asked();
    #[cfg(not(target_os = "linux"))]
    let is_on_bus = false;
    let shown = if is_on_bus {
        at_rest(
            &arguments.on_bus,
            ("sensor monitor", &arguments.rig),
            rig,
            output,
            |on_bus, terms, is_interrupted, output, tell| {
                let shown = on_bus.sense(terms, times_s, is_interrupted, |news| match news {
                    yieldwall_run::host::News::Sensed(from_s, row) => told(output, from_s, *row),
                    news => tell(output, news),
                });
                has_asked = is_interrupted.load(Ordering::Relaxed);
                shown
            },
        )?
    } else {
        let (mut machine, is_interrupted) = (simulated(rig, output)?, on_interrupt()?);
        let shown = machine.sense(&rig.value, times_s, &is_interrupted, |from_s, row| told(output, from_s, row));
        has_asked = is_interrupted.load(Ordering::Relaxed);
        ended(shown.map_err(|error| rig_failure(&error))?)?
    };
    printed?;
    let name = &rig.value.sensor.name;
    let listened_s = if has_asked { ROW_S * rows.len() as f64 } else { arguments.seconds };
    let per_second = shown.count() as f64 / listened_s;
    let end = if shown.count() == 0 {
        let help = "check the sensor with `yieldwall doctor`";
        Err(Failure::new(Exit::DeviceMismatch, format!("{name} has sent no valid sample"), help))
    } else if has_asked {
        Err(Failure::new(Exit::Interrupted, "interrupted; nothing was enabled", ""))
    } else {
        Ok(())
    };
    if output.is_json() {
        return output.end(
            json!({
                "sensor": name, "samples": shown.count(), "samples_per_s": per_second,
                "saturated": shown.saturated, "invalid": shown.invalid,
                "mean": document(shown.mean()), "deviation": document(shown.deviation()),
                "least": document(shown.least()), "greatest": document(shown.greatest()), "rows": rows,
            }),
            end,
        );
    }
    let mut text = String::new();
    for (word, wrench) in
        [("mean", shown.mean()), ("std dev", shown.deviation()), ("min", shown.least()), ("max", shown.greatest())]
    {
        text.push_str(&format!("{word:>8}{}\n", columns(wrench)));
    }
    text.push_str(&format!(
        "sensor    {name}, in its own frame\nsamples   {}, {per_second:.0} per second\n          {} saturated, {} invalid\n",
        shown.count(),
        shown.saturated,
        shown.invalid
    ));
    output.result(&text)?;
    end
}

fn zero(arguments: &Tare, rig: &Loaded<config::Rig>, output: &mut Output) -> Result<(), Failure> {
    // A zero above the friction that nobody sees moves the arm.
    let friction_n =
        Some(rig.value.fixture.friction_n.get()).filter(|friction_n| *friction_n > 0.0).unwrap_or(f64::INFINITY);
    let by_yield = || Positive::new((ZERO_SHARE * rig.value.fixture.yield_n.get()).min(friction_n));
    let most_n = arguments.up_to.or(rig.value.sensor.tare_up_to_n).or_else(by_yield);
    let most_n = most_n.ok_or_else(|| Failure::new(Exit::Usage, "the largest zero is 0 N", "write --up-to 3"))?;
    #[cfg(target_os = "linux")]
    let is_on_bus = arguments.on_bus.is_asked();
    #[cfg(not(target_os = "linux"))]
    let is_on_bus = false;
    let zero = if is_on_bus {
        at_rest(
            &arguments.on_bus,
            ("sensor tare", &arguments.rig),
            rig,
            output,
            |on_bus, terms, is_interrupted, output, tell| {
                on_bus.tare(terms, most_n, is_interrupted, |news| tell(output, news))
            },
        )?
    } else {
        let (mut machine, is_interrupted) = (simulated(rig, output)?, on_interrupt()?);
        let zero = machine.tare(&rig.value, most_n, &is_interrupted);
        ended(zero.map_err(|error| rig_failure(&error))?)?
    };
    if output.is_json() {
        let document = json!({ "sensor": rig.value.sensor.name, "zero": document(zero), "most_n": most_n });
        return output.report(document);
    }
    let heading = AXES.map(|(axis, unit)| format!("{:>10}", format!("{axis} {unit}"))).concat();
    let force_n = yieldwall_motion::elementary::hypot(zero.0.x, zero.0.y);
    let kept = match rig.value.sensor.tare_up_to_n {
        Some(most_n) if force_n <= most_n.get() => {
            format!("tare      {force_n:.3} N at each enabling (limit {} N)", most_n.get())
        }
        Some(most_n) => {
            format!(
                "tare      NOT OK: {force_n:.3} N (limit {} N, `tare_up_to_n`); the rig refuses to enable",
                most_n.get()
            )
        }
        None => {
            let most_n = most_n.get();
            let but = if most_n > friction_n {
                format!(
                    "\nwarning   {most_n} N exceed `friction_n` of {friction_n} N: if a hand rests on the handle during the\n          tare, the arm moves when the hand lets go"
                )
            } else {
                String::new()
            };
            format!("nothing saved; to tare at each enabling, write `tare_up_to_n: {most_n}` in `sensor`{but}")
        }
    };
    output.result(&format!("{:>8}{heading}\n{:>8}{}\n{kept}\n", "", "zero", columns(zero)))
}

/// Returns the result of a command that was not interrupted.
fn ended<T>(found: Result<T, RunError>) -> Result<T, Failure> {
    found.map_err(|error| match error {
        RunError::Interrupted => Failure::new(Exit::Interrupted, "interrupted; nothing was enabled", ""),
        error => live_failure(&error),
    })
}

fn columns(wrench: Wrench) -> String {
    // Without the sign of nothing.
    wrench.0.iter().map(|value| format!("{:10.3}", if value.abs() < 5e-4 { 0.0 } else { *value })).collect()
}

fn document(wrench: Wrench) -> Value {
    let [fx, fy, fz, tx, ty, tz] = wrench.0.into();
    json!({ "force_n": [fx, fy, fz], "torque_n_m": [tx, ty, tz] })
}
