//! Checks of scenes, alone and with the machine that runs them.

use super::Findings;
use super::words::{round, shorten_numbers};
use crate::injection::{DefectError, InjectionError};
use crate::number::Finite;
use crate::tree::{CommandMode, ImpedanceDevice, PathSegment, Rig, Scene, Tracking};
use yieldwall_motion::elementary;
use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::TipPoint;

/// Longest run, s: the program keeps every cycle of it in memory.
pub const MAX_DURATION_S: f64 = 3600.0;
/// Highest upper edge of a tremor, Hz: the simulation draws it on a grid of 1 ms, and it carries a tenth of that rate.
const MAX_TREMOR_HZ: f64 = 100.0;
/// Highest corner of the error of an aim, Hz: half of the limit of a tremor.
const MAX_AIM_HZ: f64 = 50.0;
/// Largest error of an aim, m RMS on each axis: a person who traces a line by eye errs by millimetres, in haste by about 20 mm.
const MAX_AIM_ERROR_M: f64 = 0.05;
/// Damping ratio of human arms: mean and standard deviation over postures and torques.
///
/// # Source
/// Perreault, Kirsch and Crago, *Multijoint dynamics and postural stability of the human arm*, Experimental Brain Research 157
/// (2004).
const ARM_DAMPING_RATIO: [f64; 2] = [0.26, 0.08];
/// Smallest plausible damping ratio: a hand below it oscillates as no arm does.
const LEAST_DAMPING_RATIO: f64 = 0.15;
/// Least distance of the start of an arc from its centre, m.
const MIN_ARC_RADIUS_M: f64 = 1e-9;

/// Largest mass of a hand, kg. An arm acts with 0.5 to 3 kg at the tool.
const MAX_HAND_KG: f64 = 100.0;
/// Largest stiffness of a hand, N/m. Arms reach some 3000 N/m; beyond this limit the tool is clamped, not held.
const MAX_HAND_N_PER_M: f64 = 1e5;
/// Largest damping of a hand, N s/m: above the critical damping of the largest mass at the largest stiffness.
const MAX_HAND_N_S_PER_M: f64 = 1e4;

/// Machine that runs a scene.
#[derive(Clone, Copy)]
pub(crate) enum Machine<'a> {
    Rig(&'a Rig),
    Device(&'a ImpedanceDevice),
}

/// Rules of a scene alone.
pub(crate) fn check_scene(findings: &mut Findings, scene: &Scene) {
    let duration = *scene.duration_s;
    if duration > MAX_DURATION_S {
        let message = format!("`duration_s` is {duration} s, above {MAX_DURATION_S} s");
        findings.error("duration_s", message, "write a shorter run; every cycle of it is kept in memory");
    }
    for (index, fault) in scene.faults.iter().enumerate() {
        if let Err(error) = fault.injection() {
            let key = match error {
                InjectionError::Medium { .. } => ".inject",
                InjectionError::Target { .. } => ".target",
                InjectionError::Size { .. } | InjectionError::NoSize { .. } => ".size",
                InjectionError::Duration { .. } | InjectionError::NoDuration { .. } => ".for_s",
                InjectionError::Start { .. } => ".at_s",
            };
            let help = "`yieldwall faults NAME` says what it takes; leave the key out for the usual";
            findings.error(&format!("faults[{index}]{key}"), error.to_string(), help);
        }
    }
    for (index, defect) in scene.defects.iter().enumerate() {
        if let Err(error) = defect.defect() {
            let key = if matches!(error, DefectError::TextSpan { .. }) { "drive" } else { "size" };
            let help = "`yieldwall commission --defect list` says what it takes; leave the key out for the usual";
            findings.error(&format!("defects[{index}].{key}"), error.to_string(), help);
        }
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
    check_arcs(findings, scene);
    check_noise(findings, scene);
    if check_hand(findings, scene) {
        check_damping(findings, scene);
    }
    check_model(findings, scene);
}

/// Checks that a person could have the hand, and returns whether one could. Larger values are most often in another unit.
fn check_hand(findings: &mut Findings, scene: &Scene) -> bool {
    let hand = &scene.hand;
    let mut is_of_person = true;
    for (key, value, most, unit, help) in [
        ("mass_kg", *hand.mass_kg, MAX_HAND_KG, "kg", "write kilograms: an arm acts with 0.5 to 3 kg at the tool"),
        (
            "stiffness_n_per_m",
            *hand.stiffness_n_per_m,
            MAX_HAND_N_PER_M,
            "N/m",
            "write N/m: arms have 100 to 3000 N/m, and a stiffer hand is a clamp",
        ),
        (
            "damping_n_s_per_m",
            *hand.damping_n_s_per_m,
            MAX_HAND_N_S_PER_M,
            "N s/m",
            "write N s/m: arms have 5 to 100 N s/m",
        ),
    ] {
        if value > most {
            is_of_person = false;
            let message = format!("`hand.{key}` is {value} {unit}, above {most} {unit}");
            findings.error(&format!("hand.{key}"), message, help);
        }
    }
    is_of_person
}

/// Checks that the hand is damped like an arm: an undamped hand makes rigs oscillate that no person would.
fn check_damping(findings: &mut Findings, scene: &Scene) {
    let hand = &scene.hand;
    let (stiffness, damping, mass) = (*hand.stiffness_n_per_m, *hand.damping_n_s_per_m, *hand.mass_kg);
    let critical = 2.0 * (stiffness * mass).sqrt();
    if damping >= LEAST_DAMPING_RATIO * critical {
        return;
    }
    let [mean, deviation] = ARM_DAMPING_RATIO;
    let message = format!(
        "`hand.damping_n_s_per_m` is {damping} N s/m: with {stiffness} N/m and {mass} kg a damping ratio of {:.2}; arms of \
         people have {mean} +- {deviation}",
        damping / critical
    );
    let help = format!("write {} for that ratio, unless the hand is meant to ring", round(mean * critical));
    findings
        .warning("hand.damping_n_s_per_m", message, help)
        .see("hand.stiffness_n_per_m", "the stiffness")
        .see("hand.mass_kg", "the mass");
}

/// Checks the random parts of a hand.
fn check_noise(findings: &mut Findings, scene: &Scene) {
    if let Some(tremor) = scene.hand.tremor {
        let (low, high) = (*tremor.low_hz, *tremor.high_hz);
        if low >= high {
            let message = format!("`hand.tremor.low_hz` is {low} Hz, not below `hand.tremor.high_hz` of {high} Hz");
            findings
                .error("hand.tremor.low_hz", message, "a hand trembles at about 8 to 12 Hz")
                .see("hand.tremor.high_hz", "high_hz");
        }
        if high > MAX_TREMOR_HZ {
            let message =
                format!("`hand.tremor.high_hz` is {high} Hz, above the {MAX_TREMOR_HZ} Hz that are simulated");
            findings.error("hand.tremor.high_hz", message, "a hand trembles at about 8 to 12 Hz");
        }
    }
    if let Some(error) = scene.hand.aim_error {
        if *error.rms_m > MAX_AIM_ERROR_M {
            let message = format!("`hand.aim_error.rms_m` is {} m, above {MAX_AIM_ERROR_M} m", *error.rms_m);
            let help = "write metres: a person who traces a line by eye errs by some 0.005, in haste by 0.02";
            findings.error("hand.aim_error.rms_m", message, help);
        }
        if *error.corner_hz > MAX_AIM_HZ {
            let message = format!("`hand.aim_error.corner_hz` is {} Hz, above {MAX_AIM_HZ} Hz", *error.corner_hz);
            findings.error("hand.aim_error.corner_hz", message, "people move by intent below some 2 Hz");
        }
    }
}

/// Checks that a scene has one model, and the own rules of that model.
fn check_model(findings: &mut Findings, scene: &Scene) {
    let help = "write `model` for a rig, whose hand moves in the plane, or `device_model: {plant_step_us: ..}` for an \
                impedance device";
    match (&scene.model, &scene.device_model) {
        (None, None) => {
            findings.error("hand", "the scene has neither `model` nor `device_model`", help);
        }
        (Some(_), Some(_)) => {
            let message = "the scene has `model` and `device_model`: they are for different machines";
            findings.error("device_model", message, help).see("model", "model");
        }
        _ => {}
    }
    let Some(model) = scene.model else { return };
    let Some(gear) = model.joint_elasticity else { return };
    let key = "model.joint_elasticity";
    if *gear.motor_share >= 1.0 {
        let key = format!("{key}.motor_share");
        let message = format!("`{key}` is {}, not below 1: nothing is left behind the gear", *gear.motor_share);
        findings.error(&key, message, "write the part of the inertia before the gear, such as 0.6");
    }
    if model.tracking == Tracking::Ideal {
        let message =
            format!("`{key}` is given, and with `model.tracking` ideal there is no arm that could have gears");
        findings
            .error(key, message, "write `joint_elasticity: null`, or `tracking: rigid`")
            .see("model.tracking", "ideal");
    }
}

/// A segment of a path in the plane, except a wait.
struct Leg {
    /// Its key, without the last part.
    key: String,
    is_arc: bool,
    /// Radius of an arc, m.
    radius_m: f64,
    /// End of the segment, m.
    end_m: [f64; 2],
    length_m: f64,
    in_s: f64,
}

/// The segments of a path, as far as they have coordinates.
fn legs(scene: &Scene) -> Vec<Leg> {
    let plane = |point: &[Finite]| match point {
        [x, y, ..] => Some([**x, **y]),
        _ => None,
    };
    let mut legs = Vec::new();
    let Some(mut here) = plane(&scene.hand.start_m) else { return legs };
    for (index, segment) in scene.hand.path.iter().enumerate() {
        let leg = match segment {
            PathSegment::To { point_m, in_s } => plane(point_m).map(|end_m| Leg {
                key: format!("hand.path[{index}].to"),
                is_arc: false,
                radius_m: f64::INFINITY,
                end_m,
                length_m: elementary::hypot(end_m[0] - here[0], end_m[1] - here[1]),
                in_s: **in_s,
            }),
            PathSegment::Arc { center_m, by_rad, in_s, .. } => plane(center_m).map(|[center_x, center_y]| {
                let (x, y) = (here[0] - center_x, here[1] - center_y);
                let (sine, cosine) = elementary::sin_cos(**by_rad);
                let radius_m = elementary::hypot(x, y);
                Leg {
                    key: format!("hand.path[{index}].arc"),
                    is_arc: true,
                    radius_m,
                    end_m: [center_x + cosine * x - sine * y, center_y + sine * x + cosine * y],
                    length_m: radius_m * by_rad.abs(),
                    in_s: **in_s,
                }
            }),
            PathSegment::Wait { .. } | PathSegment::LetGo { .. } => continue,
        };
        let Some(leg) = leg else { break };
        here = leg.end_m;
        legs.push(leg);
    }
    legs
}

/// Whether every arc starts away from its centre.
fn check_arcs(findings: &mut Findings, scene: &Scene) {
    if let Some(leg) = legs(scene).iter().find(|leg| leg.radius_m < MIN_ARC_RADIUS_M) {
        let key = format!("{}.center_m", leg.key);
        let message = format!("`{key}` is where the arc starts: it has no radius");
        findings.error(&key, message, "end the segment before it elsewhere, or move the centre");
    }
}

/// Checks that a rig can follow the hand. It reports a spring force beyond the force limit even if the arm comes as far as it
/// can, and an aim faster than the tool may move.
fn check_path(findings: &mut Findings, scene: &Scene, rig: &Rig) {
    let hand = &scene.hand;
    let (radius_m, limit_n) = (*rig.linkage.working_radius_m, *rig.guard.force_limit_n);
    let strength_n = hand.voluntary_force_limit_n.map_or(f64::INFINITY, |limit| *limit);
    let speed_limit = *rig.guard.tool_speed_limit_m_per_s;
    for leg in legs(scene) {
        let [x, y] = leg.end_m;
        let beyond_m = elementary::hypot(x, y) - radius_m;
        let pull_n = *hand.stiffness_n_per_m * beyond_m;
        if pull_n > limit_n && beyond_m > radius_m {
            let key = format!("{}.{}", leg.key, if leg.is_arc { "center_m" } else { "point_m" });
            let force =
                if pull_n > strength_n { format!("all its {strength_n} N") } else { format!("{} N", round(pull_n)) };
            let message = format!(
                "`{key}` leads the hand to ({}, {}) m, and the rig's working disc ends at {radius_m} m: there it pulls with {force}",
                round(x),
                round(y)
            );
            findings.warning(&key, message, "write metres, and lead the hand not far beyond the working disc");
            // What follows from here starts there.
            return;
        }
        let speed = leg.length_m / leg.in_s;
        if speed > speed_limit {
            let key = format!("{}.in_s", leg.key);
            let message = format!(
                "`{key}` is {} s: the hand leads with {} m/s, and the rig's `guard.tool_speed_limit_m_per_s` is {speed_limit} m/s",
                leg.in_s,
                round(speed)
            );
            findings.warning(&key, message, "give it more time; arcs are in rad, points in m, times in s");
        }
    }
}

fn check_dimension(findings: &mut Findings, scene: &Scene) {
    let dimension = scene.hand.start_m.len();
    for (index, segment) in scene.hand.path.iter().enumerate() {
        let (name, point) = match segment {
            PathSegment::To { point_m, .. } => ("to.point_m", point_m),
            PathSegment::Arc { center_m, .. } => ("arc.center_m", center_m),
            PathSegment::Wait { .. } | PathSegment::LetGo { .. } => continue,
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
pub(crate) fn check_scene_for(findings: &mut Findings, scene: &Scene, machine: Machine<'_>) {
    let (name, dimension, period_us) = match machine {
        Machine::Rig(rig) => ("a rig", 2, rig.cycle.period_us),
        Machine::Device(device) => ("an impedance device", 3, device.cycle.period_us),
    };
    if !check_model_for(findings, scene, machine) {
        return;
    }
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
    check_step(findings, scene, period_us);
    if let (Machine::Device(_), [_, ..]) = (machine, scene.faults.as_slice()) {
        let message = "the scene has `faults`, and an impedance device has no bus on which they could happen";
        findings.error("faults", message, "leave `faults` out, or run the scene on a rig");
    }
    if let (Machine::Device(_), [_, ..]) = (machine, scene.defects.as_slice()) {
        let message = "the scene has `defects`, and an impedance device is not commissioned";
        findings.error("defects", message, "leave `defects` out, or run the scene on a rig");
    }
    if let Machine::Rig(rig) = machine {
        check_start(findings, scene, rig);
        check_path(findings, scene, rig);
        check_media(findings, scene, rig);
        check_defects(findings, scene, rig);
    }
}

/// Whether each injection of a scene means something on the buses of a rig.
fn check_media(findings: &mut Findings, scene: &Scene, rig: &Rig) {
    for (index, fault) in scene.faults.iter().enumerate() {
        let Ok(injection) = fault.injection() else { continue };
        if let Err(error) = injection.check_on(rig.medium(&injection)) {
            let help = "leave it out, or write another one; `yieldwall faults NAME` says where it acts";
            findings.error(&format!("faults[{index}].inject"), error.to_string(), help);
        }
    }
}

/// Whether each defect of a scene means something on a rig.
fn check_defects(findings: &mut Findings, scene: &Scene, rig: &Rig) {
    for (index, defect) in scene.defects.iter().enumerate() {
        if let Some([why, which]) = rig.excludes(defect.defect.0) {
            let message = format!("`{}` means nothing here: {why}", defect.defect.0.row().name);
            findings.error(&format!("defects[{index}].defect"), message, format!("leave it out, or try it on {which}"));
        }
    }
}

fn check_step(findings: &mut Findings, scene: &Scene, period_us: u32) {
    let Some(step) = scene.plant_step_us() else { return };
    if step > 0 && !period_us.is_multiple_of(step) {
        let key = if scene.model.is_some() { "model.plant_step_us" } else { "device_model.plant_step_us" };
        let why = if step > period_us { "is shorter" } else { "is not a multiple of it" };
        findings.error(
            key,
            format!("`{key}` is {step} us, and the control period of {period_us} us {why}"),
            match (1..=step.min(period_us)).rev().find(|shorter| period_us.is_multiple_of(*shorter)) {
                Some(divisor) => format!("write a divisor of the period, such as {divisor}"),
                None => "write a divisor of the period".to_owned(),
            },
        );
    }
}

/// Checks that the scene is for this machine, and then that its model fits.
fn check_model_for(findings: &mut Findings, scene: &Scene, machine: Machine<'_>) -> bool {
    match (machine, &scene.model, &scene.device_model) {
        (Machine::Rig(_), None, Some(_)) => {
            let help = "write `model` with tracking, encoder and force sensor, or choose another scene";
            let message = "`device_model` is for an impedance device, and a rig runs this scene";
            findings.error("device_model", message, help);
            false
        }
        (Machine::Device(_), Some(_), None) => {
            let message = "`model` is for a rig, and an impedance device runs this scene: it has neither encoders, gears \
                           nor force sensor";
            let help = "write `device_model: {plant_step_us: ..}` in its place, or choose another scene";
            findings.error("model", message, help);
            false
        }
        (Machine::Rig(rig), Some(model), _) => {
            if model.tracking == Tracking::Ideal && rig.rig.command_mode != CommandMode::Position {
                let message = "`model.tracking` is ideal, and the rig that runs this scene does not command positions: a \
                               torque or a rate moves nothing where there is no arm";
                let help = "write `tracking: rigid`, or `command_mode: position` in the rig";
                findings.error("model.tracking", message, help);
            }
            true
        }
        _ => true,
    }
}

fn check_start(findings: &mut Findings, scene: &Scene, rig: &Rig) {
    let [x, y] = scene.hand.start_m.as_slice() else { return };
    let tip = TipPoint::new(**x, **y);
    let Ok(five_bar) = FiveBar::new(rig.linkage.geometry()) else { return };
    if let Err(error) = five_bar.inverse(tip) {
        let message = format!("the arm does not reach `hand.start_m`: {}", shorten_numbers(&error.to_string()));
        findings.error("hand.start_m", message, "start inside the working disc of the rig");
    }
}
