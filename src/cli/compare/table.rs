//! Measures side by side.

use super::item::Item;
use yieldwall_figures::Throw;

/// Digits of a number in the table.
const DIGITS: i32 = 4;

/// Rows of cells, with a head.
pub(crate) struct Table(Vec<Vec<String>>);

impl Table {
    pub(crate) fn new(head: Vec<String>) -> Self {
        Self(vec![head])
    }

    pub(crate) fn push(&mut self, row: Vec<String>) {
        self.0.push(row);
    }

    /// Returns a line for each row: the first column to the left, the others to the right.
    pub(crate) fn lines(&self) -> Vec<String> {
        let columns = self.0.iter().map(Vec::len).max().unwrap_or_default();
        let width = |column: usize| {
            self.0.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or_default()
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        let line = |row: &Vec<String>| {
            let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, width))| match column {
                0 => format!("{cell:width$}"),
                _ => format!("{cell:>width$}"),
            });
            cells.collect::<Vec<_>>().join("  ")
        };
        self.0.iter().map(line).collect()
    }
}

type Take = fn(&Item) -> Option<f64>;

/// Compared measures: name with unit, and the number.
const ROWS: [(&str, Take); 27] = [
    ("time, s", |item| Some(item.time_s())),
    ("held at rest by faults, s", |item| Some(item.held_s())),
    ("impacts", |item| Some(item.measures.impacts.len() as f64)),
    ("deepest impact, mm", |item| (!item.measures.impacts.is_empty()).then_some(item.measures.penetration_mm)),
    ("fastest impact, mm/s", |item| {
        item.measures.impacts.iter().map(|impact| 1e3 * impact.speed_m_per_s).reduce(f64::max)
    }),
    ("tool off the surface, tracing, RMS, mm", |item| item.measures.tool_rms_tracing_mm),
    ("tool off the surface, in contact, RMS, mm", |item| item.measures.tool_rms_on_surface_mm),
    ("tool off the surface, in contact, max, mm", |item| item.measures.tool_max_on_surface_mm),
    ("proxy off the surface that holds it, max, mm", |item| item.measures.proxy_on_surface_max_mm),
    ("on the surface when pressed below R, %", |item| {
        item.measures.on_surface_fraction_when_pressed.map(|share| 100.0 * share)
    }),
    ("on the surface, s", |item| Some(item.measures.on_surface_s).filter(|on_s| *on_s > 0.0)),
    ("break-outs with a push of R", |item| Some(f64::from(item.measures.break_outs))),
    ("unintended releases", |item| {
        item.measures.on_surface_fraction_when_pressed.map(|_| f64::from(item.measures.unintended_releases))
    }),
    ("off the surface when the hand lets go, mm", |item| Some(1e3 * Throw::in_run(&item.trace)?.depth_m)),
    ("thrown back after that, mm", |item| Some(1e3 * Throw::in_run(&item.trace)?.back_m)),
    ("force along the normal in contact, max, N", |item| item.measures.peak_force_on_surface_n),
    ("force sample age, mean, ms", |item| item.measures.force_age_mean_ms),
    ("force sample age, max, ms", |item| item.measures.force_age_max_ms),
    ("energy into the hand, total, mJ", |item| Some(1e3 * item.measures.energy_given_j)),
    ("energy from the hand, total, mJ", |item| Some(1e3 * item.measures.energy_taken_j)),
    ("energy into the hand, largest burst, mJ", |item| Some(1e3 * item.measures.bounded_energy_j())),
    ("limit of the burst, mJ", |item| Some(1e3 * item.measures.energy_bound_j)),
    ("net work on the hand, max of any stretch, mJ", |item| Some(1e3 * item.measures.energy_rise_j)),
    ("share of time with power to the hand, %", |item| Some(100.0 * item.measures.power_positive_fraction)),
    ("torque, peak, N m", |item| item.measures.peak_torque_n_m),
    ("at the torque limit, s", |item| item.measures.torque_limit_s),
    ("at the torque limit without an impact, s", |item| item.measures.torque_limit_apart_s),
];

/// Returns all measures that one of the items has.
pub(super) fn measures_table(items: &[Item]) -> Table {
    let head = std::iter::once("measure".to_owned()).chain(items.iter().map(|item| item.label.to_string()));
    let mut table = Table::new(head.collect());
    for (name, take) in ROWS {
        let values: Vec<Option<f64>> = items.iter().map(take).collect();
        if values.iter().any(Option::is_some) {
            let cells = values.into_iter().map(|value| value.map_or("-".to_owned(), number));
            table.push(std::iter::once(name.to_owned()).chain(cells).collect());
        }
    }
    table
}

/// Formats a number with four digits, or all digits of its whole part.
fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value.is_finite() { "0".to_owned() } else { "none".to_owned() };
    }
    let whole_digits = yieldwall_motion::elementary::log10(value.abs()).floor() as i32 + 1;
    let decimals = (DIGITS - whole_digits).clamp(0, 9) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits_and_columns_stand_below_one_another() {
        let texts = [0.0, 12.0, 0.012345, 20.24999, 8300.4, 123_456.7, -0.5, f64::INFINITY].map(number);
        assert_eq!(texts, ["0", "12", "0.01235", "20.25", "8300", "123457", "-0.5", "none"]);
        let mut table = Table::new(vec!["measure".to_owned(), "A".to_owned()]);
        table.push(vec!["time".to_owned(), "12.5".to_owned()]);
        assert_eq!(table.lines(), ["measure     A", "time     12.5"]);
    }
}
