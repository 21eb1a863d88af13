//! The device models that a rig names: whether they are known, and have what it asks of them.

use std::time::Duration;

use yieldwall_drives::profiles::{BrakeHolder, DeviceProfile, EncoderKind, Known, Role, Servo, Tried};
use yieldwall_drives::watchdog::{HEARTBEAT_PERIODS, TORQUE_LIMIT, WATCHED_CYCLES, Watchdog};

use super::Findings;
use crate::config::suggest::nearest;
use crate::config::tree::{CommandMode, Drive, ProfileName, Rig, Simulation};

/// Whether every device's model is known, is that of such a device, and has what the rig asks of it.
pub(super) fn check_profiles(findings: &mut Findings, rig: &Rig) {
    let mode = rig.rig.command_mode.operation_mode();
    let word = match rig.rig.command_mode {
        CommandMode::Torque => "torque",
        CommandMode::Velocity => "velocity",
        CommandMode::Position => "position",
    };
    if let Some(simulation) = &rig.simulation {
        check_drive_model(findings, "simulation.drive_model.profile", simulation);
    }
    for (index, drive) in rig.drives.iter().enumerate() {
        let key = format!("drives[{index}].profile");
        let Some(profile) = drive.profile.get() else { continue };
        let Some(servo) = profile.servo() else {
            refuse_profile(findings, &key, drive.profile.as_str(), "is not one of a drive", is_servo);
            continue;
        };
        if servo.process_data.of(mode).is_none() {
            let known = servo.process_data.modes().into_iter().filter(|mode| mode.3.is_some()).map(|mode| mode.1);
            let name = drive.profile.as_str();
            findings
                .error(
                    "rig.command_mode",
                    format!(
                        "`rig.command_mode` is {word}, which the profile `{name}` of `drives[{index}]` does not have"
                    ),
                    format!("the profile has {}", known.collect::<Vec<_>>().join(", ")),
                )
                .see(&key, "profile");
        }
        // What is so of both drives is said once.
        let is_same = |other: &Drive| other.profile == drive.profile && other.encoder == drive.encoder;
        if rig.drives.iter().take(index).any(is_same) {
            continue;
        }
        check_tried(findings, &key, profile);
        check_watchdogs(findings, &key, rig, &drive.profile, servo);
        check_reference(findings, &key, profile, drive.encoder.unwrap_or(servo.encoder.kind));
        if servo.brake.held_by == BrakeHolder::Output {
            let message =
                format!("the brake of `{}` is opened by an output that nothing here sets", drive.profile.as_str());
            findings.error(
                &key,
                message,
                "let the drive hold the brake, and write `brake: {held_by: drive}` in the profile",
            );
        }
    }
}

/// Whether the model of the simulated drives is one of a drive.
pub(in crate::config) fn check_drive_model(findings: &mut Findings, key: &str, simulation: &Simulation) {
    let Some(model) = &simulation.drive_model else { return };
    if model.profile.get().is_some_and(|profile| profile.servo().is_none()) {
        refuse_profile(findings, key, model.profile.as_str(), "is not one of a drive", is_servo);
    }
}

fn check_tried(findings: &mut Findings, key: &str, profile: &DeviceProfile) {
    if profile.profile.tried == Tried::Never {
        let message =
            format!("the profile `{}` was never tried on the drive: it is written from documents", profile.name());
        findings.warning(key, message, "have the arm free to move and a hand on the emergency stop at the first drill");
    }
}

/// The rule of which watchdogs suffice: one that acts when the master dies, always; in torque mode within 10 ms. One for SYNC or
/// set-points that the drive lacks is told.
fn check_watchdogs(findings: &mut Findings, key: &str, rig: &Rig, name: &ProfileName, servo: &Servo) {
    let name = name.as_str();
    if servo.lacks(Watchdog::Heartbeat) {
        let message =
            format!("drives with the profile `{name}` go on when this program dies: they do not watch its heartbeat");
        findings.error(key, message, "a drive is wanted that has 1016h");
        return;
    }
    let lacking: Vec<Watchdog> = Watchdog::CANOPEN.into_iter().filter(|watchdog| servo.lacks(*watchdog)).collect();
    if lacking.is_empty() {
        return;
    }
    let words: Vec<&str> = lacking.iter().map(|watchdog| watchdog.name()).collect();
    let message = format!("drives with the profile `{name}` have no watchdog for {}", words.join(" and "));
    // On EtherCAT the controller has the watchdog.
    let Some((bus, own)) = rig.buses.iter().find_map(|(name, bus)| Some((name, bus.canopen()?))) else { return };
    let heartbeat = Duration::from_millis(own.heartbeat_ms.into()) * HEARTBEAT_PERIODS;
    let own_key = format!("buses.{bus}.canopen.heartbeat_ms");
    let cycles = Duration::from_micros(rig.cycle.period_us.into()) * WATCHED_CYCLES;
    let fastest = if lacking.len() < 2 { heartbeat.min(cycles) } else { heartbeat };
    if rig.rig.command_mode == CommandMode::Torque && fastest > TORQUE_LIMIT {
        let message = format!(
            "{message}, and no other stops a drive in torque mode within {} ms when this program dies",
            TORQUE_LIMIT.as_millis()
        );
        let help = format!("shorten `{own_key}` to 5, or command positions");
        findings.error(key, message, help).see(&own_key, "heartbeat_ms").see("rig.command_mode", "mode");
    } else {
        let help = "the drive goes on with its last set-point until another watchdog acts; run the drill";
        findings.warning(key, message, help);
    }
}

/// Whether the drive knows where its zero is when a run begins: each begins with a reset.
fn check_reference(findings: &mut Findings, key: &str, profile: &DeviceProfile, encoder: EncoderKind) {
    let is_incremental = matches!(encoder, EncoderKind::Incremental | EncoderKind::Unknown);
    if !is_incremental || profile.node.reset_loses_reference == Known::No {
        return;
    }
    let message = format!(
        "drives with the profile `{}` may not know where their zero is: the reset with which a run begins takes it from an \
         incremental encoder",
        profile.name()
    );
    let help = "write `encoder: multi_turn` or `single_turn` at the drive if its motor has such a one; an incremental one needs a \
                profile with a reset that keeps the reference";
    findings.error(key, message, help);
}

pub(super) fn is_servo(role: &Role) -> bool {
    matches!(role, Role::Servo(_))
}

/// A profile that cannot stand at a key.
pub(in crate::config) fn refuse_profile(
    findings: &mut Findings,
    key: &str,
    name: &str,
    why: &str,
    fits: fn(&Role) -> bool,
) {
    let known: Vec<&str> =
        ProfileName::shipped().filter(|(_, profile)| fits(&profile.device)).map(|(name, _)| name).collect();
    let help = match nearest(name, known.iter().copied()) {
        Some(meant) => format!("did you mean `{meant}`?"),
        None => format!("the profiles that fit are {}; or name a file that ends in .yaml", known.join(", ")),
    };
    findings.error(key, format!("`{key}` is `{name}`, which {why}"), help);
}
