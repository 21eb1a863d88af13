//! `yieldwall od`: the objects of a device, one by one and all together.

mod diff;
mod dump;
mod restore;

use std::path::{Path, PathBuf};

use serde_json::{Value as Json, json};
use yieldwall_drives::eds::{Eds, Value, is_concise, read_concise};
use yieldwall_drives::objects::of_first_axis;

use super::keeping::{back_up, store};
use super::place::BusArguments;
use super::reached::DeviceHandle;
use super::state::refuse_powered;
use super::words::{self, object, table, titled};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_config::{Diagnostic, Severity};
use yieldwall_fieldbus::objects::{AbortCode, Address};
use yieldwall_service::{Caution, Error, Step, WriteOutcome, carry_out, known, type_by_length, type_held};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Read objects
    Read(Read),
    /// Write one object and read it back; save the old value to a file
    Write(Write),
    /// Read all objects into a device configuration file (DCF)
    Dump(dump::Arguments),
    /// Compare the parameters of devices or files; exit with 7 if they differ
    Diff(diff::Arguments),
    /// Restore parameters from a file, except commutation, encoder and calibration
    Restore(restore::Arguments),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Read {
    /// Node id, EtherCAT position, or device name from the rig
    node: String,
    /// Objects by address (6041h, 1018h:2) or by name (statusword, vendor-id)
    #[arg(required = true)]
    objects: Vec<String>,
    /// Data sheet (EDS or DCF) with the names and types of vendor objects
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    #[command(flatten)]
    place: BusArguments,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Write {
    /// Node id, EtherCAT position, or device name from the rig
    node: String,
    /// Object by address (6072h) or by name (max-torque)
    object: String,
    /// New value: decimal, hexadecimal after 0x, or text
    #[arg(allow_negative_numbers = true)]
    value: String,
    /// Data sheet (EDS or DCF) with the names and types of vendor objects
    #[arg(long, value_name = "FILE.eds")]
    eds: Option<PathBuf>,
    /// Print what would be written, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    saving: Saving,
    #[command(flatten)]
    place: BusArguments,
}

/// Options for storing the written values in the device.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Saving {
    /// Store all parameters in the device afterwards (1010h), after confirmation
    #[arg(long)]
    save: bool,
    /// Answer yes to the question of --save
    #[arg(long, requires = "save")]
    yes: bool,
}

impl Saving {
    /// Makes the device store the written values, if this is requested and agreed to. Returns whether it did.
    fn after(self, reached: &mut DeviceHandle, output: &mut Output) -> Result<bool, Failure> {
        if self.save { store(reached, self.yes, output).map(|()| true) } else { Ok(false) }
    }
}

/// Result of a write.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Fate {
    /// It would be made.
    Planned,
    /// The device holds the value.
    Written,
    /// The device refused the value and kept its old one.
    Refused(AbortCode),
    /// The device confirmed it, and holds something else.
    Holds(Vec<u8>),
    /// The device did not answer, or nothing could be sent.
    Unknown(Error),
    /// The sequence ended before this write.
    NotTried,
}

/// Progress of a sequence of writes.
pub(super) struct Done {
    /// Result of each write.
    fates: Vec<Fate>,
    /// Failure that ended the sequence early.
    end: Result<(), Failure>,
    /// Whether nothing was to be written.
    is_dry: bool,
    /// Whether the device got the command to store its parameters, and did so.
    is_stored: bool,
}

impl Done {
    /// Returns the steps as not written, since no write was requested.
    pub(super) fn planned(steps: &[Step]) -> Self {
        Self { fates: vec![Fate::Planned; steps.len()], end: Ok(()), is_dry: true, is_stored: false }
    }

    /// Makes the device store the written values, if all of them were written.
    pub(super) fn saved(mut self, saving: Saving, reached: &mut DeviceHandle, output: &mut Output) -> Self {
        match &mut self.end {
            Ok(()) => match saving.after(reached, output) {
                Ok(is_stored) => self.is_stored = is_stored,
                Err(failure) => self.end = Err(failure),
            },
            Err(failure) if saving.save => {
                let help = failure.report.diagnostics.first_mut().and_then(|finding| finding.help.as_mut());
                help.into_iter().for_each(|help| help.push_str("; nothing was stored"));
            }
            Err(_) => {}
        }
        self
    }
}

pub(crate) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Read(arguments) => read(arguments, output),
        Command::Write(arguments) => write(arguments, output),
        Command::Dump(arguments) => dump::run(arguments, output),
        Command::Diff(arguments) => diff::run(arguments, output),
        Command::Restore(arguments) => restore::run(arguments, output),
    }
}

/// Reads a data sheet; irregularities in it are warnings.
pub(super) fn sheet(path: &Path, output: &mut Output) -> Result<Eds, Failure> {
    let bytes = bytes_of(path)?;
    if is_concise(&bytes) {
        let message = "is a concise DCF, which has no names and no types".to_owned();
        return Err(about_file(path, Exit::ConfigInvalid, message, "name an EDS or a DCF"));
    }
    text_sheet(path, &bytes, output)
}

/// Reads the values of a file: a data sheet, or a concise DCF, whose types are those of the data sheet `eds` and of the standards.
pub(super) fn values(path: &Path, eds: Option<&Eds>, output: &mut Output) -> Result<Eds, Failure> {
    let bytes = bytes_of(path)?;
    if !is_concise(&bytes) {
        return text_sheet(path, &bytes, output);
    }
    let values = read_concise(&bytes).map_err(|error| {
        let help = "it is taken for a concise DCF, by its third and fourth byte: dump the device anew";
        about_file(path, Exit::ConfigInvalid, error.to_string(), help)
    })?;
    let values: Vec<_> =
        values.into_iter().map(|(index, sub, value)| (Address::new(index, sub), value.to_vec())).collect();
    // It does not say of which node it is.
    Ok(Eds { node: None, ..yieldwall_service::sheet_of(0, &values, eds) })
}

fn about_file(path: &Path, exit: Exit, message: String, help: &str) -> Failure {
    Failure::about_file(exit, path, format!("{}: {message}", path.display()), help)
}

/// Returns the bytes of a file that is no larger than a data sheet may be.
fn bytes_of(path: &Path) -> Result<Vec<u8>, Failure> {
    let about = |exit: Exit, message: String, help: &str| about_file(path, exit, message, help);
    let unread = |error: std::io::Error| about(Exit::Usage, format!("cannot be read: {error}"), "name an EDS or a DCF");
    let facts = std::fs::metadata(path).map_err(unread)?;
    if !facts.is_file() {
        return Err(about(Exit::Usage, "is no file".to_owned(), "name an EDS or a DCF"));
    }
    if facts.len() > yieldwall_drives::eds::MAX_BYTES as u64 {
        let large = yieldwall_drives::eds::EdsError::Large.to_string();
        return Err(about(Exit::ConfigInvalid, large, "a data sheet is shorter"));
    }
    std::fs::read(path).map_err(unread)
}

fn text_sheet(path: &Path, bytes: &[u8], output: &mut Output) -> Result<Eds, Failure> {
    let reading = Eds::read(bytes)
        .map_err(|error| about_file(path, Exit::ConfigInvalid, error.to_string(), "name an EDS or a DCF"))?;
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

/// Whether a word means a file and not a device.
fn is_file(word: &str) -> bool {
    word.contains(['/', '.']) || Path::new(word).is_file()
}

pub(super) fn sheet_of(path: Option<&Path>, output: &mut Output) -> Result<Option<Eds>, Failure> {
    path.map(|path| sheet(path, output)).transpose()
}

fn read(arguments: &Read, output: &mut Output) -> Result<(), Failure> {
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let objects: Vec<Address> =
        arguments.objects.iter().map(|word| object(word, eds.as_ref())).collect::<Result<_, _>>()?;
    let mut reached = DeviceHandle::open(&arguments.place, &arguments.node, output)?;
    let (mut rows, mut documents, mut end) = (Vec::new(), Vec::new(), Ok(()));
    for at in objects {
        let name = words::name(at, eds.as_ref());
        match reached.read(at) {
            Ok(bytes) => {
                let data_type = type_held(at, eds.as_ref(), &bytes);
                let shown = words::value(at, data_type, &bytes, reached.scaling());
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
                let doing = format!("reading {}", titled(at, &words::name(at, eds.as_ref())));
                end = end.and(Err(reached.failure(&doing, error)));
            }
            Err(error) => return Err(reached.failure(&format!("reading {at}"), error)),
        }
    }
    if output.is_json() {
        return output.end(reached.document(json!({ "objects": documents })), end);
    }
    output.result(&table(&rows))?;
    end
}

fn write(arguments: &Write, output: &mut Output) -> Result<(), Failure> {
    let eds = sheet_of(arguments.eds.as_deref(), output)?;
    let at = object(&arguments.object, eds.as_ref())?;
    let mut reached = DeviceHandle::open(&arguments.place, &arguments.node, output)?;
    let name = words::name(at, eds.as_ref());
    // A name refers to an object of the selected axis; an address is taken as it is.
    let at = if words::address(&arguments.object).is_none() { reached.at(at) } else { at };
    let old = match reached.read(at) {
        Ok(old) => Some(old),
        // Write only.
        Err(Error::Refused(yieldwall_fieldbus::objects::AbortCode::WRITE_ONLY)) => None,
        Err(error) => return Err(reached.failure(&format!("reading {at}"), error)),
    };
    let data_type = match (known(at, eds.as_ref()), &old) {
        (Some(known), None) => known.data_type,
        (Some(known), Some(old)) => type_held(at, eds.as_ref(), old).unwrap_or(known.data_type),
        (None, Some(old)) => type_by_length(old.len()).ok_or_else(|| no_type(at))?,
        (None, None) => return Err(no_type(at)),
    };
    let range = words::range(at, data_type, reached.named().node_id(), eds.as_ref());
    let unfit = |error: &str| {
        let what = "write a decimal number, or a hexadecimal one behind 0x";
        let help = range.as_ref().map_or(what.to_owned(), |range| format!("it takes {range}; {what}"));
        Failure::new(Exit::Usage, format!("{}: {error}", titled(at, &name)), help)
    };
    let value = Value::parse(&arguments.value, data_type).map_err(|error| unfit(&error))?;
    let new = value
        .to_bytes(data_type, reached.named().node_id())
        .ok_or_else(|| unfit(&format!("`{}` does not fit its type", arguments.value)))?;
    let step = Step { at, name, data_type, old, new, is_final: true };
    if let Some(caution) = Caution::of_write(at, &step.new) {
        let message = format!("{}: not written: this {caution}", titled(at, &step.name));
        let help = match caution {
            Caution::Memory => "`--save` with the write of another object stores its parameters, and asks before",
            _ => {
                "`yieldwall run` moves a drive, within the limits of a rig; what takes torque away is written (0, 2, 80h)"
            }
        };
        return Err(Failure::new(Exit::Usage, message, help));
    }
    let is_control = of_first_axis(at.index) == 0x6040;
    if !is_control {
        refuse_powered(&mut reached)?;
    }
    let steps = [step];
    if arguments.dry_run {
        let takes = range.map(|range| format!("    takes {range}"));
        return told(&reached, &steps, Done::planned(&steps), output)
            .and_then(|()| takes.map_or(Ok(()), |takes| output.news(&takes)));
    }
    let done = write_all(&mut reached, &steps, eds.as_ref(), output)?;
    let done = done.saved(arguments.saving, &mut reached, output);
    told(&reached, &steps, done, output)
}

fn no_type(at: Address) -> Failure {
    let message = format!("{at}: neither the standards nor its length show its data type");
    Failure::new(Exit::Usage, message, "give the data sheet of the device with --eds")
}

/// Saves the objects' values, writes the objects in this order and reads each back. Stops at the first object that does not take
/// its value.
///
/// # Errors
/// If the values cannot be saved: nothing was written.
pub(super) fn write_all(
    reached: &mut DeviceHandle,
    steps: &[Step],
    eds: Option<&Eds>,
    output: &mut Output,
) -> Result<Done, Failure> {
    // If an object is written twice, the first value counts.
    let mut held: Vec<(Address, Vec<u8>)> = Vec::new();
    for step in steps {
        if let Some(old) = &step.old
            && !held.iter().any(|(at, _)| *at == step.at)
        {
            held.push((step.at, old.clone()));
        }
    }
    let kept = back_up(reached.is_simulated(), reached.named(), &held, eds)?;
    if let Some(path) = &kept {
        output.news(&format!("kept      {}", path.display()))?;
    }
    let mut fates = Vec::new();
    for step in steps {
        fates.push(match carry_out(&mut *reached.objects()?, step) {
            Ok(WriteOutcome::Written) => Fate::Written,
            Ok(WriteOutcome::Refused(code)) => Fate::Refused(code),
            Ok(WriteOutcome::Holds(bytes)) if step.is_final => Fate::Holds(bytes),
            // A PDO that is out of use for the time being.
            Ok(WriteOutcome::Holds(_)) => Fate::Written,
            Err(error) => Fate::Unknown(error),
        });
        if fates.last() != Some(&Fate::Written) {
            break;
        }
    }
    let end = match (fates.last(), fates.len().checked_sub(1).and_then(|last| steps.get(last))) {
        (Some(fate), Some(step)) if *fate != Fate::Written => {
            let back = way_back(reached, kept.as_deref(), fates.len() > 1 || !matches!(fate, Fate::Refused(_)));
            Err(ended(reached, step, fate, eds, &back))
        }
        _ => Ok(()),
    };
    fates.resize(steps.len(), Fate::NotTried);
    Ok(Done { fates, end, is_dry: false, is_stored: false })
}

/// Describes how to undo the writes.
fn way_back(reached: &DeviceHandle, kept: Option<&Path>, has_written: bool) -> String {
    match kept {
        _ if !has_written => "nothing was written".to_owned(),
        Some(path) => {
            let command = reached.command(&format!("od restore {}", path.display()));
            format!("{command} puts back what was written")
        }
        None if reached.is_simulated() => "simulated devices forget what was written when this command ends".to_owned(),
        None => "what was written has to be put back by hand: it could not be read before".to_owned(),
    }
}

/// Returns the failure of a write.
fn ended(reached: &DeviceHandle, step: &Step, fate: &Fate, eds: Option<&Eds>, back: &str) -> Failure {
    let doing = format!("writing {}", titled(step.at, &step.name));
    let of_device = |what: String, help: String| {
        Failure::new(Exit::DeviceMismatch, format!("{}: {doing}: {what}", reached.words()), help)
    };
    match fate {
        Fate::Refused(code) => {
            let is_of_value =
                matches!(*code, AbortCode::VALUE | AbortCode::VALUE_HIGH | AbortCode::VALUE_LOW | AbortCode::LENGTH);
            let range = words::range(step.at, step.data_type, reached.named().node_id(), eds).filter(|_| is_of_value);
            let of_type = if eds.is_some() { "" } else { " by its type, and the device takes fewer" };
            let takes = range.map_or(String::new(), |range| format!("it takes {range}{of_type}; "));
            of_device(format!("refused: {code}"), format!("{takes}{back}"))
        }
        Fate::Holds(bytes) => {
            let shown = words::value(step.at, Some(step.data_type), bytes, None);
            let what = format!("it holds {} afterwards", shown.raw);
            of_device(what, format!("the device changes what it is given; {back}"))
        }
        Fate::Unknown(error) => {
            let mut failure = reached.failure(&doing, *error);
            if let Some(finding) = failure.report.diagnostics.first_mut() {
                let help = finding.help.take().map_or(String::new(), |help| format!("{help}; "));
                finding.help = Some(help + back);
            }
            failure
        }
        Fate::Planned | Fate::Written | Fate::NotTried => Failure::new(Exit::Internal, doing, ""),
    }
}

/// Returns the values that were written, or would be, old -> new, the values that were not written, and the overall result.
pub(super) fn told(reached: &DeviceHandle, steps: &[Step], done: Done, output: &mut Output) -> Result<(), Failure> {
    let shown = |step: &Step, bytes: &[u8]| {
        let shown = words::value(step.at, Some(step.data_type), bytes, reached.scaling());
        shown.means.map_or(shown.raw.clone(), |means| format!("{} {means}", shown.raw))
    };
    let Done { fates, end, is_dry, is_stored } = done;
    let of_each = steps.iter().zip(&fates);
    if output.is_json() {
        let each = of_each.map(|(step, fate)| {
            let mut write = json!({
                "object": step.at.to_string(), "name": step.name,
                "old": step.old.as_ref().map(|old| shown(step, old)), "new": shown(step, &step.new),
            });
            let (word, why) = fate.words();
            write["outcome"] = word.into();
            write["why"] = match fate {
                Fate::Holds(bytes) => shown(step, bytes).into(),
                _ => why.map_or(Json::Null, Json::from),
            };
            write
        });
        let each: Vec<_> = each.collect();
        let document = json!({ "dry_run": is_dry, "writes": each, "stored": is_stored });
        return output.end(reached.document(document), end);
    }
    let mut text = String::new();
    for (step, fate) in of_each {
        let (word, why) = fate.words();
        text.push_str(&format!("{word:11} {}\n", titled(step.at, &step.name)));
        let old = step.old.as_ref().map_or("?".to_owned(), |old| shown(step, old));
        text.push_str(&words::change(&old, &shown(step, &step.new)));
        match fate {
            Fate::Holds(bytes) => text.push_str(&format!("    holds {}\n", shown(step, bytes))),
            _ => text.extend(why.map(|why| words::wrapped_behind("    ", &why))),
        }
    }
    if is_stored {
        text.push_str(&format!("stored      {} keeps its parameters beyond power-off (1010h:1)\n", reached.words()));
    }
    output.result(&text)?;
    end
}

impl Fate {
    /// Returns the result, and the reason if the device caused it.
    fn words(&self) -> (&'static str, Option<String>) {
        match self {
            Self::Planned => ("would write", None),
            Self::Written => ("wrote", None),
            Self::Refused(code) => ("refused", Some(code.to_string())),
            Self::Holds(_) => ("changed", None),
            Self::Unknown(error) => ("unknown", Some(error.to_string())),
            Self::NotTried => ("not tried", None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(index: u16, data_type: u16, old: &[u8], new: &[u8]) -> Step {
        let at = Address::new(index, 0);
        let (old, new) = (Some(old.to_vec()), new.to_vec());
        Step { at, name: words::name(at, None), data_type, old, new, is_final: true }
    }

    /// The report after a refusal in the middle: what was written, what was refused and why, what was not tried, and how to undo
    /// it.
    #[test]
    fn writes_that_end_half_way_say_how_far_they_came() {
        let mut output = Output::new(true, false, false);
        let mut reached = DeviceHandle::open(&BusArguments::default(), "left", &mut output).unwrap();
        let steps = [
            step(0x6072, 6, &[0xe8, 3], &[0x84, 3]),
            step(0x605a, 3, &[2, 0], &[99, 0]),
            step(0x6065, 7, &[0xbc, 0x31, 0, 0], &[0xe8, 3, 0, 0]),
        ];
        let done = write_all(&mut reached, &steps, None, &mut output).unwrap();
        assert_eq!(done.fates, [Fate::Written, Fate::Refused(AbortCode::VALUE_HIGH), Fate::NotTried]);
        let saved = done.saved(Saving { save: true, yes: true }, &mut reached, &mut output);
        assert!(!saved.is_stored, "half of it is not kept");
        let failure = saved.end.unwrap_err();
        assert_eq!(failure.exit, Exit::DeviceMismatch);
        let finding = &failure.report.diagnostics[0];
        assert!(
            finding.message.contains("writing 605Ah:0 quick-stop-option: refused: 06090031h"),
            "{}",
            finding.message
        );
        let help = finding.help.as_deref().unwrap();
        assert!(help.contains("it takes -32768 to 32767") && help.ends_with("; nothing was stored"), "{help}");
        // What comes behind the refusal is as it was.
        assert_eq!(reached.read(steps[0].at).unwrap(), [0x84, 3]);
        assert_eq!(reached.read(steps[2].at).unwrap(), [0xbc, 0x31, 0, 0]);
        // On a bus, a command for the same device undoes the writes.
        let DeviceHandle::Node(desk, _) = &mut reached else { panic!("on CAN") };
        desk.arguments = " --bus can0".to_owned();
        let back = way_back(&reached, Some(Path::new("kept.dcf")), true);
        assert_eq!(back, "`yieldwall od restore kept.dcf 1 --bus can0` puts back what was written");
        assert_eq!(way_back(&reached, Some(Path::new("kept.dcf")), false), "nothing was written");
    }

    #[test]
    fn all_that_was_written_can_be_stored() {
        let mut output = Output::new(true, false, false);
        let mut reached = DeviceHandle::open(&BusArguments::default(), "left", &mut output).unwrap();
        let steps = [step(0x6072, 6, &[0xe8, 3], &[0x84, 3])];
        let done = write_all(&mut reached, &steps, None, &mut output).unwrap();
        let saved = done.saved(Saving { save: true, yes: true }, &mut reached, &mut output);
        assert_eq!((saved.end.is_ok(), saved.is_stored, saved.is_dry), (true, true, false));
    }
}
