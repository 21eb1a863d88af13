//! `yieldwall od restore`: the parameters of a device as in a file.

use std::path::PathBuf;

use super::super::place::{Desk, Place};
use super::super::state::refuse_powered;
use super::super::words::spaced;
use super::{Saving, sheet, sheet_of, told, write_all};
use crate::canopen::NmtState;
use crate::cli::failure::{Exit, Failure};
use crate::cli::output::Output;
use crate::service::plan;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// The file, as `od dump` writes it, or a backup of another command
    file: PathBuf,
    /// A node id, or the name of a device in the rig
    node: String,
    /// A data sheet (EDS or DCF) of the device: objects of the vendor are written only if it explains them
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    /// Say what would be written, in which order, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    saving: Saving,
    #[command(flatten)]
    place: Place,
}

pub(super) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let wanted = sheet(&arguments.file, output)?;
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    if wanted.entries().all(|(.., entry)| entry.value.is_none()) {
        let message = format!("{}: has no values: no entry has a ParameterValue", arguments.file.display());
        return Err(Failure::about_file(
            Exit::ConfigInvalid,
            &arguments.file,
            message,
            "name a DCF, as `yieldwall od dump` writes it",
        ));
    }
    let mut desk = Desk::open(&arguments.place, output)?;
    let node = desk.node(&arguments.node)?;
    refuse_powered(&mut desk, &node)?;
    let state = desk.service.state(node.id).map_err(|error| desk.failure(&node, "asking its state", error))?;
    if state == Some(NmtState::Operational) {
        let message = format!("{} is {}: its process data may not change", node.words(), spaced("Operational"));
        let help = format!("`yieldwall nmt {} preop` first", node.id.raw());
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let plan = plan(&mut desk.service, node.id, &wanted, eds.as_ref());
    let plan = plan.map_err(|error| desk.failure(&node, "comparing its objects", error))?;
    for left_out in &plan.left_out {
        output.news(&format!("left out  {} {}: {}", left_out.at, left_out.name, left_out.why))?;
    }
    if plan.steps.is_empty() {
        output.news("nothing to write: all else is as in the file")?;
    } else if !arguments.dry_run {
        write_all(&mut desk, &node, &plan.steps, eds.as_ref(), output)?;
    }
    let stored = if arguments.dry_run { Ok(()) } else { arguments.saving.after(&mut desk, &node) };
    told(&desk, &node, &plan.steps, arguments.dry_run, stored, output)
}
