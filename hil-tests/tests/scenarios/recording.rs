//! Recordings of the whole rig: they change nothing, they replay, and they outlive the program.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;

use hil_tests::Scenario;
use hil_tests::processes::{Process, output};
use yieldwall::canopen::Frame;
use yieldwall::config;
use yieldwall::guard::{Fault, Request};
use yieldwall::link::Packet;
use yieldwall::record::recording::{
    self, About, Backpressure, BlackBox, Feed, ReadError, Reader, Recorder, Sink, Writer,
};
use yieldwall::record::{CycleRecord, DeviceRecord};
use yieldwall::report::replay::{self, End, recorded, replay, replay_any, replay_device};
use yieldwall::report::{Overrides, Watch, run_device, run_rig};
use yieldwall::rig::EmbeddedRig;
use yieldwall::run::Observer;
use yieldwall::time::Time;

/// A folder of this test's own, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("yieldwall-hil-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder for temporary files");
        Self(path)
    }

    fn mcap(&self) -> PathBuf {
        self.0.join("cycles.mcap")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn overrides(duration_s: f64) -> Overrides {
    Overrides { duration_s: Some(duration_s), ..Overrides::default() }
}

fn about(scenario: &Scenario) -> About {
    replay::about(&scenario.rig, Some(&scenario.scene), &overrides(1.0)).expect("shipped documents")
}

/// All frames of a run that somebody watches.
fn frames(scenario: &Scenario, duration_s: f64, observer: Option<Observer>) -> Vec<(Time, Frame)> {
    let frames = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&frames);
    let tap = move |time, packet: Packet<'_>| {
        seen.lock().expect("one thread").extend(packet.can().map(|frame| (time, *frame)));
    };
    let watch = Watch { tap: Some(Box::new(tap)), observer, ..Watch::default() };
    run_rig(&scenario.rig, &scenario.scene, &overrides(duration_s), watch, |_| ControlFlow::Continue(()))
        .expect("a shipped rig");
    Arc::into_inner(frames).expect("the run is over").into_inner().expect("one thread")
}

fn record(scenario: &Scenario, duration_s: f64, folder: &Path) -> Vec<(Time, Frame)> {
    let recorder = Recorder::create(folder, &about(scenario)).expect("an empty folder");
    let (mut ring, feed) = Feed::start("recorder", 512, Backpressure::Wait, recorder).expect("a thread");
    let frames = frames(scenario, duration_s, Some(Box::new(move |record| ring.push(record))));
    let end = feed.finish().expect("the thread ends");
    assert!(end.error.is_none() && end.counts.lost() == 0, "{end:?}");
    frames
}

fn read(folder: &Folder) -> Vec<CycleRecord> {
    let mut reader = Reader::open(&folder.mcap()).expect("a recording");
    let mut records = Vec::new();
    while let Some(record) = reader.next_record().expect("it can be read") {
        records.push(record);
    }
    records
}

/// A writer that does not come back until the run is over.
struct Blocked(mpsc::Receiver<()>);

impl Sink<CycleRecord> for Blocked {
    type Report = ();

    fn take(&mut self, _: &CycleRecord) -> io::Result<()> {
        let _ = self.0.recv();
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn stored(&self) -> u64 {
        0
    }

    fn report(self) {}
}

#[test]
fn a_recording_changes_no_frame() {
    for scenario in [Scenario::torque(), Scenario::position()] {
        let alone = frames(&scenario, 3.0, None);
        let folder = Folder::new();
        assert!(record(&scenario, 3.0, &folder.0) == alone, "recorded; replay: {}", scenario.replay());
        let black_box = BlackBox::new(None, "rig", scenario.period_s(), about(&scenario));
        let (mut ring, feed) = Feed::start("black box", 512, Backpressure::Wait, black_box).expect("a thread");
        let watched = frames(&scenario, 3.0, Some(Box::new(move |record| ring.push(record))));
        assert!(watched == alone, "with a black box; replay: {}", scenario.replay());
        assert!(feed.finish().expect("the thread ends").report.is_empty());
        let (release, gate) = mpsc::channel();
        let (mut ring, feed) = Feed::start("blocked", 512, Backpressure::Drop, Blocked(gate)).expect("a thread");
        let watched = frames(&scenario, 3.0, Some(Box::new(move |record| ring.push(record))));
        assert!(watched == alone, "with a writer that stands still; replay: {}", scenario.replay());
        drop(release);
        assert!(feed.finish().expect("the thread ends").counts.dropped > 2000, "the ring was full");
    }
}

#[test]
fn the_same_seed_gives_the_same_files() {
    let scenario = Scenario::torque();
    let folders = [Folder::new(), Folder::new()];
    for folder in &folders {
        record(&scenario, 1.0, &folder.0);
    }
    for file in ["cycles.mcap", "cycles.csv"] {
        let [one, other] = folders.each_ref().map(|folder| std::fs::read(folder.0.join(file)).expect("a file"));
        assert!(one == other, "{file} differs; replay: {}", scenario.replay());
        assert!(one.len() > 100_000);
    }
}

const KINDS: [&str; 5] = [
    "paper-admittance.yaml",
    "paper-admittance-csp.yaml",
    "paper-admittance-csv.yaml",
    "paper-admittance-cartesian.yaml",
    "paper-admittance-4ms.yaml",
];

#[test]
fn recordings_of_all_kinds_of_rig_replay_bit_by_bit() {
    for file in KINDS {
        let scenario = Scenario::shipped(file);
        let folder = Folder::new();
        record(&scenario, 4.0, &folder.0);
        let replayed = replay(&mut Reader::open(&folder.mcap()).expect("a recording")).expect("it replays");
        assert_eq!(replayed.end, End::Whole, "{file}");
        assert!(replayed.cycles as f64 > 4.0 / scenario.period_s(), "{file}: {} cycles", replayed.cycles);
    }
}

fn replay_of(about: &About, records: &[CycleRecord]) -> replay::Replay {
    let mut file = Vec::new();
    let mut writer = Writer::new(&mut file, about).expect("memory");
    records.iter().for_each(|record| writer.write(record).expect("memory"));
    writer.finish().expect("memory");
    drop(writer);
    replay(&mut Reader::new(&file[..]).expect("a recording")).expect("it replays")
}

#[test]
fn a_replay_finds_what_differs_and_what_is_missing() {
    let scenario = Scenario::torque();
    let folder = Folder::new();
    record(&scenario, 2.0, &folder.0);
    let (about, records) = (about(&scenario), read(&folder));
    let mut changed = records.clone();
    let proxy = &mut changed[1234].signals.proxy.0.x;
    *proxy = proxy.next_up();
    let replayed = replay_of(&about, &changed);
    assert_eq!(replayed.cycles, 1234);
    let End::Different { index: 1234, difference, .. } = replayed.end else { panic!("{:?}", replayed.end) };
    assert_eq!(difference.field, "proxy_x_m");
    // What entered a cycle has its effect too.
    let mut changed = records.clone();
    changed[1500].inputs.sample.as_mut().expect("1 kHz").counts[0] += 400;
    let replayed = replay_of(&about, &changed);
    assert!(matches!(replayed.end, End::Different { index: 1500, .. }), "{:?}", replayed.end);
    let mut changed = records.clone();
    changed.remove(500);
    let gap = End::Gap { expected: 500, found: 501 };
    assert_eq!(replay_of(&about, &changed), replay::Replay { cycles: 500, end: gap });
    let gap = End::Gap { expected: 0, found: 700 };
    assert_eq!(replay_of(&about, &records[700..]), replay::Replay { cycles: 0, end: gap });
}

const KILLS: u64 = 100;
const FOLDER: &str = "YIELDWALL_TEST_RECORDS_INTO";
/// Cycles that may be lost: less than those of a second.
const LOST_CYCLES: u64 = 1000;

/// What is killed: a rig that runs and records for an hour, and tells now and then how many cycles it has recorded.
#[test]
#[ignore = "runs as a child of the test that kills it"]
fn records_until_it_is_killed() {
    let Some(folder) = std::env::var_os(FOLDER) else { return };
    let scenario = Scenario::torque();
    let recorder = Recorder::create(PathBuf::from(folder).as_path(), &about(&scenario)).expect("an empty folder");
    // As the program has it: room for half a second.
    let (mut ring, feed) = Feed::start("recorder", 500, Backpressure::Wait, recorder).expect("a thread");
    let count = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&count);
    let mut machine = EmbeddedRig::new(&scenario.rig, &scenario.scene, &scenario.rig.fixture, 1).expect("a rig");
    machine.set_observer(Box::new(move |record| {
        ring.push(record);
        counted.fetch_add(1, Ordering::Relaxed);
    }));
    machine.enable().expect("it is enabled");
    for cycle in 0..3_600_000 {
        machine.run_cycle(Request::None).expect("it goes on");
        if cycle % 50 == 0 {
            writeln!(io::stdout(), "\nrecorded {}", count.load(Ordering::Relaxed)).expect("somebody reads");
        }
    }
    drop(feed);
}

#[test]
fn a_recording_that_is_killed_loses_less_than_a_second() {
    let mut most_lost = 0;
    for kill in 0..KILLS {
        let folder = Folder::new();
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        command.args(["--ignored", "--exact", "recording::records_until_it_is_killed", "--nocapture"]);
        command.env(FOLDER, &folder.0).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = Process::start(&mut command);
        let mut lines = BufReader::new(child.stdout().clone()).lines();
        let mut count_of = move || {
            let number = |line: String| line.strip_prefix("recorded ").and_then(|count| count.parse::<u64>().ok());
            lines.by_ref().find_map(|line| number(line.ok()?))
        };
        assert!(count_of().is_some(), "the child records");
        let reader = std::thread::spawn(move || std::iter::from_fn(&mut count_of).last().unwrap_or(0));
        std::thread::sleep(Duration::from_millis(kill * 37 % 200));
        drop(child);
        let produced = reader.join().expect("its output is read");
        let kept = read(&folder);
        assert!(kept.iter().enumerate().all(|(at, record)| record.moment.index == at as u64), "kill {kill}");
        let lost = produced.saturating_sub(kept.len() as u64);
        assert!(lost < LOST_CYCLES, "kill {kill}: {lost} of {produced} cycles are lost");
        most_lost = most_lost.max(lost);
        // A log that was cut is text to its last whole line.
        let file = File::open(folder.0.join("cycles.csv")).expect("a file");
        assert!(BufReader::new(file).lines().count() as u64 + LOST_CYCLES > produced, "kill {kill}");
    }
    println!("{KILLS} kills: at most {most_lost} cycles lost");
}

/// What runs on another processor: it replays what was recorded, and records the same runs for itself.
#[test]
#[ignore = "runs as a child of the test that compares"]
fn replays_and_records_once_more() {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else { return };
    for file in KINDS {
        let replayed = replay(&mut Reader::open(&folder.join(file).join("cycles.mcap")).expect("a recording"));
        assert_eq!(replayed.expect("it replays").end, End::Whole, "{file}");
        record_all(&folder.join("again").join(file), file);
    }
    #[expect(clippy::disallowed_methods, reason = "the C library's own, for comparison")]
    let sines: Vec<u8> = (0..100_000).flat_map(|i| f64::sin(f64::from(i) * 1e-3).to_ne_bytes()).collect();
    std::fs::write(folder.join("sines"), sines).expect("a file");
}

/// Cycles and frames of 4 s of a rig, in a new folder.
fn record_all(folder: &Path, file: &'static str) {
    std::fs::create_dir_all(folder).expect("a folder");
    let scenario = Scenario::shipped(file);
    let frames = record(&scenario, 4.0, folder);
    std::fs::write(folder.join("frames"), format!("{frames:?}")).expect("a file");
}

/// The C library has functions for processors with fused multiply-add and others for those without, with other last bits.
/// Told to take the others, it changes no bit of a run.
#[test]
#[cfg(all(target_arch = "x86_64", target_env = "gnu"))]
fn a_processor_without_fused_multiply_add_gives_the_same_bits() {
    let folder = Folder::new();
    for file in KINDS {
        record_all(&folder.0.join(file), file);
    }
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command
        .args(["--ignored", "--exact", "recording::replays_and_records_once_more", "--nocapture"])
        .env(FOLDER, &folder.0);
    // The names that it has today, and those that it had before version 2.33.
    command.env("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-FMA_Usable,-FMA4_Usable,-AVX2_Usable");
    let child = output(&mut command);
    let told = String::from_utf8_lossy(&child.stdout) + String::from_utf8_lossy(&child.stderr);
    assert!(child.status.success(), "{told}");
    for file in KINDS {
        for part in ["cycles.mcap", "cycles.csv", "frames"] {
            let [here, there] = [folder.0.join(file), folder.0.join("again").join(file)]
                .map(|folder| std::fs::read(folder.join(part)).expect("a file"));
            assert!(here == there, "{part} of {file} differs");
        }
    }
    let sines = std::fs::read(folder.0.join("sines")).expect("a file");
    #[expect(clippy::disallowed_methods, reason = "the C library's own, for comparison")]
    let own = (0..100_000).map(|i| f64::sin(f64::from(i) * 1e-3).to_ne_bytes());
    let others = sines.chunks_exact(8).zip(own).filter(|(there, here)| *there != here).count();
    println!("of the C library's own sines {others} in 100000 differ; with none this test shows nothing");
}

#[test]
fn a_fault_leaves_a_black_box_and_its_recording_replays() {
    let mut scenario = Scenario::torque();
    // Less than what the hand of the scene needs to leave the surface, after 10 s.
    scenario.rig.guard.force_limit_n = yieldwall::config::Positive::new(22.0).expect("a positive number");
    let folder = Folder::new();
    let black_box = BlackBox::new(Some(folder.0.join("black-box")), "rig", scenario.period_s(), about(&scenario));
    let (mut ring, feed) = Feed::start("black box", 512, Backpressure::Wait, black_box).expect("a thread");
    let recorder = Recorder::create(&folder.0, &about(&scenario)).expect("an empty folder");
    let (mut cycles, recording) = Feed::start("recorder", 512, Backpressure::Wait, recorder).expect("a thread");
    let observer: Observer = Box::new(move |record| {
        ring.push(record);
        cycles.push(record);
    });
    let watch = Watch { observer: Some(observer), ..Watch::default() };
    let report =
        run_rig(&scenario.rig, &scenario.scene, &overrides(27.0), watch, |_| ControlFlow::Continue(())).expect("a rig");
    let cause = report.cause.expect("a fault");
    assert_eq!(cause.fault, Fault::ForceLimit, "replay: {}", scenario.replay());
    assert_eq!(recording.finish().expect("the thread ends").counts.lost(), 0);
    let saved = feed.finish().expect("the thread ends").report;
    let [saved] = &saved[..] else { panic!("one fault, one file: {saved:?}") };
    assert_eq!(saved.cause, cause);
    let all = read(&folder);
    let mut reader: Reader<_> = Reader::open(saved.file.as_ref().expect("a file")).expect("a recording");
    let kept: Vec<_> = std::iter::from_fn(|| reader.next_record().expect("it can be read")).collect();
    let second = (1.0 / scenario.period_s()).round() as usize;
    assert_eq!(kept.len(), 4 * second);
    let fault = kept.iter().position(|record| record.cause.is_some()).expect("the fault is in the file");
    assert_eq!((fault, kept[fault].moment.scene_time_s), (2 * second, saved.scene_time_s));
    let first = kept[0].moment.index as usize;
    assert!(kept[..] == all[first..first + kept.len()], "the black box has what the recording has");
    // The rows end with the cycle that the fault stopped; the recording goes on.
    let last = report.trace.rows.last().expect("rows").time_s;
    assert!(all.last().expect("cycles").moment.scene_time_s > last + 1.9);
    let replayed = replay(&mut Reader::open(&folder.mcap()).expect("a recording")).expect("it replays");
    assert_eq!(replayed, replay::Replay { cycles: all.len() as u64, end: End::Whole });
}

#[test]
fn an_impedance_device_is_recorded_and_run_again() {
    let folder = Folder::new();
    let device = config::load_device(config::builtin("paper-impedance.yaml")).expect("a shipped device");
    let scene = config::load_scene(device.source.relative(&device.value.scene)).expect("its scene").value;
    let (device, asked) = (device.value, overrides(1.5));
    let about = replay::about_device(&device, &scene, &asked).expect("shipped documents");
    let recorder = Recorder::<_, DeviceRecord>::create(&folder.0, &about).expect("an empty folder");
    let (mut producer, feed) = Feed::start("test", 4096, Backpressure::Wait, recorder).expect("a thread");
    let report = run_device(&device, &scene, &asked, |record| producer.push(record), |_| ControlFlow::Continue(()))
        .expect("it runs");
    assert_eq!(feed.finish().expect("the thread ends").counts.lost(), 0);
    let count = report.trace.rows.len() as u64;
    assert!(count >= 1500 && report.trace.rows.iter().any(|row| row.is_impact));

    let again = || recording::open(&folder.mcap()).expect("a recording");
    assert_eq!(replay_any(&mut again()).expect("it replays"), replay::Replay { cycles: count, end: End::Whole });
    let (trace, measures) = recorded(&mut again()).expect("a recording");
    assert_eq!((trace, measures), (report.trace.clone(), report.measures.clone()));
    let Err(ReadError::OtherMachine { .. }) = Reader::<_, CycleRecord>::open(&folder.mcap()) else {
        panic!("it has no cycles of a rig")
    };

    // A position that was reported otherwise gives another proxy, and one that was recorded otherwise is found.
    let mut reader: Reader<_, DeviceRecord> = Reader::open(&folder.mcap()).expect("a recording");
    let mut records: Vec<_> = std::iter::from_fn(|| reader.next_record().expect("it can be read")).collect();
    records[700].force_n[1] += 1e-9;
    let mut file = Vec::new();
    let mut writer = Writer::new(&mut file, &about).expect("memory");
    records.iter().for_each(|record| writer.write(record).expect("memory"));
    writer.finish().expect("memory");
    drop(writer);
    let replayed = replay_device(&mut Reader::new(&file[..]).expect("a recording")).expect("it replays");
    let End::Different { index: 700, difference, .. } = replayed.end else { panic!("{:?}", replayed.end) };
    assert_eq!((replayed.cycles, difference.field), (700, "force_y_n"));
}

/// The frames of a capture on one bus, by the number of the bus: each with its time in ns.
fn captured(file: &[u8], bus: u32) -> Vec<(u64, &[u8])> {
    let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().expect("four"));
    let (mut at, mut frames) = (0, Vec::new());
    while at < file.len() {
        if word(at) == 6 && word(at + 8) == bus {
            let time = u64::from(word(at + 12)) << 32 | u64::from(word(at + 16));
            frames.push((time, &file[at + 28..at + 28 + word(at + 20) as usize]));
        }
        at += word(at + 4) as usize;
    }
    frames
}

#[test]
fn a_capture_has_the_frames_of_all_buses_and_the_same_seed_gives_the_same_bytes() {
    let folder = Folder::new();
    let run = |rig: &str, more: &[&str]| {
        let mut run = Command::new(hil_tests::program());
        run.current_dir(&folder.0).args(["-q", "run", rig, "--duration", "0.3"]).args(more);
        let done = output(&mut run);
        (done.status.code(), String::from_utf8(done.stderr).expect("text"))
    };
    let mixed = "builtin:paper-ethercat-can-sensor.yaml";
    let good = (Some(0), String::new());
    for (seed, file) in [("1", "one.pcapng"), ("1", "again.pcapng"), ("2", "other.pcapng")] {
        assert_eq!(run(mixed, &["--seed", seed, "--pcapng", file]), good, "{file}");
    }
    assert_eq!(run(mixed, &["--seed", "1", "--record", "rec", "--candump", "can.log"]), good);
    let read = |file: &str| std::fs::read(folder.0.join(file)).expect("a file");
    let one = read("one.pcapng");
    assert!(one == read("again.pcapng") && one == read("rec/bus.pcapng"), "the same seed gives the same bytes");
    assert!(one != read("other.pcapng"), "a seed without effect");
    assert!(read("can.log") == read("rec/bus.log"));
    // Bus 0 is the segment: each frame as it was sent and as it came back, which one bit of the sender tells. Bus 1 is CAN.
    let on_segment = captured(&one, 0);
    let came_back = on_segment.iter().filter(|(_, frame)| frame[6] & 2 != 0).count();
    assert!(on_segment.len() > 1000 && 2 * came_back == on_segment.len(), "{came_back} of {}", on_segment.len());
    assert!(on_segment.iter().all(|(_, frame)| frame[12..14] == [0x88, 0xa4]));
    let on_can = captured(&one, 1);
    let log = String::from_utf8(read("can.log")).expect("text");
    assert_eq!(on_can.len(), log.lines().count());
    for ((time, frame), line) in on_can.iter().zip(log.lines()) {
        let id = u32::from_be_bytes(frame[..4].try_into().expect("four"));
        let data: String = frame[8..].iter().map(|byte| format!("{byte:02X}")).collect();
        let (seconds, micros) = (time / 1_000_000_000, time / 1000 % 1_000_000);
        assert_eq!(format!("({seconds:010}.{micros:06}) vcan1 {id:03X}#{data}"), line);
    }
    // A rig without CAN has no log of it.
    assert_eq!(run("builtin:paper-ethercat.yaml", &["--record", "segment"]), good);
    assert!(!folder.0.join("segment/bus.log").exists() && folder.0.join("segment/bus.pcapng").exists());
    let (code, said) = run("builtin:paper-ethercat.yaml", &["--candump", "none.log"]);
    assert!(
        code == Some(2) && said.contains("this rig has no bus but") && said.contains("paper-ethercat.yaml:"),
        "{said}"
    );
    assert!(!folder.0.join("none.log").exists());
}

/// The report of `record repair` of a recorded folder on one of its files with frames.
fn repaired(folder: &Path, file: &str) -> serde_json::Value {
    let mut repair = Command::new(hil_tests::program());
    let done = output(repair.current_dir(folder).args(["record", "repair", "rec", "--json"]));
    let text = String::from_utf8(done.stdout).expect("text");
    let document: serde_json::Value = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
    assert_eq!(done.status.code(), Some(0), "{document:#}");
    std::fs::remove_file(folder.join("rec/cycles.repaired.mcap")).expect("it was written");
    let frames = document["frames"].as_array().unwrap_or_else(|| panic!("no frames: {document:#}"));
    let is_it = |told: &&serde_json::Value| told["file"] == format!("rec/{file}");
    frames.iter().find(is_it).unwrap_or_else(|| panic!("no {file}: {document:#}")).clone()
}

/// Cut at every byte of the last two frames, as `kill -9` cuts them.
#[test]
fn a_repair_cuts_a_capture_and_a_log_behind_their_last_whole_frame() {
    let folder = Folder::new();
    let mut run = Command::new(hil_tests::program());
    run.current_dir(&folder.0).args([
        "-q",
        "run",
        "builtin:paper-ethercat-can-sensor.yaml",
        "--duration",
        "0.05",
        "--record",
        "rec",
    ]);
    let done = output(&mut run);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let path = |name: &str| folder.0.join("rec").join(name);
    let capture = std::fs::read(path("bus.pcapng")).expect("a capture");
    let log = std::fs::read(path("bus.log")).expect("a log");
    let mut blocks = vec![0];
    while blocks.last() != Some(&capture.len()) {
        let at = *blocks.last().expect("one");
        blocks.push(at + u32::from_le_bytes(capture[at + 4..at + 8].try_into().expect("four")) as usize);
    }
    let lines =
        [vec![0], log.iter().enumerate().filter(|(_, byte)| **byte == b'\n').map(|(at, _)| at + 1).collect()].concat();
    for (name, ending, bytes, ends) in [("bus.pcapng", "pcapng", &capture, &blocks), ("bus.log", "log", &log, &lines)] {
        let copy = path(&format!("bus.repaired.{ending}"));
        let whole = repaired(&folder.0, name);
        assert_eq!((&whole["cut_bytes"], &whole["out"]), (&0.into(), &serde_json::Value::Null), "{whole:#}");
        assert!(!copy.exists(), "what is whole is not copied");
        for cut in ends[ends.len() - 3]..bytes.len() {
            std::fs::write(path(name), &bytes[..cut]).expect("it is written");
            let kept = *ends.iter().rfind(|end| **end <= cut).expect("the begin");
            let told = repaired(&folder.0, name);
            let what = format!("{name} of {cut} bytes: {told:#}");
            assert_eq!((&told["kept_bytes"], &told["cut_bytes"]), (&kept.into(), &(cut - kept).into()), "{what}");
            assert_eq!(copy.exists(), kept < cut, "{what}");
            if kept < cut {
                assert!(std::fs::read(&copy).expect("a copy") == bytes[..kept], "{what}");
                std::fs::remove_file(&copy).expect("it is there");
            }
            assert!(std::fs::read(path(name)).expect("the file") == bytes[..cut], "the file itself stays: {what}");
        }
        std::fs::write(path(name), bytes).expect("it is written");
    }
    // A copy that is there already is not written over, and then nothing is written.
    std::fs::write(path("bus.log"), &log[..log.len() - 1]).expect("it is written");
    std::fs::write(path("bus.repaired.log"), "mine").expect("it is written");
    let mut repair = Command::new(hil_tests::program());
    let done = output(repair.current_dir(&folder.0).args(["record", "repair", "rec"]));
    let said = String::from_utf8(done.stderr).expect("text");
    assert!(done.status.code() == Some(2) && said.contains("bus.repaired.log"), "{said}");
    assert!(!path("cycles.repaired.mcap").exists());
    let left: Vec<_> =
        std::fs::read_dir(path("")).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    assert!(left.iter().all(|path| !path.to_string_lossy().contains("unfinished")), "{left:?}");
}
