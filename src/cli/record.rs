//! `yieldwall record`: the contents of a recording, its text export, and the repair of a damaged one.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use serde_json::json;

use super::failure::{Exit, Failure};
use super::output::Output;
use super::replace::{Replace, discard, unwritten};
use super::replay::{damage, open, read_failure, recording_file, records};
use yieldwall_link::{Whole, whole_blocks};
use yieldwall_record::recording::{Machine, Reader, Recorded, Recording, Writer, csv_header, csv_row, definition};
use yieldwall_record::{CycleRecord, DeviceRecord};
use yieldwall_run::recorder::{CAPTURE, LOG};

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Show a recording's contents: cycles, time, gaps, damage
    Info {
        /// Recording: a cycles.mcap, its folder, or a black-box file
        #[arg(value_name = "RECORDING")]
        file: PathBuf,
        /// Also print the message definition: each field with its unit
        #[arg(long)]
        schema: bool,
    },
    /// Repair a cut or damaged recording: write its readable part to a new one
    ///
    /// If RECORDING is a folder with a cut bus.pcapng or bus.log, the command also copies their whole frames. They go to
    /// bus.repaired.pcapng and bus.repaired.log beside the new recording.
    Repair {
        /// Recording: a cycles.mcap, its folder, or a black-box file
        #[arg(value_name = "RECORDING")]
        file: PathBuf,
        /// New file; default: FILE with .repaired before its extension
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Export a recording's cycles as text, like the cycles.csv of `run --record`
    Export {
        /// Recording: a cycles.mcap, its folder, or a black-box file
        #[arg(value_name = "RECORDING")]
        file: PathBuf,
        /// New file; default: RECORDING with the extension .csv
        #[arg(long, value_name = "FILE")]
        csv: Option<PathBuf>,
        #[command(flatten)]
        replace: Replace,
    },
}

pub(super) fn run(command: &Command, output: &mut Output) -> Result<(), Failure> {
    match command {
        Command::Info { file, schema } => info(&recording_file(file), *schema, output),
        Command::Repair { file, out } => repair(file, out.as_deref(), output),
        Command::Export { file, csv, replace } => export(&recording_file(file), csv.as_deref(), *replace, output),
    }
}

/// Common properties of the records of a recording.
#[derive(Default)]
struct Content {
    count: u64,
    /// Number and begin in ns of the first and the last one.
    ends: Option<[(u64, u64); 2]>,
    gaps: u64,
    missing: u64,
}

impl Content {
    fn take<T: Recorded>(&mut self, record: &T) {
        let this = (record.index(), record.begun_ns());
        let [first, last] = self.ends.unwrap_or([this; 2]);
        let missing = this.0.saturating_sub(last.0).saturating_sub(1);
        self.gaps += u64::from(missing > 0);
        self.missing = self.missing.saturating_add(missing);
        self.count += 1;
        self.ends = Some([first, this]);
    }

    /// Returns the first and last number, with times in s.
    fn ends(&self) -> Option<[(u64, f64); 2]> {
        Some(self.ends?.map(|(index, begun_ns)| (index, begun_ns as f64 * 1e-9)))
    }
}

/// Goes over all records.
fn go_over<T: Recorded>(
    reader: &mut Reader<File, T>,
    file: &Path,
    mut each: impl FnMut(&T) -> Result<(), Failure>,
) -> Result<Content, Failure> {
    let mut content = Content::default();
    while let Some(record) = reader.next_record().map_err(|error| read_failure(file, &error))? {
        content.take(&record);
        each(&record)?;
    }
    Ok(content)
}

fn info(file: &Path, schema: bool, output: &mut Output) -> Result<(), Failure> {
    let mut recording = open(file)?;
    let (content, definition, since) = match &mut recording {
        Recording::Rig(reader) => (go_over(reader, file, |_| Ok(()))?, definition::<CycleRecord>(), "switching on"),
        Recording::Device(reader) => {
            (go_over(reader, file, |_| Ok(()))?, definition::<DeviceRecord>(), "the scene began")
        }
    };
    let definition = schema.then_some(definition);
    let damage = damage(recording.damage(), file);
    let (about, records) = (recording.about(), records(&recording));
    if output.is_json() {
        let ends = content.ends();
        return output.report(json!({
            "file": file,
            "version": about.version,
            "commit": about.commit,
            "target": about.target,
            "seed": about.seed,
            "overrides": about.overrides,
            "cycles": content.count,
            "first_cycle": ends.map(|[(first, _), _]| first),
            "last_cycle": ends.map(|[_, (last, _)]| last),
            "from_s": ends.map(|[(_, from), _]| from),
            "to_s": ends.map(|[_, (_, to)]| to),
            "gaps": content.gaps,
            "missing_cycles": content.missing,
            "is_whole": damage.is_empty(),
            "damage": recording.damage_count(),
            "schema": definition,
            "diagnostics": damage,
        }));
    }
    output.warnings(&damage);
    let mut text = format!("recorded  by {}, seed {}", super::replay::maker(about), about.seed);
    if !about.overrides.is_empty() {
        text.push_str(&format!(", {}", about.overrides.escape_debug()));
    }
    let kind = if matches!(about.machine, Machine::Rig(_)) { "rig" } else { "device" };
    if let Some(name) = about.machine.document().lines().find_map(|line| line.strip_prefix("  name: ")) {
        text.push_str(&format!("\n{kind:9} {}", name.escape_debug()));
    }
    text.push_str(&match content.ends() {
        Some([(first, from_s), (last, to_s)]) => format!(
            "\n{records:9} {}, number {first} to {last}, {from_s:.3} to {to_s:.3} s since {since}",
            content.count
        ),
        None => format!("\n{records:9} none"),
    });
    text.push_str(&match content.gaps {
        0 => "\ngaps      none".to_owned(),
        gaps => format!("\ngaps      {gaps}, {} {records} are missing", content.missing),
    });
    text.push_str(&match recording.damage_count() {
        0 => "\nfile      complete".to_owned(),
        1 => "\nfile      damaged at 1 place".to_owned(),
        count => format!("\nfile      damaged at {count} places"),
    });
    if let Some(definition) = definition {
        text.push_str("\n\n");
        text.push_str(definition.trim_end());
    }
    output.news(&text)
}

fn repair(named: &Path, out: Option<&Path>, output: &mut Output) -> Result<(), Failure> {
    let file = &recording_file(named);
    let mut recording = open(file)?;
    let out = out.map_or_else(|| file.with_extension("repaired.mcap"), Path::to_owned);
    let frames = if named.is_dir() { FramesFile::all_in(named, &out)? } else { Vec::new() };
    let cannot = |error: io::Error| unwritten(&out, &error);
    let target = OpenOptions::new().write(true).create_new(true).open(&out);
    let target = target.map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => Failure::new(
            Exit::Usage,
            format!("{} exists already", out.display()),
            "delete it, or name another file with --out",
        ),
        _ => cannot(error),
    })?;
    let about = recording.about().clone();
    let saved = match &mut recording {
        Recording::Rig(reader) => save(reader, file, Writer::new(target, &about), cannot),
        Recording::Device(reader) => save(reader, file, Writer::new(target, &about), cannot),
    };
    let content = match saved {
        Ok(content) => content,
        Err(failure) => {
            discard(&out);
            return Err(failure);
        }
    };
    frames.iter().try_for_each(FramesFile::save)?;
    let (damage, records) = (damage(recording.damage(), file), records(&recording));
    if output.is_json() {
        return output.report(json!({
            "file": file,
            "out": out,
            "frames": frames.iter().map(FramesFile::document).collect::<Vec<_>>(),
            "kept_cycles": content.count,
            "gaps": content.gaps,
            "missing_cycles": content.missing,
            "damage": recording.damage_count(),
            "diagnostics": damage,
        }));
    }
    output.warnings(&damage);
    let lost = lost(&content, &recording);
    let lines: String = frames.iter().map(|file| format!("\n{file}")).collect();
    output.news(&format!("{}: {} {records} kept; {lost}{lines}", out.display(), content.count))
}

/// A file with the frames of a recording, and how far it is whole.
struct FramesFile {
    file: PathBuf,
    /// The copy of its whole part, where it is cut.
    copy: PathBuf,
    whole: Whole,
    /// Bytes behind the whole part.
    cut_bytes: u64,
}

impl FramesFile {
    /// Reads the files of a recorded folder, whose copies go beside `out`. Writes nothing.
    fn all_in(folder: &Path, out: &Path) -> Result<Vec<Self>, Failure> {
        let there = [CAPTURE, LOG].map(|name| folder.join(name)).into_iter().filter(|file| file.is_file());
        let mut all = Vec::new();
        for file in there {
            let unread = |error: io::Error| {
                let help = "move it out of the folder: the cycles are repaired without it";
                Failure::about_file(
                    Exit::ConfigInvalid,
                    &file,
                    format!("{} cannot be read: {error}", file.display()),
                    help,
                )
            };
            let is_capture = file.ends_with(CAPTURE);
            let bytes = BufReader::new(File::open(&file).map_err(unread)?);
            let length = fs::metadata(&file).map_err(unread)?.len();
            let whole = if is_capture { whole_blocks(bytes) } else { whole_lines(bytes) }.map_err(unread)?;
            let ending = if is_capture { "repaired.pcapng" } else { "repaired.log" };
            let copy = out.with_file_name(file.file_name().unwrap_or_default()).with_extension(ending);
            let cut_bytes = length.saturating_sub(whole.bytes);
            let file = Self { file, copy, whole, cut_bytes };
            if file.has_copy() {
                Replace::default().check_new(&file.copy)?;
            }
            all.push(file);
        }
        Ok(all)
    }

    /// Whether it is cut, and has a whole part.
    fn has_copy(&self) -> bool {
        self.cut_bytes > 0 && self.whole.bytes > 0
    }

    /// Copies the whole part. The copy is there with all of it, or not at all.
    fn save(&self) -> Result<(), Failure> {
        if !self.has_copy() {
            return Ok(());
        }
        let cannot = |error: io::Error| unwritten(&self.copy, &error);
        let unfinished = self.copy.with_extension(format!("{}.unfinished", std::process::id()));
        let copied = || -> io::Result<()> {
            let mut to = OpenOptions::new().write(true).create_new(true).open(&unfinished)?;
            io::copy(&mut File::open(&self.file)?.take(self.whole.bytes), &mut to)?;
            to.sync_all()?;
            fs::rename(&unfinished, &self.copy)
        };
        copied().map_err(|error| {
            discard(&unfinished);
            cannot(error)
        })
    }

    fn document(&self) -> serde_json::Value {
        json!({
            "file": self.file,
            "out": self.has_copy().then_some(&self.copy),
            "kept_frames": self.whole.frames,
            "kept_bytes": self.whole.bytes,
            "cut_bytes": self.cut_bytes,
        })
    }
}

impl fmt::Display for FramesFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (file, Whole { frames, .. }) = (self.file.display(), self.whole);
        match self.cut_bytes {
            0 => write!(f, "{file}: {frames} frames, whole"),
            cut if self.has_copy() => {
                let copy = self.copy.display();
                write!(
                    f,
                    "{copy}: {frames} frames kept; the last {cut} bytes of {file} are no whole frame and were cut off"
                )
            }
            cut => write!(f, "{file}: none of its {cut} bytes is a whole frame, and nothing was written"),
        }
    }
}

/// Finds out how far a log consists of whole lines, of which each is a frame.
fn whole_lines(mut log: impl BufRead) -> io::Result<Whole> {
    let (mut whole, mut read) = (Whole::default(), 0);
    loop {
        let part = log.fill_buf()?;
        if part.is_empty() {
            return Ok(whole);
        }
        let ends = part.iter().enumerate().filter(|(_, byte)| **byte == b'\n');
        for (at, _) in ends {
            whole = Whole { bytes: read + at as u64 + 1, frames: whole.frames + 1 };
        }
        let length = part.len();
        read += length as u64;
        log.consume(length);
    }
}

/// Describes the missing part of a recording.
fn lost(content: &Content, recording: &Recording<File>) -> String {
    match (content.missing, recording.damage_count()) {
        (0, 0) => "nothing is lost".to_owned(),
        (0, _) => "nothing between the first and the last is lost".to_owned(),
        (missing, _) => format!("{missing} {} are missing in {} gaps", records(recording), content.gaps),
    }
}

fn export(file: &Path, csv: Option<&Path>, replace: Replace, output: &mut Output) -> Result<(), Failure> {
    let mut recording = open(file)?;
    let csv = csv.map_or_else(|| file.with_extension("csv"), Path::to_owned);
    let cannot = |error: io::Error| unwritten(&csv, &error);
    let mut text = BufWriter::new(replace.create(&csv)?);
    let written = match &mut recording {
        Recording::Rig(reader) => write_text(reader, file, &mut text, cannot),
        Recording::Device(reader) => write_text(reader, file, &mut text, cannot),
    };
    let content = match written.and_then(|content| text.flush().map_err(cannot).map(|()| content)) {
        Ok(content) => content,
        Err(failure) => {
            discard(&csv);
            return Err(failure);
        }
    };
    let (damage, records) = (damage(recording.damage(), file), records(&recording));
    if output.is_json() {
        return output.report(json!({
            "file": file,
            "csv": csv,
            "cycles": content.count,
            "gaps": content.gaps,
            "missing_cycles": content.missing,
            "damage": recording.damage_count(),
            "diagnostics": damage,
        }));
    }
    output.warnings(&damage);
    output.news(&format!("{}: {} {records}; {}", csv.display(), content.count, lost(&content, &recording)))
}

/// Writes all records as text, below a line with the names of the columns.
fn write_text<T: Recorded>(
    reader: &mut Reader<File, T>,
    file: &Path,
    out: &mut impl Write,
    cannot: impl Fn(io::Error) -> Failure,
) -> Result<Content, Failure> {
    writeln!(out, "{}", csv_header::<T>()).map_err(&cannot)?;
    let mut row = String::new();
    go_over(reader, file, |record| {
        csv_row(record, &mut row);
        writeln!(out, "{row}").map_err(&cannot)
    })
}

/// Writes all records into a new file.
fn save<T: Recorded>(
    reader: &mut Reader<File, T>,
    file: &Path,
    writer: io::Result<Writer<File, T>>,
    cannot: impl Fn(io::Error) -> Failure,
) -> Result<Content, Failure> {
    let mut writer = writer.map_err(&cannot)?;
    let content = go_over(reader, file, |record| writer.write(record).map_err(&cannot))?;
    writer.finish().map_err(&cannot)?;
    Ok(content)
}
