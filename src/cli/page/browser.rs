//! The browser of the person at this computer.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::keep::state_folder;
use crate::output::Output;

/// A file that redirects to a page while the page is served.
pub(super) struct LeadingFile(PathBuf);

impl Drop for LeadingFile {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

/// Opens the page at `address`. Its token is in a file that this user alone can read, and on no command line.
pub(super) fn open(address: &str, port: u16, output: &Output) -> Option<LeadingFile> {
    if rustix::process::geteuid().is_root() {
        output.aside("no browser is opened as root: open the address as the user of the desktop");
        return None;
    }
    let opened = LeadingFile::new(address, port).and_then(|file| {
        let mut command = Command::new("xdg-open");
        command.arg(&file.0).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        // Ctrl-C ends this program, and not the browser.
        Ok((command.process_group(0).spawn()?, file))
    });
    match opened {
        Ok((mut child, file)) => {
            output.aside("a browser opens the page; if it shows none, open the address above");
            // It ends at once, or with the browser.
            let _ = std::thread::Builder::new().name("browser".to_owned()).spawn(move || child.wait());
            Some(file)
        }
        Err(error) => {
            output.aside(&format!("xdg-open opened no browser ({error}): open the address above in one"));
            None
        }
    }
}

impl LeadingFile {
    /// Returns a file in the state folder of this user.
    fn new(address: &str, port: u16) -> io::Result<Self> {
        let folder = state_folder("page").ok_or_else(|| io::Error::other("there is no HOME"))?;
        fs::DirBuilder::new().recursive(true).mode(0o700).create(&folder)?;
        let path = folder.join(format!("{port}.html"));
        // A file of a program that was killed may have other rights.
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path)?;
        let refresh = format!("<meta http-equiv=\"refresh\" content=\"0; url={address}\">");
        writeln!(file, "<!doctype html>{refresh}<title>yieldwall</title>")?;
        Ok(Self(path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn the_file_that_leads_to_the_page_is_for_this_user_alone_and_goes_with_it() {
        if state_folder("page").is_none() {
            return;
        }
        let mut path = PathBuf::new();
        for _ in 0..2 {
            let file = LeadingFile::new("http://127.0.0.1:1/#00", 1).unwrap();
            path = file.0.clone();
            assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
            assert!(fs::read_to_string(&path).unwrap().contains("url=http://127.0.0.1:1/#00"));
        }
        assert!(!path.exists());
    }
}
