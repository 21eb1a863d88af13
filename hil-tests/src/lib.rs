//! Scenario bodies shared by the tests and benchmarks of the whole rig.
//!
//! [`Scenario`] names a shipped rig and what is changed about it; [`Recording`] is what an observer on the bus sees of it.
//! [`arbitrary`] has bodies for any bytes. The benchmarks time a [`machine::Machine`] and its stages on what [`tape`] recorded.

pub mod arbitrary;
pub mod machine;
mod observe;
mod scenario;
pub mod stopwatch;
pub mod tape;

pub use observe::{DRIVE_NODES, Recording, SENSOR_NODE, Seen, Setpoint, Status, setpoint, status};
pub use scenario::{Scenario, Session};
