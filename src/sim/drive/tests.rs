//! The drive as a master sees it: frames in, frames out, and a joint behind it.

use std::time::Duration;
use yieldwall_motion::elementary;

use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::profiles::Pdo;
use yieldwall_drives::scaling::{AxisScaling, Direction};

use super::super::device::mapping;
use super::*;
use yieldwall_config::shipped_profile;
use yieldwall_fieldbus::canopen::{MappingEntry, node_id};

const NODE: u8 = 1;
const CYCLE: Duration = Duration::from_micros(1000);
const COUNTS_PER_REV: f64 = 800_000.0;
const INERTIA_KG_M2: f64 = 0.25;

fn settings(direction: Direction) -> DriveSettings {
    DriveSettings {
        node: node_id(NODE).unwrap(),
        profile: shipped_profile("simulated-servo"),
        serial: 4711,
        scaling: AxisScaling::new(COUNTS_PER_REV, direction, 0.0, 60.0).unwrap(),
        position_loop: PositionLoop {
            period_us: 125,
            stiffness_n_m_per_rad: 20_000.0,
            damping_n_m_s_per_rad: 150.0,
            integral_n_m_per_rad_s: 200_000.0,
        },
        encoder: Encoder::Quantised,
        manner: DriveQuirks::default(),
    }
}

/// A drive on a free inertia, a clock, and what the drive has sent.
struct Bench {
    drive: Drive,
    now: Time,
    angle: f64,
    rate: f64,
    sent: Vec<Frame>,
}

impl Bench {
    fn with(settings: DriveSettings) -> Self {
        let drive = Drive::new(settings).unwrap();
        let mut bench = Bench { drive, now: Time(0), angle: 0.0, rate: 0.0, sent: Vec::new() };
        bench.drive.boot(bench.now, &mut bench.sent);
        assert_eq!(bench.take_sent(0x701), [Frame::new(0x701, &[0])]);
        bench
    }

    /// In Operational with the PDOs of `mode`, Switch On Disabled.
    fn configured(mode: OperationMode) -> Self {
        let mut bench = Self::with(settings(Direction::Same));
        bench.configure(mode);
        bench
    }

    /// In Operation Enabled.
    fn enabled(mode: OperationMode) -> Self {
        let mut bench = Self::configured(mode);
        bench.enable();
        bench
    }

    fn configure(&mut self, mode: OperationMode) {
        let profile = shipped_profile("simulated-servo");
        let pdos = profile.pdos(Some(mode)).unwrap();
        let raw = |pdo: &Pdo| -> Vec<u32> {
            let entries = mapping(&profile, pdo).into_iter();
            entries.map(|(index, sub, bits)| MappingEntry::new(index, sub, bits).to_u32()).collect()
        };
        self.remap(0x1400, 0x201, &raw(&pdos.rpdo[0]));
        self.remap(0x1800, 0x181, &raw(&pdos.tpdo[0]));
        self.write(0x6060, 0, &[mode.code() as u8]);
        self.send(Frame::new(0x000, &[0x01, NODE]));
    }

    fn remap(&mut self, parameter: u16, id: u32, entries: &[u32]) {
        let map = parameter + 0x200;
        self.write(parameter, 1, &(id | 1 << 31).to_le_bytes());
        self.write(map, 0, &[0]);
        for (sub, entry) in (1..).zip(entries) {
            self.write(map, sub, &entry.to_le_bytes());
        }
        self.write(map, 0, &[entries.len() as u8]);
        self.write(parameter, 2, &[1]);
        self.write(parameter, 1, &id.to_le_bytes());
        for (sub, entry) in (1..).zip(entries) {
            assert_eq!(self.read(map, sub), *entry);
        }
    }

    fn enable(&mut self) {
        let target = self.position();
        for controlword in [0x06, 0x07, 0x0f] {
            self.cycle(controlword, target);
        }
        assert_eq!(self.cycle(0x0f, target).0 & 0x6f, 0x27);
    }

    /// The position target that keeps the joint where it is, or no torque or velocity.
    fn position(&mut self) -> i32 {
        if self.read(0x6061, 0) == 8 { self.read(0x6064, 0) as i32 } else { 0 }
    }

    fn advance(&mut self, until: Time) {
        while self.now < until {
            let next = self.drive.next_deadline().min(until);
            let seconds = next.since(self.now).as_secs_f64();
            let acceleration = self.drive.torque_n_m() / INERTIA_KG_M2;
            self.angle += self.rate * seconds + 0.5 * acceleration * seconds * seconds;
            self.rate += acceleration * seconds;
            self.now = self.now.max(next);
            self.drive.measure(self.angle, self.rate);
            self.drive.poll(self.now, &mut self.sent);
        }
    }

    fn wait(&mut self, time: Duration) {
        self.advance(self.now + time);
    }

    fn send(&mut self, frame: Frame) {
        self.drive.measure(self.angle, self.rate);
        self.drive.on_frame(self.now, &frame, &mut self.sent);
    }

    /// SYNC, the TPDO that answers it, then the RPDO for the next SYNC in the middle of the cycle.
    fn cycle(&mut self, controlword: u16, target: i32) -> (u16, i32) {
        self.send(Frame::new(0x080, &[]));
        let answer = self.take_sent(0x181);
        assert_eq!(answer.len(), 1, "one TPDO per SYNC");
        self.wait(CYCLE / 2);
        self.send_setpoint(controlword, target);
        self.wait(CYCLE / 2);
        let data = answer[0].bytes();
        assert_eq!(answer[0].len(), 6);
        (u16::from_le_bytes([data[0], data[1]]), i32::from_le_bytes([data[2], data[3], data[4], data[5]]))
    }

    fn send_setpoint(&mut self, controlword: u16, target: i32) {
        let mut data = controlword.to_le_bytes().to_vec();
        let is_torque = self.read(0x1600, 2) == 0x6071_0010;
        data.extend(&target.to_le_bytes()[..if is_torque { 2 } else { 4 }]);
        self.send(Frame::new(0x201, &data));
    }

    fn take_sent(&mut self, id: u16) -> Vec<Frame> {
        let (taken, kept) = self.sent.drain(..).partition(|frame| frame.id() == id);
        self.sent = kept;
        taken
    }

    fn request(&mut self, data: [u8; 8]) -> [u8; 8] {
        self.send(Frame::new(0x601, &data));
        let answer = self.take_sent(0x581);
        assert_eq!(answer.len(), 1, "request {data:02x?}");
        *answer[0].bytes()
    }

    fn try_write(&mut self, index: u16, sub: u8, value: &[u8]) -> [u8; 8] {
        let [low, high] = index.to_le_bytes();
        let mut data = [0x23 | (4 - value.len() as u8) << 2, low, high, sub, 0, 0, 0, 0];
        data[4..4 + value.len()].copy_from_slice(value);
        self.request(data)
    }

    fn write(&mut self, index: u16, sub: u8, value: &[u8]) {
        let answer = self.try_write(index, sub, value);
        assert_eq!(answer[0], 0x60, "{index:04x}:{sub} refused with {answer:02x?}");
    }

    fn read(&mut self, index: u16, sub: u8) -> u32 {
        let [low, high] = index.to_le_bytes();
        let answer = self.request([0x40, low, high, sub, 0, 0, 0, 0]);
        assert_eq!(answer[0] & 0xe3, 0x43, "{index:04x}:{sub} refused with {answer:02x?}");
        u32::from_le_bytes([answer[4], answer[5], answer[6], answer[7]])
    }
}

#[test]
fn identity_and_supported_modes_are_those_of_the_profile() {
    let mut bench = Bench::with(settings(Direction::Same));
    let read = [1, 2, 3, 4].map(|sub| bench.read(0x1018, sub));
    assert_eq!(read, [0xffff_5957, 0x402, 0x0001_0000, 4711]);
    assert_eq!(bench.read(0x1000, 0), 0x0002_0192);
    assert_eq!(bench.read(0x6502, 0), 0x0000_03a0);
    assert_eq!(bench.read(0x6076, 0), 60_000);
    assert_eq!(bench.read(0x608f, 1), 800_000);
}

#[test]
fn unsupported_modes_are_refused_and_the_display_follows_supported_ones() {
    let mut bench = Bench::with(settings(Direction::Same));
    assert_eq!(bench.try_write(0x6060, 0, &[1]), [0x80, 0x60, 0x60, 0, 0x30, 0x00, 0x09, 0x06]);
    assert_eq!(bench.read(0x6061, 0), 0);
    for code in [8, 9, 10] {
        bench.write(0x6060, 0, &[code]);
        assert_eq!(bench.read(0x6061, 0), u32::from(code));
    }
}

#[test]
fn the_walk_up_is_seen_in_the_statusword_one_cycle_later() {
    let mut bench = Bench::configured(OperationMode::CyclicTorque);
    let states: Vec<u16> = [0x06, 0x07, 0x0f, 0x0f, 0x0f].map(|word| bench.cycle(word, 0).0).to_vec();
    assert_eq!(states, [0x0250, 0x0231, 0x0233, 0x1237, 0x1237]);
}

#[test]
fn the_torque_is_taken_over_at_sync_and_held() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.send_setpoint(0x0f, 100);
    assert_eq!(bench.drive.torque_n_m(), 0.0);
    bench.send(Frame::new(0x080, &[]));
    assert_eq!(bench.drive.torque_n_m(), 6.0);
    bench.wait(CYCLE * 2);
    assert_eq!(bench.drive.torque_n_m(), 6.0);
    assert_eq!(bench.read(0x6077, 0) as u16, 100);
    assert!((bench.rate - 6.0 / INERTIA_KG_M2 * 2e-3).abs() < 1e-12);
}

#[test]
fn a_reversed_axis_turns_counts_and_torque() {
    let mut bench = Bench::with(settings(Direction::Reversed));
    bench.configure(OperationMode::CyclicTorque);
    bench.enable();
    bench.send_setpoint(0x0f, 100);
    bench.send(Frame::new(0x080, &[]));
    assert_eq!(bench.drive.torque_n_m(), -6.0);
    bench.wait(CYCLE * 4);
    assert!(bench.angle < 0.0);
    assert!(bench.read(0x6064, 0) as i32 > 0);
    assert!(bench.read(0x606c, 0) as i32 > 0);
}

#[test]
fn the_torque_limit_cuts_off_and_shows() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.write(0x6072, 0, &50u16.to_le_bytes());
    bench.cycle(0x0f, 100);
    bench.cycle(0x0f, -100);
    assert_eq!(bench.drive.torque_n_m(), 3.0);
    assert_eq!(bench.cycle(0x0f, 0).0 & 0x0800, 0x0800);
    assert_eq!(bench.drive.torque_n_m(), -3.0);
    bench.cycle(0x0f, 0);
    assert_eq!(bench.cycle(0x0f, 0).0 & 0x0800, 0);
}

/// Above its speed limit the motor is not driven on; it may be braked, and pushed from without.
#[test]
fn above_its_speed_limit_a_motor_is_only_braked() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    // 60 r/min are 6.28 rad/s.
    bench.write(0x6080, 0, &60u32.to_le_bytes());
    let drive = |bench: &mut Bench, per_mille: i16, rate_rad_per_s: f64| {
        bench.rate = rate_rad_per_s;
        bench.cycle(0x0f, per_mille.into());
        bench.rate = rate_rad_per_s;
        bench.cycle(0x0f, per_mille.into());
        bench.drive.torque_n_m()
    };
    let free = drive(&mut bench, 50, 6.2);
    assert!(free.abs() > 1.0, "{free}");
    let direction = free.signum();
    assert_eq!(drive(&mut bench, 50, 6.4 * direction), 0.0);
    assert_eq!(drive(&mut bench, -50, 6.4 * direction), -free);
    assert_eq!(drive(&mut bench, -50, -6.4 * direction), 0.0);
    assert_eq!(drive(&mut bench, 50, -6.4 * direction), free);
}

#[test]
fn a_position_target_is_followed_along_a_sine() {
    let mut bench = Bench::enabled(OperationMode::CyclicPosition);
    // 0.2 rad at 1 Hz: 1.26 rad/s, 7.9 rad/s^2.
    let sine = |cycle: i32| 0.2 * (1.0 - elementary::cos(std::f64::consts::TAU * f64::from(cycle) * 1e-3));
    let counts = |angle: f64| (angle / std::f64::consts::TAU * COUNTS_PER_REV).round() as i32;
    let mut worst = 0.0f64;
    for cycle in 0..1000 {
        let (status, position) = bench.cycle(0x0f, counts(sine(cycle)));
        assert_eq!(status & 0x306f, 0x1027, "bit 13 at cycle {cycle}");
        // Sent in cycle k, latched at k + 1, reached at k + 2: the TPDO of cycle k shows target k - 2.
        worst = worst.max(f64::from((position - counts(sine((cycle - 2).max(0)))).abs()));
    }
    // The acceleration is not fed forward: 0.25 kg m^2 * 7.9 rad/s^2 / 20000 N m/rad is 0.1 mrad, 12.6 counts.
    assert!(worst < 15.0, "worst following error {worst} counts");
    assert!(worst > 1.0, "a loop without acceleration feed-forward cannot be that good: {worst}");
}

#[test]
fn an_exact_encoder_sees_between_counts_and_a_quantised_one_does_not() {
    let coarse = AxisScaling::new(1000.0, Direction::Same, 0.0, 60.0).unwrap();
    for (encoder, expected) in [(Encoder::Exact, -20.0), (Encoder::Quantised, 0.0)] {
        let mut bench = Bench::with(DriveSettings { encoder, scaling: coarse, ..settings(Direction::Same) });
        bench.configure(OperationMode::CyclicPosition);
        bench.enable();
        // 1 mrad is less than half a count of 6.3 mrad.
        (bench.angle, bench.rate) = (1e-3, 0.0);
        bench.send(Frame::new(0x080, &[]));
        let torque = bench.drive.torque_n_m();
        assert!((torque - expected).abs() < 0.1, "{encoder:?}: {torque} N m");
    }
}

#[test]
fn a_velocity_target_is_reached() {
    let mut bench = Bench::enabled(OperationMode::CyclicVelocity);
    for _ in 0..300 {
        bench.cycle(0x0f, 100_000);
    }
    assert!((bench.rate - 100_000.0 / COUNTS_PER_REV * std::f64::consts::TAU).abs() < 1e-3, "{}", bench.rate);
}

#[test]
fn a_position_near_the_wrap_is_followed_across_it() {
    let across = f64::from(i32::MAX) / COUNTS_PER_REV * std::f64::consts::TAU;
    let mut bench = Bench::with(settings(Direction::Same));
    (bench.angle, bench.rate) = (across - 1e-3, 0.0);
    bench.configure(OperationMode::CyclicPosition);
    bench.enable();
    let start = bench.position();
    for step in 0..200 {
        bench.cycle(0x0f, start.wrapping_add(2 * step));
    }
    let (status, position) = bench.cycle(0x0f, start.wrapping_add(400));
    assert_eq!(status & 0x6f, 0x27);
    assert!(position < 0 && bench.angle > across, "{position} {}", bench.angle - across);
}

#[test]
fn a_following_error_is_a_fault_with_its_code_and_needs_an_edge() {
    let mut bench = Bench::enabled(OperationMode::CyclicPosition);
    bench.write(0x6065, 0, &1000u32.to_le_bytes());
    bench.write(0x6066, 0, &3u16.to_le_bytes());
    let far = 500_000;
    let mut seen = Vec::new();
    for _ in 0..10 {
        seen.push(bench.cycle(0x0f, far).0);
    }
    assert!(seen.iter().any(|status| status & 0x206f == 0x2027), "bit 13 while enabled: {seen:04x?}");
    let emergencies = bench.take_sent(0x081);
    assert_eq!(emergencies.len(), 1);
    assert_eq!(emergencies[0].bytes()[..3], [0x11, 0x86, 0x21]);
    for _ in 0..300 {
        bench.cycle(0x0f, far);
    }
    assert_eq!(bench.cycle(0x0f, far).0 & 0x4f, 0x08);
    assert_eq!(bench.drive.torque_n_m(), 0.0);
    assert_eq!(bench.read(0x603f, 0), 0x8611);
    for _ in 0..20 {
        bench.cycle(0x0f, far);
    }
    assert_eq!(bench.cycle(0x80, far).0 & 0x4f, 0x08, "no reset without the edge");
    bench.cycle(0x80, far);
    assert_eq!(bench.cycle(0x80, far).0 & 0x4f, 0x40);
    assert_eq!(bench.read(0x603f, 0), 0);
    assert_eq!(bench.take_sent(0x081).last().map(|frame| frame.bytes()[..3].to_vec()), Some(vec![0, 0, 0]));
}

#[test]
fn a_quick_stop_brakes_on_its_ramp_and_leaves_the_drive_disabled() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    for _ in 0..20 {
        bench.cycle(0x0f, 1000);
    }
    bench.cycle(0x02, 0);
    let (speed, start) = (bench.rate, bench.now);
    assert!(speed > 4.0, "{speed}");
    for _ in 0..20 {
        assert_eq!(bench.cycle(0x02, 0).0 & 0x6f, 0x07);
    }
    // 6085h at power-on is 100 rad/s^2; the loop lags the ramp by what its damping needs for 25 N m.
    let braked = speed - 100.0 * bench.now.since(start).as_secs_f64();
    assert!((bench.rate - braked).abs() < 25.0 / 150.0, "{} instead of {braked}", bench.rate);
    let settled = (0..200).take_while(|_| bench.cycle(0x02, 0).0 & 0x6f != 0x40).count();
    assert!((20..70).contains(&settled), "{settled} cycles");
    assert!(bench.rate.abs() < 0.02, "{}", bench.rate);
    assert_eq!(bench.drive.torque_n_m(), 0.0);
}

#[test]
fn a_quick_stop_with_option_6_holds_the_joint() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.write(0x605a, 0, &6i16.to_le_bytes());
    for _ in 0..10 {
        bench.cycle(0x0f, 1000);
    }
    for _ in 0..200 {
        bench.cycle(0x02, 0);
    }
    assert_eq!(bench.cycle(0x02, 0).0 & 0x046f, 0x0407, "standstill shows in bit 10");
    bench.rate = 0.5;
    for _ in 0..300 {
        bench.cycle(0x02, 0);
    }
    assert!(bench.rate.abs() < 1e-3, "pushed and held, {}", bench.rate);
}

#[test]
fn a_lost_heartbeat_has_the_reaction_of_6007h() {
    for (option, expected) in [(1i16, 0x08), (2, 0x40), (3, 0x40)] {
        let mut bench = Bench::with(settings(Direction::Same));
        bench.write(0x1016, 1, &(127u32 << 16 | 20).to_le_bytes());
        bench.write(0x1029, 1, &[1]);
        bench.write(0x6007, 0, &option.to_le_bytes());
        bench.configure(OperationMode::CyclicTorque);
        bench.enable();
        for _ in 0..50 {
            bench.cycle(0x0f, 100);
            bench.send(Frame::new(0x77f, &[0x05]));
        }
        assert_eq!(bench.cycle(0x0f, 100).0 & 0x6f, 0x27, "option {option}");
        for _ in 0..19 {
            bench.cycle(0x0f, 100);
        }
        let emergencies = bench.take_sent(0x081);
        assert_eq!(emergencies[0].bytes()[..2], [0x30, 0x81]);
        for _ in 0..200 {
            bench.cycle(0x0f, 100);
        }
        assert_eq!(bench.cycle(0x0f, 100).0 & 0x4f, expected, "option {option}");
        assert_eq!(bench.drive.torque_n_m(), 0.0);
        assert!(option == 2 || bench.rate.abs() < 0.02, "option {option} leaves {}", bench.rate);
    }
}

#[test]
fn rpdos_that_stay_away_are_a_fault() {
    let mut bench = Bench::with(settings(Direction::Same));
    bench.write(0x1400, 5, &10u16.to_le_bytes());
    bench.configure(OperationMode::CyclicTorque);
    bench.enable();
    for _ in 0..300 {
        bench.send(Frame::new(0x080, &[]));
        bench.wait(CYCLE);
    }
    assert_eq!(bench.take_sent(0x081).first().map(|frame| frame.bytes()[..2].to_vec()), Some(vec![0x50, 0x82]));
    let last = *bench.take_sent(0x181).last().unwrap();
    assert_eq!(last.bytes()[0] & 0x4f, 0x08);
    assert_eq!(bench.read(0x603f, 0), 0x8250);
}

#[test]
fn a_lost_sync_is_a_fault_after_five_periods() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.cycle(0x0f, 100);
    bench.send(Frame::new(0x080, &[]));
    bench.wait(Duration::from_micros(4999));
    assert_eq!((bench.drive.torque_n_m(), bench.drive.state()), (6.0, State::OperationEnabled));
    bench.wait(Duration::from_micros(1));
    assert_eq!(bench.take_sent(0x081)[0].bytes()[..2], [0x00, 0x87]);
    bench.wait(Duration::from_millis(200));
    assert_eq!(bench.read(0x6041, 0) & 0x4f, 0x08);
    assert!(bench.rate.abs() < 0.02);
}

#[test]
fn leaving_operational_stops_the_drive() {
    let mut bench = Bench::enabled(OperationMode::CyclicPosition);
    bench.send(Frame::new(0x000, &[0x80, NODE]));
    bench.wait(Duration::from_millis(5));
    assert_eq!(bench.read(0x6041, 0) & 0x6f, 0x40);
}

#[test]
fn a_node_reset_takes_the_torque_away_and_boots() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.cycle(0x0f, 100);
    bench.cycle(0x0f, 100);
    assert_eq!(bench.drive.torque_n_m(), 6.0);
    bench.send(Frame::new(0x000, &[0x81, NODE]));
    assert_eq!(bench.take_sent(0x701), [Frame::new(0x701, &[0])]);
    assert_eq!(bench.drive.torque_n_m(), 0.0);
    assert_eq!(bench.read(0x6041, 0) & 0x4f, 0x40);
    assert_eq!(bench.read(0x6060, 0), 0);
}

#[test]
fn without_voltage_there_is_no_torque_and_bit_4_is_low() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.cycle(0x0f, 100);
    bench.cycle(0x0f, 100);
    bench.drive.set_voltage(bench.now, false, &mut bench.sent);
    assert_eq!(bench.drive.torque_n_m(), 0.0);
    assert_eq!(bench.cycle(0x0f, 100).0 & 0x7f, 0x40);
    for word in [0x06, 0x07, 0x0f, 0x0f] {
        bench.cycle(word, 100);
    }
    assert_eq!(bench.drive.torque_n_m(), 0.0);
    bench.drive.set_voltage(bench.now, true, &mut bench.sent);
    bench.enable();
}

#[test]
fn a_drive_fault_and_a_warning_show() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.drive.set_warning(true);
    assert_eq!(bench.cycle(0x0f, 0).0 & 0x80, 0x80);
    bench.drive.raise_fault(bench.now, 0x4310, &mut bench.sent);
    assert_eq!(bench.take_sent(0x081)[0].bytes()[..2], [0x10, 0x43]);
    bench.wait(Duration::from_millis(1));
    assert_eq!(bench.cycle(0x0f, 0).0 & 0x4f, 0x08);
}

#[test]
fn an_encoder_that_gives_no_number_is_a_fault_without_torque() {
    let mut bench = Bench::enabled(OperationMode::CyclicPosition);
    bench.drive.measure(f64::NAN, 0.0);
    bench.drive.on_frame(bench.now, &Frame::new(0x080, &[]), &mut bench.sent);
    assert_eq!(bench.drive.state(), State::Fault);
    assert_eq!(bench.drive.torque_n_m(), 0.0);
    assert_eq!(bench.take_sent(0x081)[0].bytes()[..2], [0x05, 0x73]);
}

#[test]
fn a_mode_change_waits_until_the_drive_is_not_enabled() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.write(0x6060, 0, &[8]);
    assert_eq!(bench.read(0x6061, 0), 10);
    bench.cycle(0x00, 0);
    bench.cycle(0x00, 0);
    assert_eq!(bench.read(0x6061, 0), 8);
}

#[test]
fn an_event_driven_statusword_is_sent_when_it_changes() {
    let mut bench = Bench::with(settings(Direction::Same));
    bench.send(Frame::new(0x000, &[0x01, NODE]));
    bench.take_sent(0x181);
    bench.send(Frame::new(0x201, &[0x06, 0x00]));
    assert_eq!(bench.take_sent(0x181), [Frame::new(0x181, &[0x31, 0x02])]);
    bench.send(Frame::new(0x201, &[0x06, 0x00]));
    assert_eq!(bench.take_sent(0x181), []);
}

#[test]
fn a_drive_that_is_off_is_silent() {
    let mut bench = Bench::enabled(OperationMode::CyclicTorque);
    bench.cycle(0x0f, 100);
    bench.cycle(0x0f, 100);
    bench.drive.switch_off();
    bench.send(Frame::new(0x080, &[]));
    bench.wait(Duration::from_millis(100));
    assert_eq!((bench.sent.len(), bench.drive.torque_n_m(), bench.drive.next_deadline()), (0, 0.0, Time::NEVER));
}

#[test]
fn bad_settings_are_refused() {
    let good = settings(Direction::Same);
    let role =
        Drive::new(DriveSettings { profile: shipped_profile("simulated-force-sensor"), ..good.clone() }).unwrap_err();
    assert!(matches!(role, DeviceError::Role { wanted: "servo drive", .. }));
    for position_loop in [
        PositionLoop { period_us: 0, ..good.position_loop },
        PositionLoop { stiffness_n_m_per_rad: 0.0, ..good.position_loop },
        PositionLoop { damping_n_m_s_per_rad: -1.0, ..good.position_loop },
        PositionLoop { integral_n_m_per_rad_s: f64::NAN, ..good.position_loop },
    ] {
        assert!(matches!(
            Drive::new(DriveSettings { position_loop, ..good.clone() }),
            Err(DeviceError::Setting { .. })
        ));
    }
}

#[test]
fn a_server_of_its_own_manner_sends_segments_alone_and_other_lengths() {
    let lengths = vec![(Address::new(0x60c2, 2), 2), (Address::new(0x6041, 0), 8), (Address::new(0x6065, 0), 1)];
    let manner = DriveQuirks { segments_only: true, lengths: lengths.clone(), ..DriveQuirks::default() };
    let mut bench = Bench::with(DriveSettings { manner, ..settings(Direction::Same) });
    // 1000h: four bytes, of which an initiate frame tells the number alone.
    assert_eq!(bench.request([0x40, 0x00, 0x10, 0, 0, 0, 0, 0]), [0x41, 0x00, 0x10, 0, 4, 0, 0, 0]);
    assert_eq!(bench.request([0x60, 0, 0, 0, 0, 0, 0, 0]), [0x07, 0x92, 0x01, 0x02, 0x00, 0, 0, 0]);
    // -3 in one byte is sent in two, and taken in one.
    assert_eq!(bench.request([0x40, 0xc2, 0x60, 2, 0, 0, 0, 0]), [0x41, 0xc2, 0x60, 2, 2, 0, 0, 0]);
    assert_eq!(bench.request([0x60, 0, 0, 0, 0, 0, 0, 0]), [0x0b, 0xfd, 0xff, 0, 0, 0, 0, 0]);
    bench.write(0x60c2, 2, &[0xfc]);
    // No blocks in either direction: 05040001h.
    for first in [[0xa4, 0x00, 0x10, 0, 127, 0, 0, 0], [0xc6, 0x65, 0x60, 0, 4, 0, 0, 0]] {
        let [_, low, high, sub, ..] = first;
        assert_eq!(bench.request(first), [0x80, low, high, sub, 0x01, 0x00, 0x04, 0x05]);
    }
    // Where small values come at once, those of more than four bytes come in segments.
    let manner = DriveQuirks { lengths, ..DriveQuirks::default() };
    let mut bench = Bench::with(DriveSettings { manner, ..settings(Direction::Same) });
    assert_eq!(bench.request([0x40, 0x41, 0x60, 0, 0, 0, 0, 0]), [0x41, 0x41, 0x60, 0, 8, 0, 0, 0]);
    assert_eq!(bench.request([0x60, 0, 0, 0, 0, 0, 0, 0])[..3], [0x00, 0x50, 0x02]);
    assert_eq!(bench.request([0x40, 0x65, 0x60, 0, 0, 0, 0, 0])[0], 0x4f, "one byte of four");
}

#[test]
fn a_drive_may_refuse_dummies_and_modes() {
    for is_odd in [false, true] {
        let manner = DriveQuirks { lacks_dummies: is_odd, refuses_mode: is_odd, ..DriveQuirks::default() };
        let mut bench = Bench::with(DriveSettings { manner, ..settings(Direction::Same) });
        bench.write(0x1400, 1, &0x8000_0201_u32.to_le_bytes());
        bench.write(0x1600, 0, &[0]);
        let answer = bench.try_write(0x1600, 1, &0x0005_0008_u32.to_le_bytes());
        let refused = [0x80, 0x00, 0x16, 1, 0x41, 0x00, 0x04, 0x06];
        assert_eq!(answer, if is_odd { refused } else { [0x60, 0x00, 0x16, 1, 0, 0, 0, 0] });
        bench.write(0x1600, 1, &0x6040_0010_u32.to_le_bytes());
        bench.configure(OperationMode::CyclicPosition);
        bench.enable();
        let answer = bench.try_write(0x6060, 0, &[9]);
        let refused = [0x80, 0x60, 0x60, 0, 0x22, 0x00, 0x00, 0x08];
        assert_eq!(answer, if is_odd { refused } else { [0x60, 0x60, 0x60, 0, 0, 0, 0, 0] });
        assert_eq!(bench.read(0x6061, 0), 8, "nor does it change in Operation Enabled");
    }
}

#[test]
fn a_drive_that_does_not_watch_for_set_points_by_an_event_timer_has_none() {
    let profile =
        yieldwall_config::load_profile(yieldwall_config::builtin("vendors/profiles/no-rpdo-timer.yaml")).unwrap();
    let mut bench = Bench::with(DriveSettings { profile: profile.value.into(), ..settings(Direction::Same) });
    assert_eq!(bench.try_write(0x1400, 5, &[5, 0])[..], [0x80, 0x00, 0x14, 5, 0x11, 0x00, 0x09, 0x06]);
    assert_eq!(bench.read(0x1400, 0) & 0xff, 2);
}

#[test]
fn objects_may_be_absent_fixed_or_want_certain_bits() {
    let odd = |index, sub| OddObject { index, sub, ..OddObject::default() };
    let objects = vec![
        OddObject { is_read_only: true, ..odd(0x1600, None) },
        OddObject { holds: Some(-4), is_read_only: true, ..odd(0x60c2, Some(2)) },
        OddObject { needed_bits: 0x4000_0000, ..odd(0x1800, Some(1)) },
        OddObject { is_absent: true, ..odd(0x6076, None) },
    ];
    let manner = DriveQuirks { objects, ..DriveQuirks::default() };
    let mut bench = Bench::with(DriveSettings { manner, ..settings(Direction::Same) });
    assert_eq!(bench.try_write(0x1600, 0, &[0]), [0x80, 0x00, 0x16, 0, 0x02, 0x00, 0x01, 0x06]);
    assert_eq!(bench.request([0x40, 0xc2, 0x60, 2, 0, 0, 0, 0]), [0x4f, 0xc2, 0x60, 2, 0xfc, 0, 0, 0]);
    assert_eq!(bench.try_write(0x60c2, 2, &[0xfc]), [0x80, 0xc2, 0x60, 2, 0x02, 0x00, 0x01, 0x06]);
    assert_eq!(bench.request([0x40, 0x00, 0x18, 1, 0, 0, 0, 0])[7] & 0x40, 0x40);
    let refused = [0x80, 0x00, 0x18, 1, 0x30, 0x00, 0x09, 0x06];
    assert_eq!(bench.try_write(0x1800, 1, &0x8000_0181_u32.to_le_bytes()), refused);
    assert_eq!(bench.try_write(0x1800, 1, &0xc000_0181_u32.to_le_bytes())[0], 0x60);
    assert_eq!(bench.request([0x40, 0x76, 0x60, 0, 0, 0, 0, 0]), [0x80, 0x76, 0x60, 0, 0x00, 0x00, 0x02, 0x06]);
    // An object that it does not have cannot be odd.
    let manner = DriveQuirks { objects: vec![odd(0x5fff, Some(1))], ..DriveQuirks::default() };
    let lacking = Drive::new(DriveSettings { manner, ..settings(Direction::Same) });
    assert!(matches!(lacking, Err(DeviceError::Lacks { at: Address { index: 0x5fff, sub: 1 } })));
}

#[test]
fn a_write_may_take_longer_than_others() {
    let slow =
        OddObject { index: 0x1010, sub: Some(1), write_time: Duration::from_millis(2500), ..OddObject::default() };
    let manner = DriveQuirks { objects: vec![slow], ..DriveQuirks::default() };
    let mut drive = Drive::new(DriveSettings { manner, ..settings(Direction::Same) }).unwrap();
    let (mut out, begin) = (Vec::new(), Time(0));
    drive.boot(begin, &mut out);
    out.clear();
    let id = cob::sdo_request(settings(Direction::Same).node);
    drive.on_frame(begin, &Frame::new(id, &[0x23, 0x10, 0x10, 1, b's', b'a', b'v', b'e']), &mut out);
    drive.poll(begin + Duration::from_millis(2499), &mut out);
    assert!(out.is_empty(), "{out:?}");
    drive.poll(begin + Duration::from_millis(2500), &mut out);
    assert_eq!(out.iter().map(|frame| frame.data()[0]).collect::<Vec<_>>(), [0x60]);
}

#[test]
fn a_fault_of_power_on_lasts_through_resets_of_the_node_until_it_is_reset_itself() {
    let manner = DriveQuirks { fault_code: 0x7121, ..DriveQuirks::default() };
    let mut bench = Bench::with(DriveSettings { manner, ..settings(Direction::Same) });
    for command in [0x81, 0x82] {
        bench.send(Frame::new(0x000, &[command, NODE]));
        assert_eq!((bench.drive.state(), bench.read(0x603f, 0)), (State::Fault, 0x7121));
    }
    bench.sent.clear();
    bench.write(0x6040, 0, &[0x80, 0]);
    assert_eq!((bench.drive.state(), bench.read(0x603f, 0)), (State::SwitchOnDisabled, 0));
    bench.send(Frame::new(0x000, &[0x81, NODE]));
    assert_eq!(bench.drive.state(), State::SwitchOnDisabled);
    bench.drive.switch_off();
    bench.drive.boot(bench.now, &mut bench.sent);
    assert_eq!(bench.drive.state(), State::Fault, "switched off and on");
}

#[test]
fn a_power_stage_that_comes_later_is_an_emergency_that_is_withdrawn() {
    let manner = DriveQuirks { supply_time: Duration::from_millis(200), ..DriveQuirks::default() };
    let mut bench = Bench::with(DriveSettings { manner, ..settings(Direction::Same) });
    for _ in 0..2 {
        bench.wait(Duration::from_millis(199));
        assert_eq!(bench.take_sent(0x081), [Frame::new(0x081, &[0x20, 0x32, 0x21, 0, 0, 0, 0, 0])]);
        bench.wait(Duration::from_millis(1));
        assert_eq!(bench.take_sent(0x081), [Frame::new(0x081, &[0; 8])]);
        assert_eq!(bench.drive.state(), State::SwitchOnDisabled);
        bench.send(Frame::new(0x000, &[0x81, NODE]));
    }
}
