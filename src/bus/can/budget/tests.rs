use super::*;
use crate::tests::WAITS;
use crate::{CommandMode, DriveSetup, SensorLink, SensorNode, SensorSetup, SensorStart};
use yieldwall_config::shipped_profile;
use yieldwall_fieldbus::plain_can::{Link, Protocol, polled, streaming};

const US: u64 = 1000;

fn setup(mode: CommandMode, period_us: u64) -> MasterSetup {
    let heartbeat = Duration::from_millis(20);
    let drive = |name: &str, node_id| DriveSetup {
        name: name.to_owned(),
        bus: BusId::FIRST,
        node_id,
        profile: shipped_profile("simulated-servo"),
        heartbeat,
        waits: WAITS,
        torque_limit_per_mille: 1000,
        speed_limit_counts_per_s: 10_000,
        following_error_counts: 1000,
        homing: None,
    };
    MasterSetup {
        node_id: 127,
        heartbeat,
        period: Duration::from_micros(period_us),
        mode,
        drives: vec![drive("left", 1), drive("right", 2)],
        sensor: SensorSetup {
            name: "wrist".to_owned(),
            bus: BusId::FIRST,
            link: SensorLink::Canopen(SensorNode {
                node_id: 10,
                profile: shipped_profile("simulated-force-sensor"),
                heartbeat,
                start: SensorStart::default(),
            }),
            waits: WAITS,
            sample_period: Duration::from_micros(period_us),
        },
    }
}

const HOST: Conditions = Conditions {
    bus: BusId::FIRST,
    bit_rate: 1_000_000,
    compute_at: Duration::from_micros(620),
    device_delay: Duration::ZERO,
    has_release_jitter: true,
    has_fifo: true,
};

fn budget(mode: CommandMode, conditions: Conditions) -> Budget {
    Budget::new(&setup(mode, 1000), conditions).unwrap()
}

fn response_us(budget: &Budget, cob_id: u16) -> u64 {
    let frame = budget.frames.iter().find(|frame| frame.frame.cob_id == cob_id).unwrap();
    frame.response_ns.unwrap() / US
}

#[test]
fn the_frames_are_those_of_the_profiles() {
    let budget = budget(CommandMode::Torque, HOST);
    let frames: Vec<(u16, u8, &str)> = budget
        .frames
        .iter()
        .map(|FrameBudget { frame, .. }| (frame.cob_id, frame.bytes, frame.name.as_str()))
        .collect();
    assert_eq!(
        frames,
        [
            (0x080, 0, "SYNC"),
            (0x081, 8, "left EMCY"),
            (0x082, 8, "right EMCY"),
            (0x08a, 8, "wrist EMCY"),
            (0x181, 6, "left TPDO1"),
            (0x182, 6, "right TPDO1"),
            (0x18a, 8, "wrist TPDO1"),
            (0x201, 4, "left RPDO1"),
            (0x202, 4, "right RPDO1"),
            (0x28a, 6, "wrist TPDO2"),
            (0x58a, 8, "wrist SDO response"),
            (0x60a, 8, "wrist SDO request"),
            (0x701, 1, "left heartbeat"),
            (0x702, 1, "right heartbeat"),
            (0x70a, 1, "wrist heartbeat"),
            (0x77f, 1, "master heartbeat"),
        ]
    );
    // 725 bits of process data every ms, 4 heartbeats of 65 bits every 20 ms.
    assert!((budget.cyclic_load() - 0.725).abs() < 1e-12);
    assert!((budget.load() - 0.738).abs() < 1e-12);
}

/// Every figure by hand, from the longest frames: 53 SYNC, 111 112 131 111 measured, 111 112 set-points, heartbeats 62 but
/// that of the sensor, 61.
#[test]
fn position_mode_at_one_kilohertz_by_hand() {
    let budget = budget(CommandMode::Position, HOST);
    // From the control step: two heartbeats of drives, one of the sensor, both set-points, the master's heartbeat.
    assert_eq!(response_us(&budget, 0x77f), 61 + 62 + 62 + 111 + 112 + 62);
    // It holds up SYNC by what goes beyond the period.
    let sync = 620 + 470 - 1000 + 53;
    assert_eq!(response_us(&budget, 0x080), sync);
    assert_eq!(response_us(&budget, 0x181), sync + 111);
    assert_eq!(response_us(&budget, 0x28a), sync + 111 + 112 + 131 + 111);
    assert_eq!(response_us(&budget, 0x201), 62 + 111);
    assert_eq!(response_us(&budget, 0x202), 62 + 111 + 112);
    assert!(budget.is_schedulable());
    assert_eq!(budget.latest().unwrap().frame.cob_id, 0x28a);
    assert_eq!(budget.latest().unwrap().late_ns(), Some(0));
}

#[test]
fn without_a_fifo_sync_waits_for_one_heartbeat() {
    let budget = budget(CommandMode::Position, Conditions { has_fifo: false, ..HOST });
    assert_eq!(response_us(&budget, 0x080), 62 + 53);
    assert_eq!(response_us(&budget, 0x28a), 62 + 53 + 465);
    assert!(budget.is_schedulable());
}

#[test]
fn a_device_that_answers_late_lets_other_frames_in_between() {
    let delay = |us| Conditions { device_delay: Duration::from_micros(us), ..HOST };
    let at = |us, id| response_us(&budget(CommandMode::Torque, delay(us)), id);
    assert_eq!(at(10, 0x28a), at(0, 0x28a) + 10 + 62);
    // A measured value of lower priority from a faster device is in the way as well.
    assert_eq!(at(10, 0x181), at(0, 0x181) + 10 + 131);
    assert!(!budget(CommandMode::Torque, delay(200)).is_schedulable());
}

#[test]
fn sdo_and_emergencies_are_counted_apart() {
    let budget = budget(CommandMode::Torque, HOST);
    assert!(budget.is_schedulable());
    let (sdo, emergencies) = (budget.latest_with_sdo.unwrap(), budget.latest_with_emergencies.unwrap());
    assert!(sdo.late_ns().unwrap() > 0 && emergencies.late_ns() > sdo.late_ns(), "{sdo:?} {emergencies:?}");
    for id in [0x58a, 0x60a, 0x081] {
        assert!(budget.frames.iter().any(|frame| frame.frame.cob_id == id && frame.is_occasional()));
    }
}

#[test]
fn all_together_without_fifo_is_the_plain_analysis() {
    let plain = budget(CommandMode::Position, Conditions { has_release_jitter: false, has_fifo: false, ..HOST });
    // A heartbeat in the way of the last cyclic frame, SYNC, four frames of 6 bytes of the drives, 8 and 6 of the sensor:
    // 55 + 10 s bits each.
    assert_eq!(response_us(&plain, 0x28a), 65 + 55 + 4 * 115 + 135 + 115);
    let stream = |frame: &FrameBudget| frame.frame.stream(1000, true);
    let streams: Vec<Stream> = plain.regular().map(stream).collect();
    for frame in plain.regular() {
        assert_eq!(frame.response_ns, response_among_ns(&stream(frame), &streams, 1000));
        assert_eq!(frame.deadline_ns, frame.frame.period.as_nanos() as u64);
    }
    let fifo = budget(CommandMode::Position, Conditions { has_release_jitter: false, ..HOST });
    assert!(response_us(&fifo, 0x080) > response_us(&plain, 0x28a), "SYNC waits behind the heartbeat");
}

#[test]
fn a_bus_that_is_too_slow_has_no_bounds_and_no_panic() {
    for bit_rate in [10_000, 125_000, 500_000] {
        for (has_release_jitter, has_fifo) in [(true, true), (true, false), (false, true), (false, false)] {
            let budget = budget(CommandMode::Position, Conditions { bit_rate, has_release_jitter, has_fifo, ..HOST });
            assert!(!budget.is_schedulable(), "{bit_rate} {has_release_jitter} {has_fifo}");
            assert!(budget.load() > 1.0);
        }
    }
}

#[test]
fn advice_is_the_least_change_that_fits() {
    let torque = setup(CommandMode::Torque, 1000);
    let early = Conditions { compute_at: Duration::from_micros(300), ..HOST };
    assert!(!Budget::new(&torque, early).unwrap().is_schedulable());
    let advice = advise(&torque, early, &[]).unwrap().unwrap();
    assert_eq!((advice.bit_rate, advice.period), (1_000_000, Duration::from_millis(1)));
    let [earliest, latest] = advice.compute_at_us;
    assert!(earliest < 620 && 620 < latest, "{advice:?}");
    // Both ends are sharp.
    let fits = |compute_us| {
        let conditions = Conditions { compute_at: Duration::from_micros(compute_us), ..HOST };
        Budget::new(&torque, conditions).unwrap().is_schedulable()
    };
    assert!(fits(earliest) && fits(latest) && !fits(earliest - 1) && !fits(latest + 1));

    let slow = Conditions { bit_rate: 500_000, ..HOST };
    let advice = advise(&torque, slow, &[]).unwrap().unwrap();
    // 800 kbit/s does not do.
    assert_eq!((advice.bit_rate, advice.period), (1_000_000, Duration::from_millis(1)));
    let advice = advise(&setup(CommandMode::Position, 500), HOST, &[]).unwrap().unwrap();
    assert_eq!((advice.bit_rate, advice.period), (1_000_000, Duration::from_millis(1)));
}

fn plain_can(protocol: Protocol, sample_us: u64) -> MasterSetup {
    let link = Link {
        protocol,
        pair_gap: Duration::from_micros(500),
        sample_period: Duration::from_millis(1),
        zero_at_start: false,
    };
    let name = "wrist".to_owned();
    let sample_period = Duration::from_micros(sample_us);
    let sensor = SensorSetup { name, bus: BusId::FIRST, link: SensorLink::PlainCan(link), waits: WAITS, sample_period };
    MasterSetup { sensor, ..setup(CommandMode::Torque, 1000) }
}

fn streaming(first: u16, sample_us: u64) -> MasterSetup {
    plain_can(Protocol::Streaming(streaming::Ids { command: first + 2, data: [first, first + 1] }), sample_us)
}

fn polled() -> MasterSetup {
    let byte_order = polled::ByteOrder::BigEndian;
    plain_can(Protocol::Polled(polled::Format { base: 0x1b0, byte_order, overload_bits: 1, invalid_bits: 2 }), 1000)
}

/// Torque mode without the sensor's node: 53 SYNC, 111 112 drives, 92 93 set-points, heartbeats 62. A request has 63 bits,
/// each of its answers 131.
#[test]
fn a_polled_sensor_by_hand() {
    let at = |compute_us| {
        let conditions = Conditions { compute_at: Duration::from_micros(compute_us), ..HOST };
        Budget::new(&polled(), conditions).unwrap()
    };
    let budget = at(700);
    // The last heartbeat of the cycle holds up SYNC.
    let heartbeat = 62 + 62 + 92 + 93 + 62;
    let sync = 700 + heartbeat - 1000 + 53;
    assert_eq!(response_us(&budget, 0x77f), heartbeat);
    assert_eq!(response_us(&budget, 0x080), sync);
    assert_eq!(response_us(&budget, 0x1b0), sync + 111 + 112 + 63);
    assert_eq!(response_us(&budget, 0x1b5), sync + 111 + 112 + 63 + 131);
    assert_eq!(response_us(&budget, 0x1b6), sync + 111 + 112 + 63 + 131 + 131);
    // The request has gone when the set-points come.
    assert_eq!(response_us(&budget, 0x202), 62 + 92 + 93);
    assert!(budget.is_schedulable() && !at(620).is_schedulable());
    let delayed =
        Conditions { device_delay: Duration::from_micros(10), compute_at: Duration::from_micros(700), ..HOST };
    let delayed = Budget::new(&polled(), delayed).unwrap();
    assert!(response_us(&delayed, 0x1b6) > response_us(&budget, 0x1b6) + 20, "two devices take their time");
}

#[test]
fn a_streaming_sensor_comes_at_any_moment() {
    let budget = Budget::new(&streaming(0x360, 2000), HOST).unwrap();
    let heartbeat = 131 + 132 + 62 + 62 + 92 + 93 + 62;
    assert_eq!(response_us(&budget, 0x77f), heartbeat);
    let sync = 620 + heartbeat - 1000 + 53;
    assert_eq!(response_us(&budget, 0x080), sync);
    assert_eq!(response_us(&budget, 0x182), sync + 111 + 112, "what is lower waits");
    assert_eq!(response_us(&budget, 0x202), 132 + 92 + 93, "but for a frame that has just begun");
    // All of one cycle before both frames of a sample.
    assert_eq!(response_us(&budget, 0x361), 62 + 53 + 111 + 112 + 92 + 93 + 132 + 131);
    let sample = budget.frames.iter().find(|frame| frame.frame.cob_id == 0x361).unwrap();
    assert_eq!((sample.from, sample.deadline_ns), (Moment::Release, 2000 * US));
    assert!(budget.is_schedulable());
    // As delivered it goes before SYNC and everything else.
    let outranking = Budget::new(&streaming(0x001, 2000), HOST).unwrap();
    assert!(response_us(&outranking, 0x080) >= 131 + 132 + 53);
    assert!(response_us(&outranking, 0x182) > response_us(&budget, 0x182) + 200);
}

/// The sensor on a bus of its own, at half the bit rate of the drives'.
fn apart(mut setup: MasterSetup) -> [Budget; 2] {
    setup.sensor.bus = BusId::new(1);
    let conditions = Conditions { compute_at: Duration::from_micros(740), ..HOST };
    let sensor = Conditions { bus: BusId::new(1), bit_rate: 500_000, ..conditions };
    [conditions, sensor].map(|conditions| Budget::new(&setup, conditions).unwrap())
}

/// As above; 61 bits of the heartbeat, 131 and 111 of the process data of node 10.
#[test]
fn two_buses_do_not_wait_for_each_other() {
    let [drives, sensor] = apart(setup(CommandMode::Torque, 1000));
    assert!(drives.frames.iter().chain(&sensor.frames).all(|each| !each.frame.name.is_empty()));
    assert!(sensor.frames.iter().all(|each| each.frame.name.starts_with("wrist")
        || each.frame.name.starts_with("master")
        || each.frame.name == "SYNC"));
    assert!(drives.frames.iter().all(|each| !each.frame.name.starts_with("wrist")));
    // One heartbeat that has just begun, then SYNC; the master's own does not last to the next cycle.
    assert_eq!(response_us(&sensor, 0x080), 2 * (61 + 53));
    assert_eq!(response_us(&sensor, 0x28a), 2 * (61 + 53 + 131 + 111));
    assert_eq!(response_us(&drives, 0x202), 62 + 92 + 93);
    assert!(drives.is_schedulable() && sensor.is_schedulable());
}

#[test]
fn a_streaming_sensor_alone_on_its_bus_needs_no_sync() {
    let [_, sensor] = apart(streaming(0x360, 2000));
    let ids: Vec<u16> = sensor.frames.iter().map(|each| each.frame.cob_id).collect();
    assert_eq!(ids, [0x360, 0x361]);
    assert_eq!(response_us(&sensor, 0x361), 2 * (132 + 131));
    let [_, polled] = apart(polled());
    // Request and both answers follow the begin of the cycle.
    assert_eq!(response_us(&polled, 0x1b6), 2 * (63 + 131 + 131));
    assert!(sensor.is_schedulable() && polled.is_schedulable());
}

#[test]
fn advice_for_one_bus_is_kept_by_the_others() {
    let mut setup = setup(CommandMode::Torque, 1000);
    setup.sensor.bus = BusId::new(1);
    let conditions = Conditions { compute_at: Duration::from_micros(600), ..HOST };
    let sensor = Conditions { bus: BusId::new(1), bit_rate: 500_000, ..conditions };
    let advice = advise(&setup, sensor, &[conditions]).unwrap().unwrap();
    assert_eq!((advice.bit_rate, advice.compute_at_us), (500_000, [712, 753]));
}
