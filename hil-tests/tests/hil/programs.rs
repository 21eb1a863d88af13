//! The program as a process, and who listens on its bus.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use hil_tests::network::Real;
pub(super) use hil_tests::processes::LIMIT;
use hil_tests::processes::{PipeReader, Process};
use serde_json::Value;
use yieldwall::canopen::{Emergency, Frame};
use yieldwall::config::{self, Source};
use yieldwall::link::{CanLink, Received, SocketCanSettings};
use yieldwall::live::serve;
use yieldwall::rig::DeviceServer;
use yieldwall::run::Pace;
use yieldwall::time::Time;

pub(super) const RIG: &str = "builtin:paper-admittance.yaml";
/// How often something is tried that a computer which stands still for a moment can spoil.
pub(super) const TRIES: usize = 4;

/// What a person sees of an end.
pub(super) const OK: i32 = 0;
pub(super) const BUS_UNAVAILABLE: i32 = 4;
pub(super) const DEVICE_MISMATCH: i32 = 5;
pub(super) const DEVICE_FAULT: i32 = 6;
pub(super) const OUT_OF_TOLERANCE: i32 = 7;
pub(super) const SAFETY_STOP: i32 = 8;
pub(super) const TIMING_MISSED: i32 = 9;
pub(super) const INTERRUPTED: i32 = 130;

pub(super) use hil_tests::program;

pub(super) fn bus() -> String {
    std::env::var("YIELDWALL_CAN").unwrap_or_else(|_| "vcan0".to_owned())
}

/// Where the programs of these tests keep their records.
pub(super) fn own_state() -> PathBuf {
    std::env::temp_dir().join(format!("yieldwall-hil-{}", std::process::id()))
}

/// A process that does not outlive its test.
pub(super) struct Running(Process);

impl Running {
    pub(super) fn start(arguments: &[&str]) -> Self {
        Self::start_with(&own_state(), arguments)
    }

    /// With records of its own.
    pub(super) fn start_with(state: &Path, arguments: &[&str]) -> Self {
        // Whoever started these tests may have had HUP ignored for all that they start.
        Self::piped(
            Command::new("env").arg("--default-signal=HUP").arg(program()).args(arguments).env("XDG_STATE_HOME", state),
        )
    }

    /// In a network namespace.
    pub(super) fn start_in(namespace: &str, arguments: &[&str]) -> Self {
        let mut ip = Command::new("ip");
        ip.args(["netns", "exec", namespace]).arg(program()).args(arguments).env("XDG_STATE_HOME", own_state());
        Self::piped(&mut ip)
    }

    /// An example of the library, with the records of [`Running::start`].
    pub(super) fn example(name: &str, arguments: &[&str]) -> Self {
        let example = program().with_file_name("examples").join(name);
        Self::piped(Command::new(example).args(arguments).env("XDG_STATE_HOME", own_state()))
    }

    /// Without an input: the one of the tests may never end.
    fn piped(command: &mut Command) -> Self {
        Self(Process::start(command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped())))
    }

    /// A program of others.
    pub(super) fn of(child: Child) -> Self {
        Self(Process::of(child))
    }

    /// Simulated devices that are ready.
    pub(super) fn sim(rig: &str, arguments: &[&str]) -> Self {
        let bus = bus();
        Self::ready(Self::start(&[&["sim", rig, "--bus", &bus], arguments].concat()))
    }

    /// Waits until simulated devices say what they are.
    pub(super) fn ready(mut sim: Self) -> Self {
        let mut first = String::new();
        BufReader::with_capacity(1, sim.stdout()).read_line(&mut first).expect("it says what it is");
        assert!(first.starts_with("simulated"), "{first}");
        sim
    }

    pub(super) fn run(rig: &str, arguments: &[&str]) -> Self {
        let bus = bus();
        Self::start(&[&["run", rig, "--bus", &bus, "--json"], arguments].concat())
    }

    pub(super) fn signal(&self, name: &str) {
        self.0.signal(name);
    }

    /// Number of the process.
    pub(super) fn pid(&self) -> u32 {
        self.0.pid()
    }

    /// What it prints.
    pub(super) fn stdout(&mut self) -> &mut PipeReader {
        self.0.stdout()
    }

    /// Whether it has ended.
    pub(super) fn has_ended(&mut self) -> bool {
        self.0.has_ended()
    }

    /// Waits for the end; exit code, and what nobody has read of standard output and standard error.
    pub(super) fn end(self) -> (i32, String, String) {
        let Output { status, stdout, stderr } = self.0.output();
        let text = |bytes| String::from_utf8(bytes).expect("text");
        (status.code().unwrap_or(-1), text(stdout), text(stderr))
    }

    pub(super) fn document(self) -> (i32, Value) {
        let (code, out, error) = self.end();
        (code, serde_json::from_str(&out).unwrap_or_else(|problem| panic!("{problem}: {out}\n{error}")))
    }

    /// Reads the events of a program with `--jsonl` up to an event of this name, or to the end of the program.
    pub(super) fn until_event(&mut self, name: &str) {
        let event = format!("\"event\":\"{name}\"");
        let lines = BufReader::with_capacity(1, self.stdout()).lines();
        let _ = lines.map(|line| line.expect("text")).find(|line| line.contains(&event));
    }

    /// Waits for the end of a program with `--jsonl`; exit code, and the document in the last line.
    pub(super) fn last_line(self) -> (i32, Value) {
        let (code, out, error) = self.end();
        let last = out.lines().last().unwrap_or_default();
        (code, serde_json::from_str(last).unwrap_or_else(|problem| panic!("{problem}: {out}\n{error}")))
    }

    /// Ends simulated devices by Ctrl-C; what they say.
    pub(super) fn interrupted(self) -> String {
        self.signal("INT");
        let (code, out, error) = self.end();
        assert_eq!(code, OK, "{error}");
        out
    }
}

/// The simulated devices of a rig once more, on the bus beside those of a program: in this process, which is none of those
/// that keep a node id for one of them.
pub(super) struct Doubles {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Doubles {
    /// Devices that are switched on; `scene` in place of the rig's.
    pub(super) fn start(rig: &str, scene: Option<&str>, pace: Pace) -> Self {
        let rig = config::load_rig(Source::named(rig)).expect("a good rig");
        let scene = scene.map_or_else(|| rig.scene(), |path| config::load_scene(Source::named(path)));
        let scene = scene.expect("a good scene").value;
        let mut link = Real::open(&SocketCanSettings::everything(&bus()));
        let is_over = Arc::new(AtomicBool::new(false));
        let (end, (is_on, switched_on)) = (Arc::clone(&is_over), std::sync::mpsc::channel());
        let thread = std::thread::spawn(move || {
            let server = DeviceServer::new(&rig.value, &scene, scene.seed, pace);
            let mut server = server.expect("a rig that can be simulated");
            let served = serve(&mut server, &mut link, &end, |_| {
                // Nobody waits a second time.
                let _ = is_on.send(());
            });
            served.expect("the interface stays");
        });
        switched_on.recv().expect("they are served");
        Self { is_over, thread: Some(thread) }
    }
}

impl Drop for Doubles {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_none_or(|ended| ended.is_ok()), "the devices have failed");
    }
}

/// Memory in bytes for what an observer has not taken yet. In lockstep time goes as fast as the processor does, and who only
/// listens may wait for it for seconds.
const MEMORY: usize = 64 << 20;

/// An identifier that CiA 301 gives to nobody.
const MARK: u16 = 0x7f0;

/// What an observer has heard, each frame with its moment.
#[derive(Default)]
struct Heard {
    frames: Vec<Frame>,
    times: Vec<Time>,
}

/// Who listens on the bus, on a thread of its own.
pub(super) struct Observer {
    heard: Arc<Mutex<Heard>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Observer {
    pub(super) fn new() -> Self {
        Self::on(&bus())
    }

    /// On another interface.
    pub(super) fn on(interface: &str) -> Self {
        let everything = SocketCanSettings::everything(interface);
        let mut link = Real::open(&SocketCanSettings { receive_buffer: MEMORY, ..everything });
        let heard = Arc::new(Mutex::new(Heard::default()));
        let is_over = Arc::new(AtomicBool::new(false));
        let (own, end) = (Arc::clone(&heard), Arc::clone(&is_over));
        let thread = std::thread::spawn(move || {
            while !end.load(Ordering::Relaxed) {
                link.wait(link.now() + Duration::from_millis(20));
                while let Some(arrival) = link.receive() {
                    match arrival.what {
                        Received::Frame(frame) => {
                            let mut heard = own.lock().expect("nobody panics with it");
                            heard.frames.push(frame);
                            heard.times.push(arrival.time);
                        }
                        Received::Overflow { frames } => panic!("the observer has lost {frames} frames"),
                        _ => {}
                    }
                }
            }
        });
        Self { heard, is_over, thread: Some(thread) }
    }

    /// Waits until `is_enough` of all that was heard.
    pub(super) fn until(&self, what: &str, is_enough: impl Fn(&[Frame]) -> bool) {
        let started = Instant::now();
        while !is_enough(&self.heard.lock().expect("nobody panics with it").frames) {
            assert!(started.elapsed() < LIMIT, "no {what}: {}", self.last_frames());
            assert!(!self.thread.as_ref().is_some_and(JoinHandle::is_finished), "the observer hears all");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// How many frames were heard, and the last of them.
    fn last_frames(&self) -> String {
        // A test that fails while it looks at the frames leaves the lock poisoned.
        let heard = self.heard.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let from = heard.frames.len().saturating_sub(20);
        format!("{} frames, the last {:x?}", heard.frames.len(), &heard.frames[from..])
    }

    /// Both drives were told to be in Operation Enabled for so many cycles.
    pub(super) fn until_moving(&self, cycles: usize) {
        self.until("motion", |frames| moves(frames, cycles));
    }

    /// What was heard so far, which is forgotten.
    pub(super) fn take(&self) -> Vec<Frame> {
        std::mem::take(&mut *self.heard.lock().expect("nobody panics with it")).frames
    }

    /// All that was on the bus by now, which is forgotten. What the observer has not taken yet would pass for what comes later: a frame of its
    /// own behind that says when all was taken.
    pub(super) fn take_all(&self) -> Vec<Frame> {
        let mark = Frame::new(MARK, &[]);
        Real::open(&SocketCanSettings::everything(&bus())).send(&mark).expect("the bus takes a frame");
        self.until("mark", |frames| frames.iter().any(|frame| frame.id() == MARK));
        self.take().into_iter().filter(|frame| frame.id() != MARK).collect()
    }

    /// All that was heard, and what still comes within a while: devices go on to send heartbeats.
    pub(super) fn rest(self) -> Vec<Frame> {
        self.rest_with_times().0
    }

    pub(super) fn rest_with_times(mut self) -> (Vec<Frame>, Vec<Time>) {
        std::thread::sleep(Duration::from_millis(300));
        self.is_over.store(true, Ordering::Relaxed);
        self.thread.take().expect("once").join().expect("the observer hears all");
        let heard = std::mem::take(&mut *self.heard.lock().expect("nobody panics with it"));
        (heard.frames, heard.times)
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

/// An interface or its queue put back as it was, also when a test fails in between.
pub(super) struct PutBack(Vec<String>);

impl PutBack {
    /// Takes an interface down until this is dropped.
    pub(super) fn down(interface: &str) -> Self {
        system(&["ip", "link", "set", interface, "down"]);
        Self(["ip", "link", "set", interface, "up"].map(str::to_owned).to_vec())
    }

    /// Has the frames of an interface wait in its queue, each for so long, until this is dropped: it lets go what still waits.
    pub(super) fn delayed(interface: &str, delay: &str) -> Self {
        system(&["tc", "qdisc", "add", "dev", interface, "root", "netem", "delay", delay]);
        Self(["tc", "qdisc", "change", "dev", interface, "root", "netem", "delay", "0ms"].map(str::to_owned).to_vec())
    }
}

impl Drop for PutBack {
    fn drop(&mut self) {
        let words: Vec<&str> = self.0.iter().map(String::as_str).collect();
        system(&words);
        if let ["tc", "qdisc", "change", "dev", interface, ..] = words[..] {
            // What waited has gone on by then.
            std::thread::sleep(Duration::from_millis(50));
            system(&["tc", "qdisc", "del", "dev", interface, "root"]);
        }
    }
}

/// So many rounds, each with a seed of its own; the one that YIELDWALL_SEED names, alone.
pub(super) fn seeds(rounds: u64) -> std::ops::Range<u64> {
    let named = std::env::var("YIELDWALL_SEED").ok().and_then(|seed| seed.parse().ok());
    named.map_or(0..rounds, |seed| seed..seed + 1)
}

/// SplitMix64.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    pub(super) fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut word = self.0;
        word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (word ^ (word >> 31)) % end
    }
}

fn system(words: &[&str]) {
    let done = Command::new(words[0]).args(&words[1..]).output().expect("iproute2 is installed");
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() || std::thread::panicking(), "{}: {said}", words.join(" "));
}

/// Whether both drives were told to be in Operation Enabled for so many cycles.
pub(super) fn moves(frames: &[Frame], cycles: usize) -> bool {
    set_points(frames).filter(|word| *word == 0x0f).count() > 2 * cycles
}

/// The low byte of every controlword for a drive, in the order of the bus.
pub(super) fn set_points(frames: &[Frame]) -> impl Iterator<Item = u8> {
    frames.iter().filter(|frame| matches!(frame.id(), 0x201 | 0x202)).map(|frame| frame.bytes()[0])
}

pub(super) fn emergencies(frames: &[Frame], node: u8) -> Vec<u16> {
    let own = frames.iter().filter_map(Emergency::decode).filter(|emergency| emergency.node.raw() == node);
    own.filter(|emergency| !emergency.code.is_reset()).map(|emergency| emergency.code.0).collect()
}

/// Both axes get the quick stop with the same cycle: until the first word that is none to move, all are; from the next pair
/// on, none is.
pub(super) fn assert_stopped_together(frames: &[Frame]) {
    let words: Vec<u8> = set_points(frames).collect();
    let pairs: Vec<&[u8]> = words.chunks_exact(2).skip_while(|pair| **pair != [0x0f; 2]).collect();
    let moving = pairs.iter().take_while(|pair| ***pair == [0x0f; 2]).count();
    assert!(moving > 0 && moving < pairs.len(), "it moved, and then it did not");
    for pair in &pairs[moving..] {
        assert!(pair.iter().all(|word| *word != 0x0f), "{pair:?}");
    }
}

pub(super) fn lockstep(rig: &str) -> Running {
    Running::sim(rig, &["--pace", "lockstep"])
}

pub(super) fn run_for(seconds: &str) -> Running {
    Running::run(RIG, &["--pace", "lockstep", "--duration", seconds])
}

/// A shipped rig with some of its text replaced, as a file; its path. `name` is that of the test.
pub(super) fn changed(name: &str, file: &str, changes: &[(&str, &str)]) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../config");
    let mut text = std::fs::read_to_string(format!("{folder}/{file}")).expect("a shipped rig");
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let text = text.replace("scene: scenes/", &format!("scene: {folder}/scenes/"));
    let text = text.replace("simulation: simulations/", &format!("simulation: {folder}/simulations/"));
    let text = text.replace("like: ", &format!("like: {folder}/"));
    let path = std::env::temp_dir().join(format!("yieldwall-{name}-{}.yaml", std::process::id()));
    std::fs::write(&path, text).expect("the folder for temporary files can be written");
    path.to_str().expect("a plain path").to_owned()
}

/// What a program says that ends in failure: its exit code, and the only error with what to do next.
pub(super) fn refusal(program: Running) -> (i32, String, String) {
    let (code, document) = program.document();
    let findings = document["diagnostics"].as_array().unwrap_or_else(|| panic!("{document:#}"));
    let errors: Vec<&Value> = findings.iter().filter(|finding| finding["severity"] == "error").collect();
    assert_eq!((errors.len(), &document["exit_code"]), (1, &Value::from(code)), "{document:#}");
    let text = |key: &str| errors[0][key].as_str().unwrap_or_default().to_owned();
    (code, text("message"), text("help"))
}

/// Whether a drive was told to be in Operation Enabled.
pub(super) fn is_enabled(frames: &[Frame]) -> bool {
    set_points(frames).any(|word| word == 0x0f)
}

/// Of devices that are there twice none is enabled, and the doubled node id is named. When the second one is heard is up to this
/// computer: in the boot, before the drives are enabled, or so late that it looks like a restart of the first.
pub(super) fn assert_duplicates_are_refused(master: impl FnOnce() -> Running) {
    let observer = Observer::new();
    let (code, message, help) = refusal(master());
    // One that answers for the other in the boot makes a value read back differently, which has other causes too.
    let is_in_help = ["node-reset", "reads back"].iter().any(|what| message.contains(what));
    let told = if is_in_help { &help } else { &message };
    let exit = if message.contains("node-reset") { SAFETY_STOP } else { DEVICE_MISMATCH };
    let names = ["because of duplicate-node", "two nodes have its node id", "a duplicate node id"];
    assert!(names.iter().any(|name| told.contains(name)), "{code}: {message}; {help}");
    assert_eq!(code, exit, "{message}");
    assert!(!is_enabled(&observer.rest()), "{message}");
}
