//! A virtual EtherCAT segment: slave controllers in a line, with the simulated devices behind them.
//!
//! ```text
//! master --frame--> Controller --> Controller --> Controller --+      Controller: registers, FMMU, sync managers, SII, clock,
//!        <---------------------------------------------------- +                  state machine, mailbox
//!                       |              |              |
//!                    ServedDevice   ServedDevice   ServedDevice           one object dictionary each
//! ```
//!
//! [`Segment::process`] is a pure function of time and frame: it changes the frame in place and gives the moment at which it is back.
//! It does not allocate.

mod application;
mod controller;
mod description;
mod device;
mod process_data;
mod segment;
#[cfg(test)]
mod tests;

pub use application::EthercatApplication;
pub use controller::{Controller, ControllerSettings, Information, Manner};
pub(super) use description::{Communication, PdoMapping};
pub use description::{esi, sii};
pub use device::SimulatedDevice;
pub use segment::Segment;
