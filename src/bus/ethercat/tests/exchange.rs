//! Up to OP, and cycles.

use super::*;
use yieldwall_drives::cia402::State;
use yieldwall_fieldbus::objects::{ObjectAnswer, ObjectRequest};

#[test]
fn all_devices_reach_op() {
    let mut bench = Bench::usual();
    assert_eq!(bench.start(), Ok(()));
    assert_eq!([0, 1, 2].map(|place| bench.al(place)), ["OP", "OP", "OP"]);
    let counts = bench.network.counts();
    assert_eq!((counts.lost, counts.late, counts.foreign, counts.unprocessed), (0, 0, 0, 0));
    eprintln!("{} frames, {} ms of virtual time", counts.sent, bench.now.0 / 1_000_000);
    for _ in 0..100 {
        let arrived = bench.cycle(&REST);
        assert!(arrived.drives.iter().all(|words| words.statusword.is_some() && words.position.is_some()));
        assert!(arrived.sample.is_some());
        assert_eq!(arrived.link, LinkEvents::default());
    }
    assert_eq!([Device::LeftDrive, Device::Sensor].map(|device| bench.network.missed(device)), [Some((0, 0)); 2]);
}

#[test]
fn drives_follow_their_words_and_the_sensor_is_heard() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.segment.controller_mut(2).unwrap().device_mut().force_torque_mut().unwrap().measure([1, -2, 3, -4, 5, -6]);
    for controlword in [0x06, 0x07, 0x0f] {
        bench.cycles(5, &[DriveOrders { controlword, target: 0, releases: false }; 2]);
    }
    let states =
        [0, 1].map(|place| bench.segment.controller_mut(place).unwrap().device_mut().drive_mut().unwrap().state());
    assert_eq!(states, [State::OperationEnabled; 2]);
    let arrived = bench.cycle(&[DriveOrders { controlword: 0x0f, target: 0, releases: false }; 2]);
    assert_eq!(arrived.drives.map(|words| words.statusword.unwrap() & 0x6f), [0x27; 2]);
    let sample = arrived.sample.unwrap();
    assert_eq!((sample.counts, sample.overload, sample.invalid), ([1, -2, 3, -4, 5, -6], false, false));
    let next = bench.cycle(&REST).sample.unwrap();
    assert_ne!(sample.sequence, next.sequence, "the sensor samples 8000 times a second");
}

#[test]
fn outputs_act_at_the_next_sync0() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycle(&REST);
    bench.keeps = true;
    bench.cycle(&[
        DriveOrders { controlword: 0x06, target: 0x0102_0304, releases: false },
        DriveOrders { controlword: 0x07, target: -2, releases: false },
    ]);
    // LWR of left and right drive and of the sensor, in one frame.
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let outputs = bench.sent.iter().rfind(|frame| frame[16] == 11).unwrap();
    assert_eq!(hex(&outputs[18..24]), "000001000680", "6 bytes at 10000h, more follow");
    assert_eq!(hex(&outputs[26..32]), "060004030201");
    assert_eq!(hex(&outputs[44..50]), "0700feffffff");
    let inputs = bench.sent.iter().find(|frame| frame[16] == 14).unwrap();
    // 16 and FRMW 20, LRD 18, FPRD 18, LRD 18, FPRD 18, LRD 44, FPRD 18.
    assert_eq!(inputs.len(), 16 + 20 + 2 * (18 + 18) + 44 + 18);
    let word = |bench: &Bench| bench.segment.controller(0).unwrap().device().od().raw(0x6040, 0);
    assert_eq!(word(&bench), 0, "they wait for SYNC0");
    bench.cycle(&REST);
    assert_eq!(word(&bench), 6);
}

#[test]
fn outputs_on_arrival_act_in_their_own_cycle_and_inputs_stay_those_of_sync0() {
    let mut on_arrival = setup();
    on_arrival.stations[..2].iter_mut().for_each(|station| station.acts = Acts::OnArrival);
    let mut bench = Bench::new(&on_arrival, devices());
    bench.start().unwrap();
    bench.cycle(&REST);
    let raw = |bench: &Bench, index, sub| bench.segment.controller(0).unwrap().device().od().raw(index, sub);
    assert_eq!((raw(&bench, 0x1c32, 1), raw(&bench, 0x1c33, 1)), (1, 2));
    bench.cycle(&[DriveOrders { controlword: 0x06, target: 0, releases: false }; 2]);
    assert_eq!(raw(&bench, 0x6040, 0), 6, "they do not wait for SYNC0");
    // The statusword that answers is that of the next SYNC0.
    let arrived = bench.cycle(&REST);
    assert_eq!(arrived.drives.map(|words| words.statusword.unwrap() & 0x6f), [0x21; 2]);
    bench.cycles(100, &REST);
    assert_eq!(bench.network.clock_lost(), DeviceSet::NONE);
    assert_eq!(raw(&bench, 0x1c32, 11), 0, "no SYNC0 without new outputs");
}

#[test]
fn clocks_that_drift_come_together_and_stay() {
    for [left, right, sensor_ppb] in [[50_000, -50_000, 0], [-50_000, 50_000, 50_000], [0, 50_000, -50_000]] {
        let devices = vec![controller(drive(1), left), controller(drive(2), right), controller(sensor(), sensor_ppb)];
        let mut bench = Bench::new(&setup(), devices);
        assert_eq!(bench.start(), Ok(()), "{left} {right}");
        let mut errors: Vec<i64> = Vec::new();
        for _ in 0..3000 {
            assert_eq!(bench.cycle(&REST).link, LinkEvents::default());
            errors.push(bench.network.grid_error_ns().abs());
            assert!(bench.network.grid_shift_ns().abs() <= 10_000);
        }
        errors.sort_unstable();
        let (middle, high, worst) = (errors[1500], errors[2997], errors[2999]);
        eprintln!("{left} {right} ppb: error of the grid p50 {middle} ns, p99.9 {high} ns, greatest {worst} ns");
        assert!(high < 2000, "p99.9 {high} ns");
        assert_eq!(bench.network.clock_lost(), DeviceSet::NONE);
        let times = [0, 1].map(|place| bench.segment.controller(place).unwrap().system_time_ns(bench.now));
        assert!((times[1] - times[0]).abs() < 1000, "{times:?}");
        let pulses = [0, 1].map(|place| bench.segment.controller(place).unwrap().sync0_count());
        assert!(pulses[0].abs_diff(pulses[1]) <= 1 && pulses[0] > 3000, "{pulses:?}");
    }
}

#[test]
fn a_computer_that_wakes_up_late_is_no_clock_that_is_lost() {
    for tells_late in [true, false] {
        let devices = vec![controller(drive(1), 50_000), controller(drive(2), -50_000), controller(sensor(), 0)];
        let mut bench = Bench::new(&setup(), devices);
        bench.start().unwrap();
        let mut random = numbers(1);
        bench.late = Box::new(move || Duration::from_nanos((random() >> 8) % 200_000));
        bench.tells_late = tells_late;
        let mut errors: Vec<i64> = Vec::new();
        for _ in 0..3000 {
            bench.cycle(&REST);
            errors.push(bench.network.grid_error_ns().abs());
        }
        errors.sort_unstable();
        eprintln!("told {tells_late}: error of the grid p99.9 {} ns", errors[2997]);
        assert_eq!(errors[2997] < 2000, tells_late, "{} ns", errors[2997]);
        assert_eq!(bench.network.clock_lost().is_empty(), tells_late);
    }
}

#[test]
fn a_clock_that_jumps_is_lost_within_cycles() {
    for place in [0, 1] {
        let mut bench = Bench::usual();
        bench.start().unwrap();
        bench.cycles(200, &REST);
        assert!(bench.network.clock_lost().is_empty());
        let now = bench.now;
        bench.segment.controller_mut(place).unwrap().jump_clock(now, 100_000);
        let cycles = (0..100).take_while(|_| {
            bench.cycle(&REST);
            bench.network.clock_lost().is_empty()
        });
        let cycles = cycles.count();
        eprintln!("device {place}: noticed after {cycles} cycles");
        assert!(cycles < 50, "device {place}: {cycles}");
        let link = bench.cycle(&REST).link;
        let found = bench.network.findings();
        if place == 0 {
            assert!(link.clock_lost.contains(DeviceSet::DRIVES | DeviceSet::SENSOR));
            assert!(
                found[0].starts_with("the cycles were") && found[0].ends_with("us beside the reference clock"),
                "{found:?}"
            );
        } else {
            assert_eq!(link.clock_lost, DeviceSet::RIGHT_DRIVE);
            assert!(found[0].starts_with("the clock of right (position 1) was"), "{found:?}");
        }
    }
}

#[test]
fn objects_are_read_and_written_beside_the_cycle() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycle(&REST);
    let mut ask = |request: ObjectRequest<'_>, device| {
        let now = bench.now;
        bench.network.ask(now, device, request).unwrap();
        assert_eq!(bench.network.ask(now, device, request), Err(ObjectError::Busy));
        for _ in 0..50 {
            assert_eq!(bench.cycle(&REST).link, LinkEvents::default());
            if bench.network.answer(device) != ObjectAnswer::Pending {
                break;
            }
        }
        match bench.network.answer(device) {
            ObjectAnswer::Done(data) => Ok(data.to_vec()),
            ObjectAnswer::Failed(error) => Err(error.to_string()),
            other => panic!("{other:?}"),
        }
    };
    let limit = Address::new(0x6072, 0);
    assert_eq!(ask(ObjectRequest::Read(limit), Device::LeftDrive), Ok(vec![0xf4, 1]));
    assert_eq!(ask(ObjectRequest::Write(limit, &[100, 0]), Device::LeftDrive), Ok(vec![]));
    assert_eq!(ask(ObjectRequest::Read(limit), Device::LeftDrive), Ok(vec![100, 0]));
    // 278 bytes in segments.
    let calibration = ask(ObjectRequest::Read(Address::new(0x1008, 0)), Device::Sensor).unwrap();
    assert_eq!(calibration, b"six-axis force/torque sensor");
    assert!(ask(ObjectRequest::Read(Address::new(0x1234, 0)), Device::RightDrive).unwrap_err().contains("0602"));
}

#[test]
fn an_emergency_is_told_with_its_device_and_moment() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycle(&REST);
    let now = bench.now;
    let drive = bench.segment.controller_mut(1).unwrap().device_mut().drive_mut().unwrap();
    drive.raise_fault(now, 0x3210);
    for controlword in [0x06, 0x07, 0x0f] {
        bench.cycles(5, &[DriveOrders { controlword, target: 0, releases: false }; 2]);
    }
    let now = bench.now;
    bench.segment.controller_mut(0).unwrap().fail(now, AlStatusCode::SYNC_ERROR);
    let mut events = LinkEvents::default();
    for _ in 0..60 {
        let link = bench.cycle(&REST).link;
        events.emergency |= link.emergency;
        events.device_state |= link.device_state;
    }
    assert_eq!((events.emergency, events.device_state), (DeviceSet::LEFT_DRIVE, DeviceSet::LEFT_DRIVE));
    let told: Vec<_> = bench.network.told().map(|told| (told.device, told.code.0)).collect();
    assert_eq!(told, [(Device::RightDrive, 0x3210), (Device::LeftDrive, 0x8250)]);
    let (status, code) = bench.network.al_status(Device::LeftDrive).unwrap();
    assert_eq!((status.to_string(), code), ("SAFE-OP+ERR".to_owned(), AlStatusCode::SYNC_ERROR));
    let found = bench.network.findings();
    assert!(found[0].starts_with("left (position 0) left OP: SAFE-OP+ERR, AL status code 001Ah"), "{found:?}");
}

#[test]
fn a_network_that_is_left_puts_the_devices_to_pre_op_and_can_be_started_again() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycle(&REST);
    let now = bench.now;
    bench.network.leave(&mut bench.outbox);
    bench.flush();
    bench.run_until(now + Duration::from_millis(5));
    assert_eq!([0, 1, 2].map(|place| bench.al(place)), ["PRE-OP"; 3]);
    bench.next_open = Time::NEVER;
    assert_eq!(bench.start(), Ok(()));
    bench.cycle(&REST);
}

#[test]
fn who_looks_on_is_told_what_is_waited_for() {
    let mut bench = Bench::usual();
    assert_eq!(bench.network.waiting(bench.now), None);
    bench.network.start(bench.now, &mut bench.outbox);
    bench.flush();
    let mut told: Vec<String> = Vec::new();
    while *bench.network.phase() != Phase::Operational {
        let waiting = bench.network.waiting(bench.now).unwrap();
        assert!(waiting.left <= Duration::from_secs(10));
        let line = format!("{}: {}", waiting.name, waiting.step);
        if told.last() != Some(&line) {
            told.push(line);
        }
        let until = bench.now + Duration::from_micros(20);
        bench.run_until(until);
    }
    for line in [
        "master: look for another master",
        "left: go to PRE-OP",
        "right: map the process data",
        "force sensor: go to SAFE-OP",
    ] {
        assert!(told.iter().any(|seen| seen == line), "{line} in {told:#?}");
    }
    assert_eq!(told[told.len() - 2..], ["master: bring the clocks together", "master: go to OP"]);
    assert_eq!(bench.network.waiting(bench.now), None);
}

#[test]
fn after_a_master_that_died_the_segment_comes_up() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycles(5, &REST);
    // It dies: the watchdogs act.
    bench.network = EthercatNetwork::new(&setup()).unwrap();
    bench.wire.clear();
    bench.next_open = Time::NEVER;
    let later = bench.now + Duration::from_millis(50);
    bench.run_until(later);
    assert_eq!([bench.al(0), bench.al(1)], ["SAFE-OP+ERR", "SAFE-OP+ERR"]);
    assert_eq!(bench.start(), Ok(()));
}
