//! Master and devices as two processes with nothing between them but an interface, in lockstep so that a slow machine is
//! no fault of theirs. What the drives are in at the end is asked of them over the same interface.

use std::io::Read;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use super::interface::Own;
use hil_tests::network::{PATIENCE, Real, client, transfer};
use hil_tests::{DRIVE_NODES, Seen, setpoint};
use yieldwall::canopen::SdoOutcome;
use yieldwall::link::{CanLink, Received, SocketCan, SocketCanSettings};

/// The shipped rig in position mode: whoever enables it at the wrong place sends a target that shows it.
const RIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/paper-admittance-csp.yaml");
/// Statusword (CiA 402) of a drive in Operation Enabled, and the bits that say so.
const ENABLED: (u16, u16) = (0x27, 0x6f);

/// Ends with the test.
struct Process(Child);

impl Process {
    fn start(arguments: &[&str]) -> Self {
        // Beside the folder of the test program.
        let test = std::env::current_exe().expect("a test program");
        let program: PathBuf = test.parent().and_then(|deps| deps.parent()).expect("a folder").join("yieldwall");
        let mut command = Command::new(&program);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Self(command.spawn().unwrap_or_else(|error| panic!("{}: {error}; build the program", program.display())))
    }

    fn signal(&self, name: &str) {
        let done = Command::new("kill").args([name, &self.0.id().to_string()]).status().expect("a shell's kill");
        assert!(done.success(), "kill {name}");
    }

    fn is_over(&mut self) -> bool {
        self.0.try_wait().expect("a child").is_some()
    }

    /// Waits for its end.
    fn output(mut self, clock: &mut SocketCan) -> Output {
        let until = clock.now() + 3 * PATIENCE;
        while !self.is_over() {
            assert!(clock.now() < until, "it does not end");
            clock.wait(clock.now() + Duration::from_millis(20));
            while clock.receive().is_some() {}
        }
        let status = self.0.wait().expect("a child");
        let (mut stdout, mut stderr) = (Vec::new(), Vec::new());
        self.0.stdout.take().expect("a pipe").read_to_end(&mut stdout).expect("a pipe");
        self.0.stderr.take().expect("a pipe").read_to_end(&mut stderr).expect("a pipe");
        Output { status, stdout, stderr }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may be over already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// An interface with simulated devices and somebody who listens.
struct Rig {
    own: Own,
    link: SocketCan,
    devices: Process,
}

impl Rig {
    fn new(name: &'static str) -> Self {
        let own = Own::new(name);
        let link = Real::open(&SocketCanSettings::everything(name));
        let devices = Process::start(&["sim", RIG, "--bus", name, "--pace", "lockstep"]);
        let mut rig = Self { own, link, devices };
        for node in [1, 2, 10] {
            rig.hear(|seen| seen.frame.id() == 0x700 + node && seen.frame.data() == [0]);
        }
        rig
    }

    fn run(&self, duration_s: &str) -> Process {
        let folder = std::env::temp_dir().join(self.own.name());
        let black_box = folder.to_str().expect("a name in plain letters");
        let bus = ["--json", "run", RIG, "--bus", self.own.name(), "--pace", "lockstep"];
        Process::start(&[&bus[..], &["--duration", duration_s, "--black-box", black_box]].concat())
    }

    /// The next frame for which `is_it`.
    fn hear(&mut self, is_it: impl Fn(&Seen) -> bool) -> Seen {
        let until = self.link.now() + PATIENCE;
        while self.link.now() < until {
            assert!(!self.devices.is_over(), "the devices have ended");
            while let Some(arrival) = self.link.receive() {
                let Received::Frame(frame) = arrival.what else { continue };
                let seen = Seen { time: arrival.time, frame };
                if is_it(&seen) {
                    return seen;
                }
            }
            self.link.wait(until);
        }
        panic!("it has not come for {PATIENCE:?}");
    }

    /// Waits until both drives are in Operation Enabled, by what they say in every cycle, and a while longer.
    fn runs(&mut self) {
        for node in DRIVE_NODES {
            self.hear(|seen| {
                let bytes = seen.frame.bytes();
                seen.frame.id() == 0x180 + node && u16::from_le_bytes([bytes[0], bytes[1]]) & ENABLED.1 == ENABLED.0
            });
        }
        for _ in 0..100 {
            self.hear(|seen| seen.frame.id() == 0x080);
        }
    }

    /// Waits until neither drive is in Operation Enabled, by its own word.
    fn comes_to_rest(&mut self) {
        for node in DRIVE_NODES {
            let mut client = client(node as u8);
            let mut link = Real::open(&SocketCanSettings::everything(self.own.name()));
            let until = link.now() + PATIENCE;
            loop {
                let outcome = transfer(&mut link, &mut client, |client, now, out| {
                    client.start_upload(now, 0x6041, 0, out).expect("idle");
                });
                assert!(matches!(outcome, SdoOutcome::Uploaded { .. }), "{outcome:?}");
                let word = client.value::<u16>().expect("two bytes");
                if word & ENABLED.1 != ENABLED.0 {
                    break;
                }
                assert!(link.now() < until, "drive {node} is still enabled: {word:04X}h");
                link.wait(link.now() + Duration::from_millis(100));
                while link.receive().is_some() {}
            }
        }
    }

    /// Set-points that have come since the last look and enable a drive.
    fn enabling(&mut self) -> usize {
        let arrivals = std::iter::from_fn(|| self.link.receive());
        let frames = arrivals.filter_map(|arrival| match arrival.what {
            Received::Frame(frame) => Some(Seen { time: arrival.time, frame }),
            _ => None,
        });
        let set_points = frames.filter(|seen| DRIVE_NODES.iter().any(|node| seen.frame.id() == 0x200 + node));
        set_points.filter(|seen| setpoint(seen).enables()).count()
    }
}

fn says(output: &Output, key: &str, value: &str) -> bool {
    String::from_utf8_lossy(&output.stdout).contains(&format!("\"{key}\": {value}"))
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_hand_is_held_on_the_circle_and_the_rig_ends_at_rest() {
    let mut rig = Rig::new("ywcircle");
    let output = rig.run("3").output(&mut rig.link);
    assert!(output.status.success(), "{}", text(&output));
    let whole = [("ended", "\"Whole\""), ("cycles", "3000"), ("lost", "0"), ("not_sent", "0"), ("cause", "null")];
    for (key, value) in whole {
        assert!(says(&output, key, value), "{key} is not {value}: {}", text(&output));
    }
    rig.comes_to_rest();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn drives_stop_by_themselves_when_the_master_is_killed() {
    let mut rig = Rig::new("ywkill");
    let master = rig.run("60");
    rig.runs();
    master.signal("-KILL");
    rig.comes_to_rest();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_master_that_was_stopped_for_long_does_not_enable_again() {
    let mut rig = Rig::new("ywstop");
    let master = rig.run("60");
    rig.runs();
    master.signal("-STOP");
    rig.comes_to_rest();
    rig.enabling();
    master.signal("-CONT");
    let until = rig.link.now() + PATIENCE;
    let mut master = master;
    // Set-points that were computed before it was stopped may still be on the way: one for each drive.
    let mut enabling = 0;
    while !master.is_over() && rig.link.now() < until {
        rig.link.wait(rig.link.now() + Duration::from_millis(50));
        enabling += rig.enabling();
    }
    let mut clock = rig.own.link();
    let output = master.output(&mut clock);
    assert!(!output.status.success() && !says(&output, "ended", "\"Whole\""), "{}", text(&output));
    assert!(enabling <= 2, "{enabling} set-points that enable");
    rig.comes_to_rest();
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn an_interface_that_goes_down_ends_the_run_and_the_drives_stop() {
    let mut rig = Rig::new("ywcut");
    let master = rig.run("60");
    rig.runs();
    rig.own.set("down");
    let mut clock = Real::new().client(127);
    let output = master.output(&mut clock);
    assert!(!output.status.success(), "{}", text(&output));
    assert!(says(&output, "state", "\"Lost\""), "{}", text(&output));
    rig.own.set("up");
    rig.comes_to_rest();
}
