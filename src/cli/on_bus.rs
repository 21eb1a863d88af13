//! Messages and refusals that the commands on an interface share.

mod emergencies;
mod standstill;

use super::desk::journal::journal_failure;
use super::ending::{self, exit_of, rig_failure};
use super::failure::{Exit, Failure};
use super::interfaces::Interfaces;
use super::output::Output;
pub(super) use emergencies::{
    different, document, drive_error_json, drive_error_text, standing, text, told_at_boot, told_before, with_findings,
    with_told, words_of_code, words_of_fault,
};
pub(super) use standstill::{after_standstill, not_in_time, said_first, stood};
use yieldwall_bus::{HeardFrame, Sign};
use yieldwall_config as config;
use yieldwall_link::LinkError;
use yieldwall_motion::guard::Device;
use yieldwall_run::host::system::Refusal;
use yieldwall_run::host::{OpenError, ThreadError};
use yieldwall_run::{DriveError, Pace, RunError};

/// Returns the failure for an interface that cannot be used.
pub(super) fn link_failure(error: &LinkError) -> Failure {
    Failure::new(Exit::BusUnavailable, error.to_string(), "")
}

/// Refuses the first given argument that is only for rigs on CAN. Each entry is a name, whether the argument is given, and the
/// alternative.
pub(super) fn only_for_can(arguments: &[(&str, bool, &str)]) -> Result<(), Failure> {
    let Some((name, _, help)) = arguments.iter().find(|(_, is_given, _)| *is_given) else { return Ok(()) };
    let message = format!("{name} is for devices on CAN, and this rig is on EtherCAT");
    Err(Failure::new(Exit::Usage, message, *help))
}

/// Returns the failure for interfaces that cannot be used for a rig.
pub(super) fn open_failure(error: &OpenError) -> Failure {
    match error {
        OpenError::Run(error) => live_failure(error),
        OpenError::Link(error) => link_failure(error),
        OpenError::Ethernet(error) => Failure::new(Exit::BusUnavailable, error.to_string(), ""),
        OpenError::Journal(error) => journal_failure(error),
        OpenError::Count { .. } => Failure::new(Exit::Usage, error.to_string(), "name one interface for each bus"),
    }
}

/// Returns the arguments with which a command reaches the device of this name: the interface of its bus, and the rig.
fn arguments_of(name: &str, rig: &config::Rig, file: &str, interfaces: &Interfaces) -> String {
    let drive = rig.drives.iter().find(|drive| ending::is_title(name, &drive.name)).map(|drive| &drive.bus);
    let bus = drive.unwrap_or(&rig.sensor.bus);
    let at = rig.buses.keys().position(|name| name == bus).unwrap_or_default();
    // There is one for each bus.
    let interface = interfaces.names().get(at).map_or("", String::as_str);
    let bus = if rig.buses.len() == 1 { interface.to_owned() } else { format!("{bus}={interface}") };
    format!(" --bus {bus} --rig {file}")
}

/// Adds advice on the node to a failure of the boot, and the command that finds the cause if the node does not answer.
pub(super) fn point_to_node(
    failure: Failure,
    error: &RunError,
    rig: &config::Rig,
    file: &str,
    interfaces: &Interfaces,
) -> Failure {
    let RunError::Boot(error) = error else { return failure };
    ending::point_to_node(failure, error, rig, &arguments_of(&error.name, rig, file, interfaces))
}

/// Adds the command that resets each drive in Fault to a failure.
pub(super) fn point_to_resets(
    failure: Failure,
    errors: &[DriveError],
    rig: &config::Rig,
    file: &str,
    interfaces: &Interfaces,
) -> Failure {
    let arguments = |device: Device| {
        let drive = usize::from(device == Device::RightDrive);
        arguments_of(&rig.drives[drive].name, rig, file, interfaces)
    };
    emergencies::with_resets(failure, errors, rig, arguments)
}

/// Returns the failure for a thread that does not exist, or has panicked.
pub(super) fn thread_failure(error: &ThreadError) -> Failure {
    Failure::new(Exit::Internal, error.to_string(), "")
}

/// Prints warnings for a person before the first frame.
pub(super) fn warn(output: &mut Output, message: String) {
    let finding = config::Diagnostic::about_file("", message, "");
    output.warnings(&[config::Diagnostic { severity: config::Severity::Warning, ..finding }]);
}

/// Prints the permissions that this computer did not grant.
pub(super) fn warn_of(output: &mut Output, granted: &Result<(), Refusal>) {
    if let Err(refusal) = granted {
        warn(output, refusal.to_string());
    }
}

/// Returns the failure for another master.
pub(super) fn other_master(message: String, heard: &HeardFrame) -> Failure {
    let help = match heard.sign {
        Sign::Master { .. } => {
            "end the other master; if it is a device, give this rig's master another node id (`node_id` of its bus)"
        }
        _ => "end the other master, or run this rig on a separate bus; `candump` shows the frames on a bus",
    };
    Failure::new(Exit::BusUnavailable, message, help)
}

/// Returns the failure for an error of the loop.
pub(super) fn live_failure(error: &RunError) -> Failure {
    match error {
        RunError::Assembly(error) => rig_failure(&error.clone().into()),
        RunError::Boot(error) => rig_failure(&error.clone().into()),
        RunError::OtherMaster { heard, .. } => other_master(error.to_string(), heard),
        RunError::Send { .. } => Failure::new(
            Exit::BusUnavailable,
            error.to_string(),
            "no device acknowledges: check supply, cable, termination and bit rate",
        ),
        RunError::NotBooted => Failure::new(Exit::Internal, error.to_string(), "please report what was printed above"),
        RunError::OldPermit | RunError::NotVirtual => {
            Failure::new(Exit::Internal, error.to_string(), "please report what was printed above")
        }
        RunError::NotEnabled { cause, .. } | RunError::NotTried { cause, .. } => {
            let exit = cause.map_or(Exit::DeviceFault, exit_of);
            let help = cause
                .map_or("`yieldwall state DRIVE` shows a drive's error code (603Fh) and what it means", |cause| {
                    cause.fault.row().next
                });
            Failure::new(exit, error.to_string(), help)
        }
        RunError::NoTorqueLimit { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "name its object in the device profile (`limits.torque`, or `limits.current` in another unit), or confirm with --accept-drive-limit \
             that the drive may use the limit in its maker's tool",
        ),
        RunError::DriveLimit { .. } => Failure::new(
            Exit::SafetyStop,
            error.to_string(),
            "lower it with the maker's tool, or confirm with --accept-drive-limit that the drive may use it; `commission` shows it and asks",
        ),
        RunError::WayBlocked { .. } => Failure::new(
            Exit::SafetyStop,
            error.to_string(),
            "nothing was enabled; choose a shorter move or the other direction; with keys both directions have to be free",
        ),
        RunError::NotHomed { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "nothing was enabled; `yieldwall home RIG.yaml` with the same --bus homes both joints",
        ),
        RunError::BehindHome { by_rad, .. } => {
            // A little more than back to home, so that it comes up to its rate.
            let back_deg = (-by_rad.to_degrees() - 3.0_f64.copysign(*by_rad)).round();
            let help = format!(
                "nothing was enabled; move it back first: `yieldwall jog RIG.yaml JOINT --by {back_deg:+}deg` with the same --bus"
            );
            Failure::new(Exit::OutOfTolerance, error.to_string(), help)
        }
        RunError::NoPosture => Failure::new(
            Exit::OutOfTolerance,
            error.to_string(),
            "nothing was enabled; compare `zero_offset_rad`, `direction` and `linkage` with the machine",
        ),
        RunError::Unread { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "compare node ids or positions, and profiles, with the devices on the bus",
        ),
        RunError::Pace { pace, .. } => {
            let pace = if *pace == Pace::Lockstep { "lockstep" } else { "free" };
            let help = format!("nothing was enabled; start `yieldwall sim` with --pace {pace} as well");
            Failure::new(Exit::DeviceMismatch, error.to_string(), help)
        }
        RunError::Unmarked { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "nothing was enabled; start the `yieldwall sim` of this version. Another simulated device has to hold `simulated device` in \
             2012h:1 to 4, four letters each, the first letter in the lowest byte. A real drive needs its own profile",
        ),
        RunError::NotSimulated { .. } => Failure::new(
            Exit::DeviceMismatch,
            error.to_string(),
            "nothing was enabled; omit --pace lockstep, and drill the drives",
        ),
        RunError::NotTared { .. } => Failure::new(
            Exit::OutOfTolerance,
            error.to_string(),
            "nothing was enabled; release the handle, and look at `yieldwall sensor monitor`. `sensor.tare_up_to_n` limits the zero",
        ),
        RunError::Unwatched { .. } => Failure::new(
            Exit::OutOfTolerance,
            error.to_string(),
            "nothing was enabled; start `yieldwall sim` without --unwatched, or drill the rig by the wall clock",
        ),
        RunError::Interrupted => Failure::new(Exit::Interrupted, error.to_string(), ""),
    }
}
