//! What python-canopen and this project said to each other on a CAN interface, once more: the engines get what the other side
//! sent and have to say what they said then. `hil-tests/peers/capture.py` wrote the logs.

use std::time::Duration;

use hil_tests::network::{Participant, bare, client, device};
use yieldwall::canopen::{Frame, SdoClient};
use yieldwall::time::Time;

/// A frame of a log in the format of candump, and its time since the first.
fn parse(line: &str) -> (Time, Frame) {
    let mut words = line.split(' ');
    let time: f64 = words.next().unwrap().trim_matches(['(', ')']).parse().unwrap();
    let (id, data) = words.nth(1).unwrap().split_once('#').unwrap();
    let id = u16::from_str_radix(id, 16).unwrap();
    let frame = match data.strip_prefix('R') {
        Some(len) => Frame::remote(id, len.parse().unwrap_or(0)),
        None => {
            let bytes: Vec<_> =
                (0..data.len()).step_by(2).map(|at| u8::from_str_radix(&data[at..at + 2], 16).unwrap()).collect();
            Frame::new(id, &bytes)
        }
    };
    (Time((time * 1e9) as u64), frame)
}

fn frames(log: &str) -> Vec<(Time, Frame)> {
    log.lines().map(parse).collect()
}

/// Plays to a device what others sent, and compares what it says. Frames that `is_theirs` are of others.
fn answers_the_same(mut device: impl Participant, log: &str, is_theirs: impl Fn(&Frame) -> bool) {
    let mut expected: Vec<Frame> = Vec::new();
    let mut said: Vec<Frame> = Vec::new();
    device.switch_on(Time(0), &mut said);
    // It was switched on before the log began; what it said then may or may not be in there.
    let boot = std::mem::take(&mut said);
    let until = |device: &mut dyn Participant, time: Time, said: &mut Vec<Frame>| {
        while device.next_deadline() <= time {
            device.poll(device.next_deadline(), said);
        }
    };
    let mut last = Time(0);
    for (time, frame) in frames(log) {
        until(&mut device, time, &mut said);
        last = time;
        if is_theirs(&frame) {
            device.on_frame(time, &frame, &mut said);
        } else if !(expected.is_empty() && boot.contains(&frame)) {
            expected.push(frame);
        }
    }
    until(&mut device, last + Duration::from_millis(100), &mut said);
    for (at, (said, expected)) in said.iter().zip(&expected).enumerate() {
        assert_eq!(said, expected, "frame {at}");
    }
    assert_eq!(said.len(), expected.len());
    assert!(said.len() > 20, "{} frames", said.len());
}

#[test]
fn a_device_answers_the_client_and_the_master_of_python_canopen_as_it_did() {
    let log = include_str!("../../peers/captured/their-client.log");
    answers_the_same(device(5), log, |frame| matches!(frame.id(), 0x000 | 0x605) || frame.is_remote());
}

#[test]
fn a_device_answers_the_lss_master_of_python_canopen_as_it_did() {
    let log = include_str!("../../peers/captured/their-lss-master.log");
    answers_the_same(bare(), log, |frame| frame.id() == 0x7e5);
}

/// One request of our client.
type Start = fn(&mut SdoClient, Time, &[u8], &mut Vec<Frame>);

#[test]
fn the_client_asks_the_server_of_python_canopen_as_it_did() {
    let long: Vec<u8> = (0..100u32).map(|place| (place * 37 % 256) as u8).collect();
    let starts: [(Start, &[u8]); 7] = [
        (|client, now, _, out| client.start_upload(now, 0x2000, 0, out).unwrap(), &[]),
        (|client, now, data, out| client.start_download(now, 0x2001, 0, data, out).unwrap(), &long),
        (|client, now, _, out| client.start_upload(now, 0x2001, 0, out).unwrap(), &[]),
        (|client, now, data, out| client.start_block_download(now, 0x2001, 0, data, out).unwrap(), &long[..50]),
        (|client, now, _, out| client.start_block_upload(now, 0x2001, 0, out).unwrap(), &[]),
        (|client, now, data, out| client.start_download(now, 0x2000, 0, data, out).unwrap(), &[1]),
        (|client, now, _, out| client.start_upload(now, 0x5fff, 0, out).unwrap(), &[]),
    ];
    let mut log = frames(include_str!("../../peers/captured/our-client.log")).into_iter().filter(|(_, frame)| {
        // The server announces itself as a device; the client does not care.
        matches!(frame.id(), 0x605 | 0x585)
    });
    for (number, (start, data)) in starts.into_iter().enumerate() {
        let mut client = client(5);
        client.set_timeout(Duration::from_secs(60));
        let mut out = Vec::new();
        start(&mut client, Time(0), data, &mut out);
        loop {
            for frame in out.drain(..) {
                assert_eq!(Some(frame), log.next().map(|(_, frame)| frame), "request {number}");
            }
            if !client.is_busy() {
                break;
            }
            let (time, answer) = log.next().unwrap();
            assert_eq!(answer.id(), 0x585, "request {number}");
            client.on_frame(time, &answer, &mut out);
        }
    }
    assert_eq!(log.next(), None);
}
