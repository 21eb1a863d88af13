//! Frames that are lost, late, doubled or somebody else's.

use super::*;
use proptest::prelude::*;

/// Which share of the frames, in per cent, has a fate.
fn some(seed: u64, per_cent: u64, fates: &'static [Fate]) -> Box<dyn FnMut(u64) -> Fate> {
    let mut random = numbers(seed);
    Box::new(move |_| {
        let number = random() >> 8;
        if number % 100 < per_cent { fates[(number / 100) as usize % fates.len()] } else { Fate::Passes }
    })
}

const BAD: &[Fate] =
    &[Fate::IsLost, Fate::IsLate(Duration::from_micros(700)), Fate::IsLate(Duration::from_millis(25)), Fate::IsDoubled];

#[test]
fn bring_up_survives_frames_that_are_lost_late_and_doubled() {
    for seed in 0..12 {
        let mut bench = Bench::usual();
        bench.fate = some(seed, 5, BAD);
        assert_eq!(bench.start(), Ok(()), "seed {seed}");
        let counts = bench.network.counts();
        assert!(counts.lost > 0 && counts.late > 0, "{counts:?}");
    }
}

#[test]
fn sync0_that_was_set_up_too_late_is_set_up_again() {
    // Half of the frames are lost, and each is waited for: some set-ups take longer than the time to the first pulse.
    let mut late = 0;
    for seed in 0..12 {
        let mut is_lossy = false;
        let mut bench = Bench::usual();
        bench.keeps = true;
        bench.network.start(bench.now, &mut bench.outbox);
        bench.flush();
        while matches!(bench.network.phase(), Phase::Configuring) {
            let is_sync0 = bench.network.waiting(bench.now).is_some_and(|waiting| waiting.step == "set up SYNC0");
            if is_sync0 != is_lossy {
                is_lossy = is_sync0;
                bench.fate = if is_lossy { some(seed, 50, &[Fate::IsLost]) } else { Box::new(|_| Fate::Passes) };
            }
            let until = bench.now + Duration::from_micros(5);
            bench.run_until(until);
        }
        bench.fate = Box::new(|_| Fate::Passes);
        let until = bench.now + Duration::from_secs(10);
        bench.run_until(until);
        assert_eq!(bench.network.phase(), &Phase::Operational, "seed {seed}");
        // Each value of the start time that was written, of two devices.
        let starts: std::collections::BTreeSet<_> = bench
            .sent
            .iter()
            .filter(|frame| frame[16] == 5 && frame[20..22] == [0x90, 0x09])
            .map(|frame| frame[18..].to_vec())
            .collect();
        late += starts.len() - 2;
    }
    eprintln!("{late} times too late");
    assert!(late > 0);
}

#[test]
fn a_late_reply_is_not_the_input_of_another_cycle() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    let mut late = 0;
    let mut position = 0i32;
    for cycle in 0..400 {
        // What the drive measures says in which cycle it was.
        position += 10;
        let drive = bench.segment.controller_mut(0).unwrap().device_mut().drive_mut().unwrap();
        drive.measure(f64::from(position) / 100_000.0 * std::f64::consts::TAU, 0.0);
        let is_late = cycle % 7 == 3;
        bench.fate = Box::new(move |_| if is_late { Fate::IsLate(Duration::from_micros(700)) } else { Fate::Passes });
        let arrived = bench.cycle(&REST);
        assert_eq!(arrived.drives[0].position.is_none(), is_late, "cycle {cycle}");
        assert_eq!(arrived.sample.is_none(), is_late);
        late += u32::from(!arrived.link.late.is_empty());
        if let Some(heard) = arrived.drives[0].position {
            assert!((heard - position).abs() <= 10, "cycle {cycle}: {heard} where {position} was measured");
        }
    }
    assert!(late > 40, "{late}");
}

#[test]
fn a_device_that_is_silent_is_named_by_its_counter_and_the_others_are_heard() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycle(&REST);
    bench.segment.controller_mut(1).unwrap().set_silent(true);
    for _ in 0..10 {
        let arrived = bench.cycle(&REST);
        assert!(arrived.drives[0].statusword.is_some() && arrived.sample.is_some());
        assert_eq!(arrived.drives[1], Default::default());
        assert_eq!(bench.network.missing(), DeviceSet::RIGHT_DRIVE);
    }
    // The last output frame is not back yet.
    assert_eq!(bench.network.missed(Device::RightDrive), Some((10, 9)));
    assert_eq!(bench.network.missed(Device::LeftDrive), Some((0, 0)));
    assert_eq!(bench.cycle(&REST).link, LinkEvents { outputs_missed: DeviceSet::RIGHT_DRIVE, ..LinkEvents::default() });
    assert_eq!(bench.network.findings(), ["right (position 1): inputs missing in 11 cycles, outputs not taken in 10"]);
}

#[test]
fn a_port_that_counts_damaged_frames_is_named_and_told_once_for_each() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycles(20, &REST);
    for port in [0, 1, 1] {
        bench.segment.controller_mut(1).unwrap().count_receive_error(port);
        let told: Vec<_> = (0..12).map(|_| bench.cycle(&REST).link.port_errors).filter(|set| !set.is_empty()).collect();
        assert_eq!(told, [DeviceSet::RIGHT_DRIVE]);
    }
    assert_eq!(
        bench.network.findings(),
        [
            "port 0 of right (position 1) counted 1 damaged frames",
            "port 1 of right (position 1) counted 2 damaged frames"
        ]
    );
}

#[test]
fn a_pulled_cable_leaves_the_rest_and_nothing_goes_to_op_by_itself() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycles(5, &REST);
    bench.segment.set_cable(1, false);
    let arrived = bench.cycle(&REST);
    assert!(
        arrived.drives[0].statusword.is_some() && arrived.drives[1].statusword.is_none() && arrived.sample.is_none()
    );
    let cut = DeviceSet::RIGHT_DRIVE | DeviceSet::SENSOR;
    assert_eq!(bench.cycle(&REST).link.port_errors, cut, "in the next cycle, and from then on");
    assert_eq!(
        bench.network.findings()[0],
        "the link at port 1 of left (position 0) was lost; behind it: right (position 1), force sensor (position 2)"
    );
    for _ in 0..20 {
        assert_eq!(bench.cycle(&REST).link.port_errors, cut);
    }
    assert_eq!((bench.al(0), bench.al(1), bench.al(2)), ("OP".into(), "SAFE-OP+ERR".into(), "SAFE-OP+ERR".into()));
    bench.segment.set_cable(1, true);
    let mut left = DeviceSet::NONE;
    for _ in 0..50 {
        let link = bench.cycle(&REST).link;
        left |= link.device_state;
        assert_eq!(link.port_errors, cut, "until a person starts the network anew");
    }
    assert_eq!(left, cut);
    assert_eq!((bench.al(1), bench.al(2)), ("SAFE-OP+ERR".into(), "SAFE-OP+ERR".into()));
    bench.next_open = Time::NEVER;
    assert_eq!(bench.start(), Ok(()), "by identity");
    assert_eq!(bench.cycle(&REST).link, LinkEvents::default());
    assert_eq!(bench.network.findings(), [""; 0]);
}

#[test]
fn the_drives_stop_by_their_watchdogs_when_nothing_is_sent() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycles(5, &REST);
    bench.network.set_silent(true);
    bench.cycles(10, &REST);
    assert_eq!((bench.al(0), bench.al(1)), ("SAFE-OP+ERR".into(), "SAFE-OP+ERR".into()));
}

#[test]
fn frames_of_somebody_else_are_an_intruder_in_op() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycle(&REST);
    bench.fate = Box::new(|count| if count.is_multiple_of(50) { Fate::IsFollowed } else { Fate::Passes });
    let intruders = (0..100).filter(|_| bench.cycle(&REST).link.intruder).count();
    // Four frames a cycle.
    assert!((7..=9).contains(&intruders), "{intruders}");
    let found = bench.network.findings();
    assert_eq!(found[0], "another master writes: an EtherCAT frame came from 02:00:00:00:00:07", "{found:?}");
}

#[test]
fn cycles_go_on_with_five_per_cent_of_bad_frames_and_an_object_is_still_read() {
    for seed in 0..4 {
        let mut bench = Bench::usual();
        bench.start().unwrap();
        bench.fate = some(seed, 5, BAD);
        let (mut whole, mut read) = (0, 0);
        for cycle in 0..3000 {
            let arrived = bench.cycle(&REST);
            whole += u32::from(arrived.drives.iter().all(|words| words.statusword.is_some()));
            if !matches!(bench.network.answer(Device::LeftDrive), ObjectAnswer::Pending) {
                let answer = bench.network.answer(Device::LeftDrive);
                match answer {
                    ObjectAnswer::Done(data) => assert_eq!(data, [0xf4, 1]),
                    ObjectAnswer::NotAsked => {}
                    other => panic!("seed {seed}, cycle {cycle}: {other:?}"),
                }
                read += 1;
                let now = bench.now;
                bench.network.ask(now, Device::LeftDrive, ObjectRequest::Read(Address::new(0x6072, 0))).unwrap();
            }
        }
        assert!(whole > 2800, "{whole}");
        assert!(read > 100, "{read}");
        assert_eq!([0, 1, 2].map(|place| bench.al(place)), ["OP"; 3], "seed {seed}");
        assert_eq!(bench.network.clock_lost(), DeviceSet::NONE, "seed {seed}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever comes over the wire, framed as EtherCAT or not: no panic, and what is sent is bounded.
    #[test]
    fn any_bytes_are_survived(frames in proptest::collection::vec((proptest::collection::vec(any::<u8>(), 0..200), any::<bool>()), 1..40), is_up: bool) {
        let mut bench = Bench::usual();
        if is_up {
            bench.start().unwrap();
            bench.cycle(&REST);
        } else {
            bench.network.start(bench.now, &mut bench.outbox);
        }
        let sent = bench.network.counts().sent;
        for (bytes, is_framed) in &frames {
            let mut frame = bytes.clone();
            if *is_framed {
                let [low, high] = (bytes.len() as u16 | 0x1000).to_le_bytes();
                frame = [&[0xff; 6][..], &[0x12, 0x10, 0x10, 0x10, 0x10, 0x10], &[0x88, 0xa4, low, high], bytes].concat();
            }
            bench.network.on_frame(bench.now, &frame, &mut bench.outbox);
        }
        prop_assert!(bench.network.counts().sent - sent <= frames.len() as u64);
    }

    /// Replies whose data are anything, to frames of the network's own.
    #[test]
    fn any_answers_of_devices_are_survived(seed: u64, share in 0u64..100, counters: bool) {
        let mut network = EthercatNetwork::new(&setup()).unwrap();
        let mut bench = Bench::usual();
        let mut random = numbers(seed);
        let (mut now, mut out) = (Time(0), Vec::new());
        network.start(now, &mut out);
        for _ in 0..400 {
            for mut frame in std::mem::take(&mut out) {
                bench.segment.process(now, &mut frame);
                let spans: Vec<_> = {
                    let end = frame::end(&frame).unwrap();
                    let mut at = Some(frame::HEADER);
                    std::iter::from_fn(|| {
                        let span = frame::datagram_at(&frame, at?, end).ok()?;
                        at = span.header.has_more.then_some(span.end());
                        Some(span)
                    }).collect()
                };
                if random() % 100 < share {
                    for span in spans {
                        for byte in span.data.clone() {
                            frame[byte] = random() as u8;
                        }
                        if counters {
                            frame[span.data.end] = (random() % 4) as u8;
                        }
                    }
                }
                network.on_frame(now, &frame, &mut out);
            }
            now = Time(now.0.saturating_add(20_000).max(network.next_deadline().0.min(now.0 + 10_000_000)));
            bench.segment.poll(now);
            network.poll(now, &mut out);
            prop_assert!(out.len() < 20);
        }
    }
}
