//! `yieldwall doctor --second-opinion`: the same devices read by this program and by ethercrab, and where both differ.

mod ethercrab;
mod kept;
mod own;
mod process;
mod reading;
#[cfg(test)]
mod tests;

use std::sync::atomic::Ordering;

use serde_json::{Value, json};

use self::ethercrab::Answer;
use self::process::NoAnswer;
use self::reading::{DeviceReading, Difference, Subject, differences};
use super::SegmentSession;
use crate::checkup::Section;
use crate::confirm::agreed;
use crate::failure::{Exit, Failure};
use crate::output::Output;
use yieldwall_bus::SEGMENT_LISTENING;
use yieldwall_link::checkup::Check;

pub(crate) use process::{Arguments, run};

/// A person's word that all devices may be taken through INIT.
#[derive(Debug)]
pub(crate) struct Consent(());

/// Asks for it, once for all interfaces; `is_given` answers.
pub(crate) fn consent(interfaces: &[&str], is_given: bool) -> Result<Consent, Failure> {
    let question = format!(
        "All devices on {} go through INIT to PRE-OP and get new station addresses by ethercrab, another EtherCAT master; \
         afterwards each gets back its state and address",
        interfaces.join(" and ")
    );
    if is_given || agreed(&question) {
        return Ok(Consent(()));
    }
    Err(Failure::new(
        Exit::Usage,
        "no device was asked or changed",
        "answer yes, give --yes, or leave out --second-opinion",
    ))
}

/// Returns the differences, a section for each device, and both readings as a document.
pub(in crate::desk) fn sections(
    desk: &mut SegmentSession,
    interface: &str,
    _: &Consent,
    output: &Output,
) -> Result<(Vec<Section>, Value), Failure> {
    kept::keep(desk)?;
    let mut own = own::read(desk)?;
    // A master that has come since.
    let heard = desk.service.listen(SEGMENT_LISTENING).map_err(|error| desk.segment_failure(error))?;
    if let Some(sign) = heard {
        return Err(desk.other_master(sign));
    }
    let kept = kept::keep(desk)?;
    output.aside(&format!("ethercrab brings the devices on {interface} to PRE-OP"));
    let answer = process::ask(interface, desk.service.is_over());
    // The devices are restored, also after Ctrl-C.
    desk.service.is_over().store(false, Ordering::Relaxed);
    // Delays that cannot be read are not compared.
    let _ = add_delays(desk, &mut own);
    let failed = kept::give_back(desk, &kept);
    if let Err(NoAnswer::Interrupted) = &answer {
        let devices = if failed.is_empty() { "; the devices have back what they held" } else { "" };
        let message = format!("interrupted during the second opinion{devices}");
        let mut failure = Failure::new(Exit::Interrupted, message, "");
        failure.report.diagnostics.extend(failed.into_iter().flat_map(|failed| failed.report.diagnostics));
        return Err(failure);
    }
    let document = json!({
        "interface": interface,
        "own": own,
        "ethercrab": answer.as_ref().ok(),
        "failure": answer.as_ref().err().map(ToString::to_string),
    });
    let about = format!("second opinion on {interface}");
    let mut sections = judged(&about, &own, &answer, |position| desk.at(position).words(), &desk.arguments);
    let not_given_back = not_given_back(failed, &desk.arguments);
    if !not_given_back.is_empty() {
        sections.push(Section::new(about, Exit::DeviceMismatch, not_given_back));
    }
    Ok((sections, document))
}

/// Skips the rest of ethercrab's frames, and adds the delays from the times that its frame latched.
fn add_delays(desk: &mut SegmentSession, own: &mut [DeviceReading]) -> Result<(), Failure> {
    while desk.service.listen(std::time::Duration::ZERO).map_err(|error| desk.segment_failure(error))?.is_some() {}
    own::add_delays(desk, own)
}

/// Returns the verdict on both readings.
fn judged(
    about: &str,
    own: &[DeviceReading],
    answer: &Result<Answer, NoAnswer>,
    words: impl Fn(u16) -> String,
    arguments: &str,
) -> Vec<Section> {
    let (other, without) = match answer {
        Ok(Answer::Read { devices, without_process_data }) => (devices, without_process_data.as_ref()),
        Ok(Answer::Failed(why)) => {
            return vec![unread(about, format!("it did not bring the devices to PRE-OP: {why}"), arguments)];
        }
        Err(why) => return vec![unread(about, why.to_string(), arguments)],
    };
    let (of_segment, of_devices): (Vec<_>, Vec<_>) =
        differences(own, other).into_iter().partition(|difference| difference.position.is_none());
    let mut all: Vec<Check> = of_segment.iter().map(|difference| check(difference, arguments)).collect();
    all.extend(without.map(|why| {
        Check::wrong("process data", format!("ethercrab cannot set them up: {why}"))
            .follows("this shows what the first device exchanges; compare each device with its data sheet")
            .fix(format!("yieldwall pdo show 0{arguments}"))
    }));
    let mut sections = Vec::new();
    if !all.is_empty() {
        sections.push(Section::new(about, Exit::DeviceMismatch, all));
    }
    for (position, (own, other)) in (0..).zip(own.iter().zip(other)) {
        let own_differences = of_devices.iter().filter(|difference| difference.position == Some(position));
        let mut checks: Vec<Check> = own_differences.map(|difference| check(difference, arguments)).collect();
        checks.extend(compared(own, other, checks.is_empty()));
        sections.push(Section::new(format!("{about}: {}", words(position)), Exit::DeviceMismatch, checks));
    }
    sections
}

/// Returns the section on why ethercrab has read nothing.
fn unread(about: &str, why: String, arguments: &str) -> Section {
    let check = Check::wrong("ethercrab", why)
        .follows(
            "nothing was compared. This program has read the same devices: its own sections say what is wrong with them. \
             ethercrab takes memory chips for whole: this lists damaged parts",
        )
        .fix(format!("yieldwall sii check{arguments}"));
    Section::new(about, Exit::DeviceMismatch, vec![check])
}

/// Returns the compared values, and those that only one of both has.
fn compared(own: &DeviceReading, other: &DeviceReading, is_equal: bool) -> Vec<Check> {
    let (mut both, mut one) = (Vec::new(), Vec::new());
    for ((subject, own), (_, other)) in own.values().into_iter().zip(other.values()) {
        match (own, other) {
            (Some(_), Some(_)) => both.push(subject.word()),
            (Some(_), None) => one.push(format!("{} (not by ethercrab)", subject.word())),
            (None, Some(_)) => one.push(format!("{} (not by this program)", subject.word())),
            (None, None) => {}
        }
    }
    let equal = is_equal.then(|| Check::ok("ethercrab", format!("reads the same: {}", both.join(", "))));
    let unread =
        (!one.is_empty()).then(|| Check::unknown("not compared", format!("read by one alone: {}", one.join(", "))));
    equal.into_iter().chain(unread).collect()
}

fn check(difference: &Difference, arguments: &str) -> Check {
    let Difference { position, subject, own, other } = difference;
    let found = format!("this program reads {own}, ethercrab {other}");
    let of_device = |command: &str| format!("yieldwall {command} {}{arguments}", position.unwrap_or_default());
    let (follows, fix) = match subject {
        Subject::Devices => (
            "a device or a link came or went between both readings: look at supply and cables, then ask again",
            format!("yieldwall scan{arguments}"),
        ),
        Subject::Vendor | Subject::Product | Subject::Revision | Subject::Serial => (
            "the memory chip gave two answers, or one master misreads it: ask again. A value that stays is in both readings: \
             compare it with the name plate",
            of_device("sii check"),
        ),
        Subject::Name | Subject::FullName => (
            "no motion depends on it, but the strings of the memory chip are read in two ways: this shows them",
            of_device("sii read"),
        ),
        Subject::MailboxTo | Subject::MailboxFrom | Subject::Protocols => (
            "the memory chip has the mailboxes twice, in its head and in its sync managers: compare both with the vendor's ESI file",
            of_device("sii read"),
        ),
        Subject::Outputs | Subject::Inputs => (
            "this program goes by the objects of the device (1C00h), ethercrab by the sync managers in the memory chip: compare both with \
             the vendor's ESI file",
            of_device("pdo show"),
        ),
        Subject::Ports => {
            ("a link came or went between both readings: look at the plugs, then ask again", of_device("errors"))
        }
        Subject::Parent => {
            ("one master takes the order of the cables for another: compare it with the cables", of_device("info"))
        }
        Subject::Delay => (
            "the clock of the device is set by it: ask again. A difference that stays puts SYNC0 off by so much",
            of_device("dc"),
        ),
    };
    Check::wrong(subject.word(), found).follows(follows).fix(fix)
}

/// Reports devices that were not restored.
fn not_given_back(failed: Vec<Failure>, arguments: &str) -> Vec<Check> {
    let findings = failed.into_iter().flat_map(|failed| failed.report.diagnostics);
    let check = |message: String| {
        Check::wrong("given back", message)
            .follows("switch the device off and on, or take all to INIT")
            .fix(format!("yieldwall state all init --take-over{arguments}"))
    };
    findings.map(|finding| check(finding.message)).collect()
}
