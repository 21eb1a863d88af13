//! What is missing or wrong ends `run --bus` with one message that says what and what to do next, with the exit code that
//! `--help` documents, and no drive is ever enabled.

use std::process::Command;

use hil_tests::processes::output;
use serde_json::Value;

use super::programs::*;

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn an_interface_that_is_not_there() {
    let (code, message, _) = refusal(Running::start(&["run", RIG, "--bus", "vcan77", "--json"]));
    assert_eq!(code, BUS_UNAVAILABLE);
    assert!(message.contains("there is no interface `vcan77`"), "{message}");
    assert!(message.contains("sudo ip link add vcan77 type vcan"), "{message}");
    // An interface, and yet none for CAN.
    let (code, message, _) = refusal(Running::start(&["run", RIG, "--bus", "lo", "--json"]));
    assert_eq!(code, BUS_UNAVAILABLE);
    assert!(message.contains("`lo` is no CAN interface"), "{message}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_can_interface_for_a_segment() {
    let interface = format!("main={}", bus());
    for command in ["run", "drill", "sim"] {
        let arguments = [command, "builtin:paper-ethercat.yaml", "--bus", &interface, "--json"];
        let (code, message, _) = refusal(Running::start(&arguments));
        assert_eq!(code, BUS_UNAVAILABLE, "{command}: {message}");
        let told = format!("`{}` is a CAN interface, and EtherCAT runs on Ethernet; ", bus());
        assert!(message.starts_with(&told), "{command}: {message}");
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_process_that_may_not_open_can_sockets() {
    let filter = concat!(env!("CARGO_MANIFEST_DIR"), "/peers/without_can.py");
    let program = program();
    let program = program.to_str().expect("a plain path");
    let bus = bus();
    let done = output(Command::new("python3").args([filter, program, "run", RIG, "--bus", &bus]));
    let said = String::from_utf8(done.stderr).expect("text");
    assert_eq!(done.status.code(), Some(BUS_UNAVAILABLE), "{said}");
    let said = said.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    assert!(said.contains("this process may not open CAN sockets"), "{said}");
    assert!(said.contains("RestrictAddressFamilies"), "{said}");
    let done = output(Command::new("python3").args([filter, program, "doctor", "--bus", &bus, "--json"]));
    let document: Value = serde_json::from_slice(&done.stdout).expect("a document");
    let checks = document["checks"].as_array().expect("checks");
    let found = checks.iter().find(|check| check["subject"] == "permission").expect("the trouble by its name");
    assert_eq!((&found["verdict"], &document["exit_code"]), (&"wrong".into(), &BUS_UNAVAILABLE.into()), "{found:#}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_node_that_is_not_there() {
    let observer = Observer::new();
    let (code, message, help) = refusal(run_for("1"));
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(
        message.starts_with("node 1 (left) is silent; no other node of its bus answered: wait for the"),
        "{message}"
    );
    assert!(help.contains("node ids") && help.starts_with("`yieldwall doctor node 1 --bus "), "{help}");
    // Both drives are there, and the sensor is not.
    let socket = std::env::temp_dir().join(format!("yieldwall-refused-{}.sock", std::process::id()));
    let _ = std::fs::remove_file(&socket);
    let socket = socket.to_str().expect("a plain path");
    let sim = Running::sim(RIG, &["--pace", "lockstep", "--nodes", "left,right", "--plant", socket]);
    let (code, message, _) = refusal(run_for("1"));
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(message.starts_with("node 10 (wrist) is silent; 1 and 2 answered: wait for the boot-up"), "{message}");
    drop(sim);
    let _ = std::fs::remove_file(socket);
    assert!(!is_enabled(&observer.rest()));
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_device_that_is_another_one() {
    // The sensor has the node id of the left drive.
    let swapped = changed(
        "swapped",
        "paper-admittance.yaml",
        &[
            ("    node_id: 1\n", "    node_id: 77\n"),
            ("node_id: 10\n", "node_id: 1\n"),
            ("node_id: 77\n", "node_id: 10\n"),
        ],
    );
    let sim = Running::sim(&swapped, &["--pace", "lockstep"]);
    let observer = Observer::new();
    let (code, message, help) = refusal(run_for("1"));
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(message.contains("node 1 (left): check the device type"), "{message}");
    assert!(message.contains("1000h:0") && message.contains("0x20194") && message.contains("0x20192"), "{message}");
    assert!(help.contains("profiles"), "{help}");
    assert!(!is_enabled(&observer.rest()));
    drop(sim);
    std::fs::remove_file(swapped).expect("it is there");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_whose_watchdogs_nobody_has_tried() {
    let (rig, scene) = super::wall_clock::slow();
    let state = std::env::temp_dir().join(format!("yieldwall-untried-{}", std::process::id()));
    let bus = bus();
    let arguments = ["run", &rig, "--bus", &bus, "--json", "--duration", "1", "--ignore-latency"];
    let sim = Running::sim(&rig, &["--scene", &scene]);
    let observer = Observer::new();
    let (code, _, help) = refusal(Running::start_with(&state, &arguments));
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(help.contains(&format!("yieldwall drill {rig} --bus {bus}")), "{help}");
    assert!(!is_enabled(&observer.rest()));
    drop(sim);
    std::fs::remove_file(rig).expect("it is there");
    std::fs::remove_file(scene).expect("it is there");
}
