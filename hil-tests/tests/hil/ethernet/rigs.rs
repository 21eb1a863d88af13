//! The programs on the near end of the cable, and the rig that they run.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::super::programs::*;
use super::served::{FAR, Served};

/// The interface of the programs under test.
pub(super) const NEAR: &str = "main=veth0";

/// The shipped rig in position mode at a cycle that any computer keeps, and two scenes, as files that go with this.
pub(super) struct Slow {
    pub(super) rig: String,
    /// A hand that leads the tool for two seconds, until it meets the circle.
    pub(super) scene: String,
    /// A hand that rests.
    rest: String,
}

/// So slow, in us.
pub(super) const PERIOD_US: u64 = 20_000;

impl Slow {
    /// `name` is that of the test.
    pub(super) fn new(name: &str) -> Self {
        let slow = format!(
            "rig:\n  name: slow-ethercat\n  command_mode: position\ncycle:\n  period_us: {PERIOD_US}\n  compute_at_us: {}\n\
             guard:\n  tool_speed_limit_m_per_s: 0.25\n  force_limit_n: 140.0\n",
            PERIOD_US / 2
        );
        let rig = changed(name, "paper-ethercat.yaml", &[("rig:\n  name: paper-ethercat\n", &slow)]);
        let slowly = ("in_s: 1.5}              # hits", "in_s: 4.0} # hits");
        let scene = changed(&format!("{name}-scene"), "scenes/circle-hold.yaml", &[slowly]);
        let at_rest = ("in_s: 1.5}              # hits", "in_s: 900.0} # hits");
        let rest = changed(&format!("{name}-rest"), "scenes/circle-hold.yaml", &[at_rest]);
        Self { rig, scene, rest }
    }

    /// The devices in this process.
    pub(super) fn served(&self) -> Served {
        Served::new(&self.rig, &self.scene)
    }

    /// The devices in this process, with a hand that rests.
    pub(super) fn resting(&self) -> Served {
        Served::new(&self.rig, &self.rest)
    }

    /// The devices as a program that tells in JSON of its end, with a hand that rests.
    pub(super) fn sim(&self) -> Running {
        let bus = format!("main={FAR}");
        let sim = Running::start(&["sim", &self.rig, "--bus", &bus, "--scene", &self.rest, "--json"]);
        // It says nothing before its end: its socket is the first one here.
        let begun = Instant::now();
        while std::fs::read_to_string("/proc/net/packet").expect("procfs").lines().count() < 2 {
            assert!(begun.elapsed() < LIMIT, "no socket");
            std::thread::sleep(Duration::from_millis(10));
        }
        sim
    }

    pub(super) fn run(&self, seconds: &str) -> Running {
        Running::start(&["run", &self.rig, "--bus", NEAR, "--json", "--ignore-latency", "--duration", seconds])
    }

    /// A master in a network namespace of its own, where its interface is `e0`.
    pub(super) fn run_in(&self, namespace: &str, seconds: &str) -> Running {
        let run = ["run", &self.rig, "--bus", "main=e0", "--json", "--ignore-latency", "--duration", seconds];
        Running::start_in(namespace, &run)
    }

    pub(super) fn drill(&self) -> Running {
        Running::start(&["drill", &self.rig, "--bus", NEAR, "--json"])
    }

    /// Has a drill on record, with which `run` enables the drives; what it found where this is the first one.
    pub(super) fn drilled(&self) -> Option<Value> {
        static IS_DONE: Mutex<bool> = Mutex::new(false);
        let mut is_done = IS_DONE.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if *is_done {
            return None;
        }
        for _ in 0..TRIES {
            let devices = self.resting();
            let (code, document) = self.drill().document();
            drop(devices);
            if code == OK {
                *is_done = true;
                return Some(document);
            }
            println!("this computer was too late for a drill: {document:#}");
        }
        panic!("no drill in {TRIES} tries");
    }

    /// Both drives enabled by `run` for a while, in so many tries: the devices, and the program.
    pub(super) fn running(&self) -> (Served, Running) {
        self.drilled();
        for _ in 0..TRIES {
            let devices = self.served();
            let run = std::cell::RefCell::new(self.run("600"));
            let cycles = 25 * PERIOD_US * 1000;
            let is_moving = |seen: &super::served::Seen| {
                let since = seen.states.last().map_or(0, |(since, _)| since.0);
                seen.is_enabled() && seen.tool.last().is_some_and(|(now, _)| now.0 > since + cycles)
            };
            if devices.until(|| run.borrow_mut().has_ended(), is_moving) {
                return (devices, run.into_inner());
            }
            println!("this computer was too late: {:?}", run.into_inner().end());
        }
        panic!("not enabled in {TRIES} tries");
    }
}

impl Drop for Slow {
    fn drop(&mut self) {
        for file in [&self.rig, &self.scene, &self.rest] {
            let _ = std::fs::remove_file(file);
        }
    }
}
