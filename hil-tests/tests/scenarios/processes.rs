//! A test that hangs is ended with a report. Two tests hang on purpose, each in a process of its own with a limit of a second.

use std::process::Command;
use std::sync::mpsc::channel;
use std::time::Duration;

use hil_tests::processes::{self, Process};

const HANGS: &str = "YIELDWALL_TEST_HANGS";

/// A shell that says something and waits for a process that does not end.
fn endless() -> Process {
    let mut shell = Command::new("sh");
    shell.args(["-c", "echo last words; echo last error >&2; sleep 4321 & wait"]);
    Process::start(shell.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()))
}

#[test]
#[ignore = "hangs: a child of the test that looks at its end"]
fn waits_for_a_process() {
    if std::env::var_os(HANGS).is_some() {
        processes::set_limit(Duration::from_secs(1));
        endless().output();
    }
}

#[test]
#[ignore = "hangs: a child of the test that looks at its end"]
fn waits_for_itself() {
    if std::env::var_os(HANGS).is_some() {
        processes::set_limit(Duration::from_secs(1));
        let _process = endless();
        let (_sender, receiver) = channel::<()>();
        let _ = receiver.recv();
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_test_that_hangs_is_ended_with_a_report_of_all_its_processes() {
    for (name, end) in [
        ("processes::waits_for_a_process", "has reached its limit of 1s, see the report above"),
        ("processes::waits_for_itself", "... FAILED: it goes on without its processes"),
    ] {
        let mut tests = Command::new(std::env::current_exe().expect("this program"));
        let done = processes::output(tests.args(["--ignored", "--exact", name]).env(HANGS, "1"));
        let [out, error] = [done.stdout, done.stderr].map(|bytes| String::from_utf8(bytes).expect("text"));
        assert_eq!(done.status.code(), Some(101), "{name}: {out}\n{error}");
        for part in [
            &format!("test {name} has reached its limit of 1s\n"),
            "  sh -c echo last words; echo last error >&2; sleep 4321 & wait\n",
            ", started by it\n  sleep 4321\n  thread sleep: State:\tS (sleeping), ",
            "its last output:\nlast words\n",
            "its last errors:\nlast error\n",
            "the test itself, process ",
        ] {
            assert!(error.contains(part), "{name}: no `{part}` in\n{error}");
        }
        assert!(format!("{out}{error}").contains(&format!("{name} {end}")), "{name}: {out}\n{error}");
        // The process that the shell has started is gone too.
        let started = error.lines().find_map(|line| line.strip_prefix("process ")?.strip_suffix(", started by it"));
        let started: u32 = started.expect("it is named").parse().expect("a number");
        let state = std::fs::read_to_string(format!("/proc/{started}/stat")).unwrap_or_default();
        assert!(state.is_empty() || state.contains(") Z "), "{state}");
    }
}
