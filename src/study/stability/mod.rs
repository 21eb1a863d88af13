//! Stability of the loop, in simulation and in theory. The maps show the least virtual mass, the virtual coupling, impacts, the
//! sliding mode after saturation, singular poses, corners, lost samples, and friction computed from the last velocity.
//!
//! Everything runs on [`bench`](super::bench) or on less: exact plant, no bus, no counts, no guard.

mod corners;
mod coupling;
mod crossover;
mod friction;
mod held;
mod impact;
mod mass;
pub(super) mod page;
mod samples;
mod singular;
mod sliding;

use super::sweep::{Report, Study, Sweep, Table};
use yieldwall_motion::elementary;

/// The study `stability`.
pub(super) struct Stability(Vec<Box<dyn Sweep>>);

impl Stability {
    /// With all its tables.
    pub(super) fn new() -> Self {
        Self(vec![
            Box::new(mass::Map),
            Box::new(mass::Theory),
            Box::new(mass::Rows),
            Box::new(impact::Proxy),
            Box::new(impact::Tool),
            Box::new(coupling::Map),
            Box::new(sliding::Overshoot),
            Box::new(singular::Map),
            Box::new(corners::Jumps),
            Box::new(samples::Samples),
            Box::new(friction::Push),
        ])
    }
}

impl Study for Stability {
    fn name(&self) -> &'static str {
        STUDY
    }

    fn about(&self) -> &'static str {
        "where admittance and impedance fixtures are stable, where theory says they are, and where methods fail"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.0
    }

    fn report(&self, tables: &[Table]) -> Report {
        let [map, theory, rows, proxy, tool, coupling, sliding, singular, corners, samples, friction] = tables else {
            return Report::default();
        };
        let mut report = Report::default();
        mass::report(map, theory, rows, &mut report);
        impact::report(proxy, tool, &mut report);
        coupling::report(coupling, &mut report);
        sliding::report(sliding, &mut report);
        singular::report(singular, &mut report);
        corners::report(corners, &mut report);
        samples::report(samples, &mut report);
        friction::report(friction, &mut report);
        report
    }
}

/// Name of the study, as on the command line.
const STUDY: &str = "stability";

/// How boundaries that were measured and computed on one grid agree.
#[derive(Debug, Default)]
struct Agreement {
    within_a_step: usize,
    beyond: Vec<String>,
}

impl Agreement {
    /// Takes in a pair of places on the grid; `what` names it.
    fn add(&mut self, measured: u64, computed: u64, what: impl FnOnce() -> String) {
        if measured.abs_diff(computed) <= 1 { self.within_a_step += 1 } else { self.beyond.push(what()) }
    }

    /// The first and the last that disagree.
    fn ends(&self) -> impl Iterator<Item = &String> {
        let last = self.beyond.len().checked_sub(1).filter(|&last| last > 0);
        self.beyond.first().into_iter().chain(last.and_then(|last| self.beyond.get(last)))
    }

    fn line(&self, name: &str) -> String {
        let all = self.within_a_step + self.beyond.len();
        format!("{name}: {} of {all} within one grid step of theory", self.within_a_step)
    }
}

/// The value of a logarithmic grid.
fn on_grid(index: u64, points: u64, [low, high]: [f64; 2]) -> f64 {
    low * elementary::powf(high / low, index as f64 / (points - 1) as f64)
}

/// The middle of a cell of a logarithmic map.
fn cell(index: u64, cells: u64, [low, high]: [f64; 2]) -> f64 {
    low * elementary::powf(high / low, (index as f64 + 0.5) / cells as f64)
}

/// Number of cells of a logarithmic map whose middles lie below `value`.
fn cells_below(value: f64, cells: u64, range: [f64; 2]) -> u64 {
    (0..cells).filter(|&index| cell(index, cells, range) < value).count() as u64
}
