//! The commands that ask devices one by one, on the near end of the cable.

use serde_json::Value;

use super::super::programs::*;
use super::rigs::{NEAR, Slow};
use super::served::Served;

fn ask(rig: &str, line: &str) -> (i32, Value) {
    let arguments: Vec<&str> = line.split(' ').chain(["--bus", NEAR, "--rig", rig, "--json"]).collect();
    Running::start(&arguments).document()
}

fn well(rig: &str, line: &str) -> Value {
    let (code, document) = ask(rig, line);
    assert_eq!(code, OK, "{line}: {document:#}");
    document
}

/// Commands find, read and repair a device with an empty memory chip and the others.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn devices_are_found_asked_and_mended_while_one_is_broken() {
    let slow = Slow::new("desk");
    let mut is_whole = true;
    let damage = move |server: &mut yieldwall::rig::SegmentServer| {
        if std::mem::take(&mut is_whole) {
            server.segment_mut().expect("a segment").controller_mut(0).expect("the left drive").sii_mut().fill(0xff);
        }
    };
    let devices = Served::with(&slow.rig, &slow.scene, [true; 3], damage);
    let rig = slow.rig.as_str();
    let found = well(rig, "scan");
    let each = found["devices"].as_array().expect("devices");
    let damaged: Vec<bool> = each.iter().map(|device| device["sii"].is_string()).collect();
    assert_eq!(damaged, [true, false, false], "{found:#}");
    assert!(each[0]["sii"].as_str().expect("why").contains("the chip is empty"), "{found:#}");
    assert_eq!(each[2]["rig_entry"], "wrist", "{found:#}");
    let (code, checked) = ask(rig, "sii check");
    assert_eq!((code, &checked["devices"][0]["whole"]), (OUT_OF_TOLERANCE, &false.into()), "{checked:#}");
    assert_eq!(ask(rig, "doctor node left").0, DEVICE_MISMATCH);

    let held = well(rig, "od read right max-torque");
    assert_eq!(held["objects"][0]["value"], "1000 (03E8h)", "{held:#}");
    let written = well(rig, "od write right max-torque 900");
    assert_eq!(written["writes"][0]["outcome"], "wrote", "{written:#}");
    assert_eq!(well(rig, "od read right max-torque")["objects"][0]["value"], "900 (0384h)");
    assert_eq!(well(rig, "reg read right al-status")["registers"][0]["means"], "PRE-OP");
    let (code, refused) = ask(rig, "state right safeop");
    assert_eq!(code, DEVICE_MISMATCH, "{refused:#}");
    let message = refused["diagnostics"][0]["message"].as_str().expect("why");
    assert!(message.contains("PRE-OP+ERR to SAFE-OP refused with 001"), "{message}");
    assert_eq!(well(rig, "state right ack")["devices"][0]["state"], "PRE-OP");

    // The image of its twin fixes it.
    let image = std::env::temp_dir().join(format!("yieldwall-desk-{}.sii", std::process::id()));
    let image = image.display().to_string();
    well(rig, &format!("sii read right --out {image}"));
    let mended = well(rig, &format!("sii write left {image} --yes"));
    assert!(mended["kept"].is_string(), "{mended:#}");
    std::fs::remove_file(&image).expect("it was written");
    assert_eq!(ask(rig, "sii check").0, OK);
    well(rig, "alias left 7 --yes");
    assert_eq!(well(rig, "alias left")["alias"], 7);
    assert_eq!(well(rig, "state all init")["devices"][1]["state"], "INIT");
    assert!(!devices.end().was_enabled());
}

/// While a rig runs nothing is sent; after its process was killed its devices show the watchdog, and are freed.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn beside_a_master_nothing_is_sent_and_after_it_died_the_devices_are_freed() {
    let slow = Slow::new("beside");
    let (devices, master) = slow.running();
    for line in ["scan", "reg read left", "state all init --take-over", "od write left max-torque 900"] {
        let (code, refused) = ask(&slow.rig, line);
        assert_eq!(code, BUS_UNAVAILABLE, "{line}: {refused:#}");
        let message = refused["diagnostics"][0]["message"].as_str().expect("why");
        assert!(message.contains(&format!("process {} (`", master.pid())), "{line}: {message}");
    }
    assert!(devices.seen().is_enabled());
    master.signal("KILL");
    assert!(devices.until(|| false, |seen| !seen.is_enabled()));
    drop(master);
    let left = well(&slow.rig, "state all");
    assert_eq!(left["devices"][0]["al_status_code"], 0x1b, "{left:#}");
    let freed = well(&slow.rig, "state all init");
    assert!(freed["devices"].as_array().expect("devices").iter().all(|device| device["state"] == "INIT"), "{freed:#}");
}
