//! `yieldwall drive adopt`: writes the profile of a drive that nobody has described.

use std::collections::BTreeMap;
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
use crate::printable::one_line;
use crate::replace::Replace;
use yieldwall_config::ProfileName;
use yieldwall_drives::eds::Eds;
use yieldwall_drives::esi::{self, AxisSteps, Device as EsiDevice, Esi, ModuleError, PluggedModule, axis_steps};
use yieldwall_drives::objects::VENDOR_ID;
use yieldwall_drives::profiles::AxisOffset;
use yieldwall_fieldbus::objects::Address;
use yieldwall_service::adopt::{Refusal, contradictions, originals, profile, survey};
use yieldwall_service::count_axes_by;

/// Columns of a terminal.
const WIDTH: usize = 80;

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Query and test a drive in Switch On Disabled, restore it, write its profile
    Adopt(Arguments),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Node id, EtherCAT position, or drive name from the rig
    #[arg(long)]
    node: String,
    /// File of the profile; default: standard output
    #[arg(long, value_name = "PROFILE.yaml")]
    out: Option<PathBuf>,
    /// Name of the profile; default: derived from the drive's own name
    #[arg(long)]
    name: Option<String>,
    /// Data sheet to compare with the drive, whose values win: EDS, DCF or ESI
    ///
    /// The device description (ESI) is for a drive on EtherCAT: it has the clock and the slot modules.
    #[arg(long, value_name = "FILE")]
    eds: Option<PathBuf>,
    /// Module in a slot of the device description, instead of the default module
    ///
    /// Give it by type, name or number, or `none` for an empty slot. Slots count from 1.
    #[arg(long = "module", value_name = "SLOT=MODULE", value_parser = slot_module, requires = "eds")]
    modules: Vec<(u32, String)>,
    /// Print which objects would be tested, and write nothing
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    replace: Replace,
    #[command(flatten)]
    place: BusArguments,
}

/// Parses a slot and the word for its module.
fn slot_module(text: &str) -> Result<(u32, String), String> {
    let slot = text.split_once('=').and_then(|(slot, module)| Some((slot.trim().parse().ok()?, module.trim())));
    let slot = slot.filter(|(_, module)| !module.is_empty());
    slot.map(|(slot, module)| (slot, module.to_owned()))
        .ok_or_else(|| "write for example 2=Torque or 2=#x200".to_owned())
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
    if matches!(sheet, Some(Sheet::Eds(_))) && !arguments.modules.is_empty() {
        let message = "--module names a module of a device description (ESI), and `--eds` is another data sheet";
        return Err(Failure::new(
            Exit::Usage,
            message,
            "name the device description with --eds, or leave --module out",
        ));
    }
    let mut reached = DeviceHandle::open(&arguments.place, &arguments.node, output)?;
    let description = match &sheet {
        Some(Sheet::Esi(esi, path)) => Some(Description::of(esi, path, &arguments.modules, &mut reached)?),
        _ => None,
    };
    let modules = description.as_ref().map_or(&[][..], |description| &description.modules);
    for [slot, module] in modules {
        output.aside(&format!("module    {slot}: {module}"));
    }
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
    let device = description.as_ref().map(|description| &description.device);
    let found = survey(&mut *reached.tried()?, &values, eds, device);
    let mut found = found.map_err(|refusal| refused(&reached, refusal))?;
    found.axis_steps = description.as_ref().and_then(|description| description.axis_steps);
    let step = found.axis_steps.map(|steps| steps.objects);
    let offset = |axis| step.map_or(AxisOffset::standard(axis), |step| AxisOffset::apart(step, axis));
    let has = |at| Ok::<_, Failure>(reached.number_of(at, "counting its axes")?.is_some());
    found.axes = count_axes_by(offset, has)?;
    found.sync1_us = device.and_then(sync1_us);
    let product = eds.map(|eds| &eds.device.product).or(device.map(|device| &device.name));
    let named = arguments
        .name
        .clone()
        .or_else(|| found.name.iter().chain(product).map(|name| kebab(name)).find(|name| !name.is_empty()));
    let named = named.unwrap_or_else(|| format!("node-{}", reached.number()));
    let named = if is_shipped(&named) { format!("{named}{ADOPTED}") } else { named };
    let file = arguments.eds.as_deref().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    let (text, missing) = profile(&found, eds.map(|eds| (eds, &*file)), &named, env!("CARGO_PKG_VERSION"));
    let contradictions = contradictions(eds, &found);
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
            "modules": modules.iter().map(|[slot, module]| json!({ "slot": slot, "module": module })).collect::<Vec<_>>(),
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
        told.push_str("the data sheet differs from the drive; the profile has the values of the drive:\n");
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

/// The device of a device description that a drive is, with its modules.
pub(super) struct Description {
    /// The device, with the process data of its modules.
    pub(super) device: EsiDevice,
    /// Each slot that has a module, and the module.
    pub(super) modules: Vec<[String; 2]>,
    /// Distances of its axes, if its modules are axes.
    pub(super) axis_steps: Option<AxisSteps>,
}

impl Description {
    /// Reads the identity of a drive, and takes the modules that are named by slot, else the default ones.
    pub(super) fn of(
        esi: &Esi,
        path: &Path,
        named: &[(u32, String)],
        reached: &mut DeviceHandle,
    ) -> Result<Self, Failure> {
        let named: BTreeMap<u32, String> = named.iter().cloned().collect();
        let device = described(esi, path, reached)?;
        let refused = |error: ModuleError| {
            let help = match (&error, error.place()) {
                (ModuleError::NoSlot { .. }, _) => "--module counts the slots of the file from 1".to_owned(),
                (_, Some(place)) => {
                    format!("name the module that is plugged in: --module {place}=MODULE; or leave --eds out")
                }
                (_, None) => {
                    "ask the vendor for one file with the device and its modules, or leave --eds out".to_owned()
                }
            };
            let message = format!("{}: {}: {error}; nothing was written", path.display(), one_line(&device.type_name));
            Failure::about_file(Exit::ConfigInvalid, path, message, help)
        };
        let plugged = esi.plugged(device, &named).map_err(refused)?;
        let in_words = |own: &PluggedModule<'_>| {
            [own.words(), format!("{} (#x{:08X})", one_line(own.module.title()), own.module.ident)]
        };
        Ok(Self {
            device: device.with_modules(&plugged).map_err(refused)?,
            modules: plugged.iter().map(in_words).collect(),
            axis_steps: axis_steps(&plugged),
        })
    }
}

/// Returns the device in a device description that matches the drive's identity.
fn described<'a>(esi: &'a Esi, path: &Path, reached: &mut DeviceHandle) -> Result<&'a EsiDevice, Failure> {
    let mut identity = |sub| reached.number_of(Address::new(VENDOR_ID.index, sub), "reading its identity (1018h)");
    let [vendor, product, revision] = [identity(1)?, identity(2)?, identity(3)?];
    let of_product = || esi.devices.iter().filter(|device| Some(device.product_code) == product);
    let of_revision = of_product().find(|device| Some(device.revision) == revision);
    // Another revision of a product differs in details at most.
    let device = of_revision.or_else(|| of_product().next_back()).filter(|_| Some(esi.vendor_id) == vendor);
    device.ok_or_else(|| {
        let [vendor, product] = [vendor, product].map(Option::unwrap_or_default);
        let message = format!(
            "{}: it is product {product:08X}h of vendor {vendor:08X}h, which {} does not describe; nothing was written",
            reached.words(),
            path.display()
        );
        Failure::new(Exit::DeviceMismatch, message, "name the description of this drive, or leave `--eds` out")
    })
}

/// Returns the time from SYNC0 to SYNC1 by the first mode of its clock that synchronises it, us; `None` without SYNC1.
fn sync1_us(device: &EsiDevice) -> Option<u32> {
    let mode = device.op_modes.iter().find(|mode| mode.assign_activate != 0)?;
    let shift_ns = u32::try_from(mode.sync1_shift_ns).unwrap_or(0);
    mode.has_sync1().then_some(shift_ns / 1000)
}

/// Explains why a drive is not adopted.
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

/// Suffix of a profile's name that another profile already has.
const ADOPTED: &str = "-adopted";

/// Whether a shipped profile has this name.
fn is_shipped(name: &str) -> bool {
    ProfileName::shipped().any(|(shipped, _)| shipped == name)
}

/// Returns a line of a list, not wider than a terminal.
fn item(line: &str) -> String {
    let options = textwrap::Options::new(WIDTH).initial_indent("  - ").subsequent_indent("    ");
    textwrap::fill(line, options) + "\n"
}

/// Returns a name as profiles have it.
fn kebab(name: &str) -> String {
    let lower: String =
        name.chars().map(|one| if one.is_ascii_alphanumeric() { one.to_ascii_lowercase() } else { '-' }).collect();
    lower.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-")
}
