//! Plasticity-based virtual fixtures for a five-bar admittance rig on CANopen servo drives.
//!
//! # The signal path
//! ```text
//! bus frame -> sensing -> Force -> fixture -> TipPoint -> linkage::inverse -> JointAngles
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

#[doc(inline)]
pub use yieldwall_bus as bus;
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
#[cfg(feature = "sim")]
#[doc(inline)]
pub use yieldwall_rig::{self as rig, analysis, batch, live, report};
#[cfg(feature = "config")]
#[doc(inline)]
pub use yieldwall_run::{self as run, assembly, explanation, host};
#[doc(inline)]
pub use yieldwall_service as service;
#[cfg(feature = "sim")]
#[doc(inline)]
pub use yieldwall_sim as sim;
#[cfg(feature = "sim")]
#[doc(inline)]
pub use yieldwall_soak as soak;
#[cfg(feature = "figures")]
#[doc(inline)]
pub use yieldwall_study as study;

pub mod record {
    //! Records of every cycle, traces, recordings and figures of a run.

    #[cfg(feature = "figures")]
    #[doc(inline)]
    pub use yieldwall_figures as figure;
    #[doc(inline)]
    pub use yieldwall_record::*;
}
