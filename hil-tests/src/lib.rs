//! Scenario bodies shared by the tests and benchmarks of the whole rig.
//!
//! [`Scenario`] names a shipped rig and what is changed about it; [`Recording`] is what an observer on the bus sees of it.
//! [`arbitrary`] has bodies for any bytes. The benchmarks time a [`machine::Machine`] and its stages on what [`tape`] recorded.
//! [`processes`] are programs that a test starts, none of which outlives it.
//! [`network`] is a bus with devices, virtual or behind an interface; [`segment`] is a virtual EtherCAT segment with devices.

pub mod arbitrary;
pub mod cable;
pub mod machine;
pub mod network;
mod observe;
pub mod processes;
mod scenario;
pub mod segment;
pub mod segment_cable;
pub mod shared_cable;
pub mod stopwatch;
pub mod tape;

pub use observe::{DRIVE_NODES, ObservedFrame, Recording, SENSOR_NODE, Setpoint, Status, setpoint, status};
pub use scenario::{Scenario, Session};

/// The program itself, which `hil-tests/run` has built beside the tests.
///
/// # Panics
/// If it is not there.
pub fn program() -> std::path::PathBuf {
    let tests = std::env::current_exe().expect("a test has a file");
    let program = tests.ancestors().nth(2).expect("target/debug/deps").join("yieldwall");
    assert!(program.is_file(), "{} is missing: cargo build --bin yieldwall", program.display());
    program
}
