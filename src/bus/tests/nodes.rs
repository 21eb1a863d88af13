//! What nodes and strangers do while process data are exchanged.

use super::*;
use yieldwall_motion::guard::{Device, DeviceSet};

#[test]
fn what_happens_on_the_bus_stops_both_drives_in_the_same_cycle() {
    let stop = |sent: &[String; 2]| sent[0].starts_with("201#0200") && sent[1].starts_with("202#0200");
    for mode in [CommandMode::Torque, CommandMode::Position] {
        for (line, state, fault) in [
            ("702#00", State::Stopped, Fault::NodeReset),               // boot-up
            ("701#7F", State::Lost, Fault::HeartbeatLost),              // Pre-operational
            ("70A#04", State::Lost, Fault::HeartbeatLost),              // Stopped
            ("082#1186201122334455", State::Stopped, Fault::Emergency), // 8611h: following error
        ] {
            let mut net = Net::running(mode);
            let (_, sent) = net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
            assert_eq!(net.state(), (state, Some(fault)), "{line}");
            assert!(stop(&sent), "{line}: {sent:?}");
        }
        // An emergency that ends is no fault, and strangers do not count.
        for line in ["081#0000000000000000", "083#1186200000000000", "703#00", "183#000000000000"] {
            let mut net = Net::running(mode);
            net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
            assert_eq!(net.state(), (State::Running, None), "{line}");
        }
        // A drive that leaves, one that faults.
        let mut net = Net::running(mode);
        let (_, sent) = net.cycle(["3312", "3712"], Request::None, |_| {});
        assert_eq!(net.state(), (State::Stopped, Some(Fault::DriveLeftOperation)));
        assert!(stop(&sent), "{sent:?}");
        let mut net = Net::running(mode);
        let (_, sent) = net.cycle(["3712", "1802"], Request::None, |_| {});
        assert_eq!(net.state(), (State::Disabled, Some(Fault::DriveFault)));
        // A drive in Fault hears nothing but a reset; the other one stops.
        assert!(sent[0].starts_with("201#0200") && sent[1].starts_with("202#0000"), "{sent:?}");
    }
}

#[test]
fn what_nodes_do_on_a_strangers_command_is_told_as_the_stranger() {
    for (command, answers) in
        [("000#8000", ["701#7F", "702#7F", "70A#7F"]), ("000#8100", ["701#00", "702#00", "70A#00"])]
    {
        let mut net = Net::running(CommandMode::Torque);
        let (_, sent) = net.cycle(["3712"; 2], Request::None, |net| {
            net.hear(command);
            answers.iter().for_each(|line| net.hear(line));
        });
        assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)), "{command}");
        assert!(sent[0].starts_with("201#0200"), "{sent:?}");
        net.cycle(["3712"; 2], Request::None, |_| {});
        assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)), "{command}: the first cause stays");
        // Nobody runs it again without the nodes.
        net.cycle(["3712"; 2], Request::Reset, |_| {});
        net.cycle(["3712"; 2], Request::Enable, |_| {});
        assert_eq!(net.state().0, State::Idle, "{command}");
    }
}

#[test]
fn the_emergency_is_kept_for_reports() {
    let mut net = Net::running(CommandMode::Torque);
    net.cycle(["3712"; 2], Request::None, |net| net.hear("082#1042200000000000"));
    let told = *net.master.networks().told().last().unwrap();
    assert_eq!((told.device, told.code.0, told.register.0), (Device::RightDrive, 0x4210, 0x20));
}

#[test]
fn a_heartbeat_that_stays_away_stops_the_rig_after_two_periods() {
    let mut net = Net::running(CommandMode::Torque);
    net.hear("701#05");
    net.hear("702#05");
    net.hear("70A#05");
    net.wait(Duration::from_millis(39));
    net.hear("701#05");
    net.hear("70A#05");
    net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(net.state().0, State::Running);
    net.wait(Duration::from_millis(1));
    net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(net.state(), (State::Lost, Some(Fault::HeartbeatLost)));
}

#[test]
fn a_node_that_is_lost_or_has_restarted_keeps_the_rig_from_being_enabled_again() {
    // The left drive still answers with process data, as one that starts by itself would.
    for (line, cured_by, state, fault, is_curable) in [
        ("701#7F", "701#05", State::Lost, Fault::HeartbeatLost, true),
        ("701#00", "701#05", State::Stopped, Fault::NodeReset, false),
        ("70A#04", "70A#05", State::Lost, Fault::HeartbeatLost, true),
    ] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!(net.state(), (state, Some(fault)), "{line}");
        net.quiet("5002", Request::Reset);
        net.quiet("3102", Request::Enable);
        assert_eq!(net.state(), (State::Idle, Some(fault)), "{line}: it is still so");
        net.cycle(["3102"; 2], Request::None, |net| net.hear(cured_by));
        net.quiet("3102", Request::None);
        net.quiet("3102", Request::Enable);
        assert_eq!(net.state().0 == State::Enabling, is_curable, "{line}");
    }
}

#[test]
fn no_bytes_from_the_bus_panic_or_enable() {
    use proptest::prelude::*;
    let frames = proptest::collection::vec((0..0x800u16, proptest::collection::vec(any::<u8>(), 0..9), 0..3u8), 0..200);
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig { cases: 60, ..ProptestConfig::default() });
    let run = runner.run(&frames, |frames| {
        let mut net = Net::new(CommandMode::Torque);
        net.boot();
        for (id, data, kind) in frames {
            // Two thirds to identifiers that mean something.
            let id = [id, 0x181 + id % 2, [0x701, 0x702, 0x70a, 0x081, 0x18a, 0x28a, 0x581][usize::from(id % 7)]];
            let frame = Frame::new(id[usize::from(kind)], &data);
            net.master.networks_mut().on_packet(net.now, Packet::Can(&frame), &mut net.sent);
            net.now = net.now + Duration::from_micros(100);
            net.master.networks_mut().poll(net.now, &mut net.sent);
            net.master.networks_mut().open(&mut net.sent);
            net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        }
        for line in net.take().iter().filter(|line| line.starts_with("201#") || line.starts_with("202#")) {
            prop_assert!(line.ends_with("#06000000") || line.ends_with("#00000000"), "{line}");
        }
        Ok(())
    });
    run.unwrap();
}

#[test]
fn frames_that_only_the_master_sends_are_those_of_an_intruder() {
    for line in ["000#8101", "080#", "201#0F000000", "202#", "77F#05"] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)), "{line}");
        // Own frames are none.
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.master.networks_mut().on_echo(&frame(line)));
        assert_eq!(net.state(), (State::Running, None), "{line}");
    }
    for line in ["601#4041600000000000", "203#06000000", "77E#05", "7E5#0000000000000000"] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!(net.state(), (State::Running, None), "{line}");
    }
}

#[test]
fn two_devices_with_one_node_id_are_found_by_their_heartbeats() {
    // Heartbeats of the left drive, ms after the rig runs; its period is 20 ms.
    let found = |times: &[u64]| {
        let mut net = Net::running(CommandMode::Torque);
        let start = net.now;
        for &ms in times {
            net.now = start + Duration::from_millis(ms);
            net.hear("701#05");
        }
        net.cycle(["3712"; 2], Request::None, |_| {});
        net.seen(Fault::DuplicateNode) > 0
    };
    assert!(!found(&[20, 40, 60, 80, 100]));
    assert!(!found(&[38, 40, 60, 80]), "one that is late by 18 ms");
    assert!(!found(&[37, 41, 60, 80]), "two in a row that are late");
    assert!(!found(&[40, 40, 60, 80, 100]), "a bus that was blocked for a whole period");
    for offset in 1..20 {
        let times: Vec<u64> = (1..6).flat_map(|period| [20 * period, 20 * period + offset]).collect();
        assert!(found(&times), "another one {offset} ms later");
    }
    // A device is switched on with the factory's node id: its boot-up, and the other one goes on.
    let mut net = Net::running(CommandMode::Torque);
    net.cycle(["3712"; 2], Request::None, |net| net.hear("701#00"));
    assert_eq!((net.state(), net.seen(Fault::DuplicateNode)), ((State::Stopped, Some(Fault::NodeReset)), 0));
    net.cycle(["3712"; 2], Request::None, |net| net.hear("701#05"));
    assert_eq!(net.seen(Fault::DuplicateNode), 1);
}

#[test]
fn two_devices_with_one_node_id_are_found_by_their_answers_before_anything_is_enabled() {
    // Boots a network in which all own frames are seen; whether each answer of the left drive comes twice, and what else is
    // heard before. What the first cycle says of duplicates.
    let found = |is_twice: bool, before: &[&str]| {
        let mut net = Net::new(CommandMode::Torque);
        net.reset();
        before.iter().for_each(|line| net.hear(line));
        let mut answers = 0;
        for _ in 0..1000 {
            let sent = std::mem::take(&mut net.sent);
            sent.iter().for_each(|frame| net.master.networks_mut().on_echo(frame));
            for request in sent.iter().filter(|frame| (0x601..=0x67f).contains(&frame.id())) {
                let answer = net.answer((request.id() - 0x600) as u8, request.bytes());
                let answer = Frame::new(request.id() - 0x80, &answer);
                for _ in 0..1 + usize::from(is_twice && answer.id() == 0x581) {
                    net.master.networks_mut().on_packet(net.now, Packet::Can(&answer), &mut net.sent);
                    answers += 1;
                }
            }
        }
        assert!(answers > 60, "{answers}");
        ["701#05", "702#05", "70A#05"].iter().for_each(|line| net.hear(line));
        assert_eq!(*net.master.networks().phase(), Phase::Operational);
        net.sync();
        net.report(["5002"; 2]);
        net.compute(Request::Enable);
        assert_eq!(net.state().0 == State::Enabling, !is_twice, "{:?}", net.state());
        net.master.last_inputs().link.duplicate_node
    };
    assert_eq!(found(true, &[]), DeviceSet::LEFT_DRIVE);
    assert_eq!(found(false, &[]), DeviceSet::NONE);
    // CAN may double a frame.
    assert_eq!(found(false, &["581#6000100000000000"; 2]), DeviceSet::NONE);
}

#[test]
fn in_operation_somebody_else_may_ask_a_node() {
    for (is_asked, found) in [(true, DeviceSet::NONE), (false, DeviceSet::LEFT_DRIVE)] {
        let mut net = Net::new(CommandMode::Torque);
        net.boot();
        net.master.networks_mut().on_echo(&frame("601#4000100000000000"));
        if is_asked {
            net.hear("601#4000100000000000");
        }
        (0..5).for_each(|_| net.hear("581#4200100092010200"));
        net.sync();
        net.report(["5002"; 2]);
        net.compute(Request::None);
        assert_eq!(net.master.last_inputs().link.duplicate_node, found);
    }
}

#[test]
fn a_warning_is_counted_and_the_last_eight_emergencies_are_kept() {
    let mut net = Net::running(CommandMode::Torque);
    // 8140h: recovered from bus-off.
    net.cycle(["3712"; 2], Request::None, |net| net.hear("082#4081110000000000"));
    assert_eq!((net.state(), net.seen(Fault::EmergencyWarning)), ((State::Running, None), 1));
    for code in 1..=10u8 {
        net.hear(&format!("081#{code:02X}FF200000000000"));
    }
    let codes: Vec<u16> = net.master.networks().told().iter().map(|told| told.code.0).collect();
    assert_eq!(codes, [0xff03, 0xff04, 0xff05, 0xff06, 0xff07, 0xff08, 0xff09, 0xff0a]);
}

#[test]
fn a_node_withdraws_its_own_emergencies_when_no_error_is_left() {
    let mut net = Net::running(CommandMode::Torque);
    // One error fewer, with bits left in the register.
    for line in ["081#2032050000000000", "082#2032050000000000", "081#0000010000000000"] {
        net.hear(line);
    }
    let withdrawn = |net: &Net| net.master.networks().told().iter().map(|told| told.is_withdrawn).collect::<Vec<_>>();
    assert_eq!(withdrawn(&net), [false, false]);
    net.hear("081#0000000000000000");
    assert_eq!(withdrawn(&net), [true, false]);
    net.hear("081#1042090000000000");
    assert_eq!(withdrawn(&net), [true, false, false]);
    net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(net.state(), (State::Stopped, Some(Fault::Emergency)), "withdrawn or not");
}
