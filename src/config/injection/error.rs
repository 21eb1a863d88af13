//! Errors of an impossible injection.

use super::{Medium, Size, Target};
use thiserror::Error;

/// Reason why an injection is impossible.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum InjectionError {
    /// The kind does not act there.
    #[error("{name} does not act on {}: it acts on {}", target.name(), names(targets))]
    Target {
        /// Name of the kind.
        name: &'static str,
        /// The target that was asked for.
        target: Target,
        /// The targets of the kind.
        targets: &'static [Target],
    },
    /// The kind means nothing on such a bus.
    #[error("{name} does not exist on {}, only on {}", medium.name(), media.iter().map(|medium| medium.name()).collect::<Vec<_>>().join(" and "))]
    Medium {
        /// Name of the kind.
        name: &'static str,
        /// The bus that is there.
        medium: Medium,
        /// The buses of the kind.
        media: &'static [Medium],
    },
    /// The start is not a moment of the scene.
    #[error("{name} begins at {start_s} s: write seconds after the start of the scene, 0 or above")]
    Start {
        /// Name of the kind.
        name: &'static str,
        /// The start that was asked for, in s.
        start_s: f64,
    },
    /// The duration is not above zero.
    #[error("{name} lasts {duration_s} s: write seconds above 0")]
    Duration {
        /// Name of the kind.
        name: &'static str,
        /// The duration that was asked for, in s.
        duration_s: f64,
    },
    /// Faults that happen once, or are present from power-on, have no duration.
    #[error("{name} has no duration: it happens once, or lasts from power-on")]
    NoDuration {
        /// Name of the kind.
        name: &'static str,
    },
    /// The size is out of its range.
    #[error("{name} has the size {size}: write {} between {} and {}", allowed.what, allowed.least, allowed.most)]
    Size {
        /// Name of the kind.
        name: &'static str,
        /// The size that was asked for.
        size: f64,
        /// Sizes allowed.
        allowed: Size,
    },
    /// The kind has no size.
    #[error("{name} takes no size")]
    NoSize {
        /// Name of the kind.
        name: &'static str,
    },
}

fn names(targets: &[Target]) -> String {
    targets.iter().map(|target| target.name()).collect::<Vec<_>>().join(", ")
}
