//! What is missing or wrong ends `run` and `drill` with one message that says what and what to do next, with the exit code that `--help`
//! documents, and no drive is ever enabled.

use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use yieldwall::ethercat::frame::{Command as Datagram, FrameWriter, address};
use yieldwall::ethercat::{AlState, AlStatusCode};
use yieldwall::link::{EthernetLink, PacketSocket, Role};
use yieldwall::rig::SegmentServer;

use super::super::programs::*;
use super::ip;
use super::rigs::{NEAR, Slow};
use super::served::{FAR, Served};

/// What `run` and `drill` say to devices of which not all are there, or that are sabotaged again and again.
fn refused_by_both(
    slow: &Slow,
    here: [bool; 3],
    sabotage: impl FnMut(&mut SegmentServer) + Clone + Send + 'static,
    code: i32,
    told: &[&str],
) {
    for (name, program) in [("run", Slow::run as fn(&Slow, &str) -> Running), ("drill", |slow, _| slow.drill())] {
        let devices = Served::with(&slow.rig, &slow.scene, here, sabotage.clone());
        let (ended, message, help) = refusal(program(slow, "1"));
        println!("{name}: {ended}: {message}; {help}");
        assert_eq!(ended, code, "{name}: {message}; {help}");
        told.iter()
            .for_each(|part| assert!(message.contains(part) || help.contains(part), "{name}: {message}; {help}"));
        assert!(!devices.end().was_enabled(), "{name}: {message}");
    }
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_segment_without_its_sensor_or_with_nobody_on_it() {
    let slow = Slow::new("unplugged");
    let told = ["wrist", "2 devices answer", "position 2", "look at the cable behind the last one that answers"];
    refused_by_both(&slow, [true, true, false], |_| (), DEVICE_MISMATCH, &told);
    let out = |server: &mut SegmentServer| server.segment_mut().expect("a segment").set_cable(0, false);
    refused_by_both(&slow, [true; 3], out, BUS_UNAVAILABLE, &["none came back", "plug in the cable"]);
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn devices_in_another_order() {
    let slow = Slow::new("ordered");
    let text = std::fs::read_to_string(&slow.rig).expect("it was made");
    let swapped = text
        .replace("position: 0", "position: 7")
        .replace("position: 2", "position: 0")
        .replace("position: 7", "position: 2");
    let path = format!("{}.swapped.yaml", slow.rig);
    std::fs::write(&path, swapped).expect("the folder for temporary files can be written");
    let devices = Served::new(&path, &slow.scene);
    let (code, message, help) = refusal(slow.run("1"));
    std::fs::remove_file(&path).expect("it is there");
    println!("{message}; {help}");
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    assert!(message.starts_with("left (position 0): check its identity"), "{message}");
    assert!(message.contains("at position 2 fits") && message.contains("the order of the cables"), "{message}");
    assert!(!devices.end().was_enabled());
}

/// Changes bytes in the memory chip of a device before it is switched on: what is there at first is kept.
fn in_sii(place: usize, change: fn(&mut [u8])) -> impl FnMut(&mut SegmentServer) + Clone + Send + 'static {
    let mut is_done = false;
    move |server| {
        if let Some(controller) = server.segment_mut().expect("a segment").controller_mut(place).filter(|_| !is_done) {
            change(controller.sii_mut());
            is_done = true;
        }
    }
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_device_that_is_another_one_and_one_with_an_empty_memory() {
    let slow = Slow::new("another");
    // The product code stands in words 000Ah and 000Bh.
    let told = ["right (position 1)", "product code", "compare the device at that position with its profile"];
    refused_by_both(&slow, [true; 3], in_sii(1, |image| image[0x14] ^= 0x01), DEVICE_MISMATCH, &told);
    let told = ["wrist (position 2)", "the chip is empty", "write the image of the vendor anew"];
    refused_by_both(&slow, [true; 3], in_sii(2, |image| image.fill(0xff)), DEVICE_MISMATCH, &told);
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_device_that_does_not_leave_safe_op() {
    let slow = Slow::new("stuck");
    let stuck = |server: &mut SegmentServer| {
        let now = server.now();
        let controller = server.segment_mut().expect("a segment").controller_mut(1).expect("it is there");
        let status = controller.al_status();
        if status.state() == Some(AlState::SafeOperational) && !status.has_error() {
            controller.fail(now, AlStatusCode::SYNC_ERROR);
        }
    };
    refused_by_both(&slow, [true; 3], stuck, DEVICE_FAULT, &["right (position 1)", "SAFE-OP+ERR", "001Ah"]);
    let stays = |server: &mut SegmentServer| {
        let controller = server.segment_mut().expect("a segment").controller_mut(1).expect("it is there");
        controller.set_stays_in_safe_op(true);
    };
    let told = [
        "right (position 1)",
        "it is in SAFE-OP",
        "the request of OP, and reports no error",
        "look whether output frames",
    ];
    refused_by_both(&slow, [true; 3], stays, DEVICE_FAULT, &told);
}

/// Somebody at the other end of the cable who sends frames of EtherCAT, as where a switch joins two segments.
pub(super) struct Stranger {
    is_over: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Stranger {
    pub(super) fn at(interface: &str) -> Self {
        let mut link = PacketSocket::open(interface, Role::Node(99)).unwrap_or_else(|error| panic!("{error}"));
        let is_over = Arc::new(AtomicBool::new(false));
        let end = Arc::clone(&is_over);
        let thread = std::thread::spawn(move || {
            let mut buffer = [0; 64];
            while !end.load(Ordering::Relaxed) {
                let mut writer = FrameWriter::new(&mut buffer, [0x12, 0, 0, 0, 0, 0x34]).expect("room");
                writer.push(Datagram::Brd, 1, address(0, 0x0130), &[0; 2]).expect("room");
                link.send(writer.finish()).expect("the interface is up");
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        Self { is_over, thread: Some(thread) }
    }
}

impl Drop for Stranger {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(std::thread::JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_none_or(|ended| ended.is_ok()), "the stranger has failed");
    }
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn frames_of_another_master_and_of_a_switch() {
    let slow = Slow::new("stranger");
    for stranger in [FAR, "veth0"] {
        let devices = slow.served();
        let stranger = Stranger::at(stranger);
        for is_drill in [false, true] {
            let (code, message, help) = refusal(if is_drill { slow.drill() } else { slow.run("1") });
            println!("{message}; {help}");
            assert_eq!(code, BUS_UNAVAILABLE, "{message}");
            assert!(message.contains("a master is on this segment; nothing was written"), "{message}");
            assert!(
                message.contains("12:00:00:00:00:34") && help.contains("stop the other master"),
                "{message}; {help}"
            );
        }
        drop(stranger);
        let seen = devices.end();
        assert_eq!((seen.was_enabled(), seen.writing), (false, 0));
    }
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn an_interface_that_cannot_be_used() {
    let slow = Slow::new("interface");
    let devices = slow.served();
    ip("link add veth6 type veth peer name veth5");
    for (interface, told) in [
        ("main=veth7", "there is no interface `veth7`; Ethernet interfaces here: "),
        ("main=lo", "`lo` is the loopback interface, and EtherCAT runs on Ethernet"),
        ("veth6", "`veth6` is down. Take it up with `sudo ip link set veth6 up`"),
    ] {
        for arguments in [&["run", "--ignore-latency"][..], &["drill"]] {
            let arguments = [arguments, &[&slow.rig, "--bus", interface, "--json"]].concat();
            let (code, message, _) = refusal(Running::start(&arguments));
            assert_eq!(code, BUS_UNAVAILABLE, "{message}");
            assert!(message.contains(told), "{message}");
        }
    }
    ip("link del veth6");
    for command in ["run", "drill"] {
        let mut unprivileged = Command::new("setpriv");
        unprivileged.args(["--bounding-set=-net_raw", "--inh-caps=-net_raw"]).arg(program());
        unprivileged.args([command, &slow.rig, "--bus", NEAR, "--json"]).env("XDG_STATE_HOME", own_state());
        let piped = std::process::Stdio::piped;
        let child = unprivileged.stdout(piped()).stderr(piped()).spawn().expect("util-linux is there");
        let (code, message, _) = refusal(Running::of(child));
        assert_eq!(code, BUS_UNAVAILABLE, "{message}");
        assert!(message.contains("`sudo setcap cap_net_raw+ep "), "{message}");
    }
    let seen = devices.end();
    assert_eq!((seen.was_enabled(), seen.frames), (false, 0));
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn commands_for_can_name_those_for_ethercat_and_a_scan_that_listens_needs_no_role() {
    let near = "veth0";
    let _master = PacketSocket::open(near, Role::Master).expect("nobody else has it");
    let start = |line: &str| Running::start(&line.split(' ').chain(["--bus", near, "--json"]).collect::<Vec<_>>());
    for line in ["nmt 1 reset", "lss find", "monitor --for 1"] {
        let (code, message, help) = refusal(start(line));
        assert_eq!(code, 2, "{line}: {message}");
        assert!(message.contains("is an Ethernet interface"), "{line}: {message}");
        assert!(help.contains(&format!("`yieldwall state all --bus {near}`")), "{line}: {help}");
    }
    let (code, document) = start("scan --listen").document();
    assert!(code == OK && document["heard"].is_null(), "{document:#}");
    let (code, message, _) = refusal(start("scan"));
    assert_eq!(code, BUS_UNAVAILABLE, "{message}");
    assert!(message.contains(&format!("process {}", std::process::id())), "{message}");
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn drives_whose_watchdog_nobody_has_tried() {
    let slow = Slow::new("untried");
    let state = std::env::temp_dir().join(format!("yieldwall-untried-wire-{}", std::process::id()));
    let devices = slow.served();
    let run = ["run", &slow.rig, "--bus", NEAR, "--json", "--duration", "1"];
    let (code, message, help) = refusal(Running::start_with(&state, &run));
    assert_eq!((code, devices.seen().frames), (TIMING_MISSED, 0), "{message}; {help}");
    let (code, message, help) = refusal(Running::start_with(&state, &[&run[..], &["--ignore-latency"]].concat()));
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    let drill = format!("`yieldwall drill {} --bus veth0`", slow.rig);
    assert!(help.contains(&drill), "{help}");
    // Nor is a joint moved.
    let jog = ["jog", &slow.rig, "left", "--by", "2deg", "--bus", NEAR, "--json", "--ignore-latency"];
    let (code, message, help) = refusal(Running::start_with(&state, &jog));
    assert_eq!(code, DEVICE_MISMATCH, "{message}");
    assert!(help.contains(&drill), "{help}");
    assert!(!devices.end().was_enabled());
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn drives_hold_what_they_held_after_every_signal_and_after_a_kill() {
    let slow = Slow::new("killed");
    let sim = slow.sim();
    // The cycle of SYNC0 and what the controller counts.
    crate::killed::what_the_drives_held_is_given_back(&slow.rig, NEAR, &["1C32h", "1C33h", "6040h", "607Ah"]);
    sim.interrupted();
}
