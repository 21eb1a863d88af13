//! Text on the age of the force and on the handle.

use serde_json::{Value, json};

use super::plus_minus;
use yieldwall_config::Rig;
use yieldwall_motion::identification::{Handle, NotIdentified};
use yieldwall_rig::analysis::{believed_age_s, later_s};
use yieldwall_run::{ForceFound, JointLoop};

/// Advice for a sensor that carries too little mass to show the age of its force.
const WEIGHT: &str = "fix a weight of some 0.3 kg to the handle, beyond the sensor, and begin again";
/// Masses that differ by less, kg, or by less than this share, are the same.
const SAME_KG: f64 = 0.01;
const SAME_SHARE: f64 = 0.05;

/// Returns the identified values of a joint.
pub(super) fn line(handle: &Result<Handle, NotIdentified>) -> String {
    let handle = match handle {
        Ok(handle) => handle,
        Err(error) => return format!("force     its age is not identified: {error}"),
    };
    let [low, high] = handle.between_s.map(|age| 1e3 * age);
    format!(
        "force     {} ms older than the angles of its cycle, from {low:.2} to {high:.2} ms with what the hold hides; {} kg beyond the sensor",
        plus_minus(&handle.age_s, 1e3, 3),
        plus_minus(&handle.mass_kg, 1.0, 4)
    )
}

/// Returns the conclusions for the rig file.
pub(super) fn advice(found: &[&JointLoop], rig: &Rig) -> Vec<String> {
    let Some(force) = ForceFound::of(found) else {
        let feels_too_little = |joint: &&JointLoop| matches!(joint.handle, Err(NotIdentified::NoHandle { .. }));
        let words =
            format!("age of the force: not identified, and taken from what the rig file says of its sensor; {WEIGHT}");
        return if found.iter().any(feels_too_little) { vec![words] } else { Vec::new() };
    };
    let mut lines = Vec::new();
    if let (Ok([least, most]), Ok(later)) = (believed_age_s(rig), later_s(rig, &force)) {
        let [least, most, later, oldest] = [least, most, later, force.between_s[1]].map(|age| 1e3 * age);
        let believed = format!("by what the rig file says of sensor and bus it is {least:.2} to {most:.2} ms");
        lines.push(if later > 0.0 {
            format!("age of the force: up to {oldest:.2} ms, and {believed}; the virtual masses count with {later:.2} ms more")
        } else {
            format!("age of the force: up to {oldest:.2} ms; {believed}, which that does not contradict")
        });
    }
    let (is, file) = (force.mass_kg, rig.sensor.handle_mass_kg.get());
    if (is - file).abs() > SAME_KG.max(SAME_SHARE * file) {
        lines.push(format!(
            "`sensor.handle_mass_kg` has {file}, and {is:.3} kg move beyond the sensor: write that, unless a weight was put there to measure; the \
             inertia above has a weight too, so measure the gains without it; the virtual masses below count with {file}, and a heavier handle needs \
             heavier ones: `yieldwall tune fixture` prints them"
        ));
    }
    lines
}

/// Returns the identified values of a joint as data.
pub(super) fn handle_json(handle: &Result<Handle, NotIdentified>) -> Value {
    let estimate = super::estimate_json;
    match handle {
        Ok(handle) => json!({
            "age_s": estimate(&handle.age_s),
            "between_s": handle.between_s,
            "low_pass_s": handle.lag_s,
            "handle_mass_kg": estimate(&handle.mass_kg),
            "misfit": handle.misfit,
        }),
        Err(_) => Value::Null,
    }
}

/// Returns the conclusions for the rig file as data.
pub(super) fn json(found: &[&JointLoop], rig: &Rig) -> Value {
    let force = ForceFound::of(found);
    json!({
        "between_s": force.map(|force| force.between_s),
        "believed_between_s": believed_age_s(rig).ok(),
        "later_s": force.and_then(|force| later_s(rig, &force).ok()),
    })
}
