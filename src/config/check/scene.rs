//! Scenes, alone and with the machine that runs them.

use super::Findings;
use super::words::{round, shorten_numbers};
use crate::config::tree::{EncoderModel, ForceSensorModel, ImpedanceDevice, PathSegment, Rig, Scene, Tracking};
use crate::linkage::FiveBar;
use crate::quantity::TipPoint;

/// Longest run, s.
const MAX_DURATION_S: f64 = 3600.0;

/// What runs a scene.
#[derive(Clone, Copy)]
pub(in crate::config) enum Machine<'a> {
    Rig(&'a Rig),
    Device(&'a ImpedanceDevice),
}

/// Rules of a scene alone.
pub(in crate::config) fn check_scene(findings: &mut Findings, scene: &Scene) {
    let duration = *scene.duration_s;
    if duration > MAX_DURATION_S {
        let message = format!("`duration_s` is {duration} s, above {MAX_DURATION_S} s");
        findings.error("duration_s", message, "write a shorter run; every cycle of it is kept in memory");
    }
    let path_s: f64 = scene.hand.path.iter().map(PathSegment::duration_s).sum();
    if path_s > duration + 1e-9 {
        findings
            .warning(
                "duration_s",
                format!("`duration_s` is {duration} s, and `hand.path` takes {} s: its end is cut off", round(path_s)),
                "lengthen the run or shorten the path",
            )
            .see("hand.path", "path");
    }
    check_dimension(findings, scene);
    if let Some(tremor) = scene.hand.tremor
        && *tremor.low_hz >= *tremor.high_hz
    {
        findings
            .error(
                "hand.tremor.low_hz",
                format!(
                    "`hand.tremor.low_hz` is {} Hz, not below `hand.tremor.high_hz` of {} Hz",
                    *tremor.low_hz, *tremor.high_hz
                ),
                "a hand trembles at about 8 to 12 Hz",
            )
            .see("hand.tremor.high_hz", "high_hz");
    }
    if let Some(gear) = scene.model.joint_elasticity
        && *gear.motor_share >= 1.0
    {
        let key = "model.joint_elasticity.motor_share";
        let message = format!("`{key}` is {}, not below 1: nothing is left behind the gear", *gear.motor_share);
        findings.error(key, message, "write the part of the inertia before the gear, such as 0.6");
    }
}

fn check_dimension(findings: &mut Findings, scene: &Scene) {
    let dimension = scene.hand.start_m.len();
    for (index, segment) in scene.hand.path.iter().enumerate() {
        let (name, point) = match segment {
            PathSegment::To { point_m, .. } => ("to.point_m", point_m),
            PathSegment::Arc { center_m, .. } => ("arc.center_m", center_m),
            PathSegment::Wait { .. } => continue,
        };
        if point.len() != dimension {
            let key = format!("hand.path[{index}].{name}");
            findings
                .error(
                    &key,
                    format!("`{key}` has {} coordinates, and `hand.start_m` has {dimension}", point.len()),
                    "write two coordinates everywhere for a rig, three for an impedance device",
                )
                .see("hand.start_m", "start_m");
        }
    }
}

/// Rules of a scene with the machine that runs it.
pub(in crate::config) fn check_scene_for(findings: &mut Findings, scene: &Scene, machine: Machine<'_>) {
    let (name, dimension, period_us) = match machine {
        Machine::Rig(rig) => ("a rig", 2, rig.cycle.period_us),
        Machine::Device(device) => ("an impedance device", 3, device.cycle.period_us),
    };
    if scene.hand.start_m.len() != dimension {
        findings.error(
            "hand.start_m",
            format!(
                "`hand.start_m` has {} coordinates, and {name} moves in {dimension} dimensions",
                scene.hand.start_m.len()
            ),
            format!("write {dimension} coordinates here and in the path, or choose another scene"),
        );
    }
    let step = scene.model.plant_step_us;
    if step > 0 && !period_us.is_multiple_of(step) {
        findings.error(
            "model.plant_step_us",
            format!(
                "`model.plant_step_us` is {step} us, and the control period of {period_us} us is not a multiple of it"
            ),
            "write a divisor of the period, such as 100",
        );
    }
    match machine {
        Machine::Rig(rig) => check_start(findings, scene, rig),
        Machine::Device(_) => check_for_device(findings, scene),
    }
}

fn check_start(findings: &mut Findings, scene: &Scene, rig: &Rig) {
    let [x, y] = scene.hand.start_m.as_slice() else { return };
    let tip = TipPoint::new(**x, **y);
    let Ok(five_bar) = FiveBar::new(rig.linkage.geometry()) else { return };
    if let Err(error) = five_bar.inverse(tip) {
        let message = format!("the arm does not reach `hand.start_m`: {}", shorten_numbers(&error.to_string()));
        findings.error("hand.start_m", message, "start inside of the working disc of the rig");
    }
}

fn check_for_device(findings: &mut Findings, scene: &Scene) {
    let unused = [
        ("model.force_sensor", scene.model.force_sensor != ForceSensorModel::Exact, "has no force sensor", "exact"),
        ("model.joint_elasticity", scene.model.joint_elasticity.is_some(), "has no gears", "null"),
        ("model.tracking", scene.model.tracking == Tracking::Ideal, "has no position control", "rigid"),
    ];
    for (key, is_set, why, instead) in unused {
        if is_set {
            let message = format!("`{key}` has no effect: an impedance device {why}");
            findings.warning(key, message, format!("write {instead}"));
        }
    }
    // Both encoder models have a meaning: the device measures its position.
    let (EncoderModel::Exact | EncoderModel::Quantised) = scene.model.encoder;
}
