//! Measurements by a person at the arm, with nothing enabled: known forces that pull at the tool, and known points to which the
//! person guides it.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::assembly::calibration;
use crate::bringup::jog::idle_before_lead;
use crate::error::RunError;
use crate::permit::Ask;
use crate::place::{Place, Task};
use crate::runner::Runner;
use crate::sensor::Wrenches;
use yieldwall_config as config;
use yieldwall_motion::quantity::{Force, JointAngles, TipPoint};
use yieldwall_motion::sensing::Wrench;

/// Time of measurement under each pull, s.
const LISTENING_S: f64 = 1.0;
/// Time for the arm to come to rest at a point, and time of measurement then, s.
const SETTLING_S: f64 = 0.2;
const LOOKING_S: f64 = 0.2;

/// Person at the arm; returns whether the task was done.
pub type Helper<'a> = &'a mut dyn FnMut(&mut dyn Place, Task) -> bool;

/// Reading of a force sensor under a known force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pulled {
    /// The force in N, base frame.
    pub force: Force,
    /// The force in the frame of the sensor, mounted as in the rig file.
    pub expected: Wrench,
    /// The reading in the sensor's frame, by the calibration of the rig file, without a zero.
    pub shown: Wrenches,
}

/// Asks for pulls of this force at the tool, along x and y of the base frame, in both directions. Reads the force sensor at rest
/// and under each pull. Nothing is enabled.
///
/// # Errors
/// If the network cannot be booted, a drive that has to be homed was not, the arm is where the linkage cannot be, or nobody pulls.
pub fn pulls(
    runner: &mut Runner<dyn Place>,
    rig: &config::Rig,
    force_n: f64,
    help: Helper<'_>,
    is_interrupted: &AtomicBool,
) -> Result<Vec<Pulled>, RunError> {
    let (_, mounting) = calibration(rig)?;
    let forces = [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let mut all = Vec::with_capacity(forces.len());
    for [x, y] in forces {
        let force = Force::new(force_n * x, force_n * y);
        let is_pull = force != Force::default();
        if is_interrupted.load(Ordering::Relaxed) || (is_pull && !help(&mut runner.place, Task::Pull(force))) {
            return Err(RunError::Interrupted);
        }
        let shown = runner.boot().and_then(|()| runner.sense(rig, LISTENING_S, is_interrupted, |_, _| ()));
        let angles = runner.angles();
        let homed = runner.check_homed();
        runner.leave();
        if is_pull {
            help(&mut runner.place, Task::Pull(Force::default()));
        }
        let shown = shown?;
        homed?;
        let posture = runner.master().cycle().linkage().forward(angles);
        let posture = posture.map_err(|_| RunError::NoPosture)?;
        let expected = mounting.to_sensor(force, 0.0, mounting.link_rotation(posture.distal_rotation));
        all.push(Pulled { force, expected, shown });
    }
    Ok(all)
}

/// Asks for the tool at points, one after the other, and measures the angles of the joints at each. Nothing is enabled.
///
/// # Errors
/// If the network cannot be booted, a drive that has to be homed was not, or nobody leads the tool.
pub fn visit(
    runner: &mut Runner<dyn Place>,
    points: &[TipPoint],
    help: Helper<'_>,
    is_interrupted: &AtomicBool,
) -> Result<Vec<JointAngles>, RunError> {
    let mut all = Vec::with_capacity(points.len());
    // Nobody leads an arm for nothing whose drives have to be homed before.
    if runner.master().homing().iter().any(|homing| !homing.is_referenced) {
        let homed = runner.boot().and_then(|()| {
            settle(runner, is_interrupted)?;
            runner.check_homed()
        });
        runner.leave();
        homed?;
    }
    for (at, point) in points.iter().enumerate() {
        if is_interrupted.load(Ordering::Relaxed) || !help(&mut runner.place, Task::LeadTo(at, *point)) {
            return Err(RunError::Interrupted);
        }
        let looked = runner.boot().and_then(|()| look_at_angles(runner, is_interrupted));
        runner.leave();
        all.push(looked?);
    }
    Ok(all)
}

fn settle(runner: &mut Runner<dyn Place>, is_interrupted: &AtomicBool) -> Result<(), RunError> {
    let cycles = runner.cycles_in(SETTLING_S).max(1);
    idle_before_lead(runner, cycles, is_interrupted)
}

fn look_at_angles(runner: &mut Runner<dyn Place>, is_interrupted: &AtomicBool) -> Result<JointAngles, RunError> {
    settle(runner, is_interrupted)?;
    runner.check_homed()?;
    let cycles = runner.cycles_in(LOOKING_S).max(1);
    let first = runner.angles();
    let mut sum = JointAngles::default();
    for _ in 0..cycles {
        if is_interrupted.load(Ordering::Relaxed) {
            return Err(RunError::Interrupted);
        }
        runner.run_cycle(Ask::Nothing);
        sum += runner.angles() - first;
    }
    Ok(first + sum * f64::from(cycles).recip())
}
