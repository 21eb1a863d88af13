//! The black box: the time around a fault, kept without being asked for.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::about::About;
use super::feed::Sink;
use super::writer::{Writer, create_new};
use crate::{AROUND_FAULT_S, CycleRecord, fault_severity, trusted};
use yieldwall_motion::guard::{Cause, State};

/// Files that are kept in one folder.
const KEPT_FILES: usize = 20;
/// End of a file's name, behind a number of six digits.
const ENDING: &str = ".black-box.mcap";
/// Longest part of a file's name that comes from the rig, in characters.
const MAX_NAME: usize = 64;

/// A file that a fault left.
#[derive(Debug)]
pub struct Saved {
    /// The fault and its devices.
    pub cause: Cause,
    /// State of the rig after it.
    pub state: State,
    /// Time of the scene at which it did, in s; minus infinity before the scene.
    pub scene_time_s: f64,
    /// The file, or the reason why it is missing or incomplete.
    pub file: Result<PathBuf, io::Error>,
}

/// Keeps the last cycles in memory, and writes those around a fault that stops or holds the rig into a file.
///
/// One file for one fault: what goes wrong within the time after it belongs to the same file. Only the newest files of a
/// folder are kept.
pub struct BlackBox {
    folder: Option<PathBuf>,
    name: String,
    about: About,
    /// The last cycles, memory for all of them set aside.
    last: VecDeque<CycleRecord>,
    cycles_around: usize,
    severity: u8,
    open: Option<Open>,
    saved: Vec<Saved>,
    taken: u64,
}

struct Open {
    writer: Writer<File>,
    cycles_left: usize,
}

impl BlackBox {
    /// Creates a black box that writes into `folder`, which is made when it is needed; `name` is that of the rig and `period_s` its cycle
    /// time in s, positive.
    ///
    /// Without a folder the black box only reports an error.
    pub fn new(folder: Option<PathBuf>, name: &str, period_s: f64, about: About) -> Self {
        // A period that is far too short does not take all the memory.
        let cycles_around = (AROUND_FAULT_S / period_s).round().clamp(1.0, 100_000.0) as usize;
        Self {
            folder,
            name: sanitised(name),
            about,
            last: VecDeque::with_capacity(cycles_around),
            cycles_around,
            severity: 0,
            open: None,
            saved: Vec::new(),
            taken: 0,
        }
    }

    /// Returns the files of a rig of this name in a folder, the newest first; none where the folder cannot be read.
    pub fn files_of(folder: &Path, name: &str) -> Vec<PathBuf> {
        let name = sanitised(name);
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let mut files: Vec<(u32, PathBuf)> = entries
            .filter_map(|entry| {
                let file = entry.file_name().to_string_lossy().into_owned();
                let (of, _) = file.strip_suffix(ENDING)?.rsplit_once('-')?;
                Some((number(&file).filter(|_| of == name)?, entry.path()))
            })
            .collect();
        files.sort();
        files.into_iter().rev().map(|(_, path)| path).collect()
    }

    fn save(&mut self, cause: Cause, record: &CycleRecord) {
        // Only the newest files are there to be told of.
        if self.saved.len() == KEPT_FILES {
            self.saved.remove(0);
        }
        let file = match self.begin() {
            Ok((path, writer)) => {
                self.open = Some(Open { writer, cycles_left: self.cycles_around });
                Ok(path)
            }
            Err(error) => Err(error),
        };
        let (state, scene_time_s) = (record.directive.state, record.moment.scene_time_s);
        self.saved.push(Saved { cause, state, scene_time_s, file });
    }

    fn begin(&self) -> io::Result<(PathBuf, Writer<File>)> {
        let folder = self.folder.as_deref().ok_or_else(|| io::Error::other("there is no home folder to write to"))?;
        let (path, file) = next_file(folder, &self.name)?;
        let mut writer = Writer::new(file, &self.about)?;
        for record in &self.last {
            writer.write(record)?;
        }
        Ok((path, writer))
    }

    fn write(&mut self, record: &CycleRecord) {
        let Some(open) = &mut self.open else { return };
        let mut result = open.writer.write(record);
        open.cycles_left -= 1;
        if open.cycles_left == 0 {
            result = result.and_then(|()| open.writer.finish());
        }
        if result.is_err() || open.cycles_left == 0 {
            self.open = None;
        }
        self.note(result);
    }

    /// Notes an error of the file under way.
    fn note(&mut self, result: io::Result<()>) {
        if let (Err(error), Some(saved)) = (result, self.saved.last_mut()) {
            saved.file = Err(error);
        }
    }
}

impl Sink<CycleRecord> for BlackBox {
    type Report = Vec<Saved>;

    fn take(&mut self, record: &CycleRecord) -> io::Result<()> {
        self.taken += 1;
        let severity = fault_severity(record.directive.state, record.cause);
        if let Some(cause) = record.cause
            && severity > self.severity
            && self.open.is_none()
        {
            self.save(cause, record);
        }
        self.severity = severity;
        self.write(record);
        if self.last.len() == self.cycles_around {
            self.last.pop_front();
        }
        self.last.push_back(*record);
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        if let Some(mut open) = self.open.take() {
            let result = open.writer.finish();
            self.note(result);
        }
        Ok(())
    }

    fn stored(&self) -> u64 {
        self.taken
    }

    fn report(self) -> Vec<Saved> {
        self.saved
    }
}

/// Returns a name that means nothing to a file system.
fn sanitised(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '-' };
    let name: String = name.chars().take(MAX_NAME).map(plain).collect();
    if name.is_empty() { "rig".to_owned() } else { name }
}

/// Makes the file with the next number in `folder`, and removes the oldest ones.
fn next_file(folder: &Path, name: &str) -> io::Result<(PathBuf, File)> {
    let located = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", folder.display()));
    trusted::make_private(folder).map_err(located)?;
    if fs::symlink_metadata(folder).map_err(located)?.is_symlink() {
        return Err(located(io::Error::other("is a link; links are not followed")));
    }
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(located)? {
        let entry = entry.map_err(located)?;
        if let Some(number) = number(&entry.file_name().to_string_lossy())
            && entry.file_type().map_err(located)?.is_file()
        {
            files.push((number, entry.path()));
        }
    }
    files.sort();
    let number = files.last().map_or(1, |(number, _)| number + 1);
    let path = folder.join(format!("{name}-{number:06}{ENDING}"));
    let file = create_new(&path)?;
    let surplus = (files.len() + 1).saturating_sub(KEPT_FILES);
    for (_, old) in files.into_iter().take(surplus) {
        fs::remove_file(old).map_err(located)?;
    }
    Ok((path, file))
}

/// Returns the number in the name of a file of a black box; `None` for another file.
fn number(name: &str) -> Option<u32> {
    let (_, number) = name.strip_suffix(ENDING)?.rsplit_once('-')?;
    (6..=9).contains(&number.len()).then(|| number.parse().ok()).flatten()
}
