//! A configuration assembled into a rig that runs in virtual time.
//!
//! ```text
//! config::Rig + config::Scene -> build -> Master (cycle inside) <-> VirtualBus <-> Drive x2, ForceSensor <-> World (arm, hand)
//! ```
//! [`EmbeddedRig`] processes events in order of virtual time: frames that arrive, moments that devices or the master
//! wait for, and the two moments of each cycle. [`ImpedanceRig`] is the device without a bus,
//! [`Pair`] a master and a slave with a delay between them.

mod devices;
mod drill;
mod embedded;
mod error;
mod far_end;
mod hand;
mod held;
mod impedance;
mod margins;
mod pair;
mod seat;
mod server;
mod world;

pub use devices::{arm as simulated_arm, drive as simulated_drive, force_sensor as simulated_force_sensor};
pub use drill::drill;
pub use embedded::{BodyTruth, EmbeddedRig, PORTS};
pub use error::RigError;
pub use held::{
    Coupled, HeldMasses, Holding, UnevenSamples, coupled_device, hand_of, held_masses, stiffer, uneven_samples,
    usual_hands,
};
pub use impedance::{ImpedanceLoop, ImpedanceRig};
pub use margins::{Margin, PoseMargins, pose_margins};
pub use pair::{Pair, PairParameters, PairRow, PairServo, Placement, Surroundings};
pub use seat::{Answer, Call, Peer};
pub use server::{DeviceServer, Served};
