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
    let mut rows = vec![row(["fault", "bound", "shown", "reactions", "median", "most", "allowed"])];
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
    let mut rows = vec![row(["injection", "met the rig running", "judged alone", "as expected"])];
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
        fact("seeds", format!("{}, {} of them with several faults at once", tally.seeds, tally.tangles)),
        fact("cycles", format!("{}, {hours:.2} h of simulated time", tally.cycles)),
        fact(
            "ended",
            format!(
                "{} with all cycles, {} not booted, {} with the process gone, {} broken off",
                ends("Complete"),
                ends("NotBooted"),
                ends("MasterGone"),
                ends("Broken")
            ),
        ),
        fact("network booted anew", format!("{} times", tally.restarts)),
        fact("greatest torque", format!("{:.2} N m", peaks.torque_n_m)),
        fact(
            "greatest speed",
            format!("{:.3} m/s of the tool, {:.3} m/s of the proxy", peaks.speed_m_per_s, peaks.proxy_m_per_s),
        ),
        fact("greatest force while running", format!("{:.1} N sensed", peaks.force_n)),
        fact("energy given beyond what was held", format!("{:.1} mJ", 1e3 * peaks.returned_j)),
        fact("own frames on the bus", format!("{:.1} % of a cycle at most", 100.0 * peaks.bus_share)),
        fact("frames waiting in one port", format!("{} at most", peaks.queue)),
        fact("wraps of position counters", peaks.wraps.to_string()),
        fact("did not hold and was excused", format!("{} times", tally.excused.values().sum::<u64>())),
        fact("mark of all runs", format!("{:016x}", tally.hash)),
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
    let mut rows = vec![row(["did not hold", "excused", "times"])];
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
        let _ = writeln!(text, "{name:34} {value}");
    }
    // The bounds of docs/faults.md left away, and what may be long at the end.
    let faults = faults(tally).picked(&[0, 2, 4, 5, 6, 3]);
    for (about, table) in [
        ("", excuses(tally)),
        ("cycles from a fault to its reaction: median, most, allowed\n", faults),
        ("", injections(tally)),
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
