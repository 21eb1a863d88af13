//! On the clock of the wall, at a cycle so slow that any computer keeps it: 50 ms too late is in time. How a computer keeps a
//! faster one is measured by `hil-tests/circle` and by `yieldwall latency`.

use std::path::Path;
use std::time::Duration;
use yieldwall::run::Pace;

use serde_json::Value;

use super::programs::*;

/// The rig every 100 ms, and a hand that rests: at this cycle nobody could be guided.
pub(super) fn slow() -> (String, String) {
    let scene =
        changed("rests", "scenes/circle-hold.yaml", &[("in_s: 1.5}              # hits", "in_s: 900.0} # hits")]);
    let rig = changed(
        "slow",
        "paper-admittance-5ms.yaml",
        &[
            ("period_us: 5000", "period_us: 100000"),
            ("compute_at_us: 2500", "compute_at_us: 50000"),
            ("_ms: 100", "_ms: 200"),
        ],
    );
    (rig, scene)
}

fn sim(rig: &str, scene: &str, arguments: &[&str]) -> Running {
    Running::sim(rig, &[&["--scene", scene], arguments].concat())
}

/// An exit code and what else there is of a program that this computer was in time for: if it stood still meanwhile, it is
/// tried again.
fn in_time<T>(what: impl Fn() -> (i32, T)) -> (i32, T) {
    let tries = std::iter::repeat_with(&what).take(TRIES - 1);
    { tries }.find(|(code, _)| *code != TIMING_MISSED).unwrap_or_else(what)
}

fn drill(rig: &str) -> (i32, Value) {
    in_time(|| Running::start(&["drill", rig, "--bus", &bus(), "--json"]).document())
}

/// Measures this computer at 1 ms for as many cycles as show tier B. At 100 ms it has that tier if it wakes up within 50 ms.
fn measure(state: Option<&Path>) {
    let arguments = ["latency", "--duration", "4", "--json"];
    let (code, document) = in_time(|| match state {
        Some(state) => Running::start_with(state, &arguments).document(),
        None => Running::start(&arguments).document(),
    });
    assert_eq!((code, document["record"].is_string()), (OK, true), "{document:#}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_load_is_told_stopped_and_on_record_also_after_an_interrupt() {
    let state = std::env::temp_dir().join(format!("yieldwall-loaded-{}", std::process::id()));
    let bus = bus();
    let load = ["latency", "--bus", &bus, "--load", "--period-us", "100000"];
    let (code, document) =
        Running::start_with(&state, &[&load[..], &["--duration", "1", "--json"]].concat()).document();
    assert_eq!(code, OK, "{document:#}");
    assert!(document["load"].as_str().is_some_and(|load| load.contains("threads of arithmetic")), "{document:#}");
    assert!(document["stamps"]["kernel"].as_u64().is_some_and(|count| count > 0), "{document:#}");
    assert!(
        document["adapter"].as_str().is_some_and(|told| told.starts_with("virtual, driver unknown")),
        "{document:#}"
    );
    let record = || std::fs::read_to_string(document["record"].as_str().expect("a path")).expect("it was kept");
    assert!(record().contains("threads of arithmetic"), "{}", record());

    let measuring = Running::start_with(&state, &[&load[..], &["--duration", "600"]].concat());
    std::thread::sleep(Duration::from_secs(2));
    let said = measuring.interrupted();
    let at = |text: &str| said.find(text).unwrap_or_else(|| panic!("no `{text}` in {said}"));
    assert!(at("load      started: ") < at("load      stopped") && at("load      stopped") < at("tier "), "{said}");
    // Nothing is left but the record.
    let left: Vec<_> = std::fs::read_dir(state.join("yieldwall/latency")).expect("a folder").collect();
    assert_eq!(left.len(), 1, "{left:?}");
    std::fs::remove_dir_all(state).expect("it is there");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_computer_that_nobody_has_measured_is_refused_unless_a_person_says_otherwise() {
    let (rig, scene) = slow();
    let devices = sim(&rig, &scene, &[]);
    let state = std::env::temp_dir().join(format!("yieldwall-unmeasured-{}", std::process::id()));
    let bus = bus();
    let run = |also: &[&str]| {
        refusal(Running::start_with(
            &state,
            &[&["run", &rig, "--bus", &bus, "--json", "--duration", "1"], also].concat(),
        ))
    };
    let observer = Observer::new();
    let (code, message, help) = run(&[]);
    assert_eq!(code, TIMING_MISSED, "{message}");
    assert!(message.contains("no measured wake-up latency"), "{message}");
    assert!(help.contains("nothing was sent; `yieldwall latency --period-us 100000"), "{help}");
    assert!(observer.rest().iter().all(|frame| frame.id() != 0x000), "no NMT command");
    // What comes next is the drill, which these drives have not passed with these records.
    let (code, message, _) = run(&["--ignore-latency"]);
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    measure(Some(&state));
    let (code, message, _) = run(&[]);
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    assert!(message.contains("no watchdog drill is on record"), "{message}");
    drop(devices);
    std::fs::remove_dir_all(state).expect("it is there");
    std::fs::remove_file(rig).expect("it is there");
    std::fs::remove_file(scene).expect("it is there");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_hold_what_they_held_after_every_signal_and_after_a_kill() {
    let (rig, scene) = slow();
    let devices = sim(&rig, &scene, &["--no-hand"]);
    // What process data carry stays as it was last.
    super::killed::what_the_drives_held_is_given_back(&rig, &bus(), &["6040h", "607Ah", "6071h"]);
    drop(devices);
    std::fs::remove_file(rig).expect("it is there");
    std::fs::remove_file(scene).expect("it is there");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_drilled_rig_runs_alone_on_its_bus_and_one_that_stalls_is_lost() {
    let (rig, scene) = slow();
    let devices = sim(&rig, &scene, &[]);
    let (code, document) = drill(&rig);
    assert_eq!(code, OK, "{document:#}");
    for finding in document["watchdogs"]["findings"].as_array().expect("findings") {
        assert!(finding["left_stops_after_ms"].is_number() && finding["right_stops_after_ms"].is_number(), "{finding}");
    }
    measure(None);
    let (code, (document, frames)) = in_time(|| {
        let observer = Observer::new();
        let (code, document) = Running::run(&rig, &["--duration", "2"]).document();
        let code = if code == OK && document["skipped"] != 0 { TIMING_MISSED } else { code };
        (code, (document, observer.rest()))
    });
    assert_eq!((code, &document["state"]), (OK, &"Running".into()), "{document:#}");
    assert!(document["timing"]["tier"].is_string(), "{document:#}");
    assert_eq!((&document["cycles"], &document["skipped"]), (&20.into(), &0.into()), "{document:#}");
    assert_stopped_together(&frames);
    as_a_library(&rig);
    twice(&rig, &scene);
    if bus() == "vcan0" {
        stall(&rig);
    }
    drop(devices);
    std::fs::remove_file(rig).expect("it is there");
    std::fs::remove_file(scene).expect("it is there");
}

/// A program of others that calls the library runs the same rig by the same records.
fn as_a_library(rig: &str) {
    let run = || Running::example("rig_on_bus", &[rig, &bus(), "2"]).end();
    let tries = std::iter::repeat_with(run).take(TRIES - 1);
    let (code, said, error) = { tries }.find(|(code, ..)| *code == OK).unwrap_or_else(run);
    assert!(code == OK && said.contains("20 cycles"), "{said}\n{error}");
}

/// Every device is there twice. In lockstep nobody would wait for the second one.
fn twice(rig: &str, scene: &str) {
    let others = Doubles::start(rig, Some(scene), Pace::Free);
    assert_duplicates_are_refused(|| Running::run(rig, &["--duration", "1"]));
    drop(others);
}

/// The queue of the interface stalls for two cycles and a half and is released then: what it lets go is of one cycle, and the
/// bus is lost.
fn stall(rig: &str) {
    let observer = Observer::new();
    let master = Running::run(rig, &["--duration", "60"]);
    observer.until_moving(5);
    observer.take();
    let stalled = PutBack::delayed(&bus(), "250ms");
    let (code, document) = master.document();
    drop(stalled);
    let frames = observer.rest();
    assert_eq!((code, &document["state"]), (SAFETY_STOP, &"Lost".into()), "{document:#}");
    assert_eq!(document["cause"], "transmit-stalled", "{document:#}");
    let syncs = frames.iter().filter(|frame| frame.id() == 0x080).count();
    let words = set_points(&frames).count();
    assert!(words <= 2 * (syncs + 1), "{words} set-points after {syncs} SYNC");
    let last = frames.iter().rposition(|frame| frame.id() == 0x080).map_or(0, |at| at + 1);
    // What stops the drives may follow it; it moves nothing.
    let words: Vec<u8> = set_points(&frames[last..]).collect();
    println!("after the last SYNC: {words:02x?}");
    assert!(
        words.iter().filter(|word| **word == 0x0f).count() <= 2,
        "more commands to move than of one cycle: {words:02x?}"
    );
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_that_lack_a_watchdog_are_refused() {
    let (rig, scene) = slow();
    let devices = sim(&rig, &scene, &["--unwatched", "heartbeat"]);
    let (code, document) = drill(&rig);
    assert_eq!(code, OUT_OF_TOLERANCE, "{document:#}");
    measure(None);
    let observer = Observer::new();
    let (code, document) = Running::run(&rig, &["--duration", "1"]).document();
    assert_eq!(code, OUT_OF_TOLERANCE, "{document:#}");
    assert!(document.to_string().contains("heartbeat"), "{document:#}");
    assert!(!is_enabled(&observer.rest()));
    drop(devices);
    std::fs::remove_file(rig).expect("it is there");
    std::fs::remove_file(scene).expect("it is there");
}

/// In lockstep time waits with the frames: whatever a queue does to them, nothing is lost and nothing happens twice.
#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_queue_that_stalls_for_20_ms_stops_time_in_lockstep() {
    if bus() != "vcan0" {
        return;
    }
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("8");
    observer.until_moving(300);
    let stalled = PutBack::delayed(&bus(), "20ms");
    std::thread::sleep(Duration::from_millis(500));
    drop(stalled);
    let (code, document) = master.document();
    assert_eq!((code, &document["cycles"], &document["state"]), (OK, &8000.into(), &"Running".into()), "{document:#}");
    assert_eq!((&document["frames"]["lost"], &document["frames"]["not_sent"]), (&0.into(), &0.into()), "{document:#}");
    let (frames, times) = observer.rest_with_times();
    assert_stopped_together(&frames);
    // The queue has met a running rig.
    let syncs: Vec<_> = frames.iter().zip(times).filter(|(frame, _)| frame.id() == 0x080).map(|(_, at)| at).collect();
    let stalls = syncs.windows(2).filter(|pair| pair[1].since(pair[0]) >= Duration::from_millis(20)).count();
    assert!(stalls >= 5, "{stalls} cycles of 20 ms or more");
    drop(sim);
}
