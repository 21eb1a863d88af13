//! The drive and the sensor of the rig, from finding them to moving them, by frames alone.

use super::super::{SimulatedDevice, esi, sii};
use super::*;
use crate::{AxisSettings, Encoder, EthercatDrive, ForceTorqueSensor, ForceTorqueSettings, PositionLoop};
use yieldwall_config::shipped_profile;
use yieldwall_drives::cia402::State;
use yieldwall_drives::scaling::{AxisScaling, Direction};
use yieldwall_fieldbus::ethercat::coe::{CoeAnswer, CoeClient, CoeEvent, CoeRequest};
use yieldwall_fieldbus::ethercat::frame::Command;
use yieldwall_fieldbus::ethercat::mailbox::{self, Counter, Protocol};
use yieldwall_fieldbus::ethercat::sii::Sii;
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectError, ServedDevice};

const CYCLE: Duration = Duration::from_millis(1);
const OUTPUTS: usize = 13;
const INPUTS: usize = 15;

fn drive() -> SimulatedDevice {
    let axis = AxisSettings {
        scaling: AxisScaling::new(100_000.0, Direction::Same, 0.0, 60.0).unwrap(),
        position_loop: PositionLoop {
            period_us: 125,
            stiffness_n_m_per_rad: 20_000.0,
            damping_n_m_s_per_rad: 150.0,
            integral_n_m_per_rad_s: 200_000.0,
        },
        encoder: Encoder::Quantised,
    };
    let drive = EthercatDrive::new(&shipped_profile("simulated-servo"), 4711, &axis).unwrap();
    SimulatedDevice::Drive(Box::new(drive))
}

fn sensor() -> SimulatedDevice {
    let settings = ForceTorqueSettings::new(shipped_profile("ati-ethercat"), 8);
    SimulatedDevice::ForceTorque(Box::new(ForceTorqueSensor::new(&settings).unwrap()))
}

/// A master of a few lines.
struct Bench {
    segment: Segment<SimulatedDevice>,
    now: Time,
    counters: Vec<Counter>,
    emergencies: Vec<u16>,
}

impl Bench {
    fn new(devices: impl IntoIterator<Item = SimulatedDevice>) -> Self {
        let controllers: Vec<_> = devices
            .into_iter()
            .map(|device| {
                let image = sii(device.od()).write();
                Controller::new(device, ControllerSettings::new(image))
            })
            .collect();
        let counters = vec![Counter::FIRST; controllers.len()];
        Bench { segment: Segment::new(Time(0), controllers), now: Time(1000), counters, emergencies: Vec::new() }
    }

    fn ask(&mut self, command: Command, place: usize, ado: u16, data: &[u8]) -> (Vec<u8>, u16) {
        let mut buffer = [0; 1514];
        let mut writer = frame::FrameWriter::new(&mut buffer, [0x10; 6]).unwrap();
        let at = writer.push(command, 1, frame::address(0u16.wrapping_sub(place as u16), ado), data).unwrap();
        let frame = writer.finish();
        self.now = self.now + Duration::from_micros(20);
        self.segment.process(self.now, frame);
        (frame[at.clone()].to_vec(), u16_at(frame, at.end))
    }

    fn write(&mut self, place: usize, ado: u16, data: &[u8]) {
        assert_eq!(self.ask(Command::Apwr, place, ado, data).1, 1, "{ado:04x}");
    }

    /// Sync managers as the SII of the device says them.
    fn configure(&mut self, place: usize, range: std::ops::Range<usize>) {
        let image = self.segment.controller_mut(place).unwrap().sii_mut().to_vec();
        for (number, manager) in
            Sii::read(&image).unwrap().sync_managers.iter().enumerate().take(range.end).skip(range.start)
        {
            self.write(place, 0x0800 + 8 * number as u16, &manager.settings.encode());
        }
    }

    fn state(&mut self, place: usize, state: u8) {
        self.write(place, 0x0120, &[state, 0]);
        let (status, _) = self.ask(Command::Aprd, place, 0x0130, &[0; 6]);
        assert_eq!(status, [state, 0, 0, 0, 0, 0], "device {place} to {state}");
    }

    fn coe(&mut self, place: usize, request: CoeRequest<'_>) -> CoeAnswer {
        let mut client = CoeClient::new(Duration::from_secs(1));
        client.start(self.now, request).unwrap();
        for _ in 0..1000 {
            let mut out = [0; 128];
            let len = client.message(&mut out[mailbox::HEADER..]);
            if len > 0 {
                mailbox::seal(&mut out, Protocol::Coe, self.counters[place].take(), len);
                self.write(place, 0x1000, &out);
            }
            let (bytes, counter) = self.ask(Command::Aprd, place, 0x1400, &[0; 128]);
            if counter == 1 {
                let (_, message) = mailbox::decode(&bytes).unwrap();
                if let CoeEvent::Emergency(emergency) = client.on_message(self.now, message) {
                    self.emergencies.push(emergency.code);
                }
            }
            if !client.is_busy() {
                break;
            }
        }
        client.answer().clone()
    }

    fn read(&mut self, place: usize, index: u16, sub: u8) -> Vec<u8> {
        match self.coe(place, CoeRequest::Read { at: Address::new(index, sub), complete: false }) {
            CoeAnswer::Value(value) => value,
            other => panic!("{index:04x}:{sub}: {other:?}"),
        }
    }

    fn drive(&mut self) -> &mut EthercatDrive {
        self.segment.controller_mut(0).unwrap().device_mut().drive_mut().unwrap()
    }

    /// One cycle of 1 ms with SYNC0 in its middle: a motor without load that is where it is told to be.
    fn cycle(&mut self, control: u16, target: i32, mode: u8) -> Vec<u8> {
        self.cycle_with(control, mode, |outputs| outputs[2..6].copy_from_slice(&target.to_le_bytes()))
    }

    fn cycle_with(&mut self, control: u16, mode: u8, aim: impl FnOnce(&mut [u8; OUTPUTS])) -> Vec<u8> {
        let mut outputs = [0; OUTPUTS];
        outputs[..2].copy_from_slice(&control.to_le_bytes());
        outputs[12] = mode;
        aim(&mut outputs);
        self.write(0, 0x1800, &outputs);
        let until = self.now + CYCLE;
        while self.segment.next_deadline() <= until {
            let next = self.segment.next_deadline();
            self.segment.poll(next);
        }
        self.now = until;
        let (inputs, counter) = self.ask(Command::Aprd, 0, 0x1c00, &[0; INPUTS]);
        assert_eq!(counter, 1);
        inputs
    }

    fn start_op(&mut self) {
        self.configure(0, 0..2);
        self.state(0, 2);
        self.configure(0, 2..4);
        self.write(0, 0x09a0, &1_000_000u32.to_le_bytes());
        let start = (self.now.0 / 1_000_000 + 2) * 1_000_000 + 500_000;
        self.write(0, 0x0990, &start.to_le_bytes());
        self.write(0, 0x0981, &[3]);
        self.state(0, 4);
        self.write(0, 0x1800, &[0; OUTPUTS]);
        self.write(0, 0x0120, &[8, 0]);
        for _ in 0..4 {
            self.cycle(0, 0, 8);
        }
        assert_eq!(self.ask(Command::Aprd, 0, 0x0130, &[0; 6]).0, [8, 0, 0, 0, 0, 0]);
    }
}

#[test]
fn sii_description_and_dictionary_of_both_devices_agree() {
    for (device, inputs, outputs) in [(drive(), 15, 13), (sensor(), 32, 8)] {
        let read = Sii::read(&sii(device.od()).write()).unwrap();
        assert_eq!(read, sii(device.od()));
        let od = device.od();
        let identity = [read.vendor_id, read.product_code, read.revision, read.serial];
        assert_eq!(identity.map(u64::from), [1, 2, 3, 4].map(|sub| od.raw(0x1018, sub)));
        let described = esi(od, "Vendor & Sons");
        assert_eq!(yieldwall_drives::esi::Esi::read(described.write().as_bytes()).unwrap(), described);
        let device = &described.devices[0];
        assert_eq!(
            (described.vendor_id, device.product_code, device.revision),
            (identity[0], identity[1], identity[2])
        );
        for (described, read) in [(&device.rx_pdos, &read.rx_pdos), (&device.tx_pdos, &read.tx_pdos)] {
            let described = described.iter().flat_map(|pdo| &pdo.entries);
            let described: Vec<_> = described.map(|entry| (entry.index, entry.sub, entry.bits)).collect();
            let read = read.iter().flat_map(|pdo| &pdo.entries);
            assert!(read.map(|entry| (entry.index, entry.sub, u16::from(entry.bits))).eq(described));
        }
        let lengths: Vec<u16> = read.sync_managers.iter().map(|manager| manager.settings.len).collect();
        assert_eq!(lengths, [128, 128, outputs, inputs]);
        let entries = read.rx_pdos.iter().chain(&read.tx_pdos).flat_map(|pdo| &pdo.entries);
        for entry in entries {
            let object = od.describe(Address::new(entry.index, entry.sub)).unwrap();
            assert_eq!(entry.name, object.name);
            assert_eq!(Some(entry.bits), object.data_type.bits());
            assert!(!entry.name.is_empty(), "{:04x}", entry.index);
        }
    }
}

#[test]
fn a_drive_is_enabled_by_controlword_and_follows_its_target_at_sync0() {
    let mut bench = Bench::new([drive(), sensor()]);
    bench.start_op();
    let status = |inputs: &[u8]| u16::from_le_bytes([inputs[0], inputs[1]]);
    for control in [0x06, 0x07, 0x0f, 0x0f] {
        bench.cycle(control, 0, 8);
    }
    let inputs = bench.cycle(0x0f, 0, 8);
    assert_eq!((status(&inputs) & 0x6f, inputs[14]), (0x27, 8));
    assert_eq!(bench.drive().state(), State::OperationEnabled);
    for target in [100, 200, 300] {
        bench.cycle(0x0f, target, 8);
    }
    assert!(bench.drive().torque_n_m() > 1.0, "it pulls towards its target: {} N m", bench.drive().torque_n_m());
    bench.drive().measure(300.0 / 100_000.0 * std::f64::consts::TAU, 0.0);
    let inputs = bench.cycle(0x0f, 300, 8);
    assert_eq!(inputs[2..6], 300i32.to_le_bytes());
}

#[test]
fn a_drive_turns_at_its_target_velocity_and_makes_its_target_torque() {
    let mut bench = Bench::new([drive(), sensor()]);
    bench.start_op();
    for control in [0x06, 0x07, 0x0f, 0x0f] {
        bench.cycle(control, 0, 9);
    }
    // CSV: a motor that stands still is pulled the way that is wanted, one that turns faster the other way.
    let inputs = bench.cycle_with(0x0f, 9, |outputs| outputs[6..10].copy_from_slice(&10_000i32.to_le_bytes()));
    assert_eq!((inputs[0] & 0x6f, inputs[14]), (0x27, 9));
    for _ in 0..3 {
        bench.cycle_with(0x0f, 9, |outputs| outputs[6..10].copy_from_slice(&10_000i32.to_le_bytes()));
    }
    assert!(bench.drive().torque_n_m() > 1.0, "{} N m", bench.drive().torque_n_m());
    bench.drive().measure(0.0, 20_000.0 / 100_000.0 * std::f64::consts::TAU);
    for _ in 0..3 {
        bench.cycle_with(0x0f, 9, |outputs| outputs[6..10].copy_from_slice(&10_000i32.to_le_bytes()));
    }
    assert!(bench.drive().torque_n_m() < -1.0, "{} N m", bench.drive().torque_n_m());
    // CST: 300 per mille of 60 N m, whatever the motor does. The mode changes in Switched On.
    bench.drive().measure(0.0, 0.0);
    for control in [[0x07; 100], [0x0f; 100]].concat() {
        bench.cycle_with(control, 10, |outputs| outputs[10..12].copy_from_slice(&300i16.to_le_bytes()));
    }
    let inputs = bench.cycle_with(0x0f, 10, |outputs| outputs[10..12].copy_from_slice(&300i16.to_le_bytes()));
    assert_eq!((inputs[0] & 0x6f, inputs[14]), (0x27, 10));
    assert_eq!((bench.drive().torque_n_m(), inputs[10..12].to_vec()), (18.0, 300i16.to_le_bytes().to_vec()));
}

#[test]
fn a_master_that_stops_lets_the_watchdog_stop_the_drive() {
    let mut bench = Bench::new([drive()]);
    bench.start_op();
    for control in [0x06, 0x07, 0x0f, 0x0f, 0x0f] {
        bench.cycle(control, 0, 8);
    }
    assert_eq!(bench.drive().state(), State::OperationEnabled);
    bench.now = bench.now + Duration::from_millis(500);
    while bench.segment.next_deadline() <= bench.now {
        let next = bench.segment.next_deadline();
        bench.segment.poll(next);
    }
    assert_eq!(bench.ask(Command::Aprd, 0, 0x0130, &[0; 6]).0, [0x14, 0, 0, 0, 0x1b, 0]);
    assert_ne!(bench.drive().state(), State::OperationEnabled);
    assert_eq!(bench.drive().torque_n_m(), 0.0);
    assert_eq!(bench.read(0, 0x1001, 0), [0x11]);
    assert_eq!(bench.emergencies, [0x8250]);
}

#[test]
fn a_fault_is_an_emergency_also_while_an_object_is_read() {
    let mut bench = Bench::new([drive()]);
    bench.start_op();
    let now = bench.now;
    bench.drive().raise_fault(now, 0x3220);
    assert_eq!(bench.read(0, 0x603f, 0), [0x20, 0x32]);
    assert_eq!(bench.emergencies, [0x3220]);
    assert_eq!(bench.read(0, 0x1001, 0), [0x21]);
    let refused = bench.coe(0, CoeRequest::Read { at: Address::new(0x5fff, 0), complete: false });
    assert_eq!(refused, CoeAnswer::Failed(ObjectError::Aborted(AbortCode::NO_OBJECT)));
}

#[test]
fn the_calibration_of_the_sensor_is_278_bytes_by_segments_and_complete_access() {
    let mut bench = Bench::new([drive(), sensor()]);
    bench.configure(1, 0..2);
    bench.state(1, 2);
    let whole = bench.coe(1, CoeRequest::Read { at: Address::new(0x2040, 1), complete: true });
    let CoeAnswer::Value(whole) = whole else { panic!("{whole:?}") };
    assert_eq!(whole.len(), 278);
    assert_eq!(whole[..8], *b"FT000008");
    // Units, then counts per N and N m.
    assert_eq!((whole[220], whole[221]), (2, 3));
    assert_eq!(whole[246..254], [0x40, 0x42, 0x0f, 0, 0x40, 0x42, 0x0f, 0]);
    let singly: Vec<u8> = (1..=56).flat_map(|sub| bench.read(1, 0x2040, sub)).collect();
    assert_eq!(singly, whole);
    // One value that is longer than a mailbox.
    assert_eq!(bench.read(1, 0x2041, 0), whole);
    assert_eq!(bench.read(1, 0x1018, 1), 0x732u32.to_le_bytes());
}

#[test]
fn the_sensor_samples_by_its_own_clock_with_32_bits() {
    let mut bench = Bench::new([sensor()]);
    bench.configure(0, 0..2);
    bench.state(0, 2);
    bench.configure(0, 2..4);
    bench.state(0, 4);
    bench.write(0, 0x1800, &[0; 8]);
    bench.state(0, 8);
    let sensor = |bench: &mut Bench, counts| {
        let controller = bench.segment.controller_mut(0).unwrap();
        controller.device_mut().force_torque_mut().unwrap().measure(counts);
    };
    sensor(&mut bench, [100_000_000, -2, 3, 4, 5, 600_000_000]);
    bench.now = bench.now + Duration::from_millis(10);
    let (first, counter) = bench.ask(Command::Aprd, 0, 0x1c00, &[0; 32]);
    assert_eq!((yieldwall_fieldbus::ethercat::u32_at(&first, 0), counter), (100_000_000, 1));
    assert_eq!(yieldwall_fieldbus::ethercat::u32_at(&first, 20), 500_000_000, "cut off at the range");
    assert_eq!(yieldwall_fieldbus::ethercat::u32_at(&first, 24), 1 << 27);
    // A frame takes 20 us: 10 ms from one to the other.
    bench.now = bench.now + Duration::from_micros(9980);
    let (second, _) = bench.ask(Command::Aprd, 0, 0x1c00, &[0; 32]);
    let number = |inputs: &[u8]| yieldwall_fieldbus::ethercat::u32_at(inputs, 28);
    assert_eq!(number(&second) - number(&first), 80, "8000 samples a second");
    // The zero.
    sensor(&mut bench, [7; 6]);
    bench.write(0, 0x1800, &[1, 0, 0, 0, 0, 0, 0, 0]);
    bench.now = bench.now + Duration::from_millis(1);
    sensor(&mut bench, [9; 6]);
    bench.now = bench.now + Duration::from_millis(1);
    let (zeroed, _) = bench.ask(Command::Aprd, 0, 0x1c00, &[0; 32]);
    assert_eq!(yieldwall_fieldbus::ethercat::u32_at(&zeroed, 0), 2);
}

#[test]
fn each_record_says_how_many_entries_it_has_and_those_of_the_simulation_have_names() {
    let drive = drive();
    let has = |index, sub| drive.od().describe(Address::new(index, sub)).is_ok();
    for index in 0x1000..=u16::MAX {
        assert!(!has(index, 1) || has(index, 0), "{index:04X}h:0");
    }
    for index in [0x1029, 0x2012] {
        assert!(!drive.od().describe(Address::new(index, 0)).unwrap().name.is_empty(), "{index:04X}h");
    }
}
