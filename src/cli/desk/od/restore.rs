//! `yieldwall od restore`: the parameters of a device as in a file.

use std::path::PathBuf;

use super::super::place::BusArguments;
use super::super::reached::DeviceHandle;
use super::super::state::refuse_powered;
use super::super::words::{spaced, titled, wrapped};
use super::{Done, Saving, is_file, sheet_of, told, values, write_all};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_drives::eds::Eds;
use yieldwall_fieldbus::canopen::NmtState;
use yieldwall_fieldbus::ethercat::{AlState, AlStatus};
use yieldwall_fieldbus::objects::Address;
use yieldwall_service::{Error, number, plan};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// File from `od dump`, with or without --concise, or a backup by another command
    file: PathBuf,
    /// Node id, EtherCAT position, or device name from the rig
    node: String,
    /// Data sheet (EDS or DCF) of the device; vendor objects are written only if it describes them
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    /// Print what would be written, in which order, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    saving: Saving,
    #[command(flatten)]
    place: BusArguments,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    if !arguments.file.is_file() && is_file(&arguments.node) {
        let message = format!("the file comes first, then the device: {} is no file", arguments.file.display());
        let (file, node) = (&arguments.node, arguments.file.display());
        let help = format!("`yieldwall od restore {file} {node}{}`", arguments.place.arguments());
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let wanted = values(&arguments.file, eds.as_ref(), output)?;
    if wanted.entries().all(|(.., entry)| entry.value.is_none()) {
        let message = format!(
            "{}: has no values: no entry has a ParameterValue, or it is a concise DCF of 0 values",
            arguments.file.display()
        );
        return Err(Failure::about_file(
            Exit::ConfigInvalid,
            &arguments.file,
            message,
            "name a DCF, as `yieldwall od dump` writes it",
        ));
    }
    let mut reached = DeviceHandle::open(&arguments.place, &arguments.node, output)?;
    refuse_powered(&mut reached)?;
    refuse_exchanging(&mut reached)?;
    refuse_another_kind(&mut reached, &wanted)?;
    let node_id = reached.named().node_id();
    let plan = plan(&mut *reached.objects()?, node_id, &wanted, eds.as_ref());
    let plan = plan.map_err(|error| reached.failure("comparing its objects", error))?;
    for left_out in &plan.left_out {
        output.news(
            wrapped(&format!("left out  {}: {}", titled(left_out.at, &left_out.name), left_out.why)).trim_end(),
        )?;
    }
    if plan.steps.is_empty() {
        output.news("nothing to write: the rest is as in the file")?;
    }
    let done = if arguments.dry_run {
        Done::planned(&plan.steps)
    } else {
        let done = write_all(&mut reached, &plan.steps, eds.as_ref(), output)?;
        done.saved(arguments.saving, &mut reached, output)
    };
    told(&reached, &plan.steps, done, output)
}

/// Objects that distinguish kinds of device: device type, vendor and product.
const KIND: [(u16, u8, &str); 3] = [(0x1000, 0, "device type"), (0x1018, 1, "vendor"), (0x1018, 2, "product code")];

/// Refuses a device whose process data are, or may be, exchanged: the mapping cannot change meanwhile.
fn refuse_exchanging(reached: &mut DeviceHandle) -> Result<(), Failure> {
    let state = match reached {
        DeviceHandle::Node(desk, node) => {
            let state = desk.service.state(node.id);
            let state = state.map_err(|error| desk.failure(node, "asking its state", error))?;
            (state == Some(NmtState::Operational)).then(|| (spaced("Operational"), "nmt"))
        }
        DeviceHandle::Device(desk, device) => {
            let state = desk.service.state(device.position);
            let (status, _) = state.map_err(|error| desk.failure(device, "reading its state", error))?;
            let is_at_rest = status == AlStatus::new(AlState::PreOperational, false);
            (!is_at_rest).then(|| (status.to_string(), "state"))
        }
    };
    let Some((state, command)) = state else { return Ok(()) };
    let message = format!("{} is in {state}: its process data can be changed only in Pre-operational", reached.words());
    let help = format!("`yieldwall {command} {} preop{}` first", reached.number(), reached.arguments());
    Err(Failure::new(Exit::Usage, message, help))
}

/// Refuses the file of a device of another kind, since the device could accept some objects before it refuses one. A file that does
/// not name its device, such as a backup of a few objects, is accepted.
fn refuse_another_kind(reached: &mut DeviceHandle, wanted: &Eds) -> Result<(), Failure> {
    for (index, sub, what) in KIND {
        let entry = wanted.entry(index, sub);
        let value = entry.and_then(|entry| entry.value.as_ref()?.to_bytes(entry.data_type, reached.named().node_id()));
        let Some(value) = value else { continue };
        match reached.read(Address::new(index, sub)) {
            Ok(held) if number(&held) != number(&value) => {
                let message = format!(
                    "{} has the {what} {:08X}h, and the file is of a device with {:08X}h: nothing was written",
                    reached.words(),
                    number(&held),
                    number(&value)
                );
                let help =
                    format!("name the device that the file is of; `yieldwall scan{}` shows them", reached.arguments());
                return Err(Failure::new(Exit::DeviceMismatch, message, help));
            }
            Ok(_) | Err(Error::Refused(_)) => {}
            Err(error) => return Err(reached.failure("reading what it is", error)),
        }
    }
    Ok(())
}
