//! `yieldwall emcy` on EtherCAT: the errors that devices have stored, and the emergencies that wait in their mailboxes.

use std::time::Duration;

use serde_json::{Map, Value, json};

use super::super::emcy::{history, stored, text};
use super::{Device, SegmentSession};
use crate::explain;
use crate::failure::Failure;
use crate::output::Output;
use yieldwall_fieldbus::canopen::PastError;
use yieldwall_fieldbus::ethercat::coe::CoeEmergency;
use yieldwall_service::ObjectAccess;

/// Duration of listening to a device.
const LISTENING: Duration = Duration::from_millis(100);

/// Errors that a device reports.
pub(super) struct DeviceErrors {
    device: Device,
    stored: Option<Vec<PastError>>,
    sent: Vec<CoeEmergency>,
}

pub(in crate::desk) fn run(word: Option<&str>, mut desk: SegmentSession, output: &mut Output) -> Result<(), Failure> {
    let (mut told, mut end) = (Vec::new(), Ok(()));
    for device in desk.devices_of(word)? {
        match ask(&mut desk, device, output) {
            Ok(one) => told.push(one),
            // The others may have a mailbox.
            Err(failure) => end = end.and(Err(failure)),
        }
    }
    if output.is_json() {
        let devices: Vec<Value> = told.iter().map(|told| document(&desk, told)).collect();
        return output.end(json!({ "place": desk.place, "devices": devices }), end);
    }
    output.result(&told.iter().map(|told| lines(&desk, told)).collect::<String>())?;
    end
}

pub(super) fn ask(desk: &mut SegmentSession, device: Device, output: &Output) -> Result<DeviceErrors, Failure> {
    desk.reach(&device, output)?;
    let mut objects = desk.objects(&device)?;
    let errors = history(&mut |at| objects.read(at));
    let heard = objects.listen(LISTENING);
    let stored = errors.map_err(|error| desk.object_failure(&device, "reading its stored errors", error))?;
    heard.map_err(|error| desk.failure(&device, "listening to it", error))?;
    let sent = desk.service.take_emergencies().into_iter();
    let sent = sent.filter(|(position, _)| *position == device.position).map(|(_, emergency)| emergency).collect();
    Ok(DeviceErrors { device, stored, sent })
}

pub(super) fn lines(desk: &SegmentSession, told: &DeviceErrors) -> String {
    let DeviceErrors { device, stored, sent } = told;
    let mut lines = text(&device.words(), stored.as_deref(), |code| desk.explained(device, code));
    for emergency in sent {
        let explained = desk.explained(device, emergency.code);
        lines.push_str(&format!(
            "  sent {:04X}h {}, error register {:02X}h\n",
            emergency.code, explained.meaning, emergency.register
        ));
        lines.push_str(&explain::lines(8, &explained));
    }
    lines
}

fn document(desk: &SegmentSession, told: &DeviceErrors) -> Value {
    let DeviceErrors { device, stored: errors, sent } = told;
    let sent = sent.iter().map(|emergency| {
        let mut keys: Map<String, Value> = explain::document(&desk.explained(device, emergency.code));
        keys.insert("error_register".to_owned(), emergency.register.into());
        Value::Object(keys)
    });
    json!({
        "position": device.position,
        "rig_entry": device.entry.as_ref().map(|entry| entry.name.clone()),
        "errors": stored(errors.as_deref(), |code| desk.explained(device, code)),
        "sent": sent.collect::<Vec<_>>(),
    })
}
