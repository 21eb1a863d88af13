use super::complex::Complex;
use super::error::{LinkageError, finite};
use super::geometry::{Chain, Geometry, GeometryError, Side};
use super::posture::{Posture, matrix};
use crate::elementary;
use crate::quantity::{JointAngles, TipPoint};
use nalgebra::UnitComplex;
use std::f64::consts::TAU;

/// Sine of the angle between the distal links below which the posture counts as singular of type 2. There the
/// Jacobian is a million times that of a good posture, and rounding alone moves the wrist by a micrometre.
pub const LEAST_SINE: f64 = 1e-6;

/// Joint angles beyond this are refused: their rounding would exceed 1e-10 rad.
pub const ANGLE_LIMIT_RAD: f64 = 1e6;

/// A checked five-bar with what its equations need computed once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FiveBar {
    pub(super) geometry: Geometry,
    pub(super) base: [Complex; 2],
    /// Triangle base joint, elbow, carried point of each chain.
    chains: [Triangle; 2],
    /// Triangle left elbow, wrist, right elbow.
    distal: Triangle,
    /// Least `|d0 x d1|` of the distal vectors, [`LEAST_SINE`] times both lengths.
    least_cross: f64,
    pub(super) carrier: Chain,
    /// Elbow -> tool point over elbow -> wrist on the link that holds the tool. One without an offset.
    pub(super) tool_ratio: Complex,
    pub(super) wrist_ratio: Complex,
    /// One over the lengths of the distal links.
    per_distal_m: [f64; 2],
}

/// The loop closed at a pair of joint angles: where its links are, which kinematics and dynamics share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closure {
    pub(super) angles: JointAngles,
    /// Base joint -> elbow.
    pub(super) proximal: [Complex; 2],
    pub(super) elbow: [Complex; 2],
    /// Elbow -> wrist.
    pub(super) distal: [Complex; 2],
    /// Cross product of the distal vectors, left x right.
    cross: f64,
}

/// Motion of a closed loop's wrist with the joints.
pub(super) struct Transmission {
    /// `x = dual[0] r[0] + dual[1] r[1]` solves `distal[i] . x = r[i]`.
    pub(super) dual: [Complex; 2],
    /// Wrist velocity per joint rate.
    pub(super) wrist_column: [Complex; 2],
}

impl Closure {
    /// Returns the joint angles.
    pub fn angles(&self) -> JointAngles {
        self.angles
    }

    /// With an angle that is not finite, as after a bit flip.
    #[cfg(test)]
    pub fn at_no_angle(self) -> Self {
        Self { angles: JointAngles::new(f64::NAN, self.angles.right()), ..self }
    }

    #[inline]
    pub(super) fn transmission(&self) -> Transmission {
        let Self { proximal, distal, .. } = self;
        let per_cross = 1.0 / self.cross;
        let dual = [distal[1].left().scale(-per_cross), distal[0].left().scale(per_cross)];
        let wrist_column = [dual[0].scale(proximal[0].cross(distal[0])), dual[1].scale(proximal[1].cross(distal[1]))];
        Transmission { dual, wrist_column }
    }
}

/// Two sides of a triangle, which say how the third point lies against the base between the first two.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Triangle {
    longest: f64,
    shortest: f64,
    longest_square: f64,
    shortest_square: f64,
    /// Difference of the squares, first minus second.
    difference: f64,
    /// +1: the third point lies to the left of first -> second.
    sign: f64,
}

impl Triangle {
    fn new(first: f64, second: f64, sign: f64) -> Self {
        let (longest, shortest) = (first + second, (first - second).abs());
        Self {
            longest,
            shortest,
            longest_square: longest * longest,
            shortest_square: shortest * shortest,
            difference: (first - second) * longest,
            sign,
        }
    }

    /// Sixteen times the squared area over a base of this squared length, negative if the sides do not meet. Written
    /// with the two factors that vanish at the ends, which keeps their full precision there.
    #[inline]
    fn area(&self, base_square: f64) -> f64 {
        (self.longest_square - base_square) * (base_square - self.shortest_square)
    }

    /// Returns the first -> third point over first -> second point, and twice the signed area.
    #[inline]
    fn apex(&self, base_square: f64, area: f64) -> (Complex, f64) {
        let per_square = 1.0 / base_square;
        let cross = 0.5 * self.sign * area.sqrt();
        (Complex::new(0.5 * (1.0 + self.difference * per_square), cross * per_square), cross)
    }
}

impl FiveBar {
    /// Checks the parameters.
    ///
    /// # Errors
    /// A length or coordinate out of range, a tool point on an elbow, or a loop that closes at no pair of angles.
    pub fn new(geometry: Geometry) -> Result<Self, GeometryError> {
        geometry.check()?;
        let [l0, l1] = geometry.distal_m;
        let carrier = geometry.tool.fixed_to;
        let held = geometry.distal_m[carrier.index()];
        let tool_ratio = Complex::new(1.0 + geometry.tool.along_m / held, geometry.tool.across_m / held);
        let mut carried = geometry.distal_m;
        carried[carrier.index()] = elementary::hypot(held + geometry.tool.along_m, geometry.tool.across_m);
        let chain = |i: usize| Triangle::new(geometry.proximal_m[i], carried[i], geometry.elbows[i].sign());
        Ok(Self {
            geometry,
            base: geometry.base_m.map(Complex::from),
            chains: [chain(0), chain(1)],
            // Seen from left to right elbow, a wrist to the left has a positive cross product of the distal vectors.
            distal: Triangle::new(l0, l1, geometry.wrist.sign()),
            least_cross: LEAST_SINE * l0 * l1,
            carrier,
            tool_ratio,
            wrist_ratio: tool_ratio.inverse(),
            per_distal_m: [1.0 / l0, 1.0 / l1],
        })
    }

    /// Returns the parameters that this linkage was made from.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Returns the joint angles, each within (-pi, pi], that hold the tool point at `tip` in this working and assembly mode.
    ///
    /// The edge of the workspace (a chain exactly stretched or folded) still has an answer, except where a chain with equal links folds
    /// onto its base joint.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// The error names the chain that cannot reach, and by how much. The function also refuses a type 2 singularity, a solution that
    /// belongs to the other assembly mode, and numbers that are not finite.
    pub fn inverse(&self, tip: TipPoint) -> Result<JointAngles, LinkageError> {
        self.close_at(tip).map(|closure| closure.angles)
    }

    /// Returns the loop closed so that the tool point is at `tip`.
    fn close_at(&self, tip: TipPoint) -> Result<Closure, LinkageError> {
        if !tip.is_finite() {
            return Err(LinkageError::NotFinite { what: "tool point in m", values: tip.to_array() });
        }
        let tip = Complex::from(tip.to_array());
        let (held, free) = (self.carrier, self.carrier.other());
        let mut proximal = [Complex::default(); 2];
        let mut distal = [Complex::default(); 2];
        let (h, f) = (held.index(), free.index());
        let mut elbow = [Complex::default(); 2];
        proximal[h] = self.reach(held, tip)?;
        elbow[h] = self.base[h] + proximal[h];
        distal[h] = (tip - elbow[h]) * self.wrist_ratio;
        let wrist = elbow[h] + distal[h];
        proximal[f] = self.reach(free, wrist)?;
        elbow[f] = self.base[f] + proximal[f];
        distal[f] = wrist - elbow[f];
        let cross = self.check_assembly(distal)?;
        let angles = JointAngles::new(proximal[0].angle_rad(), proximal[1].angle_rad());
        Ok(Closure { angles, proximal, elbow, distal, cross })
    }

    /// [`inverse`](Self::inverse) with each angle moved by whole turns to within half a turn of `near`: fed with the
    /// previous result, the angles are continuous along a path.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// As [`inverse`](Self::inverse); also if `near` is not within [`ANGLE_LIMIT_RAD`].
    pub fn inverse_near(&self, tip: TipPoint, near: JointAngles) -> Result<JointAngles, LinkageError> {
        self.close_near(tip, near).map(|closure| closure.angles)
    }

    /// [`inverse_near`](Self::inverse_near) with the loop that it closes, for [`posture`](Self::posture) and
    /// [`dynamics_of`](Self::dynamics_of), which need no sine then.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// As [`inverse_near`](Self::inverse_near).
    pub fn close_near(&self, tip: TipPoint, near: JointAngles) -> Result<Closure, LinkageError> {
        check_angles(near)?;
        let mut closure = self.close_at(tip)?;
        let turns = ((near - closure.angles) / TAU).map(f64::round);
        closure.angles += turns * TAU;
        Ok(closure)
    }

    /// Returns the complete posture at a pair of joint angles. The elbows may lie on other sides than the working mode says;
    /// [`Posture::elbow_sides`] has the actual sides.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// Where the distal links do not meet, or lie on one line to within [`LEAST_SINE`] (type 2, by kind); angles that
    /// are not within [`ANGLE_LIMIT_RAD`].
    pub fn forward(&self, angles: JointAngles) -> Result<Posture, LinkageError> {
        self.close(angles).map(|closure| self.posture(&closure))
    }

    /// Everything about the posture of a closed loop.
    ///
    /// Real-time: yes.
    pub fn posture(&self, closure: &Closure) -> Posture {
        let tip = self.tip(closure);
        let wrist = closure.elbow[0] + closure.distal[0];
        let side = |chain: Chain| {
            let i = chain.index();
            let carried = if chain == self.carrier { tip } else { wrist };
            let left = (carried - self.base[i]).cross(closure.proximal[i]) >= 0.0;
            if left { Side::Left } else { Side::Right }
        };
        let distal_rotation = Chain::BOTH.map(|chain| {
            let i = chain.index();
            let Complex { re, im } = closure.distal[i].scale(self.per_distal_m[i]);
            UnitComplex::from_cos_sin_unchecked(re, im)
        });
        Posture {
            angles: closure.angles,
            tip: tip.to_array().into(),
            wrist_m: wrist.to_array(),
            elbows_m: closure.elbow.map(Complex::to_array),
            distal_rotation,
            elbow_sides: Chain::BOTH.map(side),
            jacobian: matrix(self.tip_columns(closure, &closure.transmission())),
        }
    }

    /// Base joint -> elbow of a chain that carries `point`.
    fn reach(&self, chain: Chain, point: Complex) -> Result<Complex, LinkageError> {
        let triangle = &self.chains[chain.index()];
        let base = point - self.base[chain.index()];
        let square = base.square();
        // With equal links the folded chain leaves the angle open at its base joint.
        let shortest_m = triangle.shortest.max(LEAST_SINE * triangle.longest);
        let area = triangle.area(square);
        if square > triangle.longest_square {
            let distance_m = finite(base.length());
            return Err(LinkageError::OutOfReach { chain, distance_m, longest_m: triangle.longest });
        }
        if area < 0.0 || square < shortest_m * shortest_m {
            return Err(LinkageError::TooClose { chain, distance_m: base.length(), shortest_m });
        }
        Ok(base * triangle.apex(square, area).0)
    }

    /// Returns the cross product of these distal vectors, if they belong to this assembly mode.
    fn check_assembly(&self, distal: [Complex; 2]) -> Result<f64, LinkageError> {
        let cross = distal[0].cross(distal[1]);
        if cross.abs() < self.least_cross {
            return Err(self.type_2(distal[0] - distal[1]));
        }
        if cross * self.distal.sign < 0.0 {
            return Err(LinkageError::OtherAssembly { wrist_offset_m: cross / (distal[0] - distal[1]).length() });
        }
        Ok(cross)
    }

    /// Returns the kind of type 2 singularity at this vector from left to right elbow.
    #[cold]
    fn type_2(&self, elbows: Complex) -> LinkageError {
        let elbow_distance_m = elbows.length();
        let Triangle { longest, shortest, .. } = self.distal;
        if longest - elbow_distance_m < elbow_distance_m - shortest {
            LinkageError::DistalStretched { elbow_distance_m, longest_m: longest }
        } else {
            LinkageError::DistalFolded { elbow_distance_m, shortest_m: shortest }
        }
    }

    /// Closes the loop at a pair of joint angles. One sine and cosine per joint, one square root, one division.
    ///
    /// Real-time: yes.
    ///
    /// # Errors
    /// As [`forward`](Self::forward).
    #[inline(always)]
    pub fn close(&self, angles: JointAngles) -> Result<Closure, LinkageError> {
        check_angles(angles)?;
        let [l0, l1] = self.geometry.proximal_m;
        let proximal = [Complex::polar(l0, angles.left()), Complex::polar(l1, angles.right())];
        let elbow = [self.base[0] + proximal[0], self.base[1] + proximal[1]];
        let elbows = elbow[1] - elbow[0];
        let square = elbows.square();
        let area = self.distal.area(square);
        // The area is four times the squared cross product of the distal vectors.
        if area < 4.0 * self.least_cross * self.least_cross {
            return Err(self.type_2(elbows));
        }
        let (apex, cross) = self.distal.apex(square, area);
        let first = elbows * apex;
        Ok(Closure { angles, proximal, elbow, distal: [first, first - elbows], cross })
    }

    /// Tool point of a closed loop.
    #[inline]
    pub(super) fn tip(&self, closure: &Closure) -> Complex {
        let i = self.carrier.index();
        closure.elbow[i] + self.tool_ratio * closure.distal[i]
    }

    /// Returns a quantity (velocity, acceleration) of the tool point, which is linear in those of wrist and elbow.
    #[inline]
    pub(super) fn at_tip(&self, wrist: Complex, elbow: Complex) -> Complex {
        elbow + self.tool_ratio * (wrist - elbow)
    }

    /// Tool velocity per joint rate.
    #[inline]
    pub(super) fn tip_columns(&self, closure: &Closure, transmission: &Transmission) -> [Complex; 2] {
        let i = self.carrier.index();
        let mut elbow = [Complex::default(); 2];
        elbow[i] = closure.proximal[i].left();
        let [left, right] = transmission.wrist_column;
        [self.at_tip(left, elbow[0]), self.at_tip(right, elbow[1])]
    }

    /// Returns the longest and shortest distance between base joint and carried point of each chain, in m.
    pub(super) fn chain_range_m(&self, chain: Chain) -> (f64, f64) {
        let triangle = &self.chains[chain.index()];
        (triangle.longest, triangle.shortest)
    }

    /// Returns the longest and shortest distance between the elbows, in m.
    pub(super) fn distal_range_m(&self) -> (f64, f64) {
        (self.distal.longest, self.distal.shortest)
    }
}

#[inline]
fn check_angles(angles: JointAngles) -> Result<(), LinkageError> {
    let [first, second] = angles.to_array();
    if first.abs() <= ANGLE_LIMIT_RAD && second.abs() <= ANGLE_LIMIT_RAD {
        Ok(())
    } else {
        Err(LinkageError::NotFinite { what: "joint angles in rad", values: [first, second] })
    }
}
