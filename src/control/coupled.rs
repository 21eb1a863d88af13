//! Stability of an admittance fixture whose tool is held by a hand or an environment: the least virtual mass.
//!
//! ```text
//!          hand force h                                proxy q
//! tool ---> delay, sensor hold, low pass ---> M q'' + b q' = h ---> position servo ---> arm with hand ---> tool
//! ```
//! With `(1 - 1/z)/T` for the derivative, as the fixture computes it, the loop closes where
//! `M ((1 - 1/z)/T)^2 v = -(H(z) + b (1 - 1/z)/T) v` for some direction `v`; `H` is the 2x2 response from the proxy to
//! the force that the fixture is given, with its sign turned. On `z = exp(j w T)` the virtual masses at the edge of
//! stability are the real positive eigenvalues of `-(H + b (1 - 1/z)/T) (T/(1 - 1/z))^2`. Above the greatest of them every
//! mass is stable, if a mass without bound is.

use std::f64::consts::{PI, TAU};

use nalgebra::{Complex, DMatrix, Matrix2, Matrix2x4, Matrix4, Matrix4x2, SMatrix, Schur};

use super::error::{ControlError, not_negative, positive};
use super::{Gains, MAX_DELAY_CYCLES, ServoLoop, principal_inertias};

/// Points of the frequency grid on which crossovers are looked for, evenly in the logarithm.
const GRID_POINTS: usize = 400;
/// Lowest frequency of the grid in rad/s. A mass at the edge of stability there would weigh 100 times the stiffness.
const LOWEST_RAD_PER_S: f64 = 0.1;
/// Halvings of a grid interval when a crossover is refined.
const BISECTIONS: usize = 40;
/// Iterations within which the eigenvalues of a small matrix are found.
const SCHUR_ITERATIONS: usize = 10_000;

/// A pose of the arm in the coordinates in which its controllers act: joints, or the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Mass matrix in kg m^2, or kg.
    pub mass: Matrix2<f64>,
    /// Viscous friction in N m s/rad, or N s/m.
    pub viscous: Matrix2<f64>,
    /// Tool velocity per rate: m/rad, or the identity.
    pub jacobian: Matrix2<f64>,
    /// Inertia feed-forward: effort per acceleration of the set-point, as `mass`; zero for none.
    pub forward_mass: Matrix2<f64>,
    /// Viscous feed-forward: effort per rate of the set-point, as `viscous`; zero for none.
    pub forward_viscous: Matrix2<f64>,
}

/// Who holds the tool: a mass at the tool, beyond the force sensor, with a spring and a damper to a point at rest, the same
/// in all directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// `K_h` in N/m, positive.
    pub stiffness_n_per_m: f64,
    /// `B_h` in N s/m, not negative.
    pub damping_n_s_per_m: f64,
    /// Mass in kg, not negative.
    pub mass_kg: f64,
}

/// The way from the hand's force to the set-point of the servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outer {
    /// Sampling interval `T` of the fixture in s, not shorter than the servo's own.
    pub period_s: f64,
    /// Cycles from the moment of a force sample to the servo's having the set-point, 0 to [`MAX_DELAY_CYCLES`]. The
    /// servo's own delay is not part of it. A servo that is faster than the fixture and holds each set-point adds half a
    /// cycle, one that draws a line from the last set-point to the next a whole one.
    pub delay_cycles: f64,
    /// Cycles for which each sample of a slow sensor is held, 1 for a new one in every cycle.
    pub sample_cycles: u32,
    /// Cut-off of the first-order low pass of the samples in Hz, if any.
    pub low_pass_hz: Option<f64>,
    /// Damping `b` of the proxy in N s/m.
    pub damping_n_s_per_m: f64,
}

impl Outer {
    fn checked(&self) -> Result<&Self, ControlError> {
        positive("period", self.period_s)?;
        not_negative("delay in cycles", self.delay_cycles)?;
        not_negative("damping of the proxy", self.damping_n_s_per_m)?;
        if let Some(cut_off_hz) = self.low_pass_hz {
            positive("low-pass cut-off", cut_off_hz)?;
        }
        let within = |name, value: f64, most: f64, requirement| {
            if value <= most { Ok(()) } else { Err(ControlError::OutOfRange { name, value, requirement }) }
        };
        within("delay in cycles", self.delay_cycles, MAX_DELAY_CYCLES, "at most MAX_DELAY_CYCLES")?;
        let held = f64::from(self.sample_cycles);
        within("cycles between samples", held, 1000.0, "1 to 1000")?;
        within("cycles between samples", -held, -1.0, "1 to 1000").map(|()| self)
    }

    /// `1 - alpha` of the low pass, `y += alpha (x - y)`.
    fn remembered(&self) -> f64 {
        let interval_s = f64::from(self.sample_cycles) * self.period_s;
        self.low_pass_hz.map_or(0.0, |cut_off_hz| (-TAU * cut_off_hz * interval_s).exp())
    }

    /// Delay, hold and low pass at the angular frequency `w`. What a slow sensor folds down from above its own Nyquist
    /// frequency is left out.
    fn response(&self, w: f64) -> Complex<f64> {
        let half = 0.5 * w * self.period_s;
        let held = f64::from(self.sample_cycles);
        let hold = (held * half).sin() / (held * half.sin());
        let lag = 2.0 * half * (self.delay_cycles + 0.5 * (held - 1.0));
        let kept = self.remembered();
        let low_pass = (Complex::from(1.0) - Complex::from_polar(kept, -2.0 * half * held)).inv() * (1.0 - kept);
        Complex::from_polar(hold, -lag) * low_pass
    }
}

/// Lag of the loop at low frequencies in s: in slow motion the tool comes that much later than a mass would. Zero or less
/// leaves the hand its own damping; above `B_h/K_h` no virtual mass at all is stable.
///
/// Delay and hold of the force and its low pass, less one cycle (the fixture steps with the force of the same step), and the
/// viscous friction of the joints where no integral makes up for it. The hold of the servo's own efforts is not in it: a servo
/// follows slow motion without lag. A hand that is stiff against the servo sees less lag, since the servo gives way.
///
/// # Errors
/// [`ControlError::OutOfRange`] for what is not finite or outside its range.
pub fn lag_s(servo: &ServoLoop, pose: &Pose, outer: &Outer) -> Result<f64, ControlError> {
    let Outer { period_s, delay_cycles, sample_cycles, .. } = *outer.checked()?;
    let Gains { stiffness, integral, .. } = servo.gains.checked()?;
    let held = f64::from(sample_cycles);
    let kept = outer.remembered();
    let drag_s = if integral > 0.0 { 0.0 } else { pose.viscous.symmetric_eigenvalues().max() / stiffness };
    Ok(period_s * (delay_cycles + 0.5 * (held - 1.0) - 1.0 + held * kept / (1.0 - kept)) + drag_s)
}

/// The mass in kg below which no virtual mass is passive for every hand: the arm's own at the tool in its heaviest
/// direction. Delays ask for more, so this says what cannot be had, not what can.
///
/// # Errors
/// [`ControlError::NotPositiveDefinite`] for a mass matrix that is none, [`ControlError::OutOfRange`] for a singular
/// Jacobian.
///
/// # Source
/// Derived for a continuous servo without viscous friction: with `G = 1 - J s^2 D` and the compliance `D` of the servo, the
/// real part of `s (G/(M s^2) + D)` is not negative from `M = J` on. Keemink, van der Kooij, Stienen, *Admittance control
/// for physical human-robot interaction* (2018), has the same limit for a velocity servo of high gain.
pub fn passive_mass_kg(pose: &Pose) -> Result<f64, ControlError> {
    let inverse = inverse_jacobian(pose)?;
    Ok(principal_inertias(&(inverse.transpose() * pose.mass * inverse))?[1])
}

/// The least virtual mass in kg from which on the loop is stable with this hand; infinity if no mass is stable.
///
/// Exact for rigid joints without dry friction, efforts without limit and a force sampled in every interval of the servo. A servo with a
/// shorter interval, as within a drive, is taken at its own interval, and a slow sensor by its mean; both leave out what
/// is folded down from above the Nyquist frequency. Dry friction is left out: it stops some loops that are unstable, and
/// makes others hunt.
///
/// # Errors
/// [`ControlError::OutOfRange`] for what is not finite or outside its range; [`ControlError::NotPositiveDefinite`] for a
/// mass matrix or a Jacobian that is none.
///
/// # Source
/// Derived; for one direction, a continuous servo `G` that holds its set-points and a hand that does not load it, it is the
/// greatest `|K_h + j w B_h| |G(j w)| / (2/T sin(w T/2))^2` over the crossovers of the phase with the lag `(d - 1/2) T`.
pub fn least_virtual_mass_kg(servo: &ServoLoop, pose: &Pose, grip: &Grip, outer: &Outer) -> Result<f64, ControlError> {
    Held::new(servo, pose, grip, outer, 1.0)?.least_mass_kg()
}

/// Arm with hand under its servo, as the fixture sees them.
struct Held<'a> {
    servo: ServoLoop,
    outer: &'a Outer,
    grip: &'a Grip,
    jacobian: Matrix2<f64>,
    inverse: Matrix2<f64>,
    /// Positions and rates one interval later, without effort and by an effort new or old within the interval.
    free: Matrix4<f64>,
    new: Matrix4x2<f64>,
    old: Matrix4x2<f64>,
    whole_delay: usize,
    /// Accelerations by positions and rates, and by the effort that acts.
    acceleration: Matrix2x4<f64>,
    mobility: Matrix2<f64>,
    forward_mass: Matrix2<f64>,
    forward_viscous: Matrix2<f64>,
}

impl<'a> Held<'a> {
    /// `load` is the share of the hand's spring and damper that the arm feels, 1 but for tests.
    fn new(servo: &ServoLoop, pose: &Pose, grip: &'a Grip, outer: &'a Outer, load: f64) -> Result<Self, ControlError> {
        servo.gains.checked()?;
        positive("servo period", servo.period_s)?;
        let delay = not_negative("delay in cycles", servo.delay_cycles)?;
        if delay > MAX_DELAY_CYCLES {
            let requirement = "at most MAX_DELAY_CYCLES";
            return Err(ControlError::OutOfRange { name: "delay in cycles", value: delay, requirement });
        }
        positive("stiffness of the hand", grip.stiffness_n_per_m)?;
        not_negative("damping of the hand", grip.damping_n_s_per_m)?;
        not_negative("mass of the hand", grip.mass_kg)?;
        principal_inertias(&pose.mass)?;
        let outer = outer.checked()?;
        let inverse = inverse_jacobian(pose)?;
        let weight = pose.jacobian.tr_mul(&pose.jacobian) * load;
        let mass = pose.mass + weight * grip.mass_kg;
        let mobility = mass.try_inverse().ok_or(ControlError::NotPositiveDefinite { least: 0.0, asymmetry: 0.0 })?;
        let mut rate = SMatrix::<f64, 6, 6>::zeros();
        rate.fixed_view_mut::<2, 2>(0, 2).copy_from(&Matrix2::identity());
        rate.fixed_view_mut::<2, 2>(2, 0).copy_from(&(-mobility * weight * grip.stiffness_n_per_m));
        let damping = pose.viscous + weight * grip.damping_n_s_per_m;
        rate.fixed_view_mut::<2, 2>(2, 2).copy_from(&(-mobility * damping));
        rate.fixed_view_mut::<2, 2>(2, 4).copy_from(&mobility);
        let over = |time_s: f64| (rate * time_s).exp();
        let whole = over(servo.period_s);
        let late = over((1.0 - delay.fract()) * servo.period_s);
        let new: Matrix4x2<f64> = late.fixed_view::<4, 2>(0, 4).into_owned();
        Ok(Self {
            servo: *servo,
            outer,
            grip,
            jacobian: pose.jacobian,
            inverse,
            free: whole.fixed_view::<4, 4>(0, 0).into_owned(),
            new,
            old: whole.fixed_view::<4, 2>(0, 4).into_owned() - new,
            whole_delay: delay.trunc() as usize,
            acceleration: rate.fixed_view::<2, 4>(2, 0).into_owned(),
            mobility,
            forward_mass: pose.forward_mass,
            forward_viscous: pose.forward_viscous,
        })
    }

    fn least_mass_kg(&self) -> Result<f64, ControlError> {
        let nyquist = PI / self.outer.period_s;
        let mut before = self.edge_masses(LOWEST_RAD_PER_S);
        // A mass without bound turns slowly; there the hand's damping has to be ahead of the lag.
        if !self.is_servo_stable() || !before.iter().all(|mass| mass.im >= 0.0) {
            return Ok(f64::INFINITY);
        }
        let at = |i: usize| LOWEST_RAD_PER_S * (nyquist / LOWEST_RAD_PER_S).powf(i as f64 / GRID_POINTS as f64);
        let mut least: f64 = 0.0;
        for i in 1..=GRID_POINTS {
            let next = nearest_first(self.edge_masses(at(i)), before);
            for direction in 0..2 {
                let (from, to) = (before[direction], next[direction]);
                // At the Nyquist frequency itself both are real.
                if (from.im < 0.0) != (to.im < 0.0) || i == GRID_POINTS {
                    least = least.max(self.crossover(at(i - 1), at(i), from, to));
                }
            }
            before = next;
        }
        Ok(least)
    }

    /// The complex masses that would close the loop at `w`; where one is real and positive it is at the edge.
    fn edge_masses(&self, w: f64) -> [Complex<f64>; 2] {
        let force = self.force_per_proxy(w);
        let turn = w * self.outer.period_s;
        // (1 - 1/z)/T without cancellation.
        let rate = Complex::new(2.0 * (0.5 * turn).sin().powi(2), turn.sin()) / self.outer.period_s;
        eigenvalues(&force).map(|stiffness| -(stiffness + rate * self.outer.damping_n_s_per_m) / (rate * rate))
    }

    /// `H`, in N/m.
    fn force_per_proxy(&self, w: f64) -> Matrix2<Complex<f64>> {
        let period_s = self.servo.period_s;
        let back = Complex::from_polar(1.0, -w * period_s);
        let z = back.conj();
        let complex = |x: f64| Complex::from(x);
        let delayed = Complex::from_polar(1.0, -w * period_s * self.whole_delay as f64);
        let input = self.new.map(complex) * delayed + self.old.map(complex) * (delayed * back);
        let free = Matrix4::identity() * z - self.free.map(complex);
        let motion = free.lu().solve(&input).unwrap_or_else(|| Matrix4x2::from_element(complex(f64::NAN)));
        let Gains { stiffness, damping, integral } = self.servo.gains;
        let rate = (complex(1.0) - back) / period_s;
        let law = rate * damping + stiffness + rate.inv() * integral;
        let angles = motion.fixed_rows::<2>(0) * law;
        let closed = (Matrix2::identity() + angles).try_inverse();
        let closed = closed.unwrap_or_else(|| Matrix2::from_element(complex(f64::NAN)));
        let command = Matrix2::identity() * law
            + self.forward_mass.map(complex) * (rate * rate)
            + self.forward_viscous.map(complex) * rate;
        // A sample is taken before the new effort acts.
        let acceleration = self.acceleration.map(complex) * motion + self.mobility.map(complex) * (delayed * back);
        let load = motion.fixed_rows::<2>(0) * complex(self.grip.stiffness_n_per_m)
            + motion.fixed_rows::<2>(2) * complex(self.grip.damping_n_s_per_m)
            + acceleration * complex(self.grip.mass_kg);
        let force = self.jacobian.map(complex) * load * closed * command * self.inverse.map(complex);
        force * self.outer.response(w)
    }

    /// The edge mass where the locus between two frequencies is real, or zero if it is not positive there.
    fn crossover(&self, low: f64, high: f64, from: Complex<f64>, to: Complex<f64>) -> f64 {
        let (mut low, mut high, mut from, mut to) = (low, high, from, to);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            let between = (from + to) * 0.5;
            let mass = nearest_first(self.edge_masses(middle), [between, between])[0];
            if (mass.im < 0.0) == (from.im < 0.0) {
                (low, from) = (middle, mass);
            } else {
                (high, to) = (middle, mass);
            }
        }
        to.re.max(0.0)
    }

    /// Whether servo and hand alone are stable, the proxy at rest.
    fn is_servo_stable(&self) -> bool {
        let Gains { stiffness, damping, integral } = self.servo.gains;
        let period_s = self.servo.period_s;
        // Positions, rates, errors before, sums of errors, efforts under way.
        let under_way = 2 * (self.whole_delay + 1);
        let size = 8 + under_way;
        let step = |column: usize| {
            let mut state = vec![0.0; size];
            state[column] = 1.0;
            let mut effort = [0.0; 2];
            for joint in 0..2 {
                let error = -state[joint];
                let sum = state[6 + joint] + period_s * error;
                effort[joint] = stiffness * error + damping * (error - state[4 + joint]) / period_s + integral * sum;
                (state[4 + joint], state[6 + joint]) = (error, if integral > 0.0 { sum } else { 0.0 });
            }
            let mut efforts = vec![effort[0], effort[1]];
            efforts.extend_from_slice(&state[8..]);
            let [new, old] = [self.whole_delay, self.whole_delay + 1]
                .map(|age| nalgebra::Vector2::new(efforts[2 * age], efforts[2 * age + 1]));
            let motion = nalgebra::Vector4::from_column_slice(&state[..4]);
            let motion = self.free * motion + self.new * new + self.old * old;
            state[..4].copy_from_slice(motion.as_slice());
            state[8..].copy_from_slice(&efforts[..under_way]);
            state
        };
        let columns: Vec<f64> = (0..size).flat_map(step).collect();
        let map = DMatrix::from_column_slice(size, size, &columns);
        Schur::try_new(map, f64::EPSILON, SCHUR_ITERATIONS)
            .is_some_and(|schur| schur.complex_eigenvalues().iter().all(|pole| pole.norm() < 1.0))
    }
}

fn inverse_jacobian(pose: &Pose) -> Result<Matrix2<f64>, ControlError> {
    let singular = ControlError::OutOfRange {
        name: "determinant of the Jacobian",
        value: pose.jacobian.determinant(),
        requirement: "finite and not zero",
    };
    pose.jacobian.try_inverse().filter(|inverse| inverse.iter().all(|x| x.is_finite())).ok_or(singular)
}

/// Both eigenvalues of a complex 2x2 matrix.
fn eigenvalues(matrix: &Matrix2<Complex<f64>>) -> [Complex<f64>; 2] {
    let mean = (matrix[(0, 0)] + matrix[(1, 1)]) * 0.5;
    let half = (matrix[(0, 0)] - matrix[(1, 1)]) * 0.5;
    let root = (half * half + matrix[(0, 1)] * matrix[(1, 0)]).sqrt();
    [mean + root, mean - root]
}

/// `next` in the order in which it follows `before`.
fn nearest_first(next: [Complex<f64>; 2], before: [Complex<f64>; 2]) -> [Complex<f64>; 2] {
    let way = |a: usize, b: usize| (next[a] - before[0]).norm() + (next[b] - before[1]).norm();
    // Between two equal points the first is the nearer one.
    let swapped = if before[0] == before[1] {
        (next[1] - before[0]).norm() < (next[0] - before[0]).norm()
    } else {
        way(1, 0) < way(0, 1)
    };
    if swapped { [next[1], next[0]] } else { next }
}

#[cfg(test)]
mod tests;
