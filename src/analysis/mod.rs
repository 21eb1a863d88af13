//! What can be said of a rig before it runs: the margins of its own loop, and the virtual masses that its hands can hold.

mod held;
mod margins;

pub use held::{
    Coupled, HeldMasses, Holding, UnevenSamples, coupled_device, hand_of, held_masses, stiffer, uneven_samples,
    usual_hands,
};
pub use margins::{Margin, PoseMargins, pose_margins};
