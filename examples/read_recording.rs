//! Reading a recording: every cycle of a run, as the run left it on disk.
//!
//! ```sh
//! cargo run -p yieldwall --no-default-features --features sim,recording --example read_recording [FILE.mcap]
//! ```
//!
//! Without a file it records five seconds of a simulated rig and reads them. Reading alone needs the feature `recording` only.

use std::error::Error;
use std::fs::{self, File};
use std::ops::ControlFlow;
use std::path::Path;

use yieldwall::config::{Source, load_rig};
use yieldwall::record::recording::{Backpressure, Feed, Reader, Recorder};
use yieldwall::report::{Overrides, Watch, replay, run_rig};

fn main() -> Result<(), Box<dyn Error>> {
    match std::env::args_os().nth(1) {
        Some(file) => read(Path::new(&file)).map(|_| ()),
        None => record_and_read(),
    }
}

/// Reads a recording from its begin to its end, and says how many cycles there are.
fn read(file: &Path) -> Result<u64, Box<dyn Error>> {
    let mut reader: Reader<File> = Reader::open(file)?;
    println!("recorded by version {}", reader.about().version);
    let (mut cycles, mut on_surface, mut greatest_n) = (0, 0, 0.0_f64);
    while let Some(record) = reader.next_record()? {
        cycles += 1;
        on_surface += u64::from(record.signals.is_on_surface);
        greatest_n = greatest_n.max(record.signals.force.norm());
    }
    // A file that was cut is read up to the cut, and the reader says where that is.
    for damage in reader.damage() {
        println!("damaged at {damage}");
    }
    println!("{cycles} cycles, {on_surface} of them on the surface; the hand pushed with {greatest_n:.1} N at most");
    Ok(cycles)
}

fn record_and_read() -> Result<(), Box<dyn Error>> {
    let folder = std::env::temp_dir().join(format!("yieldwall-read-recording-{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    let recorded = record(&folder)?;
    let cycles = read(&folder.join("cycles.mcap"))?;
    assert_eq!(cycles, recorded, "every cycle that was recorded is read");
    assert!(cycles > 5000, "five seconds at 1 kHz, and what enabling and stopping takes");
    fs::remove_dir_all(folder)?;
    Ok(())
}

/// Records five seconds of a simulated rig, and says how many cycles that are.
fn record(folder: &Path) -> Result<u64, Box<dyn Error>> {
    let loaded = load_rig(Source::named("builtin:paper-admittance.yaml"))?;
    let (rig, scene) = (&loaded.value, loaded.scene()?.value);
    let overrides = Overrides { duration_s: Some(5.0), ..Overrides::default() };
    let recorder = Recorder::create(folder, &replay::about(rig, Some(&scene), &overrides)?)?;
    // The cycle fills a ring, and a thread writes to disk. A simulation may wait for that thread; a rig on a bus takes `Drop`.
    let (mut ring, feed) = Feed::start("recorder", 512, Backpressure::Wait, recorder)?;
    let watch = Watch { observer: Some(Box::new(move |record| ring.push(record))), ..Watch::default() };
    run_rig(rig, &scene, &overrides, watch, |_| ControlFlow::Continue(()))?;
    let finished = feed.finish()?;
    finished.error.map_or(Ok(finished.counts.kept), |error| Err(error.into()))
}

#[test]
fn what_the_example_says_is_so() -> Result<(), Box<dyn Error>> {
    record_and_read()
}
