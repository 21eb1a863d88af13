//! Analysis of a rig before it runs: the margins of its own loop, gains that give the wanted margins, and the virtual masses that
//! its hands can hold.

mod force_age;
mod gains;
mod held;
mod identified;
mod margins;
mod remedies;

pub use force_age::{UnevenSamples, believed_age_s, is_sampled_at_sync, later_s, uneven_samples};
pub use gains::{
    LEAST_MARGINS, PROPOSED_MARGINS, RateMargins, has_margins, proposed_gains, proposed_rate_gain, rate_margins,
};
pub use held::{
    Coupled, DriveLimits, HeldMasses, Holding, coupled_device, drive_limits, hand_of, held_masses,
    held_masses_identified, stiffer, unmodelled, usual_hands,
};
pub use identified::{identified_margins, identified_models};
pub use margins::{Margin, PoseMargins, pose_margins};
pub use remedies::{Remedy, remedies};
