//! A hand that holds the tool of an admittance in free space and is nudged: does the motion die away?

use nalgebra::{Matrix2, Vector2};

use super::crossover::Crossover;
use crate::bench::{Bench, BenchError, BenchParameters};
use crate::plant::{STUDY_ARM, StudyArm};
use yieldwall_motion::control::{
    FeedForwardParameters, Follower, Gains, Grip, HeldLoop, Law, Outer, Pose, Sampling, StableMasses, stable_masses,
};
use yieldwall_motion::cycle::TorqueServoParameters;
use yieldwall_motion::fixture::{
    self, Admittance, Contrast, Coupling, Curvature, Fixture, Guidance, Limits, Line, Parameters, Rearm, Shape2, Side,
};
use yieldwall_motion::linkage::{self, Chain, FiveBar, Geometry, GeometryError, Tool, WristSide};
use yieldwall_motion::quantity::{JointRates, TipPoint};
use yieldwall_sim::arm::{ArmError, ArmParameters};
use yieldwall_sim::hand::HandLoad;

pub(super) const PERIOD_S: f64 = 1e-3;
const PLANT_STEP_S: f64 = 1e-4;
/// Heaviest virtual mass of the maps.
const HEAVIEST_KG: f64 = 10.0;
/// Where the tool starts: on the axis of symmetry, where the directions x and y do not couple. The arm weighs 5.5 kg along x
/// and 3.9 kg along y there.
pub(super) const START_M: Vector2<f64> = Vector2::new(0.0, 0.36);
/// PD gains of the joints: N m/rad, N m s/rad.
const GAINS: Gains = Gains { stiffness: 4000.0, damping: 45.0, integral: 0.0 };
/// How long the nudge lasts.
const NUDGE_S: f64 = 0.02;
/// The tool is lost when it is that far from where it started.
const LOST_M: f64 = 0.15;
/// Below this speed of proxy and tool all through a window the loop is at rest.
const REST_M_PER_S: f64 = 1e-6;
/// With dry joints the tool counts as at rest if it swings by less than this in the last quarter of a run. A proxy then creeps
/// within the band in which the joints stick. The tremor of a still hand is as large: 49 um RMS (Riviere, Rader, Khosla,
/// *Characteristics of hand motion of eye surgeons*, 1997).
const STILL_M: f64 = 50e-6;
/// Windows of a run.
const WINDOWS: u64 = 8;
/// The motion dies away if the energy of its swing falls below this share from one quarter of the run to the next but one.
const DYING: f64 = 0.9;

/// Elbows away from the axis of symmetry, as the arm of the study has them.
pub(super) const OUTWARD: [linkage::Side; 2] = [linkage::Side::Left, linkage::Side::Right];

/// Lengths and sides of an arm that is symmetric about the y axis, with the tool at the wrist.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Links {
    /// Half of the distance between the base joints.
    pub(super) half_base_m: f64,
    pub(super) proximal_m: f64,
    pub(super) distal_m: f64,
    pub(super) elbows: [linkage::Side; 2],
}

impl Links {
    fn linkage(&self) -> Result<FiveBar, GeometryError> {
        FiveBar::new(Geometry {
            base_m: [[-self.half_base_m, 0.0], [self.half_base_m, 0.0]],
            proximal_m: [self.proximal_m; 2],
            distal_m: [self.distal_m; 2],
            elbows: self.elbows,
            wrist: WristSide::Forward,
            tool: Tool { fixed_to: Chain::Right, along_m: 0.0, across_m: 0.0 },
        })
    }
}

/// Everything that a map or a row of a table fixes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Setting {
    pub(super) name: &'static str,
    /// Delay of the force in cycles.
    pub(super) delay: u64,
    /// Cycles between samples of the force.
    pub(super) sample_cycles: u32,
    pub(super) low_pass_hz: Option<f64>,
    /// Dry friction of each joint in N m.
    pub(super) coulomb_n_m: f64,
    /// `F` of the fixture in N.
    pub(super) friction_n: f64,
    /// Damping of the proxy in N s/m.
    pub(super) damping_n_s_per_m: f64,
    /// Factor on the servo's bandwidth: its square on the stiffness, itself on the damping.
    pub(super) bandwidth: f64,
    pub(super) hand_n_s_per_m: f64,
    /// Mass of the hand in kg, beyond the sensor.
    pub(super) hand_kg: f64,
    /// Delay of the joint controllers in cycles.
    pub(super) servo_delay: usize,
    /// Where the tool starts, on the axis of symmetry.
    pub(super) start_m: Vector2<f64>,
    /// Links of the arm.
    pub(super) links: Links,
    /// Force of the nudge in N.
    pub(super) nudge_n: f64,
}

pub(super) const PLAIN: Setting = Setting {
    name: "plain",
    delay: 0,
    sample_cycles: 1,
    low_pass_hz: None,
    coulomb_n_m: 0.0,
    friction_n: 0.0,
    damping_n_s_per_m: 0.0,
    bandwidth: 1.0,
    hand_n_s_per_m: 15.0,
    hand_kg: 0.0,
    servo_delay: 0,
    start_m: START_M,
    links: Links {
        half_base_m: STUDY_ARM.half_base_m,
        proximal_m: STUDY_ARM.proximal_m,
        distal_m: STUDY_ARM.distal_m,
        elbows: OUTWARD,
    },
    nudge_n: 5.0,
};

/// Effect of the nudge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NudgeEffect {
    /// The loop came to rest, or was on the way.
    Dies,
    /// It goes on within bounds or grows slowly.
    Lasts,
    /// The tool was thrown away.
    Lost,
    /// The arm came where it cannot be or nearly locks, or its proxy did.
    Refused,
}

impl NudgeEffect {
    /// As in the tables and the legends.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Dies => "dies away",
            Self::Lasts => "goes on",
            Self::Lost => "tool thrown away",
            Self::Refused => "refused",
        }
    }
}

impl Setting {
    fn gains(&self) -> Gains {
        let Gains { stiffness, damping, integral } = GAINS;
        Gains { stiffness: stiffness * self.bandwidth * self.bandwidth, damping: damping * self.bandwidth, integral }
    }

    /// The stable virtual masses by theory, which leaves the dry friction of the joints and `F` out; `None` if there are none.
    pub(super) fn stable_masses(&self, hand_n_per_m: f64) -> Option<StableMasses> {
        let follower = Follower::Host { gains: self.gains(), delay_cycles: self.servo_delay as f64 };
        let interval_s = f64::from(self.sample_cycles) * PERIOD_S;
        let outer = Outer {
            period_s: PERIOD_S,
            sampling: Sampling { interval_s, oldest_s: (self.delay as f64 - 1.0) * PERIOD_S + interval_s, phases: 1 },
            low_pass: self.low_pass_hz.map(|cut_off_hz| (cut_off_hz, interval_s)),
            damping_n_s_per_m: self.damping_n_s_per_m,
            handle_kg: 0.0,
            compensation: None,
        };
        let grip =
            Grip { stiffness_n_per_m: hand_n_per_m, damping_n_s_per_m: self.hand_n_s_per_m, mass_kg: self.hand_kg };
        let held = HeldLoop::new(&follower, &self.pose()?, &grip, &outer, 0).ok()?;
        stable_masses(&[held])
    }

    /// The least virtual mass in kg from which on all are stable up to [`HEAVIEST_KG`]; infinity if that one is not.
    pub(super) fn least_mass_kg(&self, hand_n_per_m: f64) -> f64 {
        let found = self.stable_masses(hand_n_per_m).filter(|found| found.greatest_kg >= HEAVIEST_KG);
        found.map_or(f64::INFINITY, |found| found.least_kg)
    }

    /// Whether the formula for a continuous servo applies to this loop. It does not cover dry joints, a low pass, a slow sensor,
    /// a hand with mass, a late servo, or damping of the proxy.
    pub(super) fn has_crossover(&self) -> bool {
        let Self { name, delay, bandwidth, hand_n_s_per_m, start_m, links, nudge_n, .. } = *self;
        *self == Self { name, delay, bandwidth, hand_n_s_per_m, start_m, links, nudge_n, ..PLAIN }
    }

    /// Returns the least stable virtual mass in kg by the formula for a continuous servo without the load of the hand, the
    /// greater of the two directions. `None` if the formula does not apply.
    pub(super) fn least_mass_by_crossover_kg(&self, hand_n_per_m: f64) -> Option<f64> {
        if !self.has_crossover() {
            return None;
        }
        let inertias = self.pose()?.mass.symmetric_eigenvalues();
        let masses = inertias.iter().map(|&inertia_kg_m2| {
            let loop_of = Crossover {
                gains: self.gains(),
                inertia_kg_m2,
                period_s: PERIOD_S,
                delay_cycles: self.delay as f64,
                hand_n_per_m,
                hand_n_s_per_m: self.hand_n_s_per_m,
            };
            loop_of.least_mass_kg()
        });
        masses.reduce(f64::max)
    }

    /// The arm where the tool starts.
    fn pose(&self) -> Option<Pose> {
        let arm = self.arm()?;
        let angles = arm.linkage.inverse(TipPoint(self.start_m)).ok()?;
        let dynamics = arm.linkage.dynamics(&arm.mass, angles, JointRates::default()).ok()?;
        Some(Pose {
            mass: dynamics.mass,
            viscous: Matrix2::zeros(),
            jacobian: dynamics.jacobian,
            forward_mass: Matrix2::zeros(),
            forward_viscous: Matrix2::zeros(),
            gears: None,
        })
    }

    /// Runs for `duration_s` with this hand and virtual mass.
    pub(super) fn run(&self, hand_n_per_m: f64, mass_kg: f64, duration_s: f64) -> NudgeEffect {
        let Some(mut bench) = self.bench(mass_kg) else { return NudgeEffect::Refused };
        let cycles = (duration_s / PERIOD_S).round() as u64;
        let window_cycles = cycles.div_ceil(WINDOWS);
        let mut energies = [0.0_f64; WINDOWS as usize];
        let mut fastest: f64 = 0.0;
        let mut proxy = self.start_m;
        let mut swing = Swing::default();
        let nudge = Vector2::repeat(self.nudge_n / 2.0_f64.sqrt());
        for cycle in 0..cycles {
            let held = u64::from(self.sample_cycles);
            let sample = cycle.saturating_sub(self.delay) / held * held;
            let seen = bench.run_cycle(sample, |time_s, tip| HandLoad {
                force_n: (self.start_m - tip.0) * hand_n_per_m
                    + if time_s < NUDGE_S { nudge } else { Vector2::zeros() },
                damping_n_s_per_m: self.hand_n_s_per_m,
                stiffness_n_per_m: hand_n_per_m,
            });
            let seen = match seen {
                Ok(seen) => seen,
                Err(BenchError::Arm(ArmError::NotFinite { .. })) => return NudgeEffect::Lost,
                Err(_) => return NudgeEffect::Refused,
            };
            let away = seen.tool_m - self.start_m;
            if away.norm() > LOST_M {
                return NudgeEffect::Lost;
            }
            if cycle >= cycles / 4 * 3 {
                swing.add(&seen.tool_m);
            }
            let velocity = (seen.step.proxy - proxy) / PERIOD_S;
            proxy = seen.step.proxy;
            let energy = 0.5 * (hand_n_per_m * away.norm_squared() + mass_kg * velocity.norm_squared());
            let window = (cycle / window_cycles) as usize;
            energies[window] = energies[window].max(energy);
            fastest = fastest.max(velocity.norm()).max(seen.tool_velocity_m_per_s.norm());
            if (cycle + 1) % window_cycles == 0 {
                if fastest < REST_M_PER_S {
                    return NudgeEffect::Dies;
                }
                fastest = 0.0;
            }
        }
        let [.., a, b, _, _, c, d] = energies;
        let is_still = self.coulomb_n_m > 0.0 && swing.amplitude_m() < STILL_M;
        if is_still || c.max(d) < DYING * a.max(b) { NudgeEffect::Dies } else { NudgeEffect::Lasts }
    }

    /// The arm of the study with these links, the same masses and this hand.
    pub(super) fn arm(&self) -> Option<ArmParameters> {
        let linkage = self.links.linkage().ok()?;
        let (coulomb_n_m, distal_m) = (self.coulomb_n_m, self.links.distal_m);
        let arm = StudyArm { coulomb_n_m, viscous_n_m_s_per_rad: 0.0, distal_m, ..STUDY_ARM };
        Some(ArmParameters { linkage, handle_kg: self.hand_kg, ..arm.parameters().ok()? })
    }

    fn bench(&self, mass_kg: f64) -> Option<Bench> {
        Bench::new(&self.parameters()?, free_space(mass_kg, self.friction_n, self.damping_n_s_per_m)?).ok()
    }

    /// The arm with its servo, whose torques have no limit, and the way of the force to it.
    pub(super) fn parameters(&self) -> Option<BenchParameters> {
        let servo = TorqueServoParameters {
            law: Law::Pid,
            gains: self.gains(),
            sliding_time_s: 0.0,
            is_cartesian: false,
            torque_limit_n_m: f64::INFINITY,
            feed_forward: FeedForwardParameters::NONE,
            inertia: None,
        };
        Some(BenchParameters {
            arm: self.arm()?,
            start_m: self.start_m,
            period_s: PERIOD_S,
            plant_step_s: PLANT_STEP_S,
            servo,
            delay_cycles: self.servo_delay,
            low_pass: self.low_pass_hz.map(|hz| (hz, f64::from(self.sample_cycles) * PERIOD_S)),
        })
    }
}

/// Where a point has been: the least and the greatest of each coordinate.
#[derive(Clone, Copy, Debug, Default)]
struct Swing(Option<[Vector2<f64>; 2]>);

impl Swing {
    fn add(&mut self, point_m: &Vector2<f64>) {
        let [low, high] = self.0.unwrap_or([*point_m; 2]);
        self.0 = Some([low.inf(point_m), high.sup(point_m)]);
    }

    /// Half of the way across.
    fn amplitude_m(&self) -> f64 {
        self.0.map_or(0.0, |[low, high]| 0.5 * (high - low).norm())
    }
}

/// An admittance without a wall: mass, friction `F` and damping alone.
pub(super) fn free_space(mass_kg: f64, friction_n: f64, damping_n_s_per_m: f64) -> Option<Fixture<Shape2, 2>> {
    let limits = Limits { friction_n, yield_n: friction_n };
    let coupling = Admittance { mass_kg };
    let guidance = Guidance::Viscous { across_n_s_per_m: damping_n_s_per_m, along_n_s_per_m: damping_n_s_per_m };
    let kappa = coupling.stiffness_n_per_m(PERIOD_S);
    let set = Contrast::new(guidance, limits, Side::Bilateral, kappa, PERIOD_S).ok()?;
    let parameters = Parameters {
        coupling: Coupling::Admittance(coupling),
        limits,
        side: Side::Bilateral,
        hold_steps: 0,
        rearm: Rearm::OffSurface,
        curvature: Curvature::Tangent,
        period_s: PERIOD_S,
    };
    let line = Line::new(Vector2::zeros(), Vector2::y()).ok()?;
    Fixture::with_set(Shape2::Line(line), parameters, fixture::Law::Contrast(set)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Behind dry joints a damped proxy creeps on where the tool stands, and a light one hunts by millimetres.
    #[test]
    fn a_proxy_that_creeps_behind_dry_joints_is_at_rest_and_one_that_hunts_is_not() {
        let dry = Setting { delay: 1, coulomb_n_m: 10.0, nudge_n: 30.0, ..PLAIN };
        let creeps = Setting { damping_n_s_per_m: 30.0, ..dry };
        assert_eq!(creeps.run(300.0, 2.046, 4.0), NudgeEffect::Dies);
        assert_eq!(dry.run(500.0, 1.376, 4.0), NudgeEffect::Lasts);
    }

    /// Theory and simulation meet within 5 % on both sides, at delays, with a slow sensor and behind a low pass.
    #[test]
    fn the_boundary_is_where_theory_says() {
        for setting in [
            PLAIN,
            Setting { delay: 1, ..PLAIN },
            Setting { delay: 3, ..PLAIN },
            Setting { sample_cycles: 2, ..PLAIN },
            Setting { low_pass_hz: Some(30.0), ..PLAIN },
            Setting { delay: 1, bandwidth: 2.0, ..PLAIN },
            Setting { delay: 1, damping_n_s_per_m: 10.0, ..PLAIN },
            Setting { servo_delay: 1, ..PLAIN },
            Setting { servo_delay: 1, hand_kg: 0.5, ..PLAIN },
            Setting { delay: 1, hand_kg: 1.5, ..PLAIN },
        ] {
            for hand_n_per_m in [1000.0, 3000.0] {
                let least = setting.least_mass_kg(hand_n_per_m);
                if !(0.02..10.0).contains(&least) {
                    continue;
                }
                let outcome = |factor: f64| setting.run(hand_n_per_m, factor * least, 4.0);
                assert_eq!(outcome(1.05), NudgeEffect::Dies, "{setting:?} {hand_n_per_m} N/m above {least} kg");
                assert_ne!(outcome(0.95), NudgeEffect::Dies, "{setting:?} {hand_n_per_m} N/m below {least} kg");
            }
        }
    }
}
