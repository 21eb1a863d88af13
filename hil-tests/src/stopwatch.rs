//! Durations on a machine that does other things too, and what many of them have in common.

use std::fmt;
use std::time::Instant;

/// Measures one stretch of the present thread.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch {
    start: Instant,
    on_core_ns: Option<f64>,
}

/// How long a stretch took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elapsed {
    /// Time in which the thread had a core, in ns. Good to a scheduler tick (1 to 10 ms): for stretches of 0.1 s and
    /// more. Equal to the wall clock where the system does not tell.
    pub on_core_ns: f64,
    /// By the wall clock, in ns.
    pub wall_ns: f64,
}

impl Stopwatch {
    /// Starts now.
    pub fn start() -> Self {
        Self { on_core_ns: on_core_ns(), start: Instant::now() }
    }

    /// Time since the start.
    pub fn elapsed(&self) -> Elapsed {
        let wall_ns = self.start.elapsed().as_nanos() as f64;
        let on_core = self.on_core_ns.zip(on_core_ns()).map(|(from, to)| to - from);
        Elapsed { on_core_ns: on_core.unwrap_or(wall_ns), wall_ns }
    }
}

/// What Linux says this thread has had of a core since it began.
fn on_core_ns() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse().ok()
}

/// Median and extremes of repeated measurements, written as `median (least, most)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Middle value, the upper one of two.
    pub median: f64,
    /// Smallest value.
    pub least: f64,
    /// Largest value.
    pub most: f64,
}

impl Spread {
    /// Of no values.
    pub const NONE: Self = Self { median: f64::NAN, least: f64::NAN, most: f64::NAN };

    /// The same with all three less by `share`.
    pub fn less(self, share: f64) -> Self {
        Self { median: self.median - share, least: self.least - share, most: self.most - share }
    }

    /// Of these values; all NaN if there are none.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let at = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
        Self { median: at(values.len() / 2), least: at(0), most: at(values.len().saturating_sub(1)) }
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(1);
        write!(f, "{:.digits$} ({:.digits$}, {:.digits$})", self.median, self.least, self.most)
    }
}

#[cfg(test)]
mod tests {
    use super::Spread;

    #[test]
    fn the_middle_of_an_odd_number_of_values() {
        let spread = Spread::of(vec![7.0, 1.0, 3.0]);
        assert_eq!(spread, Spread { median: 3.0, least: 1.0, most: 7.0 });
        assert_eq!(format!("{spread:.1}"), "3.0 (1.0, 7.0)");
    }
}
