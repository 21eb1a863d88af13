//! Nodes on their buses: names, numbers and heartbeat periods.

use super::Findings;
use super::axes::are_axes;
use crate::suggest::nearest;
use crate::tree::{Bus, Rig};

/// Bit rates of CiA 301, bit/s.
const BIT_RATES: [u32; 8] = [10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];
/// Smallest heartbeat period in control periods: a heartbeat that is due in every cycle may come late in one.
pub const HEARTBEAT_CYCLES: u64 = 2;

/// Remedies if two drives have one node-ID.
const AXIS_OR_NODE: &str = "give each node of a bus its own node-ID from 1 to 127, here and in the device. Drives of one device of \
                            several axes need `axis: 0` and `axis: 1`";

/// Checks that the buses exist and are in use, and that every node of a bus has its own number.
pub(super) fn check_nodes(findings: &mut Findings, rig: &Rig) {
    let [left, right] = &rig.drives;
    let used = [&left.bus, &right.bus, &rig.sensor.bus];
    // An unknown name is reported below. It is then the cause of a bus without devices.
    let are_known = used.iter().all(|name| rig.buses.contains_key(*name));
    for name in rig.buses.keys().filter(|name| are_known && !used.contains(name)) {
        findings.error(
            &format!("buses.{name}"),
            format!("no device is on the bus `{name}`"),
            "remove the bus, or name it as the `bus` of a drive or of the sensor",
        );
    }
    for (name, bus) in &rig.buses {
        let Some(bus) = bus.canopen() else { continue };
        if !BIT_RATES.contains(&bus.bit_rate_bit_per_s) {
            let key = format!("buses.{name}.canopen.bit_rate_bit_per_s");
            let message = format!("`{key}` is {}, which is not a bit rate of CiA 301", bus.bit_rate_bit_per_s);
            findings.error(
                &key,
                message,
                format!("write one of {}", BIT_RATES.map(|rate| rate.to_string()).join(", ")),
            );
        }
    }
    let names: Vec<&str> = rig.buses.keys().map(String::as_str).collect();
    let mut taken: Vec<(&str, u8, String)> = Vec::new();
    let devices = [
        ("drives[0]", "drives[0].address.canopen.node_id", &rig.drives[0].bus, rig.drives[0].address.node_id()),
        ("drives[1]", "drives[1].address.canopen.node_id", &rig.drives[1].bus, rig.drives[1].address.node_id()),
        ("sensor", "sensor.protocol.canopen.node_id", &rig.sensor.bus, rig.sensor.protocol.node_id()),
    ];
    for (device, id_key, bus, node_id) in devices {
        let key = format!("{device}.bus");
        if !names.contains(&bus.as_str()) {
            let help = match nearest(bus, names.iter().copied()) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => format!("the buses of this rig are {}", names.join(", ")),
            };
            findings.error(&key, format!("`{key}` is `{bus}`, which is not among `buses`"), help).see("buses", "buses");
        }
        let Some(node_id) = node_id else { continue };
        let key = id_key.to_owned();
        let shares = device == "drives[1]" && are_axes(rig);
        let other = taken.iter().find(|(on, id, _)| !shares && on == bus && *id == node_id);
        let other = other.map(|(_, _, other)| other.clone());
        let is_own = rig.buses.get(bus).and_then(Bus::canopen).is_some_and(|own| own.node_id == node_id);
        let other = other.or_else(|| is_own.then(|| format!("buses.{bus}.canopen.node_id")));
        if let Some(other) = other {
            let help = match device == "drives[1]" && rig.has_one_device() {
                true => AXIS_OR_NODE,
                false => "give each node of a bus its own node-ID from 1 to 127, here and in the device",
            };
            let message = format!("`{key}` is {node_id}, and so is `{other}` on the same bus");
            findings.error(&key, message, help).see(&other, "the other");
        }
        taken.push((bus, node_id, key));
    }
    check_own_node(findings, rig);
    if rig.drives[0].name == rig.drives[1].name {
        let message = format!("`drives[1].name` is `{}`, and so is `drives[0].name`", rig.drives[1].name);
        findings
            .error("drives[1].name", message, "give each drive a name of its own")
            .see("drives[0].name", "the other");
    }
    for (index, drive) in rig.drives.iter().enumerate() {
        if !matches!(drive.direction, 1 | -1) {
            let key = format!("drives[{index}].direction");
            let message = format!("`{key}` is {}, and a direction is 1 or -1", drive.direction);
            findings.error(&key, message, "write 1 when counts grow with a positive angle, else -1");
        }
    }
}

/// Whether this program is the same node on all buses.
fn check_own_node(findings: &mut Findings, rig: &Rig) {
    let mut buses = rig.buses.iter().filter_map(|(name, bus)| Some((name, bus.canopen()?)));
    let Some((first, own)) = buses.next() else { return };
    for (name, bus) in buses {
        let numbers =
            [("node_id", bus.node_id.into(), own.node_id.into()), ("heartbeat_ms", bus.heartbeat_ms, own.heartbeat_ms)];
        for (key, here, there) in numbers.into_iter().filter(|(_, here, there): &(_, u16, u16)| here != there) {
            let (at, other) = (format!("buses.{name}.canopen.{key}"), format!("buses.{first}.canopen.{key}"));
            let message = format!("`{at}` is {here}, and `{other}` is {there}: this program is one node on all buses");
            findings.error(&at, message, "write the same number for all buses").see(&other, "the other");
        }
    }
}

/// Whether nodes send heartbeats slowly enough for the cycle to distinguish a late heartbeat from a lost one.
pub(super) fn check_heartbeats(findings: &mut Findings, rig: &Rig) {
    let period = rig.cycle.period_us;
    let sensor = rig.sensor.protocol.heartbeat_ms().map(|beat_ms| ("sensor.protocol.canopen.heartbeat_ms", beat_ms));
    let sensor = sensor.map(|(key, beat_ms)| (key.to_owned(), beat_ms));
    let own = rig
        .buses
        .iter()
        .filter_map(|(name, bus)| Some((format!("buses.{name}.canopen.heartbeat_ms"), bus.canopen()?.heartbeat_ms)));
    let drives = (0..).zip(&rig.drives).filter_map(|(index, drive): (usize, _)| {
        Some((format!("drives[{index}].address.canopen.heartbeat_ms"), drive.address.heartbeat_ms()?))
    });
    for (key, beat_ms) in own.chain(drives).chain(sensor) {
        if 1000 * u64::from(beat_ms) < HEARTBEAT_CYCLES * u64::from(period) {
            let message = format!("`{key}` is {beat_ms} ms, below {HEARTBEAT_CYCLES} control periods of {period} us");
            let least_ms = (HEARTBEAT_CYCLES * u64::from(period)).div_ceil(1000).max(20);
            let help =
                format!("raise it, such as to {least_ms}: heartbeats of every cycle fill the bus and say nothing more");
            findings.error(&key, message, help).see("cycle.period_us", "period_us");
        }
    }
}
