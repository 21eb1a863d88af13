//! Measurements of the joints' loops, as a self-contained page.

use nalgebra::Complex;

use super::joint_text;
use crate::escaped::escaped;
use yieldwall_config::{ControlGains, Rig};
use yieldwall_figures::chart::{Axis, Chart, Color, Mark, Panel, Series, svg};
use yieldwall_motion::control::{Gains, ServoLoop, controller, open_loop};
use yieldwall_motion::elementary;
use yieldwall_motion::identification::Dynamics;
use yieldwall_run::JointLoop;
use yieldwall_run::assembly::{gains, period_s};

/// Points of a curve.
const POINTS: u32 = 200;
/// Lowest frequency of a plot, Hz.
const LOWEST_HZ: f64 = 1.0;

/// Returns the page; `tuned` has the gains that are proposed.
pub(super) fn html(rig: &Rig, found: &[&JointLoop], tuned: Option<&Rig>) -> String {
    let name = escaped(&rig.rig.name);
    let sections: String = found.iter().map(|joint| section(rig, joint, tuned)).collect();
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Loops of {name}</title>\n<style>\n\
         body {{ font: 15px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }}\n\
         pre {{ white-space: pre-wrap; }} svg {{ max-width: 100%; height: auto; }}\n</style></head><body>\n\
         <h1>Loops of {name}</h1>\n\
         <p>Made by yieldwall {version}, which is not a safety component. Intervals are of 95 %. Cycle: {period} us.</p>\n{sections}</body></html>\n",
        version = env!("CARGO_PKG_VERSION"),
        period = rig.cycle.period_us,
    )
}

fn section(rig: &Rig, joint: &JointLoop, tuned: Option<&Rig>) -> String {
    let name = rig.drives.get(joint.joint).map_or("", |drive| drive.name.as_str());
    let lines = escaped(&joint_text(joint, rig));
    let bode = match &joint.dynamics {
        Ok(dynamics) => svg(&loop_chart(rig, dynamics, tuned)),
        Err(_) => svg(&following_chart(joint)),
    };
    let step = step_chart(joint).map(|chart| svg(&chart)).unwrap_or_default();
    format!("<h2>{}</h2>\n<pre>{lines}</pre>\n{bode}\n{step}\n", escaped(name))
}

/// Known values at frequencies in Hz.
type Known = [(f64, Complex<f64>)];
/// A curve in a Bode plot: its name, its known values, and its drawing function.
type Curve = (String, Vec<(f64, Complex<f64>)>, Mark);
/// Curve over the frequency.
type Drawn = fn(&Known) -> Vec<(f64, f64)>;

fn bode(title: &str, curves: &[Curve]) -> Chart {
    let series = |of: Drawn| {
        let each = curves.iter().zip(Color::LINES);
        each.map(|((name, points, mark), color)| Series { name: name.clone(), points: of(points), mark: *mark, color })
            .collect::<Vec<_>>()
    };
    let panel = |y: &str, of: Drawn| Panel {
        title: String::new(),
        x: Axis::logarithmic("frequency (Hz)"),
        y: Axis::linear(y),
        series: series(of),
    };
    Chart { title: title.to_owned(), panels: vec![panel("gain (dB)", gain_db), panel("phase (deg)", phase_deg)] }
}

/// Returns the gain at each frequency, dB.
fn gain_db(points: &Known) -> Vec<(f64, f64)> {
    points.iter().map(|(hz, z)| (*hz, 20.0 * elementary::log10(elementary::hypot(z.re, z.im)))).collect()
}

/// Returns the phase at each frequency, less than half a turn from the one before; the first between -330 and 30 degrees.
fn phase_deg(points: &Known) -> Vec<(f64, f64)> {
    let mut last = -150.0;
    points
        .iter()
        .map(|(hz, z)| {
            let phase = elementary::atan2(z.im, z.re).to_degrees();
            last = phase - 360.0 * ((phase - last) / 360.0).round();
            (*hz, last)
        })
        .collect()
}

/// Returns the chart of the open loop, measured and identified; of the joint alone if the controllers act on the tool.
fn loop_chart(rig: &Rig, dynamics: &Dynamics, tuned: Option<&Rig>) -> Chart {
    let period_s = period_s(rig);
    let delay_cycles = (dynamics.delay_s.value / period_s).max(0.0);
    let [inertia, viscous] = [dynamics.inertia_kg_m2.value, dynamics.viscous_n_m_s_per_rad.value.max(0.0)];
    let is_joint = matches!(rig.control.gains, ControlGains::Joint { .. });
    let of_rig = |rig: &Rig| gains(&rig.control).map(|(gains, _)| gains).filter(|_| is_joint);
    // Without gains, a stiffness of one leaves only the joint.
    let alone = Gains { stiffness: 1.0, damping: 0.0, integral: 0.0 };
    let servo = |gains: Gains| ServoLoop { gains, period_s, delay_cycles };
    let highest_hz = 0.45 / period_s;
    let model = |gains: Gains| {
        let at =
            |point: u32| LOWEST_HZ * elementary::powf(highest_hz / LOWEST_HZ, f64::from(point) / f64::from(POINTS));
        let points = (0..=POINTS).map(at);
        points.filter_map(|hz| Some((hz, open_loop(&servo(gains), inertia, viscous, hz).ok()?))).collect::<Vec<_>>()
    };
    let own = of_rig(rig).unwrap_or(alone);
    let measured = dynamics.responses.iter().filter_map(|response| {
        let controller = controller(&servo(own), response.frequency_hz).ok()?;
        Some((response.frequency_hz, controller * response.plant))
    });
    let mut curves = vec![
        ("by what was identified".to_owned(), model(own), Mark::Line),
        ("measured".to_owned(), measured.collect(), Mark::Marks),
    ];
    if let Some(gains) = tuned.and_then(of_rig) {
        curves.push(("with the proposed gains".to_owned(), model(gains), Mark::Dashed));
    }
    let title =
        if is_joint { "open loop, with the other joint held" } else { "angle over torque, with the other joint held" };
    bode(title, &curves)
}

fn following_chart(joint: &JointLoop) -> Chart {
    let points = joint.follows.iter().map(|it| (it.frequency_hz, it.ratio)).collect();
    bode("angle over reference", &[("measured".to_owned(), points, Mark::MarkedLine)])
}

fn step_chart(joint: &JointLoop) -> Option<Chart> {
    let step = joint.step.as_ref()?;
    let line = |name: &str, at: usize, color| Series {
        name: name.to_owned(),
        points: step.samples.iter().map(|sample| (1e3 * sample[0], sample[at])).collect(),
        mark: Mark::Line,
        color,
    };
    Some(Chart {
        title: "step of 0.5 mrad in 20 ms, during a slow motion".to_owned(),
        panels: vec![Panel {
            title: String::new(),
            x: Axis::linear("time (ms)"),
            y: Axis::linear("share of the step"),
            series: vec![line("reference", 1, Color::Blue), line("angle", 2, Color::Vermilion)],
        }],
    })
}
