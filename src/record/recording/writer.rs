//! Records to files.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};

use super::feed::Sink;
use super::forms;
use crate::record::CycleRecord;

/// Time after which a chunk is closed and handed to the operating system, in ns of the cycle's clock: what is lost
/// when the program is killed. Not of the wall clock, so that the same run gives the same bytes.
pub(super) const CHUNK_NS: u64 = 250_000_000;
/// Size at which a chunk is closed earlier, in bytes.
const CHUNK_BYTES: u64 = 256 << 10;

/// Name of the metadata record.
pub(super) const ABOUT: &str = "yieldwall";
/// Name of the message definition.
pub(super) const SCHEMA: &str = "yieldwall_msgs/msg/Cycle";
const SCHEMA_ENCODING: &str = "ros2msg";
pub(super) const TOPIC: &str = "/cycle";
const MESSAGE_ENCODING: &str = "cdr";

/// What a recording says of the run besides its cycles: enough to run them again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct About {
    /// Version of the program that made the recording.
    pub version: String,
    /// Commit that the program was built from, with `-dirty` if the tree was changed; empty if not known.
    pub commit: String,
    /// What it was built for, as the compiler names it: processor, system and C library; empty if not known.
    pub target: String,
    /// The rig as a document, with the fixture that it ran with and `scene.yaml` as its scene.
    pub rig: String,
    /// The scene as a document.
    pub scene: String,
    /// Seed of the run.
    pub seed: u64,
    /// What was asked for in place of what the documents say, as on the command line; may be empty.
    pub overrides: String,
}

impl About {
    fn metadata(&self) -> Metadata {
        let entry = |key: &str, value: &str| (key.to_owned(), value.to_owned());
        let metadata = BTreeMap::from([
            entry("version", &self.version),
            entry("commit", &self.commit),
            entry("target", &self.target),
            entry("rig.yaml", &self.rig),
            entry("scene.yaml", &self.scene),
            entry("seed", &self.seed.to_string()),
            entry("overrides", &self.overrides),
        ]);
        Metadata { name: ABOUT.to_owned(), metadata }
    }

    /// `None` if something is missing.
    pub(super) fn of(mut metadata: BTreeMap<String, String>) -> Option<Self> {
        let mut take = |key| metadata.remove(key);
        Some(Self {
            version: take("version")?,
            commit: take("commit").unwrap_or_default(),
            target: take("target").unwrap_or_default(),
            rig: take("rig.yaml")?,
            scene: take("scene.yaml")?,
            seed: take("seed")?.parse().ok()?,
            overrides: take("overrides")?,
        })
    }
}

/// Writes an MCAP file from its begin to its end.
pub struct Writer<W: Write> {
    mcap: mcap::Writer<NoSeek<BufWriter<W>>>,
    channel: u16,
    message: Vec<u8>,
    /// Number of the present chunk's stretch of time.
    stretch: Option<u64>,
    written: u64,
    stored: u64,
}

impl<W: Write> Writer<W> {
    /// A file that says what `about` says and has no cycles yet.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(out: W, about: &About) -> io::Result<Self> {
        let options = mcap::WriteOptions::new()
            // Chunks are put together in memory and written whole.
            .disable_seeking(true)
            .chunk_size(Some(CHUNK_BYTES))
            .profile("ros2")
            .library(concat!("yieldwall ", env!("CARGO_PKG_VERSION")));
        let mut mcap = options.create(NoSeek::new(BufWriter::new(out))).map_err(io_error)?;
        mcap.write_metadata(&about.metadata()).map_err(io_error)?;
        let schema = mcap.add_schema(SCHEMA, SCHEMA_ENCODING, forms::definition().as_bytes()).map_err(io_error)?;
        let channel = mcap.add_channel(schema, TOPIC, MESSAGE_ENCODING, &BTreeMap::new()).map_err(io_error)?;
        mcap.flush().map_err(io_error)?;
        Ok(Self { mcap, channel, message: Vec::new(), stretch: None, written: 0, stored: 0 })
    }

    /// Appends a cycle.
    ///
    /// # Errors
    /// Those of the file; nothing can be appended afterwards.
    pub fn write(&mut self, record: &CycleRecord) -> io::Result<()> {
        let stretch = Some(record.moment.sync_ns / CHUNK_NS);
        if self.stretch != stretch {
            self.flush()?;
            self.stretch = stretch;
        }
        forms::encode(record, &mut self.message);
        let header = MessageHeader {
            channel_id: self.channel,
            sequence: record.moment.index as u32,
            log_time: record.moment.sync_ns,
            publish_time: record.moment.compute_ns,
        };
        self.mcap.write_to_known_channel(&header, &self.message).map_err(io_error)?;
        self.written += 1;
        Ok(())
    }

    /// Closes the chunk and hands everything to the operating system.
    ///
    /// # Errors
    /// Those of the file.
    pub fn flush(&mut self) -> io::Result<()> {
        self.mcap.flush().map_err(io_error)?;
        self.stored = self.written;
        Ok(())
    }

    /// Cycles that were handed to the operating system.
    pub fn stored(&self) -> u64 {
        self.stored
    }

    /// Writes what belongs at the end.
    ///
    /// # Errors
    /// Those of the file.
    pub fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        self.mcap.finish().map_err(io_error).map(|_| ())
    }
}

fn io_error(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

/// Writes the cycles into a folder: `cycles.mcap`, and the same as text in `cycles.csv`.
pub struct Recorder<W: Write> {
    mcap: Writer<W>,
    csv: BufWriter<W>,
    row: String,
    stretch: u64,
}

impl Recorder<File> {
    /// Makes both files in `folder`, which must be there.
    ///
    /// # Errors
    /// If one of them is there already, and those of the file system.
    pub fn create(folder: &Path, about: &About) -> io::Result<Self> {
        Self::new(create_new(&folder.join("cycles.mcap"))?, create_new(&folder.join("cycles.csv"))?, about)
    }
}

/// Makes a file that is not there yet, not even as a link.
pub(super) fn create_new(path: &Path) -> io::Result<File> {
    let result = OpenOptions::new().write(true).create_new(true).open(path);
    result.map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", path.display())))
}

impl<W: Write> Recorder<W> {
    /// Writes the cycles to `mcap` and, as text, to `csv`.
    ///
    /// # Errors
    /// Those of the two.
    pub fn new(mcap: W, csv: W, about: &About) -> io::Result<Self> {
        let mut csv = BufWriter::new(csv);
        writeln!(csv, "{}", forms::csv_header())?;
        Ok(Self { mcap: Writer::new(mcap, about)?, csv, row: String::new(), stretch: 0 })
    }
}

impl<W: Write + Send + 'static> Sink<CycleRecord> for Recorder<W> {
    type Report = ();

    fn take(&mut self, record: &CycleRecord) -> io::Result<()> {
        self.mcap.write(record)?;
        let stretch = record.moment.sync_ns / CHUNK_NS;
        if stretch != self.stretch {
            self.stretch = stretch;
            self.csv.flush()?;
        }
        forms::csv_row(record, &mut self.row);
        self.row.push('\n');
        self.csv.write_all(self.row.as_bytes())
    }

    fn finish(&mut self) -> io::Result<()> {
        let text = self.csv.flush();
        self.mcap.finish().and(text)
    }

    fn stored(&self) -> u64 {
        self.mcap.stored()
    }

    fn report(self) {}
}
