//! The journal of the devices of a rig, in words.

use super::place::node_failure;
use super::segment;
use super::state::powered;
use crate::clock::now_unix_s;
use crate::failure::{Exit, Failure};
use crate::interfaces::Interfaces;
use crate::keep::state_folder;
use crate::on_bus::{open_failure, other_master};
use crate::output::Output;
use yieldwall_bus::ethercat::SegmentFailure;
use yieldwall_config::Rig;
use yieldwall_run::host::OpenError;
use yieldwall_service::journal::{DeviceError, JournalError, Journals, Restored, Unrestored};
use yieldwall_service::{ConnectError, SegmentError, titled};

/// Returns the journals of this user, for a command.
pub(crate) fn journals(command: &str) -> Journals {
    Journals { folder: state_folder("journals"), command: command.to_owned(), now_unix_s: now_unix_s() }
}

/// Returns the failure to open a rig.
pub(crate) fn not_opened(error: &OpenError, rig: &Rig, file: &str, interfaces: &Interfaces) -> Failure {
    match error {
        OpenError::Journal(JournalError::Left(journal)) => {
            let help = format!(
                "nothing was sent; `yieldwall commission {file} {} --restore` gives the devices back what they held",
                interfaces.arguments(rig)
            );
            Failure::new(Exit::DeviceMismatch, journal.to_string(), help)
        }
        error => open_failure(error),
    }
}

/// Prints the restored values of the devices, and returns whether all were restored.
pub(crate) fn restored(restored: Restored, output: &mut Output) -> Result<(), Failure> {
    for (name, at) in &restored.unreadable {
        output.aside(&format!("{name}: {} could not be read before, and stays as it was written", titled(*at, "")));
    }
    if !restored.devices.is_empty() {
        let given: Vec<String> = restored.devices.iter().map(|(name, count)| format!("{name} {count}")).collect();
        output.aside(&format!("restored  objects as they were before: {}", given.join(", ")));
    }
    restored.end.map_err(|error| journal_failure(&error))
}

/// Returns the failure of a journal that stops a command, did not begin or stays open.
pub(crate) fn journal_failure(error: &JournalError) -> Failure {
    let message = error.to_string();
    match error {
        JournalError::Left(_) => {
            Failure::new(Exit::DeviceMismatch, message, "`yieldwall commission` with --restore closes it")
        }
        JournalError::AtWork { .. } => Failure::new(Exit::BusUnavailable, message, "wait for its end"),
        JournalError::Unreadable { .. } => {
            Failure::new(Exit::ConfigInvalid, message, "remove it once the devices are as they should be")
        }
        JournalError::NoFolder => {
            let message = format!("{message}: neither XDG_STATE_HOME nor HOME is set");
            Failure::new(Exit::Usage, message, "set XDG_STATE_HOME to a folder that is kept")
        }
        JournalError::NotKept { .. } => Failure::new(Exit::Usage, message, "make the folder one that can be written"),
        JournalError::Device(error) => device_failure(error),
        JournalError::NotRestored { command, path, interfaces, lacking } => {
            let lacking: Vec<String> = lacking.iter().map(unrestored).collect();
            let message = format!("not all is as it was before `yieldwall {command}`: {}", lacking.join("; "));
            let buses: String = interfaces.iter().map(|interface| format!(" --bus {interface}")).collect();
            let help = format!(
                "`yieldwall commission RIG.yaml{buses} --restore` tries again; no rig moves on this bus before. Where it cannot be, remove {} once \
                 the devices are as they should be",
                path.display()
            );
            Failure::new(Exit::DeviceMismatch, message, help)
        }
        JournalError::NotRemoved { .. } => Failure::new(Exit::Usage, message, "remove the file"),
    }
}

/// Describes an object or a device that was not restored, with the remedy.
fn unrestored(lacking: &Unrestored) -> String {
    let Unrestored::Device { device, restored, error } = lacking else { return lacking.to_string() };
    let why = device_failure(error).report.diagnostics.into_iter().next();
    let why = why.into_iter().flat_map(|why| [Some(why.message), why.help]).flatten().collect::<Vec<_>>().join("; ");
    Unrestored::at_device(device, *restored, &why)
}

fn device_failure(error: &DeviceError) -> Failure {
    let message = error.to_string();
    match error {
        DeviceError::Connect(error) => connect_failure(error),
        DeviceError::Segment(error) => segment::segment_failure(error.clone()),
        DeviceError::Missing { place, .. } => {
            let help = format!("`yieldwall scan --bus {}` shows who answers", place.interface);
            Failure::new(Exit::DeviceMismatch, message, help)
        }
        DeviceError::State { place, doing, error } => segment::state_failure(&place.to_string(), doing, error.clone()),
        DeviceError::NoObjects { place, error } => {
            segment::no_objects(&place.to_string(), place.number, &format!(" --bus {}", place.interface), error)
        }
        DeviceError::Object { place, error, .. } if place.is_on_ethercat => {
            segment::device_failure(message, *error, place.number, &format!(" --bus {}", place.interface))
        }
        DeviceError::Object { place, error, .. } => {
            let doctor = format!("`yieldwall doctor node {} --bus {}`", place.number, place.interface);
            node_failure(message, *error, &doctor)
        }
        DeviceError::Powered { place, axis, statusword } => {
            powered(&place.to_string(), place.number, (*axis, &format!(" --bus {}", place.interface)), statusword.0)
        }
        DeviceError::OtherDevice => Failure::new(Exit::DeviceMismatch, message, "put the one back that it was"),
    }
}

/// Returns the failure to connect an interface.
pub(super) fn connect_failure(error: &ConnectError) -> Failure {
    let message = error.to_string();
    match error {
        ConnectError::Unusable(_) => Failure::new(Exit::BusUnavailable, message, ""),
        ConnectError::NotCan { interface } => {
            let help = format!(
                "name a CAN interface with --bus; on EtherCAT `yieldwall scan --bus {interface}` lists the devices and `yieldwall state all --bus {interface}` \
                 shows their states"
            );
            Failure::new(Exit::Usage, message, help)
        }
        ConnectError::OtherMaster { heard, .. } => other_master(message, heard),
        ConnectError::Segment(SegmentError::Failed(SegmentFailure::OtherMaster { sign, .. })) => {
            segment::other_master(*sign, "")
        }
        ConnectError::Segment(error) => segment::segment_failure(error.clone()),
    }
}
