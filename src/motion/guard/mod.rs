//! The last gate before the bus: what may move, whether it may move now, and how everything stops.
//!
//! The last gate is [`Gate`]: it turns a [`JointCommand`] into an [`Allowed`] one or names the [`Fault`]. The state of the rig is in
//! [`Supervisor`]. It decides, once a cycle and for all axes together, whether the rig runs, holds or stops. The faults are listed in
//! [`fault`], as data.

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
