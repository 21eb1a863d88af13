//! Raw counts of a six-axis force sensor to the force of the hand on the tool, in the base frame.
//!
//! ```text
//! RawSample -> Calibration -> Wrench (sensor frame) -> tare -> Mounting (turns with the link) -> handle inertia
//!           -> low pass -> Reading
//! ```
//! [`Calibration::counts_for`] and [`Mounting::to_sensor`] go the other way, for a simulated sensor.
//!
//! # Sign
//! The wrench is what the hand's side exerts on the sensor. A sensor that reports its own reaction has the sign in its
//! calibration matrix.

mod calibration;
mod error;
mod filter;
mod mounting;
mod reading;
mod tare;
#[cfg(test)]
mod tests;

pub use calibration::{Calibration, RawSample, SATURATION_FRACTION, Wrench};
pub use error::SensingError;
pub use filter::LowPass;
pub use mounting::{MountedOn, Mounting};
pub use reading::{Reading, STALE_AFTER_MISSED_SAMPLES, STUCK_AFTER_IDENTICAL_SAMPLES, Sensing, SensingParameters};
pub use tare::{Tare, TareFault, TareParameters, TareState};
