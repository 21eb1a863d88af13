//! Two drives and a sensor on one bus, with a script in the master's place.

use yieldwall_config::shipped_profile;
use yieldwall_drives::cia402::OperationMode;
use yieldwall_drives::scaling::{AxisScaling, Direction};

use super::can::{BitTiming, Delivery, QueueOrder, VirtualBus};
use super::*;
use yieldwall_fieldbus::canopen::{Frame, MappingEntry, node_id};
use yieldwall_fieldbus::time::Time;

const MASTER: usize = 0;
const SENSOR: usize = 3;

/// Port 0 is the master, 1 and 2 are drives with these node ids, 3 is the sensor, node 10.
struct Rig {
    bus: VirtualBus,
    drives: [Drive; 2],
    sensor: ForceSensor,
    now: Time,
    delivered: Vec<Delivery>,
}

impl Rig {
    fn new(timing: BitTiming) -> Self {
        let orders = [QueueOrder::Fifo, QueueOrder::Priority, QueueOrder::Priority, QueueOrder::Priority];
        let drive = |node| {
            Drive::new(DriveSettings {
                node: node_id(node).unwrap(),
                profile: shipped_profile("simulated-servo"),
                serial: 1,
                scaling: AxisScaling::new(800_000.0, Direction::Same, 0.0, 60.0).unwrap(),
                position_loop: PositionLoop {
                    period_us: 125,
                    stiffness_n_m_per_rad: 20_000.0,
                    damping_n_m_s_per_rad: 150.0,
                    integral_n_m_per_rad_s: 200_000.0,
                },
                encoder: Encoder::Quantised,
                manner: DriveQuirks::default(),
            })
            .unwrap()
        };
        let sensor = ForceSensor::new(ForceSensorSettings {
            speaks: Speaks::Canopen {
                node: node_id(10).unwrap(),
                profile: shipped_profile("simulated-force-sensor"),
                serial: 1,
                counts_per_unit: [1; 2],
            },
            sample_rate_hz: 1000,
            phase_us: 0,
            range_counts: 32_000,
        })
        .unwrap();
        let mut rig = Rig {
            bus: VirtualBus::new(timing, &orders).unwrap(),
            drives: [drive(1), drive(2)],
            sensor,
            now: Time(0),
            delivered: Vec::new(),
        };
        for (drive, port) in rig.drives.iter_mut().zip(1..) {
            drive.boot(Time(0), &mut rig.bus.outbox(port, Time(0)));
        }
        rig.sensor.boot(Time(0), &mut rig.bus.outbox(SENSOR, Time(0)));
        rig.run_to(Time::from_micros(1000));
        rig
    }

    fn run_to(&mut self, until: Time) {
        loop {
            let devices = self.drives.iter().map(Drive::next_deadline).min().unwrap_or(Time::NEVER);
            let next = self.bus.next_event().min(devices).min(self.sensor.next_deadline());
            if next > until {
                self.now = until;
                return;
            }
            self.now = next;
            while let Some(delivery) = self.bus.advance(self.now) {
                self.deliver(delivery);
            }
            for (drive, port) in self.drives.iter_mut().zip(1..) {
                drive.poll(self.now, &mut self.bus.outbox(port, self.now));
            }
            self.sensor.poll(self.now, &mut self.bus.outbox(SENSOR, self.now));
        }
    }

    fn deliver(&mut self, delivery: Delivery) {
        let Delivery { time, from, frame } = delivery;
        for (drive, port) in self.drives.iter_mut().zip(1..) {
            if port != from {
                drive.on_frame(time, &frame, &mut self.bus.outbox(port, time));
            }
        }
        if from != SENSOR {
            self.sensor.on_frame(time, &frame, &mut self.bus.outbox(SENSOR, time));
        }
        if from != MASTER {
            self.delivered.push(delivery);
        }
    }

    fn send(&mut self, frame: Frame) {
        assert!(self.bus.submit(MASTER, self.now, frame));
    }

    fn write(&mut self, node: u8, index: u16, sub: u8, value: u32, len: u8) {
        let mut data = [0x23 | (4 - len) << 2, 0, 0, sub, 0, 0, 0, 0];
        data[1..3].copy_from_slice(&index.to_le_bytes());
        data[4..].copy_from_slice(&value.to_le_bytes());
        self.delivered.clear();
        self.send(Frame::new(0x600 + u16::from(node), &data));
        self.run_to(Time(self.now.0 + 1_000_000));
        let answer = self.delivered.iter().find(|delivery| delivery.frame.id() == 0x580 + u16::from(node));
        assert_eq!(answer.map(|delivery| delivery.frame.bytes()[0]), Some(0x60), "node {node} {index:04x}:{sub}");
    }

    /// Operational in CST, the mapping of the profiles.
    fn configure(&mut self) {
        let profile = shipped_profile("simulated-servo");
        let pdos = profile.pdos(Some(OperationMode::CyclicTorque)).unwrap();
        for node in [1, 2] {
            let mut remap = |parameter: u16, id: u32, pdo: &yieldwall_drives::profiles::Pdo| {
                self.write(node, parameter, 1, id | 1 << 31, 4);
                self.write(node, parameter + 0x200, 0, 0, 1);
                for (sub, entry) in (1..).zip(super::device::mapping(&profile, pdo)) {
                    let (index, mapped, bits) = entry;
                    let entry = MappingEntry::new(index, mapped, bits).to_u32();
                    self.write(node, parameter + 0x200, sub, entry, 4);
                }
                self.write(node, parameter + 0x200, 0, pdo.maps.len() as u32, 1);
                self.write(node, parameter, 2, pdo.transmission_type.into(), 1);
                self.write(node, parameter, 1, id, 4);
            };
            remap(0x1400, 0x200 + u32::from(node), &pdos.rpdo[0]);
            remap(0x1800, 0x180 + u32::from(node), &pdos.tpdo[0]);
            self.write(node, 0x6060, 0, 10, 1);
        }
        self.write(10, 0x1800, 1, 0x18a, 4);
        self.write(10, 0x1801, 1, 0x28a, 4);
        self.send(Frame::new(0x000, &[0x01, 0x00]));
        self.run_to(Time::from_micros((self.now.0 / 1_000_000 + 1) * 1000));
    }

    /// SYNC at 0, RPDOs at 700 us; what the devices sent in this cycle, in microseconds from its start.
    fn cycle(&mut self, controlword: u16, torque: i16) -> Vec<(u64, Frame)> {
        let start = self.now;
        self.delivered.clear();
        self.send(Frame::new(0x080, &[]));
        self.run_to(Time(start.0 + 700_000));
        for node in [1, 2] {
            let [low, high] = torque.to_le_bytes();
            self.send(Frame::new(0x200 + node, &[controlword as u8, (controlword >> 8) as u8, low, high]));
        }
        self.run_to(Time(start.0 + 1_000_000));
        assert_eq!(self.bus.next_event(), Time::NEVER, "the bus is quiet before the next SYNC");
        self.delivered.iter().map(|delivery| ((delivery.time.0 - start.0) / 1000, delivery.frame)).collect()
    }
}

#[test]
fn a_cycle_at_1_mbit_per_s_fits_its_schedule() {
    let mut rig = Rig::new(BitTiming::Arbitrated { bit_rate: 1_000_000 });
    rig.configure();
    let before = *rig.bus.counters();
    for controlword in [0x06, 0x07, 0x0f, 0x0f, 0x0f, 0x0f, 0x0f, 0x0f, 0x0f, 0x0f] {
        let sent = rig.cycle(controlword, -200);
        let ids: Vec<u16> = sent.iter().map(|(_, frame)| frame.id()).collect();
        assert_eq!(ids, [0x181, 0x182, 0x18a, 0x28a], "by priority");
        // SYNC, 2 x 6 bytes, 8 bytes and 6 bytes at their worst are 55 + 2 * 115 + 135 + 115 bits.
        assert!(sent[3].0 <= 535, "{} us", sent[3].0);
    }
    assert_eq!(rig.drives.each_ref().map(Drive::torque_n_m), [-12.0, -12.0]);
    let load = rig.bus.counters().load_since(&before, std::time::Duration::from_millis(10), 1_000_000);
    // Unstuffed 577 bits a cycle, at most 725.
    assert!((0.577..0.725).contains(&load), "load {load}");
}

#[test]
fn without_bit_timing_the_same_frames_come_at_once() {
    let mut rig = Rig::new(BitTiming::Ideal);
    rig.configure();
    let sent = rig.cycle(0x06, 0);
    assert_eq!(
        sent.iter().map(|(at, frame)| (*at, frame.id())).collect::<Vec<_>>(),
        [(0, 0x181), (0, 0x182), (0, 0x18a), (0, 0x28a)]
    );
}

#[test]
fn one_flipped_bit_of_a_force_reaches_the_master_and_nothing_else_changes() {
    let run = |flip: bool| {
        let mut rig = Rig::new(BitTiming::Arbitrated { bit_rate: 1_000_000 });
        rig.configure();
        rig.sensor.measure([5; 6]);
        if flip {
            rig.bus.set_tamper(|_: Time, from: usize, frame: Frame| {
                let is_force = from == SENSOR && frame.id() == 0x18a;
                Some(if is_force { Frame::from_bits(0x18a, frame.bits() ^ 1 << 20, 8) } else { frame })
            });
        }
        rig.cycle(0x06, 0)
    };
    let (clean, flipped) = (run(false), run(true));
    let differing: Vec<_> = clean.iter().zip(&flipped).filter(|(one, other)| one != other).collect();
    assert_eq!(differing.len(), 1);
    let ((at, frame), (flipped_at, flipped_frame)) = differing[0];
    assert_eq!((at, frame.bits() ^ flipped_frame.bits()), (flipped_at, 1 << 20));
}
