//! A newcomer's rig, fixed only by the advice of the messages.

use serde_json::{Value, json};

use super::checked::Checked;
use yieldwall_config::{Diagnostic, Source};

/// Returns a rig: links of 0.25 and 0.35 m, an ellipse through points whose inside is forbidden, 12 N, 500 Hz.
fn rig() -> Value {
    let point = |part: u32| {
        let (sine, cosine) = yieldwall_motion::elementary::sin_cos(std::f64::consts::TAU * f64::from(part) / 12.0);
        [0.09 * cosine, 0.06 * sine]
    };
    json!({
        "like": "builtin:paper-admittance.yaml",
        "rig": { "name": "my-rig" },
        "cycle": { "period_us": 2000, "compute_at_us": 1240 },
        "linkage": { "proximal_m": [0.25, 0.25], "distal_m": [0.35, 0.35] },
        "fixture": {
            "yield_n": 12.0,
            "side": "unilateral",
            "surface": { "closed_curve": { "points_m": (0..12).map(point).collect::<Vec<_>>(), "forbidden": "inside" } },
        },
        "simulation": { "scene": "scene.yaml" },
    })
}

/// Returns the scene of a stiff hand that approaches the ellipse, moves along it and leans on it.
fn scene() -> Value {
    json!({
        "duration_s": 8.0,
        "seed": 1,
        "model": {
            "tracking": "rigid", "plant_step_us": 100, "encoder": "quantised", "force_sensor": "quantised",
            "force_noise_counts": 0.0, "joint_elasticity": null,
        },
        "hand": {
            "mass_kg": 0.5, "stiffness_n_per_m": 3000.0, "damping_n_s_per_m": 8.0, "voluntary_force_limit_n": null,
            "tremor": null, "start_m": [0.115, 0.0],
            "path": [
                { "to": { "point_m": [0.088, 0.0], "in_s": 2.0 } },
                { "arc": { "center_m": [0.0, 0.0], "by_rad": 0.3, "in_s": 3.0, "speed": "constant" } },
                { "wait": { "for_s": 1.0 } },
            ],
        },
    })
}

fn source(rig: &Value, scene: &Value) -> Source {
    let files = [("rig.yaml", rig), ("scene.yaml", scene)];
    Source::among("rig.yaml", files.map(|(name, value)| (name.into(), value.to_string().into())))
}

/// Returns the key and value that a finding advises to write: the text after `write`, or in backquotes as `key: value`.
fn advised(finding: &Diagnostic) -> Option<(String, Value)> {
    let help = finding.help.as_deref()?;
    if let Some((_, after)) = help.split_once("write ").filter(|(_, after)| !after.starts_with('`')) {
        let number = after.split([' ', ',', ';']).next()?;
        return Some((finding.key.clone(), serde_json::from_str(number).ok()?));
    }
    let (_, quoted) = help.split_once('`')?;
    let (key, group) = quoted.split_once('`')?.0.split_once(": ")?;
    // A group of YAML in one line, whose keys are plain words.
    let entries = group.trim_matches(['{', '}']).split(", ").map(|entry| {
        let (key, value) = entry.split_once(": ")?;
        Some((key.to_owned(), serde_json::from_str(value).ok()?))
    });
    let group: Option<serde_json::Map<String, Value>> = entries.collect();
    let parent = finding.key.rsplit_once('.').map_or("", |(parent, _)| parent);
    Some((format!("{parent}.{key}"), Value::Object(group?)))
}

fn set(document: &mut Value, key: &str, value: Value) {
    let slot = key.split('.').fold(document, |inner, step| &mut inner[step]);
    *slot = value;
}

#[test]
fn a_newcomer_comes_to_a_rig_that_runs_by_what_the_messages_say_alone() {
    let (mut rig, mut scene) = (rig(), scene());
    let mut steps: Vec<String> = Vec::new();
    loop {
        let mut checked = Checked::of(source(&rig, &scene));
        checked.rehearse();
        let Some(finding) = checked.findings.first() else {
            let rehearsal = checked.rehearsal.unwrap();
            assert!(rehearsal.held_s == 0.0 && rehearsal.tracing_mm.unwrap() < 0.5, "{rehearsal:?}");
            break;
        };
        let (key, value) = advised(finding).unwrap_or_else(|| panic!("nothing to write: {finding:?}"));
        assert!(finding.place.is_some(), "{finding:?}");
        steps.push(format!("{key}: {value}"));
        assert!(steps.len() <= 6, "{steps:#?}");
        set(if finding.key.starts_with("hand.") { &mut scene } else { &mut rig }, &key, value);
    }
    let keys: Vec<&str> = steps.iter().map(|step| step.split(':').next().unwrap()).collect();
    assert_eq!(
        keys,
        ["sensor.sample_rate_hz", "linkage.working_radius_m", "hand.damping_n_s_per_m", "control.gains.joint"],
        "{steps:#?}"
    );
}
