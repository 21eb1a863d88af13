//! Scene of the study's arm: motors, hand and pushes, and the resulting motion.

use nalgebra::Vector2;
use std::f64::consts::TAU;
use yieldwall_motion::elementary;

use super::machine::{STUDY_ARM, StudyArm, inverse};
use yieldwall_sim::arm::ArmError;
use yieldwall_sim::hand::HandLoad;

/// The controller of each joint runs, and the tool is looked at, at this period.
pub const CYCLE_S: f64 = 1e-3;

/// An arm that a scene moves.
pub trait Plant {
    /// Moves on to `end_s` in steps no longer than `step_s`, under held motor torques.
    ///
    /// # Errors
    /// Where the arm cannot be, or if no finite motion results.
    fn run_to(&mut self, end_s: f64, step_s: f64, torque_n_m: Vector2<f64>) -> Result<(), ArmError>;

    /// Joint angles in rad.
    fn angles(&self) -> Vector2<f64>;

    /// Joint rates in rad/s.
    fn rates(&self) -> Vector2<f64>;
}

/// A controller of each joint towards the planned angle and rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Gain of the angle, in N m/rad.
    pub n_m_per_rad: f64,
    /// Gain of the rate, in N m s/rad.
    pub n_m_s_per_rad: f64,
}

/// A hand: spring and damper between its target and the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spring {
    /// Spring in N/m.
    pub n_per_m: f64,
    /// Damper in N s/m.
    pub n_s_per_m: f64,
}

/// The way that the tool is to follow: an arc to and fro, and a hand that aims beside it and trembles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// Centre of the arc in m.
    pub center_m: [f64; 2],
    /// Radius in m.
    pub radius_m: f64,
    /// Angle at which the motion starts, in rad.
    pub from_rad: f64,
    /// Half of how far it goes, in rad.
    pub swing_rad: f64,
    /// How often it goes to and fro, in Hz.
    pub swing_hz: f64,
    /// How far outside the hand aims, in m.
    pub offset_m: f64,
    /// Amplitude of its tremor along the radius, in m.
    pub tremor_m: f64,
    /// Frequency of its tremor in Hz.
    pub tremor_hz: f64,
}

/// One scene. The arm starts at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    /// The arm.
    pub arm: StudyArm,
    /// Where the tool starts, in m; `None`: on its way.
    pub start_m: Option<[f64; 2]>,
    /// The controller.
    pub gains: Gains,
    /// Torque of the motors beside the controller's, in N m.
    pub torque_n_m: [f64; 2],
    /// The hand.
    pub hand: Spring,
    /// Force on the tool beside the hand's, in N.
    pub push_n: [f64; 2],
    /// Path that controller and hand follow.
    pub way: Way,
    /// Number of cycles.
    pub cycles: usize,
}

const NO_GAINS: Gains = Gains { n_m_per_rad: 0.0, n_m_s_per_rad: 0.0 };
const NO_HAND: Spring = Spring { n_per_m: 0.0, n_s_per_m: 0.0 };

/// The scene of the study: 2 s in which each joint turns round several times and sticks now and then.
///
/// The controller is that of a stiff drive; the hand's spring is that of a firm grip. The hand's target lies 8 mm off the arc, so
/// that hand and motors pull against each other. Its tremor is in the band of human hands.
pub const STUDY: Scene = Scene {
    arm: STUDY_ARM,
    start_m: None,
    gains: Gains { n_m_per_rad: 4000.0, n_m_s_per_rad: 45.0 },
    torque_n_m: [0.0; 2],
    hand: Spring { n_per_m: 500.0, n_s_per_m: 15.0 },
    push_n: [0.0; 2],
    way: Way {
        center_m: [0.0, 0.36],
        radius_m: 0.10,
        from_rad: 0.3,
        swing_rad: 0.75,
        swing_hz: 1.0,
        offset_m: 8e-3,
        tremor_m: 0.5e-3,
        tremor_hz: 9.0,
    },
    cycles: 2000,
};

/// The motors are off and the tool is pushed with a third of what the joints hold: nothing may move.
pub const HOLD: Scene =
    Scene { start_m: Some([0.03, 0.33]), gains: NO_GAINS, hand: NO_HAND, push_n: [20.0, 0.0], cycles: 2000, ..STUDY };

/// Distal links so short that motors that push outward pull them into line (type 2): with `1.0` outward, `-1.0` inward, by
/// 4 N m more than dry friction.
pub const fn lock(sign: f64) -> Scene {
    let arm = StudyArm { distal_m: 0.25, ..STUDY_ARM };
    let torque_n_m = [14.0 * sign, -14.0 * sign];
    Scene { arm, start_m: Some([0.0, 0.36]), gains: NO_GAINS, hand: NO_HAND, torque_n_m, cycles: 2000, ..STUDY }
}

/// The scene of the study with another hand that aims 0.5 mm off the arc, as a stiff hand or a sensor's spring would.
pub const fn stiff(hand: Spring) -> Scene {
    Scene { hand, way: Way { offset_m: 0.5e-3, ..STUDY.way }, ..STUDY }
}

impl Way {
    /// Point and velocity on the arc of another radius, which grows at a rate in m/s.
    #[inline]
    fn at(&self, time_s: f64, radius_m: f64, growth_m_per_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let (sin, cos) = elementary::sin_cos(TAU * self.swing_hz * time_s);
        let angle = self.from_rad + self.swing_rad * (1.0 - cos);
        let rate = self.swing_rad * TAU * self.swing_hz * sin;
        let (sin, cos) = elementary::sin_cos(angle);
        let (outward, along) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        (Vector2::from(self.center_m) + outward * radius_m, along * (rate * radius_m) + outward * growth_m_per_s)
    }

    /// Where the tool is to be, and its velocity.
    pub fn of_tool(&self, time_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        self.at(time_s, self.radius_m, 0.0)
    }

    /// Where the hand aims, and how that moves.
    #[inline]
    pub fn of_hand(&self, time_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let (sin, cos) = elementary::sin_cos(TAU * self.tremor_hz * time_s);
        let radius_m = self.radius_m + self.offset_m + self.tremor_m * sin;
        self.at(time_s, radius_m, self.tremor_m * TAU * self.tremor_hz * cos)
    }
}

/// Target of the controller of both joints in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// Angles in rad.
    pub angles: Vector2<f64>,
    /// Rates in rad/s.
    pub rates: Vector2<f64>,
}

impl Scene {
    /// Joint angles at the start.
    pub fn start(&self) -> Vector2<f64> {
        self.arm.inverse(self.start_m.map_or_else(|| self.way.of_tool(0.0).0, Vector2::from))
    }

    /// Returns the targets of the controller, cycle by cycle.
    pub fn plan(&self) -> Vec<Aim> {
        let aim = |cycle: usize| {
            let (point, velocity) = self.way.of_tool(cycle as f64 * CYCLE_S);
            let angles = self.arm.inverse(point);
            let jacobian = self.arm.motion(angles, Vector2::zeros()).jacobian;
            Aim { angles, rates: inverse(&jacobian) * velocity }
        };
        (0..self.cycles).map(aim).collect()
    }

    /// Torque of the motors, held for a cycle.
    #[inline]
    pub fn torque(&self, aim: &Aim, angles: Vector2<f64>, rates: Vector2<f64>) -> Vector2<f64> {
        let Gains { n_m_per_rad, n_m_s_per_rad } = self.gains;
        Vector2::from(self.torque_n_m) + (aim.angles - angles) * n_m_per_rad + (aim.rates - rates) * n_m_s_per_rad
    }

    /// Returns the load at the tool.
    #[inline]
    pub fn load(&self, time_s: f64, tip: Vector2<f64>) -> HandLoad<2> {
        let Spring { n_per_m, n_s_per_m } = self.hand;
        let push = Vector2::from(self.push_n);
        if self.hand == NO_HAND {
            return HandLoad { force_n: push, ..HandLoad::default() };
        }
        let (target, velocity) = self.way.of_hand(time_s);
        HandLoad {
            force_n: push + (target - tip) * n_per_m + velocity * n_s_per_m,
            damping_n_s_per_m: n_s_per_m,
            stiffness_n_per_m: n_per_m,
        }
    }
}
