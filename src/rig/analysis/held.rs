//! How light and how heavy an admittance may be, and how stiff an impedance, before a rig's own loop is unstable with a hand on it.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, Vector2};

use super::force_age::{later_between_s, outers};
use super::identified::{identified_delay_cycles, identified_models};
use super::margins::poses;
use crate::RigError;
use yieldwall_config as config;
use yieldwall_motion::control::{
    Follower, Gains, Gears, Grip, HeldLoop, Outer, Pose, Sampling, ServoLoop, damping_needed_n_s_per_m,
    greatest_damping_n_s_per_m, greatest_stiffness_n_per_m, is_stable, lag_s, passive_mass_kg, stable_masses,
};
use yieldwall_motion::linkage::MassModel;
use yieldwall_motion::quantity::{JointAngles, JointRates, TipPoint};
use yieldwall_run::assembly::{AssemblyError, delay_cycles, gains, linkage, period_s, plant_mass};
use yieldwall_run::{ForceFound, JointFound};

/// Default stiffnesses of the hand: normal, stiff and braced, N/m.
const USUAL_HANDS_N_PER_M: [f64; 3] = [500.0, 1000.0, 3000.0];
/// Rounds of the search for the worst phase of a sensor's clock: each leaves 0.62 of the interval.
const PHASE_ROUNDS: usize = 12;
/// Every which pose is looked at at phases of that clock but the first and the last.
const POSE_STRIDE: usize = 4;

/// The stable virtual masses of a rig with one hand, over all poses and all phases of the sensor's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Holding {
    /// The hand.
    pub grip: Grip,
    /// The masses; `None` if none is stable.
    pub masses: Option<HeldMasses>,
    /// Whether the mass that is configured is stable everywhere.
    pub is_configured_stable: bool,
    /// Greatest lag of the loop in slow motion, s: with more than `B_h/K_h` the heaviest masses drift.
    pub lag_s: f64,
    /// No mass below this one is passive for all hands, kg: the arm's own, at its heaviest pose.
    pub passive_kg: f64,
}

/// The widest range of virtual masses that is stable with one hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldMasses {
    /// The least mass in kg.
    pub least_kg: f64,
    /// The greatest mass in kg; infinity where none drifts.
    pub greatest_kg: f64,
    /// Tool point of the pose that asks for the least, m.
    pub least_at_m: [f64; 2],
    /// Tool point of the pose that bears no more than the greatest, m.
    pub greatest_at_m: [f64; 2],
}

/// Limits of drives that close a loop of their own, which the masses leave out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveLimits {
    /// Force of the hand in N above which a virtual mass makes the drives exceed the torque limit, at the worst pose. In a cycle
    /// the rate of the target changes by `F T/M`, to which the drives answer with `B F T/(M lever)`.
    pub saturating_n: f64,
    /// Torque in N m that one count of the target asks for, `2 pi/counts B/T`; `None` in velocity mode.
    pub count_n_m: Option<f64>,
    /// The torque limit in N m.
    pub torque_limit_n_m: f64,
    /// Whether forces that the guard lets pass saturate the drives.
    pub is_saturated_soon: bool,
}

impl DriveLimits {
    /// Part of the torque limit above which one count of the target is coarse.
    const COARSE: f64 = 0.1;

    /// Whether one count of the target asks for much of the torque.
    pub fn is_coarse(&self) -> bool {
        self.count_n_m.is_some_and(|count_n_m| count_n_m > Self::COARSE * self.torque_limit_n_m)
    }
}

/// Returns the limits of a rig's drives with a virtual mass; `None` in torque mode.
///
/// # Errors
/// As [`held_masses`].
pub fn drive_limits(rig: &config::Rig, scene: &config::Scene, mass_kg: f64) -> Result<Option<DriveLimits>, RigError> {
    let Some(Held { follower, poses, .. }) = Held::of(rig, scene)? else { return Ok(None) };
    let (damping, is_position) = match follower {
        Follower::Host { .. } => return Ok(None),
        Follower::Drive { gains, .. } => (gains.damping, true),
        Follower::Rate { gains, .. } => (gains.damping, false),
    };
    let rates = poses.iter().filter_map(|pose| pose.jacobian.try_inverse());
    let most_per_m = rates.flat_map(|inverse| [inverse.row(0).norm(), inverse.row(1).norm()]).fold(0.0, f64::max);
    let per_rate = damping / period_s(rig);
    let torque_limit_n_m = rig.guard.torque_limit_n_m.get();
    let saturating_n = mass_kg * torque_limit_n_m / (damping * period_s(rig) * most_per_m);
    let counts = rig.drives.iter().map(|drive| f64::from(drive.encoder_counts_per_rev)).fold(f64::INFINITY, f64::min);
    Ok(Some(DriveLimits {
        saturating_n,
        count_n_m: is_position.then_some(TAU / counts * per_rate),
        torque_limit_n_m,
        is_saturated_soon: saturating_n < rig.guard.force_limit_n.get(),
    }))
}

/// Parts of a scene that the masses of [`held_masses`] leave out, as they stand in its file.
pub fn unmodelled(scene: &config::Scene) -> Vec<String> {
    let ideal = scene.model.as_ref().filter(|model| model.tracking == config::Tracking::Ideal);
    let tracking = ideal.map(|_| "`model.tracking: ideal`, which has no arm".to_owned());
    let defects: Vec<String> = scene.defects.iter().map(|defect| format!("`{}`", defect.defect.0.row().name)).collect();
    let defects = (!defects.is_empty()).then(|| format!("`defects`: {}", defects.join(", ")));
    tracking.into_iter().chain(defects).collect()
}

/// Limits of an impedance device's virtual coupling, with the hand off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupled {
    /// Whether the configured spring and damper are stable.
    pub is_stable: bool,
    /// Damping that the configured spring needs, N s/m, by the rule of thumb `K T/2`.
    pub damping_needed_n_s_per_m: f64,
    /// Greatest stiffness in N/m at the configured damping; `None` if none is stable.
    pub greatest_stiffness_n_per_m: Option<f64>,
    /// Greatest damping in N s/m at the configured stiffness; `None` if none is stable.
    pub greatest_damping_n_s_per_m: Option<f64>,
}

/// Returns the hand of a scene.
pub fn hand_of(scene: &config::Scene) -> Grip {
    Grip {
        stiffness_n_per_m: scene.hand.stiffness_n_per_m.get(),
        damping_n_s_per_m: scene.hand.damping_n_s_per_m.get(),
        mass_kg: scene.hand.mass_kg.get(),
    }
}

/// Returns hands of the usual stiffnesses with the mass and damping of `hand`. The damping grows with the root of the stiffness, so
/// that all have the same damping ratio.
pub fn usual_hands(hand: &Grip) -> [Grip; 3] {
    USUAL_HANDS_N_PER_M.map(|stiffness| stiffer(hand, stiffness))
}

/// Returns `hand` with another stiffness and the same damping ratio.
pub fn stiffer(hand: &Grip, stiffness_n_per_m: f64) -> Grip {
    let ratio = if hand.stiffness_n_per_m > 0.0 { stiffness_n_per_m / hand.stiffness_n_per_m } else { 1.0 };
    Grip { stiffness_n_per_m, damping_n_s_per_m: hand.damping_n_s_per_m * ratio.sqrt(), ..*hand }
}

/// Returns the stable virtual masses with each hand over the poses along a rig's surface, and whether `configured_kg` is one.
/// `None` if the gains do not belong to the command mode.
///
/// In torque mode the servo is the rig's own, with its inertia and viscous feed-forward, and the arm is the feed-forward's model if
/// there is one. In velocity and position mode the servo is the one of the simulated drives, and the arm the simulated one. Elastic
/// gears of the scene are included. Dry friction, torque limits and [`unmodelled`] effects are left out.
///
/// # Errors
/// If the arm cannot be built, does not reach a pose or is singular there; numbers out of range.
pub fn held_masses(
    rig: &config::Rig,
    scene: &config::Scene,
    hands: &[Grip],
    configured_kg: f64,
) -> Result<Option<Vec<Holding>>, RigError> {
    let Some(held) = Held::of(rig, scene)? else { return Ok(None) };
    held.holdings(hands, configured_kg).map(Some)
}

/// Returns the stable virtual masses in torque mode with the identified values of the joints: their delay, and both models of the
/// arm from [`identified_models`]. The model of the file is fed forward. If the identified age of the force exceeds the age in the
/// file, the masses hold for its least and its greatest value. `None` in the other modes.
///
/// # Errors
/// As [`held_masses`].
pub fn held_masses_identified(
    (rig, scene): (&config::Rig, &config::Scene),
    (found, force): (&[JointFound; 2], Option<&ForceFound>),
    hands: &[Grip],
    configured_kg: f64,
) -> Result<Option<Vec<Holding>>, RigError> {
    let (Some((Follower::Host { gains, .. }, is_cartesian)), believed) = (follower(rig)?, outers(rig)?) else {
        return Ok(None);
    };
    let mut later_s = force.map_or(Ok([0.0; 2]), |force| later_between_s(rig, force))?.to_vec();
    later_s.dedup();
    let older = |outer: &Outer, by_s: f64| {
        let oldest_s = outer.sampling.oldest_s + by_s;
        Outer { sampling: Sampling { oldest_s, ..outer.sampling }, ..*outer }
    };
    let outers = later_s.iter().flat_map(|by_s| believed.iter().map(move |outer| older(outer, *by_s))).collect();
    let follower = Follower::Host { gains, delay_cycles: identified_delay_cycles(rig, found)? };
    let models = identified_models(rig, found)?;
    let places = || poses(rig).into_iter().flat_map(|tool| models.iter().map(move |model| (tool, model)));
    let (tools, at) = (places().map(|(tool, _)| tool).collect(), |(tool, model)| {
        pose_at((rig, scene), tool, is_cartesian, Some(model))
    });
    let poses = places().map(at).collect::<Result<Vec<_>, _>>()?;
    Held { follower, outers, tools, poses }.holdings(hands, configured_kg).map(Some)
}

/// Point of a loop's computation: the number of its pose, the force path, and the number of the phase.
#[derive(Clone, Copy)]
struct LoopPoint<'a> {
    pose: usize,
    outer: &'a Outer,
    phase: u32,
}

/// A rig's loop at all poses along its surface, for hands to be put on it.
pub(super) struct Held {
    follower: Follower,
    outers: Vec<Outer>,
    tools: Vec<Vector2<f64>>,
    poses: Vec<Pose>,
}

impl Held {
    /// Returns `None` if the gains do not belong to the command mode.
    pub(super) fn of(rig: &config::Rig, scene: &config::Scene) -> Result<Option<Self>, RigError> {
        let Some((follower, is_cartesian)) = follower(rig)? else { return Ok(None) };
        let (outers, tools) = (outers(rig)?, poses(rig));
        let at = |tool: &Vector2<f64>| pose_at((rig, scene), *tool, is_cartesian, None);
        let poses = tools.iter().map(at).collect::<Result<Vec<_>, _>>()?;
        Ok(Some(Self { follower, outers, tools, poses }))
    }

    fn holdings(&self, hands: &[Grip], configured_kg: f64) -> Result<Vec<Holding>, RigError> {
        hands.iter().map(|grip| self.holding(grip, configured_kg)).collect()
    }

    /// Whether a virtual mass is stable at every computed pose and phase.
    pub(super) fn is_stable(&self, grip: &Grip, mass_kg: f64) -> Result<bool, RigError> {
        Ok(self.loops(grip)?.iter().all(|(_, held)| held.is_stable(mass_kg)))
    }

    /// Returns pose, force path and phase with the loop there, for all computed points.
    fn loops(&self, grip: &Grip) -> Result<Vec<(LoopPoint<'_>, HeldLoop)>, RigError> {
        let phases = self.outers.iter().flat_map(|outer| (0..outer.sampling.phases).map(move |phase| (outer, phase)));
        let places = phases.flat_map(|(outer, phase)| {
            // The first and the last at every pose. Those between are lighter as a rule: some poses will do.
            let is_end = phase == 0 || phase == outer.sampling.phases - 1;
            let stride = if is_end { 1 } else { POSE_STRIDE };
            (0..self.poses.len()).step_by(stride).map(move |pose| (pose, outer, phase))
        });
        let held = |(pose, outer, phase): (usize, _, _)| {
            let held = HeldLoop::new(&self.follower, &self.poses[pose], grip, outer, phase)?;
            Ok((LoopPoint { pose, outer, phase }, held))
        };
        places.map(held).collect()
    }

    /// The loop that is nearest to its edge with this mass, by golden section between the neighbours of a phase.
    fn worst_phase(&self, place: LoopPoint<'_>, grip: &Grip, mass_kg: f64) -> Result<HeldLoop, RigError> {
        let steps = f64::from(place.outer.sampling.phases - 1);
        let at = |share: f64| HeldLoop::at(&self.follower, &self.poses[place.pose], grip, place.outer, share);
        let radius = |share: f64| at(share).map(|held| held.spectral_radius(mass_kg).unwrap_or(f64::INFINITY));
        let [mut from, mut to] = [-1.0, 1.0].map(|step| ((f64::from(place.phase) + step) / steps).clamp(0.0, 1.0));
        let inner = |from: f64, to: f64| from + (to - from) * (3.0 - 5.0_f64.sqrt()) / 2.0;
        let (mut low, mut high) = (inner(from, to), inner(to, from));
        let mut radii = [radius(low)?, radius(high)?];
        let start = f64::from(place.phase) / steps;
        let mut worst = (radius(start)?, start);
        for _ in 0..PHASE_ROUNDS {
            let [of_low, of_high] = radii;
            if of_low > of_high {
                worst = if of_low > worst.0 { (of_low, low) } else { worst };
                (to, high) = (high, low);
                low = inner(from, to);
                radii = [radius(low)?, of_low];
            } else {
                worst = if of_high > worst.0 { (of_high, high) } else { worst };
                (from, low) = (low, high);
                high = inner(to, from);
                radii = [of_high, radius(high)?];
            }
        }
        Ok(at(worst.1)?)
    }

    fn holding(&self, grip: &Grip, configured_kg: f64) -> Result<Holding, RigError> {
        let (mut places, mut loops): (Vec<LoopPoint<'_>>, Vec<HeldLoop>) = self.loops(grip)?.into_iter().unzip();
        let mut masses = stable_masses(&loops);
        if let Some(found) = masses.filter(|found| places[found.least_at].outer.sampling.phases > 1) {
            let place = places[found.least_at];
            let worst = self.worst_phase(place, grip, found.least_kg)?;
            masses = found.narrowed(loops.len(), &worst);
            (places, loops) = ([places, vec![place]].concat(), [loops, vec![worst]].concat());
        }
        let masses = masses.map(|found| {
            let at = |number: usize| self.tools[places[number].pose].into();
            HeldMasses {
                least_kg: found.least_kg,
                greatest_kg: found.greatest_kg,
                least_at_m: at(found.least_at),
                greatest_at_m: at(found.greatest_at),
            }
        });
        let is_within = masses.is_some_and(|found| (found.least_kg..=found.greatest_kg).contains(&configured_kg));
        let is_configured_stable = is_within || loops.iter().all(|held| held.is_stable(configured_kg));
        let pairs = self.outers.iter().flat_map(|outer| self.poses.iter().map(move |pose| (outer, pose)));
        let lags = pairs.map(|(outer, pose)| lag_s(&self.follower, pose, grip, outer));
        let lag_s = lags.collect::<Result<Vec<_>, _>>()?.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let mut passive_kg: f64 = 0.0;
        for pose in &self.poses {
            passive_kg = passive_kg.max(passive_mass_kg(pose)?);
        }
        Ok(Holding { grip: *grip, masses, is_configured_stable, lag_s, passive_kg })
    }
}

/// Returns the servo, and whether it acts on the tool.
fn follower(rig: &config::Rig) -> Result<Option<(Follower, bool)>, RigError> {
    Ok(match rig.rig.command_mode {
        config::CommandMode::Torque => match gains(&rig.control) {
            Some((gains, is_cartesian)) => {
                Some((Follower::Host { gains, delay_cycles: delay_cycles(rig)? }, is_cartesian))
            }
            None => None,
        },
        mode @ (config::CommandMode::Position | config::CommandMode::Velocity) => {
            let drive = &rig.simulated().map_err(AssemblyError::from)?.drive_position_loop;
            let gains = Gains {
                stiffness: drive.stiffness_n_m_per_rad.get(),
                damping: drive.damping_n_m_s_per_rad.get(),
                integral: drive.integral_n_m_per_rad_s.get(),
            };
            let period_s = f64::from(drive.period_us) * 1e-6;
            match (mode, rig.control.gains) {
                (config::CommandMode::Position, _) => Some((Follower::Drive { gains, period_s }, false)),
                (_, config::ControlGains::Rate { gain_per_s }) => {
                    Some((Follower::Rate { gains, period_s, gain_per_s: gain_per_s.get() }, false))
                }
                _ => None,
            }
        }
    })
}

/// Returns the arm with the tool at a point; `real` replaces the known model.
fn pose_at(
    (rig, scene): (&config::Rig, &config::Scene),
    tool: Vector2<f64>,
    is_cartesian: bool,
    real: Option<&MassModel>,
) -> Result<Pose, RigError> {
    let linkage = linkage(rig)?;
    // What the control feeds forward acts, and stands for the arm, in torque mode alone.
    let forward = Some(&rig.control.feed_forward).filter(|_| rig.rig.command_mode == config::CommandMode::Torque);
    let model = forward.and_then(|forward| forward.inertia.as_ref());
    let angles: JointAngles = linkage.inverse(TipPoint(tool))?;
    let arm = model.map_or_else(|| plant_mass(rig), |model| Ok(model.mass_model()))?;
    let mass = linkage.dynamics(&arm, angles, JointRates::default())?;
    let motors_kg_m2 = real.unwrap_or(&arm).motor_kg_m2;
    let elasticity = scene.model.as_ref().and_then(|model| model.joint_elasticity.as_ref());
    let gears = elasticity.map(|gear| Gears {
        motor: Matrix2::from_diagonal(&Vector2::from(motors_kg_m2)) * gear.motor_share.get(),
        stiffness: Matrix2::from_diagonal_element(gear.stiffness_n_m_per_rad.get()),
        damping: Matrix2::from_diagonal_element(gear.damping_n_m_s_per_rad.get()),
    });
    let real = real.map_or(Ok(mass.mass), |real| {
        linkage.dynamics(real, angles, JointRates::default()).map(|dynamics| dynamics.mass)
    })?;
    let diagonal =
        |values: [config::NotNegative; 2]| Matrix2::from_diagonal(&Vector2::from(values.map(|value| value.get())));
    let forward_viscous = forward.map_or_else(Matrix2::zeros, |forward| diagonal(forward.viscous_n_m_s_per_rad));
    let joints = Pose {
        mass: real,
        viscous: if model.is_some() {
            forward_viscous
        } else {
            diagonal(rig.simulated().map_err(AssemblyError::from)?.arm.viscous_n_m_s_per_rad)
        },
        jacobian: mass.jacobian,
        forward_mass: if model.is_some() { mass.mass } else { Matrix2::zeros() },
        forward_viscous,
        gears,
    };
    if !is_cartesian {
        return Ok(joints);
    }
    let inverse = joints.jacobian.try_inverse().ok_or(RigError::Singular)?;
    let at_tool = |matrix: Matrix2<f64>| inverse.transpose() * matrix * inverse;
    Ok(Pose {
        mass: at_tool(joints.mass),
        viscous: at_tool(joints.viscous),
        jacobian: Matrix2::identity(),
        forward_mass: at_tool(joints.forward_mass),
        forward_viscous: at_tool(joints.forward_viscous),
        gears: joints.gears.map(|gears| Gears {
            motor: at_tool(gears.motor),
            stiffness: at_tool(gears.stiffness),
            damping: at_tool(gears.damping),
        }),
    })
}

/// Returns the limits of a device's coupling with a factor of `reserve` to spare; `None` for an admittance.
///
/// # Errors
/// Numbers out of range.
pub fn coupled_device(device: &config::ImpedanceDevice, reserve: f64) -> Result<Option<Coupled>, RigError> {
    let config::Coupling::Impedance { stiffness_n_per_m, damping_n_s_per_m } = device.fixture.coupling else {
        return Ok(None);
    };
    let period_s = f64::from(device.cycle.period_us) * 1e-6;
    let gains = Gains { stiffness: stiffness_n_per_m.get(), damping: damping_n_s_per_m.get(), integral: 0.0 };
    let servo = ServoLoop { gains, period_s, delay_cycles: 0.0 };
    let [mass, viscous] = [device.plant.mass_kg.get(), device.plant.damping_n_s_per_m.get()];
    Ok(Some(Coupled {
        is_stable: is_stable(&servo, mass, viscous)?,
        damping_needed_n_s_per_m: damping_needed_n_s_per_m(gains.stiffness, period_s, 0.0),
        greatest_stiffness_n_per_m: greatest_stiffness_n_per_m(&servo, mass, viscous, reserve)?,
        greatest_damping_n_s_per_m: greatest_damping_n_s_per_m(&servo, mass, viscous, reserve)?,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped(name: &str) -> (config::Rig, config::Scene) {
        let loaded = config::load_rig(config::builtin(name)).unwrap();
        let scene = loaded.scene().unwrap().value;
        (loaded.value, scene)
    }

    /// The phases of a sensor with its own clock, looked at one by one at the pose that asks for the least mass.
    #[test]
    fn the_least_mass_is_stable_at_every_phase() {
        let mut heavier = Vec::new();
        for (mode, period_us) in [
            (config::CommandMode::Torque, 1000),
            (config::CommandMode::Position, 2000),
            (config::CommandMode::Position, 10_000),
        ] {
            let (mut rig, scene) = shipped("paper-admittance-streaming.yaml");
            rig.rig.command_mode = mode;
            (rig.cycle.period_us, rig.cycle.compute_at_us) = (period_us, 62 * (period_us / 100));
            rig.simulation.iter_mut().for_each(|simulation| simulation.timing = config::BusTiming::Ideal);
            let grip = hand_of(&scene);
            let held = Held::of(&rig, &scene).unwrap().unwrap();
            let masses = held.holding(&grip, 1.0).unwrap().masses.unwrap();
            let loops: Vec<_> = held.loops(&grip).unwrap().into_iter().map(|(_, one)| one).collect();
            heavier.push(masses.least_kg / stable_masses(&loops).unwrap().least_kg);
            let pose = held.tools.iter().position(|tool| <[f64; 2]>::from(*tool) == masses.least_at_m).unwrap();
            for (outer, number) in held.outers.iter().flat_map(|outer| (0..=150).map(move |number| (outer, number))) {
                let share = f64::from(number) / 150.0;
                let one = HeldLoop::at(&held.follower, &held.poses[pose], &grip, outer, share).unwrap();
                assert!(one.is_stable(1.004 * masses.least_kg), "{mode:?}, {period_us} us, {share}: {masses:?}");
            }
        }
        assert!(
            heavier.iter().any(|ratio| *ratio > 1.0003),
            "the phases that are looked at first have it all: {heavier:?}"
        );
    }
}
