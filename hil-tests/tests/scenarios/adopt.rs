//! A drive that nobody has written a profile of: adopted on the embedded simulation, checked, and run by what was found.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn yieldwall(folder: &Path, line: &str) -> Output {
    let mut program = Command::new(hil_tests::program());
    hil_tests::processes::output(
        program.args(line.split(' ')).current_dir(folder).env("XDG_STATE_HOME", folder.join("state")),
    )
}

fn well(folder: &Path, line: &str) -> String {
    let seen = yieldwall(folder, line);
    let [text, said] = [seen.stdout, seen.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert_eq!(seen.status.code(), Some(0), "{line}: {text}{said}");
    text
}

/// What a command with `--json` that goes well says.
fn document(folder: &Path, line: &str) -> Value {
    serde_json::from_str(&well(folder, line)).unwrap()
}

#[test]
fn an_adopted_drive_runs_by_its_profile() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-adopt-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    well(&folder.0, "drive adopt --node left --out found.yaml --name found");
    // Not over the one that is there.
    assert_eq!(yieldwall(&folder.0, "drive adopt --node left --out found.yaml").status.code(), Some(2));
    well(&folder.0, "config check found.yaml");
    let rig = well(&folder.0, "config show builtin:paper-admittance-csp.yaml");
    assert_eq!(rig.matches("profile: simulated-servo").count(), 2);
    // What the drive cannot tell, a person has to: what its encoder knows at power-on.
    let without = rig.replace("profile: simulated-servo", "profile: found.yaml");
    std::fs::write(folder.0.join("without.yaml"), &without).unwrap();
    let refused = yieldwall(&folder.0, "config check without.yaml");
    assert_eq!(refused.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("encoder"));
    let with = without.replace("profile: found.yaml", "profile: found.yaml\n  encoder: multi_turn");
    std::fs::write(folder.0.join("with.yaml"), with).unwrap();
    // What shows in Operation Enabled alone counts as missing until somebody has seen it: the simulated drive of such a profile goes on,
    // and its drill refuses it.
    let unseen = yieldwall(&folder.0, "run with.yaml --duration 3");
    assert_eq!(unseen.status.code(), Some(7));
    assert!(String::from_utf8_lossy(&unseen.stderr).contains("without set-points"));
    let found = std::fs::read_to_string(folder.0.join("found.yaml")).unwrap();
    assert_eq!(found.matches("reaction: unknown").count(), 1, "{found}");
    std::fs::write(folder.0.join("found.yaml"), found.replace("reaction: unknown", "reaction: fault")).unwrap();
    well(&folder.0, "run with.yaml --duration 3");
}

/// A rig on drives of a vendor, which takes them for what a profile says.
fn rig_on(folder: &Path, vendor: &str, profile: &str) -> String {
    let shown = well(folder, &format!("config show builtin:vendors/{vendor}.yaml"));
    let own = format!("  profile: builtin:vendors/profiles/{vendor}.yaml\n");
    let rig = shown.replacen(&own, &format!("  profile: {profile}\n  encoder: multi_turn\n"), 2);
    assert_eq!(rig.matches(&own).count(), 1, "the simulated drives stay what they are: {rig}");
    rig
}

/// What a drill shows of drives of five odd vendors beyond what an adopted profile says: without SYNC, and without set-points.
const VENDORS: [(&str, [Option<&str>; 2]); 5] = [
    ("four-entries", [Some("built_in"), Some("fault")]),
    ("mode-below-enabled", [None, Some("abort_connection")]),
    ("no-rpdo-timer", [Some("built_in"), None]),
    ("slow-segments", [Some("built_in"), Some("fault")]),
    ("wrong-lengths", [Some("built_in"), Some("fault")]),
];

#[test]
fn drives_of_five_odd_vendors_run_by_what_was_found_of_them() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-vendors-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    for (vendor, shows) in VENDORS {
        let on = format!("--rig builtin:vendors/{vendor}.yaml");
        let scan = document(&folder.0, &format!("scan {on} --json"));
        assert_eq!(
            (&scan["nodes"][0]["name"], &scan["nodes"][0]["fits"]),
            (&vendor.into(), &"left".into()),
            "{scan:#}"
        );
        let read = document(&folder.0, &format!("od read left statusword 60c2h:2 {on} --json"));
        assert_eq!(read["objects"][0]["means"], "Switch On Disabled", "{vendor}: {read:#}");
        assert!(read["objects"][1]["value"].as_str().unwrap().starts_with("-3 "), "{vendor}: {read:#}");
        well(&folder.0, &format!("info left {on}"));
        let profile = format!("{vendor}.yaml");
        well(&folder.0, &format!("drive adopt --node left --out {profile} --name found {on}"));
        well(&folder.0, &format!("config check {profile}"));
        std::fs::write(folder.0.join("rig.yaml"), rig_on(&folder.0, vendor, &profile)).unwrap();
        // What the profile does not say the drill settles, and names the line to write.
        let run = document(&folder.0, "run rig.yaml --duration 1 --json");
        let settled = run["settled"].as_array().unwrap();
        let line = |without: &str| {
            let one = settled.iter().find(|one| one["without"] == without);
            one.map(|one| (one["key"].as_str().unwrap().to_owned(), one["write"].as_str().unwrap().to_owned()))
        };
        let lines = ["SYNC", "set-points"].map(line);
        let mut text = std::fs::read_to_string(folder.0.join(&profile)).unwrap();
        for (line, shows) in lines.iter().zip(shows) {
            assert_eq!(
                line.as_ref().map(|(_, value)| value.contains(shows.unwrap_or_default())),
                shows.map(|_| true),
                "{vendor}: {run:#}"
            );
            match line {
                Some((key, value)) if key.ends_with(".reaction") => {
                    text = text.replace("reaction: unknown", &format!("reaction: {value}"));
                }
                Some((key, value)) => {
                    assert_eq!(key, "device.servo.watchdogs.sync");
                    text = text.replace("      sync: none ", &format!("      sync: {value} "));
                    text = text.replace("  sources:\n", "  sources:\n    drill: the watchdog drill of yieldwall\n");
                }
                None => {}
            }
        }
        std::fs::write(folder.0.join(&profile), text).unwrap();
        let run = document(&folder.0, "run rig.yaml --duration 0.2 --json");
        assert_eq!(run["settled"], Value::Array(Vec::new()), "{vendor}: {run:#}");
    }
}

#[test]
fn a_profile_that_expects_what_a_drive_lacks_is_refused_at_its_boot_or_by_its_drill() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-expects-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let rig = |profile: &str, changes: &[(&str, &str)]| {
        let shown = well(&folder.0, "config show builtin:vendors/profiles/no-rpdo-timer.yaml");
        let text = changes.iter().fold(shown, |text, (from, to)| {
            assert!(text.contains(from), "{from}: {text}");
            text.replace(from, to)
        });
        std::fs::write(folder.0.join(profile), text).unwrap();
        std::fs::write(folder.0.join("rig.yaml"), rig_on(&folder.0, "no-rpdo-timer", profile)).unwrap();
    };
    let refused = |code: i32, says: &str| {
        let seen = yieldwall(&folder.0, "run rig.yaml --duration 1");
        let said = String::from_utf8_lossy(&seen.stderr).replace("\n  ", " ");
        assert_eq!(seen.status.code(), Some(code), "{said}");
        assert!(said.contains(says), "{says} is not in {said}");
    };
    let event_timer = "set_points:\n        event_timer:\n          reaction: fault\n          source: here";
    rig("timer.yaml", &[("set_points: none", event_timer)]);
    refused(5, "1400h:5");
    let built_in =
        "set_points:\n        built_in:\n          periods: 5\n          reaction: unknown\n          source: here";
    rig("watch.yaml", &[("set_points: none", built_in)]);
    refused(7, "device.servo.watchdogs.set_points: none");
    rig("vendor.yaml", &[("vendor_id: 4294924803", "vendor_id: 7")]);
    refused(5, "1018h:1");
}

#[test]
fn a_data_sheet_is_compared_with_the_drive_whose_word_counts() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-sheet-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let sheet = "[DeviceInfo]\nVendorName=Nobody\nVendorNumber=0xFFFF5A01\nProductName=Four\nProductNumber=0x402\n\
        [DummyUsage]\nDummy0005=1\n\
        [1000]\nParameterName=Device Type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x20192\n\
        [1600]\nParameterName=Receive mapping\nObjectType=9\nSubNumber=9\nCompactSubObj=8\nDataType=7\nAccessType=rw\n\
        [6007]\nParameterName=Lost link reaction\nObjectType=7\nDataType=3\nAccessType=rw\nLowLimit=0\nHighLimit=2\n\
        [6041]\nParameterName=State of the axis\nObjectType=7\nDataType=6\nAccessType=ro\nPDOMapping=1\n\
        [6502]\nParameterName=Modes\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x380\n";
    std::fs::write(folder.0.join("four.eds"), sheet).unwrap();
    let on = "--rig builtin:vendors/four-entries.yaml --json";
    let read = document(&folder.0, &format!("od read left state-of-the-axis --eds four.eds {on}"));
    assert_eq!(read["objects"][0]["object"], "6041h:0");
    let adopted = document(&folder.0, &format!("drive adopt --node left --eds four.eds --out found.yaml {on}"));
    let lines: Vec<&str> = adopted["contradictions"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    let head = std::fs::read_to_string(folder.0.join("found.yaml")).unwrap();
    for says in [
        "entries of a mapping: 8 by the data sheet, 4 by the drive",
        "dummy entries of one byte: yes by the data sheet, no by the drive",
        "6007h:0 Lost link reaction: 0 to 2 by the data sheet, and the drive takes 3",
        "6040h:0 controlword: not in the data sheet, and the drive has it",
    ] {
        assert!(lines.contains(&says), "{says} is not in {lines:#?}");
        assert!(head.contains(&format!("# - {says}\n")), "{head}");
    }
    assert!(!lines.iter().any(|line| line.contains("6041h") || line.contains("6502h")), "{lines:#?}");
    assert!(
        head.contains("mapping_entries: 4") && head.contains("value: 3}") && head.contains("four.eds of Nobody Four"),
        "{head}"
    );
    well(&folder.0, "config check found.yaml");
}

/// The device description of the drives of `ethercat-fixed-assignment`, for another time of SYNC1 than theirs or for theirs.
fn description(product: &str, sync1_ns: u32) -> String {
    format!(
        "<?xml version=\"1.0\"?><EtherCATInfo><Vendor><Id>#xFFFF5A06</Id><Name>Nobody</Name></Vendor><Descriptions><Devices><Device>\
         <Type ProductCode=\"{product}\" RevisionNo=\"1\">Drive</Type><Name LcId=\"1033\">Drive with a clock</Name><Dc><OpMode><Name>DC</Name>\
         <AssignActivate>#x0700</AssignActivate><CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0><ShiftTimeSync0>0</ShiftTimeSync0>\
         <CycleTimeSync1 Factor=\"1\">0</CycleTimeSync1><ShiftTimeSync1>{sync1_ns}</ShiftTimeSync1></OpMode></Dc></Device></Devices>\
         </Descriptions></EtherCATInfo>"
    )
}

#[test]
fn a_drive_on_ethercat_with_fixed_mappings_is_adopted_and_run_by_its_profile() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-adopt-segment-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    std::fs::write(folder.0.join("drive.xml"), description("#x1701", 250_000)).unwrap();
    std::fs::write(folder.0.join("other.xml"), description("#x1702", 0)).unwrap();
    let vendor = "ethercat-fixed-assignment";
    let on = format!("--rig builtin:vendors/{vendor}.yaml");
    let other = yieldwall(&folder.0, &format!("drive adopt --node left --eds other.xml --out found.yaml {on}"));
    assert_eq!(other.status.code(), Some(5), "{}", String::from_utf8_lossy(&other.stderr));
    assert!(!folder.0.join("found.yaml").exists());
    well(&folder.0, &format!("drive adopt --node left --eds drive.xml --out found.yaml --name found {on}"));
    let found = std::fs::read_to_string(folder.0.join("found.yaml")).unwrap();
    for says in [
        "buses: [ethercat]",
        // The mapping that is exchanged carries the targets of both modes.
        "number: 259, fixed: true, transmission_type: 1, maps: [controlword, {unused: {index: 0x6060, sub: 0, bits: 8}}, {gap: 8}, target_torque, \
         {unused: {index: 0x607a, sub: 0, bits: 32}}]",
        "{gap: 8}, {unused: {index: 0x6071, sub: 0, bits: 16}}, target_position]",
        "{gap: 3}, {unused: {index: 0x2100, sub: 1, bits: 1}}, {gap: 4}, position_actual",
        "sync1_us: 250",
        "velocity: null",
    ] {
        assert!(found.contains(says), "{says} is not in {found}");
    }
    well(&folder.0, "config check found.yaml");
    for mode in ["position", "torque"] {
        let rig =
            rig_on(&folder.0, vendor, "found.yaml").replace("command_mode: position", &format!("command_mode: {mode}"));
        std::fs::write(folder.0.join("rig.yaml"), rig).unwrap();
        well(&folder.0, "run rig.yaml --duration 0.3");
    }
}

#[test]
fn a_node_with_fixed_mappings_is_adopted_by_the_one_that_fits_or_refused_by_name() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-adopt-fixed-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let vendor = "fixed-standard-mapping";
    well(
        &folder.0,
        &format!("drive adopt --node left --out found.yaml --name found --rig builtin:vendors/{vendor}.yaml"),
    );
    let found = std::fs::read_to_string(folder.0.join("found.yaml")).unwrap();
    for says in [
        "rpdo: [{number: 3, fixed: true, transmission_type: 1, maps: [controlword, target_position]}]",
        "tpdo: [{number: 3, fixed: true, transmission_type: 1, maps: [statusword, position_actual]}]",
        "torque: null",
    ] {
        assert!(found.contains(says), "{says} is not in {found}");
    }
    well(&folder.0, "config check found.yaml");
    // Without a TPDO of statusword and position no mode gets its words.
    let rig = well(&folder.0, &format!("config show builtin:vendors/{vendor}.yaml"));
    assert_eq!(rig.matches("- index: 6658\n").count(), 1, "{rig}");
    let odd = "- {index: 6658, sub: 2, holds: 1617690656, read_only: true}\n    - index: 6658\n";
    let without = rig.replacen("- index: 6658\n", odd, 1);
    std::fs::write(folder.0.join("without.yaml"), without).unwrap();
    let seen = yieldwall(&folder.0, "drive adopt --node left --out other.yaml --rig without.yaml");
    let said = String::from_utf8_lossy(&seen.stderr).replace("│ ", "").replace("\n  ", " ");
    assert_eq!(seen.status.code(), Some(5), "{said}");
    for says in ["statusword and position do not go into one TPDO", "1A02h maps 6041h:0/16 606Ch:0/32"] {
        assert!(said.contains(says), "{says} is not in {said}");
    }
    assert!(!folder.0.join("other.yaml").exists());
}
