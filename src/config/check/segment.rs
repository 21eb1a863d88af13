//! Devices on an EtherCAT segment and their positions.

use yieldwall_drives::profiles::ForceSensor;

use super::Findings;
use super::axes::are_axes;
use crate::tree::{Bus, Rig, SensorProtocol};
use yieldwall_drives::profiles::Fieldbus;

/// Greatest number of counts of a sensor on plain CAN.
const MOST_ON_PLAIN_CAN: u32 = i16::MAX as u32;
/// Least force or torque of a count of a simulated sensor on EtherCAT, in N or N m.
const LEAST_PER_COUNT: f64 = 1e-9;

/// Remedies if two drives have one position.
const AXIS_OR_PLACE: &str = "give each device its own place, counted from 0 at the computer; drives of one device of several axes write `axis: 0` \
                             and `axis: 1` beside it";

/// A device in the document: its key, the key of its address, its bus, and its place in a segment.
struct Device<'a> {
    key: &'static str,
    address: &'static str,
    bus: &'a str,
    position: Option<u16>,
}

/// Checks that each device has an address of its bus, and that the devices of a segment stand in a line without a gap.
pub(super) fn check_segment(findings: &mut Findings, rig: &Rig) {
    let ([left, right], sensor) = (&rig.drives, &rig.sensor);
    let device = |key, address, bus, position| Device { key, address, bus, position };
    let devices = [
        device("drives[0]", "drives[0].address", &left.bus, left.address.position()),
        device("drives[1]", "drives[1].address", &right.bus, right.address.position()),
        device("sensor", "sensor.protocol", &sensor.bus, sensor.protocol.position()),
    ];
    devices.iter().for_each(|device| check_kind(findings, rig, device));
    if rig.is_on_ethercat() {
        check_places(findings, rig, &devices);
    }
    check_counts(findings, rig);
    check_profiles(findings, rig);
}

/// Checks that a sensor on its bus can have such counts, and the simulated sensor on EtherCAT such a calibration.
fn check_counts(findings: &mut Findings, rig: &Rig) {
    let (key, counts) = ("sensor.range_counts", rig.sensor.range_counts);
    let model = rig.sensor.protocol.profile().and_then(|profile| profile.get()?.force_sensor());
    let most = model.map_or(MOST_ON_PLAIN_CAN, ForceSensor::most_counts);
    if counts > most {
        let bits = u32::BITS - most.leading_zeros() + 1;
        let message = format!("`{key}` is {counts}, and the sensor sends counts of {bits} bits");
        findings.error(key, message, format!("write a whole number from 1 to {most}"));
    }
    if !matches!(rig.sensor.protocol, SensorProtocol::Ethercat { .. }) {
        return;
    }
    let matrix = &rig.sensor.calibration;
    let [newton, newton_metre] = [*matrix[0][0], *matrix[3][3]];
    let is_like = |(row, column): (usize, usize), value: f64| match row {
        _ if row != column => value == 0.0,
        0..3 => value == newton,
        _ => value == newton_metre,
    };
    let is_plain = (0..6).all(|row| (0..6).all(|column| is_like((row, column), *matrix[row][column])));
    let has_counts = [newton, newton_metre].iter().all(|unit| (LEAST_PER_COUNT..=1.0).contains(unit));
    if rig.simulation.is_some() && !(is_plain && has_counts) {
        let message = "the simulated sensor on EtherCAT has one number of counts per N and one per N m, as it says itself, and \
                       `sensor.calibration` is no such matrix";
        let help = "write N per count three times and N m per count three times along the diagonal, from 1e-9 to 1, and 0 elsewhere. \
                    A rig without `simulation` may have any matrix";
        findings.error("sensor.calibration", message, help);
    }
}

/// Whether the profiles of the devices are written for the buses that the devices are on.
fn check_profiles(findings: &mut Findings, rig: &Rig) {
    let drives = rig.drives.iter().enumerate().map(|(index, drive)| {
        (format!("drives[{index}].profile"), drive.profile.get(), drive.address.position().is_some())
    });
    let sensor = rig.sensor.protocol.profile().map(|name| {
        let is_on_segment = rig.sensor.protocol.position().is_some();
        let protocol = if is_on_segment { "ethercat" } else { "canopen" };
        (format!("sensor.protocol.{protocol}.profile"), name.get(), is_on_segment)
    });
    for (key, profile, is_on_segment) in drives.chain(sensor) {
        let Some(profile) = profile else { continue };
        let bus = if is_on_segment { Fieldbus::Ethercat } else { Fieldbus::Canopen };
        if profile.is_for(bus) {
            continue;
        }
        let message = format!("`{key}` is `{}`, which is not written for {}", profile.name(), bus.name());
        if is_on_segment {
            let help =
                "compare its process data with those of the device on EtherCAT, and add `ethercat` to its `buses`";
            findings.warning(&key, message, help);
        } else {
            let help = "name the profile of this device on CANopen; its process data differ from those on EtherCAT";
            findings.error(&key, message, help);
        }
    }
}

/// Checks that the address of a device fits its bus.
fn check_kind(findings: &mut Findings, rig: &Rig, device: &Device<'_>) {
    let Device { key, address, bus, position } = device;
    // A bus that is not there is told elsewhere.
    let (is_segment, has) = match rig.buses.get(*bus) {
        Some(Bus::Ethercat(_)) => (true, "an EtherCAT segment"),
        Some(Bus::Canopen(_)) => (false, "a CAN bus"),
        None => return,
    };
    if is_segment == position.is_some() {
        return;
    }
    let wants = match (is_segment, *key) {
        (true, _) => "`ethercat: {position: 0}`, counted from 0 at the computer,",
        (false, "sensor") => "`canopen`, `streaming` or `polled`",
        (false, _) => "`canopen: {node_id: 1, heartbeat_ms: 20}`",
    };
    let is_for = if is_segment { "a CAN bus" } else { "an EtherCAT segment" };
    let message = format!("`{address}` is for {is_for}, and `{bus}` is {has}");
    let help = format!("write {wants} below it, or name another bus at `{key}.bus`");
    findings.error(address, message, help).see(&format!("buses.{bus}"), "the bus");
}

/// Checks that both drives are on one segment, and the sensor there or on CAN, and that each device on it has its own place.
fn check_places(findings: &mut Findings, rig: &Rig, devices: &[Device<'_>; 3]) {
    let is_segment = |bus: &str| matches!(rig.buses.get(bus), Some(Bus::Ethercat(_)));
    let [first, second, sensor] = devices;
    let leader = if is_segment(first.bus) { first } else { second };
    for other in [first, second, sensor].into_iter().filter(|other| rig.buses.contains_key(other.bus)) {
        let may_be_on_can = other.key == sensor.key && is_segment(leader.bus);
        if other.bus == leader.bus || may_be_on_can && !is_segment(other.bus) {
            continue;
        }
        let key = format!("{}.bus", other.key);
        let (message, help) = if is_segment(leader.bus) {
            let rule = "a rig on EtherCAT has its drives on one segment, and its sensor there or on CAN";
            (format!("`{key}` is `{}`: {rule}", other.bus), format!("write `{}`", leader.bus))
        } else {
            let message =
                format!("`{key}` is `{}`: a sensor on EtherCAT stands behind drives on its segment", other.bus);
            (message, format!("write the name of a CAN bus, such as `{}`, and a protocol of CAN", leader.bus))
        };
        findings.error(&key, message, help).see(&format!("{}.bus", leader.key), "the other");
    }
    let is_here = |device: &&Device<'_>| device.position.is_some() || is_segment(device.bus);
    let here: Vec<&Device<'_>> = devices.iter().filter(is_here).collect();
    let shares = are_axes(rig);
    let places = here.len() - usize::from(shares);
    for (number, device) in here.iter().enumerate() {
        let Some(position) = device.position else { continue };
        let key = format!("{}.ethercat.position", device.address);
        let is_axis = shares && device.key == second.key;
        let taken = here.iter().take(number).find(|other| !is_axis && other.position == Some(position));
        if let Some(other) = taken {
            let message = format!("`{key}` is {position}, and so is that of `{}`", other.key);
            let help = match device.key == second.key && rig.has_one_device() {
                true => AXIS_OR_PLACE,
                false => "give each device its own place, counted from 0 at the computer",
            };
            findings.error(&key, message, help).see(&format!("{}.ethercat.position", other.address), "the other");
        } else if usize::from(position) >= places {
            let message = format!(
                "`{key}` is {position}, and the segment has the {places} devices of this rig: a place before it is left empty"
            );
            let places = match places {
                1 => "0",
                2 => "0 or 1",
                _ => "0, 1 or 2",
            };
            findings.error(&key, message, format!("write {places}, counted from 0 at the computer"));
        }
    }
}

/// The key of the first EtherCAT segment of a rig; `None` if it has none.
pub(crate) fn segment_key(rig: &Rig) -> Option<String> {
    let name = rig.buses.iter().find(|(_, bus)| matches!(bus, Bus::Ethercat(_))).map(|(name, _)| name)?;
    Some(format!("buses.{name}.ethercat"))
}

#[cfg(test)]
mod tests {
    use crate::{Document, Source, builtin, load, load_rig};

    /// Key, message and help of what is found in the shipped rig on EtherCAT with some of its text replaced.
    fn found(from: &str, to: &str) -> Vec<(String, String, String)> {
        let shipped = builtin("paper-ethercat.yaml").read().unwrap();
        assert!(shipped.contains(from), "{from}");
        let text = shipped.replace(from, to).replace("like: ", "like: builtin:");
        let report = load_rig(Source::memory("rig.yaml", text)).unwrap_err();
        let each = report.diagnostics.into_iter();
        each.map(|it| {
            assert!(it.place.is_some(), "{it:?}");
            (it.key, it.message, it.help.unwrap_or_default())
        })
        .collect()
    }

    fn one(from: &str, to: &str, key: &str, message: &str, help: &str) {
        let found = found(from, to);
        assert!(
            matches!(&found[..], [(at, says, next)] if at == key && says.contains(message) && next.contains(help)),
            "{to}: {found:?}"
        );
    }

    #[test]
    fn devices_of_a_segment_stand_in_a_line() {
        let right = "{name: right, address: {ethercat: {position: 1}}}";
        let at = |position: u32| format!("{{name: right, address: {{ethercat: {{position: {position}}}}}}}");
        let key = "drives[1].address.ethercat.position";
        one(right, &at(0), key, "is 0, and so is that of `drives[0]`", "its own place");
        one(right, &at(3), key, "is 3, and the segment has the 3 devices", "0, 1 or 2");
        let key = "sensor.protocol.ethercat.position";
        one("ethercat: {position: 2}", "ethercat: {position: 1}", key, "so is that of `drives[1]`", "its own place");
    }

    #[test]
    fn an_address_is_one_on_its_bus() {
        let canopen = "{name: right, address: {canopen: {node_id: 2, heartbeat_ms: 20}}}";
        let right = "{name: right, address: {ethercat: {position: 1}}}";
        let message = "`drives[1].address` is for a CAN bus, and `main` is an EtherCAT segment";
        one(right, canopen, "drives[1].address", message, "ethercat: {position: 0}");
        let sensor = "canopen: {node_id: 10, profile: simulated-force-sensor, heartbeat_ms: 20}";
        let of_sensor = found("ethercat: {position: 2}", sensor);
        assert!(
            of_sensor.iter().any(|(key, message, _)| key == "sensor.protocol" && message.contains("is for a CAN bus"))
        );
        // All devices on EtherCAT, and the bus on CAN.
        let bus = "canopen: {bit_rate_bit_per_s: 1000000, node_id: 127, heartbeat_ms: 20}";
        let found = found("    ethercat: {}", &format!("    {bus}"));
        let keys: Vec<&str> = found.iter().map(|(key, ..)| key.as_str()).collect();
        assert_eq!(keys, ["drives[0].address", "drives[1].address", "sensor.protocol"], "{found:?}");
    }

    #[test]
    fn the_simulated_sensor_has_one_factor_for_forces_and_one_for_torques() {
        let (key, second) = ("sensor.calibration", "    - [0.0, 1.0e-6, 0.0, 0.0, 0.0, 0.0]\n");
        let message = "one number of counts per N";
        one(second, "    - [0.0, 2.0e-6, 0.0, 0.0, 0.0, 0.0]\n", key, message, "along the diagonal");
        one(second, "    - [1.0e-7, 1.0e-6, 0.0, 0.0, 0.0, 0.0]\n", key, message, "along the diagonal");
    }

    #[test]
    fn all_devices_are_on_one_segment() {
        let found = found(
            "sensor:\n  protocol:\n    ethercat: {position: 2}\n  sample_rate_hz: 8000",
            "sensor:\n  bus: other\n  protocol:\n    ethercat: {position: 2}\n  sample_rate_hz: 8000",
        );
        assert!(found.iter().any(|(key, ..)| key == "sensor.bus"), "{found:?}");
    }

    #[test]
    fn the_shipped_rigs_on_ethercat_are_read_and_what_is_for_can_refuses_them() {
        for name in ["paper-ethercat.yaml", "paper-ethercat-can-sensor.yaml"] {
            assert!(matches!(load(builtin(name)), Ok(Document::Rig(_))));
            let rig = load_rig(builtin(name)).unwrap();
            assert!(rig.warnings.is_empty());
            let report = rig.on_can().unwrap_err();
            let [refused] = report.diagnostics.as_slice() else { panic!("{report}") };
            assert_eq!(refused.key, "buses.main.ethercat");
            assert!(refused.help.as_ref().unwrap().contains(&format!("run builtin:{name}")), "{refused:?}");
        }
    }

    #[test]
    fn drives_are_on_one_segment_and_the_sensor_there_or_on_can() {
        let shipped = builtin("paper-ethercat-can-sensor.yaml").read().unwrap().replace("like: ", "like: builtin:");
        let keys = |from: &str, to: &str| -> Vec<String> {
            assert!(shipped.contains(from), "{from}");
            let report = load_rig(Source::memory("rig.yaml", shipped.replace(from, to))).unwrap_err();
            report.diagnostics.into_iter().map(|it| it.key).collect()
        };
        let right = "{name: right, address: {ethercat: {position: 1}}}";
        let on_can = "{name: right, bus: sensor, address: {canopen: {node_id: 2, heartbeat_ms: 20}}}";
        assert_eq!(keys(right, on_can), ["drives[1].bus"]);
        let far = "{name: right, address: {ethercat: {position: 2}}}";
        assert_eq!(keys(right, far), ["drives[1].address.ethercat.position"]);
    }

    #[test]
    fn counts_beyond_16_bits_are_those_of_a_sensor_on_ethercat() {
        let text = "like: builtin:paper-admittance.yaml\nsensor: {range_counts: 40000}\n";
        let report = load_rig(Source::memory("rig.yaml", text)).unwrap_err();
        assert_eq!(report.diagnostics[0].key, "sensor.range_counts");
        assert!(report.diagnostics[0].message.contains("16 bits"), "{report}");
    }
}
