//! Published numbers and statements about admittance control, virtual walls and friction, computed again.

mod budai;
mod keemink;
mod kikuuwe;
pub(super) mod page;
mod quantised;
mod zwidth;

use super::sweep::{Report, Study, Sweep, Table};

/// The study `literature`.
pub(super) struct Literature(Vec<Box<dyn Sweep>>);

impl Literature {
    /// With its tables.
    pub(super) fn new() -> Self {
        Self(vec![Box::new(keemink::Rows), Box::new(kikuuwe::Laws), Box::new(zwidth::Map), Box::new(budai::Swings)])
    }
}

impl Study for Literature {
    fn name(&self) -> &'static str {
        "literature"
    }

    fn about(&self) -> &'static str {
        "published limits of stability, passivity and saturation, each beside what this program computes"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let mut report = Report::default();
        let readers = [keemink::report, kikuuwe::report, zwidth::report, budai::report];
        for (read, table) in readers.into_iter().zip(tables) {
            read(table, &mut report);
        }
        report
    }
}
