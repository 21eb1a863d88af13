//! What takes more than one datagram to see.

use super::*;
use proptest::prelude::*;
use yieldwall_fieldbus::ethercat::frame::Command;
use yieldwall_fieldbus::ethercat::{AlState, AlStatusCode};

const US: u64 = 1000;

/// Brings a device of [`three`] to SAFE-OP, by position.
fn to_safe_op(segment: &mut Segment<ObjectDictionary>, now: Time, place: u16, has_outputs: bool) {
    let adp = 0u16.wrapping_sub(place);
    let mailboxes = bytes("0010400026000100 0014400022000100");
    ask(segment, now, Command::Apwr, adp, 0x0800, &mailboxes);
    ask(segment, now, Command::Apwr, adp, 0x0120, &[0x02, 0]);
    let data = if has_outputs { "0018020064000100 001c020020000100" } else { "0000000000000000 001c040020000100" };
    ask(segment, now, Command::Apwr, adp, 0x0810, &bytes(data));
    ask(segment, now, Command::Apwr, adp, 0x0120, &[0x04, 0]);
    let (status, _) = ask(segment, now, Command::Aprd, adp, 0x0130, &[0; 6]);
    assert_eq!(status, [4, 0, 0, 0, 0, 0], "device {place}");
}

#[test]
fn the_reply_is_back_after_its_bytes_and_devices() {
    let mut segment = three();
    // 60 bytes at least, 12 around them, 80 ns each; three devices of 1 us.
    let mut short = framed(&bytes("07 02 0000 0000 0100 0000 00 0000"));
    assert_eq!(segment.process(Time(5), &mut short), Some(Time(5 + 72 * 80 + 3000)));
    let mut long = framed(&[&bytes("07 02 0000 0000 8403 0000")[..], &[0; 902]].concat());
    assert_eq!(segment.process(Time(5), &mut long), Some(Time(5 + (928 + 12) * 80 + 3000)));
    let mut foreign = short.clone();
    foreign[13] = 0x00;
    let before = foreign.clone();
    assert_eq!(segment.process(Time(9), &mut foreign), None, "a frame of another type is not passed on");
    assert_eq!(foreign, before);
}

#[test]
fn a_pulled_cable_shortens_the_segment_and_shows_in_the_ports() {
    let mut segment = three();
    let count = |segment: &mut Segment<_>| ask(segment, Time(0), Command::Brd, 0, 0, &[0]).1;
    assert_eq!(count(&mut segment), 3);
    segment.set_cable(2, false);
    assert_eq!((count(&mut segment), segment.reached()), (2, 2));
    let (status, _) = ask(&mut segment, Time(0), Command::Aprd, 0xffff, 0x0110, &[0; 2]);
    assert_eq!(status, [0x10, 0x56]);
    let (lost, _) = ask(&mut segment, Time(0), Command::Aprd, 0xffff, 0x0310, &[0; 4]);
    assert_eq!(lost, [0, 1, 0, 0]);
    ask(&mut segment, Time(0), Command::Apwr, 0xffff, 0x0311, &[0]);
    let (lost, _) = ask(&mut segment, Time(0), Command::Aprd, 0xffff, 0x0310, &[0; 4]);
    assert_eq!(lost, [0; 4], "a write clears all of them");
    segment.set_cable(2, true);
    assert_eq!(count(&mut segment), 3);
    segment.set_cable(0, false);
    assert_eq!(segment.process(Time(0), &mut framed(&bytes("07 02 0000 0000 0100 0000 00 0000"))), None);
    segment.set_cable(0, true);
    segment.set_power(Time(0), 1, false);
    assert_eq!(count(&mut segment), 1);
    segment.set_power(Time(0), 1, true);
    assert_eq!(count(&mut segment), 3);
}

#[test]
fn a_silent_device_passes_frames_on() {
    let mut segment = three();
    segment.controller_mut(1).unwrap().set_silent(true);
    assert_eq!(ask(&mut segment, Time(0), Command::Brd, 0, 0, &[0]).1, 2);
    assert_eq!(ask(&mut segment, Time(0), Command::Aprd, 0xfffe, 0x0110, &[0; 2]), (vec![0x10, 0x56], 1));
}

#[test]
fn damaged_frames_are_counted() {
    let mut segment = three();
    let mut torn = framed(&bytes("07 02 0000 0000 0100 0000 00 0000"));
    torn[22] = 9;
    assert!(segment.process(Time(0), &mut torn).is_some());
    segment.controller_mut(2).unwrap().count_receive_error(0);
    assert_eq!(ask(&mut segment, Time(0), Command::Aprd, 0, 0x030c, &[0]), (vec![1], 1));
    assert_eq!(ask(&mut segment, Time(0), Command::Aprd, 0xfffe, 0x0300, &[0; 2]), (vec![1, 0], 1));
    ask(&mut segment, Time(0), Command::Bwr, 0, 0x0300, &[0]);
    assert_eq!(ask(&mut segment, Time(0), Command::Brd, 0, 0x0300, &[0; 13]).0, [0; 13]);
}

#[test]
fn two_devices_with_inputs_and_outputs_give_a_working_counter_of_six() {
    let mut segment = three();
    for place in 0..2u16 {
        to_safe_op(&mut segment, Time(0), place, true);
        let (inputs, outputs) = (2 * place as u8, 8 + 2 * place as u8);
        let fmmus = [
            &[inputs, 0, 1, 0, 2, 0, 0, 7, 0x00, 0x1c, 0, 1, 1, 0, 0, 0][..],
            &[outputs, 0, 1, 0, 2, 0, 0, 7, 0x00, 0x18, 0, 2, 1, 0, 0, 0],
        ];
        ask(&mut segment, Time(0), Command::Apwr, 0u16.wrapping_sub(place), 0x0600, &fmmus.concat());
    }
    to_safe_op(&mut segment, Time(0), 2, false);
    let (image, counter) = ask(&mut segment, Time(0), Command::Lrw, 0, 1, &[0; 12]);
    assert_eq!((&image[..4], counter), (&[0x50, 0x02, 0x50, 0x02][..], 6));
    segment.controller_mut(1).unwrap().set_silent(true);
    assert_eq!(ask(&mut segment, Time(0), Command::Lrw, 0, 1, &[0; 12]).1, 3);
}

#[test]
fn outputs_reach_the_dictionary_in_op_alone() {
    let mut segment = three();
    to_safe_op(&mut segment, Time(0), 0, true);
    let word = |segment: &Segment<ObjectDictionary>| segment.controller(0).unwrap().device().raw(0x6040, 0);
    ask(&mut segment, Time(0), Command::Apwr, 0, 0x1800, &[0x06, 0]);
    assert_eq!(word(&segment), 0);
    ask(&mut segment, Time(0), Command::Apwr, 0, 0x0120, &[8, 0]);
    ask(&mut segment, Time(0), Command::Apwr, 0, 0x1800, &[0x07, 0]);
    assert_eq!(word(&segment), 7);
    let controller = segment.controller_mut(0).unwrap();
    controller.fail(Time(0), AlStatusCode::NO_INPUTS);
    assert_eq!(controller.al_status().to_string(), "SAFE-OP+ERR");
    assert_eq!(ask(&mut segment, Time(0), Command::Apwr, 0, 0x1800, &[0x0f, 0]).1, 0);
    assert_eq!(word(&segment), 7);
}

#[test]
fn sync0_applies_outputs_and_latches_inputs() {
    let mut segment = three();
    let mut now = Time(10_000);
    let set = |segment: &mut Segment<_>, now, ado, data: &[u8]| {
        assert_eq!(ask(segment, now, Command::Apwr, 0, ado, data).1, 1)
    };
    set(&mut segment, now, 0x09a0, &250_000u32.to_le_bytes());
    set(&mut segment, now, 0x0990, &1_000_000u64.to_le_bytes());
    set(&mut segment, now, 0x0981, &[3]);
    to_safe_op(&mut segment, now, 0, true);
    set(&mut segment, now, 0x1800, &[0x06, 0]);
    set(&mut segment, now, 0x0120, &[8, 0]);
    let state = |segment: &Segment<_>| segment.controller(0).unwrap().al_status().state();
    assert_eq!(state(&segment), Some(AlState::SafeOperational), "no SYNC0 yet");
    assert_eq!(segment.next_deadline(), Time(1_000_000));
    segment.poll(Time(1_000_000));
    assert_eq!(state(&segment), Some(AlState::Operational));
    now = Time(1_100 * US);
    set(&mut segment, now, 0x1800, &[0x0f, 0]);
    let word = |segment: &Segment<ObjectDictionary>| segment.controller(0).unwrap().device().raw(0x6040, 0);
    assert_eq!(word(&segment), 0, "outputs wait for SYNC0");
    segment.poll(Time(1_249_999));
    assert_eq!(word(&segment), 0);
    segment.poll(Time(1_250_000));
    assert_eq!((word(&segment), segment.controller(0).unwrap().sync0_count()), (15, 2));
    let (next, _) = ask(&mut segment, Time(1_250_000), Command::Aprd, 0, 0x0990, &[0; 8]);
    assert_eq!(next, 1_500_000u64.to_le_bytes());
    // Outputs that stay away are counted; with a limit of 2 they are an error.
    segment.poll(Time(1_500_000));
    assert_eq!(segment.controller(0).unwrap().device().raw(0x1c32, 11), 1);
    let od = segment.controller_mut(0).unwrap().device_mut();
    od.set_bytes(yieldwall_fieldbus::objects::Address::new(0x10f1, 2), &[2, 0]).unwrap();
    segment.poll(Time(2_000_000));
    let (status, _) = ask(&mut segment, Time(2_000_001), Command::Aprd, 0, 0x0130, &[0; 6]);
    assert_eq!(status, [0x14, 0, 0, 0, 0x1a, 0]);
}

#[test]
fn outputs_act_on_arrival_where_the_master_has_written_that() {
    for (written, shown, word_at_once) in [(0u16, 2, 0), (1, 1, 15), (2, 2, 0)] {
        let mut segment = three();
        let set = |segment: &mut Segment<_>, now, ado, data: &[u8]| {
            assert_eq!(ask(segment, now, Command::Apwr, 0, ado, data).1, 1)
        };
        let od = segment.controller_mut(0).unwrap().device_mut();
        od.set_bytes(yieldwall_fieldbus::objects::Address::new(0x1c32, 1), &written.to_le_bytes()).unwrap();
        let start = Time(10_000);
        set(&mut segment, start, 0x09a0, &250_000u32.to_le_bytes());
        set(&mut segment, start, 0x0990, &1_000_000u64.to_le_bytes());
        set(&mut segment, start, 0x0981, &[3]);
        to_safe_op(&mut segment, start, 0, true);
        set(&mut segment, start, 0x0120, &[8, 0]);
        set(&mut segment, start, 0x1800, &[0x06, 0]);
        segment.poll(Time(1_000_000));
        set(&mut segment, Time(1_100 * US), 0x1800, &[0x0f, 0]);
        let raw =
            |segment: &Segment<ObjectDictionary>, index, sub| segment.controller(0).unwrap().device().raw(index, sub);
        assert_eq!((raw(&segment, 0x1c32, 1), raw(&segment, 0x6040, 0)), (shown, word_at_once), "{written}");
        segment.poll(Time(1_250_000));
        assert_eq!(raw(&segment, 0x6040, 0), 15);
        // Outputs came before this SYNC0, and were not missed.
        assert_eq!(raw(&segment, 0x1c32, 11), 0);
    }
}

#[test]
fn op_needs_sync0_where_it_is_switched_on() {
    let mut segment = three();
    let now = Time(10_000_000);
    ask(&mut segment, now, Command::Apwr, 0, 0x09a0, &250_000u32.to_le_bytes());
    // A start that has passed.
    ask(&mut segment, now, Command::Apwr, 0, 0x0990, &1_000_000u64.to_le_bytes());
    ask(&mut segment, now, Command::Apwr, 0, 0x0981, &[3]);
    to_safe_op(&mut segment, now, 0, true);
    ask(&mut segment, now, Command::Apwr, 0, 0x1800, &[0x06, 0]);
    ask(&mut segment, now, Command::Apwr, 0, 0x0120, &[8, 0]);
    let (status, _) = ask(&mut segment, Time(300_000_000), Command::Aprd, 0, 0x0130, &[0; 6]);
    assert_eq!(status, [0x14, 0, 0, 0, 0x2d, 0]);
}

#[test]
fn receive_times_give_the_delays_and_drifting_clocks_are_brought_together() {
    let controller = |drift_ppb, clock_start_ns| {
        let settings = ControllerSettings { drift_ppb, clock_start_ns, ..ControllerSettings::new(sii(0)) };
        Controller::new(dictionary(false), settings)
    };
    let mut segment =
        Segment::new(Time(0), [controller(0, 7), controller(40_000, 500), controller(-25_000, 9_000_000)]);
    let adp = |place: u16| 0u16.wrapping_sub(place);
    assert_eq!(ask(&mut segment, Time(0), Command::Bwr, 0, 0x0900, &[0; 4]).1, 3);
    let mut loops = Vec::new();
    for place in 0..3 {
        let (times, _) = ask(&mut segment, Time(0), Command::Aprd, adp(place), 0x0900, &[0; 8]);
        loops.push(
            yieldwall_fieldbus::ethercat::u32_at(&times, 4)
                .wrapping_sub(yieldwall_fieldbus::ethercat::u32_at(&times, 0)),
        );
    }
    assert_eq!(loops[..2], [2000, 1000]);
    // Offsets against the reference, delays of 500 and 1000 ns.
    for (place, offset, delay) in [(1u16, -493i64, 500u32), (2, -8_999_993, 1000)] {
        ask(&mut segment, Time(0), Command::Apwr, adp(place), 0x0920, &offset.to_le_bytes());
        ask(&mut segment, Time(0), Command::Apwr, adp(place), 0x0928, &delay.to_le_bytes());
    }
    ask(&mut segment, Time(0), Command::Apwr, 0, 0x0010, &[1, 0]);
    let mut now = Time(0);
    for _ in 0..3000 {
        now = now + Duration::from_millis(1);
        assert_eq!(ask(&mut segment, now, Command::Frmw, 1, 0x0910, &[0; 8]).1, 3);
    }
    let times: Vec<i64> = (0..3).map(|place| segment.controller(place).unwrap().system_time_ns(now)).collect();
    assert!(times.iter().all(|time| (time - times[0]).abs() <= 20), "{times:?}");
    let (difference, _) = ask(&mut segment, now, Command::Aprd, adp(1), 0x092c, &[0; 4]);
    assert!(yieldwall_fieldbus::ethercat::u32_at(&difference, 0) & 0x7fff_ffff <= 20);
}

#[test]
fn a_full_mailbox_takes_no_more_and_a_slow_device_answers_later() {
    let mut segment = three();
    let second = 0xffff;
    ask(&mut segment, Time(0), Command::Apwr, second, 0x0800, &bytes("0010400026000100 0014400022000100"));
    ask(&mut segment, Time(0), Command::Apwr, second, 0x0120, &[2, 0]);
    let mut request = bytes("0a0000000013 0020 40 0010 00 00000000");
    request.resize(64, 0);
    assert_eq!(ask(&mut segment, Time(0), Command::Apwr, second, 0x1000, &request).1, 1);
    assert_eq!(ask(&mut segment, Time(0), Command::Aprd, second, 0x0805, &[0]), (vec![8], 1));
    assert_eq!(ask(&mut segment, Time(0), Command::Apwr, second, 0x1000, &request).1, 0, "it is full");
    assert_eq!(ask(&mut segment, Time(999 * US), Command::Aprd, second, 0x080d, &[0]), (vec![0], 1));
    assert_eq!(ask(&mut segment, Time(1001 * US), Command::Aprd, second, 0x080d, &[0]), (vec![8], 1));
    let (answer, counter) = ask(&mut segment, Time(1001 * US), Command::Aprd, second, 0x1400, &[0; 64]);
    assert_eq!((&answer[..16], counter), (&bytes("0a00 0000 00 13 0030 43 0010 00 92010200")[..], 1));
    // The same counter once more is a repetition: nothing is carried out again.
    assert_eq!(ask(&mut segment, Time(1002 * US), Command::Apwr, second, 0x1000, &request).1, 1);
    assert_eq!(ask(&mut segment, Time(5000 * US), Command::Aprd, second, 0x080d, &[0]), (vec![0], 1));
    // A protocol that the device does not speak: 4 is FoE.
    request[5] = 0x24;
    ask(&mut segment, Time(5000 * US), Command::Apwr, second, 0x1000, &request);
    let (answer, _) = ask(&mut segment, Time(7000 * US), Command::Aprd, second, 0x1400, &[0; 64]);
    assert_eq!(answer[..10], bytes("0400 0000 00 20 0100 0200"));
}

#[test]
fn the_objects_of_process_data_are_written_in_pre_op_with_their_number_at_zero() {
    let mut segment = three();
    ask(&mut segment, Time(0), Command::Apwr, 0, 0x0800, &bytes("0010400026000100 0014400022000100"));
    ask(&mut segment, Time(0), Command::Apwr, 0, 0x0120, &[2, 0]);
    let mut counter = 0;
    let mut write = |segment: &mut Segment<_>, sdo: &str| {
        counter = counter % 7 + 1;
        let mut request = [&[10, 0, 0, 0, 0, 3 | counter << 4, 0, 0x20][..], &bytes(sdo)].concat();
        request.resize(64, 0);
        ask(segment, Time(0), Command::Apwr, 0, 0x1000, &request);
        let (answer, _) = ask(segment, Time(0), Command::Aprd, 0, 0x1400, &[0; 64]);
        (answer[8], yieldwall_fieldbus::ethercat::u32_at(&answer, 12))
    };
    assert_eq!(write(&mut segment, "2b 12 1c 01 00160000"), (0x80, 0x0601_0003));
    assert_eq!(write(&mut segment, "2f 12 1c 00 00000000"), (0x60, 0));
    assert_eq!(write(&mut segment, "2b 12 1c 01 01160000"), (0x80, 0x0609_0030), "1601h is not there");
    assert_eq!(write(&mut segment, "2b 12 1c 01 00160000"), (0x60, 0));
    assert_eq!(write(&mut segment, "2f 12 1c 00 01000000"), (0x60, 0));
    assert_eq!(write(&mut segment, "2f 00 16 00 00000000"), (0x60, 0));
    assert_eq!(write(&mut segment, "23 00 16 01 10004160"), (0x80, 0x0604_0041), "6041h is an input");
    assert_eq!(write(&mut segment, "23 00 16 01 10004060"), (0x60, 0));
    assert_eq!(write(&mut segment, "2f 00 16 00 01000000"), (0x60, 0));
    to_safe_op(&mut segment, Time(0), 0, true);
    // The mailbox was left as it was.
    assert_eq!(write(&mut segment, "2f 12 1c 00 00000000"), (0x80, 0x0800_0022));
}

proptest! {
    /// Whatever the frame holds: no panic, and its length stays.
    #[test]
    fn any_frame_is_survived(frames in proptest::collection::vec((proptest::collection::vec(any::<u8>(), 0..200), 0u64..1_000_000_000), 1..20), framed_share: bool) {
        let mut segment = three();
        let mut now = Time(0);
        for (datagrams, wait) in frames {
            now = Time(now.0 + wait);
            let mut frame = if framed_share { framed(&datagrams) } else { datagrams };
            let len = frame.len();
            segment.process(now, &mut frame);
            prop_assert_eq!(frame.len(), len);
        }
    }
}
