//! Limits that the arm cannot reach, and numbers in a wrong unit: each is compared with the most that this arm can do.

use std::f64::consts::TAU;

use super::Findings;
use super::most::Most;
use super::words::round;
use crate::tree::{CommandMode, ControlGains, Coupling, Rig};

/// Longest time in which a rig may come to rest, s: the wait for it at the end of a run.
pub(super) const LONGEST_STOP_S: f64 = 2.0;
/// Smallest torque limit in per mille of the rated torque. Below it, the steps of the torque command are large enough to feel.
const LEAST_TORQUE_STEPS: f64 = 50.0;
/// Largest share of the torque limit that one count of an encoder may cause.
const MOST_OF_A_COUNT: f64 = 0.25;

/// Checks that limits are effective, and that counts are fine enough.
pub(super) fn check_guards(findings: &mut Findings, rig: &Rig) {
    check_limits(findings, rig);
    check_stop(findings, rig);
    check_torque_steps(findings, rig);
    check_angle_steps(findings, rig);
    check_force_steps(findings, rig);
    check_turns(findings, rig);
}

/// Warns about a limit that the arm cannot reach: it has no effect.
fn check_limits(findings: &mut Findings, rig: &Rig) {
    let Some(most) = Most::of(rig) else { return };
    let guard = &rig.guard;
    let (torque, force) = (*guard.torque_limit_n_m, *guard.force_limit_n);
    let at_torque_limit = |what| format!("at its torque limit this arm {what} than");
    let torque_key = ("guard.torque_limit_n_m", "torque limit");
    for (name, limit, most, unit, what, see) in [
        (
            "joint_speed_limit_rad_per_s",
            Some(*guard.joint_speed_limit_rad_per_s),
            most.joint_speed_rad_per_s,
            "rad/s",
            at_torque_limit("turns no joint faster"),
            torque_key,
        ),
        (
            "tool_speed_limit_m_per_s",
            Some(*guard.tool_speed_limit_m_per_s),
            most.tool_speed_m_per_s,
            "m/s",
            at_torque_limit("moves the tool no faster"),
            torque_key,
        ),
        (
            "following_error_limit_rad",
            Some(*guard.following_error_limit_rad),
            most.turn_rad,
            "rad",
            at_torque_limit("turns no joint farther within its working disc"),
            torque_key,
        ),
        (
            "energy_limit_j",
            Some(*guard.energy_limit_j),
            most.energy_j,
            "J",
            at_torque_limit("does no more work all across its working disc"),
            torque_key,
        ),
        (
            "stop_deceleration_m_per_s2",
            Some(*guard.stop_deceleration_m_per_s2),
            most.acceleration_m_per_s2,
            "m/s^2",
            at_torque_limit("brakes no harder"),
            torque_key,
        ),
        (
            "force_step_limit_n",
            Some(*guard.force_step_limit_n),
            2.0 * force,
            "N",
            format!("no two forces within `guard.force_limit_n` of {force} N are farther apart than"),
            ("guard.force_limit_n", "force limit"),
        ),
        (
            "residual_limit_n_m",
            guard.residual_limit_n_m.map(|limit| *limit),
            torque + most.lever_m * force,
            "N m",
            "torque limit and force limit leave no torque unexplained of more than".to_owned(),
            torque_key,
        ),
    ] {
        let Some(limit) = limit.filter(|limit| *limit >= most) else { continue };
        let key = format!("guard.{name}");
        let most = round(most);
        let message = format!("`{key}` is {limit} {unit}, and {what} {most} {unit}");
        let help = format!("check the unit, and write less than {most}: what is never reached guards nothing");
        findings.warning(&key, message, help).see(see.0, see.1);
    }
    let yields = *rig.fixture.yield_n;
    if yields >= most.sure_force_n {
        let key = "fixture.yield_n";
        let sure = round(most.sure_force_n);
        let message = format!(
            "`{key}` is {yields} N, and at its torque limit this arm does not hold more than {sure} N everywhere: the arm \
             gives way before the surface does"
        );
        let help = format!("check the unit, and write less than {sure}, or raise the torque limit");
        findings.warning(key, message, help).see("guard.torque_limit_n_m", "torque limit");
    }
}

/// Checks that the rig comes to rest from its highest speed in the time in which the program waits for it: a ramp from `v` takes
/// `1.5 v / a`.
fn check_stop(findings: &mut Findings, rig: &Rig) {
    let guard = &rig.guard;
    let (speed, deceleration) = (*guard.tool_speed_limit_m_per_s, *guard.stop_deceleration_m_per_s2);
    let stop_s = 1.5 * speed / deceleration;
    if stop_s > LONGEST_STOP_S {
        let key = "guard.stop_deceleration_m_per_s2";
        let least = round(1.5 * speed / LONGEST_STOP_S);
        let message = format!(
            "`{key}` is {deceleration} m/s^2: from `guard.tool_speed_limit_m_per_s` of {speed} m/s the ramp takes {} s, and a \
             stop may take {LONGEST_STOP_S} s",
            round(stop_s)
        );
        let help = format!("check the unit, and write {least} or more");
        findings.warning(key, message, help).see("guard.tool_speed_limit_m_per_s", "speed");
    }
}

/// Checks the resolution of the torque: drives take it in per mille of rated, so that the limit should be many of these steps.
fn check_torque_steps(findings: &mut Findings, rig: &Rig) {
    let limit = *rig.guard.torque_limit_n_m;
    for (index, drive) in rig.drives.iter().enumerate() {
        let rated = *drive.rated_torque_n_m;
        let steps = 1000.0 * limit / rated;
        // Less than one is an error already.
        if (1.0..LEAST_TORQUE_STEPS).contains(&steps) {
            let key = format!("drives[{index}].rated_torque_n_m");
            let message = format!(
                "`{key}` is {rated} N m: the drive takes torques in steps of {} N m, and `guard.torque_limit_n_m` of {limit} N m has \
                 {} of them",
                round(rated / 1000.0),
                round(steps)
            );
            let help = "write the rated torque at the link in N m, gear included";
            findings.warning(&key, message, help).see("guard.torque_limit_n_m", "torque limit");
        }
    }
}

/// Checks the encoder resolution: one count changes the measured rate by a count per period, and the damping must not turn that
/// into a jolt.
fn check_angle_steps(findings: &mut Findings, rig: &Rig) {
    let ControlGains::Joint { stiffness_n_m_per_rad, damping_n_m_s_per_rad, .. } = rig.control.gains else { return };
    if rig.rig.command_mode != CommandMode::Torque {
        return;
    }
    let (limit, period_s) = (*rig.guard.torque_limit_n_m, f64::from(rig.cycle.period_us) * 1e-6);
    for (index, drive) in rig.drives.iter().enumerate() {
        let count_rad = TAU / f64::from(drive.encoder_counts_per_rev);
        let torque = count_rad * (*stiffness_n_m_per_rad + *damping_n_m_s_per_rad / period_s);
        if torque > MOST_OF_A_COUNT * limit {
            let key = format!("drives[{index}].encoder_counts_per_rev");
            let message = format!(
                "`{key}` is {}: one count more within a period asks for {} N m, and `guard.torque_limit_n_m` is {limit} N m",
                drive.encoder_counts_per_rev,
                round(torque)
            );
            let help = "write the counts of one turn of the proximal link, gear included; with so few the gains have to be softer";
            findings.warning(&key, message, help).see("control.gains", "gains");
        }
    }
}

/// Whether the sensor resolves the forces of the fixture.
fn check_force_steps(findings: &mut Findings, rig: &Rig) {
    let (friction, yields) = (*rig.fixture.friction_n, *rig.fixture.yield_n);
    let (least, name) = if friction > 0.0 { (friction, "friction_n") } else { (yields, "yield_n") };
    for (index, row) in rig.sensor.calibration.iter().take(2).enumerate() {
        let count_n = row.iter().map(|gain| gain.abs()).fold(0.0, f64::max);
        if count_n > least {
            let key = format!("sensor.calibration[{index}]");
            let message = format!(
                "one count of the force sensor is {} N, more than `fixture.{name}` of {least} N",
                round(count_n)
            );
            let help = "copy the matrix from the sensor's calibration sheet: rows Fx and Fy in N per count";
            findings.warning(&key, message, help).see(&format!("fixture.{name}"), name);
        }
    }
}

/// Warns about angles of more than a turn: they are most likely in degrees.
fn check_turns(findings: &mut Findings, rig: &Rig) {
    let offsets = rig.drives.iter().enumerate();
    let offsets = offsets.map(|(index, drive)| (format!("drives[{index}].zero_offset_rad"), *drive.zero_offset_rad));
    let mounting = ("sensor.mounting_angle_rad".to_owned(), *rig.sensor.mounting_angle_rad);
    for (key, angle) in offsets.chain([mounting]) {
        if angle.abs() > TAU {
            let message = format!("`{key}` is {angle} rad, more than a turn");
            findings.warning(&key, message, format!("if it is in degrees, write {} rad", round(angle.to_radians())));
        }
    }
}

/// Checks that the handle leaves some of the virtual mass; the program subtracts the handle's inertia from the force.
pub(super) fn check_handle(findings: &mut Findings, rig: &Rig) {
    let Coupling::Admittance { mass_kg } = rig.fixture.coupling else { return };
    let handle = *rig.sensor.handle_mass_kg;
    if handle >= *mass_kg {
        let key = "sensor.handle_mass_kg";
        let message = format!(
            "`{key}` is {handle} kg, not below the virtual mass of {} kg: what is taken out of the force pushes the proxy on",
            *mass_kg
        );
        let help = "write the mass beyond the sensor in kg, or make the virtual mass several times as heavy";
        findings.error(key, message, help).see("fixture.coupling.admittance.mass_kg", "virtual mass");
        return;
    }
    let Some(simulation) = &rig.simulation else { return };
    let tool = *simulation.arm.tool_kg;
    if handle > tool {
        let key = "sensor.handle_mass_kg";
        let message =
            format!("`{key}` is {handle} kg, more than the {tool} kg of the simulated tool of which it is a part");
        let help = "have `simulation.arm.tool_kg` be the mass of the whole tool, with what is beyond the sensor";
        findings.warning(key, message, help).see("simulation.arm.tool_kg", "tool");
    }
}

#[cfg(test)]
mod tests {
    use crate::malformed::{base_text, with};
    use crate::{Severity, load_rig};

    /// The keys of all findings in the base rig when one of its files has one number changed.
    fn found(file: &str, from: &str, to: &str) -> Vec<(Severity, String)> {
        let text = base_text(file);
        assert!(text.contains(from), "{from}");
        found_in(file, &text.replacen(from, to, 1))
    }

    fn found_in(file: &str, text: &str) -> Vec<(Severity, String)> {
        let findings = match load_rig(with("rig.yaml", file, text)) {
            Ok(rig) => rig.warnings,
            Err(report) => report.diagnostics,
        };
        findings.into_iter().map(|finding| (finding.severity, finding.key)).collect()
    }

    #[test]
    fn numbers_in_another_unit_are_told_at_their_keys() {
        for (from, to, key) in [
            (
                "joint_speed_limit_rad_per_s: 6.0",
                "joint_speed_limit_rad_per_s: 344",
                "guard.joint_speed_limit_rad_per_s",
            ),
            ("tool_speed_limit_m_per_s: 1.5", "tool_speed_limit_m_per_s: 15.0", "guard.tool_speed_limit_m_per_s"),
            ("following_error_limit_rad: 0.05", "following_error_limit_rad: 2.9", "guard.following_error_limit_rad"),
            ("energy_limit_j: 0.5", "energy_limit_j: 500.0", "guard.energy_limit_j"),
            (
                "stop_deceleration_m_per_s2: 10.0",
                "stop_deceleration_m_per_s2: 10000.0",
                "guard.stop_deceleration_m_per_s2",
            ),
            (
                "stop_deceleration_m_per_s2: 10.0",
                "stop_deceleration_m_per_s2: 0.01",
                "guard.stop_deceleration_m_per_s2",
            ),
            ("force_step_limit_n: 80.0", "force_step_limit_n: 80000.0", "guard.force_step_limit_n"),
            ("residual_limit_n_m: 30.0", "residual_limit_n_m: 30000.0", "guard.residual_limit_n_m"),
            ("rated_torque_n_m: 60.0", "rated_torque_n_m: 60000.0", "drives[0].rated_torque_n_m"),
            ("encoder_counts_per_rev: 800000", "encoder_counts_per_rev: 800", "drives[0].encoder_counts_per_rev"),
            ("[0.00625, 0.0", "[6.25, 0.0", "sensor.calibration[0]"),
            ("zero_offset_rad: 0.0", "zero_offset_rad: 90.0", "drives[0].zero_offset_rad"),
            ("mounting_angle_rad: 0.0", "mounting_angle_rad: -45.0", "sensor.mounting_angle_rad"),
            ("coulomb_n_m: [10.0, 10.0]", "coulomb_n_m: [10.0, 12.0]", "control.feed_forward.coulomb_n_m"),
            ("motor_kg_m2: [0.25, 0.25]", "motor_kg_m2: [2.5, 2.5]", "control.feed_forward.inertia"),
            ("tool_kg: 1.0", "tool_kg: 1000.0", "control.feed_forward.inertia"),
        ] {
            let found = found("rig.yaml", from, to);
            assert!(found.contains(&(Severity::Warning, key.to_owned())), "{to}: {found:?}");
        }
        let weak = [("torque_limit_n_m: 60.0", "torque_limit_n_m: 40.0"), ("yield_n: 20.0", "yield_n: 145.0")];
        let text = weak.iter().fold(base_text("rig.yaml").to_owned(), |text, (from, to)| text.replacen(from, to, 1));
        assert!(found_in("rig.yaml", &text).contains(&(Severity::Warning, "fixture.yield_n".to_owned())));
        let heavy = found("rig.yaml", "handle_mass_kg: 0.0", "handle_mass_kg: 2.0");
        assert_eq!(heavy, [(Severity::Error, "sensor.handle_mass_kg".to_owned())]);
        let light = found("rig.yaml", "handle_mass_kg: 0.0", "handle_mass_kg: 1.5");
        assert_eq!(light, [(Severity::Warning, "sensor.handle_mass_kg".to_owned())]);
        let stuck = found("simulation.yaml", "coulomb_n_m: [10.0, 10.0]", "coulomb_n_m: [60.0, 10.0]");
        assert_eq!(stuck, [(Severity::Warning, "simulation.arm.coulomb_n_m".to_owned())]);
    }

    #[test]
    fn a_path_out_of_reach_or_too_fast_is_told_in_the_scene() {
        let text = base_text("scene.yaml");
        let leg = text.lines().find(|line| line.contains("- to:")).unwrap();
        for (leg_after, key) in [
            ("    - to: {point_m: [60.0, 30.0], in_s: 1.5}", "hand.path[0].to.point_m"),
            ("    - to: {point_m: [0.13, 0.08], in_s: 0.0015}", "hand.path[0].to.in_s"),
        ] {
            let found = found("scene.yaml", leg, leg_after);
            assert_eq!(found, [(Severity::Warning, key.to_owned())]);
        }
    }
}
