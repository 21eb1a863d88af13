//! Stability of an admittance fixture whose tool is held by a hand or an environment: the virtual masses that are stable.
//!
//! ```text
//!          hand force                                   reference r
//! tool ---> sensor ---> low pass, hold ---> M r'' + b r' = h ---> position servo ---> arm with hand ---> tool
//! ```
//! # The loop, lifted to one common period
//! At a fixed pose the motion between two events is linear and known in closed form. The module follows the loop event by event, with no
//! approximation of a delay or a hold. In one cycle of length `T`, counted from SYNC:
//!
//! 1. *Sensor.* The sensor takes the force of the hand less that of the handle, `-(K_h y + B_h y' + (m_h + m_H) y'')` at the tool, at
//!    moments of its own clock. A sensor that SYNC clocks takes the sample at SYNC, before the new effort acts.
//! 3. *Computation.* If the newest sample that has come is new, two forces are added. The first is the force that the reference's
//!    acceleration needs for the handle, `m_H (r1 - 2 r2 + r3)/T^2`. The second is the force of a [`Compensation`] by the encoders. The sum
//!    passes the low pass. The fixture steps, `M (r - 2 r1 + r2)/T^2 + b (r - r1)/T = h`. A servo of the host turns `r` and the encoders of
//!    this SYNC into efforts.
//!    steps, `M (r - 2 r1 + r2)/T^2 + b (r - r1)/T = h`. A servo of the host turns `r` and the encoders of this SYNC into efforts.
//! 4. *Drive*, if the loop closes there. At SYNC, and then every period of its own, the servo samples angle and rate. It compares them with
//!    the line from the last target to the present one, and holds a torque.
//! 5. *Motion.* Between all these events, arm and hand move by `exp(A t)` under a held effort. With elastic gears motors and links do.
//!
//! The state at SYNC has these parts:
//!
//! - position and rate of the arm, and of its links behind elastic gears,
//! - the effort that acts,
//! - the three last references,
//! - the force that the fixture holds,
//! - samples that are on their way,
//! - the servo's own state (last error, sum of errors, efforts on their way; or integral and line).
//!
//! With a sensor at `N T = m T_s` the state after `N` cycles is a matrix times the state before. The loop is stable if no eigenvalue of
//! that matrix lies on or outside the unit circle. A sensor with its own clock drifts through all phases. Its loop is checked right behind
//! SYNC, where a sample has just missed its cycle, and at phases between.
//!
//! A servo that follows only the rate does not depend on the position of the reference. Its references are counted from the last one. This
//! removes their common position, an eigenvalue of one, from the state.
//!
//! # Stable masses
//! Light masses swing, since servo and delay turn the hand's spring against the motion. Very heavy masses drift if the loop lags by more
//! than `B_h/K_h` ([`lag_s`]). The stable masses lie between a least and a greatest one.

mod admittance;
mod exponential;
mod held;

pub use admittance::admittance;
pub use held::HeldLoop;

use crate::elementary;
use std::f64::consts::TAU;

use nalgebra::Matrix2;

use super::error::{ControlError, not_negative, positive};
use super::{Gains, principal_inertias};

/// A pose of the arm in the coordinates in which its controllers act: joints, or the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Mass matrix in kg m^2, or kg.
    pub mass: Matrix2<f64>,
    /// Viscous friction in N m s/rad, or N s/m.
    pub viscous: Matrix2<f64>,
    /// Tool velocity per rate: m/rad, or the identity.
    pub jacobian: Matrix2<f64>,
    /// Inertia feed-forward: effort per acceleration of the set-point, as `mass`; zero for none. Only for a servo of the host.
    pub forward_mass: Matrix2<f64>,
    /// Viscous feed-forward: effort per rate of the set-point, as `viscous`; zero for none. Only for a servo of the host.
    pub forward_viscous: Matrix2<f64>,
    /// Elastic gears; `None` for rigid joints.
    pub gears: Option<Gears>,
}

/// Elastic gears between motors and links. Efforts, encoders and viscous friction are on the motors' side, the hand is on the links'.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gears {
    /// Inertia of the motors before the springs, a part of [`Pose::mass`], in kg m^2, or kg.
    pub motor: Matrix2<f64>,
    /// Stiffness in N m/rad, or N/m.
    pub stiffness: Matrix2<f64>,
    /// Damping in N m s/rad, or N s/m.
    pub damping: Matrix2<f64>,
}

/// Grip that holds the tool: a mass at the tool, beyond the force sensor, with a spring and a damper to a point at rest, the same in all
/// directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// `K_h` in N/m, positive.
    pub stiffness_n_per_m: f64,
    /// `B_h` in N s/m, not negative.
    pub damping_n_s_per_m: f64,
    /// Mass in kg, not negative.
    pub mass_kg: f64,
}

/// Device that closes the position loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Follower {
    /// In the cycle of the fixture, with the rate of the error by differences.
    Host {
        /// Gains of PID, or of PSMC below saturation. A stiffness of zero, with an integral of zero, leaves a servo of the rate alone.
        gains: Gains,
        /// Cycles from SYNC to the change of effort that its encoders lead to, 0 to [`Follower::MOST_DELAY`], not only whole numbers.
        delay_cycles: f64,
    },
    /// The loop closes in the drives, along the line from the last target to the present one. The drives aim at a target from the SYNC
    /// after its computation on, and reach it at the SYNC after that.
    Drive {
        /// Gains of the loop, with the true rates of line and joint.
        gains: Gains,
        /// Its period in s, not above that of the fixture. It starts again at each SYNC.
        period_s: f64,
    },
    /// In the drives, on the integral of a rate. A cycle computes the rate `(r - r1)/T + k (r - encoder)`, which acts from the next SYNC on.
    Rate {
        /// Gains of the loop, with the true rate of the joint.
        gains: Gains,
        /// Its period in s, as that of [`Follower::Drive`].
        period_s: f64,
        /// `k` in 1/s, positive.
        gain_per_s: f64,
    },
}

impl Follower {
    /// Most cycles by which efforts may be late.
    pub const MOST_DELAY: f64 = 16.0;

    fn gains(&self) -> Gains {
        match self {
            Self::Host { gains, .. } | Self::Drive { gains, .. } | Self::Rate { gains, .. } => *gains,
        }
    }

    /// Whether the servo is of the host and follows the rate alone.
    fn has_no_position(&self) -> bool {
        let Self::Host { gains: Gains { stiffness, integral, .. }, .. } = *self else { return false };
        stiffness == 0.0 && integral == 0.0
    }

    /// Returns the gains, with a stiffness of zero for a servo of the host that follows the rate alone.
    fn checked(&self) -> Result<Gains, ControlError> {
        let gains = self.gains();
        if self.has_no_position() {
            return positive("damping of a servo without stiffness", gains.damping).map(|_| gains);
        }
        gains.checked()
    }
}

/// Sampling of the force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Time from one sample to the next in s, positive.
    pub interval_s: f64,
    /// Greatest age in s at SYNC of the sample that the cycle uses. The newest sample is less than `interval_s` younger than that. The age
    /// is negative if the sensor takes the sample after SYNC and it still comes in time.
    pub oldest_s: f64,
    /// Phases of the sensor's clock to check. The first phase is right behind SYNC; the sample of the last phase is as old as it may be. If
    /// SYNC is the clock, only the last phase is checked.
    pub phases: u32,
}

impl Sampling {
    /// Creates a sample at each SYNC.
    pub fn at_sync(period_s: f64) -> Self {
        Self { interval_s: period_s, oldest_s: 0.0, phases: 1 }
    }
}

/// The way from the hand's force to the set-point of the servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outer {
    /// Cycle `T` of the fixture in s.
    pub period_s: f64,
    /// Sampling of the force.
    pub sampling: Sampling,
    /// First-order low pass of the samples, if any: its cut-off in Hz, and the interval of samples for which it is made, in s.
    pub low_pass: Option<(f64, f64)>,
    /// Damping `b` of the proxy in N s/m.
    pub damping_n_s_per_m: f64,
    /// Mass `m_H` of the handle in kg, not negative: a part of the tool that lies beyond the sensor. The reference's acceleration stands
    /// for that of the tool where its inertia is taken out of the reading.
    pub handle_kg: f64,
    /// Inertia that the encoders take out of the reading, if they do.
    pub compensation: Option<Compensation>,
}

/// Inertia beyond the sensor that is taken out of the force by the encoders: `m s/(tau s + 1)` times their rate is added to each sample before
/// the low pass. The rate is the backward difference of the encoders at SYNC.
///
/// # Source
/// Keemink, van der Kooij, Stienen, *Admittance control for physical human-robot interaction* (2018), post-sensor inertia compensation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compensation {
    /// `m` in kg, not negative.
    pub mass_kg: f64,
    /// `tau` in s, positive.
    pub time_constant_s: f64,
}

impl Outer {
    fn checked(&self) -> Result<&Self, ControlError> {
        positive("period", self.period_s)?;
        not_negative("damping of the proxy", self.damping_n_s_per_m)?;
        not_negative("mass of the handle", self.handle_kg)?;
        if let Some(Compensation { mass_kg, time_constant_s }) = self.compensation {
            not_negative("compensated mass", mass_kg)?;
            positive("time constant of the compensation", time_constant_s)?;
        }
        if let Some((cut_off_hz, interval_s)) = self.low_pass {
            positive("low-pass cut-off", cut_off_hz)?;
            positive("interval of the low pass", interval_s)?;
        }
        let Sampling { interval_s, oldest_s, phases } = self.sampling;
        positive("time between samples", interval_s)?;
        let within = |name, value: f64, [least, most]: [f64; 2], requirement| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(ControlError::OutOfRange { name, value, requirement })
            }
        };
        let cycles = |time_s: f64| time_s / self.period_s;
        within("cycles between samples", cycles(interval_s), [1e-3, 1e3], "0.001 to 1000")?;
        within("greatest age of a sample in cycles", cycles(oldest_s), [-1.0, 1e3], "-1 to 1000")?;
        // The sample has to be there before the cycle ends.
        within("least age of a sample in cycles", cycles(oldest_s - interval_s), [-1.0, 1e3], "-1 to 1000")?;
        within("phases", phases.into(), [1.0, 1e3], "1 to 1000").map(|()| self)
    }

    /// Returns `1 - alpha` of the low pass, `y += alpha (x - y)`.
    fn remembered(&self) -> f64 {
        self.low_pass.map_or(0.0, |(cut_off_hz, interval_s)| elementary::exp(-TAU * cut_off_hz * interval_s))
    }
}

/// Returns the lag of the loop in slow motion in s: the tool comes that much later than a mass would. Above `B_h/K_h` the greatest masses
/// drift; zero or less leaves the hand its own damping.
///
/// The lag is the mean age of the force, plus its low pass and the way to the end of the line. One cycle is subtracted, since the fixture
/// steps with the force of the same step. Without an integral the viscous friction of the joints adds a drag. With an integral the friction
/// adds none, but the servo gives way to the hand by `1/L` of the hand's force times the time. A hand then lags the more the stiffer it is:
/// by `K_h/L` with `L` at the tool, in its softest direction. A servo that follows a rate has a second integral, over the position error
/// that the cycle sees. With an integral of its own it adds nothing, and without one `K_h/(K k)`.
///
/// # Errors
/// [`ControlError::OutOfRange`] for what is not finite or outside its range.
pub fn lag_s(follower: &Follower, pose: &Pose, grip: &Grip, outer: &Outer) -> Result<f64, ControlError> {
    let Outer { period_s, sampling, .. } = *outer.checked()?;
    let Gains { stiffness, integral, .. } = follower.gains().checked()?;
    let kept = outer.remembered();
    let age_s = sampling.oldest_s - 0.5 * (sampling.interval_s - period_s).max(0.0);
    let filter_s = outer.low_pass.map_or(0.0, |(_, interval_s)| interval_s * kept / (1.0 - kept));
    let way_s = match follower {
        Follower::Host { .. } | Follower::Rate { .. } => -period_s,
        Follower::Drive { .. } => period_s,
    };
    let given_way = grip.stiffness_n_per_m * (pose.jacobian * pose.jacobian.transpose()).symmetric_eigenvalues().max();
    let servo_s = match follower {
        Follower::Rate { .. } if integral > 0.0 => 0.0,
        Follower::Rate { gain_per_s, .. } => given_way / (stiffness * gain_per_s),
        _ if integral > 0.0 => given_way / integral,
        _ => pose.viscous.symmetric_eigenvalues().max() / stiffness,
    };
    Ok(age_s + filter_s + way_s + servo_s)
}

/// Returns the mass in kg below which no virtual mass is passive for every hand: the arm's own at the tool in its heaviest
/// direction. Delays ask for more, so this says what cannot be had, not what can.
///
/// # Errors
/// [`ControlError::NotPositiveDefinite`] for a mass matrix that is not positive definite, [`ControlError::OutOfRange`] for a singular
/// Jacobian.
///
/// # Source
/// Derived for a continuous servo without viscous friction: with `G = 1 - J s^2 D` and the compliance `D` of the servo, the
/// real part of `s (G/(M s^2) + D)` is not negative from `M = J` on. With a handle that is a part of `J` it is that of
/// `(1 + (M - J - m_H) x)/((M - m_H J x) s)` with `x = s^2 D`, which has the same limit. Keemink, van der Kooij, Stienen, *Admittance control
/// for physical human-robot interaction* (2018), has the same limit for a velocity servo of high gain.
pub fn passive_mass_kg(pose: &Pose) -> Result<f64, ControlError> {
    let inverse = inverse_jacobian(pose)?;
    Ok(principal_inertias(&(inverse.transpose() * pose.mass * inverse))?[1])
}

fn inverse_jacobian(pose: &Pose) -> Result<Matrix2<f64>, ControlError> {
    let singular = ControlError::OutOfRange {
        name: "determinant of the Jacobian",
        value: pose.jacobian.determinant(),
        requirement: "finite and not zero",
    };
    pose.jacobian.try_inverse().filter(|inverse| inverse.iter().all(|x| x.is_finite())).ok_or(singular)
}

/// Range of masses in the search for stable ones, kg.
pub const MASSES_KG: [f64; 2] = [1e-3, 1e4];
/// Points of the search, evenly in the logarithm: eight per decade.
const SEARCH_POINTS: usize = 57;
/// An edge is known when the stable side is that near the unstable one.
const EDGE_RATIO: f64 = 1.001;
/// Masses within a range that are tried at each loop, besides its ends.
const INNER_POINTS: usize = 3;

/// Virtual masses from a least one to a greatest one, all of them stable, and the loops that set the ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StableMasses {
    /// Least mass in kg; the least of [`MASSES_KG`] if that is stable.
    pub least_kg: f64,
    /// Greatest mass in kg; infinity if the greatest of [`MASSES_KG`] is stable.
    pub greatest_kg: f64,
    /// Number of the loop that asks for the least.
    pub least_at: usize,
    /// Number of the loop that bears no more than the greatest.
    pub greatest_at: usize,
}

/// Returns the widest range of virtual masses that is stable in all of `loops`; `None` if no mass is.
///
/// It is the widest one of the first loop, narrowed by each of the others. Both ends are on the stable side, within
/// 0.1 % of the edge.
pub fn stable_masses(loops: &[HeldLoop]) -> Option<StableMasses> {
    let first = loops.first()?;
    let is_stable: Vec<bool> = (0..SEARCH_POINTS).map(|point| first.is_stable(mass_at(point))).collect();
    let [from, to] = longest_run(&is_stable)?;
    let mut found = StableMasses { least_kg: mass_at(from), greatest_kg: mass_at(to), least_at: 0, greatest_at: 0 };
    if from > 0 {
        found.least_kg = edge(first, found.least_kg, mass_at(from - 1));
    }
    if to + 1 < SEARCH_POINTS {
        found.greatest_kg = edge(first, found.greatest_kg, mass_at(to + 1));
    }
    for (number, other) in loops.iter().enumerate().skip(1) {
        found = found.within(number, other)?;
    }
    Some(found.unbounded())
}

impl StableMasses {
    /// Returns the part of this range that is stable in another loop too; `None` if there is none. The other loop gets this number where it
    /// sets an end.
    pub fn narrowed(self, number: usize, other: &HeldLoop) -> Option<Self> {
        let bounded = Self { greatest_kg: self.greatest_kg.min(MASSES_KG[1]), ..self };
        bounded.within(number, other).map(Self::unbounded)
    }

    /// Infinity for the greatest of [`MASSES_KG`].
    fn unbounded(mut self) -> Self {
        if self.greatest_kg >= MASSES_KG[1] {
            self.greatest_kg = f64::INFINITY;
        }
        self
    }

    fn within(mut self, number: usize, other: &HeldLoop) -> Option<Self> {
        // A hole within the range leaves its longer side.
        for point in 1..=INNER_POINTS {
            let share = point as f64 / (INNER_POINTS + 1) as f64;
            let mass_kg = self.least_kg * elementary::powf(self.greatest_kg / self.least_kg, share);
            if other.is_stable(mass_kg) {
                continue;
            }
            if share < 0.5 {
                (self.least_kg, self.least_at) = (mass_kg, number);
            } else {
                (self.greatest_kg, self.greatest_at) = (mass_kg, number);
                break;
            }
        }
        let step = mass_at(1) / mass_at(0);
        if !other.is_stable(self.least_kg) {
            let (mut low, mut high) = (self.least_kg, self.least_kg * step);
            while !other.is_stable(high) {
                if high > self.greatest_kg {
                    return None;
                }
                (low, high) = (high, high * step);
            }
            (self.least_kg, self.least_at) = (edge(other, high, low), number);
        }
        if !other.is_stable(self.greatest_kg) {
            let (mut high, mut low) = (self.greatest_kg, self.greatest_kg / step);
            while !other.is_stable(low) {
                if low < self.least_kg {
                    return None;
                }
                (high, low) = (low, low / step);
            }
            (self.greatest_kg, self.greatest_at) = (edge(other, low, high), number);
        }
        (self.least_kg <= self.greatest_kg).then_some(self)
    }
}

fn mass_at(point: usize) -> f64 {
    let [least, most] = MASSES_KG;
    least * elementary::powf(most / least, point as f64 / (SEARCH_POINTS - 1) as f64)
}

/// Returns the first and last place of the longest run of `true`.
fn longest_run(flags: &[bool]) -> Option<[usize; 2]> {
    let mut longest: Option<[usize; 2]> = None;
    let mut start = None;
    for (place, &flag) in flags.iter().enumerate() {
        start = flag.then(|| start.unwrap_or(place));
        if let Some(from) = start
            && longest.is_none_or(|[first, last]| place - from > last - first)
        {
            longest = Some([from, place]);
        }
    }
    longest
}

/// Returns the stable side of the edge between a stable and an unstable mass, kg.
fn edge(one: &HeldLoop, mut stable_kg: f64, mut unstable_kg: f64) -> f64 {
    while (stable_kg / unstable_kg).max(unstable_kg / stable_kg) > EDGE_RATIO {
        let middle_kg = (stable_kg * unstable_kg).sqrt();
        if one.is_stable(middle_kg) { stable_kg = middle_kg } else { unstable_kg = middle_kg }
    }
    stable_kg
}

#[cfg(test)]
mod tests;
