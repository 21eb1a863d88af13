//! CiA 402 servo drives without I/O: objects, state machine of both sides, scaling to SI, device profiles, electronic data sheets.
//!
//! Nothing here owns time, a bus or a thread. A master runs [`cia402::StateWalk`] each cycle, and a (simulated) drive runs
//! [`cia402::StateMachine`]. Units change in two places of the project, one of them [`scaling`]. A profile ([`profiles`]) describes
//! how one device model is mapped and identified. The modules [`eds`] and [`esi`] read a vendor's description of its objects.

pub mod cia402;
pub mod codes;
pub mod eds;
pub mod esi;
pub mod objects;
pub mod profiles;
pub mod scaling;
pub mod watchdog;
