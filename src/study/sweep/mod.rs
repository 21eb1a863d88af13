//! Common parts of studies: tables of points, each computed from its number alone, and the results read from them.
//!
//! ```text
//! Study -- sweeps --> Sweep::point(index) --> cells --> store (JSON lines, by shard) --> Table --> Study::report --> notes, charts
//! ```
//! A point knows nothing of the others and gives the same cells whenever it is computed, apart from measured times. So any
//! point can be computed again alone, a table can be interrupted and gone on with, and parts of it can be computed elsewhere.

mod statistics;
mod store;
mod table;

pub use statistics::{median_interval, wilson};
pub use store::{Store, StoreError};
pub use table::{Row, Table};

use std::time::Duration;

use serde_json::Value;

use super::chart::Chart;

/// Time that this thread has had on a core, from any origin. Studies that measure speed are given one.
pub type Clock<'a> = &'a (dyn Fn() -> Duration + Sync);

/// The median: of an even number of values the mean of the two in the middle. Values that are not finite are left out; `None`
/// if there is no other.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let above = *sorted.get(sorted.len() / 2)?;
    let below = *sorted.get((sorted.len() - 1) / 2)?;
    Some(0.5 * (below + above))
}

/// A table of a study: points by number, and what is found at each.
pub trait Sweep: Sync {
    /// Name, as in `--point NAME:INDEX` and in file names; small letters and hyphens.
    fn name(&self) -> &str;

    /// Names of the columns, in order: small letters, underscores, the unit last. Parameters of the point come before its
    /// results.
    fn columns(&self) -> Vec<&str>;

    /// Number of points.
    fn points(&self) -> u64;

    /// Whether the points measure time: they are then computed one after the other, on one thread, in one run.
    fn is_timed(&self) -> bool {
        false
    }

    /// Computes one point, `index` below [`Sweep::points`]: a cell for each column. A value that cannot be computed is a cell
    /// that says so (`null`, or a word in a column for outcomes), not an error. A number that is not finite becomes `null`.
    fn point(&self, index: u64, clock: Clock<'_>) -> Vec<Value>;
}

/// A question, the tables that answer it, and how they are read.
pub trait Study {
    /// Name, as on the command line.
    fn name(&self) -> &str;

    /// Question of the study, in one line.
    fn about(&self) -> &'static str;

    /// Its tables; the first is the one that answers.
    fn sweeps(&self) -> &[Box<dyn Sweep>];

    /// Reads the tables, which stand in the order of [`Study::sweeps`] and are whole.
    fn report(&self, tables: &[Table]) -> Report;
}

/// Results read from the tables of a study.
#[derive(Debug, Default)]
pub struct Report {
    /// Lines of text: what came out, what disagrees with theory and how to see a point again.
    pub notes: Vec<String>,
    /// Charts, each with its file name without ending.
    pub charts: Vec<(&'static str, Chart)>,
}

#[cfg(test)]
mod tests {
    use super::median;

    #[test]
    fn the_median_of_an_even_number_is_the_mean_of_the_two_in_the_middle() {
        assert_eq!(median([4.0, f64::NAN, 1.0, 2.0, 9.0]), Some(3.0));
        assert_eq!(median([7.0, 1.0, f64::INFINITY, 2.0]), Some(2.0));
        assert_eq!(median([f64::NAN]), None);
    }
}
