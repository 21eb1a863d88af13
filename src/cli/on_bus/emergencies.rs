//! What devices have told of themselves by emergency messages (EMCY), in words.

use serde_json::{Value, json};

use crate::bus::Told;
use crate::canopen::Emergency;
use crate::cli::failure::Failure;
use crate::config::{self, SensorProtocol};
use crate::explanation::{self, Explanation};
use crate::guard::Device;

/// The emergencies without those that say the same again, in their order.
pub(in crate::cli) fn different(emergencies: impl Iterator<Item = Told>) -> Vec<Told> {
    let mut different: Vec<Told> = Vec::new();
    for told in emergencies {
        let says_the_same = |known: &Told| (known.device, known.emergency.code) == (told.device, told.emergency.code);
        if !different.iter().any(says_the_same) {
            different.push(told);
        }
    }
    different
}

/// One of them: the node with its name, and the code with meaning and cause, by the table of its vendor.
pub(in crate::cli) fn text(told: &Told, rig: &config::Rig) -> String {
    format!("node {} ({}): {}", told.emergency.node.raw(), name(told.device, rig), explained(told, rig))
}

/// What the code means, by the table of the device's vendor.
fn explained(told: &Told, rig: &config::Rig) -> Explanation {
    let profile = match (told.device, &rig.sensor.protocol) {
        (Device::LeftDrive, _) => Some(&rig.drives[0].profile),
        (Device::RightDrive, _) => Some(&rig.drives[1].profile),
        (Device::Sensor, SensorProtocol::Canopen { profile, .. }) => Some(profile),
        (Device::Sensor, _) => None,
    };
    let codes = profile.and_then(|profile| profile.error_codes());
    explanation::error_code(told.emergency.code.0, codes.map(|codes| &**codes))
}

/// The same as data.
pub(in crate::cli) fn document(told: &Told, rig: &config::Rig) -> Value {
    let Emergency { node, register, vendor, .. } = told.emergency;
    let explained = explained(told, rig);
    json!({
        "node_id": node.raw(),
        "name": name(told.device, rig),
        "code": explained.code,
        "code_name": explained.name,
        "meaning": explained.meaning,
        "cause": explained.cause,
        "next": explained.next,
        "error_register": register.0,
        "vendor_bytes": vendor,
    })
}

/// The failure with what the devices told and what to do about that, if they told anything.
pub(in crate::cli) fn with_emergencies(mut failure: Failure, emergencies: &[Told], rig: &config::Rig) -> Failure {
    let told: Vec<String> = emergencies.iter().map(|told| text(told, rig)).collect();
    if let (Some(first), false) = (failure.report.diagnostics.first_mut(), told.is_empty()) {
        first.message = format!("{}; emergencies: {}", first.message, told.join(", "));
        let mut advice: Vec<String> = Vec::new();
        for told in emergencies.iter().filter(|told| !told.emergency.code.is_reset()) {
            let Explanation { code, next, .. } = explained(told, rig);
            let one = format!("{}: {next}", code.unwrap_or_default());
            if !advice.contains(&one) {
                advice.push(one);
            }
        }
        let help = first.help.take().into_iter().chain(advice);
        first.help = Some(help.collect::<Vec<_>>().join("\n")).filter(|help| !help.is_empty());
    }
    failure
}

/// The name of a device in the rig's file.
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
    use crate::canopen::Frame;
    use crate::cli::failure::Exit;
    use crate::config::Source;
    use crate::time::Time;

    #[test]
    fn what_a_device_told_stands_in_the_message_once() {
        // Two buses: the left drive and the sensor are both node 1.
        let rig = config::load_rig(Source::named("builtin:paper-admittance-two-buses.yaml")).unwrap().value;
        let (left, sensor) = (Device::LeftDrive, Device::Sensor);
        let frames = [(left, 0x5043_u16), (left, 0x5043), (sensor, 0x4210), (sensor, 0x5043)];
        let heard = frames.into_iter().filter_map(|(device, code)| {
            let [low, high] = code.to_le_bytes();
            let emergency = Emergency::decode(&Frame::new(0x081, &[low, high, 0x21, 1, 2, 3, 4, 5]))?;
            Some(Told { time: Time::default(), device, emergency })
        });
        let told = different(heard);
        let failure = Failure::new(Exit::SafetyStop, "stopped by emergency", "see the code");
        let failure = with_emergencies(failure, &told, &rig);
        assert_eq!(
            failure.report.diagnostics[0].message,
            "stopped by emergency; emergencies: node 1 (left): 5043h device hardware (the maker of the device gives it \
             its own meaning), node 1 (wrist): 4210h device temperature too high (the device is overloaded, or its \
             cooling is poor), node 1 (wrist): 5043h device hardware (the maker of the device gives it its own meaning)"
        );
        let help = failure.report.diagnostics[0].help.as_deref().unwrap_or_default();
        assert_eq!(
            help.lines().map(|line| line.split(':').next().unwrap_or_default()).collect::<Vec<_>>(),
            ["see the code", "5043h", "4210h"]
        );
        let document = document(&told[0], &rig);
        assert_eq!((&document["code"], &document["name"]), (&"5043h".into(), &"left".into()));
        assert_eq!((&document["error_register"], &document["meaning"]), (&0x21.into(), &"device hardware".into()));
        let quiet = with_emergencies(Failure::new(Exit::SafetyStop, "stopped", ""), &[], &rig);
        assert_eq!(quiet.report.diagnostics[0].message, "stopped");
    }
}
