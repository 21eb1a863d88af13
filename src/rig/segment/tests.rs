//! The segment as a master sees it, in virtual time: whole bring-up, what the arm does, and each injection.

use super::super::frame_faults::KEPT;
use super::*;
use yieldwall_config::injection::{CATALOGUE, Kind, Target};
use yieldwall_config::{builtin, load_rig};
use yieldwall_drives::cia402::State;
use yieldwall_fieldbus::ethercat::coe::{CoeAnswer, CoeClient, CoeEvent, CoeRequest};
use yieldwall_fieldbus::ethercat::frame::{Datagrams, FrameWriter, address};
use yieldwall_fieldbus::ethercat::mailbox::{self, Counter, Protocol};
use yieldwall_fieldbus::ethercat::sii::Sii;
use yieldwall_fieldbus::ethercat::{Direction, Fmmu, u16_at};
use yieldwall_fieldbus::objects::Address;

const PERIOD: Duration = Duration::from_millis(1);
/// Bytes of outputs and inputs of a drive, by default.
const OUTPUTS: usize = 13;
const INPUTS: usize = 15;
/// Logical addresses of a device.
const STRIDE: u32 = 0x100;

/// A master of a few lines, its clock, and what came back of its last frame.
struct Bench {
    server: SegmentServer,
    now: Time,
    back: Vec<Vec<u8>>,
    counters: [Counter; 3],
    emergencies: Vec<(usize, u16)>,
}

fn server(pace: Pace, here: [bool; 3]) -> SegmentServer {
    let rig = load_rig(builtin("paper-ethercat.yaml")).unwrap();
    let scene = rig.scene().unwrap().value;
    SegmentServer::new(&rig.value, &scene, 1, pace, here, Time(0)).unwrap()
}

impl Bench {
    fn new(pace: Pace) -> Self {
        let (back, emergencies) = (Vec::new(), Vec::new());
        Bench { server: server(pace, [true; 3]), now: Time(1000), back, counters: [Counter::FIRST; 3], emergencies }
    }

    /// Advances the wall clock; frames that were held come back.
    fn pass(&mut self, time: Duration) {
        let until = self.now + time;
        let Self { server, back, .. } = self;
        while server.next_deadline() <= until {
            server.poll(server.next_deadline(), |frame| back.push(frame.to_vec())).unwrap();
        }
        self.now = until;
    }

    /// Sends a frame of datagrams: command, address, data. It keeps the frames that come back at once.
    fn send(&mut self, datagrams: &[(Command, u32, &[u8])]) -> Vec<u8> {
        let mut buffer = [0; 1514];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
        for (command, address, data) in datagrams {
            writer.push(*command, 1, *address, data).unwrap();
        }
        let frame = writer.finish();
        let sent = frame.to_vec();
        self.back.clear();
        let Self { server, now, back, .. } = self;
        server.on_frame(*now, frame, |frame| back.push(frame.to_vec())).unwrap();
        sent
    }

    /// Data and working counter of one datagram.
    fn ask(&mut self, command: Command, address: u32, data: &[u8]) -> (Vec<u8>, u16) {
        self.pass(Duration::from_micros(20));
        self.send(&[(command, address, data)]);
        let frame = self.back.first().expect("it comes back");
        (frame[26..26 + data.len()].to_vec(), u16_at(frame, 26 + data.len()))
    }

    fn at(place: usize, ado: u16) -> u32 {
        address(0u16.wrapping_sub(place as u16), ado)
    }

    fn write(&mut self, place: usize, ado: u16, data: &[u8]) {
        assert_eq!(self.ask(Command::Apwr, Self::at(place, ado), data).1, 1, "{ado:04x} of {place}");
    }

    /// AL status and AL status code.
    fn al(&mut self, place: usize) -> (u16, u16) {
        let (data, _) = self.ask(Command::Aprd, Self::at(place, 0x0130), &[0; 6]);
        (u16_at(&data, 0), u16_at(&data, 4))
    }

    fn pre_operational(&mut self) {
        for place in 0..3 {
            let image = self.server.segment_mut().unwrap().controller_mut(place).unwrap().sii_mut().to_vec();
            let sii = Sii::read(&image).unwrap();
            for (number, manager) in (0u16..).zip(&sii.sync_managers) {
                self.write(place, 0x0800 + 8 * number, &manager.settings.encode());
            }
            let logical = STRIDE * place as u32;
            let [outputs, inputs] = [2, 3].map(|number: usize| sii.sync_managers[number].settings);
            let fmmus = [
                Fmmu::bytes(logical, outputs.len, outputs.start, Direction::Write),
                Fmmu::bytes(logical + 0x80, inputs.len, inputs.start, Direction::Read),
            ];
            self.write(place, 0x0600, fmmus.map(|fmmu| fmmu.encode()).as_flattened());
            self.write(place, 0x0120, &[2, 0]);
            assert_eq!(self.al(place), (2, 0), "device {place}");
        }
    }

    /// All in OP, the drives with SYNC0 half a period behind each start of one.
    fn operational(pace: Pace) -> Self {
        let mut bench = Bench::new(pace);
        bench.pre_operational();
        let start = bench.server.now().0 / 1_000_000 * 1_000_000 + 5_500_000;
        for place in 0..3 {
            if place < 2 {
                bench.write(place, 0x09a0, &1_000_000u32.to_le_bytes());
                bench.write(place, 0x0990, &start.to_le_bytes());
                bench.write(place, 0x0981, &[3]);
            }
            bench.write(place, 0x0120, &[4, 0]);
        }
        (0..10).for_each(|_| drop(bench.cycle([(0, 0); 2], 8)));
        (0..3).for_each(|place| bench.write(place, 0x0120, &[8, 0]));
        (0..10).for_each(|_| drop(bench.cycle([(0, 0); 2], 8)));
        (0..3).for_each(|place| assert_eq!(bench.al(place), (8, 0), "device {place}"));
        bench
    }

    /// One period: all outputs and all inputs in a frame. Controlword and target of both drives in, the frame as it comes back first.
    fn cycle(&mut self, orders: [(u16, i32); 2], mode: u8) -> Option<Vec<u8>> {
        self.pass(PERIOD);
        let outputs = orders.map(|(control, target)| {
            let mut outputs = [0; OUTPUTS];
            outputs[..2].copy_from_slice(&control.to_le_bytes());
            outputs[12] = mode;
            match mode {
                8 => outputs[2..6].copy_from_slice(&target.to_le_bytes()),
                9 => outputs[6..10].copy_from_slice(&target.to_le_bytes()),
                _ => outputs[10..12].copy_from_slice(&(target as i16).to_le_bytes()),
            }
            outputs
        });
        self.send(&[
            (Command::Lrd, 0x80, &[0; INPUTS]),
            (Command::Lrd, STRIDE + 0x80, &[0; INPUTS]),
            (Command::Lrd, 2 * STRIDE + 0x80, &[0; 32]),
            (Command::Lwr, 0, &outputs[0]),
            (Command::Lwr, STRIDE, &outputs[1]),
            (Command::Lwr, 2 * STRIDE, &[0; 8]),
        ]);
        self.back.first().cloned()
    }

    /// Working counters of the last cycle, of inputs and of outputs, device by device.
    fn working_counters(frame: &[u8]) -> [u16; 6] {
        let mut at = 16;
        [INPUTS, INPUTS, 32, OUTPUTS, OUTPUTS, 8].map(|len| {
            at += 10 + len + 2;
            u16_at(frame, at - 2)
        })
    }

    /// Statusword and position of a drive.
    fn drive(frame: &[u8], place: usize) -> (u16, i32) {
        let at = 26 + place * (12 + INPUTS);
        (u16_at(frame, at), i32::from_le_bytes(frame[at + 2..at + 6].try_into().unwrap()))
    }

    /// Both drives enabled in a mode, where they are; the positions.
    fn enabled(&mut self, mode: u8) -> [i32; 2] {
        let mut positions = [0; 2];
        for control in [6, 7, 15, 15] {
            for _ in 0..10 {
                let targets = if mode == 8 { positions } else { [0; 2] };
                let frame = self.cycle(targets.map(|target| (control, target)), mode).unwrap();
                positions = [0, 1].map(|place| Self::drive(&frame, place).1);
            }
        }
        assert_eq!(self.server.drive_states(), [Some(State::OperationEnabled); 2]);
        positions
    }

    fn mailbox(&mut self, place: usize, index: u16, sub: u8) -> Option<CoeAnswer> {
        let mut client = CoeClient::new(Duration::from_secs(1));
        client.start(self.now, CoeRequest::Read { at: Address::new(index, sub), complete: false }).unwrap();
        for _ in 0..50 {
            let mut out = [0; 128];
            let len = client.message(&mut out[mailbox::HEADER..]);
            if len > 0 {
                mailbox::seal(&mut out, Protocol::Coe, self.counters[place].take(), len);
                self.write(place, 0x1000, &out);
            }
            let (bytes, counter) = self.ask(Command::Aprd, Self::at(place, 0x1400), &[0; 128]);
            if counter == 1 {
                let (_, message) = mailbox::decode(&bytes).unwrap();
                if let CoeEvent::Emergency(emergency) = client.on_message(self.now, message) {
                    self.emergencies.push((place, emergency.code));
                }
            }
            if !client.is_busy() {
                return Some(client.answer().clone());
            }
        }
        None
    }

    fn inject(&mut self, injection: Injection) {
        self.server.inject(Injection { start_s: self.server.now().as_secs_f64() + 0.0005, ..injection }).unwrap();
    }
}

const FULL: [u16; 6] = [1; 6];

fn usual(kind: Kind) -> Injection {
    Injection::new(kind, 0.0)
}

#[test]
fn drives_move_the_arm_and_the_sensor_feels_the_hand() {
    for pace in [Pace::Free, Pace::Lockstep] {
        let mut bench = Bench::operational(pace);
        let begin = bench.enabled(8);
        for step in 1..=300 {
            let frame = bench.cycle(begin.map(|position| (15, position + 20 * step)), 8).unwrap();
            assert_eq!(Bench::working_counters(&frame), FULL, "{pace:?}");
        }
        let frame = bench.cycle(begin.map(|position| (15, position + 6000)), 8).unwrap();
        for (place, begin) in begin.into_iter().enumerate() {
            let moved = Bench::drive(&frame, place).1 - begin;
            assert!((5000..7000).contains(&moved), "{pace:?}: drive {place} moved by {moved} counts");
        }
        // The hand has taken the tool, and the sensor has counts of it.
        let (_, force) = bench.server.truth();
        assert!(force.0.norm() > 0.1, "{pace:?}: {force:?}");
        let at = 26 + 2 * (12 + INPUTS);
        let counts = |sub: usize| i32::from_le_bytes(frame[at + 4 * sub..at + 4 * sub + 4].try_into().unwrap());
        let felt_n = yieldwall_motion::elementary::hypot(f64::from(counts(0)), f64::from(counts(1))) * 1e-6;
        assert!((felt_n - force.0.norm()).abs() < 0.3 * force.0.norm() + 1.0, "{pace:?}: {felt_n} N of {force:?}");
    }
}

#[test]
fn the_clock_of_a_device_goes_on_while_the_computer_stands_still() {
    let mut bench = Bench::operational(Pace::Free);
    let time = |bench: &mut Bench| {
        bench.send(&[(Command::Aprd, Bench::at(0, 0x0910), &[0; 8])]);
        u64::from_le_bytes(bench.back[0][26..34].try_into().unwrap())
    };
    let before = time(&mut bench);
    // Nobody gets round to polling.
    bench.now = bench.now + Duration::from_millis(70);
    let passed_us = time(&mut bench).wrapping_sub(before) as f64 * 1e-3;
    assert!((passed_us - 70_000.0).abs() < 10.0, "{passed_us} us");
}

#[test]
fn in_lockstep_a_slow_master_loses_no_time_and_the_same_frames_give_the_same_answers() {
    let run = |pause: Duration| {
        let mut bench = Bench::operational(Pace::Lockstep);
        let mut said = Vec::new();
        for _ in 0..50 {
            bench.pass(pause);
            said.push(bench.cycle([(6, 0); 2], 8).unwrap());
        }
        (said, bench.al(0))
    };
    let quick = run(Duration::ZERO);
    // Far beyond the watchdog of 100 ms, which counts simulated time.
    assert_eq!(quick, run(Duration::from_millis(700)));
    assert_eq!(quick.1, (8, 0));
    // A master that stays away is missed after all.
    let mut bench = Bench::operational(Pace::Lockstep);
    bench.pass(Duration::from_millis(2500));
    assert_eq!(bench.al(0), (0x14, 0x1b));
}

/// A master that comes right behind another one reads the memory chips, which are busy for a while.
#[test]
fn in_lockstep_a_memory_chip_answers_right_after_a_cycle() {
    let mut bench = Bench::operational(Pace::Lockstep);
    bench.cycle([(6, 0); 2], 8).unwrap();
    bench.write(0, 0x0502, &[0, 1, 8, 0, 0, 0]);
    let is_busy = |bench: &mut Bench| bench.ask(Command::Aprd, Bench::at(0, 0x0502), &[0; 2]).0[1] & 0x80 != 0;
    let looks = (0..100).find(|_| {
        bench.pass(Duration::from_millis(1));
        !is_busy(&mut bench)
    });
    assert!(looks.is_some());
}

#[test]
fn devices_that_are_not_here_are_no_part_of_the_segment() {
    let mut bench = Bench { server: server(Pace::Free, [false, true, true]), ..Bench::new(Pace::Free) };
    assert_eq!(bench.ask(Command::Brd, 0, &[0; 2]).1, 2);
    assert_eq!(bench.server.drive_states(), [None, Some(State::SwitchOnDisabled)]);
    let left = usual(Kind::NodeSilent);
    let refused = bench.server.inject(left).unwrap_err().to_string();
    assert_eq!(refused, "node-silent: left_drive is not on this segment");
    bench.server.inject(left.on(Target::RightDrive)).unwrap();
}

#[test]
fn a_kind_that_is_for_can_is_refused_by_its_name() {
    let mut server = server(Pace::Free, [true; 3]);
    for row in &CATALOGUE {
        let refused = server.inject(usual(row.kind));
        match row.media.contains(&yieldwall_config::injection::Medium::Ethercat) {
            true if usual(row.kind).is_at_master() => {
                let refused = refused.unwrap_err().to_string();
                assert_eq!(refused, format!("{} is of the computer that runs the master, which is not here", row.name));
            }
            true => assert_eq!(refused, Ok(()), "{}", row.name),
            false => {
                let refused = refused.unwrap_err().to_string();
                assert!(refused.starts_with(&format!("{} does not exist on EtherCAT", row.name)), "{refused}");
            }
        }
    }
}

#[test]
fn frames_are_lost_late_twice_strange_short_and_changed() {
    let mut bench = Bench::operational(Pace::Free);
    let cycle = |bench: &mut Bench| bench.cycle([(0, 0); 2], 8);
    let good = cycle(&mut bench).unwrap();
    assert_eq!(Bench::working_counters(&good), FULL);

    bench.inject(usual(Kind::FrameLost).lasting(Some(0.003)));
    let seen: Vec<bool> = (0..5).map(|_| cycle(&mut bench).is_some()).collect();
    assert_eq!(seen, [false, false, false, true, true]);

    bench.inject(usual(Kind::FrameDelayed).lasting(Some(0.001)).sized(0.0003));
    assert_eq!(cycle(&mut bench), None);
    bench.pass(Duration::from_micros(299));
    assert!(bench.back.is_empty());
    bench.pass(Duration::from_micros(2));
    assert_eq!(bench.back.len(), 1);
    assert_eq!(Bench::working_counters(&bench.back[0]), FULL);
    bench.pass(PERIOD);

    bench.inject(usual(Kind::FrameDuplicated).lasting(Some(0.001)));
    let frame = cycle(&mut bench).unwrap();
    assert_eq!(bench.back, [frame.clone(), frame]);

    bench.inject(usual(Kind::FrameForeign).lasting(Some(0.001)));
    let stranger = cycle(&mut bench).unwrap();
    // Of another sender, with one NOP of another number that nobody has processed.
    assert_eq!(bench.back.len(), 2);
    assert_eq!(stranger[6..14], [0x02, 0, 0, 0, 0, 0x99, 0x88, 0xa4]);
    assert_eq!(stranger[16..18], [0x00, 0xee]);
    assert_eq!(Bench::working_counters(&bench.back[1]), FULL);

    bench.inject(usual(Kind::FrameShort).lasting(Some(0.001)));
    assert_eq!(cycle(&mut bench).unwrap().len(), good.len() - 1);

    bench.pass(PERIOD);
    assert_eq!(Bench::working_counters(&cycle(&mut bench).unwrap()), FULL);

    // The same once more with it and without.
    let [clean, flipped] = [0.0, 3.0].map(|bits| {
        let mut bench = Bench::operational(Pace::Free);
        if bits > 0.0 {
            bench.inject(usual(Kind::FrameCorrupt).lasting(Some(0.001)).sized(bits));
        }
        cycle(&mut bench).unwrap()
    });
    let differ: u32 = clean.iter().zip(&flipped).map(|(one, other)| (one ^ other).count_ones()).sum();
    assert_eq!((differ, &clean[..16]), (3, &flipped[..16]));
}

#[test]
fn a_device_is_bypassed_gone_and_back_or_behind_a_cable_that_is_out() {
    let mut bench = Bench::operational(Pace::Free);
    let cycle = |bench: &mut Bench| bench.cycle([(0, 0); 2], 8).map(|frame| Bench::working_counters(&frame));
    assert_eq!(cycle(&mut bench), Some(FULL));

    bench.inject(usual(Kind::DeviceBypassed).on(Target::RightDrive).lasting(Some(0.002)));
    assert_eq!(cycle(&mut bench), Some([1, 0, 1, 1, 0, 1]));
    cycle(&mut bench);
    assert_eq!(cycle(&mut bench), Some(FULL));

    bench.inject(usual(Kind::CableOut).on(Target::Sensor).lasting(Some(0.002)));
    assert_eq!(cycle(&mut bench), Some([1, 1, 0, 1, 1, 0]));
    cycle(&mut bench);
    assert_eq!(cycle(&mut bench), Some(FULL));
    // The drive before it has lost the link of its port 1 once.
    assert_eq!(bench.ask(Command::Aprd, Bench::at(1, 0x0311), &[0]).0, [1]);

    bench.inject(usual(Kind::CableOut).lasting(Some(0.002)));
    assert_eq!(cycle(&mut bench), None);
    cycle(&mut bench);
    assert_eq!(cycle(&mut bench), Some(FULL));

    // Without supply the line ends before it; back, it is in INIT and knows nothing.
    bench.inject(usual(Kind::NodeSilent).on(Target::RightDrive).lasting(Some(0.002)));
    assert_eq!(cycle(&mut bench), Some([1, 0, 0, 1, 0, 0]));
    cycle(&mut bench);
    assert_eq!(cycle(&mut bench), Some([1, 0, 1, 1, 0, 1]));
    assert_eq!((bench.al(0), bench.al(1), bench.al(2)), ((8, 0), (1, 0), (8, 0)));
}

#[test]
fn the_mailbox_is_stuck_or_an_emergency_comes_before_the_answer() {
    let mut bench = Bench::new(Pace::Free);
    bench.pre_operational();
    let vendor = CoeAnswer::Value(0x0000_0732u32.to_le_bytes().to_vec());
    assert_eq!(bench.mailbox(2, 0x1018, 1), Some(vendor.clone()));

    bench.inject(usual(Kind::MailboxStuck).on(Target::Sensor).lasting(Some(0.01)));
    bench.pass(PERIOD);
    assert_eq!(bench.mailbox(2, 0x1018, 1), None);
    bench.pass(Duration::from_millis(10));
    // The answer to what was asked then comes first.
    let (bytes, counter) = bench.ask(Command::Aprd, Bench::at(2, 0x1400), &[0; 128]);
    assert_eq!((counter, &bytes[6..16]), (1, &[0x00, 0x30, 0x43, 0x18, 0x10, 0x01, 0x32, 0x07, 0, 0][..]));
    assert_eq!(bench.mailbox(2, 0x1018, 1), Some(vendor));

    bench.inject(usual(Kind::EmergencyInSdo).on(Target::RightDrive));
    bench.pass(PERIOD);
    assert!(matches!(bench.mailbox(1, 0x1018, 1), Some(CoeAnswer::Value(_))));
    assert_eq!(bench.emergencies, [(1, 0x3210)]);

    bench.inject(usual(Kind::Emergency).on(Target::LeftDrive));
    bench.pass(PERIOD);
    assert!(matches!(bench.mailbox(0, 0x1018, 1), Some(CoeAnswer::Value(_))));
    assert_eq!(bench.emergencies, [(1, 0x3210), (0, 0x3210)]);
}

#[test]
fn a_device_leaves_op_with_an_error_or_its_clock_jumps() {
    let mut bench = Bench::operational(Pace::Free);
    let positions = bench.enabled(8);
    bench.inject(usual(Kind::DeviceState).on(Target::LeftDrive));
    let frame = bench.cycle(positions.map(|position| (15, position)), 8).unwrap();
    // It takes no outputs until the error is acknowledged, and its inputs go on.
    assert_eq!(Bench::working_counters(&frame), [1, 1, 1, 0, 1, 1]);
    assert_eq!((bench.al(0), bench.al(1)), ((0x14, 0x1a), (8, 0)));
    assert_ne!(bench.server.drive_states()[0], Some(State::OperationEnabled));
    bench.write(0, 0x0120, &[0x14, 0]);
    assert_eq!(bench.al(0), (4, 0));

    let time = |bench: &mut Bench| {
        let (data, _) = bench.ask(Command::Aprd, Bench::at(1, 0x0910), &[0; 8]);
        i64::from_le_bytes(data.try_into().unwrap()) - bench.server.now().0 as i64
    };
    let before = time(&mut bench);
    bench.inject(usual(Kind::ClockJump).on(Target::RightDrive).sized(-250_000.0));
    bench.pass(PERIOD);
    let jumped = time(&mut bench) - before;
    // Its drift of 23 ppm in 1 ms beside it.
    assert!((-250_200..=-249_800).contains(&jumped), "{jumped} ns");
}

#[test]
fn drives_and_sensor_are_in_fault_warned_without_voltage_and_invalid() {
    let mut bench = Bench::operational(Pace::Free);
    let status = |bench: &mut Bench| {
        let frame = bench.cycle([(15, 0); 2], 10).unwrap();
        [0, 1].map(|place| Bench::drive(&frame, place).0)
    };
    bench.enabled(10);
    bench.inject(usual(Kind::DriveWarning).on(Target::RightDrive).lasting(Some(0.002)));
    status(&mut bench);
    assert_eq!(status(&mut bench).map(|word| word & 0x80), [0, 0x80]);
    bench.pass(PERIOD);
    status(&mut bench);
    assert_eq!(status(&mut bench).map(|word| word & 0x80), [0, 0]);

    bench.inject(usual(Kind::DriveFault).on(Target::LeftDrive));
    for _ in 0..300 {
        status(&mut bench);
    }
    assert_eq!(status(&mut bench)[0] & 0x4f, 0x08, "fault");

    bench.inject(usual(Kind::SensorInvalid).lasting(Some(0.002)));
    bench.cycle([(0, 0); 2], 10);
    let frame = bench.cycle([(0, 0); 2], 10).unwrap();
    let at = 26 + 2 * (12 + INPUTS) + 24;
    // The first of the bits by which its profile shows it.
    assert_eq!(frame[at..at + 4], [0x04, 0, 0, 0]);
}

/// The datagrams of a frame that write: command, address, data, working counter.
fn written(frame: &[u8]) -> Vec<(u8, u32, Vec<u8>, u16)> {
    let all = Datagrams::of(frame).unwrap().map(Result::unwrap);
    let writes = all.filter(|datagram| [Command::Lwr as u8, Command::Apwr as u8].contains(&datagram.header.command));
    writes.map(|of| (of.header.command, of.header.address, of.data.to_vec(), of.working_counter)).collect()
}

#[test]
fn a_foreign_node_sends_behind_outputs_with_the_source_of_the_master() {
    let mut bench = Bench::operational(Pace::Free);
    let cycle = |bench: &mut Bench, target: i32| {
        bench.cycle([(0, target); 2], 8).unwrap();
        bench.back.clone()
    };
    let good = cycle(&mut bench, 100);
    assert_eq!(good.len(), 1);

    bench.inject(usual(Kind::ForeignOutputs).lasting(Some(0.001)));
    let [own, forged]: [Vec<u8>; 2] = cycle(&mut bench, 100).try_into().unwrap();
    assert_eq!((written(&own), &own[..16]), (written(&good[0]), &forged[..16]), "it is the master's, and behind it");
    for (own, forged) in written(&own).iter().zip(written(&forged)).take(2) {
        let target = |data: &[u8]| i32::from_le_bytes(data[2..6].try_into().unwrap());
        assert_eq!((own.0, own.1, &own.2[..2], own.3), (forged.0, forged.1, &forged.2[..2], forged.3));
        assert_eq!(target(&forged.2), target(&own.2) + 131_072);
    }

    (0..KEPT).for_each(|_| drop(cycle(&mut bench, 100)));
    bench.inject(usual(Kind::ReplayedOutputs).lasting(Some(0.002)));
    for target in [200, 300] {
        let [own, replayed]: [Vec<u8>; 2] = cycle(&mut bench, target).try_into().unwrap();
        assert_eq!(written(&own)[0].2[2..6], target.to_le_bytes());
        assert_eq!(written(&replayed), written(&good[0]), "an earlier one");
    }
    assert_eq!(cycle(&mut bench, 400).len(), 1, "it is over");

    let registers = [(0x0420u16, 0x0000u16), (0x0400, 0xffff), (0x0010, 0x1fff)];
    for (number, (register, value)) in (0..).zip(registers) {
        let what = format!("{register:04x}h");
        bench.inject(usual(Kind::ForeignRegisterWrite).lasting(Some(0.001)).sized(f64::from(number)));
        let [own, write]: [Vec<u8>; 2] = cycle(&mut bench, 0).try_into().unwrap();
        assert_eq!(write[6..12], own[6..12], "{what}");
        let (command, address, data, counter) = written(&write).remove(0);
        let expected = (Command::Apwr as u8, register, value.to_le_bytes().to_vec(), 1);
        assert_eq!((command, (address >> 16) as u16, data, counter), expected, "{what}");

        bench.inject(usual(Kind::HiddenRegisterWrite).on(Target::RightDrive).sized(f64::from(number)));
        assert_eq!(cycle(&mut bench, 0).len(), 1, "{what}: the master hears nothing of it");
        assert_eq!(bench.ask(Command::Aprd, Bench::at(1, register), &[0; 2]).0, value.to_le_bytes(), "{what}");
    }
}
