//! Device models that a rig names: whether they are known, and have the features that the rig needs.

use std::f64::consts::PI;
use std::time::Duration;

use yieldwall_drives::profiles::{BrakeHolder, DeviceProfile, EncoderKind, EncoderSide, Known, Servo, Tried};
use yieldwall_drives::watchdog::{HEARTBEAT_PERIODS, TORQUE_LIMIT, WATCHED_CYCLES, Watchdog};

use super::Findings;
use super::words::round;
use crate::number::Positive;
use crate::suggest::nearest;
use crate::tree::{CommandMode, Drive, Fitting, ProfileName, Rig, Simulation};

use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::{JointAngles, TipPoint};

/// Smallest and largest travel and rate of a joint during homing, rad and rad/s.
const WITHIN_RAD: [f64; 2] = [0.01, 1.5];
const HOMING_RATE: [f64; 2] = [0.005, 0.5];

/// Checks that every device's model is known, is a model of such a device, and has the features that the rig needs.
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
    check_both_home(findings, rig);
    for (index, drive) in rig.drives.iter().enumerate() {
        let key = format!("drives[{index}].profile");
        let Some(profile) = drive.profile.get() else { continue };
        let Some(servo) = profile.servo() else {
            refuse_profile(
                findings,
                &key,
                drive.profile.as_str(),
                "is not one of a drive",
                Fitting::on(true, drive.address.position().is_some()),
            );
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
        check_homing(findings, &format!("drives[{index}].homing"), drive, servo);
        let is_same = |other: &Drive| {
            (&other.profile, other.encoder, other.homing.is_some())
                == (&drive.profile, drive.encoder, drive.homing.is_some())
        };
        if rig.drives.iter().take(index).any(is_same) {
            continue;
        }
        check_tried(findings, &key, profile);
        // On EtherCAT the controller watches for outputs, and the master sets its time.
        if drive.address.position().is_none() {
            check_watchdogs(findings, &key, rig, &drive.profile, servo);
        }
        check_reference(findings, &key, profile, drive, servo);
        if servo.brake.held_by == BrakeHolder::Output {
            let message = format!(
                "the brake of `{}` is held by an output, which stays as it is when this program dies",
                drive.profile.as_str()
            );
            findings.warning(
                &key,
                message,
                "see that nothing falls without torque, or let the drive hold the brake and write `brake: {held_by: drive}` in the profile",
            );
        }
    }
}

/// Checks that the model of the simulated drives is a model of a drive.
pub(crate) fn check_drive_model(findings: &mut Findings, key: &str, simulation: &Simulation) {
    let Some(model) = &simulation.drive_model else { return };
    if model.profile.get().is_some_and(|profile| profile.servo().is_none()) {
        refuse_profile(findings, key, model.profile.as_str(), "is not one of a drive", Fitting::SERVO);
    }
}

fn check_tried(findings: &mut Findings, key: &str, profile: &DeviceProfile) {
    if profile.profile.tried == Tried::Never {
        let message =
            format!("the profile `{}` was never tried on the drive: it is written from documents", profile.name());
        findings.warning(key, message, "have the arm free to move and a hand on the emergency stop at the first drill");
    }
}

/// Checks the rule for watchdogs on CANopen: the drive always needs one that acts when the master dies, in torque mode within 10
/// ms. Reports a watchdog for SYNC or set-points that the drive lacks.
fn check_watchdogs(findings: &mut Findings, key: &str, rig: &Rig, name: &ProfileName, servo: &Servo) {
    let name = name.as_str();
    if servo.lacks(Watchdog::Heartbeat) {
        let message =
            format!("drives with the profile `{name}` continue if this program fails: they do not watch its heartbeat");
        findings.error(key, message, "use a drive that has 1016h");
        return;
    }
    let lacking: Vec<Watchdog> = Watchdog::CANOPEN.into_iter().filter(|watchdog| servo.lacks(*watchdog)).collect();
    if lacking.is_empty() {
        return;
    }
    let words: Vec<&str> = lacking.iter().map(|watchdog| watchdog.name()).collect();
    let message = format!("drives with the profile `{name}` have no watchdog for {}", words.join(" and "));
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

/// Whether an encoder knows the joint's angle at power-on. An angle within a turn of the motor does not suffice.
fn knows_its_angle(drive: &Drive, servo: &Servo) -> bool {
    match drive.encoder.unwrap_or(servo.encoder.kind) {
        EncoderKind::MultiTurn => true,
        EncoderKind::SingleTurn => servo.encoder.side != EncoderSide::Motor,
        EncoderKind::Incremental | EncoderKind::Unknown => false,
    }
}

/// Checks that the drive knows its zero when a run begins, or can be homed: each run begins with a reset.
fn check_reference(findings: &mut Findings, key: &str, profile: &DeviceProfile, drive: &Drive, servo: &Servo) {
    if knows_its_angle(drive, servo) {
        return;
    }
    let (loses, name) = (profile.node.reset_loses_reference != Known::No, profile.name());
    let (why, help) = match drive.homing {
        _ if loses => (
            "the reset with which a run begins takes it from an incremental encoder",
            "write `encoder: multi_turn` or `single_turn` at the drive if its motor has such a one; an incremental one needs a \
             profile with a reset that keeps the reference",
        ),
        None => (
            "an incremental encoder, or one that counts turns of the motor, does not report it at power-on",
            "write `encoder: multi_turn` at the drive if its motor has such a one; or write `homing`, as docs/bringup.md says",
        ),
        Some(_) => return,
    };
    let message = format!("drives with the profile `{name}` may not know where their zero is: {why}");
    findings.error(key, message, help);
}

/// Checks that the drive can do the homing of the rig.
fn check_homing(findings: &mut Findings, key: &str, drive: &Drive, servo: &Servo) {
    let (Some(homing), name) = (drive.homing, drive.profile.as_str()) else { return };
    if knows_its_angle(drive, servo) {
        let message = format!("`{key}` is written, and the encoder of `{}` knows its angle at power-on", drive.name);
        let help = "leave `homing` out: `zero_offset_rad` says where its zero is; or write `encoder: incremental`";
        findings.error(key, message, help);
        return;
    }
    for (name, value, [least, most], unit) in [
        ("within_rad", homing.within_rad.get(), WITHIN_RAD, "rad"),
        ("rate_rad_per_s", homing.rate_rad_per_s.get(), HOMING_RATE, "rad/s"),
    ] {
        if !(least..=most).contains(&value) {
            let at = format!("{key}.{name}");
            let message = format!("`{at}` is {value} {unit}, and it has to be {least} to {most}");
            findings.error(
                &at,
                message,
                "bring the arm near home by hand before the drives are switched on, and go slowly",
            );
        }
    }
    let at = format!("{key}.index_every_rad");
    let seeks_index = matches!(homing.method, 1..=14 | 33 | 34);
    match homing.index_every_rad.map(Positive::get) {
        Some(every) if seeks_index && every <= 2.0 * homing.within_rad.get() => {
            let message = format!(
                "`{at}` is {every} rad, and the joint may be {} rad to either side of home: another index may be the first",
                *homing.within_rad
            );
            findings.error(
                &at,
                message,
                "write a `within_rad` below half of it, and lead the arm so near to home by hand",
            );
        }
        None if seeks_index && servo.encoder.side == EncoderSide::Motor => {
            let message = format!(
                "`{key}` looks for an index, and the encoder of `{}` has one in each turn of its motor",
                drive.name
            );
            let help = "write `index_every_rad`, the angle of the joint from one to the next: a turn over the ratio of the gear";
            findings.error(key, message, help);
        }
        _ => {}
    }
    let Some(known) = &servo.homing else {
        let message = format!("`{key}` is written, and the profile `{name}` says nothing of homing");
        findings.error(
            key,
            message,
            "write `homing` into the profile by the manual: docs/device-profiles.md has its keys",
        );
        return;
    };
    if !known.methods.contains(&homing.method) {
        let methods: Vec<String> = known.methods.iter().map(i8::to_string).collect();
        let at = format!("{key}.method");
        let message = format!("`{at}` is {}, which drives with the profile `{name}` do not have", homing.method);
        findings.error(&at, message, format!("they have {}", methods.join(", ")));
    }
    if known.referenced_bit.is_none() {
        let message = format!(
            "a drive with the profile `{name}` does not report whether it was homed, so that `run` cannot check it"
        );
        let help = "write `referenced_bit` into the profile if the manual has such a bit of the statusword; without one the drive needs an \
                    encoder that knows its angle at power-on";
        findings.error(key, message, help);
    }
}

/// Checks that the other joint holds in homing mode too while one joint homes, and that the arm can reach home.
fn check_both_home(findings: &mut Findings, rig: &Rig) {
    let homing = rig.drives.each_ref().map(|drive| drive.homing);
    let [Some(left), Some(right)] = homing else {
        let [left, right] = homing.map(|homing| homing.is_some());
        if left != right {
            let lacking = usize::from(left);
            let message = format!("`drives[{lacking}]` has no `homing`, and the other drive has one");
            let help = "while one joint homes the other one is held in homing mode too: write it at both";
            findings
                .error(&format!("drives[{lacking}]"), message, help)
                .see(&format!("drives[{}].homing", 1 - lacking), "homing");
        }
        return;
    };
    // What is wrong with the linkage itself is found elsewhere.
    let Ok(linkage) = FiveBar::new(rig.linkage.geometry()) else { return };
    let Ok(origin) = linkage.inverse(TipPoint::new(0.0, 0.0)) else { return };
    let home = JointAngles::new(left.angle_rad.get(), right.angle_rad.get());
    for (joint, (home, origin)) in home.to_array().into_iter().zip(origin.to_array()).enumerate() {
        if (home - origin).abs() >= PI {
            let at = format!("drives[{joint}].homing.angle_rad");
            let message = format!(
                "`{at}` is {home} rad, more than half a turn from {} rad, where the joint is at the task's origin",
                round(origin)
            );
            findings.error(&at, message, "write the same angle, whole turns nearer");
            return;
        }
    }
    let sides = linkage.geometry().elbows;
    let posture = linkage.forward(home).ok().filter(|posture| posture.elbow_sides == sides);
    let clearance_m = posture.map_or(0.0, |posture| linkage.clearance(&posture).nearest().1);
    if clearance_m <= *rig.guard.singularity_margin_m {
        let message = "the arm cannot be at the home angles of both joints, or is too near a singularity there";
        let help = "both joints are brought near home by hand before the drives are switched on: choose a place where the arm has room";
        findings
            .error("drives[0].homing.angle_rad", message, help)
            .see("drives[1].homing.angle_rad", "angle_rad")
            .see("guard.singularity_margin_m", "margin");
    }
}

/// Refuses a profile that cannot stand at a key.
pub(crate) fn refuse_profile(findings: &mut Findings, key: &str, name: &str, why: &str, fits: Fitting) {
    let known = fits.shipped();
    let help = match nearest(name, known.iter().copied()) {
        Some(meant) => format!("did you mean `{meant}`?"),
        None => format!("the profiles that fit are {}; or name a file that ends in .yaml", known.join(", ")),
    };
    findings.error(key, format!("`{key}` is `{name}`, which {why}"), help);
}
