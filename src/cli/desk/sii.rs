//! `yieldwall sii`: what devices on EtherCAT keep in their memory chips.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::keeping::keep_image;
use super::place::Place;
use super::scan::{fit_of, identity_words};
use super::segment::{Device, SegmentSession};
use super::words::{mapped, table, wrapped_behind};
use crate::confirm::agreed;
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_fieldbus::ethercat::sii::{MailboxArea, Pdo, Sii, changes, seal};
use yieldwall_service::{Present, SegmentError};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Read the SII of a device: identity, mailboxes, sync managers, process data
    Read(Read),
    /// Write an image into the memory chip of a device, after what it holds was kept in a file; asks before
    Write(Write),
    /// Check the SII of devices: 7 if one is damaged, or is of another device than the rig says
    Check(Check),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Read {
    /// A position, or the name of a device in the rig
    node: String,
    /// Keep the image as it is in a new file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    place: Place,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Write {
    /// A position, or the name of a device in the rig
    node: String,
    /// The image, as `sii read --out` writes it; its checksum is made anew
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    asking: Asking,
    #[command(flatten)]
    place: Place,
}

/// How a memory chip is written.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Asking {
    /// Write without asking
    #[arg(long)]
    yes: bool,
    /// Say what would be written, and write nothing
    #[arg(long, conflicts_with = "yes")]
    dry_run: bool,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Check {
    /// A position, or the name of a device in the rig; all unless one is named
    node: Option<String>,
    #[command(flatten)]
    place: Place,
}

pub(crate) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Read(arguments) => read(arguments, output),
        Command::Write(arguments) => write(arguments, output),
        Command::Check(arguments) => check(arguments, output),
    }
}

fn read(arguments: &Read, output: &mut Output) -> Result<(), Failure> {
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let device = desk.device(&arguments.node)?;
    let image = desk.service.sii_image(device.position);
    let image = image.map_err(|error| desk.failure(&device, "reading its SII", error))?;
    if let Some(path) = &arguments.out {
        keep(path, &image)?;
    }
    let sii = Sii::read(&image);
    let end = match &sii {
        Ok(_) => Ok(()),
        Err(error) => {
            let message = format!("{}: its SII is damaged: {error}", device.words());
            let help = "`yieldwall sii write` writes the image of the vendor anew; --out keeps what it holds now";
            Err(Failure::new(Exit::OutOfTolerance, message, help))
        }
    };
    if output.is_json() {
        let hexadecimal: String = image.iter().map(|byte| format!("{byte:02x}")).collect();
        let document = json!({
            "place": desk.place,
            "position": device.position,
            "out": arguments.out.as_ref().map(|path| path.display().to_string()),
            "image": hexadecimal,
            "sii": sii.as_ref().ok().map(document),
        });
        return output.end(document, end);
    }
    if let Ok(sii) = &sii {
        output.result(&format!("{}\n{}", device.words(), text(sii, image.len())))?;
    }
    if let Some(path) = &arguments.out {
        output.news(&format!("kept      {} ({} bytes)", path.display(), image.len()))?;
    }
    end
}

/// Writes an image into a file that was not there.
pub(super) fn keep(path: &Path, image: &[u8]) -> Result<(), Failure> {
    use std::io::Write;

    let file = std::fs::File::create_new(path).and_then(|mut file| file.write_all(image));
    file.map_err(|error| {
        Failure::about_file(
            Exit::Usage,
            path,
            format!("it cannot be written: {error}"),
            "name a file that is not there",
        )
    })
}

fn write(arguments: &Write, output: &mut Output) -> Result<(), Failure> {
    let unfit = |message: String, help: &str| Failure::about_file(Exit::ConfigInvalid, &arguments.file, message, help);
    let image = std::fs::read(&arguments.file);
    let mut image = image.map_err(|error| unfit(format!("it cannot be read: {error}"), ""))?;
    seal(&mut image);
    let help = "name an image of the vendor, or one that `yieldwall sii read --out` kept";
    let sii = Sii::read(&image).map_err(|error| unfit(format!("this is no whole image: {error}"), help))?;
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let device = desk.device(&arguments.node)?;
    let present = desk.service.present(device.position);
    let present = present.map_err(|error| desk.failure(&device, "reading its SII", error))?;
    refuse_another_kind(&device, &present, &sii)?;
    overwrite(&mut desk, &device, &image, arguments.asking, output)
}

/// Refuses the image of another device than the one that is there, as far as that says who it is, or than the rig names.
fn refuse_another_kind(device: &Device, present: &Present, image: &Sii) -> Result<(), Failure> {
    let kind = |sii: &Sii| (sii.vendor_id, sii.product_code);
    let says = present.sii.as_ref().ok().map(kind);
    let of_image = [image.vendor_id, image.product_code, image.revision, image.serial].map(Some);
    let fits = fit_of(device.of_rig(), of_image, None);
    let is_of_rig = device.of_rig().is_none_or(|(name, _)| fits == name);
    if says.is_none_or(|says| says == kind(image)) && is_of_rig {
        return Ok(());
    }
    let words = identity_words(of_image).unwrap_or_default();
    let message = format!("{}: the image is of another device ({words}); nothing was written", device.words());
    Err(Failure::new(Exit::DeviceMismatch, message, "name the image of this device; `yieldwall scan` shows who it is"))
}

/// Writes the words of an image that differ, once a person has said yes and what the chip holds is kept.
pub(super) fn overwrite(
    desk: &mut SegmentSession,
    device: &Device,
    image: &[u8],
    asking: Asking,
    output: &mut Output,
) -> Result<(), Failure> {
    let held = desk.service.sii_image(device.position);
    let held = held.map_err(|error| desk.failure(device, "reading its SII", error))?;
    let words = changes(&held, image);
    let told = |word: &str, kept: Option<&Path>, desk: &SegmentSession, output: &mut Output| {
        if output.is_json() {
            return output.report(json!({
                "place": desk.place,
                "position": device.position,
                "dry_run": asking.dry_run,
                "kept": kept.map(|path| path.display().to_string()),
                "words": words.iter().map(|(word, bytes)| json!({ "word": word, "bytes": bytes })).collect::<Vec<_>>(),
            }));
        }
        if words.is_empty() {
            return output.result("nothing to write: the chip holds the image\n");
        }
        output.result(&format!("{word:11} {} of {} words of the SII\n", words.len(), image.len() / 2))?;
        output.news("    in force when the device is switched off and on")
    };
    if asking.dry_run || words.is_empty() {
        return told("would write", None, desk, output);
    }
    desk.refuse_led()?;
    let question = format!(
        "{}: {} words of its memory chip are written over; it keeps them beyond power-off",
        device.words(),
        words.len()
    );
    if !asking.yes && !agreed(&question) {
        let message = format!("{}: nothing was written", device.words());
        return Err(Failure::new(Exit::Usage, message, "answer yes, or give --yes"));
    }
    let kept = if desk.is_simulated { None } else { Some(keep_image(device.position, &held)?) };
    if let Some(path) = &kept {
        output.news(&format!("kept        {}", path.display()))?;
    }
    desk.service.write_sii(device.position, &words).map_err(|error| {
        let mut failure = desk.failure(device, "writing its SII", error);
        if let (Some(finding), Some(path)) = (failure.report.diagnostics.first_mut(), &kept) {
            let command = format!("yieldwall sii write {} {}{}", device.position, path.display(), desk.arguments);
            finding.help = Some(format!("do not switch it off; `{command}` puts back what it held"));
        }
        failure
    })?;
    told("wrote", kept.as_deref(), desk, output)
}

fn area(area: MailboxArea) -> String {
    format!("{:04X}h, {} bytes", area.start, area.len)
}

pub(super) fn text(sii: &Sii, bytes: usize) -> String {
    let identity = [sii.vendor_id, sii.product_code, sii.revision, sii.serial].map(Some);
    let mut rows = vec![
        ["image".to_owned(), format!("{bytes} bytes, whole")],
        ["name".to_owned(), sii.name.clone()],
        ["order".to_owned(), sii.order.clone()],
        ["identity".to_owned(), identity_words(identity).unwrap_or_default()],
        ["alias".to_owned(), if sii.alias == 0 { "none".to_owned() } else { sii.alias.to_string() }],
        ["mailbox to it".to_owned(), area(sii.receive_mailbox)],
        ["mailbox from it".to_owned(), area(sii.send_mailbox)],
        ["E-bus".to_owned(), format!("{} mA", sii.e_bus_ma)],
    ];
    for (number, manager) in sii.sync_managers.iter().enumerate() {
        let kind = match manager.kind {
            1 => "mailbox to it",
            2 => "mailbox from it",
            3 => "outputs",
            4 => "inputs",
            _ => "unused",
        };
        let settings = manager.settings;
        let says =
            format!("{:04X}h, {} bytes, control {:02X}h, {kind}", settings.start, settings.len, settings.control);
        rows.push([format!("sync manager {number}"), says]);
    }
    let mut text = table(&rows);
    for (direction, pdos) in [("outputs", &sii.rx_pdos), ("inputs", &sii.tx_pdos)] {
        pdos.iter().for_each(|pdo| text.push_str(&pdo_text(direction, pdo)));
    }
    text
}

fn entries(pdo: &Pdo) -> impl Iterator<Item = String> {
    pdo.entries
        .iter()
        .map(|entry| mapped(u32::from(entry.index) << 16 | u32::from(entry.sub) << 8 | u32::from(entry.bits)))
}

fn pdo_text(direction: &str, pdo: &Pdo) -> String {
    let manager = if pdo.sync_manager == 0xff { "none".to_owned() } else { pdo.sync_manager.to_string() };
    let head = format!("{:04X}h {direction}, sync manager {manager}\n", pdo.index);
    head + &entries(pdo).map(|entry| format!("    {entry}\n")).collect::<String>()
}

fn document(sii: &Sii) -> Value {
    let pdos = |pdos: &[Pdo]| {
        let each = pdos.iter().map(|pdo| {
            json!({ "index": pdo.index, "sync_manager": pdo.sync_manager, "maps": entries(pdo).collect::<Vec<_>>() })
        });
        each.collect::<Vec<_>>()
    };
    let managers = sii.sync_managers.iter().map(|manager| {
        let settings = manager.settings;
        json!({ "start": settings.start, "bytes": settings.len, "control": settings.control, "kind": manager.kind })
    });
    json!({
        "name": sii.name,
        "order": sii.order,
        "vendor_id": sii.vendor_id,
        "product_code": sii.product_code,
        "revision": sii.revision,
        "serial": sii.serial,
        "alias": sii.alias,
        "sync_managers": managers.collect::<Vec<_>>(),
        "outputs": pdos(&sii.rx_pdos),
        "inputs": pdos(&sii.tx_pdos),
    })
}

/// A device, and what is wrong with its SII.
pub(super) type Checked = (Device, Vec<String>);

fn check(arguments: &Check, output: &mut Output) -> Result<(), Failure> {
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let checked = checked(&mut desk, arguments.node.as_deref())?;
    let wrong: Vec<&Checked> = checked.iter().filter(|(_, wrong)| !wrong.is_empty()).collect();
    let end = match wrong.as_slice() {
        [] => Ok(()),
        [(device, first), ..] => {
            let message = format!("{}: {}", device.words(), first.concat());
            let help = format!("`yieldwall sii read {}{} --out FILE` keeps its image", device.position, desk.arguments);
            Err(Failure::new(Exit::OutOfTolerance, message, help))
        }
    };
    if output.is_json() {
        let devices: Vec<Value> = checked
            .iter()
            .map(|(device, wrong)| json!({ "position": device.position, "whole": wrong.is_empty(), "wrong": wrong }))
            .collect();
        return output.end(json!({ "place": desk.place, "devices": devices }), end);
    }
    output.result(&check_text(&checked))?;
    end
}

pub(super) fn checked(desk: &mut SegmentSession, word: Option<&str>) -> Result<Vec<Checked>, Failure> {
    let mut checked = Vec::new();
    for device in desk.devices_of(word)? {
        let present = desk.service.present(device.position);
        let wrong = match present {
            Ok(present) => wrong(&device, &present),
            Err(SegmentError::Failed(failure)) => vec![failure.to_string()],
            Err(error) => return Err(desk.failure(&device, "reading its SII", error)),
        };
        checked.push((device, wrong));
    }
    Ok(checked)
}

pub(super) fn wrong(device: &Device, present: &Present) -> Vec<String> {
    let sii = match &present.sii {
        Ok(sii) => sii,
        Err(failure) => return vec![failure.to_string()],
    };
    let mut wrong = Vec::new();
    if let Some((name, Some(_))) = device.of_rig() {
        let fits = fit_of(device.of_rig(), present.identity, None);
        if fits != name {
            wrong.push(fits);
        }
    }
    for (kind, area, word) in [(1, sii.receive_mailbox, 0x18), (2, sii.send_mailbox, 0x1a)] {
        let manager = sii.sync_managers.iter().find(|manager| manager.kind == kind).map(|manager| manager.settings);
        if let Some(manager) = manager.filter(|manager| (manager.start, manager.len) != (area.start, area.len)) {
            wrong.push(format!(
                "words {word:04X}h and {:04X}h put a mailbox at {}, and its sync manager at {:04X}h, {} bytes",
                word + 1,
                self::area(area),
                manager.start,
                manager.len
            ));
        }
    }
    wrong
}

pub(super) fn check_text(checked: &[Checked]) -> String {
    let mut text = String::new();
    for (device, wrong) in checked {
        let word = if wrong.is_empty() { "whole" } else { "wrong" };
        text.push_str(&format!("{word:7} {}\n", device.words()));
        wrong.iter().for_each(|wrong| text.push_str(&wrapped_behind("        ", wrong)));
    }
    text
}
