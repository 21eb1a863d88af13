//! The loop that runs a rig, wherever it runs: boot, proofs, enabling, cycles, stop, records, watchdog drill.
//!
//! ```text
//! grid point:         take what has come, SYNC alone
//! grid + t_compute:   take what has come, Cycle::step, set-points
//! ```
//! [`Runner`] is the only loop, and a [`Place`] is all that it needs of its surroundings: [`OnLink`] is a computer with interfaces,
//! the embedded rig has the one in virtual time ([`VirtualPlace`]). Nothing else here reads a clock.

pub mod assembly;
pub mod built;
mod calibration;
pub mod commission;
mod conduct;
mod drill;
mod drilled;
mod error;
pub mod explanation;
mod home;
pub mod host;
mod inquiry;
mod jog;
mod keys;
mod lead_watch;
mod metronome;
mod orders;
mod pace;
mod permit;
mod place;
mod proof;
mod push;
mod restart;
mod runner;
#[cfg(test)]
#[path = "../sample.rs"]
mod sample;
mod scene;
mod sensor;
mod simulation;
mod standstill;
mod torque_meter;
mod tune_loop;

pub use calibration::{Helper, Pulled, Task};
pub use conduct::{BootSteps, Enable, Enabling, STOP_LIMIT_S, has_torque, settling_cycles, settling_on_bus};
pub use drilled::{
    CYCLES_BEFORE_SILENCE, DRILL_LIMIT, Demands, Drilled, Finding, Settled, TORQUE_LIMIT, Unsafe, watchdogs,
};
pub use error::{RunError, Which};
pub use home::{HOMING_BEYOND_RAD, HomePlan, Homed, JointHomed, NoShift, NotHome, Repeated};
pub use inquiry::{DriveError, ErrorWatch};
pub use jog::{Jog, Jogged};
pub use keys::{Key, Keys};
pub use lead_watch::ToldTorque;
pub use metronome::Metronome;
pub use orders::Orders;
pub use pace::Pace;
pub use permit::{Ask, Bounds, Permit, REST_RAD};
pub use place::{OnLink, Place, Process, VirtualPlace};
pub use proof::fnv1a;
pub use proof::{DriveIdentity, NotProven, Proof, Subject, Unproven};
pub use restart::Restarts;
pub use runner::{ANNOUNCED, BootWatch, END_OF_WATCH, LinkCounts, Observer, Runner, Tap};
pub use scene::{Ended, Play, Played};
pub use sensor::{NoZero, Wrenches};
pub use tune_loop::{
    Follows, ForceFound, JointFound, JointLoop, LOOP_BOUND_RAD, LoopPlan, LoopTraced, LoopUnreadable, MeasuredLoop,
    Prove, STEP_RISE_S, StepAnswer,
};
