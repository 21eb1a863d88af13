//! The loop that runs a rig, wherever it runs: boot, proofs, enabling, cycles, stop, records. [`bringup`] holds the operations
//! before a rig is used: drill, commissioning, homing, jog, identification, calibration.
//!
//! ```text
//! grid point:         take what has come, SYNC alone
//! grid + t_compute:   take what has come, Cycle::step, set-points
//! ```
//! [`Runner`] is the only loop, and a [`Place`] is its only interface to its surroundings. [`OnLink`] is a computer with
//! interfaces. The embedded rig has the place in virtual time ([`VirtualPlace`]). Nothing else here reads a clock.

pub mod assembly;
pub mod bringup;
pub mod built;
mod conduct;
mod drilled;
mod error;
pub mod explanation;
pub mod host;
mod inquiry;
mod metronome;
mod orders;
mod pace;
mod permit;
mod place;
mod proof;
#[cfg(feature = "recording")]
pub mod recorder;
mod restart;
mod runner;
#[cfg(test)]
#[path = "../sample.rs"]
mod sample;
mod scene;
mod sensor;
mod simulation;
mod standstill;
mod watch;

pub use bringup::commission;
pub use bringup::{
    Follows, ForceFound, HOMING_BEYOND_RAD, Helper, HomePlan, Homed, Jog, Jogged, JointFound, JointHomed, JointLoop,
    Key, Keys, LOOP_BOUND_RAD, LoopPlan, LoopTraced, LoopUnreadable, MeasuredLoop, NoShift, NotHome, Prove, Pulled,
    Repeated, STEP_RISE_S, StepAnswer, ToldTorque,
};
pub use conduct::{BootSteps, Enable, Enabling, settling_cycles, settling_on_bus};
pub use drilled::{
    CYCLES_BEFORE_SILENCE, DRILL_LIMIT, Demands, Drilled, Finding, Settled, TORQUE_LIMIT, Unsafe, watchdogs,
};
pub use error::{RunError, Which};
pub use inquiry::{DriveError, ErrorWatch};
pub use metronome::Metronome;
pub use orders::Orders;
pub use pace::Pace;
pub use permit::{Ask, Bounds, Permit, REST_RAD};
pub use place::{OnLink, Place, Process, Task, VirtualPlace};
pub use proof::fnv1a;
pub use proof::{DriveIdentity, NotProven, Proof, Subject, Unproven};
pub use restart::Restarts;
pub use runner::{ANNOUNCED, BootWatch, END_OF_WATCH, LinkCounts, Observer, Runner, Tap};
pub use scene::{Ended, Play, Played};
pub use sensor::{NoZero, Wrenches};
pub use watch::Watch;
