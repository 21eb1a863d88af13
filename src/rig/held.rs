//! How light an admittance may be, and how stiff an impedance, before a rig's own loop is unstable with a hand on it.

use nalgebra::{Matrix2, Vector2};

use super::build::{gains, linkage, mass_model, period_s, plant_mass};
use super::error::RigError;
use super::margins::{LOOP_DELAY_CYCLES, poses};
use crate::config;
use crate::control::{
    Gains, Grip, Outer, Pose, ServoLoop, damping_needed_n_s_per_m, greatest_damping_n_s_per_m,
    greatest_stiffness_n_per_m, is_stable, lag_s, least_virtual_mass_kg, passive_mass_kg,
};
use crate::quantity::{JointAngles, JointRates, TipPoint};

/// Hands for which a rig is looked at when none is named: normal, stiff and braced, N/m.
const USUAL_HANDS_N_PER_M: [f64; 3] = [500.0, 1000.0, 3000.0];
/// Every which pose of those of the margins is looked at.
const POSE_STRIDE: usize = 3;
/// Cycles from the force sample to the end of the line along which a drive follows a target position: one until the next
/// SYNC, one for the line.
const POSITION_DELAY_CYCLES: f64 = 2.0;

/// The least stable virtual mass of a rig with one hand, at its worst pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Holding {
    /// The hand.
    pub grip: Grip,
    /// The least mass in kg; infinity if none is stable.
    pub least_kg: f64,
    /// Tool point of the worst pose in m.
    pub tool_m: [f64; 2],
    /// Lag of the loop in slow motion at that pose, s: with more than `B_h/K_h` no mass is stable.
    pub lag_s: f64,
    /// No mass below this one is passive for all hands, kg: the arm's own, at its heaviest pose.
    pub passive_kg: f64,
}

/// What the virtual coupling of an impedance device bears, the hand off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupled {
    /// Whether the configured spring and damper are stable.
    pub is_stable: bool,
    /// Damping that the configured spring needs, N s/m, by the rule of thumb `K T/2`.
    pub damping_needed_n_s_per_m: f64,
    /// Greatest stiffness in N/m beside the configured damping; `None` if none is stable.
    pub greatest_stiffness_n_per_m: Option<f64>,
    /// Greatest damping in N s/m beside the configured stiffness; `None` if none is stable.
    pub greatest_damping_n_s_per_m: Option<f64>,
}

/// The hand of a scene.
pub fn hand_of(scene: &config::Scene) -> Grip {
    Grip {
        stiffness_n_per_m: scene.hand.stiffness_n_per_m.get(),
        damping_n_s_per_m: scene.hand.damping_n_s_per_m.get(),
        mass_kg: scene.hand.mass_kg.get(),
    }
}

/// The usual stiffnesses with mass and damping of `hand`, the damping as the root of the stiffness: so all are damped to
/// the same degree.
pub fn usual_hands(hand: &Grip) -> [Grip; 3] {
    USUAL_HANDS_N_PER_M.map(|stiffness| stiffer(hand, stiffness))
}

/// `hand` with another stiffness, damped to the same degree.
pub fn stiffer(hand: &Grip, stiffness_n_per_m: f64) -> Grip {
    let ratio = if hand.stiffness_n_per_m > 0.0 { stiffness_n_per_m / hand.stiffness_n_per_m } else { 1.0 };
    Grip { stiffness_n_per_m, damping_n_s_per_m: hand.damping_n_s_per_m * ratio.sqrt(), ..*hand }
}

/// The least stable virtual mass with each hand over the poses along a rig's surface. `None` in velocity mode, where the
/// drives' loops are not known.
///
/// In torque mode the servo is that of the rig, with its inertia and viscous feed-forward; in position mode it is that of
/// the simulated drives. Friction is left out, as are limits of the torque.
///
/// # Errors
/// If the arm cannot be built, does not reach a pose or is singular there; numbers out of range.
pub fn least_mass(rig: &config::Rig, hands: &[Grip]) -> Result<Option<Vec<Holding>>, RigError> {
    let Some((servo, outer, is_cartesian)) = loops(rig) else { return Ok(None) };
    let poses: Vec<_> = poses(rig).into_iter().step_by(POSE_STRIDE).collect();
    let mut found = Vec::new();
    for grip in hands {
        let mut worst = Holding { grip: *grip, least_kg: -1.0, tool_m: [0.0; 2], lag_s: 0.0, passive_kg: 0.0 };
        for tool in &poses {
            let pose = pose_at(rig, *tool, is_cartesian)?;
            let least_kg = least_virtual_mass_kg(&servo, &pose, grip, &outer)?;
            if least_kg > worst.least_kg {
                (worst.least_kg, worst.tool_m) = (least_kg, (*tool).into());
                worst.lag_s = lag_s(&servo, &pose, &outer)?;
            }
            worst.passive_kg = worst.passive_kg.max(passive_mass_kg(&pose)?);
        }
        found.push(worst);
    }
    Ok(Some(found))
}

/// The servo, the way to it, and whether it acts on the tool.
fn loops(rig: &config::Rig) -> Option<(ServoLoop, Outer, bool)> {
    let period_s = period_s(rig);
    let sample_cycles = (1.0 / (rig.sensor.sample_rate_hz.get() * period_s)).round().max(1.0) as u32;
    let outer = |delay_cycles| Outer {
        period_s,
        delay_cycles,
        sample_cycles,
        low_pass_hz: rig.sensor.low_pass_hz.map(|value| value.get()),
        damping_n_s_per_m: 0.0,
    };
    match rig.rig.command_mode {
        config::CommandMode::Torque => {
            let (gains, is_cartesian) = gains(&rig.control)?;
            let servo = ServoLoop { gains, period_s, delay_cycles: LOOP_DELAY_CYCLES };
            Some((servo, outer(0.0), is_cartesian))
        }
        config::CommandMode::Position => {
            let drive = &rig.plant.drive_position_loop;
            let gains = Gains {
                stiffness: drive.stiffness_n_m_per_rad.get(),
                damping: drive.damping_n_m_s_per_rad.get(),
                integral: drive.integral_n_m_per_rad_s.get(),
            };
            let servo = ServoLoop { gains, period_s: f64::from(drive.period_us) * 1e-6, delay_cycles: 0.0 };
            Some((servo, outer(POSITION_DELAY_CYCLES), false))
        }
        config::CommandMode::Velocity => None,
    }
}

fn pose_at(rig: &config::Rig, tool: Vector2<f64>, is_cartesian: bool) -> Result<Pose, RigError> {
    let linkage = linkage(rig)?;
    let forward = &rig.control.feed_forward;
    let model = forward.inertia.as_ref().map_or_else(|| plant_mass(rig), mass_model);
    let angles: JointAngles = linkage.inverse(TipPoint(tool))?;
    let dynamics = linkage.dynamics(&model, angles, JointRates::default())?;
    let viscous = Matrix2::from_diagonal(&Vector2::from(forward.viscous_n_m_s_per_rad.map(|value| value.get())));
    // Feed-forward acts on the joints, and in torque mode alone.
    let is_fed = rig.rig.command_mode == config::CommandMode::Torque;
    let forward_mass = if is_fed && forward.inertia.is_some() { dynamics.mass } else { Matrix2::zeros() };
    let forward_viscous = if is_fed { viscous } else { Matrix2::zeros() };
    let joints = Pose { mass: dynamics.mass, viscous, jacobian: dynamics.jacobian, forward_mass, forward_viscous };
    if !is_cartesian {
        return Ok(joints);
    }
    let inverse = dynamics.jacobian.try_inverse().ok_or_else(|| RigError::Mismatch("singular pose".into()))?;
    let at_tool = |matrix: Matrix2<f64>| inverse.transpose() * matrix * inverse;
    Ok(Pose {
        mass: at_tool(joints.mass),
        viscous: at_tool(joints.viscous),
        jacobian: Matrix2::identity(),
        forward_mass: at_tool(joints.forward_mass),
        forward_viscous: at_tool(joints.forward_viscous),
    })
}

/// What the coupling of a device bears with a factor of `reserve` to spare; `None` for an admittance.
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
