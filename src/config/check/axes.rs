//! Drives that are axes of one device: their common properties, and whether the device has these axes.

use yieldwall_drives::profiles::Fieldbus;

use super::Findings;
use crate::tree::Rig;

/// PDOs of a direction for which a node of CANopen has default identifiers.
const IDENTIFIERS: usize = 4;

/// Whether both drives are at one address and at least one of them is written as an axis.
pub(super) fn are_axes(rig: &Rig) -> bool {
    rig.has_one_device() && rig.drives.iter().any(|drive| drive.address.axis().is_some())
}

/// Checks that each axis exists in its device, and that both drives of one device agree on everything that the device has only
/// once.
pub(super) fn check_axes(findings: &mut Findings, rig: &Rig) {
    for index in 0..rig.drives.len() {
        check_axis(findings, rig, index);
    }
    if are_axes(rig) {
        check_common(findings, rig);
        check_identifiers(findings, rig);
    }
}

/// The key of the address of a drive.
fn address_key(rig: &Rig, index: usize) -> String {
    let bus = match rig.drives[index].address.fieldbus() {
        Fieldbus::Canopen => "canopen",
        Fieldbus::Ethercat => "ethercat",
    };
    format!("drives[{index}].address.{bus}")
}

fn check_axis(findings: &mut Findings, rig: &Rig, index: usize) {
    let drive = &rig.drives[index];
    let (Some(axis), Some(profile)) = (drive.address.axis(), drive.profile.get()) else { return };
    let count = profile.axes();
    if axis < count {
        return;
    }
    let key = format!("{}.axis", address_key(rig, index));
    let name = drive.profile.as_str();
    let (message, help) = match count {
        1 => (
            format!("`{key}` is {axis}, and the profile `{name}` is of a device of one drive"),
            "write `axes: {count: 2}` in `device.servo` of the profile if the device has several, otherwise leave `axis` out".to_owned(),
        ),
        _ => (
            format!("`{key}` is {axis}, and the profile `{name}` has {count} axes, counted from 0"),
            format!("write 0 to {}", count - 1),
        ),
    };
    findings.error(&key, message, help).see(&format!("drives[{index}].profile"), "profile");
}

fn check_common(findings: &mut Findings, rig: &Rig) {
    let [left, right] = &rig.drives;
    let keys = [address_key(rig, 0), address_key(rig, 1)].map(|key| format!("{key}.axis"));
    match (left.address.axis(), right.address.axis()) {
        (Some(first), Some(second)) if first == second => {
            let message = format!("`{}` is {second}, and so is `{}` of the same device", keys[1], keys[0]);
            findings.error(&keys[1], message, "give each drive an axis of its own").see(&keys[0], "the other");
        }
        (Some(_), Some(_)) | (None, None) => {}
        (first, _) => {
            let (lacking, other) = if first.is_none() { (0, 1) } else { (1, 0) };
            let address = address_key(rig, lacking);
            let message = format!("`{address}` has no `axis`, and the other drive at this address has one");
            let help = "write `axis`, counted from 0, at both drives of one device";
            findings.error(&address, message, help).see(&keys[other], "the other");
        }
    }
    let beat = |index: usize| rig.drives[index].address.heartbeat_ms();
    if beat(0) != beat(1) {
        let at = |index: usize| format!("{}.heartbeat_ms", address_key(rig, index));
        let message = format!("`{}` is not that of `{}`, and one device has one heartbeat", at(1), at(0));
        findings.error(&at(1), message, "write the same period at both drives").see(&at(0), "the other");
    }
    if left.profile != right.profile {
        let message = "`drives[1].profile` is not that of `drives[0]`, and both drives are axes of one device";
        let help = "name one profile, whose `axes` say how many there are, at both drives";
        findings.error("drives[1].profile", message, help).see("drives[0].profile", "the other");
    }
    if left.waits != right.waits {
        let message = "`drives[1].waits` are not those of `drives[0]`, and one device is waited for once";
        findings
            .error("drives[1].waits", message, "write the same times at both drives")
            .see("drives[0].waits", "the other");
    }
}

/// Whether CANopen has identifiers for the PDOs of all used axes of a device.
fn check_identifiers(findings: &mut Findings, rig: &Rig) {
    let [left, _] = &rig.drives;
    let mode = rig.rig.command_mode.operation_mode();
    let map = left.profile.get().and_then(|profile| profile.pdos(Some(mode)));
    let (Some(map), Some(node_id)) = (map, left.address.node_id()) else { return };
    let axes = rig.drives.len();
    for (word, pdos) in [("RPDOs", map.rpdo.len()), ("TPDOs", map.tpdo.len())] {
        if axes * pdos > IDENTIFIERS {
            let message = format!(
                "the {axes} axes of node {node_id} have {} {word} in this mode, and a node has identifiers for {IDENTIFIERS}",
                axes * pdos
            );
            let help = format!("map all that an axis has in {} of them in the profile", IDENTIFIERS / axes);
            findings.error("drives[1].profile", message, help).see("rig.command_mode", "mode");
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Source, builtin, load_profile, load_rig};

    /// Key, message and help of what is found in a shipped rig with two axes of one device and some of its text replaced.
    fn found(name: &str, from: &str, to: &str) -> Vec<(String, String, String)> {
        let text = builtin(name).read().unwrap();
        assert!(text.contains(from), "{from}");
        let text = text.replace(from, to).replace("like: ../", "like: builtin:");
        let text = text.replace("profiles/", "builtin:vendors/profiles/");
        let report = load_rig(Source::memory("rig.yaml", text)).unwrap_err();
        let each = report.diagnostics.into_iter().inspect(|it| assert!(it.place.is_some(), "{it:?}"));
        each.map(|it| (it.key, it.message, it.help.unwrap_or_default())).collect()
    }

    #[test]
    fn axes_of_one_device_differ_and_are_those_of_its_profile() {
        for (name, bus, left, right) in [
            ("vendors/three-axes.yaml", "canopen", "axis: 0", "axis: 1"),
            ("vendors/ethercat-three-axes.yaml", "ethercat", "axis: 2", "axis: 0"),
        ] {
            let address = format!("drives[1].address.{bus}");
            for (from, to, key, message, help) in [
                (right, left, format!("{address}.axis"), "and so is", "an axis of its own"),
                (right, "axis: 3", format!("{address}.axis"), "has 3 axes", "write 0 to 2"),
            ] {
                let found = found(name, from, to);
                let [(at, says, next)] = found.as_slice() else { panic!("{name} {to}: {found:?}") };
                assert!(*at == key && says.contains(message) && next.contains(help), "{name} {to}: {found:?}");
            }
            let lacking = found(name, &format!(", {right}"), "");
            let [(at, says, next)] = lacking.as_slice() else { panic!("{lacking:?}") };
            assert!(*at == address && says.contains("has no `axis`") && next.contains("at both"), "{lacking:?}");
        }
    }

    #[test]
    fn one_device_has_one_heartbeat_one_profile_and_one_wait() {
        const RIGHT: &str = "{name: right, profile: profiles/three-axes.yaml, address: {canopen: {node_id: 1, heartbeat_ms: 20, axis: 1}}}";
        let right = |from: &str, to: &str| found("vendors/three-axes.yaml", RIGHT, &RIGHT.replace(from, to));
        for (from, to, key, help) in [
            ("heartbeat_ms: 20", "heartbeat_ms: 40", "drives[1].address.canopen.heartbeat_ms", "the same period"),
            ("{name: right", "{waits: {sdo_ms: 900}, name: right", "drives[1].waits", "the same times"),
        ] {
            let found = right(from, to);
            let [(at, _, next)] = found.as_slice() else { panic!("{to}: {found:?}") };
            assert!(at == key && next.contains(help), "{found:?}");
        }
        let found = right("profiles/three-axes.yaml", "simulated-servo");
        let keys: Vec<&str> = found.iter().map(|(key, ..)| key.as_str()).collect();
        assert_eq!(keys, ["drives[1].profile", "drives[1].address.canopen.axis"], "{found:?}");
        assert!(found[1].2.contains("axes: {count: 2}") && found[0].2.contains("at both drives"), "{found:?}");
    }

    #[test]
    fn drives_at_one_address_without_axes_are_told_of_them() {
        let text = "like: builtin:paper-admittance.yaml\ndrives:\n  - {name: left}\n  - {name: right, address: {canopen: {node_id: 1}}}\n";
        let report = load_rig(Source::memory("rig.yaml", text)).unwrap_err();
        let [found] = report.diagnostics.as_slice() else { panic!("{report}") };
        assert!(found.key == "drives[1].address.canopen.node_id" && found.help.as_ref().unwrap().contains("`axis: 0`"));
    }

    /// Findings in the profile of three axes with some of its text replaced.
    fn of_profile(from: &str, to: &str) -> Vec<(String, String)> {
        let text = builtin("vendors/profiles/three-axes.yaml").read().unwrap();
        assert!(text.contains(from), "{from}");
        let report = load_profile(Source::memory("profile.yaml", text.replace(from, to))).unwrap_err();
        report.diagnostics.into_iter().map(|it| (it.key, it.message)).collect()
    }

    #[test]
    fn each_axis_has_objects_and_process_data_of_its_own() {
        const STEP: &str = "vendor_object_step: 0x100";
        let vendor = |step: &str| {
            let text = builtin("vendors/profiles/three-axes.yaml").read().unwrap();
            let text = text.replace("torque: {index: 0x6072", "torque: {index: 0x3072").replace(STEP, step);
            load_profile(Source::memory("profile.yaml", text))
        };
        // An object of each axis among those of the vendor needs a step; a setting may be shared.
        assert!(vendor(STEP).is_ok());
        let report = vendor("vendor_object_step: 0").unwrap_err();
        let [found] = report.diagnostics.as_slice() else { panic!("{report}") };
        assert!(
            found.key == "device.servo.axes"
                && found.message.contains("3072h:00")
                && found.message.contains("one place")
        );
        assert!(found.help.as_ref().unwrap().contains("`vendor_object_step`"), "{found:?}");
        let found = of_profile("object_step: 0x800", "object_step: 0x2000");
        assert!(
            matches!(&found[..], [(key, says)] if key == "device.servo.axes" && says.contains("A040h")),
            "{found:?}"
        );
        let found = of_profile("vendor_object_step: 0x100", "vendor_object_step: 0x100\n      gap_step: 0x800");
        assert!(matches!(&found[..], [(key, _)] if key == "device.servo.axes.gap_step"), "{found:?}");
        let two = |text: &str| text.replace("rpdo: [{number: 1,", "rpdo: [{number: 2,");
        let text = two(&builtin("vendors/profiles/three-axes.yaml").read().unwrap());
        let text = text.replace(STEP, &format!("pdo_step: 1\n      {STEP}"));
        let report = load_profile(Source::memory("profile.yaml", text)).unwrap_err();
        assert!(report.diagnostics.iter().all(|it| it.key == "device.servo.axes.pdo_step"), "{report}");
        assert!(report.diagnostics[0].message.contains("reach into the next one"), "{report}");
    }
}
