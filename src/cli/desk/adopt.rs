//! `yieldwall drive adopt`: a drive nobody has a profile of, and the profile that follows.

use std::path::{Path, PathBuf};

use serde_json::json;
use yieldwall_drives::cia402::OperationMode;

use super::keeping::back_up;
use super::od::sheet;
use super::place::BusArguments;
use super::reached::DeviceHandle;
use super::words::{mode_words, name, titled};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use crate::replace::Replace;
use yieldwall_config::ProfileName;
use yieldwall_drives::eds::Eds;
use yieldwall_drives::esi::{self, Device as EsiDevice, Esi};
use yieldwall_service::adopt::{Refusal, Survey, contradictions, originals, profile, survey};
use yieldwall_service::count_axes;

/// Columns of a terminal.
const WIDTH: usize = 80;

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Write the profile of a drive: asked of it and tried out in Switch On Disabled; all values are put back
    Adopt(Arguments),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// A node id, the position of a device on EtherCAT, or the name of a drive in the rig
    #[arg(long)]
    node: String,
    /// The profile's file; standard output unless one is named
    #[arg(long, value_name = "PROFILE.yaml")]
    out: Option<PathBuf>,
    /// Name of the profile; made of the drive's own name unless given
    #[arg(long)]
    name: Option<String>,
    /// A data sheet: EDS or DCF, compared with the drive, whose word counts; on EtherCAT the device description (ESI), for its clock
    #[arg(long, value_name = "FILE")]
    eds: Option<PathBuf>,
    /// Say which objects would be tried out, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    replace: Replace,
    #[command(flatten)]
    place: BusArguments,
}

pub(crate) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    let Command::Adopt(arguments) = command;
    if let Some(name) = arguments.name.as_ref().filter(|name| kebab(name) != **name || name.is_empty()) {
        let help = format!("write for example --name {}", kebab(name));
        return Err(Failure::new(
            Exit::Usage,
            format!("--name {name}: small letters, digits and dashes make a name"),
            help,
        ));
    }
    if let Some(name) = arguments.name.as_ref().filter(|name| is_shipped(name)) {
        let message = format!("--name {name}: a profile that comes with the program is called so");
        return Err(Failure::new(Exit::Usage, message, format!("write for example --name {name}{ADOPTED}")));
    }
    let sheet = arguments.eds.as_deref().map(|path| Sheet::read(path, output)).transpose()?;
    let eds = sheet.as_ref().and_then(Sheet::eds);
    let mut reached = DeviceHandle::open(&arguments.place, &arguments.node, output)?;
    let values = originals(&mut *reached.tried()?);
    let values = values.map_err(|refusal| refused(&reached, refusal))?;
    if arguments.dry_run {
        let each: Vec<String> = values.iter().map(|(at, _)| titled(*at, &name(*at, eds))).collect();
        if output.is_json() {
            return output.report(json!({ "place": reached.place(), "dry_run": true, "tries": each }));
        }
        return output.result(&format!("would try out, and put back:\n{}\n", each.join("\n")));
    }
    if let Some(path) = &arguments.out {
        arguments.replace.check_new(path)?;
    }
    if let Some(path) = back_up(reached.is_simulated(), reached.named(), &values, eds)? {
        output.aside(&format!("kept      {}", path.display()));
    }
    let found = survey(&mut *reached.tried()?, &values, eds);
    let mut found = found.map_err(|refusal| refused(&reached, refusal))?;
    found.axes = count_axes(|at| Ok::<_, Failure>(reached.number_of(at, "counting its axes")?.is_some()))?;
    let mut product = eds.map(|eds| eds.device.product.clone());
    if let Some(Sheet::Esi(esi, path)) = &sheet {
        let device = described(esi, path, &found, &reached)?;
        found.sync1_us = sync1_us(device);
        product = Some(device.name.clone());
    }
    let named = arguments.name.clone().or_else(|| {
        found.name.as_deref().into_iter().chain(product.as_deref()).map(kebab).find(|name| !name.is_empty())
    });
    let named = named.unwrap_or_else(|| format!("node-{}", reached.number()));
    let named = if is_shipped(&named) { format!("{named}{ADOPTED}") } else { named };
    let file = arguments.eds.as_deref().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    let (text, missing) = profile(&found, eds.map(|eds| (eds, &*file)), &named, env!("CARGO_PKG_VERSION"));
    let contradictions = eds.map_or_else(Vec::new, |eds| contradictions(eds, &found));
    if let Some(path) = &arguments.out {
        arguments.replace.write(path, text.as_bytes())?;
    }
    let modes: Vec<&str> = found.modes.iter().map(|mode: &OperationMode| mode_words(*mode)).collect();
    if output.is_json() {
        return output.report(reached.document(json!({
            "name": named,
            "file": arguments.out,
            "modes": modes,
            "mapping_entries": found.mapping_entries,
            "has_dummies": found.has_dummies,
            "has_rpdo_timer": found.has_rpdo_timer,
            "missing": missing,
            "contradictions": contradictions,
            "profile": text,
        })));
    }
    let Some(path) = &arguments.out else { return output.verbatim(&text) };
    let mut told = format!(
        "{}: {named}, {}\n",
        reached.words(),
        if modes.is_empty() { "no mode that `run` could use".to_owned() } else { modes.join(", ") }
    );
    missing.iter().for_each(|line| told.push_str(&item(line)));
    if !contradictions.is_empty() {
        told.push_str("the data sheet contradicts the drive, whose word counts:\n");
        contradictions.iter().for_each(|line| told.push_str(&item(line)));
    }
    told.push_str(&format!("written   {}; `yieldwall config check` checks it\n", path.display()));
    output.result(&told)
}

/// A document about a drive: an EDS or DCF of CANopen, or a device description of EtherCAT with its path.
enum Sheet {
    Eds(Box<Eds>),
    Esi(Esi, PathBuf),
}

impl Sheet {
    fn read(path: &Path, output: &mut Output) -> Result<Self, Failure> {
        if path.extension().is_none_or(|end| !end.eq_ignore_ascii_case("xml")) {
            return Ok(Self::Eds(Box::new(sheet(path, output)?)));
        }
        let about = |exit: Exit, message: String| {
            let help = "name the device description (ESI) of the drive, or an EDS or DCF";
            Failure::about_file(exit, path, format!("{}: {message}", path.display()), help)
        };
        let unread = |error: std::io::Error| about(Exit::Usage, format!("cannot be read: {error}"));
        let facts = std::fs::metadata(path).map_err(unread)?;
        if !facts.is_file() {
            return Err(about(Exit::Usage, "is no file".to_owned()));
        }
        if facts.len() > esi::MAX_BYTES as u64 {
            return Err(about(Exit::ConfigInvalid, esi::EsiError::TooLarge(facts.len() as usize).to_string()));
        }
        let bytes = std::fs::read(path).map_err(unread)?;
        let esi = Esi::read(&bytes).map_err(|error| about(Exit::ConfigInvalid, error.to_string()))?;
        Ok(Self::Esi(esi, path.to_owned()))
    }

    fn eds(&self) -> Option<&Eds> {
        match self {
            Self::Eds(eds) => Some(eds),
            Self::Esi(..) => None,
        }
    }
}

/// The device of a device description that a drive is.
fn described<'a>(esi: &'a Esi, path: &Path, found: &Survey, reached: &DeviceHandle) -> Result<&'a EsiDevice, Failure> {
    let [vendor, product, revision, _] = found.identity;
    let of_product = || esi.devices.iter().filter(|device| Some(device.product_code) == product);
    let of_revision = of_product().find(|device| Some(device.revision) == revision);
    // Another revision of a product differs in details at most.
    let device = of_revision.or_else(|| of_product().next_back()).filter(|_| Some(esi.vendor_id) == vendor);
    device.ok_or_else(|| {
        let [vendor, product] = [vendor, product].map(Option::unwrap_or_default);
        let message = format!(
            "{}: it is product {product:08X}h of vendor {vendor:08X}h, which {} does not describe; its objects have their values again",
            reached.words(),
            path.display()
        );
        Failure::new(Exit::DeviceMismatch, message, "name the description of this drive, or leave `--eds` out")
    })
}

/// Time from SYNC0 to SYNC1 by the first mode of its clock that synchronises it, us; `None` without SYNC1.
fn sync1_us(device: &EsiDevice) -> Option<u32> {
    let mode = device.op_modes.iter().find(|mode| mode.assign_activate != 0)?;
    let shift_ns = u32::try_from(mode.sync1_shift_ns).unwrap_or(0);
    mode.has_sync1().then_some(shift_ns / 1000)
}

/// Why a drive is not adopted.
fn refused(reached: &DeviceHandle, refusal: Refusal) -> Failure {
    let message = format!("{}: {refusal}", reached.words());
    let untouched = format!("{message}; nothing was written");
    let again = format!("{message}; its objects have their values again");
    let (number, arguments) = (reached.number(), reached.arguments());
    match refusal {
        Refusal::Service(error) => reached.failure("asking what it can do", error),
        Refusal::State(_) => {
            let help = format!("{} says why; --reset-fault takes it out of Fault", reached.command("state"));
            Failure::new(Exit::DeviceFault, untouched, help)
        }
        Refusal::Nmt(_) => {
            Failure::new(Exit::Usage, untouched, format!("`yieldwall nmt {number} preop{arguments}` first"))
        }
        Refusal::Al(_) => {
            Failure::new(Exit::Usage, untouched, format!("`yieldwall state {number} preop{arguments}` first"))
        }
        Refusal::NoDrive(_) => {
            Failure::new(Exit::DeviceMismatch, untouched, format!("`yieldwall scan{arguments}` shows the drives"))
        }
        Refusal::NoMode(..) => {
            let help = "write its profile by hand: `unused` and `gap` stand for entries that a rig does not need, `fixed: true` for a mapping \
                        that cannot change";
            Failure::new(Exit::DeviceMismatch, again, help)
        }
        Refusal::Lacks(_) => Failure::new(Exit::DeviceMismatch, again, ""),
        Refusal::NotRestored(_) => {
            let help = if reached.is_on_can() {
                format!("`yieldwall nmt {number} reset{arguments}` has it start with its stored values")
            } else {
                "switch it off and on: it starts with its stored values".to_owned()
            };
            Failure::new(Exit::DeviceMismatch, message, help)
        }
    }
}

/// What is put behind the name of a profile that is another one's.
const ADOPTED: &str = "-adopted";

/// Whether a profile that comes with the program is called so.
fn is_shipped(name: &str) -> bool {
    ProfileName::shipped().any(|(shipped, _)| shipped == name)
}

/// A line of a list, not wider than a terminal.
fn item(line: &str) -> String {
    let options = textwrap::Options::new(WIDTH).initial_indent("  - ").subsequent_indent("    ");
    textwrap::fill(line, options) + "\n"
}

/// A name as profiles have it.
fn kebab(name: &str) -> String {
    let lower: String =
        name.chars().map(|one| if one.is_ascii_alphanumeric() { one.to_ascii_lowercase() } else { '-' }).collect();
    lower.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-")
}
