//! The computer that a loop runs on: what it grants, how late it wakes up, and what was proved of that; and a rig on its
//! interfaces.

mod histogram;
mod latency;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
mod on_bus;
mod stages;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub mod system;
mod timing;

pub use histogram::Histogram;
pub use latency::{Latency, Lateness, PROBE, PROVING_CYCLES, STOCK_CYCLES, Tier, measure_latency};
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub use on_bus::{
    BringUp, DrillOutcome, Evidence, HostedRun, News, NotRun, OpenError, Operation, Person, RigOnBus, Terms,
    ThreadError, open_buses,
};
pub use stages::StageTimes;
pub use timing::{Computer, Measured, ProvenTiming, REDUCED_FORCE_N, REDUCED_SPEED_M_PER_S, Stored, Untimely};
