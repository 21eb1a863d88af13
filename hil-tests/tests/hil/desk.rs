//! The commands that ask devices one by one, on an interface with simulated devices.

use std::time::Instant;

use serde_json::Value;

use super::programs::*;

/// A command on the interface with the names of the rig.
fn ask(line: &str) -> (i32, Value) {
    let bus = bus();
    let arguments: Vec<&str> = line.split(' ').chain(["--bus", &bus, "--rig", RIG, "--json"]).collect();
    Running::start(&arguments).document()
}

fn well(line: &str) -> Value {
    let (code, document) = ask(line);
    assert_eq!(code, OK, "{line}: {document:#}");
    document
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn devices_are_found_read_changed_compared_and_put_back() {
    let sim = Running::sim(RIG, &[]);
    let begun = Instant::now();
    let found = well("scan");
    let took = begun.elapsed();
    let nodes: Vec<_> = found["nodes"].as_array().unwrap().iter().collect();
    let fits: Vec<(u64, &str)> =
        nodes.iter().map(|node| (node["node_id"].as_u64().unwrap(), node["fits"].as_str().unwrap())).collect();
    assert_eq!(fits, [(1, "left"), (2, "right"), (10, "wrist")], "{found:#}");
    println!("scan took {:.2} s", took.as_secs_f64());

    let file = std::env::temp_dir().join(format!("yieldwall-desk-{}.dcf", std::process::id()));
    let path = file.to_str().unwrap();
    let _ = std::fs::remove_file(&file);
    well(&format!("od dump left --out {path}"));
    assert_eq!(well(&format!("od diff left {path}"))["differences"], Value::Array(vec![]));
    for (object, value) in
        [("max-torque", "900"), ("605ah", "6"), ("1017h", "100"), ("6065h", "1000"), ("60c2h:1", "2")]
    {
        let written = well(&format!("od write left {object} {value}"));
        assert_eq!(written["writes"].as_array().unwrap().len(), 1, "{written:#}");
    }
    let (code, differs) = ask(&format!("od diff left {path}"));
    assert_eq!((code, differs["differences"].as_array().unwrap().len()), (OUT_OF_TOLERANCE, 5), "{differs:#}");
    // Nothing is changed by saying what would be.
    let dry = well(&format!("od restore {path} left --dry-run"));
    assert_eq!(dry["writes"].as_array().unwrap().len(), 5, "{dry:#}");
    assert_eq!(ask(&format!("od diff left {path}")).0, OUT_OF_TOLERANCE);
    well(&format!("od restore {path} left"));
    assert_eq!(well(&format!("od diff left {path}"))["differences"], Value::Array(vec![]));
    // What was written over was kept, and can be put back.
    let kept = own_state().join("yieldwall/backups");
    let backups: Vec<_> = std::fs::read_dir(&kept).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(backups.len() >= 6, "{backups:?}");
    let oldest = backups.iter().min().unwrap().to_str().unwrap();
    assert_eq!(well(&format!("od restore {oldest} left"))["writes"], Value::Array(vec![]));

    assert_eq!(well("nmt left start")["state"], "Operational");
    let (code, _) = ask(&format!("od restore {path} left"));
    assert_eq!(code, 2, "not while process data run");
    assert_eq!(well("nmt left reset")["state"], "Pre-operational");
    assert_eq!(well("state left")["state"], "SwitchOnDisabled");
    assert_eq!(well("info wrist")["name"], "simulated-force-sensor");
    assert_eq!(well("emcy left")["nodes"][0]["errors"], Value::Array(vec![]));
    assert_eq!(ask("od read 77 statusword").0, DEVICE_MISMATCH);
    let _ = std::fs::remove_file(&file);
    sim.interrupted();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_device_gets_another_node_id_by_lss() {
    let sim = Running::sim(RIG, &[]);
    let (code, taken) = ask("lss set-id left 2");
    assert_eq!(code, 2, "{taken:#}");
    assert_eq!(well("lss set-id left 9")["node_id"], 9);
    let (code, moved) = ask("nmt left reset");
    assert_eq!(code, DEVICE_MISMATCH, "it boots as node 9: {moved:#}");
    let nodes: Vec<u64> =
        well("scan")["nodes"].as_array().unwrap().iter().filter_map(|node| node["node_id"].as_u64()).collect();
    assert_eq!(nodes, [2, 9, 10]);
    sim.interrupted();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn beside_a_rig_that_runs_nothing_is_sent_and_all_is_heard() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let rig = run_for("3600");
    observer.until_moving(300);
    for line in ["scan", "info left", "od read left statusword", "nmt left stop", "lss find", "emcy", "state left"] {
        let (code, refused) = ask(line);
        assert_eq!(code, BUS_UNAVAILABLE, "{line}: {refused:#}");
    }
    let heard = well("scan --listen");
    let nodes: Vec<u64> =
        heard["nodes"].as_array().unwrap().iter().filter_map(|node| node["node_id"].as_u64()).collect();
    assert!([1, 2, 10].iter().all(|node| nodes.contains(node)), "{heard:#}");
    // More than a pipe holds: it is read while it is written.
    let bus = bus();
    let monitor = ["monitor", "--for", "0.3", "--bus", &bus, "--rig", RIG, "--json"];
    let seen = std::process::Command::new(program()).args(monitor).output().unwrap();
    let frames: Value = serde_json::from_slice(&seen.stdout).unwrap();
    let texts: Vec<&str> =
        frames["frames"].as_array().unwrap().iter().filter_map(|frame| frame["what"].as_str()).collect();
    for wanted in ["SYNC", "RPDO 1 of 1 (left): controlword 000Fh", "TPDO 1 of 2 (right): statusword"] {
        assert!(
            texts.iter().any(|text| text.starts_with(wanted)),
            "{wanted} is not in {:#?}",
            &texts[..texts.len().min(30)]
        );
    }
    rig.signal("INT");
    let (code, document) = rig.document();
    assert_eq!((code, &document["state"]), (INTERRUPTED, &"Running".into()), "{document:#}");
    sim.interrupted();
}
