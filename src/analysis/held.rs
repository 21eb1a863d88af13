//! How light and how heavy an admittance may be, and how stiff an impedance, before a rig's own loop is unstable with a hand on it.

use nalgebra::{Matrix2, Vector2};

use super::identified::{identified_delay_cycles, identified_models, later_between_s};
use super::margins::poses;
use crate::assembly::{
    AssemblyError, bus_id, bus_plan, delay_cycles, gains, linkage, period_s, plant_mass, sampled_before,
};
use crate::bus::budget::{Budget, PlannedFrame, Use};
use crate::config;
use crate::control::{
    Follower, Gains, Grip, HeldLoop, Outer, Pose, Sampling, ServoLoop, damping_needed_n_s_per_m,
    greatest_damping_n_s_per_m, greatest_stiffness_n_per_m, is_stable, lag_s, passive_mass_kg, stable_masses,
};
use crate::linkage::MassModel;
use crate::quantity::{JointAngles, JointRates, TipPoint};
use crate::rig::RigError;
use crate::run::{ForceFound, JointFound};
use crate::sim::SYNC_RATE_HZ;

/// Hands for which a rig is looked at when none is named: normal, stiff and braced, N/m.
const USUAL_HANDS_N_PER_M: [f64; 3] = [500.0, 1000.0, 3000.0];
/// Phases of a sensor's own clock that are looked at.
const PHASES: u32 = 17;
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

/// The stable virtual masses with each hand over the poses along a rig's surface, and whether `configured_kg` is one. `None` in
/// velocity mode, where the drives' loops are not known.
///
/// In torque mode the servo is that of the rig, with its inertia and viscous feed-forward, and the arm is the feed-forward's
/// model where there is one; in position mode the servo is that of the simulated drives and the arm the simulated one.
/// Friction is left out, as are limits of the torque.
///
/// # Errors
/// If the arm cannot be built, does not reach a pose or is singular there; numbers out of range.
pub fn held_masses(rig: &config::Rig, hands: &[Grip], configured_kg: f64) -> Result<Option<Vec<Holding>>, RigError> {
    let Some(held) = Held::of(rig)? else { return Ok(None) };
    held.holdings(hands, configured_kg).map(Some)
}

/// The same in torque mode with what was identified of the joints: their delay, and the arm as both of
/// [`identified_models`] have it, while the model of the file is fed forward; and with the force as old as it may be, at least and at most, by
/// what was identified of it, where that is older than the file has it. `None` in the other modes.
///
/// # Errors
/// As [`held_masses`].
pub fn held_masses_identified(
    rig: &config::Rig,
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
    let (tools, at) =
        (places().map(|(tool, _)| tool).collect(), |(tool, model)| pose_at(rig, tool, is_cartesian, Some(model)));
    let poses = places().map(at).collect::<Result<Vec<_>, _>>()?;
    Held { follower, outers, tools, poses }.holdings(hands, configured_kg).map(Some)
}

/// A rig's loop at all poses along its surface, for hands to be put on it.
pub(super) struct Held {
    follower: Follower,
    outers: Vec<Outer>,
    tools: Vec<Vector2<f64>>,
    poses: Vec<Pose>,
}

impl Held {
    /// `None` in velocity mode.
    pub(super) fn of(rig: &config::Rig) -> Result<Option<Self>, RigError> {
        let Some((follower, is_cartesian)) = follower(rig)? else { return Ok(None) };
        let (outers, tools) = (outers(rig)?, poses(rig));
        let poses = tools.iter().map(|tool| pose_at(rig, *tool, is_cartesian, None)).collect::<Result<Vec<_>, _>>()?;
        Ok(Some(Self { follower, outers, tools, poses }))
    }

    fn holdings(&self, hands: &[Grip], configured_kg: f64) -> Result<Vec<Holding>, RigError> {
        hands.iter().map(|grip| self.holding(grip, configured_kg)).collect()
    }

    /// Whether a virtual mass is stable at every pose and every phase that is looked at.
    pub(super) fn is_stable(&self, grip: &Grip, mass_kg: f64) -> Result<bool, RigError> {
        Ok(self.loops(grip)?.iter().all(|(_, held)| held.is_stable(mass_kg)))
    }

    /// The number of the pose, and the loop there, for all that is looked at.
    fn loops(&self, grip: &Grip) -> Result<Vec<(usize, HeldLoop)>, RigError> {
        let phases = self.outers.iter().flat_map(|outer| (0..outer.sampling.phases).map(move |phase| (outer, phase)));
        let places = phases.flat_map(|(outer, phase)| {
            // The first and the last at every pose. Those between are lighter as a rule: some poses will do.
            let is_end = phase == 0 || phase == outer.sampling.phases - 1;
            let stride = if is_end { 1 } else { POSE_STRIDE };
            (0..self.poses.len()).step_by(stride).map(move |pose| (pose, outer, phase))
        });
        let held = |(pose, outer, phase): (usize, _, _)| {
            Ok((pose, HeldLoop::new(&self.follower, &self.poses[pose], grip, outer, phase)?))
        };
        places.map(held).collect()
    }

    fn holding(&self, grip: &Grip, configured_kg: f64) -> Result<Holding, RigError> {
        let (places, loops): (Vec<usize>, Vec<HeldLoop>) = self.loops(grip)?.into_iter().unzip();
        let masses = stable_masses(&loops).map(|found| {
            let at = |number: usize| self.tools[places[number]].into();
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

/// The servo, and whether it acts on the tool.
fn follower(rig: &config::Rig) -> Result<Option<(Follower, bool)>, RigError> {
    Ok(match rig.rig.command_mode {
        config::CommandMode::Torque => match gains(&rig.control) {
            Some((gains, is_cartesian)) => {
                Some((Follower::Host { gains, delay_cycles: delay_cycles(rig)? }, is_cartesian))
            }
            None => None,
        },
        config::CommandMode::Position => {
            let drive = &rig.simulated().map_err(AssemblyError::from)?.drive_position_loop;
            let gains = Gains {
                stiffness: drive.stiffness_n_m_per_rad.get(),
                damping: drive.damping_n_m_s_per_rad.get(),
                integral: drive.integral_n_m_per_rad_s.get(),
            };
            Some((Follower::Drive { gains, period_s: f64::from(drive.period_us) * 1e-6 }, false))
        }
        config::CommandMode::Velocity => None,
    })
}

/// What frames that wait on a bus may do to the samples of a sensor whose clock is its own, which the masses leave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnevenSamples {
    /// The sensor sends by its clock, and SYNC waits for its frames: then the drives sample and act late.
    SyncWaits,
    /// SYNC or a request has the newest sample sent, and a heartbeat that delays it decides now and then whether one is in time.
    SampleMissed,
}

/// Which of the two can happen on the rig's bus; `None` where SYNC has the sample taken.
pub fn uneven_samples(rig: &config::Rig) -> Option<UnevenSamples> {
    match rig.sensor.protocol {
        config::SensorProtocol::Canopen { .. } => (!is_sampled_at_sync(rig)).then_some(UnevenSamples::SampleMissed),
        config::SensorProtocol::Streaming { .. } => Some(UnevenSamples::SyncWaits),
        config::SensorProtocol::Polled { .. } => Some(UnevenSamples::SampleMissed),
        config::SensorProtocol::Ethercat { .. } => None,
    }
}

/// Whether the sensor takes its samples at SYNC.
pub fn is_sampled_at_sync(rig: &config::Rig) -> bool {
    matches!(rig.sensor.protocol, config::SensorProtocol::Canopen { .. })
        && *rig.sensor.sample_rate_hz == f64::from(SYNC_RATE_HZ)
}

/// The way of the force, with the oldest samples that the sensor's clock can have the cycle use: where frames decide which one that
/// is, for the shortest and for the longest ones.
pub(super) fn outers(rig: &config::Rig) -> Result<Vec<Outer>, RigError> {
    let period_s = period_s(rig);
    let interval_s = rig.sensor.sample_rate_hz.get().recip();
    let own_clock = |latest_s: f64| Sampling { interval_s, oldest_s: interval_s - latest_s, phases: PHASES };
    let samplings = match rig.sensor.protocol {
        config::SensorProtocol::Canopen { .. } if is_sampled_at_sync(rig) => vec![Sampling::at_sync(period_s)],
        // SYNC has the newest sample of the sensor's own clock sent.
        config::SensorProtocol::Canopen { .. } => vec![own_clock(0.0)],
        // The input frame takes the newest one along, some time after SYNC0, at which the drives act.
        config::SensorProtocol::Ethercat { .. } => vec![own_clock(sampled_before(rig).as_secs_f64())],
        config::SensorProtocol::Streaming { .. } | config::SensorProtocol::Polled { .. } => {
            let mut latest_s = latest_samples_s(rig)?.to_vec();
            latest_s.dedup();
            latest_s.into_iter().map(own_clock).collect()
        }
    };
    let outer = |sampling| Outer {
        period_s,
        sampling,
        // More than one sample in a cycle cannot be seen.
        low_pass: rig.sensor.low_pass_hz.map(|cut_off_hz| (cut_off_hz.get(), interval_s.max(period_s))),
        damping_n_s_per_m: 0.0,
    };
    Ok(samplings.into_iter().map(outer).collect())
}

/// How long after the end of SYNC a sample of a sensor on plain CAN may be taken that its cycle still uses, s, with the shortest and with
/// the longest frames: stuff bits are as the data are. Negative if it has to be taken before SYNC. In the regular course of the bus: a
/// heartbeat that makes one sample late now and then does not count.
fn latest_samples_s(rig: &config::Rig) -> Result<[f64; 2], RigError> {
    let bus = bus_id(rig, &rig.sensor.bus)?;
    let (setup, conditions) = bus_plan(rig)?;
    let conditions = conditions.into_iter().find(|conditions| conditions.bus == bus);
    let conditions = conditions.ok_or_else(|| RigError::Mismatch("the sensor's bus has no plan".into()))?;
    let budget = Budget::new(&setup, conditions).map_err(|error| RigError::Mismatch(error.to_string()))?;
    let frames = || budget.frames.iter().map(|budgeted| &budgeted.frame);
    let request = frames().find(|frame| frame.usage == Use::Request);
    // Behind SYNC the devices of SYNC answer, and the request waits for those that go before it.
    let goes_first = |frame: &&PlannedFrame| match frame.usage {
        Use::Sync => true,
        Use::Measured if !frame.is_answer => request.is_none_or(|request| frame.cob_id < request.cob_id),
        _ => false,
    };
    let takes_time = rig.frames_take_time();
    let latest_s = |bits: &dyn Fn(&PlannedFrame) -> u32| {
        let duration_s = |frame: &PlannedFrame| match takes_time {
            true => f64::from(bits(frame)) / f64::from(conditions.bit_rate),
            false => 0.0,
        };
        let first_s: f64 = frames().filter(goes_first).map(duration_s).sum();
        // The drives act when SYNC is over; the computation is planned from its begin.
        let sync_s: f64 = frames().filter(|frame| frame.usage == Use::Sync).map(duration_s).sum();
        if let Some(request) = request {
            return first_s + duration_s(request) - sync_s;
        }
        let sample_s: f64 = frames().filter(|frame| frame.usage == Use::Streamed).map(duration_s).sum();
        let latest_s = f64::from(rig.cycle.compute_at_us) * 1e-6 - sample_s;
        // Where the bus is not free again in time, the sample has to go before SYNC.
        (if latest_s >= first_s { latest_s } else { -sample_s }) - sync_s
    };
    Ok([latest_s(&PlannedFrame::bits_shortest), latest_s(&|frame| frame.bits(conditions.is_plain()))])
}

/// The arm with the tool at a point; `real` stands in place of the model that is known of it.
fn pose_at(
    rig: &config::Rig,
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
    };
    if !is_cartesian {
        return Ok(joints);
    }
    let inverse = joints.jacobian.try_inverse().ok_or_else(|| RigError::Mismatch("singular pose".into()))?;
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

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;
    use crate::config::Source;
    use crate::guard::Request;
    use crate::rig::EmbeddedRig;

    #[test]
    fn a_polled_sensor_takes_its_sample_when_the_request_has_come_to_drives_that_sync_has_reached() {
        let loaded = config::load_rig(Source::named("builtin:paper-admittance-polled.yaml")).unwrap();
        let scene = loaded.scene().unwrap().value;
        let rig = loaded.value;
        let config::SensorProtocol::Polled { base_id, .. } = rig.sensor.protocol else { panic!("it is polled") };
        let mut machine = EmbeddedRig::new(&rig, &scene, &rig.fixture, 1).unwrap();
        machine.enable().unwrap();
        let ends = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&ends);
        machine.set_witness(Box::new(move |passage| {
            seen.lock().unwrap().push((passage.sent.id(), passage.time));
        }));
        (0..20).for_each(|_| _ = machine.run_cycle(Request::None).unwrap());
        let ends = ends.lock().unwrap();
        let mut sync = None;
        let mut between_s = Vec::new();
        for (id, end) in ends.iter() {
            match (*id, sync) {
                (0x080, _) => sync = Some(*end),
                (id, Some(begun)) if id == base_id => between_s.push(end.since(begun).as_secs_f64()),
                _ => {}
            }
        }
        // In the run frames have as many stuff bits as their data give. The plan counts an interframe space more.
        let [shortest_s, longest_s] = latest_samples_s(&rig).unwrap();
        assert!(between_s.len() > 10);
        for took_s in between_s {
            assert!((shortest_s - 3e-6..=longest_s).contains(&took_s), "{shortest_s} to {longest_s}: {took_s}");
        }
    }
}
