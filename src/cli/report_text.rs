//! Measurements and earlier tests as text.

use std::time::Duration;

use serde_json::{Value, json};

use super::ending::{bus_names, describe, devices_text};
use super::failure::{self, Failure};
use yieldwall_config as config;
use yieldwall_motion::guard::{Cause, Fault};
use yieldwall_rig::report::measures::Measures;
use yieldwall_run::explanation::state_name;
use yieldwall_run::{Drilled, Finding, Settled};

/// Describes how soon the drives stop by themselves; the slower drive counts.
pub(crate) fn watchdogs_text(drilled: &Drilled) -> String {
    let after = |finding: &Finding| {
        let slowest = finding.stopped_after.iter().copied().collect::<Option<Vec<_>>>();
        let slowest = slowest.and_then(|times| times.into_iter().max());
        let time = slowest.map_or("never".to_owned(), |time| format!("after {:.1} ms", 1e3 * time.as_secs_f64()));
        format!("without {} {time}", finding.watchdog.name())
    };
    let findings: Vec<_> = drilled.findings.iter().map(after).collect();
    let resolution = match 1e3 * drilled.resolution.as_secs_f64() {
        0.0 => String::new(),
        ms => format!(", seen every {ms:.1} ms"),
    };
    format!("watchdog  the drives stop {}{resolution}", findings.join(", "))
}

/// Returns the watchdogs as data.
pub(crate) fn watchdogs_json(drilled: &Drilled) -> Value {
    json!({
        "findings": drilled.findings.iter().map(finding_json).collect::<Vec<_>>(),
        "resolution_ms": 1e3 * drilled.resolution.as_secs_f64(),
    })
}

/// Returns the behaviour of one watchdog as data.
pub(crate) fn finding_json(finding: &Finding) -> Value {
    let ms = |time: Duration| 1e3 * time.as_secs_f64();
    json!({
        "without": finding.watchdog.name(),
        "left_stops_after_ms": finding.stopped_after[0].map(ms),
        "right_stops_after_ms": finding.stopped_after[1].map(ms),
        "left_stops_in": finding.stopped_in[0].map(|state| format!("{state:?}")),
        "right_stops_in": finding.stopped_in[1].map(|state| format!("{state:?}")),
    })
}

/// Describes the behaviour of one watchdog, drive by drive.
pub(crate) fn finding_text(finding: &Finding) -> String {
    let drives = ["left", "right"].into_iter().zip(finding.stopped_after).zip(finding.stopped_in);
    let each: Vec<String> = drives
        .map(|((side, after), state)| match after {
            None => format!("the {side} drive goes on"),
            Some(after) => {
                let state = state.map_or(String::new(), |state| format!(", in {}", state_name(Some(state))));
                format!("the {side} drive stops after {:.1} ms{state}", 1e3 * after.as_secs_f64())
            }
        })
        .collect();
    format!("without {} {}", finding.watchdog.name(), each.join("; "))
}

/// Returns the results of the drill on which a profile states too little, with the line to write there.
pub(crate) fn settled_text(settled: &[Settled]) -> Vec<String> {
    let mut lines = Vec::new();
    for Settled { profile, watchdog, stops, key, value, .. } in settled {
        let shows = match stops {
            Some((after, state)) => {
                format!("stop after {:.1} ms, in {}", 1e3 * after.as_secs_f64(), state_name(Some(*state)))
            }
            None => "go on".to_owned(),
        };
        lines.push(format!("settled   drives with the profile `{profile}`, without {}:", watchdog.name()));
        lines.push(format!("          {shows}; write in the profile"));
        lines.push(format!("            {key}:"));
        lines.push(format!("              {value}"));
        if value.contains("source: drill") {
            lines.push("            profile.sources.drill: the watchdog drill of yieldwall".to_owned());
        }
    }
    let mut shipped: Vec<&str> =
        settled.iter().filter(|settled| settled.is_shipped).map(|settled| settled.profile.as_str()).collect();
    shipped.dedup();
    for profile in shipped {
        lines.push(format!("          `{profile}` comes with the program; a copy of your own is made by"));
        lines.push(format!("            {}", copying(profile)));
        lines.push(format!("          and named in the rig by  profile: {}", copy_of(profile)));
    }
    lines
}

/// Returns the command that copies a shipped profile.
pub(crate) fn copying(profile: &str) -> String {
    format!("yieldwall config show builtin:profiles/{profile}.yaml > {}", copy_of(profile))
}

/// Returns the file of that copy.
pub(crate) fn copy_of(profile: &str) -> String {
    format!("my-{profile}.yaml")
}

/// Returns the results on incomplete profiles as data.
pub(crate) fn settled_json(settled: &[Settled]) -> Value {
    let each = settled.iter().map(|settled| {
        json!({
            "profile": settled.profile,
            "without": settled.watchdog.name(),
            "stops_after_ms": settled.stops.map(|(after, _)| 1e3 * after.as_secs_f64()),
            "stops_in": settled.stops.map(|(_, state)| format!("{state:?}")),
            "key": settled.key,
            "write": settled.value,
        })
    });
    each.collect()
}

/// Lists events that were counted and stopped nothing, a line each: faults with the number of cycles, and SDO downloads by another
/// master.
pub(crate) fn counted_text(counted: &[(Fault, u32)], foreign_downloads: u32) -> Vec<String> {
    let faults = counted.iter().map(|(fault, cycles)| {
        let row = fault.row();
        format!("counted   {} in {cycles} cycles: {}", row.name, row.meaning)
    });
    let downloads = (foreign_downloads > 0).then(|| {
        format!(
            "counted   {foreign_downloads} SDO downloads of a foreign node to nodes of this rig: boot the rig again"
        )
    });
    faults.chain(downloads).collect()
}

/// Returns the counted faults as data.
pub(crate) fn counted_json(counted: &[(Fault, u32)]) -> Value {
    counted.iter().map(|(fault, cycles)| (fault.row().name.to_owned(), Value::from(*cycles))).collect()
}

/// Describes a command mode.
pub(crate) fn mode_text(mode: config::CommandMode) -> &'static str {
    match mode {
        config::CommandMode::Torque => "torque mode (CST), the control loop closes in this program",
        config::CommandMode::Velocity => "velocity mode (CSV)",
        config::CommandMode::Position => "position mode (CSP), the loop closes in the drives",
    }
}

/// Returns the first line of the report on a rig that a fault stopped after this time in s.
pub(crate) fn stopped_verdict(failure: &Failure, time_s: f64, cause: Cause, rig: &config::Rig) -> String {
    let at = match cause.devices.is_empty() {
        true => format!(" ({})", describe(cause, &[])),
        false => format!(" at {}", devices_text(cause.devices, &bus_names(rig))),
    };
    let (name, code) = (cause.fault.row().name, failure.exit.code());
    format!("verdict   stopped: by {name}{at} after {time_s:.3} s (exit code {code})")
}

/// Returns the first line of the report of a run of this length in s. A run that a fault stopped has the fault.
pub(crate) fn run_verdict(
    end: &Result<(), Failure>,
    (time_s, stopped_by): (f64, Option<(Cause, &config::Rig)>),
    measures: &Measures,
) -> String {
    let mut facts = contact_text(measures).into_iter().collect::<Vec<_>>();
    if measures.energy_bound_j.is_finite() {
        let side = if measures.is_within_bound() { "within" } else { "above" };
        facts.push(format!("energy {side} its limit"));
    }
    match (end, stopped_by) {
        (Err(failure), Some((cause, rig))) => {
            format!("{}; {}", stopped_verdict(failure, time_s, cause, rig), facts.join(", "))
        }
        _ => {
            facts.insert(0, format!("ran for {time_s:.1} s"));
            failure::verdict(end, || facts.join(", "))
        }
    }
}

/// Describes for how long the fixture held the proxy, and how often the hand broke out. `None` for a law that holds nothing.
fn contact_text(measures: &Measures) -> Option<String> {
    match measures.on_surface_s {
        0.0 if measures.energy_bound_j.is_infinite() => None,
        0.0 => {
            let broke_out = (releases(measures) > 0).then(|| format!(", {}", break_outs_text(measures)));
            Some(place_text(measures) + &broke_out.unwrap_or_default())
        }
        on_s => Some(format!("on the surface for {on_s:.1} s, {}", break_outs_text(measures))),
    }
}

/// Describes the place of a proxy that the fixture never held on the surface: without a hold, an impact stops beyond it.
fn place_text(measures: &Measures) -> String {
    match measures.penetration_mm {
        0.0 => "never on the surface".to_owned(),
        depth_mm => format!("deepest penetration {depth_mm:.2} mm"),
    }
}

/// Returns how often the proxy left the surface, with or without a push as strong as the yield force.
fn releases(measures: &Measures) -> u32 {
    measures.break_outs + measures.unintended_releases
}

/// Describes how often the proxy left the surface, and in how many cases the hand pushed with the yield force.
fn break_outs_text(measures: &Measures) -> String {
    let (asked, others) = (measures.break_outs, measures.unintended_releases);
    let times = match releases(measures) {
        0 => return "no break-out".to_owned(),
        1 => "once".to_owned(),
        2 => "twice".to_owned(),
        several => format!("{several} times"),
    };
    let which = match (asked, others) {
        (1, 0) => "the hand pushed with R".to_owned(),
        (_, 0) => "each time the hand pushed with R".to_owned(),
        (0, 1) => "without a push of R".to_owned(),
        (0, _) => "each time without a push of R".to_owned(),
        (_, others) => format!("{others} without a push of R"),
    };
    format!("broke out {times} ({which})")
}

/// Lists the measures, a line each.
pub(crate) fn measures_text(measures: &Measures) -> Vec<String> {
    let mut lines = Vec::new();
    lines.push(impacts_text(measures));
    if let Some([tracing, in_contact]) = tool_text(measures) {
        lines.push(format!("tool      distance from the surface, {tracing}"));
        lines.push(format!("          {in_contact}"));
    }
    if let Some(share) = measures.on_surface_fraction_when_pressed {
        lines.push(format!("contact   on the surface for {:.1} s", measures.on_surface_s));
        lines.push(format!("          held for {:.1} % of the time with a push of F to R", 100.0 * share));
        lines.push(format!("          {}", break_outs_text(measures)));
    } else if let Some(contact) = contact_text(measures).filter(|_| releases(measures) > 0) {
        lines.push(format!("contact   {contact}"));
    }
    let limit = if measures.energy_bound_j.is_infinite() {
        "no limit: a spring or a capture radius returns energy".to_owned()
    } else {
        let above = if measures.is_within_bound() { "" } else { "ABOVE the " };
        format!("{above}limit {:.1} mJ", 1e3 * measures.energy_bound_j)
    };
    lines.push(format!("energy    largest burst into the hand: {:.1} mJ ({limit})", 1e3 * measures.bounded_energy_j()));
    lines.push(format!(
        "          total into the hand: {:.1} mJ; total from the hand: {:.0} mJ",
        1e3 * measures.energy_given_j,
        1e3 * measures.energy_taken_j
    ));
    if let (Some(mean), Some(most)) = (measures.force_age_mean_ms, measures.force_age_max_ms) {
        lines.push(format!("force     sample age at the control step: mean {mean:.2} ms, max {most:.2} ms"));
        lines.push("          the sensor's own delay is not included".to_owned());
    }
    if let (Some(torque), Some(limit_s), Some(apart_s)) =
        (measures.peak_torque_n_m, measures.torque_limit_s, measures.torque_limit_apart_s)
    {
        let at_limit = match (1e3 * limit_s, 1e3 * apart_s) {
            (0.0, _) => String::new(),
            (ms, 0.0) => format!("; at the limit for {ms:.0} ms, after impacts only"),
            (ms, apart_ms) => format!("; at the limit for {ms:.0} ms, {apart_ms:.0} ms of it without an impact"),
        };
        lines.push(format!("torque    peak {torque:.1} N m{at_limit}"));
    }
    lines
}

/// Describes the tool's distance from the surface, when tracing and in contact, if it touched the surface.
pub(crate) fn tool_text(measures: &Measures) -> Option<[String; 2]> {
    let (tracing, whole) = (measures.tool_rms_tracing_mm?, measures.tool_rms_on_surface_mm?);
    let most = measures.tool_max_on_surface_mm?;
    Some([format!("tracing: {tracing:.3} mm RMS"), format!("in contact: {whole:.3} mm RMS, {most:.2} mm max")])
}

fn impacts_text(measures: &Measures) -> String {
    let Some(deepest) = measures.impacts.iter().max_by(|one, other| one.depth_mm.total_cmp(&other.depth_mm)) else {
        return "impacts   none".to_owned();
    };
    let fastest = measures.impacts.iter().map(|impact| impact.speed_m_per_s).fold(0.0, f64::max);
    let count = measures.impacts.len();
    if deepest.depth_mm == 0.0 {
        return format!("impacts   {count}, fastest {:.0} mm/s; no penetration below R", 1e3 * fastest);
    }
    let law = deepest.predicted_depth_mm.map_or(String::new(), |depth| format!(" (predicted {depth:.2} mm)"));
    format!(
        "impacts   {count}, fastest {:.0} mm/s; deepest {:.2} mm at {:.0} mm/s{law}",
        1e3 * fastest,
        deepest.depth_mm,
        1e3 * deepest.speed_m_per_s
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure::Exit;
    use yieldwall_motion::guard::DeviceSet;
    use yieldwall_record::Trace;
    use yieldwall_rig::report::measures::{Context, measure};

    fn measures(break_outs: u32, unintended_releases: u32) -> Measures {
        let context = Context {
            period_s: 1e-3,
            mass_kg: Some(2.0),
            torque_limit_n_m: None,
            has_depth_law: true,
            stiffness_n_per_m: 0.0,
            force_resolution_n: 0.0,
        };
        Measures { break_outs, unintended_releases, on_surface_s: 12.34, ..measure(&Trace::default(), &context) }
    }

    #[test]
    fn a_verdict_says_how_often_the_fixture_gave_way_and_who_asked_for_it() {
        for (counts, expected) in [
            ((0, 0), "no break-out"),
            ((1, 0), "broke out once (the hand pushed with R)"),
            ((2, 0), "broke out twice (each time the hand pushed with R)"),
            ((3, 0), "broke out 3 times (each time the hand pushed with R)"),
            ((0, 1), "broke out once (without a push of R)"),
            ((0, 2), "broke out twice (each time without a push of R)"),
            ((2, 1), "broke out 3 times (1 without a push of R)"),
        ] {
            let verdict = run_verdict(&Ok(()), (27.2, None), &measures(counts.0, counts.1));
            let around = ["verdict   ok: ran for 27.2 s, on the surface for 12.3 s, ", ", energy within its limit"];
            assert_eq!(verdict, format!("{}{expected}{}", around[0], around[1]));
        }
        let free = Measures { on_surface_s: 0.0, ..measures(0, 0) };
        assert!(run_verdict(&Ok(()), (1.0, None), &free).contains("1.0 s, never on the surface, energy"));
        let past = Measures { on_surface_s: 0.0, penetration_mm: 2.16, ..measures(1, 0) };
        let text = "deepest penetration 2.16 mm, broke out once (the hand pushed with R)";
        assert!(run_verdict(&Ok(()), (1.0, None), &past).contains(&format!("1.0 s, {text}, energy")));
        assert!(measures_text(&past).contains(&format!("contact   {text}")), "{:?}", measures_text(&past));
        let spring = Measures { energy_bound_j: f64::INFINITY, ..free };
        assert_eq!(run_verdict(&Ok(()), (1.0, None), &spring), "verdict   ok: ran for 1.0 s");
    }

    #[test]
    fn a_verdict_on_a_run_that_stopped_names_the_fault_its_device_and_the_time() {
        let rig = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap().value;
        let end = Err(Failure::new(Exit::DeviceFault, "after 0.320 s the rig was stopped", ""));
        let stopped =
            |fault, devices| run_verdict(&end, (0.32, Some((Cause { fault, devices }, &rig))), &measures(1, 0));
        let facts = "after 0.320 s (exit code 6); on the surface for 12.3 s, broke out once (the hand pushed with R), energy within its limit";
        assert_eq!(
            stopped(Fault::DriveFault, DeviceSet::SENSOR),
            format!("verdict   stopped: by drive-fault at {} {facts}", DeviceSet::SENSOR)
        );
        assert_eq!(stopped(Fault::Overrun, DeviceSet::NONE), format!("verdict   stopped: by overrun (host) {facts}"));
        let other = run_verdict(&end, (0.32, None), &measures(0, 0));
        assert_eq!(other, "verdict   NOT OK (exit code 6): after 0.320 s the rig was stopped");
    }
}
