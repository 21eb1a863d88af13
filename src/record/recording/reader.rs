//! Files to records, whatever state the file is in.
//!
//! A file may have been cut when the program was killed, damaged on its way, or made to do harm. The reader trusts a length only if that
//! many bytes are there, and no length above a limit.

use std::collections::VecDeque;
use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::Path;

use crc32fast::Hasher;
use mcap::records::{Record, op};

use super::about::{ABOUT, About, Machine};
use super::error::ReadError;
use super::forms;
use super::recorded::Recorded;
use crate::{CycleRecord, DeviceRecord};

/// Largest chunk that is read, bytes.
const MAX_CHUNK: u64 = 64 << 20;
/// Largest record outside of chunks that is read, bytes; two documents of at most 1 MiB fit.
const MAX_RECORD: u64 = 4 << 20;
/// Bytes of a sum, of the record that ends the data, and of the last one.
const SUM_BYTES: u64 = 4;
const DATA_END_BYTES: u64 = SUM_BYTES;
const FOOTER_BYTES: u64 = 16 + SUM_BYTES;
/// Largest number of damaged places that are reported one by one.
const MAX_DAMAGE: usize = 16;

/// A place at which something of the file is lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Start of the lost or cut record, in bytes from the start of the file.
    pub offset: u64,
    /// Fault at this place.
    pub what: String,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "byte {}: {}", self.offset, self.what)
    }
}

/// Reads a recording from its begin to its end.
///
/// ```
/// use yieldwall_record::recording::Reader;
/// # use yieldwall_record::{CycleRecord, recording::{About, Recorded, Writer}};
/// # let mut file = Vec::new();
/// # let mut writer = Writer::new(&mut file, &About::default())?;
/// # writer.write(&CycleRecord::blank())?;
/// # writer.finish()?;
/// # drop(writer);
///
/// // `Reader::open` takes the path of a file.
/// let mut reader: Reader<_> = Reader::new(&file[..])?;
/// let mut greatest_n = 0.0_f64;
/// while let Some(record) = reader.next_record()? {
///     greatest_n = greatest_n.max(record.signals.force.norm());
/// }
/// # assert_eq!(greatest_n, 0.0);
/// assert!(reader.damage().is_empty());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Reader<R, T = CycleRecord> {
    input: Summed<R>,
    about: Option<About>,
    /// The channels with such records.
    channels: Vec<u16>,
    schemas: Vec<u16>,
    has_other_fields: bool,
    ready: VecDeque<T>,
    damage: Vec<Damage>,
    damage_count: u64,
    is_past_data: bool,
    is_over: bool,
    body: Vec<u8>,
}

/// Next part of the file.
enum Next {
    /// A record to look into; its content is in [`Reader::body`].
    Body {
        opcode: u8,
        offset: u64,
        is_cut: bool,
    },
    /// A record that does not matter.
    Passed,
    End,
}

/// Opens a file, whatever was recorded.
///
/// # Errors
/// If it cannot be read, or is no recording that this program can use.
pub fn open(path: &Path) -> Result<Recording<File>, ReadError> {
    let mut file = regular(path)?;
    let about = Reader::<_, CycleRecord>::described(&file)?.about;
    file.rewind()?;
    Ok(match about.map(|about| about.machine) {
        Some(Machine::Device(_)) => Recording::Device(Reader::new(file)?),
        _ => Recording::Rig(Reader::new(file)?),
    })
}

fn regular(path: &Path) -> io::Result<File> {
    // A pipe blocks for ever when it is opened.
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "is not a regular file"));
    }
    File::open(path)
}

/// A recording of any kind.
#[derive(Debug)]
pub enum Recording<R> {
    /// The cycles of a rig.
    Rig(Reader<R, CycleRecord>),
    /// The samples of an impedance device.
    Device(Reader<R, DeviceRecord>),
}

impl<R: Read> Recording<R> {
    /// Returns the description of the run.
    pub fn about(&self) -> &About {
        match self {
            Recording::Rig(reader) => reader.about(),
            Recording::Device(reader) => reader.about(),
        }
    }

    /// Returns the same as [`Reader::damage`].
    pub fn damage(&self) -> &[Damage] {
        match self {
            Recording::Rig(reader) => reader.damage(),
            Recording::Device(reader) => reader.damage(),
        }
    }

    /// Returns the same as [`Reader::damage_count`].
    pub fn damage_count(&self) -> u64 {
        match self {
            Recording::Rig(reader) => reader.damage_count(),
            Recording::Device(reader) => reader.damage_count(),
        }
    }
}

impl<T: Recorded> Reader<File, T> {
    /// Opens a file with such records.
    ///
    /// # Errors
    /// As [`open`], and if another kind of machine was recorded.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        Self::new(regular(path)?)
    }
}

impl<R: Read, T: Recorded> Reader<R, T> {
    /// Reads up to the first record.
    ///
    /// # Errors
    /// If the input cannot be read, or is no recording that this program can use, or one of another kind of machine.
    pub fn new(input: R) -> Result<Self, ReadError> {
        let mut reader = Self::described(input)?;
        reader.fill()?;
        match &reader.about {
            None => Err(ReadError::NoDescription(reader.damage.first().cloned())),
            Some(about) if !T::fits(&about.machine) => Err(ReadError::OtherMachine { name: about.machine.name() }),
            Some(_) => Ok(reader),
        }
    }

    /// Reads up to the description of the run, or to the first record or the end if there is none before.
    fn described(input: R) -> Result<Self, ReadError> {
        let mut reader = Self {
            input: Summed { input: BufReader::with_capacity(1 << 16, input), offset: 0, sum: Hasher::new() },
            about: None,
            channels: Vec::new(),
            schemas: Vec::new(),
            has_other_fields: false,
            ready: VecDeque::new(),
            damage: Vec::new(),
            damage_count: 0,
            is_past_data: false,
            is_over: false,
            body: Vec::new(),
        };
        let mut magic = [0; mcap::MAGIC.len()];
        match reader.input.read_exact(&mut magic) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Err(ReadError::NotMcap),
            other => other?,
        }
        if magic != *mcap::MAGIC {
            return Err(ReadError::NotMcap);
        }
        reader.read_until(|reader| reader.about.is_some() || !reader.ready.is_empty())?;
        Ok(reader)
    }

    /// Returns the recording's description of the run.
    pub fn about(&self) -> &About {
        static NOTHING: std::sync::LazyLock<About> = std::sync::LazyLock::new(About::default);
        // A reader that was made has one.
        self.about.as_ref().unwrap_or(&NOTHING)
    }

    /// Returns the next record; `None` at the end.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn next_record(&mut self) -> Result<Option<T>, ReadError> {
        self.fill()?;
        Ok(self.ready.pop_front())
    }

    /// Returns the first places at which something is lost, as far as was read.
    pub fn damage(&self) -> &[Damage] {
        &self.damage
    }

    /// Returns the number of places at which something is lost, as far as was read.
    pub fn damage_count(&self) -> u64 {
        self.damage_count
    }

    /// Reads until there is a record, or the file ends.
    fn fill(&mut self) -> Result<(), ReadError> {
        self.read_until(|reader| !reader.ready.is_empty())
    }

    fn read_until(&mut self, is_enough: impl Fn(&Self) -> bool) -> Result<(), ReadError> {
        while !is_enough(self) && !self.is_over {
            match self.read_record()? {
                Next::End => self.is_over = true,
                Next::Passed => {}
                Next::Body { opcode, offset, is_cut } => {
                    let body = std::mem::take(&mut self.body);
                    self.take_record(opcode, &body, offset, is_cut);
                    self.body = body;
                    self.is_over |= is_cut;
                }
            }
            if self.has_other_fields {
                let version = self.about.as_ref().map_or("unknown", |about| &about.version).to_owned();
                return Err(ReadError::OtherFields { version });
            }
        }
        Ok(())
    }

    fn lose(&mut self, offset: u64, what: impl Into<String>) {
        self.damage_count += 1;
        if self.damage.len() < MAX_DAMAGE {
            self.damage.push(Damage { offset, what: what.into() });
        }
    }

    /// Reads a record outside of chunks; what is in a chunk comes as one record.
    fn read_record(&mut self) -> Result<Next, ReadError> {
        let (offset, sum) = (self.input.offset, self.input.sum.clone());
        let mut head = Vec::with_capacity(9);
        (&mut self.input).take(9).read_to_end(&mut head)?;
        let [opcode, length @ ..] = head.as_slice() else {
            self.lose(offset, "the file ends without its index: it was not closed");
            return Ok(Next::End);
        };
        let Ok(length) = <[u8; 8]>::try_from(length).map(u64::from_le_bytes) else {
            self.lose(offset, "the file is cut in the head of a record");
            return Ok(Next::End);
        };
        let opcode = *opcode;
        let limit = match opcode {
            op::FOOTER => {
                self.take_footer(offset, length)?;
                return Ok(Next::End);
            }
            op::DATA_END if length == DATA_END_BYTES => {
                let mut said = [0; DATA_END_BYTES as usize];
                if self.input.read_exact(&mut said).is_err() {
                    self.lose(offset, "the file is cut in a record");
                    return Ok(Next::End);
                }
                // What is damaged in a chunk has been told.
                if !sum_fits(sum, said) && self.damage_count == 0 {
                    self.lose(offset, "what is before this is damaged: its sum does not fit");
                }
                self.is_past_data = true;
                self.input.sum = Hasher::new();
                return Ok(Next::Passed);
            }
            op::CHUNK if !self.is_past_data => MAX_CHUNK,
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA if !self.is_past_data => MAX_RECORD,
            // Also the index at the end, which is not used.
            _ => {
                self.is_past_data |= opcode == op::DATA_END;
                let passed = io::copy(&mut (&mut self.input).take(length), &mut io::sink())?;
                if passed < length {
                    self.lose(offset, "the file is cut in a record");
                    return Ok(Next::End);
                }
                return Ok(Next::Passed);
            }
        };
        if length > limit {
            self.lose(offset, format!("a record of {length} bytes is larger than the {limit} that are read"));
            return Ok(Next::End);
        }
        self.body.clear();
        let read = (&mut self.input).take(length).read_to_end(&mut self.body)? as u64;
        Ok(Next::Body { opcode, offset, is_cut: read < length })
    }

    /// Returns the rest of the last record, and what may be behind it.
    fn take_footer(&mut self, offset: u64, length: u64) -> io::Result<()> {
        // Two places in the file, then the sum of the index and of all this up to the sum.
        let mut rest = Vec::new();
        (&mut self.input).take(FOOTER_BYTES - SUM_BYTES).read_to_end(&mut rest)?;
        let sum = self.input.sum.clone();
        let mut said = [0; SUM_BYTES as usize];
        let mut magic = [0; mcap::MAGIC.len()];
        let read = self.input.read_exact(&mut said).and_then(|()| self.input.read_exact(&mut magic));
        if length != FOOTER_BYTES || read.is_err() || magic != *mcap::MAGIC {
            self.lose(offset, "the file is cut or damaged in its last record");
        } else if !sum_fits(sum, said) {
            self.lose(offset, "the index at the end is damaged: its sum does not fit");
        }
        let end = self.input.offset;
        if (&mut self.input).take(1).read_to_end(&mut rest)? > 0 {
            self.lose(end, "there is more behind the end of the recording");
        }
        Ok(())
    }

    fn take_record(&mut self, opcode: u8, body: &[u8], offset: u64, is_cut: bool) {
        match opcode {
            op::CHUNK => self.take_chunk(body, offset, is_cut),
            _ if is_cut => self.lose(offset, "the file is cut in a record"),
            op::MESSAGE => self.take_message(body, offset),
            op::SCHEMA | op::CHANNEL | op::METADATA => match mcap::parse_record(opcode, body) {
                Ok(Record::Metadata(metadata)) if metadata.name == ABOUT && self.about.is_none() => {
                    self.about = About::of(metadata.metadata);
                    if self.about.as_ref().is_some_and(|about| about.is_damaged) {
                        self.lose(offset, "the description of what was recorded is damaged: its sum does not fit");
                    }
                }
                Ok(Record::Schema { header, data }) if header.name == T::SCHEMA => {
                    self.has_other_fields |= *data != *forms::definition::<T>().as_bytes();
                    if !self.schemas.contains(&header.id) {
                        self.schemas.push(header.id);
                    }
                }
                Ok(Record::Channel(channel))
                    if self.schemas.contains(&channel.schema_id) && channel.topic == T::TOPIC =>
                {
                    if !self.channels.contains(&channel.id) {
                        self.channels.push(channel.id);
                    }
                }
                Ok(_) => {}
                Err(error) => self.lose(offset, error.to_string()),
            },
            _ => {}
        }
    }

    fn take_chunk(&mut self, body: &[u8], offset: u64, is_cut: bool) {
        let Some(chunk) = Chunk::of(body) else {
            return self.lose(offset, "a chunk is cut in its head");
        };
        if !chunk.compression.is_empty() {
            let name = String::from_utf8_lossy(chunk.compression.get(..16).unwrap_or(chunk.compression)).into_owned();
            return self.lose(offset, format!("a chunk is compressed ({name:?}), which this program does not read"));
        }
        if is_cut {
            self.lose(
                offset,
                "the file is cut in a chunk; its last cycles are lost, the others not checked by its sum",
            );
        } else if chunk.length != chunk.records.len() as u64 {
            return self.lose(offset, "a chunk has another length than it says");
        } else if chunk.crc != 0 && crc32fast::hash(chunk.records) != chunk.crc {
            return self.lose(offset, "a chunk is damaged: its sum does not fit");
        }
        let mut rest = chunk.records;
        while let Some((head, behind)) = rest.split_at_checked(9) {
            let length = head.iter().skip(1).rev().fold(0, |length, byte| length << 8 | u64::from(*byte));
            let body = usize::try_from(length).ok().and_then(|length| behind.split_at_checked(length));
            let Some((body, behind)) = body else { break };
            if let [opcode @ (op::MESSAGE | op::SCHEMA | op::CHANNEL), ..] = head {
                self.take_record(*opcode, body, offset, false);
            }
            rest = behind;
        }
        if !rest.is_empty() && !is_cut {
            self.lose(offset, "a chunk ends within a record");
        }
    }

    fn take_message(&mut self, body: &[u8], offset: u64) {
        // Channel, sequence, two times.
        let Some((head, data)) = body.split_at_checked(22) else {
            return self.lose(offset, "a message is cut in its head");
        };
        let [low, high, ..] = head else { return };
        if !self.channels.contains(&u16::from_le_bytes([*low, *high])) {
            return;
        }
        match forms::decode(data) {
            Ok(record) => self.ready.push_back(record),
            Err(error) => self.lose(offset, error.to_string()),
        }
    }
}

/// Whether a sum is the one that a file says; zero says none.
fn sum_fits(sum: Hasher, said: [u8; SUM_BYTES as usize]) -> bool {
    let said = u32::from_le_bytes(said);
    said == 0 || sum.finalize() == said
}

/// Input that is counted and summed up.
#[derive(Debug)]
struct Summed<R> {
    input: BufReader<R>,
    /// Bytes read.
    offset: u64,
    /// Sum of those since it was made anew.
    sum: Hasher,
}

impl<R: Read> Read for Summed<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(bytes)?;
        self.sum.update(bytes.get(..count).unwrap_or_default());
        self.offset += count as u64;
        Ok(count)
    }
}

struct Chunk<'a> {
    crc: u32,
    compression: &'a [u8],
    length: u64,
    records: &'a [u8],
}

impl<'a> Chunk<'a> {
    /// Reads it from the body of its record; `None` if that ends within the chunk's head.
    fn of(body: &'a [u8]) -> Option<Self> {
        // Begin, end, size of the records; their sum; name and size of the compressed form.
        let (head, rest) = body.split_at_checked(32)?;
        let crc = u32::from_le_bytes(head.get(24..28)?.try_into().ok()?);
        let name = u32::from_le_bytes(head.get(28..32)?.try_into().ok()?);
        let (compression, rest) = rest.split_at_checked(usize::try_from(name).ok()?)?;
        let (length, records) = rest.split_at_checked(8)?;
        Some(Self { crc, compression, length: u64::from_le_bytes(length.try_into().ok()?), records })
    }
}
