//! The planar five-bar linkage: kinematics in one working and one assembly mode, distance to what it cannot pass, and
//! its equations of motion.
//!
//! # Shape
//! Two chains, left (index 0) and right (index 1). Each has a driven proximal link from its base joint to its elbow
//! and a passive distal link from its elbow to the wrist, which both share. Links may differ, and the base joints may
//! coincide. The tool point is fixed to one distal link.
//!
//! ```text
//!                 wrist
//!     distal  /          \  distal
//!   elbow 0 +              + elbow 1
//!  proximal  \            /  proximal
//!           base 0    base 1
//! ```
//!
//! # Modes
//! A tool point has up to four pairs of joint angles, which differ in the side on which each elbow lies (the working mode, [`Side`]). A
//! pair of joint angles has up to two wrists (the assembly mode, [`WristSide`]). A [`FiveBar`] knows one of each and refuses the rest by
//! name.
//!
//! # Singularities
//! Type 1: a chain is stretched or folded. The tool cannot leave along it, and the inverse ends there. Type 2: the distal links lie on one
//! line, stretched or folded. With equal distal links, folded means that the elbows meet. Locked motors do not hold the tool, and the
//! forward map ends there.
//!
//! # Source
//! The two types: Gosselin and Angeles, *Singularity analysis of closed-loop kinematic chains*, IEEE Transactions on
//! Robotics and Automation 6(3), 1990. The equations are derived where they stand.

mod clearance;
mod complex;
mod dynamics;
mod error;
mod five_bar;
mod geometry;
mod posture;
mod singularity;
#[cfg(test)]
mod tests;

pub use clearance::{Clearance, DiscError};
pub use dynamics::{Dynamics, MassModel, RATE_LIMIT_RAD_PER_S};
pub use error::LinkageError;
pub use five_bar::{ANGLE_LIMIT_RAD, Closure, FiveBar, LEAST_SINE};
pub use geometry::{Chain, Geometry, GeometryError, LENGTH_RANGE_M, Side, Tool, WristSide};
pub use posture::{CONDITION_LIMIT, Posture};
pub use singularity::Singularity;
