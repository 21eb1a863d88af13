//! The CiA 402 state machine, from the master's side and from the device's side.

mod device;
mod mode;
mod walk;
mod words;

pub use device::{OptionCodes, Reaction, StateMachine, Transition};
pub use mode::{CommandMode, OperationMode};
pub use walk::{Goal, StateWalk, Walk, next_command};
pub use words::{Command, State, Statusword, controlword};
