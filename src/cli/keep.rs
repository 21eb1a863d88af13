//! What a run leaves on disk while it runs: recording, bus log, black box.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Value, json};

use super::ending::{bus_names, describe};
use super::failure::{Exit, Failure};
use super::replace::{make_folder, make_folder_of, unwritten};
use yieldwall_config::{self as config, Diagnostic, Report, Severity};
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::ethercat::frame::LONGEST;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{CandumpWriter, CaptureWriter, CapturedBus, Packet};
use yieldwall_record::DeviceRecord;
use yieldwall_record::recording::{
    About, Backpressure, BlackBox, Feed, Finished, Producer, Recorded, Recorder, Saved, Sink,
};
use yieldwall_rig::report::Watch;

/// The log's first second: some readers take a time of zero for no time at all.
pub(super) const LOG_STARTS_AT: Duration = Duration::from_secs(1);
/// Cycles that wait for a thread, in s of the cycle's clock.
const RING_S: f64 = 0.5;
/// Frames that wait for a thread: about as long as the cycles.
const RING_FRAMES: usize = 8192;
/// Time after which the bus log is handed to the operating system, in ns of the bus's clock.
const FLUSH_NS: u64 = 250_000_000;

/// The file of the records.
pub(super) const MCAP: &str = "cycles.mcap";
/// The same as text.
const CSV: &str = "cycles.csv";
/// The frames of a recording: those of CAN, and those of all buses.
pub(super) const LOG: &str = "bus.log";
pub(super) const CAPTURE: &str = "bus.pcapng";

/// The description of a recording, with the commit of this program.
pub(super) fn described(about: Result<About, String>) -> Result<About, Failure> {
    let about =
        about.map_err(|error| Failure::new(Exit::Internal, format!("documents of the recording: {error}"), ""))?;
    Ok(About { commit: super::commit().to_owned(), ..about })
}

/// What is watched, with the names of its buses in logs.
#[derive(Clone, Copy, Debug)]
pub(super) enum Watched<'a> {
    /// The embedded simulation, which is faster than any disk and waits for it.
    Simulation(&'a [String]),
    /// Real interfaces, whose cycle waits for nothing.
    Interfaces(&'a [String]),
    /// Real interfaces in lockstep: time waits, and for the disk as well. A rig that has lost its bus waits for nothing else, and
    /// its cycles follow each other faster than any disk takes them.
    Lockstep(&'a [String]),
}

impl<'a> Watched<'a> {
    pub(super) fn backpressure(self) -> Backpressure {
        match self {
            Watched::Simulation(_) | Watched::Lockstep(_) => Backpressure::Wait,
            Watched::Interfaces(_) => Backpressure::Drop,
        }
    }

    fn interfaces(self) -> &'a [String] {
        match self {
            Watched::Simulation(names) | Watched::Interfaces(names) | Watched::Lockstep(names) => names,
        }
    }

    /// The buses of a rig for a capture.
    fn buses<'b>(self, rig: &'b config::Rig) -> impl Iterator<Item = CapturedBus<'b>>
    where
        'a: 'b,
    {
        rig.buses.iter().enumerate().map(move |(number, (name, bus))| CapturedBus {
            name,
            is_segment: bus.canopen().is_none(),
            interface: match self {
                Watched::Simulation(_) => None,
                Watched::Interfaces(names) | Watched::Lockstep(names) => names.get(number).map(String::as_str),
            },
        })
    }
}

/// The files that a run has to leave.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wanted<'a> {
    /// Frames of CAN.
    pub(super) candump: Option<&'a Path>,
    /// Frames of all buses.
    pub(super) pcapng: Option<&'a Path>,
    /// The folder of a recording.
    pub(super) record: Option<&'a Path>,
    /// The folder of black boxes.
    pub(super) black_box: Option<&'a Path>,
}

/// Files under way.
pub(super) struct Keep {
    buses: Vec<String>,
    files: Vec<(PathBuf, &'static str, Feed<()>)>,
    /// Impedance devices have no faults.
    black_box: Option<Feed<Vec<Saved>>>,
}

/// A file that a run left.
struct RunFile {
    path: PathBuf,
    what: &'static str,
    end: Finished<()>,
}

/// What a run left.
pub(super) struct RunFiles {
    /// Names of the buses.
    buses: Vec<String>,
    files: Vec<RunFile>,
    black_boxes: Vec<Saved>,
}

impl Keep {
    /// Makes the files, and what has to watch the rig for them.
    pub(super) fn start(
        watched: Watched<'_>,
        rig: &config::Rig,
        about: &About,
        wanted: &Wanted<'_>,
    ) -> Result<(Self, Watch), Failure> {
        let Wanted { candump, pcapng, record, black_box } = *wanted;
        let period_s = f64::from(rig.cycle.period_us) * 1e-6;
        let capacity = ring(rig.cycle.period_us);
        let (mut cycles, mut frames, mut packets) = (Vec::new(), Vec::new(), Vec::new());
        let (mut files, mut logs, mut captures) = (Vec::new(), Vec::new(), Vec::new());
        if let Some(folder) = record {
            let (producer, feed) = record_into(folder, about, watched, capacity)?;
            cycles.push(producer);
            files.push((folder.join(MCAP), "cycles", feed));
            if rig.is_on_can() {
                logs.push((folder.join(LOG), true));
            }
            captures.push((folder.join(CAPTURE), true));
        }
        if let Some(path) = candump {
            make_folder_of(path)?;
            logs.push((path.to_owned(), false));
        }
        if let Some(path) = pcapng {
            make_folder_of(path)?;
            captures.push((path.to_owned(), false));
        }
        for (path, is_new) in logs {
            let log = CandumpWriter::new(create(&path, is_new)?, watched.interfaces());
            let (producer, feed) = start("bus log", watched, RING_FRAMES, FrameFile::new(log))?;
            frames.push(producer);
            files.push((path, "frames", feed));
        }
        for (path, is_new) in captures {
            let capture = CaptureWriter::new(create(&path, is_new)?, watched.buses(rig));
            let capture = capture.map_err(|error| unwritten(&path, &error))?;
            let (producer, feed) = start("capture", watched, RING_FRAMES, FrameFile::new(capture))?;
            packets.push(producer);
            files.push((path, "frames", feed));
        }
        let folder = black_box.or(record).map(Path::to_owned).or_else(|| state_folder("black-box"));
        let sink = BlackBox::new(folder, &rig.rig.name, period_s, about.clone());
        let (producer, black_box) = start("black box", watched, capacity, sink)?;
        cycles.push(producer);
        let watch = Watch {
            observer: Some(Box::new(move |record| cycles.iter_mut().for_each(|producer| producer.push(record)))),
            tap: Some(Box::new(move |time, packet| {
                if let Packet::Can(frame) = packet {
                    frames.iter_mut().for_each(|producer| producer.push(&(time, *frame)));
                }
                packets.iter_mut().for_each(|producer| producer.push(&(time, Copied::of(packet))));
            })),
            ..Watch::default()
        };
        Ok((Self { buses: bus_names(rig), files, black_box: Some(black_box) }, watch))
    }

    /// The same for an impedance device.
    pub(super) fn start_device(
        device: &config::ImpedanceDevice,
        about: &About,
        record: Option<&Path>,
    ) -> Result<(Self, impl FnMut(&DeviceRecord) + use<>), Failure> {
        let (mut samples, mut files) = (None, Vec::new());
        if let Some(folder) = record {
            let capacity = ring(device.cycle.period_us);
            let (producer, feed) = record_into(folder, about, Watched::Simulation(&[]), capacity)?;
            samples = Some(producer);
            files.push((folder.join(MCAP), "samples", feed));
        }
        let observer = move |record: &DeviceRecord| samples.iter_mut().for_each(|producer| producer.push(record));
        Ok((Self { buses: Vec::new(), files, black_box: None }, observer))
    }

    /// Waits until everything is in its file.
    pub(super) fn finish(self) -> Result<RunFiles, Failure> {
        let mut files = Vec::new();
        for (path, what, feed) in self.files {
            files.push(RunFile { path, what, end: finish(feed)? });
        }
        let black_boxes = match self.black_box {
            Some(feed) => finish(feed)?.report,
            None => Vec::new(),
        };
        Ok(RunFiles { buses: self.buses, files, black_boxes })
    }
}

/// Records that wait for a thread.
pub(super) fn ring(period_us: u32) -> usize {
    (RING_S / (f64::from(period_us) * 1e-6)).ceil().clamp(64.0, 65_536.0) as usize
}

/// Has records go into a folder, which is made; never over another recording.
fn record_into<T: Recorded>(
    folder: &Path,
    about: &About,
    watched: Watched<'_>,
    capacity: usize,
) -> Result<(Producer<T>, Feed<()>), Failure> {
    make_folder(folder)?;
    for path in [MCAP, CSV, LOG, CAPTURE].map(|name| folder.join(name)) {
        if path.symlink_metadata().is_ok() {
            let message = format!("{} is there already: nothing was run", path.display());
            let help = "name another folder; a recording is never written over, also not with --force";
            return Err(Failure::about_file(Exit::Usage, &path, message, help));
        }
    }
    let recorder = Recorder::<_, T>::create(folder, about).map_err(|error| unwritten(&folder.join(MCAP), &error))?;
    start("recorder", watched, capacity, recorder)
}

fn start<T: Copy + Send + 'static, R: Send + 'static>(
    name: &str,
    watched: Watched<'_>,
    capacity: usize,
    sink: impl Sink<T, Report = R>,
) -> Result<(Producer<T>, Feed<R>), Failure> {
    Feed::start(name, capacity, watched.backpressure(), sink)
        .map_err(|error| Failure::new(Exit::Internal, format!("thread of the {name}: {error}"), ""))
}

fn finish<R: Send + 'static>(feed: Feed<R>) -> Result<Finished<R>, Failure> {
    feed.finish().map_err(|error| Failure::new(Exit::Internal, error.to_string(), ""))
}

/// `$XDG_STATE_HOME/yieldwall/NAME`, by default below `~/.local/state`; `None` without a home.
pub(super) fn state_folder(name: &str) -> Option<PathBuf> {
    let of = |variable| std::env::var_os(variable).map(PathBuf::from).filter(|path: &PathBuf| path.is_absolute());
    let state = of("XDG_STATE_HOME").or_else(|| of("HOME").map(|home| home.join(".local/state")))?;
    Some(state.join("yieldwall").join(name))
}

impl RunFiles {
    /// A line for each file.
    pub(super) fn lines(&self) -> Vec<String> {
        let files = self.files.iter().filter(|file| file.what != "frames").map(|file| {
            let (kept, what) = (file.end.counts.kept, file.what);
            format!("recorded  {kept} {what} into {}", file.path.display())
        });
        let boxes = self.black_boxes.iter().filter_map(|saved| {
            let path = saved.file.as_ref().ok()?;
            Some(format!(
                "kept      black box of {} at {}: {}",
                saved.cause.fault.row().name,
                when(saved),
                path.display()
            ))
        });
        files.chain(boxes).collect()
    }

    /// What was lost by a slow disk, or of what nobody asked for.
    pub(super) fn warnings(&self) -> Vec<Diagnostic> {
        let warning = |file: &str, message: String, help: &str| Diagnostic {
            severity: Severity::Warning,
            ..Diagnostic::about_file(file, message, help)
        };
        let slow = self.files.iter().filter(|file| file.end.counts.lost() > 0 && file.end.error.is_none());
        let files = slow.map(|file| Diagnostic {
            severity: Severity::Warning,
            ..lost(file, "the disk was too slow", "the run itself went on; record to a faster disk")
        });
        let boxes = self.black_boxes.iter().filter_map(|saved| {
            let error = saved.file.as_ref().err()?;
            let message = format!("no black box of {} at {}: {error}", saved.cause.fault.row().name, when(saved));
            Some(warning("", message, "name a folder that can be written with --black-box"))
        });
        files.chain(boxes).collect()
    }

    /// What was asked for and could not be written.
    ///
    /// # Errors
    /// If there is such a file.
    pub(super) fn is_written(&self) -> Result<(), Failure> {
        let help = "the run itself went on; make room on the disk, or name a file on another one";
        let unwritten = self.files.iter().filter_map(|file| Some((file, file.end.error.as_ref()?)));
        let diagnostics: Vec<Diagnostic> =
            unwritten.map(|(file, error)| lost(file, &error.to_string(), help)).collect();
        if diagnostics.is_empty() { Ok(()) } else { Err(Failure { exit: Exit::Usage, report: Report { diagnostics } }) }
    }

    /// The failure, its help with the black box of the last fault.
    pub(super) fn point_to_black_box(&self, mut failure: Failure) -> Failure {
        let file = self.black_boxes.last().and_then(|saved| saved.file.as_ref().ok());
        if let (Some(file), Some(finding)) = (file, failure.report.diagnostics.last_mut()) {
            let path = format!("what happened around it is in {}", file.display());
            finding.help = Some(match finding.help.take() {
                Some(help) if !help.is_empty() => format!("{help}; {path}"),
                _ => path,
            });
        }
        failure
    }

    pub(super) fn files_json(&self) -> Value {
        let file = |file: &RunFile| {
            let counts = file.end.counts;
            json!({
                "file": file.path,
                "what": file.what,
                "kept": counts.kept,
                "dropped": counts.dropped,
                "refused": counts.refused,
                "error": file.end.error.as_ref().map(ToString::to_string),
            })
        };
        self.files.iter().map(file).collect()
    }

    pub(super) fn black_boxes_json(&self) -> Value {
        let saved = |saved: &Saved| {
            json!({
                "fault": saved.cause.fault.row().name,
                "where": describe(saved.cause, &self.buses),
                "state": format!("{:?}", saved.state),
                "time_s": saved.scene_time_s.is_finite().then_some(saved.scene_time_s),
                "file": saved.file.as_ref().ok(),
                "error": saved.file.as_ref().err().map(ToString::to_string),
            })
        };
        self.black_boxes.iter().map(saved).collect()
    }
}

/// What a file has lost, and why.
fn lost(file: &RunFile, why: &str, help: &str) -> Diagnostic {
    let (counts, what) = (file.end.counts, file.what);
    let all = counts.kept + counts.lost();
    let path = file.path.display().to_string();
    let message = format!("{path}: {} of {all} {what} are lost: {why}", counts.lost());
    Diagnostic::about_file(path, message, help)
}

fn when(saved: &Saved) -> String {
    if saved.scene_time_s.is_finite() { format!("{:.3} s", saved.scene_time_s) } else { "enabling".to_owned() }
}

/// Makes a file, or empties one that need not be new.
fn create(path: &Path, is_new: bool) -> Result<BufWriter<File>, Failure> {
    let mut options = OpenOptions::new();
    let file = options.write(true).create(true).create_new(is_new).truncate(!is_new).open(path);
    Ok(BufWriter::new(file.map_err(|error| unwritten(path, &error))?))
}

/// A frame that waits for the thread that writes it, with room for the longest one: the cycle allocates nothing.
#[derive(Clone, Copy)]
struct Copied {
    /// The frame, if it is one of CAN.
    can: Option<Frame>,
    bus: BusId,
    length: usize,
    bytes: [u8; LONGEST],
}

impl Copied {
    /// Real-time: yes.
    fn of(packet: Packet<'_>) -> Self {
        let mut copied = Self { can: None, bus: BusId::FIRST, length: 0, bytes: [0; LONGEST] };
        match packet {
            Packet::Can(frame) => copied.can = Some(*frame),
            Packet::Ethernet { bus, bytes } => {
                (copied.bus, copied.length) = (bus, bytes.len().min(LONGEST));
                copied.bytes.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
            }
        }
        copied
    }

    fn packet(&self) -> Packet<'_> {
        match &self.can {
            Some(frame) => Packet::Can(frame),
            None => Packet::Ethernet { bus: self.bus, bytes: self.bytes.get(..self.length).unwrap_or_default() },
        }
    }
}

/// A form in which frames go into a file.
trait Format<T>: Send + 'static {
    fn write(&mut self, time: Time, frame: &T) -> io::Result<()>;
    fn flush(&mut self) -> io::Result<()>;
}

impl Format<Frame> for CandumpWriter<BufWriter<File>> {
    fn write(&mut self, time: Time, frame: &Frame) -> io::Result<()> {
        self.record(time, frame)
    }

    fn flush(&mut self) -> io::Result<()> {
        CandumpWriter::flush(self)
    }
}

impl Format<Copied> for CaptureWriter<BufWriter<File>> {
    fn write(&mut self, time: Time, frame: &Copied) -> io::Result<()> {
        self.record(time, frame.packet())
    }

    fn flush(&mut self) -> io::Result<()> {
        CaptureWriter::flush(self)
    }
}

/// Frames into a file.
struct FrameFile<F> {
    format: F,
    stretch: u64,
    written: u64,
    stored: u64,
}

impl<F> FrameFile<F> {
    fn new(format: F) -> Self {
        Self { format, stretch: 0, written: 0, stored: 0 }
    }
}

impl<T, F: Format<T>> Sink<(Time, T)> for FrameFile<F> {
    type Report = ();

    fn take(&mut self, (time, frame): &(Time, T)) -> io::Result<()> {
        let stretch = time.0 / FLUSH_NS;
        if stretch != self.stretch {
            self.stretch = stretch;
            Sink::<(Time, T)>::finish(self)?;
        }
        self.format.write(*time + LOG_STARTS_AT, frame)?;
        self.written += 1;
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        self.format.flush()?;
        self.stored = self.written;
        Ok(())
    }

    fn stored(&self) -> u64 {
        self.stored
    }

    fn report(self) {}
}
