//! Lines above a figure: its title, and machine, law and numbers of its runs.

use super::Options;
use super::axes::number;
use super::legend;
use super::page::{self, Anchor, Page};
use yieldwall_motion::elementary;
use yieldwall_record::{Setup, Trace};

/// Base line of the first line, and distance of the lines.
const FIRST: f64 = 40.0;
const LINE: f64 = 42.0;

/// Facts of a run, each where it is known: drive, law, `R`, `F`, `M`, `T` and `N_wait`.
type Facts = [Option<String>; 7];

fn facts(trace: &Trace) -> Facts {
    let Setup { drive, law, is_unyielding, mass_kg, period_s, .. } = &trace.setup;
    let has_surface = !trace.references.is_empty();
    let yield_n = || match trace.outward_yield_n {
        Some(outward_n) => format!("R {} N, outward {} N", short(trace.yield_n), short(outward_n)),
        None => format!("R {} N", short(trace.yield_n)),
    };
    let known = |text: &str| (!text.is_empty()).then(|| text.to_owned());
    [
        known(drive),
        known(law).filter(|_| has_surface),
        (has_surface && !is_unyielding).then(yield_n),
        Some(format!("F {} N", short(trace.friction_n))),
        mass_kg.map(|mass_kg| format!("M {} kg", short(mass_kg))),
        period_s.map(|period_s| format!("T {} ms", short(1e3 * period_s))),
        hold_steps(trace).filter(|_| has_surface),
    ]
}

/// Returns a hold as in headings.
pub(super) fn hold_steps(trace: &Trace) -> Option<String> {
    (!trace.setup.is_hold_automatic).then(|| format!("N_wait {}", trace.hold_steps))
}

/// Returns a number of at most four digits that count.
fn short(value: f64) -> String {
    let decimals = (3.0 - elementary::log10(value.abs().max(1e-9)).floor()).clamp(0.0, 9.0) as usize;
    let text = number(value, decimals);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

fn joined(facts: impl Iterator<Item = Option<String>>) -> String {
    facts.flatten().collect::<Vec<_>>().join(", ")
}

/// Returns the facts that are the same for all runs, such as `torque mode, plastic, R 20 N`.
pub(super) fn in_common(traces: &[&Trace]) -> String {
    let all: Vec<Facts> = traces.iter().map(|trace| facts(trace)).collect();
    let Some((first, others)) = all.split_first() else { return String::new() };
    let is_common = |at: usize| others.iter().all(|other| other[at] == first[at]);
    joined(first.iter().enumerate().map(|(at, fact)| fact.clone().filter(|_| is_common(at))))
}

/// Returns for each run the facts that are not the same for all, such as `R 20 N`; nothing where all are.
pub fn differences(traces: &[&Trace]) -> Vec<String> {
    let all: Vec<Facts> = traces.iter().map(|trace| facts(trace)).collect();
    let differs = |at: usize| all.iter().any(|one| one[at] != all[0][at]);
    all.iter()
        .map(|one| joined(one.iter().enumerate().map(|(at, fact)| fact.clone().filter(|_| differs(at)))))
        .collect()
}

/// Returns the lines above a figure of these runs.
pub(super) fn lines(traces: &[&Trace], options: &Options) -> Vec<String> {
    let Some(title) = &options.heading else { return Vec::new() };
    let lines = [title.clone(), in_common(traces)].into_iter().filter(|line| !line.is_empty());
    lines.map(|line| legend::shortened(&line, page::WIDTH, page::LETTER.into())).collect()
}

/// Whether the lines above a figure have the hold of all its runs.
pub(super) fn has_hold(traces: &[&Trace], options: &Options) -> bool {
    let holds = || traces.iter().map(|trace| hold_steps(trace));
    options.heading.is_some() && holds().all(|hold| Some(hold) == holds().next())
}

/// Returns the height of the lines.
pub(super) fn height(lines: &[String]) -> f64 {
    8.0 + LINE * lines.len() as f64
}

pub(super) fn draw(page: &mut Page, lines: &[String]) {
    for (row, line) in lines.iter().enumerate() {
        page.text((page::WIDTH / 2.0, FIRST + LINE * row as f64), Anchor::Middle, line);
    }
}
