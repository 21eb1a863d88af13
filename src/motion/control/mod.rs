//! Angle errors to torques: PSMC and PID per axis, rate commands, feed-forward, and the margins of the loop they close.
//!
//! An axis is one scalar coordinate with its effort: a joint (rad, N m) or one direction of the base frame (m, N). The
//! laws do not know which; a caller that controls in Cartesian space maps forces to torques by the transposed Jacobian.
//!
//! The way of one cycle, per axis:
//! ```text
//! desired rate, acceleration --> FeedForward --> EffortRange::around --> feed-forward within the limit
//!                                                       |
//! desired - measured ----------> AxisController::step <-+ what the limit leaves  --> effort; command = both added
//! ```
//!
//! # Bad input
//! A law that is given NaN or infinity answers with the effort nearest to zero that its range allows, leaves its
//! integral alone and says `valid: false`. So a command is always finite, and the guard sees that it must not be used.

mod axis;
mod coupled;
mod coupling;
mod error;
mod feed_forward;
mod margins;
mod pid;
mod psmc;
mod rate;
mod stability;
#[cfg(test)]
mod tests;
mod tuning;

pub use axis::{Axis, AxisController, AxisStep, EffortRange, Gains, Law};
pub use coupled::{
    Compensation, Follower, Gears, Grip, HeldLoop, MASSES_KG, Outer, Pose, Sampling, StableMasses, admittance, lag_s,
    passive_mass_kg, stable_masses,
};
pub use coupling::{damping_needed_n_s_per_m, greatest_damping_n_s_per_m, greatest_stiffness_n_per_m};
pub use error::ControlError;
pub use feed_forward::{FeedForward, FeedForwardParameters, FeedForwardStep, InertiaTerm};
pub use margins::{
    MAX_DELAY_CYCLES, Margins, ServoLoop, controller, is_stable, margins, open_loop, principal_inertias, worst_margins,
};
pub use pid::Pid;
pub use psmc::Psmc;
pub use rate::{RateLaw, RateStep};
pub use tuning::{Tuned, at_bandwidth, stiffest};
