//! What masters of others are tried on: a simulated segment of two drives and a force sensor.

pub mod capture;
pub mod devices;
pub mod pump;
