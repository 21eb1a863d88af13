//! Names, files, pipes and full disks that a person or a script may hand to the program: each is answered with a message, nothing hangs,
//! nothing else is written over, and a run that went well is reported all the same.

#![cfg(unix)]

use std::fs;
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// A command that takes longer hangs: the longest of these takes a second.
const HANGS: Duration = Duration::from_secs(120);
const POLL: Duration = Duration::from_millis(5);
const USAGE: i32 = 2;
const INVALID: i32 = 3;
const STOPPED: i32 = 8;
/// A name that a terminal would obey.
const ESCAPE: &str = "a\u{1b}[31mb";

/// A folder with what is hostile in it, and with files that nobody may touch.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("yieldwall-hostile-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        let folder = Self(path);
        let at = |name: &str| folder.0.join(name);
        fs::write(at("victim.yaml"), "rig:\n  name: mine\n").unwrap();
        fs::write(at("victim.svg"), "not a drawing").unwrap();
        fs::write(at("victim.log"), "not a log").unwrap();
        fs::create_dir(at("folder.svg")).unwrap();
        symlink("victim.yaml", at("link.svg")).unwrap();
        symlink("/dev/full", at("full.svg")).unwrap();
        symlink("loop.svg", at("loop.svg")).unwrap();
        symlink("loop.yaml", at("loop.yaml")).unwrap();
        for fifo in ["fifo", "fifo.svg", "fifo.png", "fifo.yaml"] {
            assert!(Command::new("mkfifo").arg(at(fifo)).status().unwrap().success());
        }
        folder
    }

    fn victims(&self) -> Vec<Vec<u8>> {
        ["victim.yaml", "victim.svg", "victim.log"].map(|name| fs::read(self.0.join(name)).unwrap()).into()
    }

    fn start(&self, program: &Path, arguments: &[&str]) -> Seen {
        let out = |name: &str| fs::File::create(self.0.join(name)).unwrap();
        let mut child = Command::new(program)
            .args(arguments)
            .current_dir(&self.0)
            .env("XDG_STATE_HOME", self.0.join("state"))
            .stdin(Stdio::null())
            .stdout(out("stdout"))
            .stderr(out("stderr"))
            .spawn()
            .unwrap();
        let started = Instant::now();
        let status = loop {
            match child.try_wait().unwrap() {
                Some(status) => break Some(status),
                None if started.elapsed() > HANGS => {
                    child.kill().unwrap();
                    child.wait().unwrap();
                    break None;
                }
                None => std::thread::sleep(POLL),
            }
        };
        let text = |name: &str| String::from_utf8_lossy(&fs::read(self.0.join(name)).unwrap()).into_owned();
        Seen { what: arguments.join(" "), status, out: text("stdout"), err: text("stderr") }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

struct Seen {
    what: String,
    status: Option<ExitStatus>,
    out: String,
    err: String,
}

impl Seen {
    /// A message that a person can read, and this exit code.
    fn is_refused(&self, code: i32) -> &Self {
        let status = self.status.unwrap_or_else(|| panic!("{}: hangs", self.what));
        assert_eq!(status.code(), Some(code), "{}: {}", self.what, self.err);
        assert!(!self.err.trim().is_empty(), "{}: no message", self.what);
        self.is_plain()
    }

    fn is_plain(&self) -> &Self {
        for text in [&self.out, &self.err] {
            assert!(!text.contains("panicked"), "{}: {text}", self.what);
            let obeyed = text.chars().find(|one| one.is_control() && !matches!(one, '\n' | '\t' | '\r'));
            assert_eq!(obeyed, None, "{}: {text}", self.what);
        }
        self
    }

    fn says(&self, words: &str) -> &Self {
        // A message is broken at the end of a line.
        let err = self.err.replace("\n  │ ", " ").replace("\n        ", " ");
        assert!(err.contains(words), "{}: {words}: {}", self.what, self.err);
        self
    }

    fn is_reported(&self) -> &Self {
        assert!(self.out.contains("energy    largest burst into the hand"), "{}: no report: {}", self.what, self.out);
        self
    }
}

const RUN: [&str; 4] = ["run", "builtin:paper-admittance.yaml", "--duration", "0.2"];

#[test]
fn places_where_nothing_can_be_written_are_refused_and_nothing_else_is_lost() {
    let folder = Folder::new("written");
    let before = folder.victims();
    let program = hil_tests::program();
    let long = format!("{}.svg", "x".repeat(300));
    let refused: [(&str, &str, &str); 24] = [
        ("--figure", "fifo.svg", "is not a regular file"),
        ("--figure", "fifo.png", "is not a regular file"),
        ("--figure", "folder.svg", "is not a regular file"),
        ("--figure", "loop.svg", ""),
        ("--figure", "link.svg", "is not a drawing: nothing was written"),
        ("--figure", "victim.svg", "is not a drawing: nothing was written"),
        ("--figure", "victim.yaml", "only .svg and .png are drawn"),
        ("--figure", "/dev/full", "only .svg and .png are drawn"),
        ("--figure", ".svg", "no ending"),
        ("--figure", "", "a value is required"),
        ("--candump", "fifo", "is not a regular file"),
        ("--candump", "folder.svg", "is not a regular file"),
        ("--candump", "victim.yaml", "is not a log of candump: nothing was written"),
        ("--candump", "victim.log", "is not a log of candump: nothing was written"),
        ("--candump", "link.svg", "is not a log of candump: nothing was written"),
        ("--candump", "victim.yaml/x", ""),
        ("--pcapng", "victim.log", "is not a capture of pcapng: nothing was written"),
        ("--record", "fifo", "is not a folder"),
        ("--record", "victim.yaml", "is not a folder"),
        ("--record", "victim.yaml/x", "is not a folder"),
        ("--record", "/dev/full", "is not a folder"),
        ("--record", "/proc/nowhere", "cannot be made"),
        ("--record", "loop.svg", ""),
        ("--record", "", "a value is required"),
    ];
    for (option, path, words) in refused {
        folder.start(&program, &[&RUN[..], &[option, path]].concat()).is_refused(USAGE).says(words);
    }
    // What shows only when the run is over costs no report.
    for (path, words) in [
        ("full.svg", "No space left"),
        ("victim.yaml/x.svg", "is not a folder"),
        (long.as_str(), "File name too long"),
        ("/proc/self/x.svg", "could not be written"),
    ] {
        let seen = folder.start(&program, &[&RUN[..], &["--figure", path]].concat());
        seen.is_refused(USAGE).says(words).is_reported();
    }
    for path in ["victim.yaml", "fifo", "/dev/full"] {
        let seen = folder.start(&program, &[&RUN[..], &["--fault", "node-reset@0.1", "--black-box", path]].concat());
        seen.is_refused(STOPPED).says("no black box").says("node-reset").is_reported();
    }
    assert!(before == folder.victims(), "a file that was there is another one");
}

/// A limit on the size of files is a disk that is full.
#[test]
fn a_full_disk_costs_the_file_and_not_the_report() {
    let folder = Folder::new("full");
    let program = hil_tests::program();
    let limited = "trap '' XFSZ; ulimit -f 40; exec \"$0\" \"$@\"";
    let start = |arguments: &[&str]| {
        let shell = ["-c", limited, program.to_str().unwrap()];
        folder.start(Path::new("/bin/sh"), &[&shell[..], arguments].concat())
    };
    let options = [
        ("--figure", "full-disk.svg"),
        ("--candump", "bus.log"),
        ("--pcapng", "bus.pcapng"),
        ("--record", "recording"),
    ];
    for (option, path) in options {
        let seen = start(&["run", "builtin:paper-admittance.yaml", "--duration", "2", option, path]);
        seen.is_refused(USAGE).says("File too large").is_reported();
    }
    folder.start(&program, &[&RUN[..], &["--candump", "/dev/full"]].concat()).is_refused(USAGE).says("are lost");
    let seen = start(&["run", "builtin:paper-admittance.yaml", "--duration", "2", "--fault", "node-reset@1"]);
    seen.is_refused(STOPPED).says("no black box").is_reported();
    // What cannot be repaired leaves no half file.
    folder.start(&program, &[&RUN[..], &["--record", "whole"]].concat());
    let whole = fs::read(folder.0.join("whole/cycles.mcap")).unwrap();
    let again = folder.start(&program, &[&RUN[..], &["--record", "whole", "--force"]].concat());
    again.is_refused(USAGE).says("already exists").says("never overwritten");
    let log = folder.start(&program, &[&RUN[..], &["--candump", "whole/cycles.mcap", "--force"]].concat());
    log.is_refused(USAGE).says("is a recording: nothing was written");
    let itself = folder.start(&program, &["record", "export", "whole", "--csv", "whole/cycles.mcap", "--force"]);
    itself.is_refused(USAGE).says("is a recording: nothing was written");
    assert!(fs::read(folder.0.join("whole/cycles.mcap")).unwrap() == whole, "a recording is never written over");
    // Root can delete a device.
    folder
        .start(&program, &["record", "export", "whole", "--csv", "/dev/full"])
        .is_refused(USAGE)
        .says("No space left");
    assert!(fs::metadata("/dev/full").unwrap().file_type().is_char_device());
    for arguments in [
        &["report", "--out"][..],
        &["od", "dump", "left", "--out"],
        &["drive", "adopt", "--node", "left", "--out"],
        &["soak", "--seeds", "0..1", "--cycles", "10", "--markdown"],
    ] {
        folder.start(&program, &[arguments, &["/dev/full"]].concat()).is_refused(USAGE).says("could not be written");
    }
    folder.start(&program, &["new", "--yes", "/proc/x.yaml"]).is_refused(USAGE).says("could not be written");
    start(&["record", "repair", "whole/cycles.mcap"]).is_refused(USAGE).says("File too large");
    assert!(!folder.0.join("whole/cycles.repaired.mcap").exists());
}

#[test]
fn what_is_no_recording_and_no_configuration_is_refused() {
    let folder = Folder::new("read");
    let before = folder.victims();
    let program = hil_tests::program();
    fs::write(folder.0.join(format!("{ESCAPE}.yaml")), "rig: 5 # \u{1b}[31m\n").unwrap();
    fs::write(folder.0.join("escape.yaml"), "rig:\n  name: \"\u{1b}[31m\"\n").unwrap();
    fs::write(folder.0.join("c1.yaml"), "rig: 5 # \u{9b}31m\n").unwrap();
    let paths =
        ["fifo", "folder.svg", "/dev/null", "/dev/full", "/dev/zero", "victim.yaml", "loop.svg", "absent", ESCAPE];
    for command in [&["replay"][..], &["plot"], &["record", "info"], &["record", "repair"]] {
        for path in paths {
            folder.start(&program, &[command, &[path]].concat()).is_refused(INVALID);
        }
    }
    let escape = format!("{ESCAPE}.yaml");
    let paths = [
        "fifo.yaml",
        "folder.svg",
        "/dev/zero",
        "loop.yaml",
        "absent",
        ESCAPE,
        &escape,
        "escape.yaml",
        "c1.yaml",
        "victim.yaml",
    ];
    for command in [&["run"][..], &["config", "check"], &["tune", "fixture"], &["bus", "budget"]] {
        for path in paths {
            folder.start(&program, &[command, &[path]].concat()).is_refused(INVALID);
        }
    }
    assert!(before == folder.victims(), "a file that was there is another one");
    assert!(!folder.0.join("recording.svg").exists() && !folder.0.join("victim.repaired.mcap").exists());
}

/// A name with an escape in it is written, and shown without the escape.
#[test]
fn names_do_not_reach_the_terminal_as_they_are() {
    let folder = Folder::new("shown");
    let program = hil_tests::program();
    let figure = format!("{ESCAPE}.svg");
    let seen = folder.start(&program, &[&RUN[..], &["--figure", &figure]].concat());
    assert!(seen.is_plain().is_reported().out.contains(r"a\u{1b}[31mb.svg"), "{}", seen.out);
    assert!(folder.0.join(&figure).is_file());
}
