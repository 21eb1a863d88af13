//! Scenario bodies shared by the tests and benchmarks of the whole rig.

pub mod machine;
pub mod stopwatch;
pub mod tape;
