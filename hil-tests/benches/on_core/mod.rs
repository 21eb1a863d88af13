//! Criterion by the time in which the thread had a core: on a machine that does other things too, the wall clock
//! measures those as well.

use std::time::Duration;

use criterion::Criterion;
use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use hil_tests::stopwatch::on_core;

/// Time on a core.
pub(crate) struct OnCore;

/// Benchmarks by time on a core.
pub(crate) fn criterion() -> Criterion<OnCore> {
    Criterion::default().with_measurement(OnCore)
}

impl Measurement for OnCore {
    type Intermediate = Duration;
    type Value = Duration;

    fn start(&self) -> Duration {
        on_core()
    }

    fn end(&self, start: Duration) -> Duration {
        on_core().saturating_sub(start)
    }

    fn add(&self, first: &Duration, second: &Duration) -> Duration {
        *first + *second
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}
