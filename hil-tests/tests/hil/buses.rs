//! A rig on two interfaces: two CAN buses, or a segment and a CAN bus.

use serde_json::Value;
use yieldwall::canopen::cob;

use super::programs::*;

const TWO_BUSES: &str = "builtin:paper-admittance-two-buses.yaml";
const INTERFACES: [&str; 4] = ["--bus", "main=vcan0", "--bus", "sensor=vcan1"];

fn sim() -> Running {
    Running::ready(Running::start(&[&["sim", TWO_BUSES, "--pace", "lockstep"], &INTERFACES[..]].concat()))
}

fn run(arguments: &[&str]) -> Running {
    Running::start(&[&["run", TWO_BUSES, "--pace", "lockstep", "--json"], &INTERFACES[..], arguments].concat())
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_rig_on_two_interfaces_runs_and_its_log_names_both() {
    if bus() != "vcan0" {
        return;
    }
    let sim = sim();
    let log = std::env::temp_dir().join(format!("yieldwall-two-buses-{}.log", std::process::id()));
    let [drives, sensor] = ["vcan0", "vcan1"].map(Observer::on);
    let (code, document) = run(&["--duration", "3", "--candump", log.to_str().expect("a plain path")]).document();
    assert_eq!((code, &document["state"]), (OK, &Value::from("Running")), "{document:#}");
    assert_eq!((&document["frames"]["lost"], &document["frames"]["not_sent"]), (&0.into(), &0.into()), "{document:#}");
    assert_eq!(document["buses"]["sensor"], "vcan1", "{document:#}");
    let [drives, sensor] = [drives, sensor].map(Observer::rest);
    let count = |frames: &[yieldwall::canopen::Frame], id: u16| frames.iter().filter(|frame| frame.id() == id).count();
    let syncs = count(&drives, cob::SYNC);
    assert!(syncs > 3000 && count(&sensor, cob::SYNC) == syncs, "one SYNC a cycle on both");
    // Node 1 is the left drive on one bus and the sensor on the other.
    assert!(drives.iter().all(|frame| frame.id() != 0x181 || frame.len() == 6));
    assert!(sensor.iter().all(|frame| frame.id() != 0x181 || frame.len() == 8));
    assert_eq!((count(&sensor, 0x201), count(&drives, 0x281)), (0, 0));
    assert_stopped_together(&drives);
    // The program's own log has what the observers have, its own requests included.
    let text = std::fs::read_to_string(&log).expect("a log");
    std::fs::remove_file(&log).expect("it is there");
    let lines = |what: &str| text.lines().filter(|line| line.contains(what)).count();
    assert_eq!((lines(" vcan0 080#"), lines(" vcan1 080#")), (syncs, syncs));
    for (frames, interface, id) in [(&drives, "vcan0", 0x601), (&drives, "vcan0", 0x602), (&sensor, "vcan1", 0x601)] {
        let requests = count(frames, id);
        assert!(requests > 10 && lines(&format!(" {interface} {id:03X}#")) == requests, "{interface} {id:03X}h");
    }
    sim.interrupted();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn one_interface_that_is_taken_down_stops_the_axes_on_the_other() {
    if bus() != "vcan0" {
        return;
    }
    for interface in ["vcan1", "vcan0"] {
        let sim = sim();
        let observer = Observer::on("vcan0");
        let master = run(&["--duration", "60"]);
        observer.until_moving(300);
        let down = PutBack::down(interface);
        let (code, document) = master.document();
        drop(down);
        assert_eq!(code, SAFETY_STOP, "{document:#}");
        assert_eq!((&document["cause"], &document["state"]), (&"link-down".into(), &"Lost".into()), "{document:#}");
        let bus = if interface == "vcan1" { "sensor" } else { "main" };
        assert_eq!(document["cause_devices"], format!("interface of bus `{bus}`"), "{document:#}");
        if interface == "vcan1" {
            // Nothing was said any more, and both drives have stopped by themselves.
            observer.until("emergency of both drives", |frames| {
                [1, 2].iter().all(|node| !emergencies(frames, *node).is_empty())
            });
        }
        drop(sim);
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_bus_without_an_interface_is_named() {
    let (code, message, help) = refusal(Running::start(&["run", TWO_BUSES, "--bus", "main=vcan0", "--json"]));
    assert_eq!((code, message.as_str()), (2, "the rig's bus `sensor` has no interface"));
    assert!(help.contains("--bus main=INTERFACE --bus sensor=INTERFACE"), "{help}");
}

/// Drives on EtherCAT, the sensor on CAN: one process serves both, and one is master of both.
const SEGMENT_AND_CAN: &str = "builtin:paper-ethercat-can-sensor.yaml";

fn mixed_sim() -> Running {
    let bus = ["--bus", "main=veth1", "--bus", "sensor=vcan0"];
    Running::ready(Running::start(&[&["sim", SEGMENT_AND_CAN, "--pace", "lockstep"], &bus[..]].concat()))
}

fn mixed_run(seconds: &str) -> Running {
    let bus = ["--bus", "main=veth0", "--bus", "sensor=vcan0"];
    let run = ["run", SEGMENT_AND_CAN, "--pace", "lockstep", "--json", "--duration", seconds];
    Running::start(&[&run[..], &bus[..]].concat())
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_rig_on_a_segment_and_a_can_bus_holds_the_circle_over_two_processes() {
    if bus() != "vcan0" {
        return;
    }
    let sim = mixed_sim();
    let observer = Observer::on("vcan0");
    let (code, document) = mixed_run("5").document();
    assert_eq!((code, &document["state"]), (OK, &Value::from("Running")), "{document:#}");
    assert_eq!((&document["cycles"], &document["segment"]), (&5000.into(), &serde_json::json!([])), "{document:#}");
    assert_eq!((&document["frames"]["lost"], &document["frames"]["not_sent"]), (&0.into(), &0.into()), "{document:#}");
    assert_eq!((&document["buses"]["main"], &document["buses"]["sensor"]), (&"veth0".into(), &"vcan0".into()));
    let measures = &document["measures"];
    assert_eq!(measures["unintended_releases"], 0, "{measures:#}");
    assert_eq!(measures["on_surface_fraction_when_pressed"], 1.0, "{measures:#}");
    // A sample a cycle, as old as the frame that brings it.
    assert!(measures["force_age_max_ms"].as_f64().is_some_and(|age| age < 1.0), "{measures:#}");
    let frames = observer.rest();
    let count = |id: u16| frames.iter().filter(|frame| frame.id() == id).count();
    assert!(count(cob::SYNC) > 5000, "{} SYNC", count(cob::SYNC));
    assert_eq!(count(cob::SYNC), count(0x18a), "one sample for each SYNC");
    let served = sim.interrupted();
    assert!(served.contains(&format!("; {} SYNC, ", count(cob::SYNC))), "{served}");
}

/// What goes wrong on one bus stops the axes on the other.
#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_can_interface_that_is_taken_down_stops_the_axes_on_the_segment() {
    if bus() != "vcan0" {
        return;
    }
    let sim = mixed_sim();
    let observer = Observer::on("vcan0");
    let master = mixed_run("60");
    observer.until("cycles", |frames| frames.iter().filter(|frame| frame.id() == cob::SYNC).count() > 2000);
    let down = PutBack::down("vcan0");
    let (code, document) = master.document();
    drop((down, observer));
    assert_eq!((code, &document["cause"]), (SAFETY_STOP, &"link-down".into()), "{document:#}");
    assert_eq!(document["cause_devices"], "interface of bus `sensor`", "{document:#}");
    let served = sim.interrupted();
    assert!(served.contains("SYNC"), "{served}");
}
