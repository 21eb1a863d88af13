//! The report of a commissioning as a self-contained page.

use chrono::DateTime;

use super::earlier::rig_hash;
use crate::clock::now_unix_s;
use crate::escaped::escaped;
use yieldwall_config as config;
use yieldwall_figures::chart::{Axis, Chart, Color, Mark, Panel, Series, svg};
use yieldwall_run::DriveIdentity;
use yieldwall_run::commission::{Commissioned, Curve, Figure, StepReport, Verdict};

/// Returns the text of a figure.
pub(super) fn figure_text(figure: &Figure) -> String {
    let unit = if figure.unit.is_empty() { String::new() } else { format!(" {}", figure.unit) };
    let number = |value: f64| if value.fract() == 0.0 { format!("{value:.0}") } else { format!("{value:.3}") };
    format!("{} {}{unit} (limit {}{unit})", figure.what, number(figure.value), number(figure.limit))
}

/// Returns the page on a rig from this file, and on the machine that these words name.
pub(super) fn html(rig: &config::Rig, file: &str, commissioned: &Commissioned, machine: &str) -> String {
    let name = escaped(&rig.rig.name);
    let verdict = commissioned.verdict().name();
    let (all, skipped) =
        (commissioned.steps.len(), commissioned.steps.iter().filter(|step| step.verdict == Verdict::Skipped).count());
    let but = if skipped == 0 { String::new() } else { format!(", {skipped} of {all} steps skipped") };
    let drives: String = match &commissioned.drives {
        Some(drives) => drives.iter().zip(&rig.drives).map(|(drive, of)| identity(drive, &of.name)).collect(),
        None => "<li>The drives are unknown: the step identity did not end in this run.</li>\n".to_owned(),
    };
    let rows: String = commissioned.steps.iter().map(row).collect();
    let details: String = commissioned.steps.iter().filter(|step| has_details(step)).map(section).collect();
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Commissioning of {name}: {verdict}{but}</title>\n<style>\n\
         body {{ font: 15px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }}\n\
         table {{ border-collapse: collapse; }} td, th {{ border: 1px solid #999; padding: .3em .6em; text-align: left; vertical-align: top; }}\n\
         .pass {{ color: #00664d; }} .fail {{ color: #a03000; font-weight: bold; }} .skipped {{ color: #555; }}\n\
         svg {{ max-width: 100%; height: auto; }}\n</style></head><body>\n\
         <h1>Commissioning of {name}: <span class=\"{verdict}\">{verdict}</span>{but}</h1>\n\
         <p>Made by yieldwall {version}, which is not a safety component, on {when}. Machine: {machine}.</p>\n\
         <p>Rig file: {file}, hash {hash}. Command mode: {mode}. Cycle: {period} us. Drives: {left} with profile {left_profile}, {right} with \
         profile {right_profile}.</p>\n<ul>\n{drives}</ul>\n\
         <table><tr><th>step</th><th>verdict</th><th>figure</th><th>description</th></tr>\n{rows}</table>\n{details}</body></html>\n",
        version = env!("CARGO_PKG_VERSION"),
        when = escaped(&utc(now_unix_s())),
        machine = escaped(machine),
        file = escaped(file),
        hash = rig_hash(rig),
        mode = format!("{:?}", rig.rig.command_mode).to_lowercase(),
        period = rig.cycle.period_us,
        left = escaped(&rig.drives[0].name),
        left_profile = escaped(rig.drives[0].profile.as_str()),
        right = escaped(&rig.drives[1].name),
        right_profile = escaped(rig.drives[1].profile.as_str()),
    )
}

/// Returns the identity that a drive reports.
fn identity(drive: &DriveIdentity, name: &str) -> String {
    let node = drive.node_id.map_or(String::new(), |node| format!("node {node}, "));
    let DriveIdentity { vendor_id, product_code, revision, serial_number, .. } = drive;
    format!(
        "<li>{}: {node}vendor {vendor_id:X}h, product {product_code:X}h, revision {revision:X}h, serial number {serial_number}</li>\n",
        escaped(name)
    )
}

/// Formats a time as a calendar date.
fn utc(unix_s: u64) -> String {
    let moment = i64::try_from(unix_s).ok().and_then(|seconds| DateTime::from_timestamp(seconds, 0));
    moment.map_or("an unknown day".to_owned(), |moment| moment.format("%Y-%m-%d %H:%M UTC").to_string())
}

fn has_details(step: &StepReport) -> bool {
    step.reason.is_some() || !step.evidence.is_empty() || !step.curves.is_empty()
}

fn row(step: &StepReport) -> String {
    let verdict = step.verdict.name();
    let bound = step.step.motion_bound_rad();
    let bound = bound.map_or(String::new(), |bound| {
        format!("; limit of a joint: {:.1} deg by its encoder, each time it is enabled", bound.to_degrees())
    });
    format!(
        "<tr><td>{}</td><td class=\"{verdict}\">{verdict}</td><td>{}</td><td>{}{bound}</td></tr>\n",
        step.step.name(),
        escaped(&step.headline().map(figure_text).or(step.reason.clone()).unwrap_or_default()),
        escaped(step.step.does()),
    )
}

fn section(step: &StepReport) -> String {
    let reason = step
        .reason
        .as_ref()
        .map_or(String::new(), |reason| format!("<p class=\"{}\">{}</p>\n", step.verdict.name(), escaped(reason)));
    let evidence: String =
        step.evidence.iter().map(|(name, value)| format!("<li>{}: {}</li>\n", escaped(name), escaped(value))).collect();
    let evidence = if evidence.is_empty() { evidence } else { format!("<ul>\n{evidence}</ul>\n") };
    let curves: String = step.curves.iter().map(|curve| svg(&chart(curve))).collect();
    format!("<h2>{}</h2>\n{reason}{evidence}{curves}\n", step.step.name())
}

fn chart(curve: &Curve) -> Chart {
    let axis = |name: &str| Axis::linear(&name.replacen(" in ", " (", 1).chars().chain([')']).collect::<String>());
    let lines = curve.lines.iter().zip(Color::LINES);
    let series = lines.map(|((name, points), color)| Series {
        name: name.clone(),
        points: points.iter().map(|[x, y]| (*x, *y)).collect(),
        mark: Mark::Line,
        color,
    });
    let panel = Panel { title: String::new(), x: axis(curve.across), y: axis(curve.up), series: series.collect() };
    Chart { title: curve.title.clone(), panels: vec![panel] }
}
