//! Defects of a machine since its assembly, by its parts.

use super::error::RigError;
use yieldwall_config as config;
use yieldwall_config::injection::{Defect, DefectKind};
use yieldwall_motion::elementary;
use yieldwall_motion::quantity::{JointAngles, JointRates, JointTorques};

/// Periods of a cogging torque in a turn of the joint.
const COGGING_PERIODS: f64 = 100.0;

/// Defects between the drives and the arm, and in the force sensor.
#[derive(Clone, Debug)]
pub(super) struct Defects {
    all: Vec<Defect>,
    /// Offset of the force sensor's first channel, counts.
    bias_counts: i32,
    /// Angles of the joints when the machine was switched on: from there the encoders count wrongly.
    start: JointAngles,
}

fn all(scene: &config::Scene) -> Result<Vec<Defect>, RigError> {
    Ok(scene.defects.iter().map(config::SceneDefect::defect).collect::<Result<_, _>>()?)
}

/// Whether a drive has a defect.
pub(super) fn has(scene: &config::Scene, kind: DefectKind, drive: usize) -> Result<bool, RigError> {
    Ok(all(scene)?.iter().any(|defect| defect.kind == kind && defect.drive == drive))
}

/// Returns the size of a defect of a drive, if the drive has it.
pub(super) fn size(scene: &config::Scene, kind: DefectKind, drive: usize) -> Result<Option<f64>, RigError> {
    let all = all(scene)?;
    let defect = all.iter().find(|defect| defect.kind == kind && defect.drive == drive);
    Ok(defect.map(|defect| defect.size))
}

/// Returns the dry friction of the joints, N m, for an arm with this friction without a defect.
pub(super) fn friction(scene: &config::Scene, mut healthy: [f64; 2]) -> Result<[f64; 2], RigError> {
    for defect in all(scene)?.iter().filter(|defect| defect.kind == DefectKind::HighFriction) {
        healthy.iter_mut().skip(defect.drive).take(1).for_each(|friction| *friction += defect.size);
    }
    Ok(healthy)
}

/// Returns the noise of a sensor with excessive noise, counts.
pub(super) fn sensor_noise_counts(rig: &config::Rig, scene: &config::Scene) -> Result<Option<f64>, RigError> {
    let noise = of_machine(scene, DefectKind::NoisySensor)?;
    Ok(noise.map(|noise_n| noise_n / n_per_count(rig)))
}

/// Returns the mass at the handle beyond the rig file's, kg.
pub(super) fn hung_kg(scene: &config::Scene) -> Result<f64, RigError> {
    of_machine(scene, DefectKind::HeavyHandle).map(Option::unwrap_or_default)
}

/// Returns the time constant of a low pass in the force sensor that the rig file does not include, s; 0 for none.
pub(super) fn sensor_lag_s(scene: &config::Scene) -> Result<f64, RigError> {
    of_machine(scene, DefectKind::SlowSensor).map(|lag_ms| 1e-3 * lag_ms.unwrap_or_default())
}

/// Returns the size of a defect that is not one of a drive, if the machine has it.
fn of_machine(scene: &config::Scene, kind: DefectKind) -> Result<Option<f64>, RigError> {
    Ok(all(scene)?.into_iter().find(|defect| defect.kind == kind).map(|defect| defect.size))
}

/// Returns the force of one count of the first channel, N.
fn n_per_count(rig: &config::Rig) -> f64 {
    let [along_x, ..] = rig.sensor.calibration;
    along_x.iter().map(|value| value.get() * value.get()).sum::<f64>().sqrt()
}

impl Defects {
    /// Creates the defects of a scene, for a machine that is switched on with its joints at these angles.
    pub(super) fn new(rig: &config::Rig, scene: &config::Scene, start: JointAngles) -> Result<Self, RigError> {
        let all = all(scene)?;
        let bias = all.iter().find(|defect| defect.kind == DefectKind::BiasedSensor);
        let bias_counts = bias.map_or(0, |defect| (defect.size / n_per_count(rig)).round() as i32);
        Ok(Self { all, bias_counts, start })
    }

    /// Whether nothing is wrong.
    pub(super) fn is_none(&self) -> bool {
        self.all.is_empty()
    }

    /// Returns the motion of the joints as the encoders report it.
    pub(super) fn measured(&self, angles: JointAngles, rates: JointRates) -> (JointAngles, JointRates) {
        let (mut angles, mut rates, start) = (angles.to_array(), rates.to_array(), self.start.to_array());
        for defect in &self.all {
            let factor = match defect.kind {
                DefectKind::EncoderPolarity | DefectKind::GearSign => -1.0,
                DefectKind::EncoderResolution => defect.size,
                _ => continue,
            };
            for ((angle, rate), start) in angles.iter_mut().zip(&mut rates).zip(start).skip(defect.drive).take(1) {
                *angle = start + factor * (*angle - start);
                *rate *= factor;
            }
        }
        (angles.into(), rates.into())
    }

    /// Returns the angles of the links from the angles of the motors and the links' previous angles: a link with play stays until
    /// its motor takes it along.
    pub(super) fn links(&self, before: JointAngles, motors: JointAngles) -> JointAngles {
        let (before, mut links) = (before.to_array(), motors.to_array());
        for defect in self.all.iter().filter(|defect| defect.kind == DefectKind::Backlash) {
            for (link, before) in links.iter_mut().zip(before).skip(defect.drive).take(1) {
                let half = 0.5 * defect.size.to_radians();
                *link = before.clamp(*link - half, *link + half);
            }
        }
        links.into()
    }

    /// Returns the true torques on joints at these angles, for the torques that the drives mean to make.
    pub(super) fn made_of(&self, meant: JointTorques, angles: JointAngles) -> JointTorques {
        let (mut torques, angles) = (meant.to_array(), angles.to_array());
        for defect in &self.all {
            for (torque, angle) in torques.iter_mut().zip(angles).skip(defect.drive).take(1) {
                *torque = match defect.kind {
                    DefectKind::GearSign => -*torque,
                    DefectKind::WeakMotor => defect.size * *torque,
                    DefectKind::Cogging => *torque + defect.size * elementary::sin(COGGING_PERIODS * angle),
                    _ => *torque,
                };
            }
        }
        torques.into()
    }

    /// Returns the counts of the force sensor's channels.
    pub(super) fn counts(&self, mut counts: [i32; 6]) -> [i32; 6] {
        counts[0] = counts[0].saturating_add(self.bias_counts);
        if self.all.iter().any(|defect| defect.kind == DefectKind::SwappedSensorAxes) {
            counts.swap(0, 1);
        }
        counts
    }
}
