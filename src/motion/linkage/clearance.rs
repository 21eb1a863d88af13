use super::complex::Complex;
use super::error::LinkageError;
use super::five_bar::FiveBar;
use super::geometry::Chain;
use super::posture::Posture;
use super::singularity::Singularity;
use crate::elementary;
use crate::quantity::TipPoint;
use std::f64::consts::TAU;
use thiserror::Error;

/// Rings of the disc check, the outermost on its edge.
const DISC_RINGS: u32 = 16;
/// Points on each ring of the disc check.
const DISC_SPOKES: u32 = 96;

/// Distance of a posture from each singularity, in m, never negative except by rounding.
///
/// The point that a chain carries is the tool point for the chain that holds the tool and the wrist for the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// Type 1, per chain: length of the stretched chain less the distance from base joint to carried point. It is the
    /// shortest way of that point to where the chain is stretched.
    pub stretched_m: [f64; 2],
    /// Type 1, per chain: distance from base joint to carried point less the length of the folded chain. It is the
    /// shortest way of that point to where the chain is folded.
    pub folded_m: [f64; 2],
    /// Type 2: sum of the distal lengths less the distance between the elbows. It is how far the elbows may part, not
    /// a way of the tool: near the end the wrist is `sqrt(2 l0 l1 x / (l0 + l1))` off the line, x being this number.
    pub distal_stretched_m: f64,
    /// Type 2: distance between the elbows less the difference of the distal lengths. It is how far the elbows may
    /// approach each other.
    pub distal_folded_m: f64,
    /// Shortest way of the tool point to where the inverse has no answer because a chain does not reach. Exact for the
    /// chain that holds the tool, and for both without an offset of the tool; else to first order for the other chain.
    pub edge_m: f64,
}

impl Clearance {
    /// Returns the nearest singularity and how far it is in m; the edge only if it is nearer than what makes it.
    ///
    /// Real-time: yes.
    pub fn nearest(&self) -> (Singularity, f64) {
        let candidates = [
            (Singularity::Stretched(Chain::Left), self.stretched_m[0]),
            (Singularity::Stretched(Chain::Right), self.stretched_m[1]),
            (Singularity::Folded(Chain::Left), self.folded_m[0]),
            (Singularity::Folded(Chain::Right), self.folded_m[1]),
            (Singularity::DistalStretched, self.distal_stretched_m),
            (Singularity::DistalFolded, self.distal_folded_m),
        ];
        let start = (Singularity::WorkspaceEdge, self.edge_m);
        candidates.into_iter().fold(start, |best, next| if next.1 <= best.1 { next } else { best })
    }

    /// Returns the distance of the nearest singularity in m, as [`nearest`](Self::nearest).
    ///
    /// Real-time: yes.
    pub fn least_m(&self) -> f64 {
        let Self { stretched_m, folded_m, distal_stretched_m, distal_folded_m, edge_m } = *self;
        let of_chains = stretched_m[0].min(stretched_m[1]).min(folded_m[0].min(folded_m[1]));
        of_chains.min(distal_stretched_m.min(distal_folded_m)).min(edge_m)
    }
}

/// A point of a disc that the linkage does not reach.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("tool point ({:.4}, {:.4}) m of the working disc: {cause}", .tip.x(), .tip.y())]
pub struct DiscError {
    /// The point.
    pub tip: TipPoint,
    /// Reason why it is refused.
    #[source]
    pub cause: LinkageError,
}

impl FiveBar {
    /// Returns the distance of a posture of this linkage from each singularity.
    ///
    /// The sides of the elbows are not checked: see [`require_clearance`](Self::require_clearance).
    ///
    /// Real-time: yes.
    pub fn clearance(&self, posture: &Posture) -> Clearance {
        let tip = Complex::from(posture.tip.to_array());
        let wrist = Complex::from(posture.wrist_m);
        let [e0, e1] = posture.elbows_m.map(Complex::from);
        let reach = Chain::BOTH.map(|chain| {
            let carried = if chain == self.carrier { tip } else { wrist };
            (carried - self.base[chain.index()]).square().sqrt()
        });
        let range = Chain::BOTH.map(|chain| self.chain_range_m(chain));
        let stretched_m = [range[0].0 - reach[0], range[1].0 - reach[1]];
        let folded_m = [reach[0] - range[0].1, reach[1] - range[1].1];
        let (longest, shortest) = self.distal_range_m();
        let elbows = (e1 - e0).square().sqrt();
        let (h, f) = (self.carrier.index(), self.carrier.other().index());
        let free = stretched_m[f].min(folded_m[f]);
        // `min` leaves out a way that is not a number.
        let edge_m = stretched_m[h].min(folded_m[h]).min(self.tool_way(posture, free));
        Clearance {
            stretched_m,
            folded_m,
            distal_stretched_m: longest - elbows,
            distal_folded_m: elbows - shortest,
            edge_m,
        }
    }

    /// Returns the way of the tool point, to first order, along which the reach of the chain without the tool changes by `gap_m`.
    /// Infinite or not a number where the reach does not change.
    fn tool_way(&self, posture: &Posture, gap_m: f64) -> f64 {
        if self.wrist_ratio == Complex::new(1.0, 0.0) {
            return gap_m;
        }
        let (h, f) = (self.carrier.index(), self.carrier.other().index());
        let elbow = Complex::from(posture.elbows_m[h]);
        let carried = Complex::from(posture.tip.to_array()) - elbow;
        let crank = (elbow - self.base[h]).left();
        let reach = Complex::from(posture.wrist_m) - self.base[f];
        let length = reach.square().sqrt();
        if length <= 0.0 {
            // On the base joint the reach has no gradient.
            return gap_m;
        }
        // A shift p of the tool turns the crank by carried.p / carried.crank and shifts the wrist by
        // p w + crank (1 - w) times that angle, with w = 1 / tool_ratio. The gradient of the reach times lever:
        let w = self.wrist_ratio;
        let lever = carried.dot(crank);
        let conjugate = Complex::new(w.re, -w.im);
        let along = crank * Complex::new(1.0 - w.re, -w.im);
        let gradient = (reach * conjugate).scale(lever) + carried.scale(along.dot(reach));
        gap_m * lever.abs() * length / gradient.square().sqrt()
    }

    /// Returns the clearance of a posture, if both elbows lie on their sides and nothing is nearer than `margin_m`.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// An elbow on the other side, or the nearest singularity if it is nearer than the margin or the margin is not a
    /// number.
    pub fn require_clearance(&self, posture: &Posture, margin_m: f64) -> Result<Clearance, LinkageError> {
        for chain in Chain::BOTH {
            let side = posture.elbow_sides[chain.index()];
            if side != self.geometry.elbows[chain.index()] {
                return Err(LinkageError::OtherElbow { chain, side });
            }
        }
        let clearance = self.clearance(posture);
        let (singularity, clearance_m) = clearance.nearest();
        if clearance_m >= margin_m {
            Ok(clearance)
        } else {
            Err(LinkageError::NearSingularity { singularity, clearance_m, margin_m })
        }
    }

    /// Checks that the tool reaches a disc with at least `margin_m` of clearance, for use when a rig is loaded.
    ///
    /// It samples the centre and 16 rings of 96 points up to the edge. Between samples, at most `0.05 radius_m` from
    /// one, a clearance of a chain can be smaller than the margin by that way.
    ///
    /// # Errors
    /// The first point that is refused, with the reason; a radius or margin that is negative or not finite.
    pub fn reaches_disc(&self, center: TipPoint, radius_m: f64, margin_m: f64) -> Result<(), DiscError> {
        let usable = |value: f64| value.is_finite() && value >= 0.0;
        if !usable(radius_m) || !usable(margin_m) {
            let cause = LinkageError::NotFinite { what: "radius and margin in m", values: [radius_m, margin_m] };
            return Err(DiscError { tip: center, cause });
        }
        let check = |tip: TipPoint| {
            self.inverse(tip)
                .and_then(|angles| self.forward(angles))
                .and_then(|posture| self.require_clearance(&posture, margin_m))
                .map_err(|cause| DiscError { tip, cause })
        };
        check(center)?;
        for ring in 1..=DISC_RINGS {
            let radius = radius_m * f64::from(ring) / f64::from(DISC_RINGS);
            for spoke in 0..DISC_SPOKES {
                let (sine, cosine) = elementary::sin_cos(TAU * f64::from(spoke) / f64::from(DISC_SPOKES));
                check(TipPoint::new(center.x() + radius * cosine, center.y() + radius * sine))?;
            }
        }
        Ok(())
    }
}
