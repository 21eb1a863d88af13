//! A force sensor on plain CAN: its identifiers among those of CANopen, and its times.

use super::Findings;
use super::words::round;
use crate::tree::{Bus, Rig, SensorProtocol};

/// SYNC of CANopen.
const SYNC: u16 = 0x080;
/// Highest sample rate of a sensor on plain CAN, Hz.
const MOST_HZ: f64 = 10_000.0;
/// Smallest number of bits of a frame with eight bytes, interframe space included.
const BITS_OF_EIGHT_BYTES: u64 = 111;
/// Distance from the base to the identifiers of the answers of a polled sensor.
const ANSWERS: [u16; 2] = [5, 6];

/// Checks that a sensor on plain CAN is compatible with the nodes of its bus, and that its samples can be assembled.
pub(super) fn check_plain_can(findings: &mut Findings, rig: &Rig, cycle_hz: f64) {
    check_rate(findings, rig, cycle_hz);
    let (group, ids, gap_us) = match rig.sensor.protocol {
        SensorProtocol::Canopen { .. } | SensorProtocol::Ethercat { .. } => return,
        SensorProtocol::Streaming { command_id, data_ids: [first, second], pair_gap_us, .. } => {
            let group = "sensor.protocol.streaming";
            let command = format!("{group}.command_id");
            if first >= second {
                let key = format!("{group}.data_ids");
                let message = format!("`{key}` has {first:03X}h before {second:03X}h: the second frame would go first");
                findings.error(
                    &key,
                    message,
                    "give the first frame of a sample the lower identifier, here and in the sensor",
                );
            }
            if [first, second].contains(&command_id) {
                let message = format!("`{command}` is {command_id:03X}h, and so is one of `data_ids`");
                findings
                    .error(&command, message, "give orders and samples identifiers of their own")
                    .see(&format!("{group}.data_ids"), "data_ids");
            }
            let data = format!("{group}.data_ids");
            (group, vec![(command, command_id), (data.clone(), first), (data, second)], pair_gap_us)
        }
        SensorProtocol::Polled { base_id, pair_gap_us, .. } => {
            let group = "sensor.protocol.polled";
            let key = format!("{group}.base_id");
            let answers = ANSWERS.map(|offset| (key.clone(), base_id.saturating_add(offset)));
            (group, [vec![(key, base_id)], answers.to_vec()].concat(), pair_gap_us)
        }
    };
    check_identifiers(findings, rig, &ids);
    check_gap(findings, rig, &format!("{group}.pair_gap_us"), gap_us);
}

/// Checks that a sensor can be set to the rate.
pub(super) fn check_rate(findings: &mut Findings, rig: &Rig, cycle_hz: f64) {
    let (key, rate) = ("sensor.sample_rate_hz", *rig.sensor.sample_rate_hz);
    if rate.fract() != 0.0 || !(1.0..=MOST_HZ).contains(&rate) {
        let message = format!("`{key}` is {rate}, which is not a whole number from 1 to {MOST_HZ}");
        findings.error(key, message, "write the rate that the sensor is set to, in Hz");
    } else if rate > cycle_hz * 1.001 && matches!(rig.sensor.protocol, SensorProtocol::Streaming { .. }) {
        let message = format!("`{key}` is {rate} Hz, and the cycle has {} Hz", round(cycle_hz));
        findings
            .warning(
                key,
                message,
                "set the sensor to the rate of the cycle: of several samples the newest counts, and all load the bus",
            )
            .see("cycle.period_us", "period_us");
    }
}

/// Checks that no other node uses the identifiers, and that the frames have a lower priority than SYNC.
fn check_identifiers(findings: &mut Findings, rig: &Rig, ids: &[(String, u16)]) {
    for (key, id) in ids {
        if let Some(user) = user_of(*id, rig) {
            let message = format!("`{key}` takes {id:03X}h, which is {user}");
            let help = "choose identifiers that no node of the bus uses, such as 0x35f, 0x360 and 0x361, here and in the sensor";
            findings.error(key, message, help);
        }
    }
    if rig.drives.iter().all(|drive| drive.bus != rig.sensor.bus) {
        return;
    }
    let above: Vec<String> = ids.iter().filter(|(_, id)| *id < SYNC).map(|(_, id)| format!("{id:03X}h")).collect();
    if let Some((key, _)) = ids.iter().find(|(_, id)| *id < SYNC) {
        let go = if above.len() == 1 { "goes" } else { "go" };
        let message =
            format!("{} {go} before SYNC (080h) on the bus that the sensor shares with the drives", listed(&above));
        let help = "give the sensor identifiers above those of the drives, such as 0x35f, 0x360 and 0x361, here and in the sensor: SYNC \
                    and the drives' data then wait for one of its frames at most";
        findings.warning(key, message, help);
    }
}

/// `a`, `a and b`, `a, b and c`.
fn listed(words: &[String]) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// Returns the CANopen use of an identifier on this bus.
fn user_of(id: u16, rig: &Rig) -> Option<String> {
    let drives = rig.drives.iter().filter(|drive| drive.bus == rig.sensor.bus);
    let drives = drives.filter_map(|drive| Some((drive.name.as_str(), drive.address.node_id()?)));
    let nodes: Vec<(&str, u8)> =
        rig.own_node().map(|own| ("the master", own.node_id)).into_iter().chain(drives).collect();
    let of_node = |what: &str| {
        let node = nodes.iter().find(|(_, node)| u16::from(*node) == id & 0x7f)?;
        Some(format!("{what} of {} (node {})", node.0, node.1))
    };
    match id {
        0x000 => Some("NMT".to_owned()),
        SYNC => Some("SYNC".to_owned()),
        0x100 => Some("TIME".to_owned()),
        0x7e4 | 0x7e5 => Some("LSS".to_owned()),
        0x081..=0x0ff => of_node("the emergency message"),
        0x181..=0x57f => of_node("a PDO"),
        0x581..=0x67f => of_node("an SDO"),
        0x701..=0x77f => of_node("the heartbeat"),
        _ => None,
    }
}

/// Checks that the two frames of a sample cannot be confused with the frames of the next.
fn check_gap(findings: &mut Findings, rig: &Rig, key: &str, gap_us: u32) {
    let period_us = 1e6 / *rig.sensor.sample_rate_hz;
    if f64::from(gap_us) >= period_us {
        let message = format!(
            "`{key}` is {gap_us} us, and a sample comes every {} us: frames of two samples could be paired",
            round(period_us)
        );
        findings
            .error(key, message, "lower it: the second frame follows as soon as the bus lets it")
            .see("sensor.sample_rate_hz", "sample_rate_hz");
    }
    let Some(bus) = rig.buses.get(&rig.sensor.bus).and_then(Bus::canopen) else { return };
    if u64::from(gap_us) * u64::from(bus.bit_rate_bit_per_s) < BITS_OF_EIGHT_BYTES * 1_000_000 {
        let message = format!("`{key}` is {gap_us} us, less than a frame of eight bytes takes");
        let rate = format!("buses.{}.canopen.bit_rate_bit_per_s", rig.sensor.bus);
        findings.error(key, message, "raise it, for example to 500 us at 1 Mbit/s").see(&rate, "bit_rate_bit_per_s");
    }
}

#[cfg(test)]
mod tests {
    use crate::malformed;
    use crate::{Severity, load_rig};

    const STREAMING: &str = "    streaming:\n      command_id: 0x35f\n      data_ids: [0x360, 0x361]\n      pair_gap_us: 500\n      \
                             zero_at_start: false\n";
    const POLLED: &str = "    polled:\n      base_id: 0x1b0\n      byte_order: little_endian\n      overload_bits: 0x0002\n      \
                          invalid_bits: 0x8000\n      pair_gap_us: 300\n      zero_at_start: true\n";

    /// Severity, key and message of what is found in the rig with this sensor.
    fn found(protocol: &str, rate: &str) -> Vec<(Severity, String, String)> {
        let text = malformed::base_text("rig.yaml");
        let (from, to) = (text.rfind("    canopen:").unwrap(), text.find("  sample_rate_hz").unwrap());
        let text = [&text[..from], protocol, &text[to..]].concat().replace("sample_rate_hz: 1000", rate);
        let findings = match load_rig(malformed::with("rig.yaml", "rig.yaml", &text)) {
            Ok(rig) => rig.warnings,
            Err(report) => report.diagnostics,
        };
        findings.into_iter().map(|finding| (finding.severity, finding.key, finding.message)).collect()
    }

    fn one(protocol: &str, from: &str, to: &str, key: &str, says: &str) -> Severity {
        assert!(protocol.contains(from));
        let found = found(&protocol.replace(from, to), "sample_rate_hz: 1000");
        let it = found.iter().find(|(_, at, message)| at == key && message.contains(says));
        it.unwrap_or_else(|| panic!("{to}: {found:?}")).0
    }

    #[test]
    fn good_sensors_pass() {
        for protocol in [STREAMING, POLLED] {
            assert_eq!(found(protocol, "sample_rate_hz: 1000"), []);
        }
    }

    #[test]
    fn identifiers_that_go_before_sync_are_a_warning() {
        let ids = "data_ids: [0x360, 0x361]";
        let group = "sensor.protocol.streaming.data_ids";
        let severity = one(STREAMING, ids, "data_ids: [0x001, 0x002]", group, "001h and 002h go before SYNC");
        assert_eq!(severity, Severity::Warning);
        let key = "sensor.protocol.streaming.command_id";
        assert_eq!(one(STREAMING, "0x35f", "0x064", key, "064h goes before SYNC"), Severity::Warning);
        assert_eq!(one(POLLED, "0x1b0", "0x07a", "sensor.protocol.polled.base_id", "before SYNC"), Severity::Warning);
    }

    #[test]
    fn identifiers_of_others_are_refused() {
        let key = "sensor.protocol.streaming.data_ids";
        for (id, user) in [
            ("0x080", "SYNC"),
            ("0x081", "the emergency message of left (node 1)"),
            ("0x181", "a PDO of left (node 1)"),
            ("0x302", "a PDO of right (node 2)"),
            ("0x582", "an SDO of right"),
        ] {
            let to = format!("data_ids: [{id}, 0x7f0]");
            assert_eq!(one(STREAMING, "data_ids: [0x360, 0x361]", &to, key, user), Severity::Error);
        }
        let key = "sensor.protocol.streaming.command_id";
        for (id, user) in
            [("0x77f", "the heartbeat of the master"), ("0x7e5", "LSS"), ("0x100", "TIME"), ("0x361", "`data_ids`")]
        {
            assert_eq!(one(STREAMING, "0x35f", id, key, user), Severity::Error);
        }
        // An answer.
        assert_eq!(one(POLLED, "0x1b0", "0x17c", "sensor.protocol.polled.base_id", "a PDO of left"), Severity::Error);
        assert_eq!(one(POLLED, "0x1b0", "0x7fa", "sensor.protocol.base_id", "greater than 2041"), Severity::Error);
    }

    #[test]
    fn halves_have_to_be_told_from_those_of_the_next_sample() {
        let (key, ids) = ("sensor.protocol.streaming.pair_gap_us", "sensor.protocol.streaming.data_ids");
        assert_eq!(one(STREAMING, "pair_gap_us: 500", "pair_gap_us: 1000", key, "frames of two"), Severity::Error);
        assert_eq!(one(STREAMING, "pair_gap_us: 500", "pair_gap_us: 90", key, "less than a frame"), Severity::Error);
        assert_eq!(one(STREAMING, "[0x360, 0x361]", "[0x361, 0x360]", ids, "would go first"), Severity::Error);
    }

    #[test]
    fn rates_are_those_of_a_sensor() {
        for (rate, is_found) in [("333.5", true), ("20000", true), ("200", false), ("500", false)] {
            let found = found(POLLED, &format!("sample_rate_hz: {rate}"));
            assert_eq!(found.iter().any(|(_, key, _)| key == "sensor.sample_rate_hz"), is_found, "{rate}: {found:?}");
        }
        let fast = found(&STREAMING.replace("500", "300"), "sample_rate_hz: 2000");
        assert!(matches!(&fast[..], [(Severity::Warning, key, _)] if key == "sensor.sample_rate_hz"), "{fast:?}");
    }
}
