//! Messages of devices about themselves, in words: from emergency messages (EMCY), and from reads after a fault (603Fh, 6041h).

use serde_json::{Value, json};

use crate::desk::{placed_text, state_words};
use crate::ending;
use crate::failure::Failure;
use yieldwall_bus::{BootError, BootFailure, EmergencyReport};
use yieldwall_config as config;
use yieldwall_drives::cia402::{State, Statusword};
use yieldwall_fieldbus::canopen::{EmcyCode, Emergency};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::guard::{Cause, Device, DeviceSet, Fault};
use yieldwall_run::explanation::{self, Explanation};
use yieldwall_run::{DriveError, RunError};

/// Returns the emergencies in their order, without repetitions. A repeated emergency counts as withdrawn if its last message is.
pub(crate) fn different(emergencies: impl Iterator<Item = EmergencyReport>) -> Vec<EmergencyReport> {
    let mut different: Vec<EmergencyReport> = Vec::new();
    for told in emergencies {
        let says_the_same = |known: &EmergencyReport| (known.device, known.code) == (told.device, told.code);
        match different.iter().position(says_the_same).and_then(|at| different.get_mut(at)) {
            Some(known) => known.is_withdrawn = told.is_withdrawn,
            None => different.push(told),
        }
    }
    different
}

/// Describes an emergency: the device with its address, and the code with meaning and cause, by the table of its vendor.
pub(crate) fn text(told: &EmergencyReport, rig: &config::Rig) -> String {
    let (name, address) = (names(told.device, rig), address(told.device, rig));
    let device = match address {
        (Some(node_id), _) => format!("node {node_id} ({name})"),
        (None, Some(position)) => format!("{name} (position {position})"),
        (None, None) => name,
    };
    format!("{device}: {}{}", of_told(told, rig), if told.is_withdrawn { "; withdrawn since" } else { "" })
}

/// Explains the code of an emergency by the table of the device's vendor.
fn of_told(told: &EmergencyReport, rig: &config::Rig) -> Explanation {
    explained(told.code, Some(told.device), rig)
}

/// Explains a code of a device by the table of its vendor.
fn explained(code: EmcyCode, device: Option<Device>, rig: &config::Rig) -> Explanation {
    let profile = match device {
        None => None,
        Some(Device::LeftDrive) => Some(&rig.drives[0].profile),
        Some(Device::RightDrive) => Some(&rig.drives[1].profile),
        Some(Device::Sensor) => rig.sensor.protocol.profile(),
    };
    let codes = profile.and_then(|profile| profile.error_codes());
    explanation::error_code(code.0, codes.map(|codes| &**codes))
}

/// Returns the emergency as data.
pub(crate) fn document(told: &EmergencyReport, rig: &config::Rig) -> Value {
    let (node_id, position) = address(told.device, rig);
    let explained = of_told(told, rig);
    json!({
        "node_id": node_id,
        "position": position,
        "name": names(told.device, rig),
        "code": explained.code,
        "code_name": explained.name,
        "meaning": explained.meaning,
        "cause": explained.cause,
        "next": explained.next,
        "error_register": told.register.0,
        "vendor_bytes": told.vendor,
        "withdrawn": told.is_withdrawn,
    })
}

/// Returns the meaning of a device's code, with its cause and the next step.
pub(crate) fn words_of_code(
    code: EmcyCode,
    device: Option<Device>,
    rig: &config::Rig,
) -> (String, Vec<(&'static str, String)>) {
    let Explanation { meaning, cause, next, .. } = explained(code, device, rig);
    (meaning.into_owned(), words(cause.into_owned(), next.into_owned()))
}

/// Returns the cause of a rig's fault and the next step.
pub(crate) fn words_of_fault(fault: Fault) -> Vec<(&'static str, String)> {
    let Explanation { cause, next, .. } = explanation::fault(fault);
    words(cause.into_owned(), next.into_owned())
}

fn words(cause: String, next: String) -> Vec<(&'static str, String)> {
    vec![("cause", cause), ("next", next)]
}

/// Returns the text of a drive's report on a fault.
pub(crate) fn drive_error_text(error: &DriveError, rig: &config::Rig) -> String {
    let name = name(error.drive, rig);
    let code = match error.code {
        None => "does not report its error code (603Fh)".to_owned(),
        Some(0) => "no error code".to_owned(),
        Some(code) => {
            let (meaning, _) = words_of_code(EmcyCode(code), Some(error.drive), rig);
            format!("error code {code:04X}h {meaning}")
        }
    };
    let status = error.statusword.map_or_else(String::new, |word| format!(", {} ({word:04X}h)", state_words(word)));
    format!("{name}: {code}{status}")
}

/// Returns a drive's report on a fault as data.
pub(crate) fn drive_error_json(error: &DriveError, rig: &config::Rig) -> Value {
    let code = error.code.map(EmcyCode);
    let words = code.filter(|code| !code.is_reset()).map(|code| words_of_code(code, Some(error.drive), rig));
    let mut document = json!({
        "name": name(error.drive, rig),
        "code": code.map(|code| format!("{:04X}h", code.0)),
        "meaning": words.as_ref().map(|(meaning, _)| meaning),
        "error_register": error.register,
        "statusword": error.statusword.map(|word| format!("{word:04X}h")),
        "state": error.statusword.map(state_words),
    });
    for (key, text) in words.into_iter().flat_map(|(_, words)| words) {
        document[key] = text.into();
    }
    document
}

/// Returns the emergencies that may explain why a rig with this cause stopped: those that were not withdrawn, and those that have
/// stopped it.
pub(crate) fn standing(emergencies: &[EmergencyReport], cause: Option<Cause>) -> Vec<EmergencyReport> {
    let stopped_by =
        cause.filter(|cause| cause.fault == Fault::Emergency).map_or(DeviceSet::NONE, |cause| cause.devices);
    let counts = |told: &EmergencyReport| !told.is_withdrawn || stopped_by.contains(told.device.set());
    emergencies.iter().copied().filter(counts).collect()
}

/// Returns the emergencies that may explain why a rig did not run.
pub(crate) fn told_before(error: &RunError, known: &[EmergencyReport], rig: &config::Rig) -> Vec<EmergencyReport> {
    match error {
        RunError::Boot(error) => told_at_boot(error, known, rig),
        RunError::NotEnabled { cause, .. } | RunError::NotTried { cause, .. } => standing(known, *cause),
        _ => standing(known, None),
    }
}

/// Returns the known reports that are not withdrawn, and the last report of a node while the network did not come up.
pub(crate) fn told_at_boot(error: &BootError, known: &[EmergencyReport], rig: &config::Rig) -> Vec<EmergencyReport> {
    let known = standing(known, None);
    let (BootFailure::NotStarted { said, .. } | BootFailure::Missing { said, .. }) = &error.failure else {
        return known;
    };
    let device = [Device::LeftDrive, Device::RightDrive, Device::Sensor];
    let device = device.into_iter().find(|device| ending::is_title(&error.name, name(*device, rig)));
    let told = said.emergency.zip(device).map(|(emergency, device)| {
        let Emergency { code, register, vendor, .. } = emergency;
        EmergencyReport { time: Time::default(), device, code, register, vendor, is_withdrawn: false }
    });
    different(known.into_iter().chain(told))
}

/// Adds the findings on the devices of a segment to the failure.
pub(crate) fn with_findings(mut failure: Failure, findings: &[String]) -> Failure {
    if let Some(first) = failure.report.diagnostics.first_mut().filter(|_| !findings.is_empty()) {
        first.message = format!("{}; {}", first.message, findings.join("; "));
    }
    failure
}

/// Adds the devices' messages and the advice on them to the failure, if there are any.
pub(crate) fn with_told(
    mut failure: Failure,
    emergencies: &[EmergencyReport],
    errors: &[DriveError],
    rig: &config::Rig,
) -> Failure {
    let told: Vec<String> = emergencies.iter().map(|told| text(told, rig)).collect();
    let code = |error: &DriveError| error.code.filter(|code| *code != 0);
    let is_told = |error: &DriveError| {
        emergencies.iter().any(|told| told.device == error.drive && code(error).is_none_or(|code| code == told.code.0))
    };
    let errors: Vec<&DriveError> =
        errors.iter().filter(|error| (code(error).is_some() || is_in_fault(error)) && !is_told(error)).collect();
    let of_drives: Vec<String> = errors.iter().map(|error| drive_error_text(error, rig)).collect();
    let Some(first) = failure.report.diagnostics.first_mut() else { return failure };
    for (what, told) in [("emergencies", told), ("drives", of_drives)] {
        if !told.is_empty() {
            first.message = format!("{}; {what}: {}", first.message, told.join(", "));
        }
    }
    let of_emergencies = emergencies.iter().filter(|told| !told.code.is_reset());
    let of_emergencies = of_emergencies.map(|told| of_told(told, rig));
    let of_drives = errors.iter().filter_map(|error| Some(explained(EmcyCode(code(error)?), Some(error.drive), rig)));
    let mut advice: Vec<String> = Vec::new();
    for Explanation { code, next, .. } in of_emergencies.chain(of_drives) {
        let one = format!("{}: {next}", code.unwrap_or_default());
        if !advice.contains(&one) {
            advice.push(one);
        }
    }
    if !advice.is_empty() {
        let help = first.help.take().into_iter().chain(advice);
        first.help = Some(help.collect::<Vec<_>>().join("\n")).filter(|help| !help.is_empty());
    }
    failure
}

/// Whether a drive is in Fault, by its last report.
fn is_in_fault(error: &DriveError) -> bool {
    error.statusword.is_some_and(|word| Statusword(word).state() == Some(State::Fault))
}

/// Adds the command that resets each drive in Fault to the failure; `arguments` are those with which a command reaches a device.
pub(crate) fn with_resets(
    mut failure: Failure,
    errors: &[DriveError],
    rig: &config::Rig,
    arguments: impl Fn(Device) -> String,
) -> Failure {
    let Some(first) = failure.report.diagnostics.first_mut() else { return failure };
    for error in errors.iter().filter(|error| is_in_fault(error)) {
        let (node_id, position) = address(error.drive, rig);
        let Some(number) = node_id.map(u16::from).or(position) else { continue };
        let stored = match error.code {
            None | Some(0) => "`yieldwall emcy NODE` shows the errors that it has stored; ",
            Some(_) => "",
        };
        let advice =
            format!("{stored}once the cause has gone, `yieldwall state NODE --reset-fault` takes it out of Fault");
        let advice = placed_text(&advice, number, &arguments(error.drive), None);
        let help = first.help.take().map_or(String::new(), |help| format!("{help}\n"));
        first.help = Some(format!("{help}{}: {advice}", name(error.drive, rig)));
    }
    failure
}

/// Returns the node id of a device, or its position on a segment.
fn address(device: Device, rig: &config::Rig) -> (Option<u8>, Option<u16>) {
    let [left, right] = &rig.drives;
    let drive = match device {
        Device::LeftDrive => left,
        Device::RightDrive => right,
        Device::Sensor => return (rig.sensor.protocol.node_id(), rig.sensor.protocol.position()),
    };
    (drive.address.node_id(), drive.address.position())
}

/// Returns the rig's names for all axes of a device: an emergency names no axis.
fn names(device: Device, rig: &config::Rig) -> String {
    let [left, right] = &rig.drives;
    match device != Device::Sensor && rig.has_one_device() {
        true => format!("{} and {}", left.name, right.name),
        false => name(device, rig).to_owned(),
    }
}

/// Returns the name of a device in the rig's file.
fn name(device: Device, rig: &config::Rig) -> &str {
    let [left, right] = &rig.drives;
    match device {
        Device::LeftDrive => &left.name,
        Device::RightDrive => &right.name,
        Device::Sensor => &rig.sensor.name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ending::rig_failure;
    use crate::failure::Exit;
    use yieldwall_bus::Said;
    use yieldwall_config::Source;
    use yieldwall_fieldbus::canopen::{ErrorRegister, Frame};

    /// The table of its vendor explains a drive's error at the boot.
    #[test]
    fn an_emergency_of_the_boot_is_told_in_the_words_of_the_vendor() {
        let mut rig = config::load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        rig.drives[0].profile = "maxon-epos4".to_owned().into();
        let emergency = Emergency::decode(&Frame::new(0x081, &[0x80, 0x73, 0x21, 0, 0, 0, 0, 0]));
        let failure = BootFailure::NotStarted { waited_ms: 500, said: Said { state: None, emergency } };
        let error = BootError { node_id: Some(1), name: "left".to_owned(), step: "start the node", failure };
        let told = told_at_boot(&error, &[], &rig);
        assert_eq!(told_at_boot(&error, &told, &rig), told, "once");
        let failure = with_told(rig_failure(&error.into()), &told, &[], &rig);
        let finding = &failure.report.diagnostics[0];
        assert!(finding.message.contains("signals of the position sensor"), "{}", finding.message);
        let help = finding.help.as_deref().unwrap();
        assert!(help.contains("7380h: look at plug, cable and shield of the encoder"), "{help}");
    }

    #[test]
    fn what_a_device_told_stands_in_the_message_once() {
        // Two buses: the left drive and the sensor are both node 1.
        let rig = config::load_rig(Source::named("builtin:paper-admittance-two-buses.yaml")).unwrap().value;
        let (left, sensor) = (Device::LeftDrive, Device::Sensor);
        let frames = [(left, 0x5043_u16), (left, 0x5043), (sensor, 0x4210), (sensor, 0x5043)];
        let heard = frames.into_iter().map(|(device, code)| {
            let (code, register) = (EmcyCode(code), ErrorRegister(0x21));
            let vendor = [1, 2, 3, 4, 5];
            EmergencyReport { time: Time::default(), device, code, register, vendor, is_withdrawn: false }
        });
        let told = different(heard);
        let failure = Failure::new(Exit::SafetyStop, "stopped by emergency", "see the code");
        // An error that an emergency has reported is not repeated.
        let error = |drive, code| DriveError { drive, code, register: Some(1), statusword: Some(0x1208) };
        let errors = [error(Device::LeftDrive, Some(0x5043)), error(Device::RightDrive, Some(0x8611))];
        let failure = with_told(failure, &told, &errors, &rig);
        assert_eq!(
            failure.report.diagnostics[0].message,
            "stopped by emergency; emergencies: node 1 (left): 5043h device hardware (the maker of the device gives it \
             its own meaning), node 1 (wrist): 4210h device temperature too high (the device is overloaded, or its \
             cooling is poor), node 1 (wrist): 5043h device hardware (the maker of the device gives it its own meaning); \
             drives: right: error code 8611h following error above its window, Fault (1208h)"
        );
        let help = failure.report.diagnostics[0].help.as_deref().unwrap_or_default();
        assert_eq!(
            help.lines().map(|line| line.split(':').next().unwrap_or_default()).collect::<Vec<_>>(),
            ["see the code", "5043h", "4210h", "8611h"]
        );
        let document = document(&told[0], &rig);
        assert_eq!((&document["code"], &document["name"]), (&"5043h".into(), &"left".into()));
        assert_eq!((&document["error_register"], &document["meaning"]), (&0x21.into(), &"device hardware".into()));
        let quiet = DriveError { statusword: Some(0x1240), ..error(Device::LeftDrive, Some(0)) };
        let quiet = with_told(Failure::new(Exit::SafetyStop, "stopped", ""), &[], &[quiet], &rig);
        assert_eq!(quiet.report.diagnostics[0].message, "stopped");
    }

    #[test]
    fn emergencies_that_were_withdrawn_are_left_out_but_for_those_that_stopped_the_rig() {
        let rig = config::load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let told = |device, code, is_withdrawn| {
            let (code, register) = (EmcyCode(code), ErrorRegister(5));
            EmergencyReport { time: Time::default(), device, code, register, vendor: [0; 5], is_withdrawn }
        };
        let (left, right) = (Device::LeftDrive, Device::RightDrive);
        let all = [told(left, 0x3220, true), told(right, 0x3220, true), told(right, 0x4210, false)];
        let codes = |told: &[EmergencyReport]| told.iter().map(|told| (told.device, told.code.0)).collect::<Vec<_>>();
        let cause = |fault| Some(Cause { fault, devices: DeviceSet::LEFT_DRIVE });
        for cause in [None, cause(Fault::DriveFault)] {
            assert_eq!(codes(&standing(&all, cause)), [(right, 0x4210)]);
        }
        let stopped = standing(&all, cause(Fault::Emergency));
        assert_eq!(codes(&stopped), [(left, 0x3220), (right, 0x4210)]);
        assert!(text(&stopped[0], &rig).ends_with("; withdrawn since"), "{}", text(&stopped[0], &rig));
        assert_eq!(document(&stopped[0], &rig)["withdrawn"], true);
        // The boot fails by something else.
        let failure = BootFailure::NoAnswer { index: 0x6060, sub: 0 };
        let error = BootError { node_id: Some(1), name: "left".to_owned(), step: "set the mode", failure };
        assert_eq!(codes(&told_before(&error.into(), &all, &rig)), [(right, 0x4210)]);
        // An error that has come again is there.
        let again = different([told(left, 0x3220, true), told(left, 0x3220, false)].into_iter());
        assert_eq!(codes(&standing(&again, None)), [(left, 0x3220)]);
    }

    #[test]
    fn drives_in_fault_are_named_with_code_and_the_command_that_resets_them() {
        let on_can = config::load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let on_segment = config::load_rig(Source::named("builtin:paper-ethercat.yaml")).unwrap().value;
        let error = |drive, code, word| DriveError { drive, code, register: None, statusword: Some(word) };
        let errors = [error(Device::LeftDrive, Some(0x7121), 0x1208), error(Device::RightDrive, Some(0), 0x1218)];
        for (rig, numbers) in [(&on_can, ["1", "2"]), (&on_segment, ["0", "1"])] {
            let failure = Failure::new(Exit::DeviceFault, "not enabled", "see the code");
            let failure = with_told(failure, &[], &errors, rig);
            let failure = with_resets(failure, &errors, rig, |_| " --bus x0 --rig my.yaml".to_owned());
            let finding = &failure.report.diagnostics[0];
            for named in ["left: error code 7121h ", "right: no error code, Fault (1218h)"] {
                assert!(finding.message.contains(named), "{}", finding.message);
            }
            let help = finding.help.as_deref().unwrap();
            let [left, right] = numbers;
            let lines: Vec<&str> = help.lines().collect();
            let reset = |number| {
                format!("`yieldwall state {number} --reset-fault --bus x0 --rig my.yaml` takes it out of Fault")
            };
            assert!(lines[1].starts_with("7121h: "), "{help}");
            assert_eq!(lines[2], format!("left: once the cause has gone, {}", reset(left)));
            let stored = format!("`yieldwall emcy {right} --bus x0 --rig my.yaml` shows the errors that it has stored");
            assert_eq!(lines[3..], [format!("right: {stored}; once the cause has gone, {}", reset(right))]);
        }
        let well = [error(Device::LeftDrive, Some(0x7121), 0x1240)];
        let failure = with_resets(Failure::new(Exit::SafetyStop, "stopped", ""), &well, &on_can, |_| String::new());
        assert_eq!(failure.report.diagnostics[0].help, None);
    }
}
