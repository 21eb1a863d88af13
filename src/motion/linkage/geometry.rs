use crate::elementary;
use std::fmt;
use std::ops::RangeInclusive;
use thiserror::Error;

/// Lengths that a link may have in m. The bounds keep every square and product far from overflow and underflow.
pub const LENGTH_RANGE_M: RangeInclusive<f64> = 1e-3..=1e3;

/// Coordinates of the base joints and offsets of the tool may be as large as the longest link.
const OFFSET_LIMIT_M: f64 = *LENGTH_RANGE_M.end();

/// One of the two chains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chain {
    /// Index 0.
    Left,
    /// Index 1.
    Right,
}

impl Chain {
    /// Both, in the order of the indices.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// Returns the place in arrays and joint vectors.
    pub const fn index(self) -> usize {
        match self {
            Self::Left => 0,
            Self::Right => 1,
        }
    }

    /// The other chain.
    pub const fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }
}

impl fmt::Display for Chain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Left => "left",
            Self::Right => "right",
        })
    }
}

/// Working mode of one chain: the side on which its elbow lies, seen from the base joint towards the point that the
/// chain carries.
///
/// That point is the wrist; for the chain that holds the tool it is the tool point, because there the side changes
/// where the tool point's inverse has its branch. Both agree while the tool's offset has no part across the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// To the left of the line of sight.
    Left,
    /// To the right of the line of sight.
    Right,
}

impl Side {
    /// +1 for left, -1 for right.
    pub(super) const fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Left => "left",
            Self::Right => "right",
        })
    }
}

/// Assembly mode: the side of the line from left to right elbow on which the wrist lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WristSide {
    /// To the left of the line from left to right elbow: away from the base, with elbows outward.
    Forward,
    /// To the right of that line.
    Backward,
}

impl WristSide {
    /// +1 for forward, -1 for backward.
    pub(super) const fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
        }
    }
}

/// Position of the tool point on the linkage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tool {
    /// The chain whose distal link holds the tool.
    pub fixed_to: Chain,
    /// From the wrist along that link, away from its elbow, in m.
    pub along_m: f64,
    /// From the wrist across that link, to the left of that direction, in m.
    pub across_m: f64,
}

/// Parameters of a planar five-bar, as measured or drawn; [`FiveBar::new`](super::FiveBar::new) checks them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Base joints, left then right, in m, base frame. They may coincide.
    pub base_m: [[f64; 2]; 2],
    /// Lengths of the proximal links in m, within [`LENGTH_RANGE_M`].
    pub proximal_m: [f64; 2],
    /// Lengths of the distal links in m, within [`LENGTH_RANGE_M`].
    pub distal_m: [f64; 2],
    /// Working mode.
    pub elbows: [Side; 2],
    /// Assembly mode.
    pub wrist: WristSide,
    /// Tool point.
    pub tool: Tool,
}

/// Reason why a set of parameters is not that of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum GeometryError {
    /// A length is NaN, not positive or beyond any machine.
    #[error("{chain} {link} link: {length_m} m is outside {}..={} m", LENGTH_RANGE_M.start(), LENGTH_RANGE_M.end())]
    Length {
        /// Chain of the link.
        chain: Chain,
        /// `proximal` or `distal`.
        link: &'static str,
        /// The refused length.
        length_m: f64,
    },
    /// A coordinate of a base joint or of the tool is not finite or beyond any machine.
    #[error("{what}: {offset_m} m is not within +-{OFFSET_LIMIT_M} m")]
    Offset {
        /// Point of the coordinate.
        what: &'static str,
        /// The refused coordinate.
        offset_m: f64,
    },
    /// The tool point lies on the elbow of the link that holds it, so the distal link cannot move it.
    #[error("the tool point lies {distance_m} m from the {chain} elbow; it needs {} m", LENGTH_RANGE_M.start())]
    ToolOnElbow {
        /// Chain of that elbow.
        chain: Chain,
        /// Distance from elbow to tool point.
        distance_m: f64,
    },
    /// At no pair of angles do the distal links meet.
    #[error(
        "the loop never closes: elbows {nearest_m} to {farthest_m} m apart, \
         distal links meet at {shortest_m} to {longest_m} m"
    )]
    NeverCloses {
        /// Smallest distance that the elbows can have.
        nearest_m: f64,
        /// Largest distance that the elbows can have.
        farthest_m: f64,
        /// Difference of the distal lengths.
        shortest_m: f64,
        /// Sum of the distal lengths.
        longest_m: f64,
    },
    /// A mass or an inertia is negative or not finite, or nothing gives a motor inertia.
    #[error("{what}: {value} is not a mass or inertia of a machine")]
    Mass {
        /// Name of the parameter.
        what: &'static str,
        /// The refused value.
        value: f64,
    },
}

impl Geometry {
    /// Lengths in range, coordinates finite, tool off the elbow, loop closable.
    pub(super) fn check(&self) -> Result<(), GeometryError> {
        for chain in Chain::BOTH {
            let i = chain.index();
            for (link, length_m) in [("proximal", self.proximal_m[i]), ("distal", self.distal_m[i])] {
                if !LENGTH_RANGE_M.contains(&length_m) {
                    return Err(GeometryError::Length { chain, link, length_m });
                }
            }
        }
        let [left, right] = self.base_m;
        let offsets = [
            ("left base joint", left[0]),
            ("left base joint", left[1]),
            ("right base joint", right[0]),
            ("right base joint", right[1]),
            ("tool along", self.tool.along_m),
            ("tool across", self.tool.across_m),
        ];
        for (what, offset_m) in offsets {
            if !(-OFFSET_LIMIT_M..=OFFSET_LIMIT_M).contains(&offset_m) {
                return Err(GeometryError::Offset { what, offset_m });
            }
        }
        let chain = self.tool.fixed_to;
        let distance_m = elementary::hypot(self.distal_m[chain.index()] + self.tool.along_m, self.tool.across_m);
        if distance_m < *LENGTH_RANGE_M.start() {
            return Err(GeometryError::ToolOnElbow { chain, distance_m });
        }
        self.check_closable()
    }

    fn check_closable(&self) -> Result<(), GeometryError> {
        let [left, right] = self.base_m;
        let base = elementary::hypot(right[0] - left[0], right[1] - left[1]);
        let [a, b] = self.proximal_m;
        let [c, d] = self.distal_m;
        let farthest_m = base + a + b;
        let nearest_m = (base - a - b).max((a - b).abs() - base).max(0.0);
        let (shortest_m, longest_m) = ((c - d).abs(), c + d);
        if nearest_m < longest_m && farthest_m > shortest_m {
            Ok(())
        } else {
            Err(GeometryError::NeverCloses { nearest_m, farthest_m, shortest_m, longest_m })
        }
    }
}
