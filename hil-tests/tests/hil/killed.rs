//! A command that changes drives and does not come to its end.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::time::Duration;

use super::programs::*;

/// Each signal at a commissioning by the wall clock whose first steps have written to the drives: one that is caught gives back what they
/// held, one that is not leaves a journal, and nothing moves before it is closed. `counted` are indices of objects that devices write themselves.
pub(super) fn what_the_drives_held_is_given_back(rig: &str, bus: &str, counted: &[&str]) {
    let state = std::env::temp_dir().join(format!("yieldwall-killed-{}", std::process::id()));
    let before = std::env::temp_dir().join(format!("yieldwall-killed-{}.dcf", std::process::id()));
    let before = before.to_str().expect("text");
    // Of an earlier process with this number.
    let _ = std::fs::remove_dir_all(&state);
    let start = |arguments: &[&str]| Running::start_with(&state, arguments);
    let desk = ["--bus", bus, "--rig", rig];
    let (code, _, error) = start(&[&["od", "dump", "right", "--force", "--out", before], &desk[..]].concat()).end();
    assert_eq!(code, OK, "{error}");
    let differing = || {
        let (code, document) = start(&[&["od", "diff", "right", before, "--json"], &desk[..]].concat()).document();
        assert!([OK, OUT_OF_TOLERANCE].contains(&code), "{document:#}");
        let all = document["differences"].as_array().expect("a list");
        let named = all.iter().map(|one| one["object"].as_str().expect("an address").to_owned());
        named.filter(|object| !counted.iter().any(|index| object.starts_with(index))).collect::<Vec<_>>()
    };
    let is_open = || journals(&state) > 0;
    assert_eq!((differing(), is_open()), (Vec::new(), false));
    // One that has failed gives it back too, whoever interrupts that: no drill is on record.
    let mut failed = start(&["commission", rig, "--bus", bus, "--yes", "--ignore-latency", "--from", "friction"]);
    let mut lines = BufReader::with_capacity(1, failed.stdout()).lines();
    assert!(lines.any(|line| line.expect("text").starts_with("fail      friction")));
    drop(lines);
    for _ in 0..20 {
        failed.signal("INT");
        std::thread::sleep(Duration::from_millis(100));
    }
    let (code, _, error) = failed.end();
    assert_eq!((code, is_open(), differing()), (OUT_OF_TOLERANCE, false, Vec::new()), "{error}");
    for signal in ["INT", "TERM", "HUP", "KILL"] {
        let mut commission =
            start(&["commission", rig, "--bus", bus, "--yes", "--ignore-latency", "--from", "identity"]);
        // Both drives were booted then.
        let mut lines = BufReader::with_capacity(1, commission.stdout()).lines();
        assert!(lines.any(|line| line.expect("text").starts_with("pass      identity")), "{signal}");
        assert!(is_open(), "{signal}: it is there before anything is written");
        drop(lines);
        commission.signal(signal);
        let (code, _, error) = commission.end();
        if signal != "KILL" {
            assert_eq!((code, is_open(), differing()), (INTERRUPTED, false, Vec::new()), "{signal}: {error}");
        }
    }
    assert!(!differing().is_empty(), "nothing was written: this shows nothing");
    assert!(is_open());
    let limits = ["--bus", bus, "--json"];
    for command in [
        &["jog", rig, "left", "--by", "1deg", "--ignore-latency"][..],
        &["run", rig, "--ignore-latency"],
        &["drill", rig],
        &["tune", "loop", rig, "--yes", "--ignore-latency"],
        &["sensor", "monitor", rig],
    ] {
        let (code, message, help) = refusal(start(&[command, &limits].concat()));
        assert_eq!(code, DEVICE_MISMATCH, "{message}");
        assert!(message.contains("`yieldwall commission` that did not come to its end"), "{message}");
        let interface = bus.rsplit('=').next().expect("a name");
        assert!(help.contains(&format!("`yieldwall commission {rig} --bus {interface} --restore`")), "{help}");
    }
    let restore = ["commission", rig, "--restore"];
    let (code, document) = start(&[&restore[..], &limits].concat()).document();
    assert_eq!((code, &document["restored"]), (OK, &true.into()), "{document:#}");
    assert_eq!((differing(), is_open()), (Vec::new(), false));
    std::fs::remove_dir_all(state).expect("it is there");
    std::fs::remove_file(before).expect("it is there");
}

/// How many journals are open.
fn journals(state: &Path) -> usize {
    std::fs::read_dir(state.join("yieldwall/journals")).map_or(0, Iterator::count)
}
