//! The simulated machine: arm, hand, point mass, drives, sensor and bus.

pub mod arm;
pub mod hand;
pub mod point_mass;
mod substeps;
