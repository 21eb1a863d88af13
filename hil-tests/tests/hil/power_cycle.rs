//! A person who is asked to switch drives off and on while a rig is commissioned.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Command, Stdio};

use super::programs::*;

/// Reads up to the end of a text; all that came before it.
fn read_until(from: &mut impl Read, wanted: &str) -> String {
    let mut text = Vec::new();
    let mut byte = [0];
    while !text.ends_with(wanted.as_bytes()) {
        assert_eq!(from.read(&mut byte).expect("it is piped"), 1, "no `{wanted}`: {}", String::from_utf8_lossy(&text));
        text.push(byte[0]);
    }
    String::from_utf8(text).expect("text")
}

/// A yes without a power cycle is asked again, and one behind it is believed: `sim` starts the devices, and the program reaches them by `bus`.
pub(super) fn a_power_cycle_is_seen_and_no_word_is_taken_for_it(rig: &str, bus: &str, sim: impl Fn() -> Running) {
    let first = sim();
    let commission = ["commission", rig, "--bus", bus, "--pace", "lockstep", "--from", "parameters"];
    let mut child = Command::new(program())
        .args(commission)
        .env("XDG_STATE_HOME", own_state())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("`cargo build --bin yieldwall` comes before these tests");
    let (mut asks, mut answers) = (child.stderr.take().expect("piped"), child.stdin.take().expect("piped"));
    let mut commission = Running::of(child);
    // Whether the arm is free.
    answers.write_all(b"yes\n").expect("it reads");
    read_until(&mut asks, "anything else skips this check:");
    answers.write_all(b"yes\n").expect("it reads");
    let told = read_until(&mut asks, "anything else skips this check:");
    for name in ["left", "right"] {
        assert!(told.contains(&format!("{name} has not restarted since the question")), "{told}");
    }
    drop(first);
    let second = sim();
    answers.write_all(b"yes\n").expect("it reads");
    let mut lines = BufReader::with_capacity(1, commission.stdout()).lines().map(|line| line.expect("text"));
    assert!(lines.any(|line| line.starts_with("pass      parameters")));
    assert!(lines.by_ref().take(3).any(|line| line.trim() == "after a power cycle: unchanged"));
    drop(lines);
    commission.signal("INT");
    drop(second);
}
