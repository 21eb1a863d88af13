//! How a run is drawn.

use crate::record::Trace;
use crate::record::figure::{Drawing, Error, Options, trajectory_and_time};

/// The drawing of one run: trajectory with forces, force and power against time.
///
/// # Errors
/// As [`trajectory_and_time`].
pub fn run(trace: &Trace, heading: Option<String>) -> Result<Drawing, Error> {
    trajectory_and_time(trace, &Options { heading, ..Options::default() })
}
