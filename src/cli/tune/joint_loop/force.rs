//! Text on the age of the force and on the handle.

use serde_json::{Value, json};

use super::{not_identified, plus_minus};
use yieldwall_config::Rig;
use yieldwall_motion::identification::{Handle, NotIdentified};
use yieldwall_rig::analysis::{believed_age_s, later_s};
use yieldwall_run::{ForceFound, JointLoop};

/// Advice for a sensor that carries too little mass to show the age of its force.
const WEIGHT: &str = "fix a weight of about 0.3 kg to the handle, beyond the sensor, and measure again";
/// Masses that differ by less, kg, or by less than this share, are the same.
const SAME_KG: f64 = 0.01;
const SAME_SHARE: f64 = 0.05;

/// Returns the identified values of a joint, as labels with their values.
pub(super) fn lines(handle: &Result<Handle, NotIdentified>) -> Vec<(&'static str, String)> {
    let handle = match handle {
        Ok(handle) => handle,
        Err(error) => return not_identified("force", "age ", error),
    };
    let [low, high] = handle.between_s.map(|age| 1e3 * age);
    vec![
        ("force", format!("age {} ms after the angles of its cycle", plus_minus(&handle.age_s, 1e3, 3))),
        ("", format!("age between {low:.2} and {high:.2} ms, with the zero-order hold")),
        ("handle", format!("{} kg beyond the sensor", plus_minus(&handle.mass_kg, 1.0, 4))),
    ]
}

/// Returns the conclusions for the rig file.
pub(super) fn advice(found: &[&JointLoop], rig: &Rig) -> Vec<String> {
    let Some(force) = ForceFound::of(found) else {
        let feels_too_little = |joint: &&JointLoop| matches!(joint.handle, Err(NotIdentified::NoHandle { .. }));
        let words =
            format!("the age of the force is not identified, and the masses use the value of the rig file: {WEIGHT}");
        return if found.iter().any(feels_too_little) { vec![words] } else { Vec::new() };
    };
    let mut lines = Vec::new();
    if let (Ok([least, most]), Ok(later)) = (believed_age_s(rig), later_s(rig, &force)) {
        let [least, most, later, oldest] = [least, most, later, force.between_s[1]].map(|age| 1e3 * age);
        let believed = format!("age of the force: up to {oldest:.2} ms (rig file: {least:.2} to {most:.2} ms)");
        lines.push(if later > 0.0 {
            format!("{believed}; the virtual masses below add {later:.2} ms")
        } else {
            believed
        });
    }
    let (is, file) = (force.mass_kg, rig.sensor.handle_mass_kg.get());
    if (is - file).abs() > SAME_KG.max(SAME_SHARE * file) {
        lines.push(format!(
            "`sensor.handle_mass_kg` is {file}, but {is:.3} kg move beyond the sensor: write {is:.3}, unless you added a weight to measure"
        ));
        lines.push(
            "the inertia above includes an added weight: measure the gains without it; a heavier handle needs heavier virtual masses than those \
             below, which `yieldwall tune fixture` prints"
                .to_owned(),
        );
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
