//! A virtual EtherCAT segment of two drives and a sensor: in OP with the frames of a cycle, or with the program's own master.

use std::time::Duration;

use yieldwall::bus::ethercat::{Acts, EthercatNetwork, EthernetOutbox, SegmentDrive, SegmentSensor, SegmentSetup};
use yieldwall::bus::{CommandMode, Phase, SensorStart, Waits};
use yieldwall::canopen::BusId;
use yieldwall::config::{self, Loaded, Rig, shipped_profile};
use yieldwall::ethercat::frame::{Command, FrameWriter, SOURCE, address};
use yieldwall::ethercat::{Direction, Fmmu, sii::Sii};
use yieldwall::guard::Device;
use yieldwall::objects::ServedDevice;
use yieldwall::rig::simulated_segment;
use yieldwall::run::Pace;
use yieldwall::sim::ethercat::{Segment, SimulatedDevice, sii};
use yieldwall::time::Time;

const PERIOD: Duration = Duration::from_millis(1);
/// Devices on it.
pub const DEVICES: u16 = 3;
/// Logical addresses of a device are so far from those of the next one.
const STRIDE: u32 = 0x100;

/// The segment and its time.
#[derive(Clone, Debug)]
pub struct Bench {
    /// The segment.
    pub segment: Segment<SimulatedDevice>,
    /// The present moment.
    pub now: Time,
    buffer: [u8; 1514],
    lengths: [(u16, u16); DEVICES as usize],
    mailbox_counter: u8,
}

/// The shipped rig on EtherCAT.
///
/// # Panics
/// If it cannot be read.
pub fn shipped() -> Loaded<Rig> {
    config::load_rig(config::builtin("paper-ethercat.yaml")).expect("a shipped rig")
}

/// The devices of a rig, all with perfect clocks.
///
/// # Panics
/// If the rig is not on EtherCAT.
pub fn segment(rig: &Loaded<Rig>) -> Segment<SimulatedDevice> {
    let scene = rig.scene().expect("a shipped scene").value;
    simulated_segment(&rig.value, &scene, [true; 3], Pace::Lockstep).expect("a rig on EtherCAT").0
}

/// What a master has to know of these devices.
pub fn setup() -> SegmentSetup {
    let ms = Duration::from_millis;
    let waits = Waits { boot_up: ms(1000), sdo: ms(200), start: ms(500) };
    let drive = |device, position| {
        let drive = SegmentDrive {
            name: format!("drive {position}"),
            device,
            position,
            profile: shipped_profile("simulated-servo"),
            waits,
            torque_limit_per_mille: 500,
            speed_limit_counts_per_s: 1_000_000,
            following_error_counts: 100_000,
            homing: None,
        };
        drive.station(CommandMode::Torque, PERIOD, Acts::AtSync0).expect("a shipped profile")
    };
    let sensor = SegmentSensor {
        name: "force sensor".to_owned(),
        position: 2,
        profile: shipped_profile("ati-ethercat"),
        waits,
        start: SensorStart::default(),
    };
    let sensor = sensor.station().expect("a shipped profile");
    SegmentSetup {
        bus: BusId::FIRST,
        period: PERIOD,
        compute_at: Duration::from_micros(500),
        sync0_phase: Duration::from_micros(100),
        stations: vec![drive(Device::LeftDrive, 0), drive(Device::RightDrive, 1), sensor],
    }
}

/// Room for the frames that a master sends at a time.
#[derive(Clone, Debug)]
pub struct Outgoing {
    frames: [[u8; 1514]; 4],
    lengths: [usize; 4],
    count: usize,
}

impl Default for Outgoing {
    fn default() -> Self {
        Outgoing { frames: [[0; 1514]; 4], lengths: [0; 4], count: 0 }
    }
}

impl EthernetOutbox for Outgoing {
    fn push(&mut self, bytes: &[u8]) {
        let Some(frame) = self.frames.get_mut(self.count) else { return };
        frame[..bytes.len()].copy_from_slice(bytes);
        self.lengths[self.count] = bytes.len();
        self.count += 1;
    }
}

impl Outgoing {
    /// How many frames wait.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The frames, which are gone afterwards.
    pub fn drain(&mut self) -> impl Iterator<Item = &mut [u8]> {
        let count = std::mem::take(&mut self.count);
        self.frames.iter_mut().zip(self.lengths).take(count).map(|(frame, len)| &mut frame[..len])
    }
}

/// The segment with the program's own master, which runs cycles by itself.
#[derive(Clone)]
pub struct Mastered {
    /// The master.
    pub network: EthercatNetwork,
    /// The segment.
    pub segment: Segment<SimulatedDevice>,
    /// The present moment.
    pub now: Time,
    /// What the master has sent and the segment has not processed.
    pub out: Outgoing,
}

impl Default for Mastered {
    /// # Panics
    /// If the setup is refused.
    fn default() -> Self {
        let network = EthercatNetwork::new(&setup()).expect("a good setup");
        Mastered { network, segment: segment(&shipped()), now: Time(0), out: Outgoing::default() }
    }
}

impl Mastered {
    /// All devices in OP.
    ///
    /// # Panics
    /// If they do not get there.
    pub fn operational() -> Self {
        let mut bench = Mastered::default();
        bench.network.start(bench.now, &mut bench.out);
        for _ in 0..1_000_000 {
            bench.step();
            if *bench.network.phase() == Phase::Operational {
                return bench;
            }
        }
        panic!("{:?}", bench.network.phase());
    }

    /// What has been sent goes round and comes back; then time goes on to what is due next.
    pub fn step(&mut self) {
        let Mastered { network, segment, now, out } = self;
        // What the replies lead to goes out in the next step.
        let mut sent = std::mem::take(out);
        for frame in sent.drain() {
            if let Some(back) = segment.process(*now, frame) {
                *now = back;
                network.on_frame(back, frame, out);
            }
        }
        if out.is_empty() {
            *now = segment.next_deadline().min(network.next_deadline()).clamp(*now, *now + PERIOD);
            segment.poll(*now);
            network.poll(*now, out);
            *now = *now + Duration::from_nanos(1);
        }
    }
}

impl Bench {
    /// All devices in OP, with SYNC0 every millisecond in the drives.
    ///
    /// # Panics
    /// If a device does not get there.
    pub fn operational() -> Self {
        let segment = segment(&shipped());
        let images = [0, 1, 2].map(|place| sii(segment.controller(place).expect("it is there").device().od()));
        let lengths =
            images.each_ref().map(|sii: &Sii| (sii.sync_managers[2].settings.len, sii.sync_managers[3].settings.len));
        let mut bench = Bench { segment, now: Time(0), buffer: [0; 1514], lengths, mailbox_counter: 0 };
        for (place, sii) in (0u16..).zip(&images) {
            bench.write(place, 0x0010, &(0x1000 + place).to_le_bytes());
            let managers: Vec<[u8; 8]> = sii.sync_managers.iter().map(|manager| manager.settings.encode()).collect();
            bench.write(place, 0x0800, managers[..2].as_flattened());
            bench.write(place, 0x0120, &[2, 0]);
            bench.write(place, 0x0810, managers[2..].as_flattened());
            let (outputs, inputs) = bench.lengths[usize::from(place)];
            let logical = STRIDE * u32::from(place);
            let fmmus = [
                Fmmu::bytes(logical, outputs, sii.sync_managers[2].settings.start, Direction::Write),
                Fmmu::bytes(logical + 0x80, inputs, sii.sync_managers[3].settings.start, Direction::Read),
            ];
            bench.write(place, 0x0600, fmmus.map(|fmmu| fmmu.encode()).as_flattened());
            if place < 2 {
                bench.write(place, 0x09a0, &1_000_000u32.to_le_bytes());
                bench.write(place, 0x0990, &10_500_000u64.to_le_bytes());
                bench.write(place, 0x0981, &[3]);
            }
            bench.write(place, 0x0120, &[4, 0]);
        }
        bench.cycle();
        (0..DEVICES).for_each(|place| bench.write(place, 0x0120, &[8, 0]));
        (0..20).for_each(|_| bench.cycle());
        for place in 0..usize::from(DEVICES) {
            let status = bench.segment.controller(place).expect("it is there").al_status();
            assert_eq!(status.to_string(), "OP", "device {place}");
        }
        bench
    }

    fn write(&mut self, place: u16, ado: u16, data: &[u8]) {
        let mut writer = FrameWriter::new(&mut self.buffer, SOURCE).expect("room");
        writer.push(Command::Apwr, 0, address(0u16.wrapping_sub(place), ado), data).expect("room");
        self.segment.process(self.now, writer.finish());
        self.now = self.now + Duration::from_micros(20);
    }

    /// The input frame of a cycle in a buffer: time of the reference clock, inputs and state of each device.
    ///
    /// # Panics
    /// If the buffer has no room.
    pub fn input_frame<'a>(&self, buffer: &'a mut [u8]) -> &'a mut [u8] {
        let mut writer = FrameWriter::new(buffer, SOURCE).expect("room");
        writer.push(Command::Frmw, 0, address(0x1000, 0x0910), &[0; 8]).expect("room");
        for (place, (_, inputs)) in (0u16..).zip(self.lengths) {
            let logical = STRIDE * u32::from(place) + 0x80;
            writer.push(Command::Lrd, 1, logical, &[0; 64][..usize::from(inputs)]).expect("room");
            writer.push(Command::Fprd, 2, address(0x1000 + place, 0x0130), &[0; 6]).expect("room");
        }
        writer.finish()
    }

    /// A cycle: input frame, output frame, a request and an answer through the mailbox of a drive, and all that is due until the next one.
    pub fn cycle(&mut self) {
        let mut buffer = self.buffer;
        let frame = self.input_frame(&mut buffer);
        self.segment.process(self.now, frame);
        let mut writer = FrameWriter::new(&mut buffer, SOURCE).expect("room");
        for (place, (outputs, _)) in (0u16..).zip(self.lengths) {
            writer.push(Command::Lwr, 3, STRIDE * u32::from(place), &[0; 64][..usize::from(outputs)]).expect("room");
        }
        let back = self.segment.process(self.now + Duration::from_micros(100), writer.finish());
        self.mailbox_counter = self.mailbox_counter % 7 + 1;
        let mut request = [0; 128];
        request[..10].copy_from_slice(&[10, 0, 0, 0, 0, 3 | self.mailbox_counter << 4, 0, 0x20, 0x50, 0x18]);
        request[10] = 0x10;
        let mut writer = FrameWriter::new(&mut buffer, SOURCE).expect("room");
        writer.push(Command::Fpwr, 4, address(0x1000, 0x1000), &request).expect("room");
        writer.push(Command::Fprd, 5, address(0x1001, 0x1400), &[0; 128]).expect("room");
        let back = self.segment.process(back.expect("it comes back"), writer.finish()).expect("it comes back");
        let mut writer = FrameWriter::new(&mut buffer, SOURCE).expect("room");
        writer.push(Command::Fprd, 6, address(0x1000, 0x1400), &[0; 128]).expect("room");
        self.segment.process(back, writer.finish());
        let until = self.now + PERIOD;
        while self.segment.next_deadline() <= until {
            self.segment.poll(self.segment.next_deadline());
        }
        self.now = until;
    }
}
