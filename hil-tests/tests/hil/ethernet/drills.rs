//! Whatever is done to a rig that runs: both drives stop, none is enabled again, and nothing moves once they have stopped.

use std::cell::RefCell;
use std::time::Duration;

use yieldwall::ethercat::frame::{Command, Datagrams, FrameWriter, address};
use yieldwall::link::{EthernetLink, PacketSocket, Role};
use yieldwall::time::Time;
use yieldwall_drives::cia402::State;

use super::super::programs::*;
use super::rigs::{PERIOD_US, Slow};
use super::served::{Seen, Served};

/// How long a program may go on before it is asked to end.
const LOOKED_AT: Duration = Duration::from_secs(1);
/// How far apart the drives may stop: one hears nothing more and has its watchdog, the other one is told.
const APART: Duration = Duration::from_micros(8 * PERIOD_US);
/// A stop from the greatest speed of the rig is over by then, and it takes the tool so far at most.
const STOPPING: Duration = Duration::from_millis(300);
const STOP_M: f64 = 0.02;
/// What an arm without torque moves by.
const REST_M: f64 = 0.0005;

/// A moment of up to so many milliseconds.
pub(super) fn pause(dice: &mut Dice, most_ms: u64) {
    std::thread::sleep(Duration::from_millis(dice.below(most_ms)));
}

/// What is done to a rig that runs; what it was.
fn disturb(dice: &mut Dice, slow: &Slow, devices: &Served) -> String {
    let place = dice.below(3) as usize;
    match dice.below(5) {
        0 => {
            let (name, second) = if dice.below(2) == 0 { ("run", slow.run("1")) } else { ("drill", slow.drill()) };
            let (code, message, _) = refusal(second);
            assert_eq!(code, BUS_UNAVAILABLE, "{message}");
            assert!(message.starts_with("a master is on this wire; nothing was sent"), "{message}");
            assert!(devices.seen().is_enabled(), "the first one goes on");
            format!("a second master, {name}")
        }
        1 => foreign(dice, devices),
        2 => {
            devices.act(move |server| server.segment_mut().expect("a segment").set_cable(place, false));
            pause(dice, 800);
            devices.act(move |server| server.segment_mut().expect("a segment").set_cable(place, true));
            format!("the cable before position {place} out and in")
        }
        3 => {
            let end = ["veth0", "veth1"][dice.below(2) as usize];
            let down = PutBack::down(end);
            pause(dice, 800);
            drop(down);
            format!("{end} down and up")
        }
        _ => {
            devices.act(move |server| {
                let now = server.now();
                server.segment_mut().expect("a segment").set_power(now, place, false);
            });
            pause(dice, 800);
            devices.act(move |server| {
                let now = server.now();
                server.segment_mut().expect("a segment").set_power(now, place, true);
            });
            format!("the device at position {place} off and on")
        }
    }
}

/// Frames of somebody else that name the devices as the rig's own master does.
fn foreign(dice: &mut Dice, devices: &Served) -> String {
    // Beside the program, which has the role of the master.
    let mut link = PacketSocket::open("veth0", Role::Node(99)).unwrap_or_else(|error| panic!("{error}"));
    let (_, outputs) = devices.seen().outputs.expect("outputs came");
    let station = 0x1000 + dice.below(3) as u16;
    let kind = dice.below(4);
    let mut buffer = [0; 1514];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).expect("room");
    match kind {
        // What the drives were told when they were enabled, but for the number of the frame; or a shutdown.
        0 | 1 => {
            for (number, datagram) in (200..).zip(Datagrams::of(&outputs).expect("it was one")) {
                let datagram = datagram.expect("a whole one");
                let mut data = datagram.data.to_vec();
                if kind == 1 {
                    data[..2].copy_from_slice(&[0x06, 0]);
                }
                writer.push(Command::Lwr, number, datagram.header.address, &data).expect("room");
            }
        }
        2 => drop(writer.push(Command::Fpwr, 200, address(station, 0x0120), &[1, 0]).expect("room")),
        _ => drop(writer.push(Command::Fprd, 200, address(station, 0x0130), &[0; 6]).expect("room")),
    }
    let frame = writer.finish().to_vec();
    for _ in 0..1 + dice.below(50) {
        link.send(&frame).expect("the interface is up");
        pause(dice, 2 * PERIOD_US / 1000);
    }
    match kind {
        0 => "old outputs from a stranger".to_owned(),
        1 => "a shutdown from a stranger".to_owned(),
        2 => format!("INIT for {station:04X}h from a stranger"),
        _ => format!("questions to {station:04X}h from a stranger"),
    }
}

/// What has to be so of drives that were enabled once, whatever was done to them.
pub(super) fn judge(seen: &Seen) {
    let is_on = |states: &[State; 2]| states.contains(&State::OperationEnabled);
    let states =
        || seen.states.iter().map(|(_, states)| states).skip_while(|states| **states != [State::OperationEnabled; 2]);
    for drive in [0, 1] {
        let mut after = states().map(|states| states[drive]).skip_while(|state| *state == State::OperationEnabled);
        assert!(!after.any(|state| state == State::OperationEnabled), "enabled again: {:?}", seen.states);
    }
    assert!(!seen.last().as_ref().is_some_and(is_on), "{:?}", seen.last());
    let [left, right] = seen.stopped_at().map(|at| at.expect("it was enabled"));
    let (first, last) = (left.min(right), left.max(right));
    assert!(last.since(first) <= APART, "the drives stopped {:?} apart", last.since(first));
    let [led, stop, rest] = [Time(0), first, last + STOPPING].map(|moment| seen.moved_since(moment));
    let apart = last.since(first);
    println!(
        "  apart {apart:?}; tool led {:.1} mm, {:.2} mm after the stop, {:.3} mm later",
        1e3 * led,
        1e3 * stop,
        1e3 * rest
    );
    assert!(stop <= STOP_M && rest <= REST_M, "the tool moved {stop} m after the stop, {rest} m of them later");
}

/// One of these is a test, so that they can run side by side, each on a cable of its own.
const PARTS: u64 = 4;

fn rigs_that_are_disturbed_stop_and_stay_where_they_are(part: u64) {
    let slow = Slow::new("disturbed");
    for seed in seeds(40).filter(|seed| seed % PARTS == part) {
        println!(
            "round {seed}; alone: YIELDWALL_SEED={seed} hil-tests/veth cargo test -p hil-tests --test hil ethernet::drills -- --ignored \
             --nocapture"
        );
        let mut dice = Dice(seed);
        let (devices, master) = slow.running();
        pause(&mut dice, 1500);
        let what = disturb(&mut dice, &slow, &devices);
        let master = RefCell::new(master);
        let begun = std::time::Instant::now();
        devices.until(|| master.borrow_mut().has_ended() || begun.elapsed() > LOOKED_AT, |_| false);
        let master = master.into_inner();
        if begun.elapsed() > LOOKED_AT {
            master.signal("INT");
        }
        let (code, document) = master.document();
        println!("  {what}: {code}, {}, {}", document["state"], document["cause"]);
        assert!([SAFETY_STOP, DEVICE_FAULT, TIMING_MISSED, INTERRUPTED].contains(&code), "{document:#}");
        // What was put back is there, and nobody enables anything.
        std::thread::sleep(LOOKED_AT / 2);
        judge(&devices.end());
    }
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn forty_rigs_that_are_disturbed_stop_and_stay_where_they_are_part_0() {
    rigs_that_are_disturbed_stop_and_stay_where_they_are(0);
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn forty_rigs_that_are_disturbed_stop_and_stay_where_they_are_part_1() {
    rigs_that_are_disturbed_stop_and_stay_where_they_are(1);
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn forty_rigs_that_are_disturbed_stop_and_stay_where_they_are_part_2() {
    rigs_that_are_disturbed_stop_and_stay_where_they_are(2);
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn forty_rigs_that_are_disturbed_stop_and_stay_where_they_are_part_3() {
    rigs_that_are_disturbed_stop_and_stay_where_they_are(3);
}

#[test]
fn a_stop_is_judged_by_what_was_seen() {
    let (on, off) = (State::OperationEnabled, State::SwitchOnDisabled);
    let at = |ms: u64| Time(ms * 1_000_000);
    let seen = |states: &[(u64, [State; 2])], to_m: f64| Seen {
        states: states.iter().map(|(ms, states)| (at(*ms), *states)).collect(),
        tool: vec![(at(0), [0.0; 2]), (at(1000), [0.0; 2]), (at(2000), [to_m, 0.0])],
        ..Seen::default()
    };
    let is_refused = |seen: Seen| std::panic::catch_unwind(|| judge(&seen)).is_err();
    assert!(!is_refused(seen(&[(0, [on; 2]), (500, [off; 2])], 0.0)));
    assert!(is_refused(seen(&[(0, [on; 2]), (500, [off; 2])], 0.01)), "it moves later");
    assert!(is_refused(seen(&[(0, [on; 2]), (500, [off, on]), (900, [off; 2])], 0.0)), "too far apart");
    assert!(
        is_refused(seen(&[(0, [on; 2]), (500, [off; 2]), (510, [on, off]), (520, [off; 2])], 0.0)),
        "enabled again"
    );
    assert!(is_refused(seen(&[(0, [on; 2]), (500, [off, on])], 0.0)), "one goes on");
}
