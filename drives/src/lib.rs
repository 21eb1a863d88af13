//! CiA 402 servo drives without I/O: objects, state machine of both sides, scaling to SI, device profiles, electronic data sheets.
//!
//! Nothing here owns time, a bus or a thread. [`cia402::StateWalk`] is what a master runs each cycle,
//! [`cia402::StateMachine`] is what a (simulated) drive runs, [`scaling`] is one of the two places of the project where
//! units change, [`profiles`] says how one device model is mapped and identified, and [`eds`] and [`esi`] read what a
//! vendor says of its objects.

pub mod cia402;
pub mod codes;
pub mod eds;
pub mod esi;
pub mod objects;
pub mod profiles;
pub mod scaling;
pub mod watchdog;
