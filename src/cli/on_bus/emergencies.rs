//! What devices have told of themselves by emergency messages (EMCY), in words.

use serde_json::{Value, json};

use crate::canopen::Emergency;
use crate::cli::failure::Failure;
use crate::config;

/// The emergencies without those that say the same again, in their order.
pub(in crate::cli) fn different(emergencies: impl Iterator<Item = Emergency>) -> Vec<Emergency> {
    let mut different: Vec<Emergency> = Vec::new();
    for emergency in emergencies {
        if !different.iter().any(|known| (known.node, known.code) == (emergency.node, emergency.code)) {
            different.push(emergency);
        }
    }
    different
}

/// One of them: the node with its name, and the code with its meaning.
pub(in crate::cli) fn text(emergency: &Emergency, rig: &config::Rig) -> String {
    let name = match name(emergency.node.raw(), rig) {
        Some(name) => format!(" ({name})"),
        None => String::new(),
    };
    format!("node {}{name}: {}", emergency.node.raw(), emergency.code)
}

/// The same as data.
pub(in crate::cli) fn document(emergency: &Emergency, rig: &config::Rig) -> Value {
    let Emergency { node, code, register, vendor } = emergency;
    json!({
        "node_id": node.raw(),
        "name": name(node.raw(), rig),
        "code": format!("{:04X}h", code.0),
        "meaning": code.meaning(),
        "error_register": register.0,
        "vendor_bytes": vendor,
    })
}

/// The failure with what the devices told, if they told anything.
pub(in crate::cli) fn with_emergencies(mut failure: Failure, emergencies: &[Emergency], rig: &config::Rig) -> Failure {
    let told: Vec<String> = emergencies.iter().map(|emergency| text(emergency, rig)).collect();
    if let (Some(first), false) = (failure.report.diagnostics.first_mut(), told.is_empty()) {
        first.message = format!("{}; emergencies: {}", first.message, told.join(", "));
    }
    failure
}

/// The name of a node, if only one device has this id: on several buses two may have it.
fn name(node_id: u8, rig: &config::Rig) -> Option<&str> {
    let [left, right] = &rig.drives;
    let sensor_id = match &rig.sensor.protocol {
        config::SensorProtocol::Canopen { node_id, .. } => Some(*node_id),
        _ => None,
    };
    let nodes = [
        (Some(left.address.canopen.node_id), &left.name),
        (Some(right.address.canopen.node_id), &right.name),
        (sensor_id, &rig.sensor.name),
    ];
    let mut own = nodes.into_iter().filter(|(id, _)| *id == Some(node_id));
    match (own.next(), own.next()) {
        (Some((_, name)), None) => Some(name),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canopen::Frame;
    use crate::cli::failure::Exit;
    use crate::config::Source;

    #[test]
    fn what_a_device_told_stands_in_the_message_once() {
        let rig = config::load_rig(Source::named("builtin:paper-admittance.yaml")).unwrap().value;
        let frames = [(0x081, 0x5043_u16), (0x081, 0x5043), (0x08a, 0x4210), (0x083, 0x8130)];
        let heard = frames.into_iter().filter_map(|(id, code)| {
            let [low, high] = code.to_le_bytes();
            Emergency::decode(&Frame::new(id, &[low, high, 0x21, 1, 2, 3, 4, 5]))
        });
        let told = different(heard);
        let failure = Failure::new(Exit::SafetyStop, "stopped by emergency", "see the code");
        let failure = with_emergencies(failure, &told, &rig);
        assert_eq!(
            failure.report.diagnostics[0].message,
            "stopped by emergency; emergencies: node 1 (left): 5043h device hardware, node 10 (wrist): 4210h device \
             temperature too high, node 3: 8130h heartbeat or life guarding lost"
        );
        let document = document(&told[0], &rig);
        assert_eq!((&document["code"], &document["name"]), (&"5043h".into(), &"left".into()));
        assert_eq!((&document["error_register"], &document["meaning"]), (&0x21.into(), &"device hardware".into()));
        let quiet = with_emergencies(Failure::new(Exit::SafetyStop, "stopped", ""), &[], &rig);
        assert_eq!(quiet.report.diagnostics[0].message, "stopped");
    }
}
