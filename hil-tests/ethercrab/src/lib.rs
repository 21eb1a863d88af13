//! What it takes to try a master of others on the simulated segment of a rig, and to look at its frames.

pub mod capture;
pub mod pump;
