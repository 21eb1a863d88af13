use super::geometry::{Chain, Side};
use super::singularity::Singularity;
use thiserror::Error;

/// Reason why a position, an angle or a motion is refused. Every variant carries the numbers behind it.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum LinkageError {
    /// A number is NaN or infinite, or so large that the result would be.
    #[error("{what} is not usable: {values:?}")]
    NotFinite {
        /// Name of the numbers, with their unit.
        what: &'static str,
        /// The refused numbers.
        values: [f64; 2],
    },
    /// The point of a chain is farther from its base joint than the stretched chain. The point is the tool point for the chain that holds
    /// the tool, and the wrist for the other chain.
    #[error(
        "the {chain} chain cannot reach: {distance_m:.6} m from its base joint, \
         stretched it has {longest_m:.6} m, {:.3e} m short",
        .distance_m - .longest_m
    )]
    OutOfReach {
        /// The chain that is too short.
        chain: Chain,
        /// Distance from its base joint to the point.
        distance_m: f64,
        /// Length of the stretched chain.
        longest_m: f64,
    },
    /// The point that a chain has to carry is nearer to its base joint than the folded chain.
    #[error(
        "the {chain} chain cannot fold so far: {distance_m:.6} m from its base joint, \
         folded it has {shortest_m:.6} m, {:.3e} m too near",
        .shortest_m - .distance_m
    )]
    TooClose {
        /// The chain that is too long.
        chain: Chain,
        /// Distance from its base joint to the point.
        distance_m: f64,
        /// Length of the folded chain; with equal links the distance below which the angle is undefined.
        shortest_m: f64,
    },
    /// Type 2: the distal links lie on one line, pointing apart, or cannot meet because the elbows are too far apart.
    #[error("the distal links are stretched: elbows {elbow_distance_m:.6} m apart, at most {longest_m:.6} m")]
    DistalStretched {
        /// Distance between the elbows.
        elbow_distance_m: f64,
        /// Sum of the two distal lengths.
        longest_m: f64,
    },
    /// Type 2: the distal links lie on one line, pointing the same way, or cannot meet because the elbows are too near.
    /// With equal distal links the elbows meet.
    #[error("the distal links are folded: elbows {elbow_distance_m:.6} m apart, at least {shortest_m:.6} m")]
    DistalFolded {
        /// Distance between the elbows.
        elbow_distance_m: f64,
        /// Difference of the two distal lengths.
        shortest_m: f64,
    },
    /// The joint angles that carry the tool point in this working mode belong to the other assembly mode.
    #[error(
        "the tool point belongs to the other assembly mode: wrist {wrist_offset_m:.6} m to the left of the elbows' line"
    )]
    OtherAssembly {
        /// Distance of the wrist from the line through the elbows, positive to the left of left -> right elbow.
        wrist_offset_m: f64,
    },
    /// An elbow lies on the other side than the geometry says.
    #[error("the {chain} elbow lies on the {side} of its line of sight, not on the side of the working mode")]
    OtherElbow {
        /// The chain of that elbow.
        chain: Chain,
        /// The side on which it lies.
        side: Side,
    },
    /// Nearer to a singularity than the margin.
    #[error("{clearance_m:.6} m before {singularity}, margin {margin_m} m")]
    NearSingularity {
        /// The nearest singularity.
        singularity: Singularity,
        /// The distance.
        clearance_m: f64,
        /// The smallest allowed distance.
        margin_m: f64,
    },
    /// The Jacobian cannot be inverted.
    #[error(
        "no joint rates give this tool velocity: smallest singular value {smallest_m:.3e} m, largest {largest_m:.3} m"
    )]
    JacobianSingular {
        /// Smallest singular value of the Jacobian.
        smallest_m: f64,
        /// Largest singular value of the Jacobian.
        largest_m: f64,
    },
    /// The mass matrix is not positive definite, so the mass model is not one of a machine.
    #[error("mass matrix not positive definite: determinant {determinant:.3e}")]
    MassNotPositive {
        /// Determinant of the mass matrix in kg^2 m^4.
        determinant: f64,
    },
}

/// Returns the largest finite number in place of an infinite distance, so that an error carries finite numbers.
pub(super) fn finite(value: f64) -> f64 {
    value.min(f64::MAX)
}
