//! Records that let a rig be enabled: files of the caller alone.
//!
//! Whoever may write such a record decides what moves. Therefore a record counts only if the caller owns the file and its folder and no
//! other user may write to either. New folders and files are open to their owner alone, and no link is followed on the way to them.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;

/// Makes a folder that nobody but the caller may look into, and the folders on the way.
///
/// # Errors
/// If the system refuses, or the folder is there and [`check`] refuses it.
pub fn make_folder(folder: &Path) -> io::Result<()> {
    make_private(folder)?;
    check(folder)
}

/// Makes the same folders, but accepts a folder that exists without a check.
pub fn make_private(folder: &Path) -> io::Result<()> {
    let mut folders = fs::DirBuilder::new();
    folders.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut folders, 0o700);
    folders.create(folder)
}

/// Checks that the caller owns a folder and that nobody else may write to it.
///
/// # Errors
/// [`ErrorKind::PermissionDenied`] with the command that changes it; the error of the system if it cannot be checked.
pub fn check(folder: &Path) -> io::Result<()> {
    check_owner(folder, &fs::metadata(folder)?)
}

/// Reads a record.
///
/// # Errors
/// [`ErrorKind::NotFound`] if it does not exist. [`ErrorKind::PermissionDenied`] if it cannot be trusted, with the command that changes it.
pub fn read(path: &Path) -> io::Result<String> {
    check(folder_of(path))?;
    let metadata = fs::symlink_metadata(path)?;
    if !metadata.is_file() {
        let message = format!("{} is no regular file; `rm {}` removes it", path.display(), quoted(path));
        return Err(io::Error::new(ErrorKind::PermissionDenied, message));
    }
    // Nobody but the caller can have put another file there since.
    check_owner(path, &metadata)?;
    let mut text = String::new();
    File::open(path)?.read_to_string(&mut text)?;
    Ok(text)
}

/// Writes a record to the disk, whole or not at all, in the place of an older one.
///
/// # Errors
/// If the folder cannot be made or belongs to others, and if the file cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    make_folder(folder_of(path))?;
    let unfinished = path.with_extension(format!("{}.unfinished", std::process::id()));
    match fs::remove_file(&unfinished) {
        // A process that was killed has left it.
        Ok(()) => {}
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(&unfinished)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&unfinished, path)?;
    File::open(folder_of(path))?.sync_all()
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(all(feature = "owners", target_os = "linux"))]
fn check_owner(path: &Path, metadata: &Metadata) -> io::Result<()> {
    use std::os::unix::fs::MetadataExt;

    let (own, owner, mode) = (rustix::process::geteuid().as_raw(), metadata.uid(), metadata.mode() & 0o777);
    let shown = path.display();
    let (mut wrong, mut commands) = (Vec::new(), Vec::new());
    if owner != own {
        wrong.push(format!("user {owner} owns {shown}"));
        let sudo = if own == 0 { "" } else { "sudo " };
        commands.push(format!("{sudo}chown {own} {}", quoted(path)));
    }
    if mode & 0o022 != 0 {
        let what = if wrong.is_empty() { shown.to_string() } else { "it".to_owned() };
        wrong.push(format!("users other than its owner may write to {what} (mode {mode:o})"));
        commands.push(format!("chmod go-w {}", quoted(path)));
    }
    if wrong.is_empty() {
        return Ok(());
    }
    let message = format!(
        "not believed, since {}. If nobody else has changed what is there, `{}` makes it yours alone",
        wrong.join(", and "),
        commands.join(" && ")
    );
    Err(io::Error::new(ErrorKind::PermissionDenied, message))
}

/// Without interfaces there is no rig that a record would let be enabled.
#[cfg(not(all(feature = "owners", target_os = "linux")))]
fn check_owner(_: &Path, _: &Metadata) -> io::Result<()> {
    Ok(())
}

/// Returns a path as a shell takes it.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |one: char| one.is_ascii_alphanumeric() || "/._-+,:@%".contains(one);
    if text.chars().all(is_plain) && !text.starts_with('-') {
        return text;
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

#[cfg(all(test, feature = "owners", target_os = "linux"))]
mod tests {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
    use std::path::PathBuf;
    use std::process::Command;

    use super::*;

    struct Folder(PathBuf);

    impl Folder {
        /// Creates a new folder whose name a shell would take for several words.
        fn new(name: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("yieldwall it's {name} {}", std::process::id()));
            let _ = fs::remove_dir_all(&folder);
            fs::create_dir(&folder).unwrap();
            Self(folder)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    fn is_root() -> bool {
        rustix::process::geteuid().is_root()
    }

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    fn set_mode(path: &Path, mode: u32) {
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    }

    /// Does what a message advises; what the record is afterwards.
    fn cured(error: &io::Error, path: &Path) -> io::Result<String> {
        assert_eq!(error.kind(), ErrorKind::PermissionDenied, "{error}");
        let text = error.to_string();
        let command = text.split('`').nth(1).unwrap();
        assert!(Command::new("sh").args(["-c", command]).status().unwrap().success(), "{command}");
        read(path)
    }

    #[test]
    fn a_record_is_written_for_its_user_alone_and_replaces_another() {
        let folder = Folder::new("written");
        let path = folder.0.join("state/drills/1.json");
        for text in ["first", "second"] {
            write(&path, text.as_bytes()).unwrap();
            assert_eq!(read(&path).unwrap(), text);
        }
        for (at, wanted) in [("state", 0o700), ("state/drills", 0o700), ("state/drills/1.json", 0o600)] {
            assert_eq!(mode(&folder.0.join(at)), wanted, "{at}");
        }
        assert_eq!(fs::read_dir(folder.0.join("state/drills")).unwrap().count(), 1);
        assert_eq!(read(&folder.0.join("other/1.json")).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[test]
    fn a_record_that_others_may_have_written_is_not_read_and_the_advice_makes_it_readable() {
        let folder = Folder::new("believed");
        let path = folder.0.join("1.json");
        for mode in [0o777, 0o770, 0o702] {
            write(&path, b"text").unwrap();
            set_mode(&folder.0, mode);
            let refused = read(&path).unwrap_err();
            assert!(write(&path, b"other").is_err(), "{mode:o}");
            assert_eq!(cured(&refused, &path).unwrap(), "text", "{refused}");
        }
        for mode in [0o666, 0o620] {
            set_mode(&path, mode);
            let refused = read(&path).unwrap_err();
            assert_eq!(cured(&refused, &path).unwrap(), "text", "{refused}");
        }
        if is_root() {
            for at in [&path, &folder.0] {
                chown(at, Some(65534), None).unwrap();
                set_mode(at, 0o777);
                let refused = read(&path).unwrap_err();
                assert!(refused.to_string().contains("user 65534 owns "), "{refused}");
                assert_eq!(cured(&refused, &path).unwrap(), "text", "{refused}");
                assert_eq!(fs::metadata(at).unwrap().uid(), 0);
            }
        }
    }

    #[test]
    fn no_link_is_followed() {
        let folder = Folder::new("links");
        let [elsewhere, path] = ["elsewhere", "1.json"].map(|name| folder.0.join(name));
        fs::write(&elsewhere, "kept").unwrap();
        symlink(&elsewhere, &path).unwrap();
        assert_eq!(read(&path).unwrap_err().kind(), ErrorKind::PermissionDenied);
        for planted in ["1.unfinished".to_owned(), format!("1.{}.unfinished", std::process::id())] {
            symlink(&elsewhere, folder.0.join(planted)).unwrap();
        }
        write(&path, b"text").unwrap();
        assert_eq!(read(&path).unwrap(), "text");
        assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "kept");
    }
}
