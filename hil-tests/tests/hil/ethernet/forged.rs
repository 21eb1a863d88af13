//! Frames with the source of the rig's own master, which it never sent: each is named, the drives stop, and neither loses its watchdog.

use std::cell::RefCell;
use std::time::Duration;

use yieldwall::ethercat::frame::{Command, Datagrams, FrameWriter, PROCESSED, SOURCE, address};
use yieldwall::ethercat::registers as register;
use yieldwall::link::{EthernetLink, PacketSocket, Role};

use super::super::programs::*;
use super::drills::{judge, pause};
use super::rigs::Slow;
use super::served::Served;

/// Cycles within which a forged frame is named, and a watchdog is written back.
const NAMED: u64 = 2;
/// A program has to end within this time.
const ENDED: Duration = Duration::from_secs(3);

/// Effects of forged frames, one a kind.
const KINDS: [&str; 12] = [
    "outputs of a cycle before",
    "a shutdown",
    "targets a little farther",
    "watchdogs off, each",
    "watchdogs off, all at once",
    "the tick of the watchdog",
    "another station address",
    "INIT",
    "sync manager 2 off",
    "no process data by FMMU",
    "the torque limit by mailbox",
    "the offset of a clock",
];

/// Builds a frame of a kind as the master could have sent it.
fn forged(kind: usize, outputs: &[u8], drive: u16, index: u8) -> Vec<u8> {
    let mut source: [u8; 6] = outputs[6..12].try_into().expect("six bytes");
    source[0] &= !PROCESSED;
    let mut buffer = [0; 1514];
    let mut writer = FrameWriter::new(&mut buffer, source).expect("room");
    let station = 0x1000 + drive;
    let mut push = |command, at, data: &[u8]| {
        writer.push(command, index, at, data).expect("room");
    };
    match kind {
        0..=2 => {
            for datagram in Datagrams::of(outputs).expect("it was one") {
                let datagram = datagram.expect("a whole one");
                let mut data = datagram.data.to_vec();
                match kind {
                    1 => data[..2].copy_from_slice(&[0x06, 0]),
                    2 if data.len() >= 6 => data[2] = data[2].wrapping_add(200),
                    _ => {}
                }
                push(Command::Lwr, datagram.header.address, &data);
            }
        }
        3 => [0x1000, 0x1001]
            .iter()
            .for_each(|to| push(Command::Fpwr, address(*to, register::WATCHDOG_SYNC_MANAGER), &[0; 2])),
        4 => push(Command::Bwr, address(0, register::WATCHDOG_SYNC_MANAGER), &[0; 2]),
        5 => push(Command::Fpwr, address(station, register::WATCHDOG_DIVIDER), &[0xff; 2]),
        6 => push(Command::Fpwr, address(station, register::STATION_ADDRESS), &[9, 0x10]),
        7 => push(Command::Fpwr, address(station, register::AL_CONTROL), &[1, 0]),
        8 => push(Command::Fpwr, address(station, register::SYNC_MANAGER + 0x16), &[0]),
        9 => push(Command::Fpwr, address(station, register::FMMU), &[0; 16]),
        // An SDO download of 6072h, expedited: mailbox header, CoE, SDO.
        10 => push(
            Command::Fpwr,
            address(station, 0x1000),
            &[[10, 0, 0, 0, 0, 0x73, 0, 0x20, 0x2b, 0x72, 0x60, 0, 0, 0, 0, 0], [0; 16], [0; 16]].concat(),
        ),
        _ => push(Command::Fpwr, address(station, register::DC_OFFSET), &[0, 0, 1, 0, 0, 0, 0, 0]),
    }
    writer.finish().to_vec()
}

/// Tick and time of the watchdogs of both drives, as they stand in the devices.
fn watchdogs(devices: &Served) -> Vec<Vec<u8>> {
    let (tell, told) = std::sync::mpsc::channel();
    devices.act(move |server| {
        let now = server.now();
        let segment = server.segment_mut().expect("a segment");
        let places = [0u16, 1].map(|position| {
            [register::WATCHDOG_DIVIDER, register::WATCHDOG_SYNC_MANAGER].map(|register| (position, register))
        });
        let read = places.as_flattened().iter().map(|(position, register)| {
            let mut buffer = [0; 64];
            let mut writer = FrameWriter::new(&mut buffer, SOURCE).expect("room");
            let at = writer.push(Command::Aprd, 0, address(position.wrapping_neg(), *register), &[0; 2]).expect("room");
            let frame = writer.finish();
            segment.process(now, frame);
            frame[at].to_vec()
        });
        tell.send(read.collect()).expect("it is waited for");
    });
    told.recv().expect("the devices are served")
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn forged_frames_are_named_and_take_no_watchdog_away() {
    let slow = Slow::new("forged");
    for seed in seeds(12) {
        println!(
            "round {seed}; alone: YIELDWALL_SEED={seed} hil-tests/veth cargo test -p hil-tests --test hil ethernet::forged -- --ignored \
             --nocapture"
        );
        let is_judged = (0..TRIES).any(|_| is_judged(&slow, seed));
        assert!(is_judged, "this computer was too late in {TRIES} tries");
    }
}

/// Plays one round. Returns `false` if the computer was too late for a judgement.
fn is_judged(slow: &Slow, seed: u64) -> bool {
    let mut dice = Dice(seed);
    let (devices, master) = slow.running();
    let before = watchdogs(&devices);
    pause(&mut dice, 700);
    let (_, outputs) = devices.seen().outputs.expect("outputs came");
    // The kinds alternate. In half of the rounds the master is killed.
    let (kind, is_killed) = (seed as usize % KINDS.len(), dice.below(2) == 0);
    let frame = forged(kind, &outputs, dice.below(2) as u16, dice.below(256) as u8);
    let mut link = PacketSocket::open("veth0", Role::Node(99)).unwrap_or_else(|error| panic!("{error}"));
    let cycles = devices.seen().cycles;
    link.send(&frame).expect("the interface is up");
    println!("  {}{}", KINDS[kind], if is_killed { ", then kill -9" } else { "" });
    let begun = std::time::Instant::now();
    let is_over = || begun.elapsed() > ENDED;
    if is_killed {
        // The forged frame may count as a cycle as well. A master that has ended sends no more of them.
        devices.until(is_over, |seen| seen.cycles >= cycles + NAMED + 2);
        pause(&mut dice, 60);
        master.signal("KILL");
        let killed = std::time::Instant::now();
        devices.until(|| killed.elapsed() > ENDED, |_| false);
    } else {
        let master = RefCell::new(master);
        devices.until(|| master.borrow_mut().has_ended() || is_over(), |_| false);
        let (code, document) = master.into_inner().document();
        if code == TIMING_MISSED {
            println!("this computer was too late: {}", document["cause"]);
            return false;
        }
        assert_eq!((code, &document["cause"]), (SAFETY_STOP, &"intruder".into()), "{}: {document:#}", KINDS[kind]);
    }
    assert_eq!(watchdogs(&devices), before, "{}", KINDS[kind]);
    judge(&devices.end());
    true
}
