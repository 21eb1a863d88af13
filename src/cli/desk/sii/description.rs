//! An image of the device description (ESI) of a vendor.

use super::super::segment::Device;
use super::{ASK, no_image};
use crate::failure::Failure;
use crate::output::Output;
use crate::printable::one_line;
use std::path::Path;
use yieldwall_drives::esi::{self, Esi};
use yieldwall_fieldbus::ethercat::sii::Sii;
use yieldwall_service::{Present, described_image};

/// Types of a device description that a message lists.
const MOST_LISTED: usize = 12;

/// Whether a file is a device description.
pub(super) fn is_one(bytes: &[u8]) -> bool {
    let text = bytes.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(bytes).trim_ascii_start();
    let word = b"<EtherCATInfo";
    text.first() == Some(&b'<') && text.windows(word.len()).take(4096).any(|window| window == word)
}

/// Returns the image that a description makes for the present device. Alias and serial number are those of the chip, if it is
/// legible.
pub(in crate::desk) fn image(
    esi: &Esi,
    device: &Device,
    present: &Present,
    (file, named): (&Path, Option<&str>),
    output: &mut Output,
) -> Result<Vec<u8>, Failure> {
    let held = present.sii.as_ref().ok().filter(|held| held.vendor_id == esi.vendor_id);
    let described = described(esi, device, held, (file, named))?;
    let serial = held.filter(|held| held.product_code == described.product_code).map_or(0, |held| held.serial);
    let made = described_image(esi, described, held.map_or(0, |held| held.alias), serial);
    let made = made.map_err(|error| no_image(file, &error.to_string(), ASK))?;
    if !output.is_json() {
        let (kind, revision) = (one_line(&described.type_name), described.revision);
        output.news(&format!("made        of the description of {kind}, revision {revision:08X}h"))?;
        for left_out in made.left_out {
            output.news(&format!("left out    {left_out}"))?;
        }
    }
    Ok(made.image)
}

/// Returns the selected device of a description: the named one, or else the one that the chip reports, or else the only one. Among
/// several revisions, the function takes the chip's revision, or else the newest.
fn described<'a>(
    esi: &'a Esi,
    device: &Device,
    held: Option<&Sii>,
    (file, named): (&Path, Option<&str>),
) -> Result<&'a esi::Device, Failure> {
    let is_meant = |described: &&esi::Device| match (named, held) {
        (Some(word), _) => {
            let code = word.strip_prefix("0x").and_then(|digits| u32::from_str_radix(digits, 16).ok());
            described.type_name.eq_ignore_ascii_case(word) || code == Some(described.product_code)
        }
        (None, Some(held)) => described.product_code == held.product_code,
        (None, None) => true,
    };
    let meant: Vec<&esi::Device> = esi.devices.iter().filter(is_meant).collect();
    let revision = held.map(|held| held.revision);
    let newest = meant.iter().max_by_key(|described| (Some(described.revision) == revision, described.revision));
    let mut products: Vec<u32> = meant.iter().map(|described| described.product_code).collect();
    products.sort_unstable();
    products.dedup();
    if let (Some(newest), [_]) = (newest, products.as_slice()) {
        return Ok(newest);
    }
    let listed = if meant.is_empty() { esi.devices.iter().collect() } else { meant };
    let mut kinds: Vec<String> = listed.iter().map(|described| one_line(&described.type_name).into_owned()).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let more = kinds.len().saturating_sub(MOST_LISTED);
    kinds.truncate(MOST_LISTED);
    let more = if more == 0 { String::new() } else { format!(" and {more} more") };
    let message = match (named, held) {
        (Some(word), _) => format!("the file describes no single device {word}"),
        (None, Some(_)) => format!("the file does not describe the device at {}", device.position),
        (None, None) => format!("the chip at {} does not report a device of this vendor", device.position),
    };
    let help =
        format!("add --device TYPE, by the type plate of the device; the file describes {}{more}", kinds.join(", "));
    Err(no_image(file, &message, &help))
}
