//! Records to files.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::marker::PhantomData;
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::write::NoSeek;

use super::about::About;
use super::feed::Sink;
use super::forms;
use super::recorded::Recorded;
use crate::CycleRecord;

/// Time after which a chunk is closed and handed to the operating system, in ns of the cycle's clock: what is lost
/// when the program is killed. Not of the wall clock, so that the same run gives the same bytes.
pub(super) const CHUNK_NS: u64 = 250_000_000;
/// Size at which a chunk is closed earlier, in bytes.
const CHUNK_BYTES: u64 = 256 << 10;

const SCHEMA_ENCODING: &str = "ros2msg";
const MESSAGE_ENCODING: &str = "cdr";

/// Writes an MCAP file of records from its begin to its end.
pub struct Writer<W: Write, T = CycleRecord> {
    mcap: mcap::Writer<NoSeek<BufWriter<W>>>,
    channel: u16,
    message: Vec<u8>,
    /// Number of the present chunk's stretch of time.
    stretch: Option<u64>,
    written: u64,
    stored: u64,
    records: PhantomData<fn(T)>,
}

impl<W: Write, T: Recorded> Writer<W, T> {
    /// Starts a file with the description `about` and without cycles.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn new(out: W, about: &About) -> io::Result<Self> {
        let options = mcap::WriteOptions::new()
            // Chunks are put together in memory and written whole.
            .disable_seeking(true)
            .chunk_size(Some(CHUNK_BYTES))
            .profile("ros2")
            .library(concat!("yieldwall ", env!("CARGO_PKG_VERSION")));
        let mut mcap = options.create(NoSeek::new(BufWriter::new(out))).map_err(io_error)?;
        mcap.write_metadata(&about.metadata()).map_err(io_error)?;
        let schema =
            mcap.add_schema(T::SCHEMA, SCHEMA_ENCODING, forms::definition::<T>().as_bytes()).map_err(io_error)?;
        let channel = mcap.add_channel(schema, T::TOPIC, MESSAGE_ENCODING, &BTreeMap::new()).map_err(io_error)?;
        mcap.flush().map_err(io_error)?;
        Ok(Self { mcap, channel, message: Vec::new(), stretch: None, written: 0, stored: 0, records: PhantomData })
    }

    /// Appends a cycle.
    ///
    /// # Errors
    /// Errors of the file; nothing can be appended afterwards.
    pub fn write(&mut self, record: &T) -> io::Result<()> {
        let stretch = Some(record.begun_ns() / CHUNK_NS);
        if self.stretch != stretch {
            self.flush()?;
            self.stretch = stretch;
        }
        forms::encode(record, &mut self.message);
        let header = MessageHeader {
            channel_id: self.channel,
            sequence: record.index() as u32,
            log_time: record.begun_ns(),
            publish_time: record.complete_ns(),
        };
        self.mcap.write_to_known_channel(&header, &self.message).map_err(io_error)?;
        self.written += 1;
        Ok(())
    }

    /// Closes the chunk and hands everything to the operating system.
    ///
    /// # Errors
    /// Errors of the file.
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
    /// Errors of the file.
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
pub struct Recorder<W: Write, T = CycleRecord> {
    mcap: Writer<W, T>,
    csv: BufWriter<W>,
    row: String,
    stretch: u64,
}

impl<T: Recorded> Recorder<File, T> {
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

impl<W: Write, T: Recorded> Recorder<W, T> {
    /// Writes the cycles to `mcap` and, as text, to `csv`.
    ///
    /// # Errors
    /// Errors of both.
    pub fn new(mcap: W, csv: W, about: &About) -> io::Result<Self> {
        let mut csv = BufWriter::new(csv);
        writeln!(csv, "{}", forms::csv_header::<T>())?;
        Ok(Self { mcap: Writer::new(mcap, about)?, csv, row: String::new(), stretch: 0 })
    }
}

impl<W: Write + Send + 'static, T: Recorded> Sink<T> for Recorder<W, T> {
    type Report = ();

    fn take(&mut self, record: &T) -> io::Result<()> {
        self.mcap.write(record)?;
        let stretch = record.begun_ns() / CHUNK_NS;
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
