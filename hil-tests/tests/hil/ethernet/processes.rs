//! The program against itself: `run` and `drill` on one end of the cable, devices at the other, and what becomes of the rig when one of
//! them dies, is stopped, or loses the cable.
//!
//! What is said about times is said on the clock of the devices.

use std::time::Duration;

use serde_json::Value;

use super::super::power_cycle::a_power_cycle_is_seen_and_no_word_is_taken_for_it;
use super::super::programs::*;
use super::super::shipped::no_command_leaves_torque;
use super::rigs::{NEAR, PERIOD_US, Slow};
use super::served::FAR;
use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::profiles::Fieldbus;

/// Five cycles, and a tick of 100 us by which the watchdog is coarser.
const WATCHED: Duration = Duration::from_micros(5 * PERIOD_US + 100);

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn devices_of_another_process_are_drilled_and_run() {
    let slow = Slow::new("sim");
    let attempt = || {
        let sim = slow.sim();
        let (code, drilled) = slow.drill().document();
        if code != OK {
            return Err(drilled);
        }
        let (code, document) = slow.run("3").document();
        sim.signal("INT");
        let (served, devices) = sim.document();
        if code == OK { Ok((drilled, document, served, devices)) } else { Err(document) }
    };
    let tries = std::iter::repeat_with(attempt).take(TRIES);
    let done = { tries }.find_map(|tried| tried.map_err(|late| println!("this computer was too late: {late:#}")).ok());
    let (drilled, document, served, devices) = done.expect("a computer that is in time once");
    let findings = drilled["watchdogs"]["findings"].as_array().expect("findings");
    assert_eq!(
        findings.iter().map(|finding| &finding["without"]).collect::<Vec<_>>(),
        ["outputs", "OP"],
        "{drilled:#}"
    );
    for finding in findings {
        // Outputs come on while a device is in SAFE-OP: it takes none, and the drive stops by itself.
        for side in ["left", "right"] {
            assert!(finding[format!("{side}_stops_after_ms")].is_number(), "{finding}");
            assert_ne!(finding[format!("{side}_stops_in")], "OperationEnabled", "{finding}");
        }
    }
    assert_eq!((&document["state"], &document["segment"]), (&"Running".into(), &Value::Array(vec![])), "{document:#}");
    assert_eq!(document["cycles"], 3_000_000 / PERIOD_US, "{document:#}");
    assert_eq!(served, OK, "{devices:#}");
    for drive in devices["drives"].as_array().expect("two") {
        assert_ne!(drive["state"], "OperationEnabled", "{devices:#}");
        assert_eq!(drive["torque_n_m"], 0.0, "{devices:#}");
    }
}

/// In lockstep, so that no computer is too slow: one joint goes by its angle, the other one holds, and nobody is at the handle.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_joint_of_another_process_is_moved_by_an_angle() {
    const RIG: &str = "builtin:paper-ethercat.yaml";
    let far = format!("main={FAR}");
    let sim = Running::ready(Running::start(&["sim", RIG, "--bus", &far, "--pace", "lockstep", "--no-hand"]));
    let jog = ["jog", RIG, "left", "--by", "-4deg", "--rate", "20deg", "--bus", NEAR, "--pace", "lockstep", "--json"];
    let (code, document) = Running::start(&jog).document();
    assert_eq!((code, &document["state"]), (OK, &"Running".into()), "{document:#}");
    let angle = |key: &str, joint: usize| document[key][joint].as_f64().expect("an angle").to_degrees();
    assert!((angle("to_rad", 0) - angle("from_rad", 0) + 4.0).abs() < 0.1, "{document:#}");
    assert!((angle("to_rad", 1) - angle("from_rad", 1)).abs() < 0.1, "{document:#}");
    sim.interrupted();
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn no_command_leaves_torque_on_a_segment_in_torque_mode() {
    no_command_leaves_torque(Fieldbus::Ethercat, OperationMode::CyclicTorque, NEAR, &format!("main={FAR}"));
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn no_command_leaves_torque_on_a_segment_in_velocity_mode() {
    no_command_leaves_torque(Fieldbus::Ethercat, OperationMode::CyclicVelocity, NEAR, &format!("main={FAR}"));
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn no_command_leaves_torque_on_a_segment_in_position_mode() {
    no_command_leaves_torque(Fieldbus::Ethercat, OperationMode::CyclicPosition, NEAR, &format!("main={FAR}"));
}

/// In lockstep: what the simulated machine of another process is made of is identified, and gains are proposed.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn joints_of_another_process_are_identified() {
    const RIG: &str = "builtin:paper-ethercat.yaml";
    let far = format!("main={FAR}");
    let sim = Running::ready(Running::start(&["sim", RIG, "--bus", &far, "--pace", "lockstep", "--no-hand"]));
    let tune = ["tune", "loop", RIG, "--bus", NEAR, "--pace", "lockstep", "--yes", "--json"];
    let (code, document) = Running::start(&tune).document();
    assert_eq!(code, OK, "{document:#}");
    for joint in 0..2 {
        let value = |key: &str| document["joints"][joint][key]["value"].as_f64().expect("a value");
        assert!((value("coulomb_n_m") / 10.0 - 1.0).abs() < 0.05, "{document:#}");
        assert!((value("delay_s") - 1e-3).abs() < 50e-6, "{document:#}");
    }
    assert!(document["proposal"]["gains"].as_array().is_some_and(|gains| gains.len() == 3), "{document:#}");
    sim.interrupted();
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_power_cycle_is_proved_by_the_station_address_that_is_lost() {
    const RIG: &str = "builtin:paper-ethercat.yaml";
    let far = format!("main={FAR}");
    let sim = || Running::ready(Running::start(&["sim", RIG, "--bus", &far, "--pace", "lockstep", "--no-hand"]));
    a_power_cycle_is_seen_and_no_word_is_taken_for_it(RIG, NEAR, sim);
}

/// In lockstep: what is wrong with a machine of another process is found in the first motion.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn an_encoder_of_another_process_that_counts_the_wrong_way_is_found() {
    const RIG: &str = "builtin:paper-ethercat.yaml";
    let far = format!("main={FAR}");
    let defect = ["--defect", "encoder-polarity:right"];
    let sim = ["sim", RIG, "--bus", &far, "--pace", "lockstep", "--no-hand"];
    let sim = Running::ready(Running::start(&[&sim[..], &defect].concat()));
    let commission = ["commission", RIG, "--bus", NEAR, "--pace", "lockstep", "--yes", "--from", "rotation", "--json"];
    let (code, document) = Running::start(&commission).document();
    assert_eq!((code, &document["verdict"]), (OUT_OF_TOLERANCE, &"fail".into()), "{document:#}");
    let steps = document["steps"].as_array().expect("steps");
    let failed: Vec<&Value> = steps.iter().filter(|step| step["verdict"] == "fail").collect();
    assert_eq!(failed.len(), 1, "{document:#}");
    assert_eq!(failed[0]["step"], "rotation", "{document:#}");
    let reason = failed[0]["reason"].as_str().expect("a reason");
    assert!(reason.contains("the joint of right moved opposite to its reference"), "{reason}");
    sim.interrupted();
}

/// Time waits for the frames, so that no computer is too slow for the shipped cycle of 1 ms; and the rig does what it does in the embedded
/// simulation.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_circle_is_held_in_lockstep_over_two_processes_as_on_the_embedded_simulation() {
    const RIG: &str = "builtin:paper-ethercat.yaml";
    let far = format!("main={FAR}");
    let sim = Running::ready(Running::start(&["sim", RIG, "--bus", &far, "--pace", "lockstep"]));
    let run = ["run", RIG, "--json", "--duration", "20"];
    let (code, document) = Running::start(&[&run[..], &["--bus", NEAR, "--pace", "lockstep"]].concat()).document();
    assert_eq!((code, &document["state"]), (OK, &"Running".into()), "{document:#}");
    assert_eq!((&document["cycles"], &document["skipped"]), (&20_000.into(), &0.into()), "{document:#}");
    assert_eq!((&document["segment"], &document["counted"]), (&serde_json::json!([]), &serde_json::json!({})));
    let served = sim.interrupted();
    // Two frames a cycle at least, and each goes back.
    let words: Vec<&str> =
        served.lines().find_map(|line| line.strip_prefix("served")).expect("counts").split(' ').collect();
    let counts: Vec<u64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    assert!(counts.len() == 2 && counts[0] == counts[1] && counts[0] > 40_000, "{served}");
    let (code, embedded) = Running::start(&run).document();
    assert_eq!(code, OK, "{embedded:#}");
    let measure = |document: &Value, name: &str| document["measures"][name].as_f64().expect("a number");
    for (name, apart) in [
        ("unintended_releases", 0.0),
        ("on_surface_fraction_when_pressed", 0.0),
        ("penetration_mm", 0.05),
        ("tool_rms_on_surface_mm", 0.05),
        ("peak_torque_n_m", 0.2),
    ] {
        let [two, one] = [&document, &embedded].map(|document| measure(document, name));
        println!("{name}: {two} over two processes, {one} in one");
        assert!((two - one).abs() <= apart, "{name}: {two} over two processes, {one} in one");
    }
    // The greatest penetration is that of an impact.
    assert!(measure(&document, "penetration_mm") > 1.0, "{document:#}");
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_rig_in_lockstep_refuses_devices_that_follow_the_wall() {
    let slow = Slow::new("pace");
    let far = format!("main={FAR}");
    let by_the_wall = Running::ready(Running::start(&["sim", &slow.rig, "--bus", &far]));
    let run = ["run", &slow.rig, "--bus", NEAR, "--json", "--duration", "1"];
    let (code, message, help) = refusal(Running::start(&[&run[..], &["--pace", "lockstep"]].concat()));
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    // Their clocks may be together by chance, and then they are asked.
    let (is_asked, is_apart) =
        ("follows the wall clock, and this rig runs in lockstep", "need the same `--pace` as this program");
    assert!(
        message.contains(is_asked) && help.contains("--pace lockstep") || message.contains(is_apart),
        "{message}; {help}"
    );
    drop(by_the_wall);
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_second_master_on_this_computer_is_refused_and_named_and_the_first_one_runs_on() {
    let slow = Slow::new("second");
    // A computer that stands still for a moment stops the first one, which is tried again then; a second master would be another fault.
    const LATE: [&str; 4] = ["pdo-missed", "pdo-late", "overrun", "stalled"];
    for attempt in 1..=TRIES {
        let (devices, first) = slow.running();
        for second in [slow.run("1"), slow.drill()] {
            let (code, message, _) = refusal(second);
            assert_eq!(code, BUS_UNAVAILABLE, "{message}");
            assert!(message.starts_with("a master is on this wire; nothing was sent"), "{message}");
            assert!(message.contains(&format!("process {} (`", first.pid())), "{message}");
        }
        first.signal("INT");
        let (code, document) = first.document();
        let was_enabled = devices
            .seen()
            .states
            .iter()
            .any(|(_, states)| states.contains(&yieldwall_drives::cia402::State::OperationEnabled));
        assert!(was_enabled && !devices.end().is_enabled());
        let is_late = LATE.contains(&document["cause"].as_str().unwrap_or_default());
        let goes_on = document["state"] == "Running" || (document["state"] == "Holding" && is_late);
        if code == INTERRUPTED && goes_on {
            return;
        }
        assert!(is_late && attempt < TRIES, "{document:#}");
    }
}

/// A master that is killed or stopped: its drives stop by the watchdog of their sync managers, counted from the last outputs that came.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_master_that_is_killed_or_stopped_leaves_drives_that_stop_by_themselves() {
    let slow = Slow::new("killed");
    for signal in ["KILL", "STOP"] {
        let (devices, master) = slow.running();
        master.signal(signal);
        assert!(devices.until(|| false, |seen| seen.stopped_at().iter().all(Option::is_some)));
        let seen = devices.seen();
        let (last, _) = seen.outputs.clone().expect("outputs came");
        let after = seen.stopped_at().map(|at| at.expect("it has stopped").since(last));
        println!("SIG{signal}: after the last outputs left stopped in {:?}, right in {:?}", after[0], after[1]);
        assert!(after.iter().all(|after| *after <= WATCHED), "SIG{signal}: {after:?}");
        if signal == "STOP" {
            // It finds them stopped, and does not enable them again.
            let frames = seen.states.len();
            master.signal("CONT");
            let (code, document) = master.document();
            assert!([SAFETY_STOP, DEVICE_FAULT, TIMING_MISSED].contains(&code), "{document:#}");
            let seen = devices.end();
            assert!(
                !seen.states[frames..]
                    .iter()
                    .any(|(_, states)| states.contains(&yieldwall_drives::cia402::State::OperationEnabled))
            );
        } else {
            drop((master, devices));
        }
    }
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn rigs_that_were_killed_come_up_again() {
    let slow = Slow::new("again");
    let (devices, master) = slow.running();
    master.signal("KILL");
    drop(master);
    assert!(devices.until(|| false, |seen| seen.stopped_at().iter().all(Option::is_some)));
    let run = || Running::start(&["run", &slow.rig, "--bus", NEAR, "--json", "--ignore-latency", "--duration", "1"]);
    let (code, document) = (0..TRIES).map(|_| run().document()).find(|(code, _)| *code == OK).expect("in time once");
    assert_eq!((code, &document["state"]), (OK, &"Running".into()), "{document:#}");
    drop(devices);
}
