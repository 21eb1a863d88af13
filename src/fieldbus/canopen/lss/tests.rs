//! Both sides against literal bytes of CiA 305, and against each other.

use std::time::Duration;

use proptest::prelude::*;

use super::super::{Frame, node_id};
use super::*;
use crate::time::Time;

const NOW: Time = Time(0);
const TIMEOUT: Duration = Duration::from_millis(10);
const ADDRESS: LssAddress =
    LssAddress { vendor_id: 0x0102_0304, product_code: 0x8000_0001, revision: 0, serial: 0xffff_fffe };

fn master() -> LssMaster {
    LssMaster::new(TIMEOUT)
}

fn sent(master: &mut LssMaster, request: LssRequest) -> (Option<LssOutcome>, Vec<[u8; 8]>) {
    let mut out = Vec::new();
    let outcome = master.start(NOW, request, &mut out).unwrap();
    assert!(out.iter().all(|frame| frame.id() == 0x7e5));
    (outcome, out.iter().map(|frame| *frame.bytes()).collect())
}

/// Asks devices one thing, in virtual time, and returns the outcome and the questions it took.
fn ask(master: &mut LssMaster, slaves: &mut [LssSlave], request: LssRequest) -> (LssOutcome, usize) {
    let mut out = Vec::new();
    let mut outcome = master.start(NOW, request, &mut out).unwrap();
    let mut asked = 0;
    let mut now = NOW;
    loop {
        let mut answers = Vec::new();
        for question in std::mem::take(&mut out) {
            asked += 1;
            answers.extend(slaves.iter_mut().filter_map(|slave| slave.on_request(question.bytes()).0));
        }
        if let Some(outcome) = outcome {
            return (outcome, asked);
        }
        // Several devices answer with one frame, since it is the same.
        match answers.first() {
            Some(answer) => outcome = master.on_frame(now, &Frame::new(0x7e4, answer), &mut out),
            None => {
                now = master.next_deadline();
                outcome = master.poll(now, &mut out);
            }
        }
    }
}

#[test]
fn requests_are_those_of_cia_305() {
    let node = node_id(0x20).ok();
    let cases = [
        (LssRequest::SwitchAll { to_configuration: true }, vec![[0x04, 1, 0, 0, 0, 0, 0, 0]]),
        (LssRequest::SwitchAll { to_configuration: false }, vec![[0x04, 0, 0, 0, 0, 0, 0, 0]]),
        (
            LssRequest::SwitchOne(ADDRESS),
            vec![
                [0x40, 4, 3, 2, 1, 0, 0, 0],
                [0x41, 1, 0, 0, 0x80, 0, 0, 0],
                [0x42, 0, 0, 0, 0, 0, 0, 0],
                [0x43, 0xfe, 0xff, 0xff, 0xff, 0, 0, 0],
            ],
        ),
        (LssRequest::InquireIdentity, vec![[0x5a, 0, 0, 0, 0, 0, 0, 0]]),
        (LssRequest::InquireNodeId, vec![[0x5e, 0, 0, 0, 0, 0, 0, 0]]),
        (LssRequest::ConfigureNodeId(node), vec![[0x11, 0x20, 0, 0, 0, 0, 0, 0]]),
        (LssRequest::ConfigureNodeId(None), vec![[0x11, 0xff, 0, 0, 0, 0, 0, 0]]),
        (LssRequest::ConfigureBitTiming { index: 2 }, vec![[0x13, 0, 2, 0, 0, 0, 0, 0]]),
        (LssRequest::ActivateBitTiming { delay_ms: 0x1234 }, vec![[0x15, 0x34, 0x12, 0, 0, 0, 0, 0]]),
        (LssRequest::Store, vec![[0x17, 0, 0, 0, 0, 0, 0, 0]]),
        (LssRequest::Fastscan, vec![[0x51, 0, 0, 0, 0, 0x80, 0, 0]]),
    ];
    for (request, expected) in cases {
        let mut master = master();
        let (outcome, frames) = sent(&mut master, request);
        assert_eq!(frames, expected);
        let is_unanswered = matches!(request, LssRequest::SwitchAll { .. } | LssRequest::ActivateBitTiming { .. });
        assert_eq!((outcome, master.is_busy()), (is_unanswered.then_some(LssOutcome::Done), !is_unanswered));
    }
}

#[test]
fn answers_refusals_and_silence() {
    let mut out = Vec::new();
    let mut master = master();
    sent(&mut master, LssRequest::Store);
    assert_eq!(master.start(NOW, LssRequest::Store, &mut out), Err(super::super::CanopenError::LssBusy));
    // Answers to something else.
    for bytes in [&[0x11, 0, 0, 0, 0, 0, 0, 0][..], &[0x17, 0, 0, 0, 0, 0, 0]] {
        assert_eq!(master.on_frame(NOW, &Frame::new(0x7e4, bytes), &mut out), None);
    }
    let refused = Frame::new(0x7e4, &[0x17, 2, 7, 0, 0, 0, 0, 0]);
    assert_eq!(master.on_frame(NOW, &refused, &mut out), Some(LssOutcome::Refused { error: 2, detail: 7 }));
    sent(&mut master, LssRequest::InquireNodeId);
    let answer = Frame::new(0x7e4, &[0x5e, 0xff, 0, 0, 0, 0, 0, 0]);
    assert_eq!(master.on_frame(NOW, &answer, &mut out), Some(LssOutcome::NodeId(None)));
    sent(&mut master, LssRequest::SwitchOne(ADDRESS));
    assert_eq!((master.poll(NOW, &mut out), master.next_deadline()), (None, NOW + TIMEOUT));
    assert_eq!(master.poll(NOW + TIMEOUT, &mut out), Some(LssOutcome::NoAnswer));
    assert_eq!(master.next_deadline(), Time::NEVER);
}

#[test]
fn one_of_several_devices_is_selected_and_asked() {
    let other = LssAddress { serial: 7, ..ADDRESS };
    let mut slaves = [LssSlave::new(other, node_id(1).ok()), LssSlave::new(ADDRESS, node_id(2).ok())];
    let mut master = master();
    assert_eq!(ask(&mut master, &mut slaves, LssRequest::InquireNodeId).0, LssOutcome::NoAnswer);
    assert_eq!(ask(&mut master, &mut slaves, LssRequest::SwitchOne(ADDRESS)).0, LssOutcome::Done);
    assert_eq!(ask(&mut master, &mut slaves, LssRequest::InquireIdentity).0, LssOutcome::Identity(ADDRESS));
    assert_eq!(ask(&mut master, &mut slaves, LssRequest::InquireNodeId).0, LssOutcome::NodeId(node_id(2).ok()));
    let third = LssAddress { serial: 8, ..ADDRESS };
    ask(&mut master, &mut slaves, LssRequest::SwitchAll { to_configuration: false });
    assert_eq!(ask(&mut master, &mut slaves, LssRequest::SwitchOne(third)).0, LssOutcome::NoAnswer);
}

/// Whoever is identified stays as it is: only the one with this very address answers.
#[test]
fn a_device_is_identified_by_its_address_and_stays_in_its_mode() {
    let mut master = master();
    let (outcome, sent) = sent(&mut master, LssRequest::Identify(ADDRESS));
    assert_eq!(outcome, None);
    assert_eq!(
        sent,
        [
            [0x46, 0x04, 0x03, 0x02, 0x01, 0, 0, 0],
            [0x47, 0x01, 0x00, 0x00, 0x80, 0, 0, 0],
            [0x48, 0, 0, 0, 0, 0, 0, 0],
            [0x49, 0, 0, 0, 0, 0, 0, 0],
            [0x4a, 0xfe, 0xff, 0xff, 0xff, 0, 0, 0],
            [0x4b, 0xfe, 0xff, 0xff, 0xff, 0, 0, 0],
        ]
    );
    let mut master = LssMaster::new(TIMEOUT);
    let other = LssAddress { serial: ADDRESS.serial + 1, ..ADDRESS };
    for (address, wanted) in [(ADDRESS, LssOutcome::Done), (other, LssOutcome::NoAnswer)] {
        let mut slaves = [LssSlave::new(ADDRESS, node_id(5).ok())];
        assert_eq!(ask(&mut master, &mut slaves, LssRequest::Identify(address)).0, wanted, "{address:?}");
        // Nobody is in configuration.
        assert_eq!(ask(&mut master, &mut slaves, LssRequest::InquireNodeId).0, LssOutcome::NoAnswer);
    }
}

#[test]
fn parts_of_an_address_count_in_order_only() {
    let mut slave = LssSlave::new(ADDRESS, None);
    let parts = ADDRESS.parts();
    for order in [[0, 1, 3, 2], [1, 2, 3, 0], [0, 2, 1, 3]] {
        let answers = order.map(|part: u8| slave.on_request(&with_number(0x40 + part, parts[usize::from(part)])).0);
        assert_eq!(answers, [None; 4]);
    }
    let identify = |slave: &mut LssSlave, low: u32, high: u32| {
        let numbers = [parts[0], parts[1], 0, 5, low, high];
        (0x46..).zip(numbers).filter_map(|(command, number)| slave.on_request(&with_number(command, number)).0).last()
    };
    assert_eq!(identify(&mut slave, 0xffff_fff0, 0xffff_ffff), Some([0x4f, 0, 0, 0, 0, 0, 0, 0]));
    assert_eq!(identify(&mut slave, 0, 0xffff_fff0), None);
}

#[test]
fn fastscan_finds_nobody_and_only_devices_without_node_id() {
    let mut master = master();
    assert_eq!(ask(&mut master, &mut [], LssRequest::Fastscan), (LssOutcome::NoAnswer, 1));
    let mut slaves = [LssSlave::new(ADDRESS, node_id(4).ok())];
    assert_eq!(ask(&mut master, &mut slaves, LssRequest::Fastscan), (LssOutcome::NoAnswer, 1));
}

proptest! {
    #[test]
    fn fastscan_finds_every_device_one_after_the_other(
        parts in proptest::collection::hash_set(any::<[u32; 4]>(), 1..6),
    ) {
        let mut slaves: Vec<_> = parts.iter().map(|&parts| LssSlave::new(LssAddress::of_parts(parts), None)).collect();
        let mut master = master();
        let mut found = std::collections::HashSet::new();
        for raw in 1..=slaves.len() as u8 {
            let (outcome, asked) = ask(&mut master, &mut slaves, LssRequest::Fastscan);
            let LssOutcome::Identity(address) = outcome else { panic!("{outcome:?}") };
            prop_assert_eq!(asked, 133);
            prop_assert!(found.insert(address.parts()));
            let configured = ask(&mut master, &mut slaves, LssRequest::ConfigureNodeId(node_id(raw).ok())).0;
            prop_assert_eq!(configured, LssOutcome::Done);
            ask(&mut master, &mut slaves, LssRequest::SwitchAll { to_configuration: false });
        }
        prop_assert_eq!(found, parts);
        prop_assert_eq!(ask(&mut master, &mut slaves, LssRequest::Fastscan).0, LssOutcome::NoAnswer);
    }

    #[test]
    fn no_bytes_break_either_side(
        payloads in proptest::collection::vec((any::<bool>(), 0u8..0x60, any::<[u8; 8]>()), 0..100),
        request in 0usize..4,
    ) {
        let mut slave = LssSlave::new(ADDRESS, None);
        let mut master = master();
        let mut out = Vec::new();
        let requests =
            [LssRequest::Fastscan, LssRequest::InquireIdentity, LssRequest::Store, LssRequest::SwitchOne(ADDRESS)];
        for (is_known, command, mut payload) in payloads {
            payload[0] = if is_known { command } else { payload[0] };
            slave.on_request(&payload);
            let _ = master.start(NOW, requests[request], &mut out);
            master.on_frame(NOW, &Frame::new(0x7e4, &payload), &mut out);
            master.poll(master.next_deadline(), &mut out);
        }
    }
}
