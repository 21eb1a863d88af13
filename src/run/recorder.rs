//! The files that a rig leaves while it runs: recording, logs of the buses, black boxes.
//!
//! ```text
//! Watch::observer  CycleRecord --ring--> thread --> cycles.mcap, cycles.csv
//!                              --ring--> thread --> black box, around a fault
//! Watch::tap       Packet      --ring--> thread --> bus.log, bus.pcapng
//! ```
//! The cycle copies into rings and waits for no disk, unless time waits too.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::Duration;

use thiserror::Error;

use crate::Watch;
use yieldwall_config as config;
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::ethercat::frame::LONGEST;
use yieldwall_fieldbus::time::Time;
use yieldwall_link::{CandumpWriter, CaptureWriter, CapturedBus, Packet};
use yieldwall_record::DeviceRecord;
use yieldwall_record::recording::{
    About, Backpressure, BlackBox, Feed, Finished, Producer, Recorded, Recorder, Saved, Sink,
};

/// Time of the first frame in a log: some readers take a time of zero for no time at all.
pub const LOG_STARTS_AT: Duration = Duration::from_secs(1);
/// File of the records in the folder of a recording.
pub const MCAP: &str = "cycles.mcap";
/// File of the records as text.
const CSV: &str = "cycles.csv";
/// File of the CAN frames in the folder of a recording.
pub const LOG: &str = "bus.log";
/// File of the frames of all buses in the folder of a recording.
pub const CAPTURE: &str = "bus.pcapng";
/// Cycles that wait for a thread, in s of the cycle's clock.
const RING_S: f64 = 0.5;
/// Frames that wait for a thread: about as long as the cycles.
const RING_FRAMES: usize = 8192;
/// Time after which the bus log is handed to the operating system, in ns of the bus's clock.
const FLUSH_NS: u64 = 250_000_000;

/// Source of records and frames, with the names of its buses in logs.
#[derive(Clone, Copy, Debug)]
pub enum Watched<'a> {
    /// The embedded simulation, which is faster than any disk and waits for it.
    Simulation(&'a [String]),
    /// Real interfaces, whose cycle waits for nothing.
    Interfaces(&'a [String]),
    /// Real interfaces in lockstep: time waits, and for the disk as well. A rig that has lost its bus waits for nothing else, and
    /// its cycles follow each other faster than any disk takes them.
    Lockstep(&'a [String]),
}

impl<'a> Watched<'a> {
    /// Returns the back-pressure: the cycle waits for a thread that writes, or drops the records that the thread does not take.
    pub fn backpressure(self) -> Backpressure {
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

    /// Returns the buses of a rig for a capture.
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
pub struct Wanted<'a> {
    /// File of the frames of CAN.
    pub candump: Option<&'a Path>,
    /// File of the frames of all buses.
    pub pcapng: Option<&'a Path>,
    /// Folder of a recording, with the frames of all buses.
    pub record: Option<&'a Path>,
    /// Folder of black boxes; without one a fault leaves a black box that names no file.
    pub black_box: Option<&'a Path>,
}

/// Reason why the files of a run could not be made, or were not finished.
#[derive(Debug, Error)]
pub enum RecorderError {
    /// A folder cannot be made.
    #[error("folder {}: {error}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Reason.
        error: io::Error,
    },
    /// The folder of a recording holds another one already, which is never overwritten.
    #[error("{} already exists", path.display())]
    Exists {
        /// A file of that recording.
        path: PathBuf,
    },
    /// A file cannot be written.
    #[error("{} could not be written: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Reason.
        error: io::Error,
    },
    /// There is no thread that would write.
    #[error("thread of the {name}: {error}")]
    NoThread {
        /// Content of the file.
        name: &'static str,
        /// Reason.
        error: io::Error,
    },
    /// A thread that writes has panicked.
    #[error(transparent)]
    Panicked(io::Error),
}

impl RecorderError {
    fn of_file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        |error| Self::File { path: path.to_owned(), error }
    }

    fn of_folder(path: &Path) -> impl FnOnce(io::Error) -> Self {
        |error| Self::Folder { path: path.to_owned(), error }
    }
}

/// Files under way.
///
/// ```no_run
/// use yieldwall_run::Watch;
/// use yieldwall_run::recorder::{RunRecorder, Wanted, Watched};
/// # use yieldwall_config::Rig;
/// # use yieldwall_record::recording::About;
///
/// # fn record(rig: &Rig, about: &About, run: impl FnOnce(Watch)) -> Result<(), Box<dyn std::error::Error>> {
/// let interfaces = ["can0".to_owned()];
/// let wanted = Wanted { record: Some("recording".as_ref()), ..Wanted::default() };
/// let (recorder, watch) = RunRecorder::start(Watched::Interfaces(&interfaces), rig, about, &wanted)?;
/// // `RigOnBus::set_watch` takes the watch, and so does `run_rig` of a simulated rig.
/// run(watch);
/// for file in recorder.finish()?.files {
///     println!("{} {} in {}", file.end.counts.kept, file.what, file.path.display());
/// }
/// # Ok(())
/// # }
/// ```
pub struct RunRecorder {
    files: Vec<(PathBuf, &'static str, Feed<()>)>,
    /// Impedance devices have no faults.
    black_box: Option<Feed<Vec<Saved>>>,
}

/// A file that a run left.
pub struct RunFile {
    /// Its path.
    pub path: PathBuf,
    /// Content: `cycles`, `samples` or `frames`.
    pub what: &'static str,
    /// Numbers of items that were kept and lost, and the first error.
    pub end: Finished<()>,
}

/// The files that a run left.
pub struct RunFiles {
    /// Recordings and logs.
    pub files: Vec<RunFile>,
    /// Black boxes, the oldest first.
    pub black_boxes: Vec<Saved>,
}

impl RunRecorder {
    /// Creates the files, and the observers of the rig for them. It creates missing folders. Without a folder of black boxes they
    /// go into that of the recording.
    ///
    /// # Errors
    /// If a folder, a file or a thread cannot be made, or the folder has a recording already.
    pub fn start(
        watched: Watched<'_>,
        rig: &config::Rig,
        about: &About,
        wanted: &Wanted<'_>,
    ) -> Result<(Self, Watch), RecorderError> {
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
            let capture = capture.map_err(RecorderError::of_file(&path))?;
            let (producer, feed) = start("capture", watched, RING_FRAMES, FrameFile::new(capture))?;
            packets.push(producer);
            files.push((path, "frames", feed));
        }
        let folder = black_box.or(record).map(Path::to_owned);
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
        Ok((Self { files, black_box: Some(black_box) }, watch))
    }

    /// Makes the files of an impedance device, whose samples the returned closure takes.
    ///
    /// # Errors
    /// As [`RunRecorder::start`].
    pub fn start_device(
        device: &config::ImpedanceDevice,
        about: &About,
        record: Option<&Path>,
    ) -> Result<(Self, impl FnMut(&DeviceRecord) + use<>), RecorderError> {
        let (mut samples, mut files) = (None, Vec::new());
        if let Some(folder) = record {
            let capacity = ring(device.cycle.period_us);
            let (producer, feed) = record_into(folder, about, Watched::Simulation(&[]), capacity)?;
            samples = Some(producer);
            files.push((folder.join(MCAP), "samples", feed));
        }
        let observer = move |record: &DeviceRecord| samples.iter_mut().for_each(|producer| producer.push(record));
        Ok((Self { files, black_box: None }, observer))
    }

    /// Waits until everything is in its file.
    ///
    /// # Errors
    /// If a thread has panicked.
    pub fn finish(self) -> Result<RunFiles, RecorderError> {
        let mut files = Vec::new();
        for (path, what, feed) in self.files {
            files.push(RunFile { path, what, end: feed.finish().map_err(RecorderError::Panicked)? });
        }
        let black_boxes = match self.black_box {
            Some(feed) => feed.finish().map_err(RecorderError::Panicked)?.report,
            None => Vec::new(),
        };
        Ok(RunFiles { files, black_boxes })
    }
}

/// Cycles of `period_us` that a ring has room for while a thread does not look.
pub fn ring(period_us: u32) -> usize {
    (RING_S / (f64::from(period_us) * 1e-6)).ceil().clamp(64.0, 65_536.0) as usize
}

fn make_folder_of(path: &Path) -> Result<(), RecorderError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.map_or(Ok(()), |folder| fs::create_dir_all(folder).map_err(RecorderError::of_folder(folder)))
}

/// Starts a recording in a folder, and makes the folder; never over another recording.
fn record_into<T: Recorded>(
    folder: &Path,
    about: &About,
    watched: Watched<'_>,
    capacity: usize,
) -> Result<(Producer<T>, Feed<()>), RecorderError> {
    fs::create_dir_all(folder).map_err(RecorderError::of_folder(folder))?;
    let mut paths = [MCAP, CSV, LOG, CAPTURE].into_iter().map(|name| folder.join(name));
    if let Some(path) = paths.find(|path| path.symlink_metadata().is_ok()) {
        return Err(RecorderError::Exists { path });
    }
    let recorder = Recorder::<_, T>::create(folder, about).map_err(RecorderError::of_file(&folder.join(MCAP)))?;
    start("recorder", watched, capacity, recorder)
}

fn start<T: Copy + Send + 'static, R: Send + 'static>(
    name: &'static str,
    watched: Watched<'_>,
    capacity: usize,
    sink: impl Sink<T, Report = R>,
) -> Result<(Producer<T>, Feed<R>), RecorderError> {
    let feed = Feed::start(name, capacity, watched.backpressure(), sink);
    feed.map_err(|error| RecorderError::NoThread { name, error })
}

/// Creates a file, or empties one that need not be new.
fn create(path: &Path, is_new: bool) -> Result<BufWriter<File>, RecorderError> {
    let mut options = OpenOptions::new();
    let file = options.write(true).create(true).create_new(is_new).truncate(!is_new).open(path);
    Ok(BufWriter::new(file.map_err(RecorderError::of_file(path))?))
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
