//! Plasticity-based virtual fixtures for a five-bar admittance rig on CANopen servo drives.
//!
//! # The signal path
//! ```text
//! bus frame -> sensing -> Force -> fixture -> ProxyPoint -> linkage::inverse -> JointAngles
//!           -> control -> JointCommand -> guard -> Allowed<JointCommand> -> scaling -> bus frame
//! ```
//! [`cycle`] is the only place that names all stages.
//!
//! # Where to begin
//! | to | take | features |
//! |---|---|---|
//! | use a fixture in a loop of your own | [`fixture::Fixture`] | none |
//! | control a joint whose torque is limited | [`control::Psmc`] | none |
//! | run a simulated rig | `rig::EmbeddedRig` | `sim` |
//! | read a recording | `record::recording::Reader` | `recording` |
//! | run a rig on a bus | `host::RigOnBus` | `config`, `socketcan` |
//!
//! Each has an example where it is described, and a program in the folder `examples`.
//!
//! # Units
//! SI in `f64`, base frame. Conversion happens in two places only: [`sensing`] and the scaling of `yieldwall_drives`.

#[cfg(feature = "config")]
#[doc(inline)]
pub use yieldwall_config::{self as config, injection};
#[doc(inline)]
pub use yieldwall_fieldbus::{canopen, ethercat, objects, plain_can, time};
#[doc(inline)]
pub use yieldwall_link::{self as link, checkup};
#[doc(inline)]
pub use yieldwall_motion::{
    control, cycle, elementary, fixture, guard, identification, linkage, quantity, sensing, setvalued,
};

#[cfg(feature = "config")]
pub mod explanation;

#[cfg(test)]
mod sample;

#[cfg(feature = "sim")]
pub mod analysis;
#[cfg(feature = "config")]
pub mod assembly;
#[cfg(feature = "config")]
pub mod batch;
pub mod bus;
#[cfg(feature = "config")]
pub mod host;
#[cfg(feature = "sim")]
pub mod live;
/// What a run leaves, and figures of it.
pub mod record {
    #[cfg(feature = "figures")]
    #[doc(inline)]
    pub use yieldwall_figures as figure;
    #[doc(inline)]
    pub use yieldwall_record::*;
}
#[cfg(feature = "sim")]
pub mod report;
#[cfg(feature = "sim")]
pub mod rig;
#[cfg(feature = "config")]
pub mod run;
pub mod service;
#[cfg(feature = "sim")]
pub mod sim;
#[cfg(feature = "sim")]
pub mod soak;
#[cfg(feature = "sim")]
pub mod study;

#[cfg(feature = "cli")]
pub mod cli;
