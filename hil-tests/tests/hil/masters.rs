//! A second master on the bus of the first one, and a second device with the node id of another: whoever comes later sends
//! nothing and says why.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hil_tests::network::Real;
use hil_tests::processes;
use yieldwall::canopen::{Frame, cob};
use yieldwall::link::{CanLink, SocketCanSettings};

use super::programs::*;

/// A participant of somebody else that sends one frame again and again.
struct Stranger {
    frame: Frame,
    observer: Observer,
    is_over: Arc<AtomicBool>,
    /// Says how many frames it has sent.
    thread: Option<std::thread::JoinHandle<usize>>,
}

impl Stranger {
    fn repeating(frame: Frame) -> Self {
        let observer = Observer::new();
        let mut link = Real::open(&SocketCanSettings::services(&bus(), Vec::new()));
        let is_over = Arc::new(AtomicBool::new(false));
        let end = Arc::clone(&is_over);
        let thread = std::thread::spawn(move || {
            let mut sent = 0;
            while !end.load(Ordering::Relaxed) {
                link.send(&frame).expect("the interface is up");
                sent += 1;
                std::thread::sleep(Duration::from_millis(100));
            }
            sent
        });
        Self { frame, observer, is_over, thread: Some(thread) }
    }
}

impl Drop for Stranger {
    /// Waits until the bus has handed over all of its frames: one that comes later would pass for the next stranger's.
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let Some(sent) = self.thread.take().and_then(|thread| thread.join().ok()) else { return };
        if !std::thread::panicking() {
            let frame = self.frame;
            self.observer
                .until("end of the stranger", |heard| heard.iter().filter(|one| **one == frame).count() >= sent);
        }
    }
}

fn run() -> Running {
    run_for("3600")
}

fn latency() -> Running {
    Running::start(&["latency", "--bus", &bus(), "--duration", "1", "--json"])
}

fn drill() -> Running {
    Running::start(&["drill", RIG, "--bus", &bus(), "--json"])
}

/// Whether a program was refused because of a process of this computer.
fn assert_held(program: Running, role: &str, holder: u32) {
    let (code, message, help) = refusal(program);
    assert_eq!(code, BUS_UNAVAILABLE, "{message}");
    assert!(message.starts_with(&format!("{role} is on this bus; nothing was sent")), "{message} {help}");
    assert!(message.contains(&format!("process {holder} (`")) && message.contains(RIG), "{message}");
    assert!(message.contains(&format!("kill -INT {holder}")), "{message}");
}

/// NMT commands: of each, the command and the node.
fn commands(frames: &[Frame]) -> Vec<[u8; 2]> {
    let commands = frames.iter().filter(|frame| frame.id() == cob::NMT);
    commands.map(|frame| [frame.bytes()[0], frame.bytes()[1]]).collect()
}

/// What a master tells its nodes at its begin and, if it comes to it, at its end. No other node is told anything.
const BEGIN: [[u8; 2]; 6] = [[0x81, 1], [0x81, 2], [0x81, 10], [1, 1], [1, 2], [1, 10]];
const END: [[u8; 2]; 3] = [[0x80, 1], [0x80, 2], [0x80, 10]];

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_second_master_on_this_computer_is_refused_and_named_and_the_first_one_runs_on() {
    let sim = lockstep(RIG);
    let observer = Observer::new();
    let first = run();
    observer.until_moving(300);
    for second in [run, drill, latency] {
        assert_held(second(), "a master", first.pid());
    }
    // A device that is there already is no master's business.
    assert_held(Running::start(&["sim", RIG, "--bus", &bus(), "--json"]), "node 1", sim.pid());
    first.signal("INT");
    let (code, document) = first.document();
    assert_eq!((code, &document["state"]), (INTERRUPTED, &"Running".into()), "{document:#}");
    assert_eq!(commands(&observer.rest()), [&BEGIN[..], &END].concat());
    drop(sim);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_master_of_somebody_else_is_heard_and_nothing_is_sent() {
    // The last one knows no rig.
    let programs = [run, drill, latency];
    for (frame, meaning, of_any_rig) in [
        (Frame::new(cob::SYNC, &[7]), "SYNC (identifier 080h, frame 080#07)", true),
        (Frame::new(cob::NMT, &[1, 5]), "an NMT command (identifier 000h, frame 000#0105)", true),
        (Frame::new(0x601, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]), "an SDO request to node 1", true),
        (Frame::remote(0x705, 1), "node guarding of node 5 (identifier 705h, frame 705#R)", true),
        (Frame::new(0x77f, &[5]), "the heartbeat of node 127, the node id of the rig's own master", false),
        (Frame::new(0x202, &[0x0f, 0, 0, 0]), "RPDO 1 of node 2, which a master sends", false),
    ] {
        let stranger = Stranger::repeating(frame);
        let count = if of_any_rig { 3 } else { 2 };
        for (name, program) in ["run", "drill", "latency"].iter().zip(programs).take(count) {
            let observer = Observer::new();
            let (code, message, help) = refusal(program());
            assert_eq!(code, BUS_UNAVAILABLE, "{name}: {message}");
            assert!(message.starts_with("a master is on this bus; nothing was sent. Heard: "), "{name}: {message}");
            assert!(message.contains(meaning) && help.contains("end the other master"), "{name}: {message}; {help}");
            let frames = observer.rest();
            assert!(!frames.is_empty() && frames.iter().all(|heard| *heard == frame), "{name}: {frames:x?}");
        }
        drop(stranger);
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_device_that_the_rig_does_not_know_is_no_master_and_is_left_alone() {
    let sim = lockstep(RIG);
    let stranger = Stranger::repeating(Frame::new(0x705, &[5]));
    let observer = Observer::new();
    let (code, document) = run_for("1").document();
    assert_eq!(code, OK, "{document:#}");
    assert_eq!(commands(&observer.rest()), [&BEGIN[..], &END].concat());
    drop((stranger, sim));
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_device_that_is_on_the_bus_keeps_a_simulated_one_away_and_a_master_does_not() {
    let socket = std::env::temp_dir().join(format!("yieldwall-masters-{}.sock", std::process::id()));
    let _ = std::fs::remove_file(&socket);
    let socket = socket.to_str().expect("a plain path");
    let bus = bus();
    let left = ["sim", RIG, "--bus", &bus, "--json", "--nodes", "left", "--plant", socket];
    for (frame, meaning) in [
        (Frame::new(0x701, &[0x7f]), "a heartbeat or boot-up message of node 1"),
        (Frame::new(0x181, &[0; 6]), "TPDO 1 of node 1 (identifier 181h, frame 181#000000000000)"),
        (Frame::new(0x081, &[0; 8]), "an emergency message of node 1"),
    ] {
        let stranger = Stranger::repeating(frame);
        let observer = Observer::new();
        let (code, message, help) = refusal(Running::start(&left));
        assert_eq!(code, BUS_UNAVAILABLE, "{message}");
        assert!(message.starts_with("a device of this process is on the bus already; nothing was sent"), "{message}");
        assert!(message.contains(meaning) && help.contains("--nodes"), "{message}; {help}");
        assert!(observer.rest().iter().all(|heard| *heard == frame), "{message}");
        assert!(!std::path::Path::new(socket).exists(), "{message}");
        drop(stranger);
    }
    // Those of other devices, and of a master.
    for frame in [Frame::new(0x702, &[0x7f]), Frame::new(cob::SYNC, &[]), Frame::new(0x201, &[0; 4])] {
        let stranger = Stranger::repeating(frame);
        Running::sim(RIG, &["--nodes", "left", "--plant", socket]).interrupted();
        drop(stranger);
    }
    // One that is attached listens too, before the arm waits for its answers.
    let plant = Running::sim(RIG, &["--nodes", "left", "--plant", socket]);
    let stranger = Stranger::repeating(Frame::new(0x702, &[0x7f]));
    let right = ["sim", RIG, "--bus", &bus, "--json", "--nodes", "right", "--attach", socket];
    let (code, message, _) = refusal(Running::start(&right));
    assert_eq!(code, BUS_UNAVAILABLE, "{message}");
    assert!(message.contains("a heartbeat or boot-up message of node 2"), "{message}");
    drop((stranger, plant));
    let _ = std::fs::remove_file(socket);
}

/// Whatever is done to two masters in whatever order: who begins while the other one lives sends nothing, whether that one runs
/// or is stopped, and who begins after it runs.
#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn two_masters_in_any_order_of_start_stop_and_kill() {
    // Twenty rounds take 200 s on a machine with nothing else to do.
    processes::set_limit(3 * processes::LIMIT);
    let sim = lockstep(RIG);
    for seed in seeds(20) {
        println!("round {seed}: YIELDWALL_SEED={seed} replays it alone");
        round(&mut Dice(seed));
    }
    sim.interrupted();
}

fn round(dice: &mut Dice) {
    let observer = Observer::new();
    let mut living = begin(dice, &observer);
    for _ in 0..1 + dice.below(3) {
        match dice.below(5) {
            0 => {
                living.signal("STOP");
                std::thread::sleep(Duration::from_millis(dice.below(3000)));
            }
            1 => {
                // Another one begins in its place, after it.
                living.signal("KILL");
                drop(living);
                assert_eq!(commands(&observer.take_all()), [[0; 2]; 0]);
                living = run();
                observer.until_moving(100);
                assert_eq!(commands(&observer.take()), BEGIN);
            }
            _ => {
                let second = run();
                let moment = Duration::from_millis(dice.below(1500));
                match dice.below(3) {
                    0 => {
                        std::thread::sleep(moment);
                        second.signal("KILL");
                    }
                    1 => {
                        std::thread::sleep(moment);
                        second.signal("STOP");
                        std::thread::sleep(moment);
                        second.signal("CONT");
                        assert_held(second, "a master", living.pid());
                    }
                    _ => assert_held(second, "a master", living.pid()),
                }
            }
        }
    }
    living.signal("CONT");
    if !living.has_ended() {
        living.signal("INT");
    }
    // It ends as asked, or by its own rule if it was stopped for long. Its nodes are left, and nobody has reset them.
    let (code, document) = living.document();
    assert!([INTERRUPTED, SAFETY_STOP, DEVICE_FAULT, TIMING_MISSED].contains(&code), "{document:#}");
    assert_eq!(commands(&observer.rest()), END, "{document:#}");
}

/// Two that begin, the second one soon after the first: one of them is refused, and the other one runs, which is given back.
/// Where one is killed meanwhile there may be a third.
fn begin(dice: &mut Dice, observer: &Observer) -> Running {
    let first = RefCell::new(run());
    std::thread::sleep(Duration::from_millis(dice.below(2500)));
    let second = RefCell::new(run());
    let (what, moment) = (dice.below(3), Duration::from_millis(dice.below(2500)));
    std::thread::sleep(moment);
    let mut was_killed = false;
    match what {
        0 => {}
        1 => {
            first.borrow().signal("STOP");
            std::thread::sleep(moment);
            first.borrow().signal("CONT");
        }
        _ => {
            first.borrow().signal("KILL");
            was_killed = true;
        }
    }
    let has_ended = |program: &RefCell<Running>| program.borrow_mut().has_ended();
    let living = if was_killed {
        observer.until("a master", |frames| has_ended(&second) || moves(frames, 100));
        let refused = has_ended(&second);
        let (first, second) = (first.into_inner(), second.into_inner());
        if refused {
            assert_held(second, "a master", first.pid());
            drop(first);
            run()
        } else {
            second
        }
    } else {
        observer.until("an end", |_| has_ended(&first) || has_ended(&second));
        let is_first = has_ended(&second);
        let (first, second) = (first.into_inner(), second.into_inner());
        if is_first {
            assert_held(second, "a master", first.pid());
            first
        } else {
            // Refused, unless it was stopped in the middle of its boot, which ends by its own rule then.
            let (code, document) = first.document();
            let is_named = document.to_string().contains(&format!("it is process {} (", second.pid()));
            assert!(code == BUS_UNAVAILABLE && is_named || what == 1, "{document:#}");
            second
        }
    };
    let living = RefCell::new(living);
    let mut heard = observer.take_all();
    observer.until("motion", |frames| moves(frames, 100) || has_ended(&living));
    heard.append(&mut observer.take());
    if !has_ended(&living) {
        // One that was killed may have begun before it, and told its nodes some of it.
        let commands = commands(&heard);
        assert!(commands.ends_with(&BEGIN) && (was_killed || commands.len() == BEGIN.len()), "{commands:x?}");
        return living.into_inner();
    }
    // It was stopped in the middle of its boot, or refused by one that was.
    assert_eq!(what, 1, "{:?}", living.into_inner().end());
    let living = run();
    observer.until_moving(100);
    assert!(commands(&observer.take()).ends_with(&BEGIN));
    living
}
