//! Two masters behind a bridge, neither of which sees the other one's lock.

use std::cell::RefCell;
use std::process::{Command, Stdio};
use std::time::Duration;

use super::super::programs::*;
use super::ip;
use super::rigs::Slow;

/// From Operation Enabled to where the fixture leads the tool.
const RUNS: Duration = Duration::from_secs(1);
const NAMESPACES: [&str; 2] = ["first", "second"];

/// A bridge with `veth0` and an interface of each namespace in it, for as long as this is there.
struct Bridge;

impl Bridge {
    fn new() -> Self {
        ip("link add bridge type bridge");
        ip("link set bridge up");
        ip("link set veth0 master bridge");
        for name in NAMESPACES {
            // One that was killed leaves the name.
            let _ = Command::new("ip").args(["netns", "del", name]).stderr(Stdio::null()).status();
            ip(&format!("netns add {name}"));
            ip(&format!("link add {name} type veth peer name e0 netns {name}"));
            ip(&format!("link set {name} master bridge up"));
            ip(&format!("-n {name} link set e0 up"));
        }
        Self
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        for name in NAMESPACES {
            ip(&format!("link del {name}"));
            ip(&format!("netns del {name}"));
        }
        ip("link del bridge");
    }
}

/// The first one stands still until its drives have stopped and the second one has enabled them.
#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_master_that_stood_still_and_the_one_in_its_place_name_each_other() {
    let slow = Slow::new("two-masters");
    slow.drilled();
    let _bridge = Bridge::new();
    let attempt = || {
        let devices = slow.resting();
        let first = RefCell::new(slow.run_in("first", "600"));
        if !devices.until(|| first.borrow_mut().has_ended(), |seen| seen.is_enabled()) {
            return Err(first.into_inner().document());
        }
        std::thread::sleep(RUNS);
        first.borrow().signal("STOP");
        assert!(devices.until(|| false, |seen| !seen.is_enabled()), "the watchdogs");
        let second = RefCell::new(slow.run_in("second", "600"));
        if !devices.until(|| second.borrow_mut().has_ended(), |seen| seen.is_enabled()) {
            return Err(second.into_inner().document());
        }
        std::thread::sleep(RUNS);
        first.borrow().signal("CONT");
        let both = [first, second].map(|master| master.into_inner().document());
        assert!(!devices.end().is_enabled());
        Ok(both)
    };
    for _ in 0..TRIES {
        let both = match attempt() {
            Ok(both) => both,
            Err((_, late)) => {
                println!("this computer was too late: {late:#}");
                std::thread::sleep(Duration::from_secs(1));
                continue;
            }
        };
        let named = both.map(|(code, document)| {
            assert_eq!((code, &document["cause"]), (SAFETY_STOP, &"intruder".into()), "{document:#}");
            let sign = document["segment"][0].as_str().expect("a finding").to_owned();
            assert!(sign.starts_with("another master writes: an EtherCAT frame came from "), "{document:#}");
            sign
        });
        assert_ne!(named[0], named[1], "each has its own address");
        return;
    }
    panic!("not both in {TRIES} tries");
}
