//! Backups before an overwrite, and the question before a device stores its parameters.

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use yieldwall_drives::eds::{Eds, Node as Of};
use yieldwall_drives::objects;

use super::reached::DeviceHandle;
use crate::confirm::agreed;
use crate::failure::{Exit, Failure};
use crate::keep::state_folder;
use crate::on_bus::warn;
use crate::output::Output;
use yieldwall_fieldbus::canopen::NodeId;
use yieldwall_fieldbus::objects::Address;
use yieldwall_record::trusted;
use yieldwall_service::{number, sheet_of};

/// Name of a device in commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Named {
    /// On CAN: its node id.
    Node(NodeId),
    /// On EtherCAT: its position.
    Position(u16),
}

impl Named {
    pub(super) fn number(self) -> u16 {
        match self {
            Self::Node(id) => id.raw().into(),
            Self::Position(position) => position,
        }
    }

    /// Returns its node id; 0 on EtherCAT.
    pub(super) fn node_id(self) -> u8 {
        match self {
            Self::Node(id) => id.raw(),
            Self::Position(_) => 0,
        }
    }

    /// Returns the key of the number in a document.
    pub(super) fn key(self) -> &'static str {
        match self {
            Self::Node(_) => "node_id",
            Self::Position(_) => "position",
        }
    }

    fn words(self) -> String {
        match self {
            Self::Node(id) => format!("node-{}", id.raw()),
            Self::Position(position) => format!("position-{position}"),
        }
    }
}

/// Writes the values of objects into a file that `od restore` takes, and returns its path. Nothing is saved of simulated devices.
pub(super) fn back_up(
    is_simulated: bool,
    device: Named,
    values: &[(Address, Vec<u8>)],
    eds: Option<&Eds>,
) -> Result<Option<PathBuf>, Failure> {
    if is_simulated || values.is_empty() {
        return Ok(None);
    }
    let id = device.node_id();
    let text = sheet_of(id, values, eds).to_dcf(&Of { id, ..Of::default() });
    keep_file(device, "dcf", text.as_bytes()).map(Some)
}

/// Saves the SII image of a device to a file that `sii write` takes, and returns its path.
pub(super) fn keep_image(position: u16, image: &[u8]) -> Result<PathBuf, Failure> {
    keep_file(Named::Position(position), "sii", image)
}

fn keep_file(device: Named, extension: &str, bytes: &[u8]) -> Result<PathBuf, Failure> {
    let folder = state_folder("backups").ok_or_else(|| {
        let message = "there is no folder for a backup: neither XDG_STATE_HOME nor HOME is set";
        Failure::new(Exit::Usage, message, "set XDG_STATE_HOME to a folder that is kept")
    })?;
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let path = folder.join(format!("{}-{}.{extension}", device.words(), since.as_millis()));
    let written = trusted::write(&path, bytes);
    written.map_err(|error| {
        let message = format!("the backup {}: {error}; nothing was written to the device", path.display());
        Failure::new(Exit::Usage, message, "make the folder one that can be written")
    })?;
    Ok(path)
}

/// Returns the answer of a device for 1010h:1, if it does not say that it stores on command. It may do so all the same.
///
/// # Source
/// CiA 301, 1010h: bit 0, the device stores on command; bit 1, it stores by itself.
fn doubt(answer: u32) -> Option<&'static str> {
    match answer & 3 {
        0 => Some("does not store on command"),
        2 => Some("stores by itself and not on command"),
        _ => None,
    }
}

/// Makes a device store its parameters, once a person has agreed.
pub(super) fn store(reached: &mut DeviceHandle, is_agreed: bool, output: &mut Output) -> Result<(), Failure> {
    let at = Address::new(objects::STORE_PARAMETERS.index, objects::STORE_PARAMETERS.sub);
    if let Ok(answer) = reached.read(at)
        && let Some(doubt) = doubt(number(&answer))
    {
        warn(output, format!("{} {doubt}, by its {at}: read the objects again after a power cycle", reached.words()));
    }
    let what =
        format!("{} stores all its parameters in its memory (1010h:1), over those that it has there", reached.words());
    if !is_agreed && !agreed(&what) {
        return Err(Failure::new(
            Exit::Usage,
            format!("{}: nothing was stored; what was written lasts until its next reset", reached.words()),
            "answer yes, or give --yes",
        ));
    }
    let stored = reached.objects()?.write(at, &objects::STORE_SIGNATURE.to_le_bytes());
    stored.map_err(|error| reached.failure("storing its parameters", error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_does_not_store_on_command_says_so() {
        let doubted = [0, 1, 2, 3, 0x8000_0000, 0x7fff_fffd].map(|answer| doubt(answer).is_some());
        assert_eq!(doubted, [true, false, true, false, true, false]);
        assert!(doubt(2).is_some_and(|doubt| doubt.starts_with("stores by itself")));
    }
}
