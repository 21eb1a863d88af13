//! Durations on a machine that does other things too, and what many of them have in common.

use std::fmt;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Measures one stretch of the present thread.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch {
    on_core: Duration,
    wall: Instant,
}

/// How long a stretch took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elapsed {
    /// Time in which the thread had a core, in ns.
    pub on_core_ns: f64,
    /// By the wall clock, in ns.
    pub wall_ns: f64,
}

impl Stopwatch {
    /// Starts now.
    pub fn start() -> Self {
        Self { wall: Instant::now(), on_core: on_core() }
    }

    /// Time since the start.
    pub fn elapsed(&self) -> Elapsed {
        let on_core = on_core().saturating_sub(self.on_core);
        Elapsed { on_core_ns: on_core.as_nanos() as f64, wall_ns: self.wall.elapsed().as_nanos() as f64 }
    }
}

/// Time in which the present thread has had a core since it began; where the system does not report, the wall clock.
pub fn on_core() -> Duration {
    #[cfg(target_os = "linux")]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        if let Ok(time) = Duration::try_from(time) {
            return time;
        }
    }
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
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
