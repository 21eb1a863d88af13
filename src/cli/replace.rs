//! Which files a command writes over.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use super::failure::{Exit, Failure};

/// Bytes by which a file is known.
const HEAD: u64 = 1024;

/// What a command writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Written {
    /// A drawing.
    Picture,
    /// A log as candump writes it.
    BusLog,
    /// Tables for a page.
    Tables,
}

impl Written {
    fn name(self) -> &'static str {
        match self {
            Written::Picture => "a drawing",
            Written::BusLog => "a log of candump",
            Written::Tables => "a file of tables",
        }
    }

    /// Whether a file that begins so is of this kind.
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
            Written::Tables => text.starts_with('|'),
        }
    }
}

/// What a command may write over.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(super) struct Replace {
    /// Write over a file that is not what this command writes
    #[arg(long)]
    force: bool,
}

impl Replace {
    /// Refuses to write over a file of another kind than what is written there, unless forced; and whatever is no file, which could
    /// block for ever. A file that cannot be looked into is left to whoever writes it.
    pub(super) fn check(self, path: &Path, what: Written) -> Result<(), Failure> {
        if !check_regular(path)? {
            return Ok(());
        }
        let mut head = Vec::new();
        let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
        if self.force || read.is_err() || head.is_empty() || what.is(&head) {
            return Ok(());
        }
        let message = format!("{} is there already, and is not {}: nothing was written", path.display(), what.name());
        Err(Failure::about_file(Exit::Usage, path, message, "name another file, or replace this one with --force"))
    }

    /// Refuses a file that is there already, unless forced.
    pub(super) fn check_new(self, path: &Path) -> Result<(), Failure> {
        let is_there = check_regular(path)?;
        if is_there && !self.force {
            let message = format!("{} is there already: nothing was written", path.display());
            return Err(Failure::about_file(
                Exit::Usage,
                path,
                message,
                "name another file, or replace this one with --force",
            ));
        }
        Ok(())
    }

    /// Makes a file that is not there yet; if it is, only when forced.
    pub(super) fn create(self, path: &Path) -> Result<File, Failure> {
        self.check_new(path)?;
        File::create(path).map_err(|error| {
            let message = format!("{}: {error}", path.display());
            Failure::about_file(Exit::Usage, path, message, "choose a file that can be written")
        })
    }
}

/// Whether there is a regular file that writing would change.
///
/// # Errors
/// If there is something else, which could block for ever.
fn check_regular(path: &Path) -> Result<bool, Failure> {
    let Ok(metadata) = fs::metadata(path) else { return Ok(false) };
    if metadata.is_file() || is_sink(&metadata) {
        return Ok(metadata.is_file());
    }
    let message = format!("{} is not a regular file", path.display());
    Err(Failure::about_file(Exit::Usage, path, message, "name a file, or one that is not there yet"))
}

/// Whether it takes what is written without being changed, as a terminal and `/dev/null`.
fn is_sink(metadata: &fs::Metadata) -> bool {
    #[cfg(unix)]
    return std::os::unix::fs::FileTypeExt::is_char_device(&metadata.file_type());
    #[cfg(not(unix))]
    return false;
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert!(Replace::default().check(&folder.join("new"), Written::Picture).is_ok());
        for force in [false, true] {
            assert!(Replace { force }.check(&folder, Written::BusLog).is_err(), "a folder");
            assert!(Replace { force }.check(Path::new("/dev/null"), Written::BusLog).is_ok());
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
