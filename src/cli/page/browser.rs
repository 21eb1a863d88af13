//! The browser of the person at this computer.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::keep::state_folder;
use crate::output::Output;

/// Opens the page at `address`. Its token is in a file that this user alone can read, and on no command line.
pub(super) fn open(address: &str, output: &Output) {
    if rustix::process::geteuid().is_root() {
        return output.aside("no browser is opened as root: open the address as the user of the desktop");
    }
    let opened = leading_file(address).and_then(|file| {
        Command::new("xdg-open").arg(file).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()
    });
    match opened {
        // A browser that runs already ends it at once; one that starts may keep it.
        Ok(mut child) => drop(std::thread::Builder::new().name("browser".to_owned()).spawn(move || child.wait())),
        Err(error) => output.aside(&format!("xdg-open opened no browser ({error}): open the address in one")),
    }
}

/// A file that leads to the address, in the state folder of this user.
fn leading_file(address: &str) -> io::Result<PathBuf> {
    let folder = state_folder("page").ok_or_else(|| io::Error::other("there is no HOME"))?;
    fs::DirBuilder::new().recursive(true).mode(0o700).create(&folder)?;
    let path = folder.join("open.html");
    // One of before may have other rights.
    match fs::remove_file(&path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path)?;
    writeln!(
        file,
        "<!doctype html><meta http-equiv=\"refresh\" content=\"0; url={address}\"><title>yieldwall</title>"
    )?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn the_file_that_leads_to_the_page_is_for_this_user_alone() {
        let Some(folder) = crate::keep::state_folder("page") else { return };
        for _ in 0..2 {
            let path = super::leading_file("http://127.0.0.1:1/#00").unwrap();
            assert!(path.starts_with(&folder));
            assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
            assert!(std::fs::read_to_string(&path).unwrap().contains("url=http://127.0.0.1:1/#00"));
        }
    }
}
