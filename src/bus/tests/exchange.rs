//! The two moments of a cycle.

use super::*;

#[test]
fn the_walk_to_operation_is_one_controlword_a_cycle_and_only_on_request() {
    let mut net = Net::new(CommandMode::Torque);
    net.boot();
    for _ in 0..3 {
        assert_eq!(net.quiet("5002", Request::None), ["201#06000000", "202#06000000"], "Shutdown");
    }
    for _ in 0..3 {
        assert_eq!(net.quiet("3102", Request::None), ["201#06000000", "202#06000000"], "no further by itself");
    }
    assert_eq!(net.quiet("3102", Request::Enable), ["201#07000000", "202#07000000"], "Switch On");
    assert_eq!(net.quiet("3302", Request::None), ["201#0F000000", "202#0F000000"], "Enable Operation");
    // The right drive takes its time; no torque until both are there.
    let (outputs, sent) = net.cycle(["3712", "3302"], Request::None, |_| {});
    assert_eq!((outputs.directive.state, sent), (State::Enabling, ["201#0F000000".into(), "202#0F000000".into()]));
    assert_eq!(net.quiet("3712", Request::None), ["201#0F000000", "202#0F000000"], "the first torque is zero");
    assert_eq!(net.state(), (State::Running, None));
}

#[test]
fn a_position_target_begins_as_the_measured_position_to_the_count() {
    let mut net = Net::new(CommandMode::Position);
    net.boot();
    net.counts = [310_001, 91_234];
    // 310001 is 04BAF1h, 91234 is 016462h.
    let targets = |word: &str| [format!("201#{word}F1BA0400"), format!("202#{word}62640100")];
    assert_eq!(net.quiet("5002", Request::None), targets("0600"));
    assert_eq!(net.quiet("3102", Request::Enable), targets("0700"));
    assert_eq!(net.quiet("3302", Request::None), targets("0F00"));
    assert_eq!(net.quiet("3712", Request::None), targets("0F00"));
    assert_eq!(net.state(), (State::Running, None));
}

#[test]
fn counts_wrap_at_32_bits_without_a_jump() {
    let (cycle, home) = position_cycle();
    // The drive reads about 2^31 at home.
    let zero = home[0] - std::f64::consts::TAU * 2_147_483_648.0 / COUNTS_PER_REV;
    let axes = [(scaling(zero), home[0]), (scaling(0.0), home[1])];
    let right = (home[1] * COUNTS_PER_REV / std::f64::consts::TAU).round() as i32;
    let mut net = Net::with(cycle, &setup(CommandMode::Position), axes);
    net.boot();
    net.counts = [0x7fff_fff6, right];
    assert!(net.quiet("5002", Request::None)[0].ends_with("F6FFFF7F"));
    let before = net.cycle(["3102"; 2], Request::None, |_| {}).0.signals.measured_angles.left();
    net.counts[0] = -0x7fff_fff6;
    let (outputs, sent) = net.cycle(["3102"; 2], Request::None, |_| {});
    assert_eq!(sent[0], "201#06000A000080", "the target wraps with the position");
    let way = outputs.signals.measured_angles.left() - before;
    let expected = 20.0 / COUNTS_PER_REV * std::f64::consts::TAU;
    assert!((way - expected).abs() < 1e-9, "{way}");
    net.quiet("3102", Request::Enable);
    net.quiet("3302", Request::None);
    net.quiet("3712", Request::None);
    net.counts[0] = 0x7fff_ffff;
    net.quiet("3712", Request::None);
    assert_eq!(net.state(), (State::Running, None), "no jump on the way back");
}

#[test]
fn the_first_frame_of_a_cycle_counts_and_a_wrong_length_is_a_miss() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.cycle(["3712"; 2], Request::None, |_| {}).0.signals.measured_angles;
    // A duplicate with a far position and another state.
    let (outputs, _) = net.cycle(["3712"; 2], Request::None, |net| net.hear("181#0800FFFFFF0F"));
    assert_eq!(outputs.signals.measured_angles, before);
    assert_eq!(net.state(), (State::Running, None));
    for (cycle, state) in [(1, State::Running), (2, State::Stopped)] {
        net.now = net.now + Duration::from_micros(380);
        net.master.networks_mut().open(&mut net.sent);
        net.hear("181#37120000");
        net.hear("182#3712000000000000");
        net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        assert_eq!(net.state().0, state, "cycle {cycle}");
    }
    assert_eq!(net.state().1, Some(Fault::PdoLength));
}

#[test]
fn half_a_force_sample_is_none() {
    let mut net = Net::running(CommandMode::Position);
    for (cycle, state) in [(1, State::Running), (2, State::Running), (3, State::Holding)] {
        net.master.networks_mut().open(&mut net.sent);
        for joint in 0..2 {
            let position = net.counts[joint].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
            net.hear(&format!("18{}#3712{position}", joint + 1));
        }
        net.hear("18A#0000000000000000");
        net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        assert_eq!(net.state().0, state, "cycle {cycle}");
    }
}

#[test]
fn own_frames_that_cannot_be_sent_are_the_end() {
    let mut net = Net::running(CommandMode::Torque);
    net.master.networks_mut().on_link(BusId::FIRST, LinkEvent::SendFailed);
    net.master.networks_mut().open(&mut net.sent);
    net.take();
    net.report(["3712"; 2]);
    for cycle in 0..100 {
        net.now = net.now + Duration::from_millis(1);
        net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        net.master.networks_mut().open(&mut net.sent);
        assert_eq!(net.state(), (State::Lost, Some(Fault::LinkDown)));
        assert_eq!(net.take(), [""; 0], "cycle {cycle}: nothing keeps the drives' watchdogs from acting");
    }
    // Asked for by a person, the exchange goes on: the nodes have to be found anew.
    net.report(["5002"; 2]);
    net.master.on_compute(net.now, Request::Reset, Timing::default(), &mut net.sent);
    assert_eq!(net.state().0, State::Idle);
    assert_eq!(net.take()[..2], ["201#06000000", "202#06000000"]);
}

#[test]
fn a_fault_reset_is_one_edge_for_one_request() {
    let mut net = Net::running(CommandMode::Torque);
    for _ in 0..5 {
        let (_, sent) = net.cycle(["1802", "5002"], Request::None, |_| {});
        assert_eq!(sent, ["201#00000000", "202#02000000"], "no reset by itself");
    }
    let mut words = Vec::new();
    for cycle in 0..8 {
        let request = if cycle == 0 { Request::Reset } else { Request::None };
        words.push(net.cycle(["1802", "5002"], request, |_| {}).1[0].clone());
    }
    assert_eq!(words.iter().filter(|line| *line == "201#80000000").count(), 1, "{words:?}");
    let at = words.iter().position(|line| line == "201#80000000").unwrap();
    assert!(words[..at].last().is_some_and(|line| line == "201#00000000"), "bit 7 was low before: {words:?}");
    assert_eq!(net.state().0, State::Idle);
}

/// The left drive's process data with its position moved by `counts`.
fn left_at(net: &Net, counts: i32) -> String {
    let position = (net.counts[0] + counts).to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
    format!("181#3712{position}")
}

#[test]
fn a_frame_after_the_computation_is_late_and_not_used() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.cycle(["3712"; 2], Request::None, |_| {}).0.signals.measured_angles;
    // The left drive's frame misses its cycle ...
    net.sync();
    let right = net.counts[1].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
    net.hear(&format!("182#3712{right}"));
    net.hear("18A#0000000000000000");
    net.sequence = net.sequence.wrapping_add(1);
    net.hear(&format!("28A#0000000000{:02X}", net.sequence));
    net.compute(Request::None);
    assert_eq!(net.seen(Fault::PdoMissed), 1);
    // ... and comes with another position before the next SYNC.
    net.hear(&left_at(&net, 500));
    let (outputs, _) = net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(outputs.signals.measured_angles, before);
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated), net.seen(Fault::PdoMissed)), (1, 0, 0));
    assert_eq!(net.master.cycle().faults().devices(Fault::PdoLate), yieldwall_motion::guard::DeviceSet::LEFT_DRIVE);
    // Nothing is owed any more: a second frame now is a duplicate.
    net.cycle(["3712"; 2], Request::None, |net| net.hear(&left_at(net, 500)));
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (0, 1));
    assert_eq!(net.state(), (State::Running, None));
}

#[test]
fn of_two_frames_the_second_counts_if_one_was_owed() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.cycle(["3712"; 2], Request::None, |_| {}).0.signals.measured_angles;
    net.sync();
    net.compute(Request::None);
    assert_eq!(net.seen(Fault::PdoMissed), 1, "a cycle without any process data");
    net.sync();
    net.hear(&left_at(&net, 500));
    net.report(["3712"; 2]);
    net.compute(Request::None);
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (1, 0));
    let (outputs, _) = net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(outputs.signals.measured_angles, before, "the late position was not used");
    assert_eq!(net.state().1, None);
}

#[test]
fn of_two_samples_in_a_cycle_the_newer_counts() {
    let mut net = Net::running(CommandMode::Position);
    // Before its time the next sample comes: the first was the late one.
    net.cycle(["3712"; 2], Request::None, |net| {
        net.sequence = net.sequence.wrapping_add(1);
        let line = format!("28A#0000000000{:02X}", net.sequence);
        net.hear(&line);
    });
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (1, 0));
    net.cycle(["3712"; 2], Request::None, |net| {
        let line = format!("28A#0000000000{:02X}", net.sequence);
        net.hear(&line);
    });
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (0, 1));
    // The status byte says that the sample is not valid.
    net.sync();
    for joint in 0..2 {
        let position = net.counts[joint].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
        net.hear(&format!("18{}#3712{position}", joint + 1));
    }
    net.hear("18A#0000000000000000");
    net.hear(&format!("28A#0000000002{:02X}", net.sequence.wrapping_add(1)));
    net.compute(Request::None);
    assert_eq!(net.state(), (State::Holding, Some(Fault::SensorInvalid)));
}

#[test]
fn at_most_one_cycle_is_in_flight() {
    let mut net = Net::running(CommandMode::Torque);
    let echo =
        |net: &mut Net, sent: &[String]| sent.iter().for_each(|line| net.master.networks_mut().on_echo(&frame(line)));
    for _ in 0..3 {
        net.sync();
        net.report(["3712"; 2]);
        let sent = net.compute(Request::None);
        echo(&mut net, &sent);
    }
    // One set-point does not leave in time: the next cycle sends nothing, and goes on when it has left.
    net.sync();
    net.report(["3712"; 2]);
    let sent = net.compute(Request::None);
    echo(&mut net, &sent[..1]);
    net.master.networks_mut().open(&mut net.sent);
    assert_eq!(net.take(), [""; 0], "no SYNC behind a set-point that is still on its way");
    assert_eq!(net.compute(Request::None), [""; 0], "and no set-points");
    assert_eq!((net.state().0, net.seen(Fault::TransmitStalled)), (State::Running, 1));
    echo(&mut net, &sent[1..]);
    net.sync();
    net.report(["3712"; 2]);
    let sent = net.compute(Request::None);
    assert_eq!((sent.len() >= 2, net.seen(Fault::TransmitStalled)), (true, 0));
    // None leaves any more: silence at the second cycle.
    net.master.networks_mut().open(&mut net.sent);
    net.compute(Request::None);
    assert!(!net.master.networks().is_silent());
    net.master.networks_mut().open(&mut net.sent);
    net.compute(Request::None);
    assert_eq!(net.state(), (State::Lost, Some(Fault::TransmitStalled)));
    assert!(net.master.networks().is_silent());
    for _ in 0..50 {
        net.master.networks_mut().open(&mut net.sent);
        assert_eq!(net.compute(Request::None), [""; 0]);
    }
    // A person resets: what was on its way is gone, and the exchange goes on.
    net.master.networks_mut().open(&mut net.sent);
    net.compute(Request::Reset);
    net.sync();
    net.report(["5002"; 2]);
    assert_eq!(net.compute(Request::None)[..2], ["201#06000000", "202#06000000"]);
}

#[test]
fn a_cycle_that_failed_is_followed_by_quick_stops_for_good() {
    for mode in [CommandMode::Torque, CommandMode::Position] {
        let mut net = Net::running(mode);
        net.sync();
        net.report(["3712"; 2]);
        net.master.quick_stop_now(net.now, &mut net.sent);
        let sent = net.take();
        assert!(sent[0].starts_with("201#0200") && sent[1].starts_with("202#0200"), "{sent:?}");
        assert!(mode == CommandMode::Position || sent[..2] == ["201#02000000", "202#02000000"], "{sent:?}");
        for request in [Request::None, Request::Reset, Request::Enable, Request::None, Request::None] {
            net.sync();
            net.report(["3102"; 2]);
            let sent = net.compute(request);
            assert!(sent.iter().take(2).all(|line| !line.contains("#0F") && !line.contains("#07")), "{sent:?}");
            assert_eq!(net.master.state(), State::Disabled);
            assert_eq!(net.master.cause().map(|cause| cause.fault), Some(Fault::CyclePanicked));
        }
        net.master.start(net.now, &mut net.sent);
        assert_eq!(
            (net.take(), net.master.networks().phase()),
            (Vec::new(), &Phase::Operational),
            "a new master is needed"
        );
    }
}

#[test]
fn a_corrupted_position_leaves_no_wrong_turn_behind() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.quiet("3712", Request::None);
    let angle = |net: &Net| net.master.last_inputs().drives[0].angle_rad.unwrap();
    let (home, counts) = (angle(&net), net.counts[0]);
    // Two steps of almost half the range each: taken as motion they make a whole turn of the counter.
    for report in [counts.wrapping_add(0x7000_0000), counts.wrapping_sub(0x2000_0000)] {
        net.counts[0] = report;
        net.quiet("3712", Request::None);
    }
    net.counts[0] = counts;
    net.quiet("3712", Request::None);
    assert_eq!(angle(&net), home);
    assert!(before[0].starts_with("201#0F00"), "{before:?}");
}
