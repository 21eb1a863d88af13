//! The last gate before the bus: what may move, whether it may move now, and how everything stops.
//!
//! [`Gate`] turns a [`JointCommand`] into an [`Allowed`] one or names the [`Fault`]; [`Supervisor`] holds the state of
//! the rig and decides, once a cycle and for all axes together, whether it runs, holds or stops; [`fault`] lists what
//! can go wrong, as data.

pub mod fault;
mod gate;
mod joint_rest;
mod stop;
mod supervisor;

pub use fault::{Cause, Device, DeviceSet, Fault, FaultCounts, Reaction};
pub use gate::{Allowed, Gate, JointCommand, Limits, Measured};
pub use joint_rest::JointRest;
pub use stop::StopRamp;
pub use supervisor::{Directive, Motion, Request, State, Supervisor, View};
