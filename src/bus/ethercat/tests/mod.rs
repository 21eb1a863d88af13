//! The network against a simulated segment, in virtual time: bytes in, bytes out.

mod axes;
mod budget;
mod exchange;
mod faults;
mod intruders;
mod master;
mod refusals;
mod sensors;

use std::collections::VecDeque;
use std::time::Duration;

use super::*;
use crate::axis::{Arrived, DriveOrders};
use crate::setup::{SensorStart, Waits};
use yieldwall_config::shipped_profile;
use yieldwall_drives::cia402::CommandMode;
use yieldwall_drives::profiles::{Identity, Revisions};
use yieldwall_drives::scaling::{AxisScaling, Direction};
use yieldwall_fieldbus::canopen::BusId;
use yieldwall_fieldbus::ethercat::frame::SOURCE;
use yieldwall_fieldbus::ethercat::{registers as register, u16_at};
use yieldwall_fieldbus::objects::{Address, ServedDevice};
use yieldwall_sim::ethercat::{Controller, ControllerSettings, Segment, SimulatedDevice, sii};
use yieldwall_sim::{AxisSettings, Encoder, EthercatDrive, ForceTorqueSensor, ForceTorqueSettings, PositionLoop};

const PERIOD: Duration = Duration::from_millis(1);
const COMPUTE_AT: Duration = Duration::from_micros(500);
const PHASE: Duration = Duration::from_micros(100);
const REST: [DriveOrders; 2] = [DriveOrders { controlword: 0, target: 0, releases: false }; 2];

fn waits() -> Waits {
    let ms = Duration::from_millis;
    Waits { boot_up: ms(1000), sdo: ms(500), start: ms(1000) }
}

fn drive_setup(device: Device, position: u16) -> StationSetup {
    let drive = SegmentDrive {
        name: if device == Device::LeftDrive { "left" } else { "right" }.to_owned(),
        device,
        position,
        profile: shipped_profile("simulated-servo"),
        waits: waits(),
        torque_limit_per_mille: 500,
        speed_limit_counts_per_s: 100_000,
        following_error_counts: 10_000,
        homing: None,
    };
    drive.station(CommandMode::Position, PERIOD, Acts::AtSync0).unwrap()
}

fn sensor_setup(position: u16) -> StationSetup {
    let sensor = SegmentSensor {
        name: "force sensor".to_owned(),
        position,
        profile: shipped_profile("ati-ethercat"),
        waits: waits(),
        start: SensorStart::default(),
    };
    sensor.station().unwrap()
}

fn setup() -> SegmentSetup {
    SegmentSetup {
        bus: BusId::FIRST,
        period: PERIOD,
        compute_at: COMPUTE_AT,
        sync0_phase: PHASE,
        stations: vec![drive_setup(Device::LeftDrive, 0), drive_setup(Device::RightDrive, 1), sensor_setup(2)],
    }
}

fn drive(serial: u32) -> SimulatedDevice {
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
    SimulatedDevice::Drive(Box::new(EthercatDrive::new(&shipped_profile("simulated-servo"), serial, &axis).unwrap()))
}

fn sensor() -> SimulatedDevice {
    let settings = ForceTorqueSettings::new(shipped_profile("ati-ethercat"), 3);
    SimulatedDevice::ForceTorque(Box::new(ForceTorqueSensor::new(&settings).unwrap()))
}

fn controller(device: SimulatedDevice, drift_ppb: i32) -> Controller<SimulatedDevice> {
    let image = sii(device.od()).write();
    let settings = ControllerSettings {
        drift_ppb,
        clock_start_ns: 1_000 * i64::from(drift_ppb),
        ..ControllerSettings::new(image)
    };
    Controller::new(device, settings)
}

fn devices() -> Vec<Controller<SimulatedDevice>> {
    vec![controller(drive(1), 0), controller(drive(2), 0), controller(sensor(), 0)]
}

/// What becomes of a frame on its way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Fate {
    #[default]
    Passes,
    IsLost,
    /// It comes back so much later.
    IsLate(Duration),
    IsDoubled,
    /// Another EtherCAT frame comes in behind it.
    IsFollowed,
    /// Bits of it are flipped, by this number.
    IsChanged(u64),
    /// If it reads the memory chip: the chip tells another word than the one that was asked for.
    IsOfAnotherWord,
}

/// A network, a segment, and the wire between them.
struct Bench {
    network: EthercatNetwork,
    segment: Segment<SimulatedDevice>,
    now: Time,
    wire: VecDeque<(Time, Vec<u8>)>,
    outbox: Vec<Vec<u8>>,
    fate: Box<dyn FnMut(u64) -> Fate>,
    sent: Vec<Vec<u8>>,
    keeps: bool,
    count: u64,
    next_open: Time,
    /// How late the owner opens each cycle, and whether the network is told.
    late: Box<dyn FnMut() -> Duration>,
    tells_late: bool,
}

impl Bench {
    fn new(setup: &SegmentSetup, devices: Vec<Controller<SimulatedDevice>>) -> Self {
        let now = Time(1_000_000);
        Bench {
            network: EthercatNetwork::new(setup).unwrap(),
            segment: Segment::new(Time(0), devices),
            now,
            wire: VecDeque::new(),
            outbox: Vec::new(),
            fate: Box::new(|_| Fate::Passes),
            sent: Vec::new(),
            keeps: false,
            count: 0,
            next_open: Time::NEVER,
            late: Box::new(|| Duration::ZERO),
            tells_late: true,
        }
    }

    fn usual() -> Self {
        Bench::new(&setup(), devices())
    }

    /// Puts what the network has sent onto the wire.
    fn flush(&mut self) {
        for frame in std::mem::take(&mut self.outbox) {
            self.count += 1;
            if self.keeps {
                self.sent.push(frame.clone());
            }
            let fate = (self.fate)(self.count);
            let mut back = frame.clone();
            let at = match fate {
                // Half of those that are lost never reach the devices.
                Fate::IsLost if self.count.is_multiple_of(2) => None,
                _ => self.segment.process(self.now, &mut back),
            };
            let Some(at) = at.filter(|_| fate != Fate::IsLost) else { continue };
            let at = match fate {
                Fate::IsLate(by) => at + by,
                _ => at,
            };
            // Behind the headers of Ethernet, EtherCAT and the datagram: control, then the word's address.
            if fate == Fate::IsOfAnotherWord
                && back[16] == Command::Fprd as u8
                && u16_at(&back, 20) == register::SII_CONTROL
            {
                back[28] ^= 1;
            }
            self.insert(at, back.clone());
            match fate {
                Fate::IsDoubled => self.insert(at + Duration::from_micros(5), back),
                Fate::IsFollowed => {
                    let mut foreign = frame;
                    foreign[6..12].copy_from_slice(&[2, 0, 0, 0, 0, 7]);
                    self.insert(at, foreign);
                }
                _ => {}
            }
        }
    }

    fn insert(&mut self, at: Time, bytes: Vec<u8>) {
        let place = self.wire.iter().position(|(other, _)| *other > at).unwrap_or(self.wire.len());
        self.wire.insert(place, (at, bytes));
    }

    /// Runs everything that is due up to a moment.
    fn run_until(&mut self, until: Time) {
        loop {
            let arrival = self.wire.front().map_or(Time::NEVER, |(at, _)| *at);
            let next = arrival.min(self.network.next_deadline()).min(self.segment.next_deadline());
            if next > until {
                break;
            }
            self.now = self.now.max(next);
            self.segment.poll(self.now);
            if arrival <= self.now
                && let Some((_, bytes)) = self.wire.pop_front()
            {
                self.network.on_frame(self.now, &bytes, &mut self.outbox);
                self.flush();
            }
            if self.network.next_deadline() <= self.now {
                let before = self.network.next_deadline();
                self.network.poll(self.now, &mut self.outbox);
                self.flush();
                if self.network.next_deadline() == before {
                    // Nothing was due after all: a moment has to pass.
                    self.now = self.now + Duration::from_nanos(1);
                }
            }
        }
        self.now = self.now.max(until);
        self.segment.poll(self.now);
    }

    /// Starts the network and runs it until it is up or has failed, or for a minute.
    fn start(&mut self) -> Result<(), String> {
        self.network.start(self.now, &mut self.outbox);
        self.flush();
        let begin = self.now;
        while self.now.since(begin) < Duration::from_secs(60) {
            let until = self.now + Duration::from_micros(50);
            self.run_until(until);
            match self.network.phase() {
                Phase::Operational => {
                    self.next_open = Time::NEVER;
                    return Ok(());
                }
                Phase::Failed(error) => return Err(error.to_string()),
                _ => {}
            }
        }
        Err(format!("still {:?}", self.network.phase()))
    }

    /// One cycle as whoever owns the network runs it.
    fn cycle(&mut self, orders: &[DriveOrders; 2]) -> Arrived {
        if self.next_open == Time::NEVER {
            // The network may be between the two moments of a cycle of its own.
            let until = self.now + PERIOD;
            while self.next_open == Time::NEVER && self.now < until {
                self.next_open = self.network.take_over_cycles().unwrap_or(Time::NEVER);
                if self.next_open == Time::NEVER {
                    self.run_until(self.now + Duration::from_micros(10));
                }
            }
        }
        let open = self.next_open;
        if let Some(before) = self.network.repeats_before() {
            self.run_until(Time(open.0 - before.as_nanos() as u64));
            self.network.repeat(&mut self.outbox);
            self.flush();
        }
        let late = (self.late)();
        self.run_until(Time(open.0 - 1) + late);
        self.now = open + late;
        if self.tells_late {
            self.network.note_late(late);
        }
        self.network.open(&mut self.outbox);
        self.flush();
        let compute = open + COMPUTE_AT;
        self.run_until(compute);
        let arrived = self.network.take(compute);
        self.network.close(compute, orders, &mut self.outbox);
        self.flush();
        let next = open + PERIOD;
        self.next_open = Time(next.0.saturating_add_signed(self.network.grid_shift_ns()));
        arrived
    }

    /// So many cycles, whatever comes.
    fn cycles(&mut self, count: usize, orders: &[DriveOrders; 2]) {
        for _ in 0..count {
            self.cycle(orders);
        }
    }

    /// A frame of one datagram that passes the devices and does not come to the network; the data as they come back.
    fn unseen(&mut self, command: Command, address: u32, data: &[u8]) -> Vec<u8> {
        let mut buffer = [0; frame::LONGEST];
        let mut writer = frame::FrameWriter::new(&mut buffer, SOURCE).unwrap();
        let at = writer.push(command, 0, address, data).unwrap();
        let frame = writer.finish();
        self.segment.process(self.now, frame);
        frame[at].to_vec()
    }

    fn al(&self, place: usize) -> String {
        self.segment.controller(place).unwrap().al_status().to_string()
    }
}

/// Numbers that look random, the same every time.
fn numbers(seed: u64) -> impl FnMut() -> u64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    }
}
