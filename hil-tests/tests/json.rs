//! What commands print: with `--json` one object, with the exit code of the process and a list of diagnostics; without it tables that fit a
//! terminal.

use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn every_command_prints_one_object_with_its_exit_code_and_its_diagnostics() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-json-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    std::fs::write(folder.0.join("bad.yaml"), "rig: 5\n").unwrap();
    let rig = "builtin:paper-admittance.yaml";
    let run = format!("run {rig} --duration 0.2");
    // In this order: a recording is made before it is looked into.
    let cases: [(&str, i32); 67] = [
        (&format!("{run} --record rec"), 0),
        (&format!("run {rig} --duration 3 --fault node-reset@2.5 --black-box rec"), 8),
        (&format!("{run} --figure x.txt"), 2),
        (&format!("{run} --fault node-rest@0.1"), 2),
        ("run builtin:sphere.yaml --duration 0.2", 0),
        ("run bad.yaml", 3),
        ("run absent.yaml", 3),
        (&format!("config check {rig}"), 0),
        (&format!("config check {rig} bad.yaml absent.yaml"), 3),
        ("config check", 2),
        ("config chek", 2),
        ("faults", 0),
        ("faults node-reset", 0),
        ("faults node-rest", 2),
        ("explain node-reset 8130h 06090011 0x0637", 0),
        ("explain node-rest", 2),
        (&format!("bus budget {rig}"), 0),
        ("bus budget builtin:paper-admittance-two-buses.yaml", 0),
        (&format!("tune fixture {rig}"), 0),
        ("tune fixture builtin:sphere.yaml", 0),
        ("tune fixture builtin:scenes/room-walk.yaml", 2),
        ("record info rec", 0),
        ("record repair rec --out whole.mcap", 0),
        ("record export rec --csv rec.csv", 0),
        ("record export rec --csv rec.csv", 2),
        ("record info bad.yaml", 3),
        ("replay rec", 0),
        ("replay rec/paper-admittance-000001.black-box.mcap", 3),
        ("plot rec --figure rec.svg", 0),
        ("compare rec builtin:sphere.yaml --duration 0.1", 0),
        ("reproduce fig9 --out figures", 0),
        ("soak --seeds 0..2 --cycles 500", 0),
        ("scan", 0),
        ("scan --listen", 0),
        (&format!("run {rig} --fault wrong-bit-rate"), 5),
        ("doctor node left", 0),
        ("doctor node 5", 5),
        ("doctor node left --fault bus-off", 4),
        ("doctor node left --fault bus-of", 2),
        ("scan --rig builtin:paper-admittance-two-buses.yaml", 0),
        ("scan --rig absent.yaml", 3),
        ("info left", 0),
        ("info 77", 5),
        ("od read left statusword 1018h:4 position-actual", 0),
        ("od read left 5000h statusword", 5),
        ("od read lefft statusword", 2),
        ("od write left max-torque 900", 0),
        ("od write left max-torque 900 --dry-run", 0),
        ("od write left controlword 15", 2),
        ("od dump right --out right.dcf", 0),
        ("od dump right --out right.dcf", 2),
        ("od diff left right.dcf", 0),
        ("od diff left bad.yaml", 3),
        ("od restore right.dcf right --dry-run", 0),
        ("od restore right.dcf wrist", 5),
        ("pdo show wrist", 0),
        ("drive adopt --node left --out found.yaml", 0),
        ("drive adopt --node left --dry-run", 0),
        ("drive adopt --node wrist", 5),
        ("nmt left reset", 0),
        ("emcy", 0),
        ("state right", 0),
        ("state right --reset-fault", 2),
        ("monitor --for 0.5", 0),
        ("completions bash", 0),
        ("man", 0),
        ("man --out pages", 0),
    ];
    for (line, code) in cases {
        let seen = Command::new(hil_tests::program())
            .args(line.split(' ').chain(["--json"]))
            .current_dir(&folder.0)
            .env("XDG_STATE_HOME", folder.0.join("state"))
            .output()
            .unwrap();
        let text = String::from_utf8(seen.stdout).unwrap();
        assert_eq!(seen.status.code(), Some(code), "{line}: {text}");
        let document: Value = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{line}: {error}: {text}"));
        assert_eq!(document["exit_code"], code, "{line}: {text}");
        let diagnostics = document["diagnostics"].as_array().unwrap_or_else(|| panic!("{line}: {text}"));
        assert_eq!(diagnostics.iter().any(|one| one["severity"] == "error"), code != 0, "{line}: {text}");
        assert!(diagnostics.iter().all(|one| one["message"].is_string()), "{line}: {text}");
    }
}

#[test]
fn tables_of_devices_fit_eighty_columns() {
    for line in [
        "scan",
        "scan --rig builtin:paper-admittance-two-buses.yaml",
        "info left",
        "info wrist",
        "od read left statusword position-actual 1008h 1018h:2 max-torque 1400h:1",
        "od write left max-torque 900 --dry-run",
        "od diff left right --all",
        "pdo show left",
        "pdo show wrist",
        "drive adopt --node left --dry-run",
        "emcy",
        "state left",
        "nmt left reset",
        "lss find",
    ] {
        let seen = Command::new(hil_tests::program()).args(line.split(' ')).output().unwrap();
        let text = String::from_utf8(seen.stdout).unwrap();
        assert!(!text.is_empty(), "{line}");
        let wide = text.lines().find(|row| row.chars().count() > 80);
        assert_eq!(wide, None, "{line}");
    }
}

/// Each line is an event, and the last one what `--json` prints, on one line.
#[test]
fn a_stream_has_an_object_a_line_and_ends_with_the_document() {
    let folder = Folder(std::env::temp_dir().join(format!("yieldwall-jsonl-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let lines = |line: &str| {
        let mut program = Command::new(hil_tests::program());
        let seen =
            program.args(line.split(' ')).current_dir(&folder.0).env("XDG_STATE_HOME", &folder.0).output().unwrap();
        let text = String::from_utf8(seen.stdout).unwrap();
        let each =
            text.lines().map(|one| serde_json::from_str(one).unwrap_or_else(|error| panic!("{line}: {error}: {one}")));
        (seen.status.code().unwrap(), each.collect::<Vec<Value>>())
    };
    let run = "run builtin:paper-admittance.yaml --duration 0.3";
    for (line, code, must) in [
        (format!("{run} --jsonl"), 0, vec!["booted", "enabled", "stopped", "end"]),
        (
            format!("{run} --jsonl --fault drive-fault@0.2:left_drive"),
            6,
            vec!["enabled", "emergency", "fault", "error", "end"],
        ),
        ("latency --duration 0.05 --jsonl".to_owned(), 0, vec!["begun", "end"]),
        ("run absent.yaml --jsonl".to_owned(), 3, vec![]),
    ] {
        let (exit, lines) = lines(&line);
        assert_eq!(exit, code, "{line}: {lines:?}");
        let (last, events) = lines.split_last().unwrap();
        assert!(
            last["exit_code"] == code && last["diagnostics"].is_array() && last["event"].is_null(),
            "{line}: {last}"
        );
        let mut names = events.iter().map(|event| event["event"].as_str().unwrap());
        assert!(events.iter().all(|event| event["text"].is_string() && event.get("time_s").is_some()), "{line}");
        for name in must {
            assert!(names.any(|known| known == name), "{line}: no {name} in its place: {events:?}");
        }
    }
}
