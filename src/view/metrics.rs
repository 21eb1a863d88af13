//! Metrics in the Prometheus text format, version 0.0.4.

use std::fmt::Write;

use yieldwall_record::recording::Layout;

use crate::server::Site;
use crate::stream::Figures;

/// Value of `Content-Type`.
pub(crate) const MEDIA_TYPE: &str = "text/plain; version=0.0.4";

/// The metrics of a server; without a stream its clients and refusals alone.
pub(crate) fn render(site: &Site) -> String {
    let mut text = String::new();
    if let Some(stream) = site.stream() {
        of_stream(&mut text, stream.figures(), stream.layout());
    }
    metric(
        &mut text,
        "yieldwall_view_refused_total",
        "counter",
        "Requests and messages that the page's server refused.",
    );
    sample(&mut text, "yieldwall_view_refused_total", site.refused());
    metric(&mut text, "yieldwall_view_clients", "gauge", "Clients of the live stream.");
    sample(&mut text, "yieldwall_view_clients", site.clients());
    text
}

fn of_stream(text: &mut String, figures: Figures, layout: &Layout) {
    let Figures { records, lost, late_ns, most_late_ns, state, fault } = figures;
    metric(text, "yieldwall_cycles_total", "counter", "Cycles that reached the live stream.");
    sample(text, "yieldwall_cycles_total", records);
    metric(text, "yieldwall_view_lost_cycles_total", "counter", "Cycles for which the live stream had no room.");
    sample(text, "yieldwall_view_lost_cycles_total", lost);
    for (name, help, value) in [
        ("yieldwall_cycle_lateness_seconds", "Delay of the last computation after its planned begin.", late_ns),
        ("yieldwall_cycle_lateness_max_seconds", "Greatest delay of a computation since the start.", most_late_ns),
    ] {
        if let Some(ns) = value {
            metric(text, name, "gauge", help);
            sample(text, name, ns as f64 / 1e9);
        }
    }
    for (name, field, help, value) in [
        ("yieldwall_supervisor_state", "state", "State of the supervisor: 1 for the present state.", state),
        ("yieldwall_fault", "cause", "Fault that led to the state: 1 for the present fault.", fault),
    ] {
        let Some(field) = layout.field(field).filter(|_| records > 0) else { continue };
        metric(text, name, "gauge", help);
        let label = name.rsplit('_').next().unwrap_or(name);
        for (code, number) in &field.codes {
            // A string takes everything.
            let _ = writeln!(text, "{name}{{{label}=\"{code}\"}} {}", u8::from(value == Some(*number)));
        }
    }
}

fn metric(text: &mut String, name: &str, kind: &str, help: &str) {
    // A string takes everything.
    let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
}

fn sample(text: &mut String, name: &str, value: impl std::fmt::Display) {
    // A string takes everything.
    let _ = writeln!(text, "{name} {value}");
}
