//! A file of results: a line of JSON for each, appended when it is finished.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// Why results could not be kept or read.
#[derive(Debug, Error)]
pub enum LinesError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The path is not a regular file: reading a pipe may never end.
    #[error("{} is not a regular file", path.display())]
    NoFile {
        /// Its name.
        path: PathBuf,
    },
    /// Another program adds to the file.
    #[error("{} is open in another program", path.display())]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// A whole line is not what the file should hold.
    #[error("{}, line {line}: {source}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Why.
        source: serde_json::Error,
    },
}

/// A file of results that is open for more.
#[derive(Debug)]
pub struct Lines {
    path: PathBuf,
    file: File,
}

impl Lines {
    /// Opens a file, creates it with its folder if it is missing, and reads its content. It cuts off a last line without an end, as
    /// an interrupted program leaves it, unless that line is no beginning of a result. No other program can open the file so
    /// meanwhile.
    ///
    /// # Errors
    /// If it is no file, cannot be read, written or understood, or another program has it open.
    pub fn open<T: DeserializeOwned>(path: &Path) -> Result<(Self, Vec<T>), LinesError> {
        let fail = |source| LinesError::Io { path: path.to_path_buf(), source };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(fail)?;
        }
        refuse_no_file(path)?;
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(fail)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(LinesError::Busy { path: path.to_path_buf() }),
            Err(TryLockError::Error(source)) => return Err(fail(source)),
        }
        let (finished, whole) = read_whole(path, &file)?;
        file.set_len(whole).map_err(fail)?;
        file.seek(SeekFrom::Start(whole)).map_err(fail)?;
        Ok((Self { path: path.to_path_buf(), file }, finished))
    }

    /// Reads what a file holds and leaves it as it is, whether or not another program is adding to it; nothing if there is
    /// no such file.
    ///
    /// # Errors
    /// If the file cannot be read or understood.
    pub fn read<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, LinesError> {
        refuse_no_file(path)?;
        match File::open(path) {
            Ok(file) => Ok(read_whole(path, &file)?.0),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
            Err(source) => Err(LinesError::Io { path: path.to_path_buf(), source }),
        }
    }

    /// Returns the files `NAME.jsonl` and `NAME.*.jsonl` of a folder, in any order; none if there is no such folder.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn files(folder: &Path, name: &str) -> Result<Vec<PathBuf>, LinesError> {
        let fail = |source| LinesError::Io { path: folder.to_path_buf(), source };
        let entries = match std::fs::read_dir(folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(fail)?,
        };
        let is_of_name = |path: &PathBuf| {
            let file = path.file_name().and_then(|file| file.to_str()).unwrap_or("");
            file.strip_prefix(name).is_some_and(|rest| rest.starts_with('.') && rest.ends_with(".jsonl"))
        };
        let paths = entries.map(|entry| entry.map(|entry| entry.path()).map_err(fail));
        paths.filter(|path| path.as_ref().map_or(true, is_of_name)).collect()
    }

    /// Adds one line.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn add(&mut self, result: &impl Serialize) -> Result<(), LinesError> {
        let fail = |source| LinesError::Io { path: self.path.clone(), source };
        let mut line = serde_json::to_vec(result).map_err(|source| fail(source.into()))?;
        line.push(b'\n');
        // One call: a line is there or it is the last one.
        (&self.file).write_all(&line).map_err(fail)
    }

    /// Throws away all that the file holds.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn clear(&mut self) -> Result<(), LinesError> {
        let fail = |source| LinesError::Io { path: self.path.clone(), source };
        self.file.set_len(0).and_then(|()| self.file.rewind()).map_err(fail)
    }
}

/// Refuses what is there and is no file, before it is opened.
fn refuse_no_file(path: &Path) -> Result<(), LinesError> {
    match std::fs::metadata(path) {
        Ok(metadata) if !metadata.is_file() => Err(LinesError::NoFile { path: path.to_path_buf() }),
        _ => Ok(()),
    }
}

/// Returns the whole lines of a file and their length in bytes.
fn read_whole<T: DeserializeOwned>(path: &Path, file: &File) -> Result<(Vec<T>, u64), LinesError> {
    let mut finished = Vec::new();
    let mut whole = 0u64;
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let length = reader
            .read_until(b'\n', &mut line)
            .map_err(|source| LinesError::Io { path: path.to_path_buf(), source })?;
        if length == 0 {
            break;
        }
        let read = serde_json::from_slice(&line);
        if line.last() != Some(&b'\n') && read.as_ref().map_or_else(|error| error.is_eof(), |_| true) {
            break;
        }
        finished.push(read.map_err(|source| LinesError::Line { path: path.to_path_buf(), line: number, source })?);
        whole += length as u64;
    }
    Ok((finished, whole))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_finished_is_found_again_and_a_torn_line_is_cut_off() {
        let folder = std::env::temp_dir().join(format!("yieldwall-lines-{}", std::process::id()));
        let path = folder.join("made").join("results.jsonl");
        let add = |value: f64| {
            let (mut lines, finished) = Lines::open::<f64>(&path).unwrap();
            lines.add(&value).unwrap();
            finished
        };
        assert!(add(0.1 + 0.2).is_empty());
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, [&whole[..], &whole[..whole.len() / 2]].concat()).unwrap();
        assert_eq!(add(1.0), [0.1 + 0.2]);
        let (open, finished) = Lines::open::<f64>(&path).unwrap();
        assert_eq!(finished, [0.1 + 0.2, 1.0]);
        assert!(matches!(Lines::open::<f64>(&path), Err(LinesError::Busy { .. })));
        let half = [&std::fs::read(&path).unwrap()[..], b"2."].concat();
        std::fs::write(&path, &half).unwrap();
        assert_eq!(Lines::read::<f64>(&path).unwrap(), [0.1 + 0.2, 1.0]);
        assert_eq!(std::fs::read(&path).unwrap(), half, "reading cuts nothing off");
        assert!(Lines::read::<f64>(&folder.join("none")).unwrap().is_empty());
        drop(open);
        let another = b"1.0\nrig:";
        std::fs::write(&path, another).unwrap();
        assert!(matches!(Lines::open::<f64>(&path), Err(LinesError::Line { line: 2, .. })));
        assert_eq!(std::fs::read(&path).unwrap(), another, "another file is left alone");
        assert!(matches!(Lines::open::<f64>(&folder), Err(LinesError::NoFile { .. })));
        assert!(matches!(Lines::read::<f64>(&folder), Err(LinesError::NoFile { .. })));
        std::fs::write(&path, "1.0\n{}\n").unwrap();
        assert!(matches!(Lines::open::<f64>(&path), Err(LinesError::Line { line: 2, .. })));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
