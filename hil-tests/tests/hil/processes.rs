//! The program against itself: `yieldwall run --bus` and `yieldwall sim` as processes of their own, and what becomes of the
//! rig when one of them dies, is stopped, or loses the bus.
//!
//! An observer on the bus sees what the master sends and what the drives say. Simulated time is that of lockstep, so that no
//! computer is too slow; what is said about order, counts and states holds at any speed.

use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use hil_tests::network::Real;
use serde_json::Value;
use yieldwall::canopen::{EmcyCode, Emergency, Frame, cob};
use yieldwall::link::{CanLink, Received, SocketCanSettings};

const RIG: &str = "builtin:paper-admittance.yaml";
const SLOW_RIG: &str = "builtin:paper-admittance-5ms.yaml";
/// How long anything may take; only a program that hangs does.
const LIMIT: Duration = Duration::from_secs(60);

/// What a person sees of an end.
const OK: i32 = 0;
const BUS_UNAVAILABLE: i32 = 4;
const DEVICE_MISMATCH: i32 = 5;
const OUT_OF_TOLERANCE: i32 = 7;
const SAFETY_STOP: i32 = 8;
const TIMING_MISSED: i32 = 9;
const INTERRUPTED: i32 = 130;

fn program() -> PathBuf {
    let tests = std::env::current_exe().expect("a test has a file");
    tests.ancestors().nth(2).expect("target/debug/deps").join("yieldwall")
}

fn bus() -> String {
    std::env::var("YIELDWALL_CAN").unwrap_or_else(|_| "vcan0".to_owned())
}

/// A process that does not outlive its test.
struct Running(Option<Child>);

impl Running {
    fn start(arguments: &[&str]) -> Self {
        let state = std::env::temp_dir().join(format!("yieldwall-hil-{}", std::process::id()));
        let child = Command::new(program())
            .args(arguments)
            .env("XDG_STATE_HOME", state)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("`cargo build --bin yieldwall` comes before these tests");
        Self(Some(child))
    }

    /// Simulated devices that are ready.
    fn sim(rig: &str, arguments: &[&str]) -> Self {
        let bus = bus();
        let mut sim = Self::start(&[&["sim", rig, "--bus", &bus], arguments].concat());
        let mut first = String::new();
        let stdout = sim.0.as_mut().and_then(|child| child.stdout.as_mut()).expect("it is piped");
        BufReader::with_capacity(1, stdout).read_line(&mut first).expect("it says what it is");
        assert!(first.starts_with("simulated"), "{first}");
        sim
    }

    fn run(rig: &str, arguments: &[&str]) -> Self {
        let bus = bus();
        Self::start(&[&["run", rig, "--bus", &bus, "--json"], arguments].concat())
    }

    fn signal(&self, name: &str) {
        let id = self.0.as_ref().expect("it runs").id().to_string();
        assert!(Command::new("kill").args(["-s", name, &id]).status().expect("procps").success());
    }

    /// Waits for the end; exit code, standard output, standard error.
    fn end(mut self) -> (i32, String, String) {
        let mut child = self.0.take().expect("it runs");
        let started = Instant::now();
        while child.try_wait().expect("it is a child").is_none() {
            assert!(started.elapsed() < LIMIT, "it hangs");
            std::thread::sleep(Duration::from_millis(10));
        }
        let (mut out, mut error) = (String::new(), String::new());
        child.stdout.take().expect("piped").read_to_string(&mut out).expect("text");
        child.stderr.take().expect("piped").read_to_string(&mut error).expect("text");
        (child.wait().expect("it is a child").code().unwrap_or(-1), out, error)
    }

    fn document(self) -> (i32, Value) {
        let (code, out, error) = self.end();
        (code, serde_json::from_str(&out).unwrap_or_else(|problem| panic!("{problem}: {out}\n{error}")))
    }

    /// Ends simulated devices by Ctrl-C; what they say.
    fn interrupted(self) -> String {
        self.signal("INT");
        let (code, out, error) = self.end();
        assert_eq!(code, OK, "{error}");
        out
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Who listens on the bus, on a thread of its own.
struct Observer {
    frames: Arc<Mutex<Vec<Frame>>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Observer {
    fn new() -> Self {
        let mut link = Real::open(&SocketCanSettings::everything(&bus()));
        let frames = Arc::new(Mutex::new(Vec::new()));
        let is_over = Arc::new(AtomicBool::new(false));
        let (heard, end) = (Arc::clone(&frames), Arc::clone(&is_over));
        let thread = std::thread::spawn(move || {
            while !end.load(Ordering::Relaxed) {
                link.wait(link.now() + Duration::from_millis(20));
                while let Some(arrival) = link.receive() {
                    match arrival.what {
                        Received::Frame(frame) => heard.lock().expect("nobody panics with it").push(frame),
                        Received::Overflow { frames } => panic!("the observer has lost {frames} frames"),
                        _ => {}
                    }
                }
            }
        });
        Self { frames, is_over, thread: Some(thread) }
    }

    /// Waits until `is_enough` of all that was heard.
    fn until(&self, what: &str, is_enough: impl Fn(&[Frame]) -> bool) {
        let started = Instant::now();
        while !is_enough(&self.frames.lock().expect("nobody panics with it")) {
            assert!(started.elapsed() < LIMIT, "no {what}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Both drives were told to be in Operation Enabled for so many cycles.
    fn until_moving(&self, cycles: usize) {
        self.until("motion", |frames| set_points(frames).filter(|word| *word == 0x0f).count() > 2 * cycles);
    }

    /// What was heard so far, which is forgotten.
    fn take(&self) -> Vec<Frame> {
        std::mem::take(&mut self.frames.lock().expect("nobody panics with it"))
    }

    /// All that was heard, and what still comes within a while: devices go on to send heartbeats.
    fn rest(mut self) -> Vec<Frame> {
        std::thread::sleep(Duration::from_millis(300));
        self.is_over.store(true, Ordering::Relaxed);
        self.thread.take().expect("once").join().expect("the observer hears all");
        self.take()
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

/// The low byte of every controlword for a drive, in the order of the bus.
fn set_points(frames: &[Frame]) -> impl Iterator<Item = u8> {
    frames.iter().filter(|frame| matches!(frame.id(), 0x201 | 0x202)).map(|frame| frame.bytes()[0])
}

fn emergencies(frames: &[Frame], node: u8) -> Vec<u16> {
    let own = frames.iter().filter_map(Emergency::decode).filter(|emergency| emergency.node.raw() == node);
    own.filter(|emergency| !emergency.code.is_reset()).map(|emergency| emergency.code.0).collect()
}

/// Both axes get the quick stop with the same cycle: until the first word that is none to move, all are; from the next pair
/// on, none is.
fn assert_stopped_together(frames: &[Frame]) {
    let words: Vec<u8> = set_points(frames).collect();
    let pairs: Vec<&[u8]> = words.chunks_exact(2).skip_while(|pair| **pair != [0x0f; 2]).collect();
    let moving = pairs.iter().take_while(|pair| ***pair == [0x0f; 2]).count();
    assert!(moving > 0 && moving < pairs.len(), "it moved, and then it did not");
    for pair in &pairs[moving..] {
        assert!(pair.iter().all(|word| *word != 0x0f), "{pair:?}");
    }
}

fn lockstep(rig: &str) -> Running {
    Running::sim(rig, &["--pace", "lockstep"])
}

fn run_for(seconds: &str) -> Running {
    Running::run(RIG, &["--pace", "lockstep", "--duration", seconds])
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_circle_is_held_in_lockstep_over_two_processes() {
    let sim = Running::sim(RIG, &["--pace", "lockstep", "--scene", "builtin:scenes/circle-hold.yaml"]);
    let (code, document) = run_for("8").document();
    assert_eq!(code, OK, "{document:#}");
    assert_eq!((&document["cycles"], &document["state"]), (&Value::from(8000), &Value::from("Running")));
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
    let frames = observer.rest();
    let last_sync = frames.iter().rposition(|frame| frame.id() == cob::SYNC).expect("it ran");
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
    let master = run_for("60");
    observer.until_moving(300);
    let set =
        |state: &str| assert!(Command::new("ip").args(["link", "set", "vcan0", state]).status().unwrap().success());
    set("down");
    let (code, document) = master.document();
    set("up");
    assert_eq!(code, SAFETY_STOP, "{document:#}");
    assert_eq!((&document["cause"], &document["state"]), (&Value::from("link-down"), &Value::from("Lost")));
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn ctrl_c_is_a_controlled_stop() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let master = run_for("60");
    observer.until_moving(300);
    master.signal("INT");
    let (code, document) = master.document();
    assert_eq!(code, INTERRUPTED, "{document:#}");
    assert_eq!((&document["state"], &document["cause"]), (&Value::from("Running"), &Value::Null));
    let frames = observer.rest();
    assert_stopped_together(&frames);
    // Who is there no longer is missed by its heartbeat, but nobody waits for set-points.
    let told = [emergencies(&frames, 1), emergencies(&frames, 2)].concat();
    assert!(told.iter().all(|code| *code == EmcyCode::HEARTBEAT.0), "{told:x?}");
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn what_is_missing_is_named_and_no_drive_is_enabled() {
    let (code, document) = Running::start(&["run", RIG, "--bus", "nowhere0", "--json"]).document();
    assert_eq!(code, BUS_UNAVAILABLE);
    assert!(document.to_string().contains("nowhere0"), "{document:#}");
    let (code, document) = run_for("1").document();
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(document.to_string().contains("node 1 (left)"), "{document:#}");
    // Nobody has drilled these drives on this machine.
    let sim = Running::sim(RIG, &[]);
    let observer = Observer::new();
    let (code, document) = Running::run(RIG, &["--duration", "1"]).document();
    assert_eq!(code, DEVICE_MISMATCH);
    assert!(document.to_string().contains("yieldwall drill"), "{document:#}");
    assert_eq!(set_points(&observer.rest()).filter(|word| *word == 0x0f).count(), 0);
    drop(sim);
}

/// On the clock of the wall: what the machine grants decides whether the rig runs, and what it says if it does not.
#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_drilled_rig_runs_on_the_wall_clock_or_says_that_this_computer_is_late() {
    let sim = Running::sim(SLOW_RIG, &[]);
    let bus = bus();
    let drill = || Running::start(&["drill", SLOW_RIG, "--bus", &bus, "--json"]).document();
    // Also a computer that is late says so, and enables nothing.
    let drilled = || (0..5).map(|_| drill()).find(|(code, _)| *code != TIMING_MISSED);
    let Some((code, document)) = drilled() else { return println!("this computer is too late for a drill") };
    assert_eq!(code, OK, "{document:#}");
    for finding in document["watchdogs"]["findings"].as_array().expect("findings") {
        assert!(finding["left_stops_after_ms"].is_number() && finding["right_stops_after_ms"].is_number(), "{finding}");
    }
    let observer = Observer::new();
    let (code, document) = Running::run(SLOW_RIG, &["--duration", "3"]).document();
    assert!([OK, TIMING_MISSED].contains(&code), "{document:#}");
    if code == OK {
        assert_stopped_together(&observer.rest());
    }
    drop(sim);
    // The same drives, one of whose watchdogs is gone.
    let sim = Running::sim(SLOW_RIG, &["--unwatched", "heartbeat"]);
    let Some((code, document)) = drilled() else { return println!("this computer is too late for a drill") };
    assert_eq!(code, OUT_OF_TOLERANCE, "{document:#}");
    let (code, document) = Running::run(SLOW_RIG, &["--duration", "1"]).document();
    assert_eq!(code, OUT_OF_TOLERANCE, "{document:#}");
    assert!(document.to_string().contains("heartbeat"), "{document:#}");
    drop(sim);
}
