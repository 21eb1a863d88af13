//! Somebody else writes to the devices: by frames that come to the network too, and from behind it.

use super::*;
use yieldwall_drives::cia402::State as Drive;
use yieldwall_fieldbus::ethercat::frame::address;

const ENABLED: [DriveOrders; 2] = [DriveOrders { controlword: 0x0f, target: 0, releases: false }; 2];
const QUICK_STOP: [DriveOrders; 2] = [DriveOrders { controlword: 0x02, target: 0, releases: false }; 2];

/// A bench whose drives are in Operation Enabled.
fn enabled() -> Bench {
    enabled_with(0)
}

/// One whose drives say that they take so long to copy their outputs.
fn enabled_with(copy_ns: u32) -> Bench {
    let mut bench = Bench::usual();
    for place in [0, 1] {
        let SimulatedDevice::Drive(drive) = bench.segment.controller_mut(place).unwrap().device_mut() else { panic!() };
        drive.od_mut().set_bytes(Address::new(0x1c32, 6), &copy_ns.to_le_bytes()).unwrap();
    }
    bench.start().unwrap();
    for controlword in [0x06, 0x07, 0x0f] {
        bench.cycles(5, &[DriveOrders { controlword, target: 0, releases: false }; 2]);
    }
    assert_eq!([0, 1].map(|place| drive(&bench, place)), [Drive::OperationEnabled; 2]);
    bench
}

fn drive(bench: &Bench, place: usize) -> Drive {
    match bench.segment.controller(place).unwrap().device() {
        SimulatedDevice::Drive(drive) => drive.state(),
        other => panic!("{other:?}"),
    }
}

/// A frame with the own source that passes the devices, and comes to the network as all do.
fn forge(bench: &mut Bench, command: Command, at: u32, data: &[u8]) {
    let mut buffer = [0; frame::LONGEST];
    let mut writer = frame::FrameWriter::new(&mut buffer, SOURCE).unwrap();
    writer.push(command, 0x55, at, data).unwrap();
    let mut frame = writer.finish().to_vec();
    let back = bench.segment.process(bench.now, &mut frame).unwrap();
    bench.insert(back, frame);
}

/// The target that a drive acts on.
fn target(bench: &Bench, place: usize) -> i32 {
    bench.segment.controller(place).unwrap().device().od().raw(0x607a, 0) as i32
}

#[test]
fn a_foreign_target_acts_only_if_it_comes_between_the_repeat_and_sync0() {
    let [.., repeat] = Budget::new(&setup()).frames;
    for copy_ns in [0, 200_000] {
        let repeat_ns = repeat.sent_ns - u64::from(copy_ns);
        let repeat_us = repeat_ns / 1000;
        for (phase_us, acts) in [(510, false), (650, false), (repeat_us - 10, false), (repeat_us + 10, true)] {
            let mut bench = enabled_with(copy_ns);
            let own = target(&bench, 0);
            let forged = [&[0x0f, 0][..], &(own + 30_000).to_le_bytes()].concat();
            let before = bench.network.repeats_before().unwrap();
            assert_eq!(before.as_nanos() as u64, 1_000_000 - repeat_ns);
            // The bench repeats by itself when the next cycle is due.
            let grid = Time(bench.next_open.0 - 1_000_000);
            if acts {
                bench.run_until(Time(bench.next_open.0 - before.as_nanos() as u64));
                bench.network.repeat(&mut bench.outbox);
                bench.flush();
            }
            bench.run_until(grid + Duration::from_micros(phase_us));
            forge(&mut bench, Command::Lwr, 0x1_0000, &forged);
            assert!(bench.cycle(&QUICK_STOP).link.intruder, "{phase_us} us");
            assert_eq!(target(&bench, 0) != own, acts, "{phase_us} us, {copy_ns} ns");
            bench.cycles(2, &QUICK_STOP);
            assert_eq!(target(&bench, 0), QUICK_STOP[0].target, "own outputs act from the next SYNC0 on");
        }
    }
}

fn watchdogs(bench: &mut Bench) -> [Vec<u8>; 2] {
    [0u16, 1].map(|position| {
        bench.unseen(Command::Aprd, address(position.wrapping_neg(), register::WATCHDOG_SYNC_MANAGER), &[0; 2])
    })
}

#[test]
fn a_frame_with_the_own_source_that_writes_what_was_never_sent_is_of_somebody_else() {
    let attacks: [(Command, u32, &[u8]); 8] = [
        (Command::Fpwr, address(0x1000, register::WATCHDOG_SYNC_MANAGER), &[0, 0]),
        (Command::Bwr, address(0, register::WATCHDOG_SYNC_MANAGER), &[0, 0]),
        (Command::Apwr, address(0, register::STATION_ADDRESS), &[1, 0x10]),
        (Command::Fprw, address(0x1001, register::WATCHDOG_DIVIDER), &[0, 0]),
        (Command::Lwr, 0x1_0000, &[0x0f, 0, 1, 0, 0, 0]),
        (Command::Lrw, 0x1_1000, &[0x0f, 0, 1, 0, 0, 0]),
        (Command::Frmw, address(0x1002, register::DC_SYSTEM_TIME), &[0; 8]),
        (Command::Fpwr, address(0x1000, 0x1000), &[0; 16]),
    ];
    for (command, at, data) in attacks {
        for phase_us in [0, 130, 480, 520, 900] {
            let mut bench = enabled();
            let open = bench.next_open;
            bench.run_until(Time(open.0 - 1_000_000) + Duration::from_micros(phase_us));
            forge(&mut bench, command, at, data);
            let seen = (0..2).position(|_| bench.cycle(&ENABLED).link.intruder);
            assert!(seen.is_some(), "{} at {at:08x}, {phase_us} us", command.name());
            // Watchdog and address are back as they were by then, whether or not the rig goes on.
            bench.cycles(1, &ENABLED);
            assert_eq!(watchdogs(&mut bench), [[50, 0], [50, 0]], "{} at {at:08x}, {phase_us} us", command.name());
            let addresses = [0u16, 1].map(|position| {
                bench.unseen(Command::Aprd, address(position.wrapping_neg(), register::STATION_ADDRESS), &[0; 2])
            });
            assert_eq!(addresses, [[0, 0x10], [1, 0x10]], "{}", command.name());
        }
    }
}

#[test]
fn a_register_that_is_written_unseen_is_named_within_a_second() {
    for (register, data, is_restored) in [
        (register::STATION_ADDRESS, &[9, 0x10][..], true),
        (register::WATCHDOG_DIVIDER, &[0xff, 0xff], true),
        (register::WATCHDOG_SYNC_MANAGER, &[0, 0], true),
        (register::DC_ACTIVATION, &[0], false),
    ] {
        for position in [0u16, 1] {
            let mut bench = enabled();
            let at = address(position.wrapping_neg(), register);
            let was = bench.unseen(Command::Aprd, at, &vec![0; data.len()]);
            bench.unseen(Command::Apwr, at, data);
            assert_ne!(bench.unseen(Command::Aprd, at, &vec![0; data.len()]), was);
            let seen = (0..1000).position(|_| bench.cycle(&ENABLED).link.intruder);
            assert!(seen.is_some(), "{register:04x}h at {position}");
            let found = bench.network.findings();
            let name = if position == 0 { "left" } else { "right" };
            let start = format!("somebody else has set register {register:04X}h of {name} (position {position}) to ");
            assert!(found[0].starts_with(&start), "{found:?}");
            bench.cycles(2, &ENABLED);
            let is = bench.unseen(Command::Aprd, at, &vec![0; data.len()]);
            assert_eq!(is == was, is_restored, "{register:04x}h");
        }
    }
}

#[test]
fn a_limit_that_is_written_through_the_mailbox_is_named_within_ten_seconds() {
    for (index, value) in [(0x6007, &[0, 0][..]), (0x6065, &[0xff; 4]), (0x6072, &[0, 0])] {
        let mut bench = enabled();
        bench.cycles(100, &ENABLED);
        let SimulatedDevice::Drive(drive) = bench.segment.controller_mut(1).unwrap().device_mut() else { panic!() };
        drive.od_mut().set_bytes(Address::new(index, 0), value).unwrap();
        let seen = (0..10_000).position(|_| bench.cycle(&ENABLED).link.intruder);
        assert!(seen.is_some(), "{index:04x}h");
        let start = format!("somebody else has set object {index:04X}h:00 of right (position 1) to ");
        assert!(bench.network.findings()[0].starts_with(&start), "{:?}", bench.network.findings());
    }
}

#[test]
fn what_is_asked_of_a_drive_is_answered_whether_or_not_its_limits_are_being_read() {
    let mut bench = enabled();
    let limit = Address::new(0x6072, 0);
    for round in 0..400u16 {
        // This program changes a limit itself: nobody else has.
        let value = (300 + round).to_le_bytes();
        let now = bench.now;
        bench.network.ask(now, Device::LeftDrive, ObjectRequest::Write(limit, &value)).unwrap();
        let ended = (0..50).find(|_| {
            assert!(!bench.cycle(&ENABLED).link.intruder);
            bench.network.answer(Device::LeftDrive) == ObjectAnswer::Done(&[])
        });
        assert!(ended.is_some(), "round {round}: {:?}", bench.network.answer(Device::LeftDrive));
        bench.cycles(usize::from(round % 37) * 10, &ENABLED);
        let now = bench.now;
        bench.network.ask(now, Device::LeftDrive, ObjectRequest::Read(limit)).unwrap();
        let ended = (0..50).find(|_| {
            bench.cycle(&ENABLED);
            bench.network.answer(Device::LeftDrive) == ObjectAnswer::Done(&value)
        });
        assert!(ended.is_some(), "round {round}: {:?}", bench.network.answer(Device::LeftDrive));
    }
}

#[test]
fn registers_that_nobody_writes_are_never_an_intruder_whatever_frames_are_lost() {
    for seed in 0..3 {
        let mut bench = enabled();
        let mut random = numbers(seed);
        bench.fate = Box::new(move |_| if random().is_multiple_of(20) { Fate::IsLost } else { Fate::Passes });
        for cycle in 0..4000 {
            assert!(!bench.cycle(&ENABLED).link.intruder, "seed {seed}, cycle {cycle}");
        }
        assert!(bench.network.findings().iter().all(|line| !line.contains("somebody else")));
    }
}

#[test]
fn drives_that_are_stopped_take_no_outputs_of_somebody_else() {
    let mut bench = enabled();
    forge(&mut bench, Command::Lwr, 0x1_0000, &[0x0f, 0, 1, 0, 0, 0]);
    let seen = (0..2).position(|_| bench.cycle(&ENABLED).link.intruder);
    assert!(seen.is_some());
    bench.network.set_stopping(true);
    for cycle in 0..200 {
        // In each cycle, behind the own outputs.
        bench.cycle(&QUICK_STOP);
        for logical in [0x1_0000, 0x1_1000] {
            forge(&mut bench, Command::Lwr, logical, &[0x0f, 0, 1, 0, 0, 0]);
        }
        if cycle > 3 {
            assert_eq!([0, 1].map(|place| bench.al(place)), ["SAFE-OP"; 2], "cycle {cycle}");
            assert!([0, 1].iter().all(|place| drive(&bench, *place) != Drive::OperationEnabled), "cycle {cycle}");
        }
    }
    let left = bench.network.findings().iter().any(|line| line.contains("left OP"));
    assert!(!left, "it was this master that asked");
    // Nothing enables a drive that has left OP.
    bench.network.set_stopping(false);
    bench.cycles(3, &ENABLED);
    assert!(!bench.cycle(&ENABLED).link.device_state.is_empty());
    assert_eq!([0, 1].map(|place| bench.al(place)), ["SAFE-OP"; 2]);
}

#[test]
fn a_drive_that_keeps_its_torque_without_outputs_is_disabled_through_its_mailbox() {
    let mut bench = enabled();
    // Without its master it does nothing: somebody has set 6007h to 0.
    let SimulatedDevice::Drive(left) = bench.segment.controller_mut(0).unwrap().device_mut() else { panic!() };
    left.od_mut().set_bytes(Address::new(0x6007, 0), &[0, 0]).unwrap();
    ServedDevice::after_write(&mut **left, Address::new(0x6007, 0));
    forge(&mut bench, Command::Lwr, 0x1_0000, &[0x0f, 0, 1, 0, 0, 0]);
    bench.cycles(2, &ENABLED);
    bench.network.set_stopping(true);
    bench.cycles(100, &QUICK_STOP);
    assert_eq!((bench.al(0).as_str(), drive(&bench, 0)), ("SAFE-OP", Drive::OperationEnabled), "it holds on");
    bench.cycles(900, &QUICK_STOP);
    assert_eq!(drive(&bench, 0), Drive::SwitchOnDisabled);
    assert_eq!([0, 1].map(|place| bench.al(place)), ["PRE-OP", "SAFE-OP"]);
}

#[test]
fn a_network_that_did_not_come_up_asks_no_device_that_it_has_not_led_out_of_init() {
    let mut setup = setup();
    setup.stations[0].identity.vendor_id = 7;
    let mut bench = Bench::new(&setup, devices());
    assert!(bench.start().unwrap_err().contains("the vendor"));
    bench.network.leave(&mut bench.outbox);
    bench.flush();
    bench.cycles(0, &REST);
    assert_eq!([0, 1, 2].map(|place| bench.al(place)), ["INIT"; 3]);
}
