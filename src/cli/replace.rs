//! Files that a command writes: the rule for overwriting, and the message if it cannot write.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

use super::failure::{Exit, Failure};

/// Bytes by which a file is known.
const HEAD: u64 = 1024;

/// First bytes of a recording.
const RECORDING: &[u8] = b"\x89MCAP";

/// File that a command writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Written {
    /// A drawing.
    Picture,
    /// A log as candump writes it.
    BusLog,
    /// A capture.
    Capture,
    /// Tables for a page.
    Tables,
}

impl Written {
    fn name(self) -> &'static str {
        match self {
            Written::Picture => "a drawing",
            Written::BusLog => "a log of candump",
            Written::Capture => "a capture of pcapng",
            Written::Tables => "a file of tables",
        }
    }

    /// Whether a file with this beginning is of this kind.
    fn is(self, head: &[u8]) -> bool {
        let text = String::from_utf8_lossy(head);
        let text = text.trim_start_matches('\u{feff}').trim_start();
        match self {
            Written::Picture => {
                let is_svg = text.starts_with("<svg") || (text.starts_with("<?xml") && text.contains("<svg"));
                is_svg || head.starts_with(b"\x89PNG\r\n\x1a\n")
            }
            Written::BusLog => {
                let time = text.strip_prefix('(').and_then(|rest| rest.split_once(')')).map(|(time, _)| time);
                time.is_some_and(|time| time.contains('.') && time.parse::<f64>().is_ok())
            }
            Written::Capture => head.starts_with(b"\n\r\r\n"),
            Written::Tables => text.starts_with('|'),
        }
    }
}

/// Rule for overwriting files.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(super) struct Replace {
    /// Overwrite files of any type, except recordings
    ///
    /// Without this option a drawing replaces only a drawing, a bus log only a bus log, a capture only a capture, and tables only tables.
    #[arg(long)]
    force: bool,
}

impl Replace {
    /// Whether everything except a recording may be overwritten.
    pub(super) fn is_forced(self) -> bool {
        self.force
    }

    /// Refuses to overwrite a file of another kind than the new one, unless forced. Refuses also anything other than a file, since
    /// it could block for ever. If a file cannot be read, the later write reports it.
    pub(super) fn check(self, path: &Path, what: Written) -> Result<(), Failure> {
        if !check_regular(path)? {
            return Ok(());
        }
        let Ok(head) = head(path) else { return Ok(()) };
        check_recording(path, &head)?;
        if self.force || head.is_empty() || what.is(&head) {
            return Ok(());
        }
        let message = format!("{} already exists, and is not {}: nothing was written", path.display(), what.name());
        Err(Failure::about_file(Exit::Usage, path, message, "name another file, or replace this one with --force"))
    }

    /// Refuses a file that is there already, unless forced.
    pub(super) fn check_new(self, path: &Path) -> Result<(), Failure> {
        let is_there = check_regular(path)?;
        if is_there
            && self.force
            && let Ok(head) = head(path)
        {
            check_recording(path, &head)?;
        }
        if is_there && !self.force {
            let message = format!("{} already exists: nothing was written", path.display());
            return Err(Failure::about_file(
                Exit::Usage,
                path,
                message,
                "name another file, or replace this one with --force",
            ));
        }
        Ok(())
    }

    /// Checks also that the file can be written at all, before a long computation; creates its folder.
    pub(super) fn check_can_write(self, path: &Path) -> Result<(), Failure> {
        let is_there = fs::symlink_metadata(path).is_ok();
        self.check_new(path)?;
        make_folder_of(path)?;
        let tried = fs::OpenOptions::new().append(true).create(true).open(path);
        if tried.is_ok() && !is_there {
            discard(path);
        }
        tried.map(drop).map_err(|error| unwritten(path, &error))
    }

    /// Makes a file that is not there yet, and the folders on the way; if it is there, only when forced.
    pub(super) fn create(self, path: &Path) -> Result<File, Failure> {
        self.check_new(path)?;
        make_folder_of(path)?;
        File::create(path).map_err(|error| unwritten(path, &error))
    }

    /// Writes a file that is not there yet, and the folders on the way; if it is there, only when forced.
    pub(super) fn write(self, path: &Path, bytes: &[u8]) -> Result<(), Failure> {
        self.create(path)?.write_all(bytes).map_err(|error| {
            discard(path);
            unwritten(path, &error)
        })
    }
}

/// Returns the failure that a file could not be written.
pub(super) fn unwritten(path: &Path, error: &io::Error) -> Failure {
    let help = match error.kind() {
        ErrorKind::StorageFull | ErrorKind::FileTooLarge | ErrorKind::QuotaExceeded => {
            "make room on the disk, or name a file on another one"
        }
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "name a file in a folder that you may write to",
        _ => "name another file",
    };
    // Some errors name the file themselves.
    let (shown, error) = (path.display().to_string(), error.to_string());
    let why = error.strip_prefix(&format!("{shown}: ")).unwrap_or(&error);
    Failure::about_file(Exit::Usage, path, format!("{shown} could not be written: {why}"), help)
}

/// Deletes a file that was written half: no device, pipe or link.
pub(super) fn discard(path: &Path) {
    if fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        // The reported failure states that there is no such file.
        let _ = fs::remove_file(path);
    }
}

/// Returns the first bytes of a file.
fn head(path: &Path) -> io::Result<Vec<u8>> {
    let mut head = Vec::new();
    File::open(path)?.take(HEAD).read_to_end(&mut head)?;
    Ok(head)
}

/// Refuses to write over a recording, which nothing brings back.
fn check_recording(path: &Path, head: &[u8]) -> Result<(), Failure> {
    if !head.starts_with(RECORDING) {
        return Ok(());
    }
    let message = format!("{} is a recording: nothing was written", path.display());
    Err(Failure::about_file(Exit::Usage, path, message, "name another file; recordings are never overwritten"))
}

/// Whether there is a regular file that writing would change.
///
/// # Errors
/// If there is something else, which could block for ever.
fn check_regular(path: &Path) -> Result<bool, Failure> {
    let Ok(metadata) = fs::metadata(path) else {
        if !fs::symlink_metadata(path).is_ok_and(|link| link.is_symlink()) {
            return Ok(false);
        }
        let message = format!("{} is a link to nothing, which is not followed: nothing was written", path.display());
        return Err(Failure::about_file(Exit::Usage, path, message, "name another file, or remove the link"));
    };
    if metadata.is_file() || is_sink(&metadata) {
        return Ok(metadata.is_file());
    }
    let message = format!("{} is not a regular file", path.display());
    Err(Failure::about_file(Exit::Usage, path, message, "name a file, or one that is not there yet"))
}

/// Whether the path accepts data without being changed, as a terminal and `/dev/null` do.
fn is_sink(metadata: &fs::Metadata) -> bool {
    #[cfg(unix)]
    return std::os::unix::fs::FileTypeExt::is_char_device(&metadata.file_type());
    #[cfg(not(unix))]
    return false;
}

/// Makes the folder that a file is to stand in, and those on the way.
pub(super) fn make_folder_of(path: &Path) -> Result<(), Failure> {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => make_folder(folder),
        _ => Ok(()),
    }
}

/// Makes a folder that is not there yet, and those on the way.
pub(super) fn make_folder(folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(|error| no_folder(folder, &error))
}

/// Returns the failure to create a folder.
pub(super) fn no_folder(folder: &Path, error: &io::Error) -> Failure {
    let why = match error.kind() {
        ErrorKind::AlreadyExists | ErrorKind::NotADirectory => "is not a folder".to_owned(),
        _ => format!("cannot be made: {error}"),
    };
    let message = format!("folder {} {why}", folder.display());
    Failure::about_file(Exit::Usage, folder, message, "choose a folder you can write to")
}

/// Returns the path beside a file at which its new text waits.
pub(super) fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".new-{}", std::process::id()));
    path.with_file_name(name)
}

/// Writes a new text beside a file, and replaces the file once `check` accepts the text there. Otherwise the file stays as it is.
pub(super) fn exchange(
    path: &Path,
    text: &str,
    failure: impl Fn(io::Error) -> Failure,
    check: impl FnOnce(&Path) -> Result<(), Failure>,
) -> Result<(), Failure> {
    // A link stays a link, and points to the new text.
    let path = &fs::canonicalize(path).map_err(&failure)?;
    let beside = beside(path);
    let permissions = fs::metadata(path).map_err(&failure)?.permissions();
    let written = File::create_new(&beside)
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .and_then(|()| fs::set_permissions(&beside, permissions));
    let checked = written.map_err(&failure).and_then(|()| check(&beside));
    let placed = checked.and_then(|()| fs::rename(&beside, path).map_err(&failure));
    placed.inspect_err(|_| {
        // It may not be there.
        let _ = fs::remove_file(&beside);
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_written_is_told_before_and_nothing_is_left_of_the_try() {
        let folder = std::env::temp_dir().join(format!("yieldwall-can-write-{}", std::process::id()));
        let (path, replace) = (folder.join("new/page.html"), Replace::default());
        assert!(replace.check_can_write(&path).is_ok());
        assert!(folder.join("new").is_dir() && !path.exists());
        fs::write(&path, b"page").unwrap();
        assert!(replace.check_can_write(&path).is_err());
        assert!(Replace { force: true }.check_can_write(&path).is_ok());
        assert_eq!(fs::read(&path).unwrap(), b"page");
        // A file where a folder would have to be, and a folder in which nobody makes files.
        assert!(replace.check_can_write(&path.join("page.html")).is_err());
        assert!(replace.check_can_write(Path::new("/proc/page.html")).is_err());
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_figure_replaces_a_figure_and_a_log_a_log_and_nothing_else() {
        let folder = std::env::temp_dir().join(format!("yieldwall-replace-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("file");
        let svg = b"<?xml version=\"1.0\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\">".as_slice();
        let log = b"(1.000000) vcan0 080#\n".as_slice();
        let cases: [(&[u8], [bool; 3]); 8] = [
            (b"", [true; 3]),
            (svg, [true, false, false]),
            (b"<svg width=\"1\">", [true, false, false]),
            (b"\x89PNG\r\n\x1a\n....", [true, false, false]),
            (log, [false, true, false]),
            (b"|  |  |\n|---|---|\n", [false, false, true]),
            (b"rig:\n  name: mine\n", [false; 3]),
            (b"<?xml version=\"1.0\"?><rig/>", [false; 3]),
        ];
        for (content, wanted) in cases {
            fs::write(&path, content).unwrap();
            let kinds = [Written::Picture, Written::BusLog, Written::Tables];
            let found = kinds.map(|what| Replace::default().check(&path, what).is_ok());
            assert_eq!(found, wanted, "{}", String::from_utf8_lossy(content));
            assert!(kinds.iter().all(|what| Replace { force: true }.check(&path, *what).is_ok()));
        }
        for recording in [b"\x89MCAP0\r\n".as_slice(), b"\x89MCAP0\r\n and more"] {
            fs::write(&path, recording).unwrap();
            for replace in [false, true].map(|force| Replace { force }) {
                assert!(replace.check(&path, Written::BusLog).is_err());
                assert!(replace.write(&path, b"").is_err());
            }
            assert_eq!(fs::read(&path).unwrap(), recording, "no recording is written over");
        }
        fs::remove_file(&path).unwrap();
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(folder.join("elsewhere"), &path).unwrap();
            for replace in [false, true].map(|force| Replace { force }) {
                assert!(replace.check(&path, Written::BusLog).is_err(), "a link to nothing is not followed");
                assert!(replace.write(&path, b"one").is_err());
            }
            assert!(!folder.join("elsewhere").exists());
            fs::remove_file(&path).unwrap();
        }
        Replace::default().write(&path, b"one").unwrap();
        assert!(Replace::default().write(&path, b"other").is_err());
        Replace { force: true }.write(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert!(Replace::default().check(&folder.join("new"), Written::Picture).is_ok());
        for force in [false, true] {
            assert!(Replace { force }.check(&folder, Written::BusLog).is_err(), "a folder");
            assert!(Replace { force }.check(Path::new("/dev/null"), Written::BusLog).is_ok());
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
