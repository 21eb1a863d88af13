//! Identification of an arm: inertia, friction and delay of a joint from its motion on a commanded path, and link lengths and zeros from
//! points that the tool has visited. Each result has its 95 % interval. The module also identifies the response of a force sensor to known
//! forces, and the age of its force.
//!
//! ```text
//! Excitation -> the joint is led at a steady rate, and the excitation on top -> Passage -> dynamics(): inertia, delay, response
//!               the joint is led at steady rates, to and fro                 -> Steady  -> friction(): Coulomb and viscous
//!               the tool is shaken by that, with nobody at the handle        -> Shaken  -> handle(): mass beyond the sensor, age of the force
//! ```
//! Nothing here reads a clock or knows a rig: angles and torques of consecutive cycles go in.
//!
//! # Why the joint moves all the time
//! Dry friction depends on the sign of the rate. As long as the joint turns one way it is a constant, and what is left is linear:
//! `torque = J q'' + b q' + constant`.
//!
//! # Why no derivative is taken
//! The second difference of an angle is exactly a mean of its acceleration over two cycles, weighted by a triangle. For a torque that is
//! held from cycle to cycle, this mean is exactly a sum of three such torques, whatever share of a cycle it comes late. So both sides of
//! the equation of motion are known without an error of discretisation, and the delay may be a share of a cycle.

mod dynamics;
mod estimate;
mod excitation;
mod forces;
mod friction;
mod handle;
mod kinematics;

pub use dynamics::{Dynamics, MOST_SHIFTS, Passage, Response, dynamics};
pub use estimate::Estimate;
pub use excitation::{Excitation, Line};
pub use forces::{ForceMap, Pull, force_map};
pub use friction::{Friction, Steady, friction};
pub use handle::{BEHIND, Handle, Shaken, handle, lead_in};
pub use kinematics::{Kinematics, Mistaken, Visited, kinematics, mistaken};

use thiserror::Error;

/// Reason why something was not identified.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum NotIdentified {
    /// Fewer samples than it takes.
    #[error("there are too few samples")]
    TooFew,
    /// A sample is not finite.
    #[error("a sample is not a number")]
    NotFinite,
    /// The joint stood, or turned back, while it had to turn one way.
    #[error("the joint did not turn one way all the time")]
    Stands,
    /// The drive closes the loop. It does not report its torque between two set-points, which causes a large share of the acceleration.
    #[error("the drive closes the loop, and does not report its torque within a cycle")]
    InDrive,
    /// The motion does not determine the unknowns separately.
    #[error("the motion does not separate inertia, friction and delay")]
    Indistinct,
    /// The points do not determine the lengths and zeros of an arm, or the arm cannot be at them.
    #[error("the points do not separate links from zeros, or no such arm reaches them")]
    Apart,
    /// No delay within the range of the search fits.
    #[error("no delay up to {longest_s} s fits")]
    NoDelay {
        /// The longest one, s.
        longest_s: f64,
    },
    /// The mass beyond the force sensor is too small against the sensor's noise.
    #[error("at most {:.1} g are beyond the force sensor, too little against its noise", 1e3 * up_to_kg)]
    NoHandle {
        /// The mass that fits, kg.
        mass_kg: f64,
        /// Greatest one that it may be, kg, 0 or above.
        up_to_kg: f64,
    },
    /// The inertia would not be positive.
    #[error("the torque does not accelerate the joint")]
    NoInertia,
}
