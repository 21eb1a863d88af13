//! `yieldwall info` on EtherCAT: one device, by its registers and its SII.

use std::convert::Infallible;

use serde_json::json;

use super::super::info::{asked, axes_row, objects};
use super::super::sii::warnings;
use super::super::words::table;
use super::SegmentSession;
use super::scan::{fit, name, warned};
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::ethercat::registers::{self as register, feature};
use yieldwall_fieldbus::ethercat::sii::{MailboxArea, protocols};
use yieldwall_fieldbus::ethercat::{AlStatusCode, array, u16_at};
use yieldwall_service::{ObjectAccess, count_axes};

/// Protocols of a mailbox by their bits in the SII.
const PROTOCOLS: [(u16, &str); 3] = [(protocols::COE, "CoE"), (protocols::EOE, "EoE"), (protocols::FOE, "FoE")];
/// Registers from the type of the controller to its features.
const CONTROLLER_LEN: usize = 10;

pub(in crate::desk) fn run(word: &str, mut desk: SegmentSession, output: &mut Output) -> Result<(), Failure> {
    let device = desk.device(word)?;
    let position = device.position;
    let mut axes = 0;
    // A device that is broken is shown without them.
    let (answers, unreached) = match desk.reach(&device, output) {
        Ok(()) => {
            let mut objects = desk.objects(&device)?;
            let answers = asked(device.axis).map(|at| objects.read(at)).collect();
            // A device that does not answer has no axes.
            axes = count_axes(|at| Ok::<_, Infallible>(objects.read(at).is_ok())).unwrap_or_default();
            (answers, None)
        }
        Err(failure) => (Vec::new(), failure.report.diagnostics.into_iter().next().map(|finding| finding.message)),
    };
    let failed = |desk: &SegmentSession, error| desk.failure(&device, "reading its identity", error);
    let present = desk.service.present(position).map_err(|error| failed(&desk, error))?;
    let mut read = |register, len| desk.service.read(position, register, len).map_err(|error| failed(&desk, error));
    let controller = read(register::TYPE, CONTROLLER_LEN)?;
    let links = u16_at(&read(register::DL_STATUS, 2)?, 0);
    let alias = u16_at(&read(register::STATION_ALIAS, 2)?, 0);
    let [kind, revision, _, _, fmmus, managers, ram_kb, ..] = array::<CONTROLLER_LEN>(&controller, 0);
    let features = u16_at(&controller, register::FEATURES.into());
    let has_clock = features & feature::DC != 0;
    let clock = match (has_clock, features & feature::DC_64 != 0) {
        (false, _) => "none",
        (true, false) => "distributed clock of 32 bits",
        (true, true) => "distributed clock of 64 bits",
    };
    let ports: Vec<usize> = (0..4).filter(|port| links & 1 << (4 + port) != 0).collect();
    let scaling = device.entry.as_ref().and_then(|entry| entry.scaling.as_ref());
    let (more, objects) = objects(answers, scaling, device.axis, |code| desk.explained(&device, code));
    if output.is_json() {
        let [vendor, product, revision_number, serial] = present.identity;
        return output.report(json!({
            "place": desk.place,
            "position": position,
            "rig_entry": device.entry.as_ref().map(|entry| entry.name.clone()),
            "fits": fit(&desk, &present),
            "name": name(&present),
            "vendor_id": vendor,
            "product_code": product,
            "revision": revision_number,
            "serial": serial,
            "alias": present.alias,
            "alias_in_force": alias,
            "state": present.status.to_string(),
            "al_status_code": present.code.0,
            "sii": present.sii.as_ref().err().map(ToString::to_string),
            "sii_warnings": warnings(&present),
            "controller": { "type": kind, "revision": revision, "fmmus": fmmus, "sync_managers": managers, "ram_kb": ram_kb },
            "has_clock": has_clock,
            "ports": ports,
            "axes": axes,
            "objects": objects,
            "unreached": unreached,
        }));
    }
    let mut rows = vec![["device".to_owned(), name(&present).unwrap_or_else(|| "no name".to_owned())]];
    for (part, value) in ["vendor", "product", "revision", "serial"].into_iter().zip(present.identity) {
        rows.extend(value.map(|value| [part.to_owned(), format!("{value:08X}h")]));
    }
    let mut row = |part: &str, says: String| rows.push([part.to_owned(), says]);
    row("rig", fit(&desk, &present));
    row("AL state", present.status.to_string());
    if present.code != AlStatusCode::NONE {
        row("  code", present.code.to_string());
    }
    let in_chip = present.alias.unwrap_or_default();
    let alias = match (in_chip == alias, alias) {
        (true, 0) => "none".to_owned(),
        (true, alias) => alias.to_string(),
        (false, alias) => format!("{in_chip} in its SII, {alias} in force until it is switched off and on"),
    };
    row("alias", alias);
    row("controller", format!("type {kind:02X}h revision {revision:02X}h"));
    row("", format!("{fmmus} FMMUs, {managers} sync managers, {ram_kb} kB"));
    row("clock", clock.to_owned());
    let each: Vec<String> = ports.iter().map(ToString::to_string).collect();
    row("links at ports", if each.is_empty() { "none".to_owned() } else { each.join(", ") });
    match &present.sii {
        Err(error) => row("SII", error.to_string()),
        Ok(sii) => {
            let spoken = PROTOCOLS.iter().filter(|(bit, _)| sii.protocols & bit != 0).map(|(_, name)| *name);
            let spoken: Vec<&str> = spoken.collect();
            let area = |area: MailboxArea| format!("{:04X}h, {} bytes", area.start, area.len);
            let mailbox = sii
                .mailbox_areas()
                .map(|[to, from]| format!("{}: to it {}, from it {}", spoken.join(", "), area(to), area(from)));
            row("mailbox", mailbox.unwrap_or_else(|| "none".to_owned()));
            warned(&desk, sii, position).into_iter().for_each(|warning| row("SII", warning));
        }
    }
    rows.extend(axes_row(axes));
    rows.extend(more);
    rows.extend(unreached.map(|why| ["objects".to_owned(), why]));
    output.result(&format!("{}\n{}", device.words(), table(&rows)))
}
