//! `yieldwall alias`: the number that identifies a device on EtherCAT at any position.

use serde_json::json;

use super::place::BusArguments;
use super::segment::{Device, SegmentSession};
use super::sii::{Asking, overwrite};
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_fieldbus::ethercat::sii::{Sii, SiiWarning, set_alias};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// EtherCAT position, or device name from the rig
    node: String,
    /// Set this alias, 1 to 65535, or 0 for none, after confirmation; without a value, print the alias
    value: Option<u16>,
    #[command(flatten)]
    asking: Asking,
    #[command(flatten)]
    place: BusArguments,
}

pub(crate) fn run(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let mut desk = SegmentSession::only(&arguments.place, output)?;
    let device = desk.device(&arguments.node)?;
    let Some(alias) = arguments.value else {
        let present = desk.service.present(device.position);
        let present = present.map_err(|error| desk.failure(&device, "reading its alias", error))?;
        if output.is_json() {
            return output.report(json!({ "place": desk.place, "position": device.position, "alias": present.alias }));
        }
        let says = match present.alias {
            None => "its SII says none, since it cannot be read".to_owned(),
            Some(0) => "no alias".to_owned(),
            Some(alias) => format!("alias {alias}"),
        };
        return output.result(&format!("{}: {says}\n", device.words()));
    };
    let image = with_alias(&mut desk, &device, alias)?;
    overwrite(&mut desk, &device, &image, arguments.asking, output)
}

/// Returns the image of a device with another alias, which no other device may have.
pub(super) fn with_alias(desk: &mut SegmentSession, device: &Device, alias: u16) -> Result<Vec<u8>, Failure> {
    let failed = |desk: &SegmentSession, error| desk.failure(device, "reading its SII", error);
    let mut image = desk.service.sii_image(device.position).map_err(|error| failed(desk, error))?;
    let damage = match Sii::read(&image) {
        Err(error) => Some(error.to_string()),
        Ok(sii) => sii.warnings.iter().find(|one| matches!(one, SiiWarning::Checksum { .. })).map(ToString::to_string),
    };
    if let Some(damage) = damage {
        let message = format!("{}: its SII is damaged: {damage}; nothing was written", device.words());
        let help = "a new checksum would hide the damage: `yieldwall sii write` writes the image of the vendor anew";
        return Err(Failure::new(Exit::DeviceMismatch, message, help));
    }
    for other in 0..if alias == 0 { 0 } else { desk.devices()? } {
        let present = desk.service.present(other).map_err(|error| failed(desk, error))?;
        if other != device.position && present.alias == Some(alias) {
            let message = format!("{} has the alias {alias} already; nothing was written", desk.at(other).words());
            return Err(Failure::new(Exit::Usage, message, "write an alias that no other device has"));
        }
    }
    set_alias(&mut image, alias);
    Ok(image)
}
