//! `yieldwall doctor` on EtherCAT: checks of the devices of a segment. The command brings a device in INIT to PRE-OP, reads its
//! objects there, and brings it back.

use super::super::errors;
use super::super::scan::fit_of;
use super::super::sii::{warnings, wrong};
use super::{Device, SegmentSession};
use crate::checkup::Section;
use crate::failure::{Exit, Failure};
use yieldwall_fieldbus::ethercat::sii::Sii;
use yieldwall_fieldbus::ethercat::{AlState, AlStatusCode};
use yieldwall_fieldbus::objects::Address;
use yieldwall_link::checkup::{Check, Verdict};
use yieldwall_service::{Counters, Present, number};

/// Objects that every device has: its type, and a drive's last error.
const DEVICE_TYPE: Address = Address::new(0x1000, 0);
const ERROR_CODE: Address = Address::new(0x603f, 0);

/// Returns a section for each device, and for each of the rig that is not there; of one alone if a word means it.
pub(in crate::desk) fn sections(desk: &mut SegmentSession, word: Option<&str>) -> Result<Vec<Section>, Failure> {
    let mut sections = Vec::new();
    let devices = desk.devices_of(word)?;
    let found = devices.len() as u16;
    let others = desk.devices()?;
    let led = desk.service.led(others).map_err(|error| desk.segment_failure(error))?;
    for device in devices {
        let checks = of_device(desk, &device, led.is_some())?;
        sections.push(Section::new(device.words(), Exit::DeviceMismatch, checks));
    }
    if word.is_none() {
        let missing = desk.entries.iter().filter(|entry| entry.position >= found);
        sections.extend(missing.map(|entry| {
            let check = Check::wrong("device", format!("{found} devices answer, and this one does not"))
                .follows("look at its power and at the cable behind the last one that answers");
            let about = format!("{} (position {})", entry.name, entry.position);
            Section::new(about, Exit::DeviceMismatch, vec![check])
        }));
    }
    Ok(sections)
}

fn of_device(desk: &mut SegmentSession, device: &Device, is_led: bool) -> Result<Vec<Check>, Failure> {
    let failed = |desk: &SegmentSession, error| desk.failure(device, "examining it", error);
    let present = desk.service.present(device.position).map_err(|error| failed(desk, error))?;
    let mut checks = vec![state(desk, &present)];
    let wrong = wrong(device, &present);
    checks.extend(sii(&wrong, &warnings(&present)));
    if device.of_rig().is_some() && wrong.is_empty() {
        checks.push(Check::ok("rig", fit_of(device.of_rig(), present.identity, None)));
    }
    let clock = desk.service.clock(device.position).map_err(|error| failed(desk, error))?;
    checks.push(match clock {
        Some(clock) if clock.is_64 => Check::ok("clock", "distributed clock of 64 bits"),
        _ => Check::warning("clock", "no distributed clock of 64 bits")
            .follows("its outputs act on arrival, not at SYNC0"),
    });
    let counters = desk.service.counters(device.position).map_err(|error| failed(desk, error))?;
    checks.extend(cable(&counters));
    let counted = errors::found(device, &counters);
    if counted.is_empty() {
        checks.push(Check::ok("ports", "no errors counted"));
    }
    let clear = format!("yieldwall errors {} --clear{}", device.position, desk.arguments);
    checks.extend(
        counted
            .into_iter()
            .map(|found| Check::warning("ports", found).follows("then have it count from 0 again").fix(clear.clone())),
    );
    checks.extend(objects(desk, device, &present, is_led)?);
    Ok(checks)
}

fn sii(wrong: &[String], warnings: &[String]) -> Vec<Check> {
    let whole = (wrong.is_empty() && warnings.is_empty()).then(|| Check::ok("SII", "whole"));
    let wrong = (!wrong.is_empty())
        .then(|| Check::wrong("SII", wrong.join("; ")).follows("`yieldwall sii write` writes an image of the vendor"));
    let warnings = warnings.iter().map(|warning| Check::warning("SII", warning.clone()));
    whole.into_iter().chain(wrong).chain(warnings).collect()
}

/// Whether the frames come in at port 0, where they have to.
fn cable(counters: &Counters) -> Option<Check> {
    let mut linked = (0..).zip(&counters.ports).filter(|(_, port)| port.is_linked).map(|(port, _)| port);
    let first: u8 = linked.next().filter(|first| *first != 0)?;
    let found = format!("port {first} has a link and port 0 has none: the frames come in at an output");
    Some(Check::wrong("cable", found).follows("plug the cable that comes from the master into the input (port 0, IN)"))
}

fn state(desk: &SegmentSession, present: &Present) -> Check {
    let status = present.status;
    let command = |target: &str| format!("yieldwall state {} {target}{}", present.position, desk.arguments);
    match present.code {
        _ if status.has_error() => {
            let code = present.code;
            Check::wrong("AL state", format!("{status}: {:04X}h {}", code.0, code.meaning()))
                .follows(format!("{}; fix that, then have the error acknowledged", code.likely_cause()))
                .fix(command("ack"))
        }
        code if status.shows_master(code) => Check::new("AL state", Verdict::Warning, status.to_string())
            .follows("a master has it, or had it and is gone: then this frees it")
            .fix(command("init --take-over")),
        AlStatusCode::NONE => Check::ok("AL state", status.to_string()),
        code => Check::ok("AL state", format!("{status}, last code {:04X}h {}", code.0, code.meaning())),
    }
}

/// Returns the reason if a device has no objects by its SII; `None` if it may have some.
fn without_objects(sii: &Sii) -> Option<&'static str> {
    match sii.has_coe() {
        true => None,
        false if sii.is_without_mailbox() => Some("none: by its SII it has no mailbox"),
        // A mailbox for which the SII names no protocol may have CoE.
        false => (sii.protocols != 0).then_some("none: by its SII its mailbox carries no CoE"),
    }
}

/// Whether it answers over its mailbox, and the error of a drive. A device in INIT is brought to PRE-OP for that, and back, unless a master
/// has other devices.
fn objects(desk: &mut SegmentSession, device: &Device, present: &Present, is_led: bool) -> Result<Vec<Check>, Failure> {
    if let Some(none) = present.sii.as_ref().ok().and_then(without_objects) {
        return Ok(vec![Check::ok("objects", none)]);
    }
    if present.status.state() != Some(AlState::Init) {
        return Ok(asked(desk, device));
    }
    let unknown = match (&present.sii, present.status.has_error(), is_led) {
        (Err(_), ..) => Some(("its SII does not say where its mailbox is, so they were not asked", "")),
        (_, true, _) => {
            Some(("in INIT with an error it has no mailbox, so they were not asked", "clear the error first"))
        }
        (_, _, true) => Some(("in INIT it has no mailbox, and a master has other devices", "end the other master")),
        _ => None,
    };
    if let Some((why, follows)) = unknown {
        return Ok(vec![Check::unknown("objects", why).follows(follows)]);
    }
    let brought = desk.service.change_state(device.position, AlState::PreOperational);
    let checks = match brought {
        Ok(_) => asked(desk, device),
        Err(error) => vec![
            Check::wrong("objects", error.to_string())
                .follows("it does not come to PRE-OP, where its objects are reached"),
        ],
    };
    let back = desk.service.change_state(device.position, AlState::Init);
    back.map_err(|error| desk.failure(device, "taking it back to INIT", error))?;
    Ok(checks)
}

/// Returns the state of its objects.
fn asked(desk: &mut SegmentSession, device: &Device) -> Vec<Check> {
    let mut read = |at| match desk.objects(device) {
        Ok(mut objects) => yieldwall_service::ObjectAccess::read(&mut objects, at).map_err(|error| error.to_string()),
        Err(failure) => Err(failure.report.diagnostics.into_iter().next().map_or_else(String::new, |one| one.message)),
    };
    let (kind, error) = (read(DEVICE_TYPE), read(ERROR_CODE));
    let mut checks = vec![match kind {
        Ok(_) => Check::ok("objects", "it answers over its mailbox"),
        Err(why) => Check::wrong("objects", why).follows("without objects nothing can be set up: switch it off and on"),
    }];
    if let Ok(bytes) = error
        && number(&bytes) != 0
    {
        let explained = desk.explained(device, number(&bytes) as u16);
        checks.push(Check::wrong("error code", explained.to_string()).follows(explained.next));
    }
    checks
}
