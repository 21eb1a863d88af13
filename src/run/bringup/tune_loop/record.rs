//! Identified values of a rig on a bus, kept for the next runs with its configuration.

use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use thiserror::Error;

use super::JointLoop;
use crate::proof::fnv1a;
use yieldwall_config as config;
use yieldwall_record::trusted;

/// Identified values of a joint, as far as its loop is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointFound {
    /// Mean inertia over the travel, kg m^2.
    pub inertia_kg_m2: f64,
    /// Angles of both joints at the identification, rad.
    pub pose_rad: [f64; 2],
    /// Longest delay that the measurement leaves possible, from the sample of an angle to the torque that was computed from it, s.
    pub delay_s: f64,
    /// Least viscous friction that it leaves possible, N m s/rad.
    pub viscous_n_m_s_per_rad: f64,
}

/// Age of the force as identified at one of both joints.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ForceFound {
    /// Between what it lies, s before the sample of the angles of its cycle.
    pub between_s: [f64; 2],
    /// Mass beyond the sensor, kg.
    pub mass_kg: f64,
}

impl ForceFound {
    /// Returns the older of the forces identified at the joints, or `None` if the sensor felt too little of the handle at all
    /// joints.
    pub fn of(joints: &[&JointLoop]) -> Option<Self> {
        let found = joints.iter().filter_map(|joint| joint.handle.as_ref().ok());
        let oldest = found.max_by(|one, other| one.between_s[1].total_cmp(&other.between_s[1]))?;
        Some(Self { between_s: oldest.between_s, mass_kg: oldest.mass_kg.value })
    }
}

impl JointLoop {
    /// Returns the values that matter for the loop, if this program closes it and all of them were identified.
    pub fn found(&self) -> Option<JointFound> {
        let (Ok(dynamics), Ok(friction)) = (&self.dynamics, &self.friction) else { return None };
        Some(JointFound {
            inertia_kg_m2: dynamics.inertia_kg_m2.value,
            pose_rad: self.pose.to_array(),
            delay_s: dynamics.delay_s.high,
            viscous_n_m_s_per_rad: friction.viscous_n_m_s_per_rad.low,
        })
    }
}

/// Measured loop of a rig on its bus. It holds for every gain, and for all of the configuration on which its delay depends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredLoop {
    configuration: Value,
    /// Both joints, left and right.
    pub joints: [JointFound; 2],
    /// Age of the force, if it was identified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    force: Option<MeasuredForce>,
    version: String,
}

/// The age of the force, and the sensor that has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct MeasuredForce {
    sensor: Value,
    found: ForceFound,
}

/// A record that cannot be read.
#[derive(Debug, Error)]
#[error("{}: {reason}", .path.display())]
pub struct LoopUnreadable {
    /// Its file.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}

impl MeasuredLoop {
    /// Creates the record of a rig's identified joints, with the age of its force if that was identified.
    pub fn new(rig: &config::Rig, joints: [JointFound; 2], force: Option<ForceFound>) -> Self {
        let force = force.map(|found| MeasuredForce { sensor: sensor(rig), found });
        Self { configuration: configuration(rig), joints, force, version: env!("CARGO_PKG_VERSION").to_owned() }
    }

    /// Returns the age of the force, if it was identified with the sensor that this rig has.
    pub fn force(&self, rig: &config::Rig) -> Option<ForceFound> {
        self.force.as_ref().filter(|force| force.sensor == sensor(rig)).map(|force| force.found)
    }

    /// Keeps it in a folder of records, in the place of an older one; where.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn store(&self, folder: &Path) -> io::Result<PathBuf> {
        let path = path(&self.configuration, folder);
        trusted::write(&path, serde_json::to_string_pretty(self)?.as_bytes())?;
        Ok(path)
    }

    /// Loads the record of a rig; `None` if there is no record.
    ///
    /// # Errors
    /// If there is a record that cannot be read.
    pub fn load(rig: &config::Rig, folder: &Path) -> Result<Option<Self>, LoopUnreadable> {
        let wanted = configuration(rig);
        let path = path(&wanted, folder);
        let unreadable = |reason: String| LoopUnreadable { path: path.clone(), reason };
        let text = match trusted::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(unreadable(error.to_string())),
        };
        let record: Self = serde_json::from_str(&text).map_err(|error| unreadable(error.to_string()))?;
        let is_number = |joint: &JointFound| {
            let JointFound { inertia_kg_m2, pose_rad: [left, right], delay_s, viscous_n_m_s_per_rad } = *joint;
            [inertia_kg_m2, left, right, delay_s, viscous_n_m_s_per_rad].iter().all(|value| value.is_finite())
        };
        let is_age = |force: &MeasuredForce| {
            let ForceFound { between_s: [low, high], mass_kg } = force.found;
            low <= high && low.is_finite() && high.is_finite() && mass_kg.is_finite()
        };
        let is_whole = record.joints.iter().all(is_number) && record.force.as_ref().is_none_or(is_age);
        if record.configuration != wanted || !is_whole {
            return Err(unreadable("it is of another configuration, or a number in it is none".to_owned()));
        }
        Ok(Some(record))
    }
}

/// Returns all of a rig on which the delay of its loop depends.
fn configuration(rig: &config::Rig) -> Value {
    let mut configuration = json!({
        "command_mode": rig.rig.command_mode,
        "cycle": rig.cycle,
        "buses": rig.buses,
        "drives": rig.drives,
        "profiles": rig.drives.each_ref().map(|drive| drive.profile.get().map(|profile| &**profile)),
    });
    for drive in configuration["drives"].as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut) {
        drive.retain(|key, _| !matches!(key.as_str(), "waits" | "enabling_ms"));
    }
    configuration
}

/// Properties of a sensor on which the age of its force depends, apart from the delay of the loop.
fn sensor(rig: &config::Rig) -> Value {
    json!({ "bus": rig.sensor.bus, "protocol": rig.sensor.protocol, "sample_rate_hz": rig.sensor.sample_rate_hz })
}

fn path(configuration: &Value, folder: &Path) -> PathBuf {
    folder.join(format!("{:016x}.json", fnv1a(configuration.to_string().as_bytes())))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_record_is_of_its_configuration_and_of_every_gain() {
        let folder = std::env::temp_dir().join(format!("yieldwall-loops-{}", std::process::id()));
        let rig = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap().value;
        assert!(MeasuredLoop::load(&rig, &folder).unwrap().is_none());
        let joint =
            JointFound { inertia_kg_m2: 0.4, pose_rad: [2.0, 0.7], delay_s: 1.001e-3, viscous_n_m_s_per_rad: 0.5 };
        let force = ForceFound { between_s: [1.9e-3, 2.1e-3], mass_kg: 0.3 };
        let measured = MeasuredLoop::new(&rig, [joint; 2], Some(force));
        assert_eq!(measured.force(&rig), Some(force));
        let path = measured.store(&folder).unwrap();
        assert_eq!(MeasuredLoop::load(&rig, &folder).unwrap(), Some(measured.clone()));
        let mut other = rig.clone();
        other.control.law = config::ControlLaw::Pid;
        other.sensor.sample_rate_hz = config::Positive::new(500.0).unwrap();
        let of_other = MeasuredLoop::load(&other, &folder).unwrap().unwrap();
        assert_eq!(of_other.force(&other), None, "another sensor has another age");
        other.cycle.compute_at_us += 10;
        assert!(MeasuredLoop::load(&other, &folder).unwrap().is_none());
        // One of before ages were identified.
        let mut earlier: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        earlier.as_object_mut().unwrap().remove("force").unwrap();
        fs::write(&path, earlier.to_string()).unwrap();
        assert_eq!(MeasuredLoop::load(&rig, &folder).unwrap().unwrap().force(&rig), None);
        #[cfg(all(feature = "ethernet", target_os = "linux"))]
        {
            crate::sample::let_others_write(&path);
            let refused = MeasuredLoop::load(&rig, &folder).unwrap_err();
            assert!(refused.to_string().contains("`chmod go-w "), "{refused}");
            measured.store(&folder).unwrap();
        }
        fs::write(&path, "{").unwrap();
        assert!(MeasuredLoop::load(&rig, &folder).is_err());
        fs::remove_dir_all(&folder).unwrap();
    }
}
