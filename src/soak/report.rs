//! Results of many runs, as text and as tables for a page.

use std::fmt::Write;

use super::invariant::Invariant;
use super::tally::{FaultTally, Tally};
use yieldwall_config::injection::CATALOGUE;
use yieldwall_motion::guard::fault::{Bound, FaultRow, TABLE};

/// One table, its first row the head.
struct Table(Vec<Vec<String>>);

impl Table {
    /// Returns the table with only these columns.
    fn picked(self, columns: &[usize]) -> Self {
        let of_row = |row: Vec<String>| columns.iter().filter_map(|at| row.get(*at).cloned()).collect();
        Self(self.0.into_iter().map(of_row).collect())
    }

    /// Returns the table as text, columns flush.
    fn text(&self) -> String {
        let columns = self.0.first().map_or(0, Vec::len);
        let width = |column: usize| self.0.iter().map(|row| row[column].len()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..columns).map(width).collect();
        let mut text = String::new();
        for row in &self.0 {
            let cells: Vec<String> = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}")).collect();
            let _ = writeln!(text, "  {}", cells.join("  ").trim_end());
        }
        text
    }

    /// Returns the table as Markdown.
    fn markdown(&self) -> String {
        let mut text = String::new();
        for (at, row) in self.0.iter().enumerate() {
            let _ = writeln!(text, "| {} |", row.join(" | "));
            if at == 0 {
                let _ = writeln!(text, "|{}", "---|".repeat(row.len()));
            }
        }
        text
    }
}

fn row<const N: usize>(cells: [&str; N]) -> Vec<String> {
    cells.map(str::to_owned).to_vec()
}

fn bound(row: &FaultRow) -> String {
    let steps = row.steps.iter().map(|step| {
        let within = match step.bound {
            Bound::Cycles(1) => "1 cycle".to_owned(),
            Bound::Cycles(cycles) => format!("{cycles} cycles"),
            Bound::Samples(1) => "1 sample".to_owned(),
            Bound::Samples(samples) => format!("{samples} samples"),
            Bound::HeartbeatTime => "heartbeat".to_owned(),
        };
        format!("{:?} {within}", step.reaction)
    });
    steps.collect::<Vec<_>>().join(", ")
}

/// Faults with their reactions, and how soon those came: bound, median and greatest in cycles.
fn faults(tally: &Tally) -> Table {
    let mut rows = vec![row(["fault", "bound", "seen", "reactions", "median", "max", "limit"])];
    let none = FaultTally::default();
    for fault in &TABLE {
        let seen = tally.faults.get(fault.name).unwrap_or(&none);
        let reactions: Vec<String> = seen.reactions.iter().map(|(name, times)| format!("{times} {name}")).collect();
        let each = |value: &dyn Fn(&super::tally::Latency) -> u32| {
            let all: Vec<String> = seen.measured.values().map(|latency| value(latency).to_string()).collect();
            all.join(", ")
        };
        let reactions = if reactions.is_empty() { "-".to_owned() } else { reactions.join(", ") };
        rows.push(vec![
            fault.name.to_owned(),
            bound(fault),
            seen.shown.to_string(),
            reactions,
            each(&|latency| latency.median()),
            each(&|latency| latency.most()),
            each(&|latency| latency.bound),
        ]);
    }
    Table(rows)
}

/// Returns the table of injections: how often each met a running rig, and how often the required consequence followed.
fn injections(tally: &Tally) -> Table {
    let mut rows = vec![row(["injection", "while running", "judged alone", "as expected"])];
    for kind in &CATALOGUE {
        let seen = tally.injections.get(kind.name).copied().unwrap_or_default();
        let counts = [seen.hits, seen.judged, seen.as_expected].map(|count| count.to_string());
        let [hits, judged, as_expected] = counts;
        rows.push(vec![kind.name.to_owned(), hits, judged, as_expected]);
    }
    Table(rows)
}

/// Returns the figures of the runs that do not depend on the computer.
fn facts(tally: &Tally) -> Vec<[String; 2]> {
    let peaks = &tally.peaks;
    let ends = |name: &str| tally.ends.get(name).copied().unwrap_or_default();
    let fact = |name: &str, value: String| [name.to_owned(), value];
    let hours = tally.simulated_ms as f64 / 3.6e6;
    vec![
        fact("seeds", tally.seeds.to_string()),
        fact("seeds with several faults at once", tally.tangles.to_string()),
        fact("cycles", tally.cycles.to_string()),
        fact("simulated time", format!("{hours:.2} h")),
        fact("runs with all cycles", ends("Complete").to_string()),
        fact("runs that never booted", ends("NotBooted").to_string()),
        fact("runs whose process ended", ends("MasterGone").to_string()),
        fact("runs stopped early", ends("Broken").to_string()),
        fact("network reboots", tally.restarts.to_string()),
        fact("largest torque", format!("{:.2} N m", peaks.torque_n_m)),
        fact("largest tool speed", format!("{:.3} m/s", peaks.speed_m_per_s)),
        fact("largest proxy speed", format!("{:.3} m/s", peaks.proxy_m_per_s)),
        fact("largest sensed force while running", format!("{:.1} N", peaks.force_n)),
        fact("largest energy beyond the stored energy", format!("{:.1} mJ", 1e3 * peaks.returned_j)),
        fact("largest bus time of own frames", format!("{:.1} % of a cycle", 100.0 * peaks.bus_share)),
        fact("largest queue of one port", format!("{} frames", peaks.queue)),
        fact("wraps of position counters", peaks.wraps.to_string()),
        fact("violations excused by a fault or a hand", tally.excused.values().sum::<u64>().to_string()),
        fact("hash of all runs", format!("{:016x}", tally.hash)),
    ]
}

fn violations(tally: &Tally) -> Vec<[String; 2]> {
    let each = tally.violations.iter().map(|(name, times)| {
        let text = Invariant::ALL.iter().find(|invariant| invariant.name() == name).map_or("", |known| known.text());
        [format!("{name}: {text}"), format!("{times} seeds")]
    });
    each.collect()
}

/// Returns the excused deviations, by invariant and reason.
fn excuses(tally: &Tally) -> Table {
    let mut rows = vec![row(["invariant", "excuse", "times"])];
    for (name, times) in &tally.excused {
        let (invariant, excuse) = name.split_once(' ').unwrap_or((name, ""));
        rows.push(vec![invariant.to_owned(), excuse.to_owned(), times.to_string()]);
    }
    Table(rows)
}

/// Returns the summary as text.
pub fn text(tally: &Tally) -> String {
    let mut text = String::new();
    for [name, value] in facts(tally).into_iter().chain(violations(tally)) {
        let _ = writeln!(text, "{name:40} {value}");
    }
    // Without the bounds of docs/faults.md; reactions, which may be long, come last.
    let faults = faults(tally).picked(&[0, 2, 4, 5, 6, 3]);
    for (about, table) in [
        ("violations excused by a fault or a hand:\n", excuses(tally)),
        ("cycles from a fault to its reaction:\n", faults),
        ("injections:\n", injections(tally)),
    ] {
        text += &format!("\n{about}{}", table.text());
    }
    text
}

/// Returns the summary as Markdown: four tables.
pub fn markdown(tally: &Tally) -> String {
    let head = [row(["", ""])];
    let facts = head.into_iter().chain(facts(tally).into_iter().chain(violations(tally)).map(|fact| fact.to_vec()));
    let tables = [Table(facts.collect()), excuses(tally), faults(tally), injections(tally)];
    tables.map(|table| table.markdown()).join("\n")
}
