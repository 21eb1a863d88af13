//! CiA 402 servo drives without I/O: objects, state machine of both sides, scaling to SI, device profiles.
//!
//! Nothing here owns time, a bus or a thread. [`cia402::StateWalk`] is what a master runs each cycle,
//! [`cia402::StateMachine`] is what a (simulated) drive runs, [`scaling`] is one of the two places of the project where
//! units change, and [`profiles`] says how one device model is mapped and identified.

pub mod cia402;
pub mod objects;
pub mod profiles;
pub mod scaling;
pub mod watchdog;
