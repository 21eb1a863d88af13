//! `yieldwall od`: the objects of a device, one by one and all together.

mod diff;
mod dump;
mod restore;

use std::path::{Path, PathBuf};

use serde_json::json;
use yieldwall_drives::eds::{Eds, Value};

use super::keeping::{back_up, store};
use super::place::{Desk, Node, Place};
use super::state::refuse_powered;
use super::words::{self, object, table};
use crate::cli::failure::{Exit, Failure};
use crate::cli::output::Output;
use crate::config::{Diagnostic, Severity};
use crate::objects::Address;
use crate::service::{Caution, Error, Made, Step, carry_out, known, type_by_length};

#[derive(Debug, clap::Subcommand)]
pub(in crate::cli) enum Command {
    /// Read objects
    Read(Read),
    /// Write one object and read it back; what it held is kept in a file
    Write(Write),
    /// Read all objects into a device configuration file (DCF)
    Dump(dump::Arguments),
    /// Compare the parameters of two devices, of a device and a file, or of two files; 7 if they differ
    Diff(diff::Arguments),
    /// Put the parameters of a device to those of a file, but for commutation, encoder and calibration
    Restore(restore::Arguments),
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Read {
    /// A node id, or the name of a device in the rig
    node: String,
    /// Objects by address (6041h, 1018h:2) or by name (statusword, vendor-id)
    #[arg(required = true)]
    objects: Vec<String>,
    /// A data sheet (EDS or DCF): names and types of the vendor's objects
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    #[command(flatten)]
    place: Place,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Write {
    /// A node id, or the name of a device in the rig
    node: String,
    /// The object by address (6072h) or by name (max-torque)
    object: String,
    /// Its value: decimal, hexadecimal behind 0x, or text
    #[arg(allow_negative_numbers = true)]
    value: String,
    /// A data sheet (EDS or DCF): names and types of the vendor's objects
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    /// Say what would be written, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    saving: Saving,
    #[command(flatten)]
    place: Place,
}

/// Whether a device keeps what it was told.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Saving {
    /// Have the device store all its parameters afterwards (1010h); asks before
    #[arg(long)]
    save: bool,
    /// Answer yes to what --save asks
    #[arg(long, requires = "save")]
    yes: bool,
}

impl Saving {
    /// Has the device store what was written, if that is wanted and agreed to.
    fn after(self, desk: &mut Desk, node: &Node) -> Result<(), Failure> {
        if self.save { store(desk, node, self.yes) } else { Ok(()) }
    }
}

pub(in crate::cli) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Read(arguments) => read(arguments, output),
        Command::Write(arguments) => write(arguments, output),
        Command::Dump(arguments) => dump::run(arguments, output),
        Command::Diff(arguments) => diff::run(arguments, output),
        Command::Restore(arguments) => restore::run(arguments, output),
    }
}

/// Reads a data sheet; what is odd in it is a warning.
pub(super) fn sheet(path: &Path, output: &mut Output) -> Result<Eds, Failure> {
    let about = |exit: Exit, message: String, help: &str| {
        Failure::about_file(exit, path, format!("{}: {message}", path.display()), help)
    };
    let unread = |error: std::io::Error| about(Exit::Usage, format!("cannot be read: {error}"), "name an EDS or a DCF");
    let facts = std::fs::metadata(path).map_err(unread)?;
    if !facts.is_file() {
        return Err(about(Exit::Usage, "is no file".to_owned(), "name an EDS or a DCF"));
    }
    if facts.len() > yieldwall_drives::eds::MAX_BYTES as u64 {
        let large = yieldwall_drives::eds::EdsError::Large.to_string();
        return Err(about(Exit::ConfigInvalid, large, "a data sheet is shorter"));
    }
    let bytes = std::fs::read(path).map_err(unread)?;
    let reading =
        Eds::read(&bytes).map_err(|error| about(Exit::ConfigInvalid, error.to_string(), "name an EDS or a DCF"))?;
    let findings: Vec<Diagnostic> = reading
        .findings
        .iter()
        .map(|finding| {
            let message = format!("line {}: {}", finding.line, finding.message);
            let found = Diagnostic::about_file(path.display().to_string(), message, finding.help);
            Diagnostic { severity: Severity::Warning, ..found }
        })
        .collect();
    output.warnings(&findings);
    Ok(reading.eds)
}

pub(super) fn sheet_of(path: Option<&Path>, output: &mut Output) -> Result<Option<Eds>, Failure> {
    path.map(|path| sheet(path, output)).transpose()
}

fn read(arguments: &Read, output: &mut Output) -> Result<(), Failure> {
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let objects: Vec<Address> =
        arguments.objects.iter().map(|word| object(word, eds.as_ref())).collect::<Result<_, _>>()?;
    let mut desk = Desk::open(&arguments.place, output)?;
    let node = desk.node(&arguments.node)?;
    let (mut rows, mut documents, mut end) = (Vec::new(), Vec::new(), Ok(()));
    for at in objects {
        let name = words::name(at, eds.as_ref());
        match desk.service.read(node.id, at) {
            Ok(bytes) => {
                let data_type = known(at, eds.as_ref()).map(|known| known.data_type);
                let shown = words::value(at, data_type, &bytes, node.scaling());
                documents.push(words::document(at, &name, &bytes, &shown));
                rows.push([at.to_string(), name, shown.raw, shown.means.unwrap_or_default()]);
            }
            // The others may be there.
            Err(error @ (Error::Refused(_) | Error::Senseless(_))) => {
                documents.push(json!({ "object": at.to_string(), "name": name, "error": error.to_string() }));
                let short = match error {
                    Error::Refused(code) => format!("refused: {}", code.name()),
                    _ => "no value".to_owned(),
                };
                rows.push([at.to_string(), name, short, String::new()]);
                end = end.and(Err(desk.failure(&node, &format!("reading {at}"), error)));
            }
            Err(error) => return Err(desk.failure(&node, &format!("reading {at}"), error)),
        }
    }
    if output.is_json() {
        return output.end(json!({ "place": desk.place, "node_id": node.id.raw(), "objects": documents }), end);
    }
    output.result(&table(&rows))?;
    end
}

fn write(arguments: &Write, output: &mut Output) -> Result<(), Failure> {
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let at = object(&arguments.object, eds.as_ref())?;
    let mut desk = Desk::open(&arguments.place, output)?;
    let node = desk.node(&arguments.node)?;
    let name = words::name(at, eds.as_ref());
    let old = match desk.service.read(node.id, at) {
        Ok(old) => Some(old),
        // Write only.
        Err(Error::Refused(crate::objects::AbortCode::WRITE_ONLY)) => None,
        Err(error) => return Err(desk.failure(&node, &format!("reading {at}"), error)),
    };
    let data_type = match (known(at, eds.as_ref()), &old) {
        (Some(known), _) => known.data_type,
        (None, Some(old)) => type_by_length(old.len()).ok_or_else(|| no_type(at))?,
        (None, None) => return Err(no_type(at)),
    };
    let value = Value::parse(&arguments.value, data_type).map_err(|error| {
        Failure::new(
            Exit::Usage,
            format!("{at} {name}: {error}"),
            "write a decimal number, or a hexadecimal one behind 0x",
        )
    })?;
    let new = value.to_bytes(data_type, node.id.raw()).ok_or_else(|| {
        Failure::new(
            Exit::Usage,
            format!("{at} {name}: {} does not fit its type", arguments.value),
            "give a value in its range",
        )
    })?;
    let step = Step { at, name, data_type, old, new, is_final: true };
    if let Some(caution) = Caution::of_write(at, &step.new) {
        let message = format!("{at} {}: not written: this {caution}", step.name);
        let help = match caution {
            Caution::Memory => "`--save` with the write of another object stores its parameters, and asks before",
            _ => {
                "`yieldwall run` moves a drive, within the limits of a rig; what takes torque away is written (0, 2, 80h)"
            }
        };
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let is_control = at.index == 0x6040;
    if !is_control {
        refuse_powered(&mut desk, &node)?;
    }
    if arguments.dry_run {
        return told(&desk, &node, &[step], true, Ok(()), output);
    }
    write_all(&mut desk, &node, std::slice::from_ref(&step), eds.as_ref(), output)?;
    let stored = arguments.saving.after(&mut desk, &node);
    told(&desk, &node, &[step], false, stored, output)
}

fn no_type(at: Address) -> Failure {
    let message = format!("{at}: neither the standards nor its length tell its data type");
    Failure::new(Exit::Usage, message, "give the data sheet of the device with --eds")
}

/// Keeps what the objects hold, writes them in this order and reads each back; stops at the first that does not take its value.
pub(super) fn write_all(
    desk: &mut Desk,
    node: &Node,
    steps: &[Step],
    eds: Option<&Eds>,
    output: &mut Output,
) -> Result<(), Failure> {
    // Of an object that is written twice the first value counts.
    let mut held: Vec<(Address, Vec<u8>)> = Vec::new();
    for step in steps {
        if let Some(old) = &step.old
            && !held.iter().any(|(at, _)| *at == step.at)
        {
            held.push((step.at, old.clone()));
        }
    }
    let kept = back_up(desk, node, &held, eds)?;
    if let Some(path) = &kept {
        output.news(&format!("kept      {}", path.display()))?;
    }
    let back = kept.map_or_else(
        || "nothing else was written".to_owned(),
        |path| format!("`yieldwall od restore {} {}` puts back what was written", path.display(), node.id.raw()),
    );
    for step in steps {
        let doing = format!("writing {} {}", step.at, step.name);
        match carry_out(&mut desk.service, node.id, step) {
            Ok(Made::Written) => {}
            Ok(Made::Refused(code)) => {
                let message = format!("{}: {doing}: refused: {code}", node.words());
                return Err(Failure::new(Exit::DeviceMismatch, message, back));
            }
            Ok(Made::Holds(bytes)) if step.is_final => {
                let shown = words::value(step.at, Some(step.data_type), &bytes, None);
                let message = format!("{}: {doing}: it holds {} afterwards", node.words(), shown.raw);
                return Err(Failure::new(
                    Exit::DeviceMismatch,
                    message,
                    format!("the device changes what it is given; {back}"),
                ));
            }
            Ok(Made::Holds(_)) => {}
            Err(error) => return Err(desk.failure(node, &doing, error)),
        }
    }
    Ok(())
}

/// What was written, or would be, old -> new; and how what came after it has ended.
pub(super) fn told(
    desk: &Desk,
    node: &Node,
    steps: &[Step],
    is_dry: bool,
    end: Result<(), Failure>,
    output: &mut Output,
) -> Result<(), Failure> {
    let shown = |step: &Step, bytes: &[u8]| {
        let shown = words::value(step.at, Some(step.data_type), bytes, node.scaling());
        shown.means.map_or(shown.raw.clone(), |means| format!("{} {means}", shown.raw))
    };
    if output.is_json() {
        let each = steps.iter().map(|step| {
            let old = step.old.as_ref().map(|old| shown(step, old));
            json!({ "object": step.at.to_string(), "name": step.name, "old": old, "new": shown(step, &step.new) })
        });
        let each: Vec<_> = each.collect();
        let document = json!({
            "place": desk.place, "node_id": node.id.raw(), "dry_run": is_dry, "writes": each,
        });
        return output.end(document, end);
    }
    let verb = if is_dry { "would write" } else { "wrote" };
    let mut text = String::new();
    for step in steps {
        let old = step.old.as_ref().map_or("?".to_owned(), |old| shown(step, old));
        text.push_str(&format!("{verb} {} {}\n    {old} -> {}\n", step.at, step.name, shown(step, &step.new)));
    }
    output.result(&text)?;
    end
}
