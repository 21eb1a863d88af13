//! The program against itself: `yieldwall run --bus` and `yieldwall sim` as processes of their own, and what becomes of the
//! rig when one of them dies, is stopped, or loses the bus.
//!
//! An observer on the bus sees what the master sends and what the drives say. Simulated time is that of lockstep, so that no
//! computer is too slow; what is said about order, counts and states holds at any speed.

use std::collections::BTreeSet;
use std::process::Command;

use hil_tests::Scenario;
use hil_tests::network::Real;
use serde_json::Value;
use yieldwall::canopen::{Frame, cob};
use yieldwall::link::CandumpWriter;
use yieldwall::link::{CanLink, SocketCanSettings};

use super::programs::*;
use super::wall_clock::slow;

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_circle_is_held_in_lockstep_over_two_processes() {
    let sim = Running::sim(RIG, &["--pace", "lockstep", "--scene", "builtin:scenes/circle-hold.yaml"]);
    // Onto the circle, off it and round it; `hil-tests/circle` goes on for a minute.
    let (code, document) = run_for("20").document();
    assert_eq!(code, OK, "{document:#}");
    assert_eq!((&document["cycles"], &document["state"]), (&Value::from(20_000), &Value::from("Running")));
    assert_eq!((&document["frames"]["lost"], &document["frames"]["not_sent"]), (&Value::from(0), &Value::from(0)));
    let measures = &document["measures"];
    assert_eq!(measures["unintended_releases"], 0, "{measures:#}");
    assert_eq!(measures["on_surface_fraction_when_pressed"], 1.0, "{measures:#}");
    assert!(measures["tool_max_on_surface_mm"].as_f64().is_some_and(|most| most < 1.0), "{measures:#}");
    // Every cycle is a SYNC that the devices took part in.
    let served = sim.interrupted();
    assert!(served.contains("SYNC"), "{served}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_that_take_their_time_to_reset_or_to_answer_are_waited_for() {
    for slow in [["--reset-ms", "700"], ["--reset-ms", "3000"], ["--sdo-ms", "600"]] {
        let sim = Running::sim(RIG, &[&["--pace", "lockstep"], &slow[..]].concat());
        let (code, document) = run_for("1").document();
        assert_eq!((code, &document["state"]), (OK, &Value::from("Running")), "{slow:?}: {document:#}");
        drop(sim);
    }
    // Longer than the rig allows; and a person who does not wait for it.
    let sim = Running::sim(RIG, &["--pace", "lockstep", "--reset-ms", "30000"]);
    let impatient = changed(
        "impatient",
        "paper-admittance.yaml",
        &[("  - name: left\n", "  - name: left\n    waits: {boot_up_ms: 800}\n")],
    );
    let (code, message, _) = refusal(Running::run(&impatient, &["--pace", "lockstep"]));
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(message.contains("node 1 (left)") && message.contains("within 800 ms"), "{message}");
    let observer = Observer::new();
    let master = run_for("1");
    observer.until("reset", |frames| frames.iter().any(|frame| frame.id() == cob::NMT));
    master.signal("INT");
    let (code, message, _) = refusal(master);
    assert_eq!(code, INTERRUPTED, "{message}");
    drop(sim);
    std::fs::remove_file(impatient).expect("it is there");
}

/// What a recorded run in lockstep has from the begin of its scene on: counts of the sensor, and the proxy.
fn recorded(rig: &str, name: &str) -> Vec<String> {
    let folder = std::env::temp_dir().join(format!("yieldwall-lockstep-{name}-{}", std::process::id()));
    let sim = lockstep(rig);
    let path = folder.to_str().expect("a plain path");
    let arguments = ["--pace", "lockstep", "--duration", "3", "--record", path];
    let (code, document) = Running::run(rig, &arguments).document();
    assert_eq!((code, &document["state"]), (OK, &Value::from("Running")), "{document:#}");
    drop(sim);
    let text = std::fs::read_to_string(folder.join("cycles.csv")).expect("a recording");
    std::fs::remove_dir_all(folder).expect("it is there");
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let head = lines.next().expect("names");
    let column = |name: &str| head.iter().position(|field| *field == name).expect("a field");
    let scene = column("scene_time_s");
    let wanted = ["has_sample", "sample_fx_counts", "sample_fy_counts", "proxy_x_m", "proxy_y_m"].map(column);
    let in_scene = lines.filter(|line| line[scene].parse::<f64>().is_ok_and(|time| time >= 0.0));
    in_scene.map(|line| wanted.map(|column| line[column]).join(",")).collect()
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn in_lockstep_sensors_on_plain_can_give_the_same_run_again() {
    for rig in ["paper-admittance-streaming.yaml", "paper-admittance-polled.yaml"] {
        let rig = format!("builtin:{rig}");
        let (one, other) = (recorded(&rig, "one"), recorded(&rig, "other"));
        assert!(one.len() >= 3000, "{rig}: {} cycles", one.len());
        let apart = one.iter().zip(&other).position(|(one, other)| one != other);
        assert_eq!((apart, one.len()), (None, other.len()), "{rig}");
        // Rows that are alike because nothing happens would prove nothing.
        assert!(one.iter().collect::<std::collections::BTreeSet<_>>().len() > 1000, "{rig}");
    }
}

/// The sensor is a log that `canplayer` replays in a ring: the rig runs on what was felt then.
#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_rig_runs_on_a_sensor_stream_that_canplayer_replays() {
    let rig = "builtin:paper-admittance-streaming.yaml";
    let folder = std::env::temp_dir().join(format!("yieldwall-replayed-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("the folder for temporary files can be written");
    let path = |name: &str| folder.join(name).to_str().expect("a plain path").to_owned();
    let (socket, log, recording) = (path("plant.sock"), path("stream.log"), path("run"));
    let session = Scenario::shipped("paper-admittance-streaming.yaml").run(3000);
    let of_sensor = session.recording().frames.into_iter().filter(|seen| [0x360, 0x361].contains(&seen.frame.id()));
    let mut writer = CandumpWriter::new(Vec::new(), ["can0"]);
    let mut felt = BTreeSet::new();
    for seen in of_sensor {
        writer.record(seen.time, &seen.frame).expect("memory");
        if let [_, high, low, ..] = *seen.frame.data()
            && seen.frame.id() == 0x360
        {
            felt.insert(i16::from_be_bytes([high, low]));
        }
    }
    std::fs::write(&log, writer.finish().expect("memory")).expect("the folder is there");
    let sim = Running::sim(rig, &["--pace", "lockstep", "--nodes", "left,right", "--plant", &socket]);
    let bus = bus();
    let player = Command::new("canplayer").args(["-l", "i", "-I", &log, &format!("{bus}=can0")]).spawn();
    let player = Running::of(player.expect("can-utils is installed"));
    let arguments = ["--pace", "lockstep", "--duration", "3", "--record", &recording];
    let (code, document) = Running::run(rig, &arguments).document();
    assert_eq!((code, &document["state"]), (OK, &Value::from("Running")), "{document:#}");
    drop((player, sim));
    let text = std::fs::read_to_string(format!("{recording}/cycles.csv")).expect("a recording");
    std::fs::remove_dir_all(folder).expect("it is there");
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let head = lines.next().expect("names");
    let [is_new, force] = ["has_sample", "sample_fx_counts"].map(|name| head.iter().position(|field| *field == name));
    let taken: Vec<i16> = lines
        .filter(|line| line[is_new.expect("a field")] == "1")
        .map(|line| line[force.expect("a field")].parse().expect("counts"))
        .collect();
    assert!(taken.len() > 1000, "{} samples", taken.len());
    assert!(taken.iter().all(|counts| felt.contains(counts)), "samples that nobody replayed");
    assert!(taken.iter().collect::<BTreeSet<_>>().len() > 100, "a stream that says nothing");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn devices_in_three_processes_share_one_arm_and_one_that_dies_stops_the_rig() {
    let socket = std::env::temp_dir().join(format!("yieldwall-plant-{}.sock", std::process::id()));
    // One that an earlier run left, which was killed.
    let _ = std::fs::remove_file(&socket);
    let socket = socket.to_str().expect("a plain path");
    let plant = Running::sim(RIG, &["--pace", "lockstep", "--nodes", "left", "--plant", socket]);
    let right = Running::sim(RIG, &["--nodes", "right", "--attach", socket]);
    let wrist = Running::sim(RIG, &["--nodes", "wrist", "--attach", socket]);
    let (code, document) = run_for("1.5").document();
    assert_eq!((code, &document["state"]), (OK, &Value::from("Running")), "{document:#}");

    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    right.signal("KILL");
    let (code, document) = master.document();
    assert_eq!(code, SAFETY_STOP, "{document:#}");
    assert_eq!((&document["cause"], &document["state"]), (&Value::from("pdo-missed"), &Value::from("Stopped")));
    assert_stopped_together(&observer.rest());

    // Without torque on one side the hand may have led the arm where it cannot go: a new one. Who is missed is named, and can
    // be put back.
    drop((plant, right, wrist));
    let _ = std::fs::remove_file(socket);
    let plant = Running::sim(RIG, &["--pace", "lockstep", "--nodes", "left", "--plant", socket]);
    let wrist = Running::sim(RIG, &["--nodes", "wrist", "--attach", socket]);
    let (code, document) = run_for("1").document();
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(document.to_string().contains("node 2 (right)"), "{document:#}");
    let right = Running::sim(RIG, &["--nodes", "right", "--attach", socket]);
    let (code, document) = run_for("1").document();
    assert_eq!(code, OK, "{document:#}");

    // So with the sensor, and the rig stops along its ramp.
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    wrist.signal("KILL");
    let (code, document) = master.document();
    assert_eq!((code, &document["state"]), (SAFETY_STOP, &Value::from("Stopped")), "{document:#}");
    assert_eq!(document["cause_devices"], "force sensor", "{document:#}");
    assert_stopped_together(&observer.rest());
    drop((plant, right, wrist));
    let _ = std::fs::remove_file(socket);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_master_that_is_killed_leaves_drives_that_stop_by_themselves() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    master.signal("KILL");
    observer
        .until("emergency of both drives", |frames| [1, 2].iter().all(|node| !emergencies(frames, *node).is_empty()));
    let (frames, times) = observer.rest_with_times();
    let last_sync = frames.iter().rposition(|frame| frame.id() == cob::SYNC).expect("it ran");
    // How soon in virtual time is what hil-tests/tests/scenarios/watchdogs.rs holds each of them to.
    let told = [0x081, 0x082].map(|id| frames.iter().position(|frame| frame.id() == id).expect("both told"));
    let after = told.map(|at| times[at].since(times[last_sync]));
    println!("after the last SYNC: left {:?}, right {:?}, apart {:?}", after[0], after[1], after[0].abs_diff(after[1]));
    let first = frames.iter().position(|frame| matches!(frame.id(), 0x081 | 0x082)).expect("they told");
    assert!(first > last_sync, "they held on as long as the master lived");
    assert!(set_points(&frames[last_sync..]).count() <= 2, "nobody moves them any more");
    // A person starts the program anew: the drives are reset, and the rig runs.
    let (code, document) = run_for("1").document();
    assert_eq!(code, OK, "{document:#}");
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_master_that_is_stopped_and_goes_on_finds_its_drives_stopped_and_latches() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    master.signal("STOP");
    observer
        .until("emergency of both drives", |frames| [1, 2].iter().all(|node| !emergencies(frames, *node).is_empty()));
    observer.take();
    master.signal("CONT");
    let (code, document) = master.document();
    assert!([SAFETY_STOP, 6].contains(&code), "{document:#}");
    assert_ne!(document["state"], "Running");
    let message = document["diagnostics"][0]["message"].as_str().expect("it has one");
    assert!(message.starts_with("this computer stood still for "), "{message}");
    let words: Vec<u8> = set_points(&observer.rest()).collect();
    // What was computed before it was stopped may still come; after that nothing moves.
    assert!(words.iter().skip(2).all(|word| *word != 0x0f), "{words:?}");
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_node_that_is_reset_in_motion_stops_both_axes_in_the_same_cycle() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    let mut stranger = Real::open(&SocketCanSettings::everything(&bus()));
    stranger.send(&Frame::new(cob::NMT, &[0x81, 1])).expect("the interface is up");
    let (code, document) = master.document();
    assert_eq!(code, SAFETY_STOP, "{document:#}");
    let cause = document["cause"].as_str().unwrap_or_default();
    assert!(["node-reset", "intruder", "drive-left-operation"].contains(&cause), "{document:#}");
    assert_stopped_together(&observer.rest());
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn an_interface_that_is_taken_down_is_a_lost_bus() {
    if bus() != "vcan0" {
        return;
    }
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let folder = std::env::temp_dir().join(format!("yieldwall-down-{}", std::process::id()));
    let record = ["--pace", "lockstep", "--duration", "60", "--record", folder.to_str().expect("a plain path")];
    let master = Running::run(RIG, &record);
    observer.until_moving(300);
    let down = PutBack::down("vcan0");
    let (code, document) = master.document();
    drop(down);
    std::fs::remove_dir_all(folder).expect("it is there");
    assert_eq!(code, SAFETY_STOP, "{document:#}");
    for file in document["recorded"].as_array().expect("files") {
        assert_eq!(file["dropped"], 0, "time waits for the disk: {file}");
    }
    assert_eq!((&document["cause"], &document["state"]), (&Value::from("link-down"), &Value::from("Lost")));
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn ctrl_c_and_a_terminal_that_goes_away_are_controlled_stops_that_leave_no_error_in_the_drives() {
    for signal in ["INT", "HUP"] {
        let sim = lockstep(RIG);
        let observer = Observer::new();
        let master = run_for("60");
        observer.until_moving(300);
        master.signal(signal);
        let (code, document) = master.document();
        assert_eq!(code, INTERRUPTED, "{signal}: {document:#}");
        assert_eq!((&document["state"], &document["cause"]), (&Value::from("Running"), &Value::Null));
        let frames = observer.rest();
        assert_stopped_together(&frames);
        // Nobody waits for set-points or for the master's heartbeat any more.
        let told = [emergencies(&frames, 1), emergencies(&frames, 2)].concat();
        assert_eq!(told, [0_u16; 0], "{signal}: {told:x?}");
        drop(sim);
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_program_that_was_started_to_outlive_its_terminal_does() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let line = format!(
        "trap '' HUP; exec {} run {RIG} --bus {} --json --pace lockstep --duration 4",
        program().display(),
        bus()
    );
    let mut shell = Command::new("sh");
    shell.args(["-c", &line]).stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
    let master = Running::of(shell.spawn().expect("a shell"));
    observer.until_moving(300);
    master.signal("HUP");
    let (code, document) = master.document();
    assert_eq!((code, &document["cycles"]), (OK, &Value::from(4000)), "{document:#}");
    drop((observer, sim));
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_stranger_that_takes_all_nodes_to_pre_operational_is_named() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    let mut stranger = Real::open(&SocketCanSettings::everything(&bus()));
    stranger.send(&Frame::new(cob::NMT, &[0x80, 0])).expect("the interface is up");
    let (code, document) = master.document();
    assert_eq!((code, &document["cause"]), (SAFETY_STOP, &Value::from("intruder")), "{document:#}");
    assert_stopped_together(&observer.rest());
    drop(sim);
}

/// A stranger's set-point bears a halt bit, which the program never sends, so that it is told from own ones.
fn assert_sync_waits_for_a_quick_stop(rig: &str, sim: &[&str], foreign: &Frame, rounds: usize) {
    let is_quick_stop = |frame: &Frame| [0x201, 0x202].contains(&frame.id()) && frame.bytes()[..2] == [0x02, 0x00];
    for round in 0..rounds {
        // Each time anew: where the last run has left the arm the hand would pull it back to where its path starts, which is too
        // fast for some rigs.
        let sim = Running::sim(rig, &[&["--pace", "lockstep"], sim].concat());
        let observer = Observer::new();
        let master = Running::run(rig, &["--pace", "lockstep", "--duration", "600"]);
        observer.until_moving(200 + 37 * round);
        let mut stranger = Real::open(&SocketCanSettings::services(&bus(), Vec::new()));
        stranger.send(foreign).expect("the interface is up");
        let (code, document) = master.document();
        assert_eq!((code, &document["cause"]), (SAFETY_STOP, &Value::from("intruder")), "{document:#}");
        let frames = observer.rest();
        let from = frames.iter().position(|frame| frame == foreign).expect("the observer hears it too");
        let after = &frames[from..];
        let stop = after.iter().position(is_quick_stop).expect("a quick stop");
        // One that was about to leave when the frame came may still do so.
        let syncs = after[..stop].iter().filter(|frame| frame.id() == cob::SYNC).count();
        assert!(syncs <= 1, "{rig}, round {round}: {:x?}", &after[..stop]);
        let own: Vec<Frame> = frames.into_iter().filter(|frame| frame != foreign).collect();
        assert_stopped_together(&own);
        sim.interrupted();
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_set_point_of_a_stranger_holds_sync_back_until_a_quick_stop_was_sent() {
    assert_sync_waits_for_a_quick_stop(RIG, &[], &Frame::new(0x202, &[0x0f, 0x01, 0xf4, 0x01]), 5);
    // 3.6 rad from where the joint is at 800 000 counts a turn.
    let position = Frame::new(0x202, &[0x0f, 0x01, 0x00, 0x00, 0x07, 0x00]);
    assert_sync_waits_for_a_quick_stop("builtin:paper-admittance-10ms.yaml", &[], &position, 3);
    let (rig, scene) = slow();
    assert_sync_waits_for_a_quick_stop(&rig, &["--scene", &scene], &position, 3);
    std::fs::remove_file(rig).expect("it is there");
    std::fs::remove_file(scene).expect("it is there");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_stranger_that_takes_a_watchdog_off_a_drive_stops_the_rig() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    let mut stranger = Real::open(&SocketCanSettings::everything(&bus()));
    // Reading changes nothing; 6007h = 0 has the drive go on without its master's heartbeat.
    stranger.send(&Frame::new(0x601, &[0x40, 0x07, 0x60, 0, 0, 0, 0, 0])).expect("the interface is up");
    observer.until_moving(300);
    stranger.send(&Frame::new(0x601, &[0x2b, 0x07, 0x60, 0, 0, 0, 0, 0])).expect("the interface is up");
    let (code, document) = master.document();
    assert_eq!((code, &document["cause"]), (SAFETY_STOP, &Value::from("intruder")), "{document:#}");
    assert_eq!(document["foreign_downloads"], 1, "{document:#}");
    assert_stopped_together(&observer.rest());
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn devices_that_were_stopped_do_not_work_off_what_came_meanwhile() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    sim.signal("STOP");
    let (code, document) = master.document();
    assert_eq!(code, SAFETY_STOP, "{document:#}");
    let missed = observer.take().iter().filter(|frame| frame.id() == cob::SYNC).count();
    sim.signal("CONT");
    let answers = observer.rest().iter().filter(|frame| frame.id() == 0x181).count();
    // One period may have been under way.
    assert!(missed > 300 && answers <= 1, "{answers} answers after {missed} SYNC");
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_get_a_speed_limit_of_their_own_before_they_are_started() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let (code, document) = run_for("1").document();
    assert_eq!(code, OK, "{document:#}");
    let frames = observer.rest();
    for node in [1_u8, 2] {
        let place = |id: u16, head: [u8; 4]| {
            let is_it = |frame: &Frame| frame.id() == id + u16::from(node) && frame.bytes()[..4] == head;
            // It is read before it is written, and read back.
            frames.iter().rposition(is_it).unwrap_or_else(|| panic!("no {head:x?} to or from node {node}"))
        };
        let limit = |at: usize| u32::from_le_bytes([4, 5, 6, 7].map(|byte| frames[at].bytes()[byte]));
        let written = place(0x600, [0x23, 0x80, 0x60, 0x00]);
        let read_back = place(0x580, [0x43, 0x80, 0x60, 0x00]);
        let started =
            frames.iter().position(|frame| *frame == Frame::new(cob::NMT, &[1, node])).expect("it is started");
        assert!(written < read_back && read_back < started, "node {node}");
        assert_eq!(limit(written), limit(read_back), "node {node}");
        // A quarter above the guard's 6 rad/s, in turns of the motor, which is the joint: 71.6, rounded down.
        assert_eq!(limit(written), 71, "node {node}");
    }
    drop(sim);
}
