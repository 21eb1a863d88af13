use super::geometry::Chain;
use std::fmt;

/// Singularity that the linkage cannot pass in one working and one assembly mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Singularity {
    /// Type 1: a chain is stretched.
    Stretched(Chain),
    /// Type 1: a chain is folded.
    Folded(Chain),
    /// Type 2: the distal links are stretched, the wrist lies between the elbows.
    DistalStretched,
    /// Type 2: the distal links are folded; with equal ones the elbows meet.
    DistalFolded,
    /// The edge of what the tool point can reach.
    WorkspaceEdge,
}

impl fmt::Display for Singularity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stretched(chain) => write!(f, "the {chain} chain is stretched"),
            Self::Folded(chain) => write!(f, "the {chain} chain is folded"),
            Self::DistalStretched => f.write_str("the distal links are stretched"),
            Self::DistalFolded => f.write_str("the distal links are folded"),
            Self::WorkspaceEdge => f.write_str("the tool point leaves the workspace"),
        }
    }
}
