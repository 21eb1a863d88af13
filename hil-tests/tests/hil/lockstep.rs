//! Two programs in lockstep that do not fit together, or that somebody else disturbs: what they say.

use yieldwall::canopen::Frame;
use yieldwall::link::{CanLink, SocketCanSettings};
use yieldwall::run::Pace;

use super::power_cycle::a_power_cycle_is_seen_and_no_word_is_taken_for_it;
use super::programs::*;
use hil_tests::network::Real;

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn devices_that_are_there_twice_are_refused_before_a_drive_is_enabled() {
    let devices = (lockstep(RIG), Doubles::start(RIG, None, Pace::Lockstep));
    assert_duplicates_are_refused(|| run_for("1"));
    drop(devices);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_that_lack_a_watchdog_are_refused_with_the_reason() {
    let sim = Running::sim(RIG, &["--pace", "lockstep", "--unwatched", "heartbeat"]);
    let observer = Observer::new();
    let (code, message, help) = refusal(run_for("1"));
    assert_eq!(code, OUT_OF_TOLERANCE, "{message}");
    assert!(message.contains("does not stop without heartbeat"), "{message}");
    assert!(help.contains("--unwatched"), "{help}");
    assert!(!is_enabled(&observer.rest()));
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_power_cycle_is_proved_by_the_boot_up() {
    let sim = || Running::sim(RIG, &["--pace", "lockstep", "--no-hand"]);
    a_power_cycle_is_seen_and_no_word_is_taken_for_it(RIG, &bus(), sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn devices_of_another_pace_are_named() {
    let observer = Observer::new();
    let by_the_wall = Running::sim(RIG, &[]);
    let (code, message, help) = refusal(run_for("1"));
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    assert!(message.contains("follows the wall clock, and this rig runs in lockstep"), "{message}");
    assert!(help.contains("--pace lockstep"), "{help}");
    drop(by_the_wall);
    let in_lockstep = lockstep(RIG);
    let (code, message, help) = refusal(Running::run(RIG, &["--duration", "1", "--ignore-latency"]));
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    assert!(message.contains("runs in lockstep, and this rig follows the wall clock"), "{message}");
    assert!(help.contains("--pace free"), "{help}");
    drop(in_lockstep);
    assert!(!is_enabled(&observer.rest()));
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn an_emergency_is_told_with_its_node_its_code_and_its_meaning() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    let mut stranger = Real::open(&SocketCanSettings::everything(&bus()));
    stranger.send(&Frame::new(0x081, &[0x43, 0x50, 0x21, 1, 2, 3, 4, 5])).expect("the interface is up");
    let (code, document) = master.document();
    assert_eq!((code, &document["cause"]), (SAFETY_STOP, &"emergency".into()), "{document:#}");
    let first = &document["emergencies"][0];
    assert_eq!((&first["node_id"], &first["code"], &first["name"]), (&1.into(), &"5043h".into(), &"left".into()));
    let told = document["diagnostics"].to_string();
    assert!(told.contains("node 1 (left): 5043h device hardware"), "{told}");
    drop((observer, sim));
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_log_has_the_last_frames_of_the_master() {
    let sim = lockstep(RIG);
    let path = std::env::temp_dir().join(format!("yieldwall-last-{}.log", std::process::id()));
    let log = path.to_str().expect("a plain path");
    let observer = Observer::new();
    let (code, document) = Running::run(RIG, &["--pace", "lockstep", "--duration", "1", "--candump", log]).document();
    assert_eq!(code, OK, "{document:#}");
    let frames = observer.rest();
    let text = std::fs::read_to_string(&path).expect("the log");
    std::fs::remove_file(&path).expect("it is there");
    for id in [0x000, 0x080, 0x201, 0x202, 0x77f] {
        let seen = frames.iter().filter(|frame| frame.id() == id).count();
        let logged = text.lines().filter(|line| line.contains(&format!(" {id:03X}#"))).count();
        assert_eq!(logged, seen, "{id:03X}h");
    }
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_device_that_cannot_be_attached_and_one_that_is_left_say_why() {
    let socket = std::env::temp_dir().join(format!("yieldwall-attach-{}.sock", std::process::id()));
    let _ = std::fs::remove_file(&socket);
    let socket = socket.to_str().expect("a plain path");
    let bus = bus();
    let attach =
        |node: &str| ["sim", RIG, "--bus", &bus, "--json", "--nodes", node, "--attach", socket].map(str::to_owned);
    let start = |arguments: [String; 9]| Running::start(&arguments.each_ref().map(String::as_str));
    let (code, message, help) = refusal(start(attach("right")));
    assert_eq!(code, 2, "{message}");
    assert!(message.contains("no process with the arm is at this socket"), "{message}");
    assert!(help.contains("--plant first"), "{help}");
    let nowhere = ["sim", RIG, "--bus", &bus, "--json", "--nodes", "left", "--plant", "/no/dir/x"];
    let (code, message, help) = refusal(Running::start(&nowhere));
    assert_eq!(code, 2, "{message}");
    assert!(message.contains("--plant /no/dir/x") && help.contains("a folder that is there"), "{message}: {help}");

    let plant = Running::sim(RIG, &["--pace", "lockstep", "--nodes", "left", "--plant", socket]);
    let (code, message, _) = refusal(start(attach("left")));
    assert_eq!(code, BUS_UNAVAILABLE, "{message}");
    assert!(message.contains("node 1 is on this bus; nothing was sent"), "{message}");
    if bus == "vcan0" {
        // On another bus nobody has the node id, and yet the arm has the device.
        let elsewhere = attach("left").map(|word| if word == bus { "vcan1".to_owned() } else { word });
        let (code, message, help) = refusal(start(elsewhere));
        assert_eq!(code, 2, "{message}");
        assert!(message.contains("did not take this device in"), "{message}");
        assert!(help.contains("--nodes"), "{help}");
    }
    // One that is served: the arm calls it while time follows the wall.
    let right = start(attach("right"));
    let wrist = Running::sim(RIG, &["--nodes", "wrist", "--attach", socket]);
    let (code, document) = run_for("1").document();
    assert_eq!(code, OK, "{document:#}");
    plant.interrupted();
    let (code, message, help) = refusal(right);
    assert_eq!(code, BUS_UNAVAILABLE, "{message}");
    assert!(message.contains("the process with the arm has ended"), "{message}");
    assert!(help.contains("--plant again"), "{help}");
    drop(wrist);
    let _ = std::fs::remove_file(socket);
}
