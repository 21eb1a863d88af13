//! What can be said of a rig before it runs: the margins of its own loop, gains that leave wanted ones, and the virtual masses that its
//! hands can hold.

mod gains;
mod held;
mod identified;
mod margins;
mod remedies;

pub use gains::{
    LEAST_MARGINS, PROPOSED_MARGINS, RateMargins, has_margins, proposed_gains, proposed_rate_gain, rate_margins,
};
pub use held::{
    Coupled, HeldMasses, Holding, UnevenSamples, coupled_device, hand_of, held_masses, held_masses_identified,
    is_sampled_at_sync, stiffer, uneven_samples, usual_hands,
};
pub use identified::{believed_age_s, identified_margins, identified_models, later_s};
pub use margins::{Margin, PoseMargins, pose_margins};
pub use remedies::{Remedy, remedies};
