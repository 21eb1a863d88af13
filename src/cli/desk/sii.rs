//! `yieldwall sii`: the memory chips of devices on EtherCAT.

pub(super) mod description;

use std::io::Read as _;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::keeping::keep_image;
use super::place::BusArguments;
use super::scan::{fit_of, identity_words};
use super::segment::{Device, SegmentSession};
use super::words::{mapped, table, wrapped_behind};
use crate::confirm::agreed;
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_drives::esi::{self, Esi};
use yieldwall_fieldbus::ethercat::sii::{MOST_WORDS, MailboxArea, Pdo, Sii, categories, changes, chip_words, seal};
use yieldwall_service::{Present, SegmentError};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Read a device's SII: identity, mailboxes, sync managers, process data
    Read(Read),
    /// Write an SII image to a device's memory chip, after a backup and confirmation
    ///
    /// The image comes from a file, or from the vendor's device description (ESI). The command saves the chip's contents to a file,
    /// and asks before it writes. It refuses other text files, and images that are too large for the chip.
    Write(Write),
    /// Check the SII of devices; exit with 7 if one is empty, unreadable or wrong
    ///
    /// An SII is wrong if the rig expects another device. A damaged, missing or unusual part of an image is a warning.
    Check(Check),
}

#[derive(Debug, clap::Args)]
pub(crate) struct Read {
    /// EtherCAT position, or device name from the rig
    node: String,
    /// Save the raw image to a new file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    place: BusArguments,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Write {
    /// EtherCAT position, or device name from the rig
    node: String,
    /// Image from `sii read --out`, with a recomputed checksum, or device description (ESI, XML)
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Device in the device description, by type or product code, if the chip does not report it
    #[arg(long, value_name = "TYPE")]
    device: Option<String>,
    /// Write the image even if it is of another device, or has no standard category
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    asking: Asking,
    #[command(flatten)]
    place: BusArguments,
}

/// Options for writing a memory chip.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Asking {
    /// Write without asking
    #[arg(long)]
    yes: bool,
    /// Print what would be written, and write nothing
    #[arg(long, conflicts_with = "yes")]
    dry_run: bool,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Check {
    /// EtherCAT position, or device name from the rig; default: all devices
    node: Option<String>,
    #[command(flatten)]
    place: BusArguments,
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
            let message = format!("{}: its SII cannot be used: {error}", device.words());
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

/// Bytes of the largest chip.
const MOST_BYTES: u64 = 2 * MOST_WORDS as u64;

fn write(arguments: &Write, output: &mut Output) -> Result<(), Failure> {
    let content = content_of(&arguments.file, arguments.force)?;
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let device = desk.device(&arguments.node)?;
    let present = desk.service.present(device.position);
    let present = present.map_err(|error| desk.failure(&device, "reading its SII", error))?;
    let sealed = match content {
        Content::Image(mut image) => {
            seal(&mut image);
            image
        }
        Content::Description(esi) => {
            description::image(&esi, &device, &present, (&arguments.file, arguments.device.as_deref()), output)?
        }
    };
    let sii = Sii::read(&sealed).map_err(|error| no_image(&arguments.file, &error.to_string(), OTHER_IMAGE))?;
    if !output.is_json() {
        for warning in &sii.warnings {
            output.news(&format!("warning     {warning}"))?;
        }
    }
    refuse_too_long(&mut desk, &device, &sealed, &arguments.file)?;
    if !arguments.force {
        refuse_another_kind(&device, &present, &sii)?;
    }
    overwrite(&mut desk, &device, &sealed, arguments.asking, output)
}

const OTHER_IMAGE: &str = "name an image of the vendor, or one that `yieldwall sii read NODE --out FILE` kept";

fn no_image(path: &Path, message: &str, help: &str) -> Failure {
    Failure::about_file(Exit::ConfigInvalid, path, format!("{message}; nothing was written"), help)
}

/// A file that makes an image.
enum Content {
    Image(Vec<u8>),
    Description(Esi),
}

/// Returns the content of a file, as far as it is known without the device.
fn content_of(path: &Path, is_forced: bool) -> Result<Content, Failure> {
    let mut image = Vec::new();
    let most = esi::MAX_BYTES as u64 + 1;
    let read = std::fs::File::open(path).and_then(|file| file.take(most).read_to_end(&mut image));
    read.map_err(|error| no_image(path, &format!("it cannot be read: {error}"), ""))?;
    if description::is_one(&image) {
        let esi =
            Esi::read(&image).map_err(|error| no_image(path, &error.to_string(), "ask the vendor for a whole file"))?;
        return Ok(Content::Description(esi));
    }
    if let Some((is, help)) = text_kind(&image) {
        return Err(no_image(path, &format!("this is {is}, and a memory chip takes a binary image"), help));
    }
    if image.len() as u64 > MOST_BYTES {
        return Err(no_image(path, "this is longer than the largest memory chip (65536 bytes)", OTHER_IMAGE));
    }
    Sii::read(&image).map_err(|error| no_image(path, &error.to_string(), OTHER_IMAGE))?;
    if !is_forced && !categories(&image).any(|category| category.is_known()) {
        let message =
            "no category of the standard (strings, general, sync managers ..) is in it, so it is no whole image";
        let help = format!("{OTHER_IMAGE}; if the device shall have it all the same, add --force");
        return Err(no_image(path, message, &help));
    }
    Ok(Content::Image(image))
}

const ASK: &str = "ask the vendor for the SII image of this device, a binary file, or its device description (ESI); or keep the image of a \
                   device of its kind: `yieldwall sii read NODE --out FILE`";
/// Returns the kind of text, and the way from it to an image; `None` if it is no text.
fn text_kind(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    const FROM_HEX: &str =
        "`objcopy -I ihex -O binary FILE IMAGE` makes an image of it, which `yieldwall sii write` takes";
    // An image has zeros in its head; text in UTF-16 begins with a mark.
    let is_utf16 = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    let text: Vec<u8> =
        if is_utf16 { bytes.iter().copied().filter(|byte| *byte != 0).skip(2).collect() } else { bytes.to_vec() };
    let text = text.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(&text).trim_ascii_start();
    let is_of = |word: &[u8]| text.windows(word.len()).take(4096).any(|window| window == word);
    let is_obeyed = |byte: &u8| byte.is_ascii_control() && !matches!(byte, b'\t' | b'\n' | b'\r' | 0x0c);
    match text.first()? {
        b'<' if is_of(b"EtherCATInfo") => Some((
            "a device description (ESI) in UTF-16",
            "`iconv -f UTF-16 -t UTF-8 FILE > NEW` makes one that `yieldwall sii write` takes",
        )),
        b'<' if text.starts_with(b"<?xml") => Some(("XML", ASK)),
        _ if text.iter().any(is_obeyed) => None,
        b':' => Some(("text in Intel HEX", FROM_HEX)),
        _ => Some(("text", ASK)),
    }
}

/// Refuses an image for which the chip has no room.
pub(super) fn refuse_too_long(
    desk: &mut SegmentSession,
    device: &Device,
    image: &[u8],
    path: &Path,
) -> Result<(), Failure> {
    let failed = |desk: &SegmentSession, error| desk.failure(device, "reading its SII", error);
    let held = desk.service.sii_image(device.position).map_err(|error| failed(desk, error))?;
    let room = desk.service.chip_size(device.position, &held).map_err(|error| failed(desk, error))?;
    let room = 2 * room.unwrap_or_else(|| chip_words(image));
    if image.len() <= room {
        return Ok(());
    }
    let message = format!(
        "{}: the image has {} bytes, and the memory chip {room}; nothing was written",
        device.words(),
        image.len()
    );
    Err(Failure::about_file(Exit::DeviceMismatch, path, message, OTHER_IMAGE))
}

/// Refuses the image of another device than the present one, as far as the present one identifies itself, or than the rig's device.
fn refuse_another_kind(device: &Device, present: &Present, image: &Sii) -> Result<(), Failure> {
    let kind = |sii: &Sii| (sii.vendor_id, sii.product_code);
    let says = present.sii.as_ref().ok().map(kind).filter(|(vendor, _)| !matches!(vendor, 0 | &u32::MAX));
    let of_image = [image.vendor_id, image.product_code, image.revision, image.serial].map(Some);
    let fits = fit_of(device.of_rig(), of_image, None);
    let is_of_rig = device.of_rig().is_none_or(|(name, _)| fits == name);
    if says.is_none_or(|says| says == kind(image)) && is_of_rig {
        return Ok(());
    }
    let words = identity_words(of_image).unwrap_or_default();
    let message = format!("{}: the image is of another device ({words}); nothing was written", device.words());
    let help =
        "name the image of this device; `yieldwall scan` shows its identity. --force writes the image all the same";
    Err(Failure::new(Exit::DeviceMismatch, message, help))
}

/// Writes the words of an image that differ, after a person has agreed and the chip's contents are saved.
pub(super) fn overwrite(
    desk: &mut SegmentSession,
    device: &Device,
    image: &[u8],
    asking: Asking,
    output: &mut Output,
) -> Result<(), Failure> {
    let held = desk.service.sii_up_to(device.position, image.len() / 2);
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
        output.news("    takes effect after a power cycle of the device")
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
            // The image before may not be whole.
            let command =
                format!("yieldwall sii write {} {} --force{}", device.position, path.display(), desk.arguments);
            finding.help = Some(match Sii::read(&held) {
                Ok(_) => format!("do not switch it off; `{command}` puts back what it held"),
                Err(_) => "do not switch it off; write the image once more".to_owned(),
            });
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
        ["image".to_owned(), format!("{bytes} bytes, {}", warned(sii))],
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
    rows.extend(sii.warnings.iter().map(|warning| ["warning".to_owned(), warning.to_string()]));
    let mut text = table(&rows);
    for (direction, pdos) in [("outputs", &sii.rx_pdos), ("inputs", &sii.tx_pdos)] {
        pdos.iter().for_each(|pdo| text.push_str(&pdo_text(direction, pdo)));
    }
    text
}

/// Whether an image is whole, in words.
fn warned(sii: &Sii) -> String {
    match sii.warnings.len() {
        0 => "whole".to_owned(),
        1 => "1 warning".to_owned(),
        many => format!("{many} warnings"),
    }
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
        "warnings": sii.warnings.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}

/// A device and its SII, with the errors in it, and the damaged, missing or unusual parts.
pub(super) struct Checked {
    device: Device,
    wrong: Vec<String>,
    warnings: Vec<String>,
}

fn check(arguments: &Check, output: &mut Output) -> Result<(), Failure> {
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let checked = checked(&mut desk, arguments.node.as_deref())?;
    let end = match checked.iter().find(|one| !one.wrong.is_empty()) {
        None => Ok(()),
        Some(Checked { device, wrong, .. }) => {
            let message = format!("{}: {}", device.words(), wrong.join("; "));
            let help = format!("`yieldwall sii read {}{} --out FILE` keeps its image", device.position, desk.arguments);
            Err(Failure::new(Exit::OutOfTolerance, message, help))
        }
    };
    if output.is_json() {
        let devices: Vec<Value> = checked
            .iter()
            .map(|one| {
                json!({
                    "position": one.device.position,
                    "whole": one.wrong.is_empty() && one.warnings.is_empty(),
                    "wrong": one.wrong,
                    "warnings": one.warnings,
                })
            })
            .collect();
        return output.end(json!({ "place": desk.place, "devices": devices }), end);
    }
    output.result(&check_text(&checked))?;
    end
}

pub(super) fn checked(desk: &mut SegmentSession, word: Option<&str>) -> Result<Vec<Checked>, Failure> {
    let mut checked = Vec::new();
    for device in desk.devices_of(word)? {
        let (wrong, warnings) = match desk.service.present(device.position) {
            Ok(present) => (wrong(&device, &present), warnings(&present)),
            Err(SegmentError::Failed(failure)) => (vec![failure.to_string()], Vec::new()),
            Err(error) => return Err(desk.failure(&device, "reading its SII", error)),
        };
        checked.push(Checked { device, wrong, warnings });
    }
    Ok(checked)
}

/// Returns a fault of the SII of a device: it is empty, or names another device.
pub(super) fn wrong(device: &Device, present: &Present) -> Vec<String> {
    if let Err(failure) = &present.sii {
        return vec![failure.to_string()];
    }
    let entry = device.of_rig().filter(|(_, kind)| kind.is_some()).map(|(name, _)| name);
    let fits = fit_of(device.of_rig(), present.identity, None);
    entry.filter(|name| fits != *name).map(|_| fits.clone()).into_iter().collect()
}

/// Damaged, missing or unusual parts of its SII.
pub(super) fn warnings(present: &Present) -> Vec<String> {
    let sii = present.sii.as_ref().ok();
    sii.iter().flat_map(|sii| &sii.warnings).map(ToString::to_string).collect()
}

pub(super) fn check_text(checked: &[Checked]) -> String {
    let mut text = String::new();
    for Checked { device, wrong, warnings } in checked {
        let word = match (wrong.is_empty(), warnings.is_empty()) {
            (false, _) => "wrong",
            (true, false) => "warning",
            (true, true) => "whole",
        };
        text.push_str(&format!("{word:7} {}\n", device.words()));
        let all = wrong.iter().chain(warnings);
        all.for_each(|one| text.push_str(&wrapped_behind("        ", one)));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_fieldbus::ethercat::sii::category;

    fn kind(bytes: &[u8]) -> Option<&'static str> {
        text_kind(bytes).map(|(kind, _)| kind)
    }

    #[test]
    fn text_is_no_image_and_is_called_what_it_is() {
        let esi = "\u{feff}<?xml version=\"1.0\"?>\n<EtherCATInfo>ü</EtherCATInfo>";
        let utf16: Vec<u8> = esi.encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert!(
            description::is_one(esi.as_bytes()) && description::is_one(b"  <EtherCATInfo>\xfc"),
            "UTF-8 and Latin-1"
        );
        assert_eq!(kind(&utf16), Some("a device description (ESI) in UTF-16"));
        assert_eq!(kind(b"<?xml version='1.0'?><svg/>"), Some("XML"));
        assert_eq!(kind(b":10000000080C00000000000000000000000000EF\r\n"), Some("text in Intel HEX"));
        assert_eq!(kind(b"080c 0000 0000\n"), Some("text"));
        assert_eq!((kind(b""), kind(&Sii::default().write())), (None, None));
    }

    #[test]
    fn a_file_that_is_no_image_is_refused_before_a_device_is_asked() {
        let path = std::env::temp_dir().join(format!("yieldwall-image-{}", std::process::id()));
        let refused = |bytes: &[u8], is_forced| {
            std::fs::write(&path, bytes).unwrap();
            content_of(&path, is_forced).map_err(|failure| failure.report.diagnostics[0].message.clone()).err()
        };
        let whole = Sii { order: "servo".to_owned(), ..Sii::default() }.write();
        assert_eq!(refused(&whole, false), None);
        let xml = [&b"<?xml version='1.0'?><EtherCATInfo>"[..], &[b' '; 60_000]].concat();
        assert!(refused(&xml, true).unwrap().contains("it ends within an element"));
        let whole_xml = [&xml[..], b"</EtherCATInfo>"].concat();
        assert_eq!(refused(&whole_xml, false), None);
        assert!(refused(&[&whole[..], &[0; 70_000]].concat(), true).unwrap().contains("longer than the largest"));
        // The head, and categories of a vendor alone.
        let mut foreign = whole[..0x80].to_vec();
        foreign.extend([0x00, 0x08, 1, 0, 5, 5, 0xff, 0xff]);
        assert!(refused(&foreign, false).unwrap().contains("no category of the standard"));
        assert_eq!(refused(&foreign, true), None);
        foreign.truncate(foreign.len() - 2);
        foreign.extend(category::DC.to_le_bytes());
        foreign.extend([0; 2]);
        assert_eq!(refused(&foreign, false), None, "beside a category of the standard");
        std::fs::remove_file(&path).unwrap();
    }
}
