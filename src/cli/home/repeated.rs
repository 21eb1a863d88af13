//! By how much references shift from one homing to the next, in words and numbers.

use serde_json::{Value, json};

use super::Plan;
use crate::failure::{Exit, Failure};
use yieldwall_config as config;
use yieldwall_motion::identification::Estimate;
use yieldwall_run::assembly::scaling;
use yieldwall_run::{NoShift, Repeated};

/// Shifts of the references of the joints that were homed more than once.
pub(super) struct Shifts {
    joints: [Option<OfJoint>; 2],
}

/// Shifts of one joint.
struct OfJoint {
    shifts_rad: Vec<f64>,
    counts_per_rad: f64,
    /// Standard deviation of the shifts, rad; none of a single one.
    deviation_rad: Option<f64>,
    /// The greatest shift, rad.
    greatest_rad: f64,
    /// Standard deviation of the home positions, without a steady drift.
    home: Option<Estimate>,
    /// Last home position minus the first one, rad.
    drift_rad: f64,
}

impl OfJoint {
    fn new(drive: &config::Drive, shifts_rad: &[f64]) -> Option<Self> {
        let counts_per_rad = scaling(drive).ok()?.counts_per_rad();
        // Home positions, relative to the first one.
        let mut homes = vec![0.0];
        homes.extend(shifts_rad.iter().scan(0.0, |home, shift| {
            *home += shift;
            Some(*home)
        }));
        Some(Self {
            counts_per_rad,
            deviation_rad: deviation(shifts_rad),
            greatest_rad: shifts_rad.iter().fold(0.0, |greatest: f64, shift| greatest.max(shift.abs())),
            home: Estimate::scatter(&homes),
            drift_rad: homes.last().copied().unwrap_or_default(),
            shifts_rad: shifts_rad.to_vec(),
        })
    }

    /// Returns the uncertainty of the drift, rad: each shift is known to one count, and all of them may have the same error.
    fn drift_known_to_rad(&self) -> f64 {
        self.shifts_rad.len() as f64 / self.counts_per_rad
    }
}

/// Standard deviation of some values, of two at least.
fn deviation(values: &[f64]) -> Option<f64> {
    let degrees = values.len().checked_sub(1).filter(|degrees| *degrees > 0)? as f64;
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    Some((values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / degrees).sqrt())
}

impl Shifts {
    /// Returns the shifts of an act that homed more than once; `None` for any other act.
    pub(super) fn of(plan: &Plan, rig: &config::Rig, repeated: &Repeated) -> Option<Self> {
        if plan.times < 2 {
            return None;
        }
        let of = |joint: usize| {
            let shifts = repeated.shifts_rad.get(joint).filter(|shifts| !shifts.is_empty())?;
            OfJoint::new(rig.drives.get(joint)?, shifts)
        };
        Some(Self { joints: [of(0), of(1)] })
    }

    /// Lines for a person.
    pub(super) fn lines(&self, rig: &config::Rig, within_rad: Option<f64>) -> String {
        let mut text = String::new();
        for (drive, joint) in rig.drives.iter().zip(&self.joints) {
            let Some(joint) = joint else { continue };
            let angle = |rad: f64| {
                format!("{:.4} deg ({:.6} rad, {:.1} counts)", rad.to_degrees(), rad, rad * joint.counts_per_rad)
            };
            let limit = within_rad.map_or(String::new(), |limit| format!(" (limit {:.4} deg)", limit.to_degrees()));
            text.push_str(&format!("repeated  {}: {} homings\n", drive.name, joint.shifts_rad.len() + 1));
            text.push_str(&format!("          largest shift: {}{limit}\n", angle(joint.greatest_rad)));
            if let Some(deviation_rad) = joint.deviation_rad {
                text.push_str(&format!("          std dev of shifts: {}\n", angle(deviation_rad)));
            }
            if let Some(home) = joint.home {
                text.push_str(&format!(
                    "          std dev of home: {:.4} deg (95 % interval {:.4} to {:.4} deg)\n",
                    home.value.to_degrees(),
                    home.low.to_degrees(),
                    home.high.to_degrees()
                ));
            }
            text.push_str(&format!(
                "          last home minus first: {:.4} deg (uncertainty {:.4} deg)\n",
                joint.drift_rad.to_degrees(),
                joint.drift_known_to_rad().to_degrees()
            ));
        }
        text
    }

    /// Checks that the shifts are known, and within the requested limit.
    pub(super) fn judge(&self, plan: &Plan, rig: &config::Rig, repeated: &Repeated) -> Result<(), Failure> {
        let name = |joint: usize| rig.drives.get(joint).map_or("", |drive| drive.name.as_str());
        if let Some((joint, why)) = repeated.unknown {
            return Err(unknown(name(joint), why));
        }
        let Some(within_rad) = plan.within_rad else { return Ok(()) };
        let greatest = |joint: &OfJoint| joint.greatest_rad;
        let beyond =
            self.joints.iter().position(|joint| joint.as_ref().map(greatest).is_some_and(|it| it > within_rad));
        let Some(joint) = beyond else { return Ok(()) };
        let greatest_rad = self.joints[joint].as_ref().map_or(0.0, greatest);
        let message = format!(
            "the reference of {} shifts by {:.4} deg from one homing to the next (limit {:.4} deg)",
            name(joint),
            greatest_rad.to_degrees(),
            within_rad.to_degrees()
        );
        let help = "check for a loose switch, encoder disc or coupling; a lower `homing.rate_rad_per_s` shows whether the drive latches home in time";
        Err(Failure::new(Exit::OutOfTolerance, message, help))
    }

    /// Returns the shifts of a joint as data.
    pub(super) fn document(&self, joint: usize) -> Option<Value> {
        let joint = self.joints.get(joint)?.as_ref()?;
        let counts = |rad: f64| rad * joint.counts_per_rad;
        Some(json!({
            "shifts_rad": joint.shifts_rad,
            "deviation_rad": joint.deviation_rad,
            "deviation_counts": joint.deviation_rad.map(counts),
            "greatest_rad": joint.greatest_rad,
            "greatest_counts": counts(joint.greatest_rad),
            "home_deviation_rad": joint.home.map(|home| json!({ "value": home.value, "low": home.low, "high": home.high })),
            "drift_rad": joint.drift_rad,
            "drift_known_to_rad": joint.drift_known_to_rad(),
        }))
    }
}

/// Explains why the shifts of a joint are not known.
fn unknown(name: &str, why: NoShift) -> Failure {
    let (message, help) = match why {
        NoShift::NoJump => (
            format!("{name} is homed, but its position did not jump: the moment of its new reference is unknown"),
            "switch the drives off and on, so that they count from another position; move the arm by hand to where home lies ahead, and try again",
        ),
        NoShift::TooNear(way_rad) => (
            format!(
                "{name} is homed, but began only {:.2} deg from home, too near to reach its rate",
                way_rad.to_degrees()
            ),
            "move the arm by hand farther from home, against the homing direction; power-cycle the drives, and try again",
        ),
        NoShift::NoPositions => (
            format!("{name} is homed, but positions are missing at the moment of its new reference"),
            "check the cable and the bus load, and try again",
        ),
    };
    Failure::new(Exit::OutOfTolerance, message, help)
}
