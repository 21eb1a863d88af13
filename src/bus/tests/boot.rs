//! From the reset to the exchange of process data, and back.

use super::*;

/// Requests to the left drive, in hexadecimal.
fn of_left(net: &Net) -> Vec<&str> {
    net.requests.iter().filter(|(node, _)| *node == 1).map(|(_, line)| line.as_str()).collect()
}

#[test]
fn the_boot_of_a_torque_drive_is_this_sequence() {
    let mut net = Net::new(CommandMode::Torque);
    net.boot();
    let read = |object: &str| format!("601#40{object}00000000");
    let mut expected: Vec<String> = ["001000", "181001", "181002", "026500", "051000", "121000"].map(read).to_vec();
    let mut write = |command: &str, object: &str, value: &str, manner: &str| {
        let write = format!("601#{command}{object}{value:0<8}");
        expected.extend(manner.chars().map(|step| if step == 'w' { write.clone() } else { read(object) }));
    };
    // r: the object is read, w: it is written.
    write("2B", "171000", "1400", "rwr"); // heartbeat every 20 ms
    write("23", "161001", "28007F00", "wr"); // watch node 127 for 40 ms, in any case anew
    write("2B", "076000", "0300", "rwr"); // quick stop when it is lost
    write("2F", "291001", "00", "r"); // and Pre-operational, as it stands
    write("2B", "5A6000", "0200", "rwr"); // quick stop ramp, then Switch On Disabled
    write("40", "C26002", "", "r"); // the unit of its cycle time, with which ...
    write("2F", "C26001", "01", "rwr"); // ... 1 ...
    write("2F", "C26002", "FD", "rwr"); // ... ms cannot be said
    write("2F", "606000", "0A", "w"); // cyclic synchronous torque ...
    write("40", "616000", "", "r"); // ... in force
    write("2B", "726000", "E803", "rwr"); // 100 % torque at most
    write("40", "8F6001", "", "r"); // increments of its encoder ...
    write("40", "8F6002", "", "r"); // ... in so many revolutions
    write("23", "806000", "0E000000", "rwr"); // 14 r/min of the motor at most
    write("23", "656000", "BC310000", "rwr"); // following error window
    write("23", "001401", "01020080", "rw"); // RPDO 1 differs: off
    write("2F", "001600", "00", "rw"); // so do its objects
    write("23", "001601", "10004060", "wr"); // controlword, 16 bits
    write("23", "001602", "10007160", "wr"); // target torque, 16 bits
    write("2F", "001600", "02", "wr");
    write("2F", "001402", "01", "wr"); // at every SYNC
    write("2B", "001405", "0500", "wr"); // deadline of 5 ms
    write("23", "001401", "01020000", "wr"); // RPDO 1 on
    write("23", "001801", "81010080", "rw"); // TPDO 1 differs: off
    write("2F", "001A00", "00", "rw");
    write("23", "001A01", "10004160", "wr"); // statusword, 16 bits
    write("23", "001A02", "20006460", "wr"); // position, 32 bits
    write("2F", "001A00", "02", "wr");
    write("2F", "001802", "01", "wr");
    write("23", "001801", "81010000", "wr"); // TPDO 1 on
    assert_eq!(of_left(&net), expected);
}

#[test]
fn what_stands_is_read_and_commands_alone_are_written() {
    let mut net = Net::new(CommandMode::Torque);
    net.boot();
    net.requests.clear();
    // It remembers all of it over a reset.
    net.master.start(net.now, &mut net.sent);
    net.take();
    ["701#00", "702#00", "70A#00"].into_iter().for_each(|line| net.hear(line));
    net.serve(|_, _| None);
    let written: Vec<&str> = of_left(&net).into_iter().filter(|line| !line.starts_with("601#40")).collect();
    // Its watch on the master begins anew, and the mode is asked for.
    assert_eq!(written, ["601#2316100128007F00", "601#2F6060000A000000"]);
    assert_eq!(*net.master.networks().phase(), Phase::Starting);
}

#[test]
fn nodes_are_kept_from_making_sync_and_time_and_their_tpdos_keep_that_they_allow_no_remote_frames() {
    let mut net = Net::new(CommandMode::Torque);
    net.objects.insert((1, 0x1005, 0), 0x4000_0080);
    net.objects.insert((1, 0x1012, 0), 0xc000_0100);
    net.objects.insert((1, 0x1800, 1), 0x4000_0181);
    net.boot();
    let held = |index, sub| net.objects.get(&(1, index, sub)).copied();
    assert_eq!((held(0x1005, 0), held(0x1012, 0)), (Some(0x80), Some(0x8000_0100)));
    assert_eq!(held(0x1800, 1), Some(0x4000_0181));
    let written = |line: &str| net.requests.iter().any(|(_, request)| request == line);
    assert!(written("601#23001801810100C0") && written("601#2300180181010040"), "{:?}", net.requests);
    assert!(!net.requests.iter().any(|(_, line)| line.starts_with("602#23051000") || line.starts_with("602#23121000")));
}

#[test]
fn a_tpdo_that_takes_no_identifier_without_bit_30_gets_it() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|node, request| {
        let is_without = request[..4] == [0x23, 0x00, 0x18, 0x01] && request[7] & 0x40 == 0;
        (node == 1 && is_without).then_some(Some([0x80, 0x00, 0x18, 0x01, 0x30, 0x00, 0x09, 0x06]))
    });
    assert_eq!(*net.master.networks().phase(), Phase::Starting);
    assert_eq!(net.objects.get(&(1, 0x1800, 1)), Some(&0x4000_0181));
    assert_eq!(net.objects.get(&(2, 0x1800, 1)), Some(&0x0000_0182));
}

#[test]
fn a_drive_that_comes_to_its_mode_late_is_waited_for_and_one_in_another_mode_is_not_started() {
    for (late_ms, is_started) in [(30, true), (1000, false)] {
        let mut net = Net::new(CommandMode::Torque);
        net.reset();
        // Profile position, mode 1, which the drive was in.
        let until = net.now + Duration::from_millis(late_ms);
        for _ in 0..100 {
            let has_changed = net.now >= until;
            net.serve(|node, request| {
                let is_it = node == 2 && request[..3] == [0x40, 0x61, 0x60];
                (is_it && !has_changed).then_some(Some([0x4f, 0x61, 0x60, 0, 1, 0, 0, 0]))
            });
            net.wait(Duration::from_millis(10));
        }
        if is_started {
            // They did not say so in time, but they were told to.
            assert_eq!(failure(&net).step, "start the node");
            continue;
        }
        assert_eq!(failure(&net).failure, BootFailure::Mode { wanted: 10, received: 1 });
        assert!(!net.take().contains(&"000#0100".to_owned()), "nothing is started");
    }
}

#[test]
fn nodes_that_start_by_themselves_are_started() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    // Their heartbeats stay the same from here on: there is no further change to wait for.
    for line in ["701#05", "702#05", "70A#05"] {
        net.hear(line);
    }
    net.serve(|_, _| None);
    assert_eq!((net.take(), net.master.networks().phase()), (STARTED.map(str::to_owned).to_vec(), &Phase::Operational));
}

#[test]
fn a_boot_that_failed_waits_for_nothing_but_its_heartbeat() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|_, _| None);
    net.hear("701#00");
    assert!(matches!(net.master.networks().phase(), Phase::Failed(_)));
    net.wait(Duration::from_secs(1));
    assert_eq!(net.master.networks().next_deadline(), net.now + Duration::from_millis(20));
}

#[test]
fn a_position_drive_gets_its_mode_and_its_target() {
    let mut net = Net::new(CommandMode::Position);
    net.boot();
    let has = |line: &str| net.requests.iter().any(|(_, request)| request == line);
    assert!(has("602#2F60600008000000"), "cyclic synchronous position");
    assert!(has("602#2300160220007A60"), "target position, 32 bits");
    assert!(!has("602#2300160210007160"));
}

#[test]
fn drives_get_a_speed_limit_in_turns_of_their_motor() {
    let mut net = Net::new(CommandMode::Torque);
    // A gear of 1 to 5: 95 493 counts/s are 14 turns/s of this motor.
    net.objects.insert((1, 0x608f, 1), 6_820);
    net.boot();
    let has = |line: &str| net.requests.iter().any(|(_, request)| request == line);
    assert!(has("601#2380600048030000") && has("602#238060000E000000"), "{:?}", net.requests);
    assert!(has("601#4080600000000000"), "it is read back");

    let mut net = Net::new(CommandMode::Torque);
    net.objects.insert((2, 0x608f, 1), 0);
    net.reset();
    net.serve(|_, _| None);
    let error = failure(&net);
    assert_eq!((error.node_id, error.step), (Some(2), "set the speed limit"));
    assert_eq!(error.failure, BootFailure::Resolution { increments: 0, revolutions: 1 });
}

#[test]
fn a_wrong_device_is_named_with_object_and_both_values() {
    for (key, value, step) in [
        ((2, 0x1018, 1), 0x0000_009a, "check the vendor"),
        ((2, 0x1018, 2), 0x0000_0403, "check the product code"),
        ((2, 0x1000, 0), 0x0001_0191, "check the device type"),
        ((2, 0x6502, 0), 0x0000_0180, "check the command mode"),
    ] {
        let mut net = Net::new(CommandMode::Torque);
        net.objects.insert(key, value);
        net.reset();
        net.serve(|_, _| None);
        let error = failure(&net);
        assert_eq!((error.node_id, error.name.as_str(), error.step), (Some(2), "right", step));
        let BootFailure::Identity { index, sub, received, .. } = error.failure else { panic!("{error}") };
        assert_eq!((2, index, sub, received), (key.0, key.1, key.2, value));
        assert!(net.take().iter().all(|line| !line.starts_with("000#01")), "nothing is started");
    }
}

#[test]
fn an_abort_a_lie_and_silence_are_named_with_node_step_and_object() {
    // 0609 0030h: value range.
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|node, request| {
        let is_it = node == 1 && request[..4] == [0x2b, 0x72, 0x60, 0x00];
        is_it.then_some(Some([0x80, 0x72, 0x60, 0x00, 0x30, 0x00, 0x09, 0x06]))
    });
    let error = failure(&net);
    assert_eq!((error.node_id, error.step), (Some(1), "set the torque limit"));
    let code = yieldwall_fieldbus::objects::AbortCode::VALUE;
    assert_eq!(error.failure, BootFailure::Keeps { index: 0x6072, sub: 0, held: 0, wanted: 1000, code });

    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|node, request| {
        let is_it = node == 2 && request[..4] == [0x40, 0x07, 0x60, 0x00];
        is_it.then_some(Some([0x4b, 0x07, 0x60, 0x00, 0x01, 0, 0, 0]))
    });
    let expected = BootFailure::ReadBack { index: 0x6007, sub: 0, written: 3, received: 1 };
    assert_eq!((failure(&net).node_id, &failure(&net).failure), (Some(2), &expected));

    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|node, request| (node == 10 && request[1..4] == [0x17, 0x10, 0x00]).then_some(None));
    assert_eq!(*net.master.networks().phase(), Phase::Configuring);
    // It is read, and asked twice more.
    [250, 250, 249].into_iter().for_each(|ms| net.wait(Duration::from_millis(ms)));
    assert_eq!(*net.master.networks().phase(), Phase::Configuring);
    net.take();
    net.wait(Duration::from_millis(1));
    let error = failure(&net);
    assert_eq!((error.node_id, error.name.as_str(), error.step), (Some(10), "wrist", "set the heartbeat"));
    assert_eq!(error.failure, BootFailure::NoAnswer { index: 0x1017, sub: 0 });
    assert!(net.take().contains(&"60A#8017100000000405".to_owned()), "the device is told that it took too long");
}

#[test]
fn a_missing_node_is_named() {
    let mut net = Net::new(CommandMode::Torque);
    net.master.start(net.now, &mut net.sent);
    net.hear("701#00");
    net.hear("70A#00");
    net.hear("70B#00");
    net.wait(Duration::from_millis(699));
    assert_eq!(*net.master.networks().phase(), Phase::Resetting);
    net.wait(Duration::from_millis(1));
    let error = failure(&net);
    assert_eq!((error.node_id, error.name.as_str()), (Some(2), "right"));
    let set = |raw: &[u8]| raw.iter().filter_map(|raw| cob::node_id(*raw).ok()).collect();
    let others = Box::new(Others { answered: set(&[1, 10]), strangers: set(&[11]) });
    assert_eq!(
        error.failure,
        BootFailure::Missing { waited_ms: 700, is_unheard: false, said: Said::default(), others }
    );
    assert_eq!(
        error.to_string(),
        "node 2 (right) is silent; 1 and 10 answered; 11, which the rig does not have, was heard: wait for the boot-up \
         message: no boot-up message within 700 ms after the reset; nothing was heard of it"
    );
}

/// What the boot waits for: node, step, time waited and time left in ms.
fn waiting(net: &Net) -> Option<(Option<u8>, &'static str, u128, u128)> {
    let waiting = net.master.networks().waiting(net.now)?;
    Some((waiting.node_id, waiting.step, waiting.waited.as_millis(), waiting.left.as_millis()))
}

#[test]
fn each_node_is_waited_for_as_long_as_it_may_take_and_who_looks_on_is_told() {
    let (cycle, home) = torque_cycle();
    let mut setup = setup(CommandMode::Torque);
    setup.drives[1].waits = Waits {
        boot_up: Duration::from_millis(5000),
        sdo: Duration::from_millis(1000),
        start: Duration::from_millis(4000),
    };
    let mut net = Net::with(cycle, &setup, home.map(|angle| (scaling(0.0), angle)));
    assert_eq!(waiting(&net), None);
    net.master.start(net.now, &mut net.sent);
    net.wait(Duration::from_millis(600));
    assert_eq!(waiting(&net), Some((Some(1), "wait for the boot-up message", 600, 100)));
    net.hear("701#00");
    net.hear("70A#00");
    net.wait(Duration::from_millis(4399));
    assert_eq!(waiting(&net), Some((Some(2), "wait for the boot-up message", 4999, 1)));
    net.hear("702#00");
    assert_eq!(*net.master.networks().phase(), Phase::Configuring);
    net.serve(|node, _| (node == 2).then_some(None));
    net.wait(Duration::from_millis(999));
    assert_eq!(waiting(&net), Some((Some(2), "check the device type", 999, 1)));
    net.master.start(net.now, &mut net.sent);
    for line in ["701#00", "702#00", "70A#00"] {
        net.hear(line);
    }
    net.serve(|_, _| None);
    for _ in 0..399 {
        ["701#05", "70A#05"].into_iter().for_each(|line| net.hear(line));
        net.wait(Duration::from_millis(10));
    }
    assert_eq!(waiting(&net), Some((Some(2), "start the node", 3990, 10)));
    net.wait(Duration::from_millis(10));
    assert_eq!((failure(&net).node_id, failure(&net).step), (Some(2), "start the node"));
    assert_eq!(waiting(&net), None);
}

#[test]
fn a_node_that_restarts_while_it_is_configured_is_configured_anew() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    // The left drive restarts in the middle and forgets what was written.
    let mut restarted = false;
    net.serve(|node, request| {
        restarted |= node == 1 && request[..4] == [0x2b, 0x72, 0x60, 0x00];
        (restarted && node == 1).then_some(None)
    });
    net.objects = objects();
    net.requests.clear();
    net.hear("701#00");
    net.serve(|_, _| None);
    let left = net.requests.iter().filter(|(node, line)| *node == 1 && line.contains("#2B17100014"));
    assert_eq!(left.count(), 1, "the heartbeat is written again");
    assert_eq!(net.objects.get(&(1, 0x6007, 0)), Some(&3), "and so is the reaction to a lost master");
    assert_eq!(*net.master.networks().phase(), Phase::Starting);
    // After that a restart is too late.
    net.hear("701#00");
    assert_eq!(failure(&net).failure, BootFailure::Restarted { times: 1 });
}

#[test]
fn a_node_that_keeps_restarting_is_given_up() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    for _ in 0..3 {
        net.hear("702#00");
        assert_eq!(*net.master.networks().phase(), Phase::Configuring);
    }
    net.hear("702#00");
    assert_eq!((failure(&net).node_id, &failure(&net).failure), (Some(2), &BootFailure::Restarted { times: 4 }));
}

#[test]
fn node_ids_are_checked_before_anything_is_sent() {
    for (ids, wanted) in [
        ([1, 1, 10], BootFailure::DuplicateNodeId { node_id: 1 }),
        ([1, 127, 10], BootFailure::DuplicateNodeId { node_id: 127 }),
        ([1, 2, 128], BootFailure::NodeId { node_id: 128 }),
        ([0, 2, 10], BootFailure::NodeId { node_id: 0 }),
    ] {
        let (cycle, home) = torque_cycle();
        let mut setup = setup(CommandMode::Torque);
        let SensorLink::Canopen(sensor) = &mut setup.sensor.link else { unreachable!() };
        [setup.drives[0].node_id, setup.drives[1].node_id, sensor.node_id] = ids;
        let Err(error) = Master::new((Some(&setup), None), home.map(|angle| axis(scaling(0.0), angle)), cycle) else {
            panic!("{ids:?} were taken")
        };
        assert_eq!(error.failure, wanted);
    }
}

#[test]
fn a_node_that_is_lost_before_all_are_started_is_named() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|_, _| None);
    net.hear("701#05");
    net.hear("702#05");
    // The left drive falls silent, the others go on.
    for _ in 0..60 {
        net.wait(Duration::from_millis(10));
        net.hear("702#05");
        if net.now >= Time(100_000_000) {
            net.hear("70A#05");
        }
    }
    assert_eq!((failure(&net).node_id, failure(&net).step), (Some(1), "start the node"));
}

#[test]
fn a_node_that_does_not_start_is_named_with_its_state_and_its_emergency() {
    for (heard, told) in [
        (&[][..], "; its last word was its boot-up message; object 1017h was set, and no heartbeat came"),
        (&["701#7F"][..], "; its last heartbeat says Pre-operational"),
        (
            &["081#2042214321AABBCC", "081#4350210000000000", "701#04"][..],
            "Stopped; its last emergency is 5043h device hardware",
        ),
        (&["081#2032050000000000", "081#0000000000000000", "701#04"][..], "; its last heartbeat says Stopped"),
    ] {
        let mut net = Net::new(CommandMode::Torque);
        net.reset();
        net.serve(|_, _| None);
        for _ in 0..50 {
            ["702#05", "70A#05"].iter().chain(heard).for_each(|line| net.hear(line));
            net.wait(Duration::from_millis(10));
        }
        let text = failure(&net).to_string();
        assert!(text.starts_with("node 1 (left): start the node: not Operational within 500 ms"), "{text}");
        assert!(text.ends_with(told), "{text}");
        // The next boot knows nothing of it.
        net.master.start(net.now, &mut net.sent);
        net.wait(Duration::from_millis(700));
        assert!(failure(&net).to_string().ends_with("after the reset; nothing was heard of it"), "{}", failure(&net));
    }
}

#[test]
fn a_person_starts_the_network_anew_from_any_phase() {
    let restart = |net: &mut Net| {
        net.take();
        net.requests.clear();
        net.objects = objects();
        net.boot();
        assert_eq!(net.master.state(), State::Idle);
        net.quiet("5002", Request::None);
        net.quiet("3102", Request::Enable);
        net.quiet("3302", Request::None);
        net.quiet("3712", Request::None);
        assert_eq!(net.state(), (State::Running, None));
        assert!(net.requests.iter().any(|(node, line)| *node == 1 && line.contains("#2B17100014")), "configured anew");
    };
    // After a node was reset, from where nothing else leads back.
    let mut net = Net::running(CommandMode::Torque);
    net.cycle(["3712"; 2], Request::None, |net| net.hear("701#00"));
    assert_eq!(net.state(), (State::Stopped, Some(Fault::NodeReset)));
    // The arm was moved by hand meanwhile, further than it can move in a cycle.
    net.counts[0] += 20_000;
    restart(&mut net);
    // In the middle of its run, of its configuration, of its start.
    restart(&mut net);
    net.master.start(net.now, &mut net.sent);
    for line in ["701#00", "702#00", "70A#00"] {
        net.hear(line);
    }
    assert_eq!(*net.master.networks().phase(), Phase::Configuring);
    restart(&mut net);
    // After it failed.
    net.master.start(net.now, &mut net.sent);
    net.wait(Duration::from_millis(700));
    assert!(matches!(net.master.networks().phase(), Phase::Failed(_)));
    restart(&mut net);
    // Out of silence.
    net.master.networks_mut().on_link(BusId::FIRST, LinkEvent::BusOff);
    net.sync();
    net.compute(Request::None);
    assert!(net.master.networks().is_silent());
    restart(&mut net);
}
