//! Drives with incremental encoders: no rig runs with them before they were homed.

use super::programs::*;

const INCREMENTAL: &str = "builtin:paper-incremental.yaml";

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_that_were_not_homed_are_not_run_and_those_that_were_are() {
    let bus = bus();
    let sim = Running::sim(INCREMENTAL, &["--pace", "lockstep", "--no-hand"]);
    let observer = Observer::new();
    let run = || Running::run(INCREMENTAL, &["--pace", "lockstep", "--duration", "0.5"]);
    let (code, message, help) = refusal(run());
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    assert!(message.contains("it was not homed since it was switched on"), "{message}");
    assert!(help.contains("`yieldwall home RIG.yaml`"), "{help}");
    assert!(!is_enabled(&observer.rest()));
    let home = Running::start(&["home", INCREMENTAL, "--bus", &bus, "--pace", "lockstep", "--json"]);
    let (code, document) = home.document();
    assert_eq!(code, OK, "{document:#}");
    for joint in document["joints"].as_array().expect("both") {
        assert_eq!((&joint["homed"], &joint["referenced"]), (&true.into(), &true.into()), "{document:#}");
        let off = joint["angle_rad"].as_f64().expect("a number") - joint["home_rad"].as_f64().expect("a number");
        assert!(off.abs() < 0.01, "{document:#}");
    }
    let (code, document) = run().document();
    assert_eq!(code, OK, "{document:#}");
    drop(sim);
}
