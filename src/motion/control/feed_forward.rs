//! Torque known beforehand: friction of the desired motion and the inertia of the desired acceleration.

use nalgebra::{Matrix2, Vector2};

use super::error::{ControlError, not_negative, positive};
use crate::quantity::{JointRates, JointTorques};
use crate::setvalued::gsat;

/// Friction of the two joints and how it is fed forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardParameters {
    /// Coulomb friction per joint, N m, not negative. Rather too small than too large: what exceeds the real friction
    /// pushes a resting joint.
    pub coulomb_n_m: [f64; 2],
    /// Viscous friction per joint, N m s/rad, not negative.
    pub viscous_n_m_s_per_rad: [f64; 2],
    /// Desired travel that takes the Coulomb term from zero to its full value, rad, greater than zero;
    /// [`FeedForwardParameters::DEFAULT_TRANSITION_RAD`] if nothing is known.
    pub coulomb_transition_rad: f64,
}

impl FeedForwardParameters {
    /// 50 microradians, 15 micrometres at an arm of 0.3 m: below the accuracy that a rig needs and far above the
    /// rounding and noise of a resting proxy.
    pub const DEFAULT_TRANSITION_RAD: f64 = 50e-6;

    /// No friction.
    pub const NONE: Self = Self {
        coulomb_n_m: [0.0; 2],
        viscous_n_m_s_per_rad: [0.0; 2],
        coulomb_transition_rad: Self::DEFAULT_TRANSITION_RAD,
    };
}

/// The inertia part: what the rigid arm needs for the desired acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertiaTerm {
    /// Mass matrix at the desired or measured pose, kg m^2.
    pub mass_matrix: Matrix2<f64>,
    /// Desired angular accelerations, rad/s^2.
    pub accelerations: Vector2<f64>,
    /// Centrifugal and Coriolis torques, N m.
    pub bias_n_m: Vector2<f64>,
}

/// Feed-forward of one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardStep {
    /// The sum of all terms, N m; finite, not limited: [`EffortRange::around`](super::EffortRange::around) does that.
    pub torques: JointTorques,
    /// The Coulomb part of it, N m.
    pub coulomb: JointTorques,
    /// Whether the input was usable. If not, the torques are zero.
    pub valid: bool,
}

/// Coulomb, viscous and inertia feed-forward of the desired motion of both joints.
///
/// # Direction of the Coulomb term
/// The Coulomb term is `tau_c s`, and `s` follows the desired *travel*: `s = gsat(-1, s1 + dq/delta, 1)` with `dq` the
/// desired angle's change of this period and `delta` the transition. Full value is reached after `delta` of travel, a
/// reversal takes `2 delta`, and at rest `s` stays as it is.
///
/// The term is not a function of the desired rate, because a proxy rests for long, to the last bit or nearly so, and then starts slowly.
/// The sign of a rate then follows rounding and jumps by `2 tau_c`. A saturated rate with a threshold high enough not to chatter drops the
/// term exactly while the joint sticks, so the servo's error has to break it loose. Travel needs no threshold between the two.
///
/// The joint of the table has 0.35 kg m^2, 10 N m friction, `K/B/L = 6000/70/30000` and one cycle of delay. Each cell has the largest error
/// in mrad and the summed change of the term in N m/s:
///
/// | desired motion | none | rate, 2 mrad/s | rate, 10 mrad/s | travel, 50 urad |
/// |---|---|---|---|---|
/// | 1 mrad/s, rest, 0.5 mrad/s | 0.64, 0 | 0.41, 3 | 0.60, 1 | 0.05, 3 |
/// | 0.1 rad swings at 0.5 Hz | 2.8, 0 | 0.03, 19 | 0.12, 20 | 0.13, 18 |
/// | random walk of the rate | 1.6, 0 | 0.19, 523 | 1.07, 160 | 0.17, 51 |
/// | rest with 1 urad of noise | 0.003, 1 | 0.005, 8600 | 0.003, 1900 | 0.003, 220 |
///
/// The price: a resting joint keeps up to `tau_c` of motor torque, which real friction of at least `tau_c` holds.
///
/// # Source
/// The travel rule is the stop operator of elasto-plasticity, as Dahl's model of friction before sliding.
#[derive(Clone, Debug)]
pub struct FeedForward {
    parameters: FeedForwardParameters,
    /// Desired rate to change of `s` per period: `T/delta`, s/rad.
    travel_factor: f64,
    /// `s` per joint, -1 to 1.
    direction: [f64; 2],
}

impl FeedForward {
    /// Creates a feed-forward with no direction yet. `period_s` is the sampling interval `T > 0` in s.
    ///
    /// # Errors
    /// [`ControlError::OutOfRange`] for a parameter that is not finite or outside its range.
    pub fn new(parameters: FeedForwardParameters, period_s: f64) -> Result<Self, ControlError> {
        for value in parameters.coulomb_n_m {
            not_negative("Coulomb friction", value)?;
        }
        for value in parameters.viscous_n_m_s_per_rad {
            not_negative("viscous friction", value)?;
        }
        let transition = positive("Coulomb transition", parameters.coulomb_transition_rad)?;
        let travel_factor = positive("period over Coulomb transition", positive("period", period_s)? / transition)?;
        Ok(Self { parameters, travel_factor, direction: [0.0; 2] })
    }

    /// Computes one period of desired motion: rates are the desired angles' change over the period, in rad/s. Without
    /// `inertia` the sum is friction alone.
    ///
    /// Desired accelerations of a proxy are second differences: when it stops within one period at an impact they ask
    /// for torques of any size, for one period in each direction. The sum is left as it is; the caller cuts it with
    /// [`EffortRange::around`](super::EffortRange::around).
    ///
    /// Input that is not finite, or a sum that overflows, gives zero torques, `valid: false` and no change of state.
    ///
    /// Real-time: yes.
    pub fn step(&mut self, desired_rates: JointRates, inertia: Option<&InertiaTerm>) -> FeedForwardStep {
        let inertia = inertia.map_or(Vector2::zeros(), |term| term.mass_matrix * term.accelerations + term.bias_n_m);
        let [tau_0, tau_1] = self.parameters.coulomb_n_m;
        let [b_0, b_1] = self.parameters.viscous_n_m_s_per_rad;
        let [rate_0, rate_1] = desired_rates.to_array();
        let [s_0, s_1] = self.direction;
        let first = friction(tau_0, b_0, rate_0, s_0 + rate_0 * self.travel_factor);
        let second = friction(tau_1, b_1, rate_1, s_1 + rate_1 * self.travel_factor);
        let torques = JointTorques::new(first.sum + inertia.x, second.sum + inertia.y);
        if !torques.is_finite() {
            let none = JointTorques::default();
            return FeedForwardStep { torques: none, coulomb: none, valid: false };
        }
        self.direction = [first.direction, second.direction];
        FeedForwardStep { torques, coulomb: JointTorques::new(first.coulomb, second.coulomb), valid: true }
    }

    /// Forgets the direction of motion, as on enabling.
    ///
    /// Real-time: yes.
    pub fn reset(&mut self) {
        self.direction = [0.0; 2];
    }
}

struct Friction {
    direction: f64,
    coulomb: f64,
    sum: f64,
}

fn friction(coulomb_n_m: f64, viscous_n_m_s_per_rad: f64, rate: f64, travel: f64) -> Friction {
    let direction = gsat(-1.0, travel, 1.0);
    let coulomb = coulomb_n_m * direction;
    Friction { direction, coulomb, sum: coulomb + viscous_n_m_s_per_rad * rate }
}
