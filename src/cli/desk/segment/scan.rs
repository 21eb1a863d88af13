//! `yieldwall scan` on EtherCAT: the devices in their order.

use serde_json::{Value, json};

use super::super::scan::{fit_of, identity_words};
use super::super::sii::warnings;
use super::super::words::{table, wrapped, wrapped_behind};
use super::SegmentSession;
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::ethercat::AlStatusCode;
use yieldwall_fieldbus::ethercat::sii::Sii;
use yieldwall_service::Present;

pub(in crate::desk) fn run(is_listening: bool, mut desk: SegmentSession, output: &mut Output) -> Result<(), Failure> {
    let mut found = Vec::new();
    if !is_listening {
        for position in 0..desk.devices()? {
            let device = desk.at(position);
            let present = desk.service.present(position);
            found.push(present.map_err(|error| desk.failure(&device, "reading its identity", error))?);
        }
    }
    if output.is_json() {
        let devices: Vec<Value> = found.iter().map(|present| document(&desk, present)).collect();
        let heard = desk.heard.map(|sign| sign.to_string());
        return output.report(json!({
            "place": desk.place, "simulated": desk.is_simulated, "devices": devices, "heard": heard,
        }));
    }
    output.result(&text(&desk, &found))
}

pub(super) fn text(desk: &SegmentSession, found: &[Present]) -> String {
    if let Some(sign) = desk.heard.filter(|_| found.is_empty()) {
        return wrapped(&format!("a master is on this segment: {sign}. Nothing was sent, and no device was asked"));
    }
    if found.is_empty() {
        return "no device is heard: devices on EtherCAT send nothing by themselves, and no master was heard\n"
            .to_owned();
    }
    let mut rows = vec![["position", "state", "name", "rig"].map(str::to_owned)];
    for present in found {
        let name = name(present).unwrap_or_else(|| "-".to_owned());
        rows.push([present.position.to_string(), present.status.to_string(), name, fit(desk, present)]);
    }
    let table = table(&rows);
    let mut lines = table.lines();
    let mut text = lines.next().map_or(String::new(), |line| format!("{line}\n"));
    for (line, present) in lines.zip(found) {
        text.push_str(line);
        text.push('\n');
        let alias = present.alias.filter(|alias| *alias != 0).map(|alias| format!(" alias {alias}"));
        if let Some(identity) = identity_words(present.identity) {
            text.push_str(&format!("          {identity}{}\n", alias.unwrap_or_default()));
        }
        let told = present
            .sii
            .as_ref()
            .map_or_else(|error| Some(error.to_string()), |sii| warned(desk, sii, present.position));
        told.iter().for_each(|told| text.push_str(&wrapped_behind("          ", told)));
        if present.code != AlStatusCode::NONE {
            text.push_str(&wrapped_behind("          ", &present.code.to_string()));
        }
    }
    text
}

/// Returns the first warning about its SII, and where the others are.
pub(super) fn warned(desk: &SegmentSession, sii: &Sii, position: u16) -> Option<String> {
    let (first, others) = sii.warnings.split_first()?;
    Some(match others.len() {
        0 => first.to_string(),
        count => format!("{first}; and {count} more: `yieldwall sii check {position}{}`", desk.arguments),
    })
}

/// Returns the name in its SII.
pub(in crate::desk) fn name(present: &Present) -> Option<String> {
    let sii = present.sii.as_ref().ok()?;
    [&sii.name, &sii.order].into_iter().find(|name| !name.is_empty()).cloned()
}

/// Returns the rig's entry at its position, and whether it is one; without an entry the profile that it fits.
pub(super) fn fit(desk: &SegmentSession, present: &Present) -> String {
    let (device, names) = (desk.at(present.position), desk.names(present.position));
    let entry = device.of_rig().map(|(name, kind)| (names.as_deref().unwrap_or(name), kind));
    fit_of(entry, present.identity, None)
}

fn document(desk: &SegmentSession, present: &Present) -> Value {
    let [vendor, product, revision, serial] = present.identity;
    json!({
        "position": present.position,
        "state": present.status.to_string(),
        "al_status_code": present.code.0,
        "name": name(present),
        "vendor_id": vendor,
        "product_code": product,
        "revision": revision,
        "serial": serial,
        "alias": present.alias,
        "sii": present.sii.as_ref().err().map(ToString::to_string),
        "sii_warnings": warnings(present),
        "rig_entry": desk.names(present.position),
        "fits": fit(desk, present),
    })
}
