//! The master against frames written by hand.

mod alone;
mod boot;
mod buses;
#[allow(dead_code)]
#[path = "../../motion/cycle/tests/example.rs"]
mod cycle_example;
mod exchange;
mod nodes;
mod objects;
mod strangers;
mod third;

use std::collections::BTreeMap;
use std::time::Duration;

use super::*;
use cycle_example::{cycle_with, fixture, geometry, torque_servo};
use yieldwall_config::shipped_profile;
use yieldwall_drives::scaling::{AxisScaling, Direction};
use yieldwall_fieldbus::Packet;
use yieldwall_fieldbus::canopen::{BusId, Frame, cob};
use yieldwall_fieldbus::time::Time;
use yieldwall_motion::control::Law;
use yieldwall_motion::cycle::{Cycle, Outputs, Servo, Timing};
use yieldwall_motion::guard::{Fault, Request, State};
use yieldwall_motion::linkage::FiveBar;
use yieldwall_motion::quantity::TipPoint;

/// A cycle whose drives close the position loop (CSP), and the angles of its home in rad.
pub(crate) fn position_cycle() -> (Cycle, [f64; 2]) {
    at_home(Servo::Position)
}

/// A cycle that closes the loop itself (CST), and the angles of its home in rad.
pub(crate) fn torque_cycle() -> (Cycle, [f64; 2]) {
    at_home(torque_servo(Law::Psmc, false))
}

fn at_home(servo: Servo) -> (Cycle, [f64; 2]) {
    let cycle = cycle_with(servo, fixture(0));
    let home = FiveBar::new(geometry()).unwrap().inverse(TipPoint::new(0.02, 0.0)).unwrap().to_array();
    (cycle, home)
}

/// Waits that differ, so that one taken for the other shows.
pub(super) const WAITS: Waits =
    Waits { boot_up: Duration::from_millis(700), sdo: Duration::from_millis(250), start: Duration::from_millis(500) };

/// The start of the nodes.
const STARTED: [&str; 3] = ["000#0101", "000#0102", "000#010A"];

const COUNTS_PER_REV: f64 = 800_000.0;

/// A frame as candump writes it, such as `201#06000000`; on another bus than the first with its number, `1:201#06000000`.
fn text(frame: &Frame) -> String {
    let bus = if frame.bus() == BusId::FIRST { String::new() } else { format!("{}:", frame.bus()) };
    frame.data().iter().fold(format!("{bus}{:03X}#", frame.id()), |line, byte| line + &format!("{byte:02X}"))
}

/// The frame that [`text`] writes.
fn frame(text: &str) -> Frame {
    let (bus, text) = text.split_once(':').unwrap_or(("0", text));
    let (id, data) = text.split_once('#').unwrap();
    let bytes: Vec<u8> =
        (0..data.len()).step_by(2).map(|at| u8::from_str_radix(&data[at..at + 2], 16).unwrap()).collect();
    Frame::new(u16::from_str_radix(id, 16).unwrap(), &bytes).on_bus(BusId::new(bus.parse().unwrap()))
}

fn axis(scaling: AxisScaling, expected_rad: f64) -> AxisSetup {
    AxisSetup { scaling, expected_rad, home: None }
}

fn scaling(zero_offset_rad: f64) -> AxisScaling {
    AxisScaling::new(COUNTS_PER_REV, Direction::Same, zero_offset_rad, 60.0).unwrap()
}

fn setup(mode: CommandMode) -> MasterSetup {
    let heartbeat = Duration::from_millis(20);
    let drive = |name: &str, node_id: u8| DriveSetup {
        name: name.into(),
        bus: BusId::FIRST,
        node_id,
        profile: shipped_profile("simulated-servo"),
        heartbeat,
        waits: WAITS,
        torque_limit_per_mille: 1000,
        speed_limit_counts_per_s: 95_493,
        following_error_counts: 12_732,
        homing: None,
    };
    MasterSetup {
        node_id: 127,
        heartbeat,
        period: Duration::from_millis(1),
        mode,
        drives: vec![drive("left", 1), drive("right", 2)],
        sensor: SensorSetup {
            name: "wrist".into(),
            bus: BusId::FIRST,
            link: SensorLink::Canopen(SensorNode {
                node_id: 10,
                profile: shipped_profile("simulated-force-sensor"),
                heartbeat,
                start: SensorStart::default(),
            }),
            waits: WAITS,
            sample_period: Duration::from_millis(1),
        },
    }
}

/// The objects that the nodes of a healthy network show: node (128 more on bus 1), index, sub-index to value.
fn objects() -> BTreeMap<(u8, u16, u8), u32> {
    let mut objects = BTreeMap::new();
    for node in [1, 2] {
        objects.insert((node, 0x1000, 0), 0x0002_0192);
        objects.insert((node, 0x1018, 2), 0x0402);
        objects.insert((node, 0x6502, 0), 0x0000_0380);
        objects.insert((node, 0x608f, 1), 400_000);
        objects.insert((node, 0x608f, 2), 1);
    }
    objects.insert((10, 0x1000, 0), 0x0002_0194);
    objects.insert((10, 0x1018, 2), 0x0404);
    for node in [1, 2, 10] {
        objects.insert((node, 0x1018, 1), 0xffff_5957);
    }
    objects
}

/// A master and the far end of its bus, moment by moment.
struct Net {
    master: Master,
    now: Time,
    sent: Vec<Frame>,
    objects: BTreeMap<(u8, u16, u8), u32>,
    /// Requests in hexadecimal that were answered, per node.
    requests: Vec<(u8, String)>,
    counts: [i32; 2],
    sequence: u8,
}

impl Net {
    fn new(mode: CommandMode) -> Self {
        let (cycle, home) = match mode {
            CommandMode::Torque => torque_cycle(),
            _ => position_cycle(),
        };
        Self::with(cycle, &setup(mode), home.map(|angle| (scaling(0.0), angle)))
    }

    fn with(cycle: Cycle, setup: &MasterSetup, axes: [(AxisScaling, f64); 2]) -> Self {
        let counts = axes.map(|(scaling, angle)| scaling.counts(angle).unwrap() as i32);
        Net {
            master: Master::new((Some(setup), None), axes.map(|(scaling, angle)| axis(scaling, angle)), cycle).unwrap(),
            now: Time(0),
            sent: Vec::new(),
            objects: objects(),
            requests: Vec::new(),
            counts,
            sequence: 0,
        }
    }

    /// The frames that the master has sent since the last call, as text.
    fn take(&mut self) -> Vec<String> {
        std::mem::take(&mut self.sent).iter().map(text).collect()
    }

    fn hear(&mut self, line: &str) {
        self.master.networks_mut().on_packet(self.now, Packet::Can(&frame(line)), &mut self.sent);
    }

    fn wait(&mut self, by: Duration) {
        self.now = self.now + by;
        self.master.networks_mut().poll(self.now, &mut self.sent);
    }

    /// Answers SDO requests until there are none, but for what `except` answers instead.
    fn serve(&mut self, mut except: impl FnMut(u8, &[u8; 8]) -> Option<Option<[u8; 8]>>) {
        for _ in 0..1000 {
            let requests: Vec<Frame> = std::mem::take(&mut self.sent);
            let (requests, rest) = requests.into_iter().partition(|frame| (0x601..=0x67f).contains(&frame.id()));
            self.sent = rest;
            let requests: Vec<Frame> = requests;
            if requests.is_empty() {
                return;
            }
            for request in requests {
                let node = (request.id() - 0x600) as u8 + 128 * request.bus().index() as u8;
                let bytes = *request.bytes();
                if bytes[0] == 0x80 {
                    continue; // an abort has no answer
                }
                let answer = except(node, &bytes).unwrap_or_else(|| Some(self.answer(node, &bytes)));
                if let Some(answer) = answer {
                    self.requests.push((node, text(&request)));
                    let answer = Frame::new(request.id() - 0x80, &answer).on_bus(request.bus());
                    self.master.networks_mut().on_packet(self.now, Packet::Can(&answer), &mut self.sent);
                }
            }
        }
        panic!("the boot does not end");
    }

    fn answer(&mut self, node: u8, request: &[u8; 8]) -> [u8; 8] {
        let [command, low, high, sub, a, b, c, d] = *request;
        let key = (node, u16::from_le_bytes([low, high]), sub);
        if command == 0x40 {
            let [a, b, c, d] = self.objects.get(&key).copied().unwrap_or_default().to_le_bytes();
            // Without a size: four bytes, of which the master knows how many count.
            return [0x42, low, high, sub, a, b, c, d];
        }
        assert!(matches!(command, 0x23 | 0x2b | 0x2f), "an expedited download: {command:02X}");
        self.objects.insert(key, u32::from_le_bytes([a, b, c, d]));
        if key.1 == 0x6060 {
            self.objects.insert((node, 0x6061, 0), u32::from_le_bytes([a, b, c, d]));
        }
        [0x60, low, high, sub, 0, 0, 0, 0]
    }

    /// Boot-ups of all nodes after the reset.
    fn reset(&mut self) {
        self.master.start(self.now, &mut self.sent);
        let reset = ["000#8101", "000#8102", "000#810A", "77F#7F"];
        assert_eq!(self.take(), reset, "a reset of each node, then a heartbeat in Pre-operational");
        for line in ["701#00", "702#00", "70A#00"] {
            assert_eq!(*self.master.networks().phase(), Phase::Resetting);
            self.hear(line);
        }
        assert_eq!(*self.master.networks().phase(), Phase::Configuring);
    }

    /// Up to the exchange of process data.
    fn boot(&mut self) {
        self.reset();
        self.serve(|_, _| None);
        assert_eq!(self.take(), STARTED, "each node is started when all are configured");
        for line in ["701#05", "702#05"] {
            self.hear(line);
            assert_eq!(*self.master.networks().phase(), Phase::Starting);
        }
        self.hear("70A#05");
        assert_eq!(*self.master.networks().phase(), Phase::Operational);
    }

    /// The drives' process data with this statusword in hexadecimal, byte order of the bus.
    fn report(&mut self, statusword: [&str; 2]) {
        for (joint, word) in statusword.into_iter().enumerate() {
            let position = self.counts[joint].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
            self.hear(&format!("18{}#{word}{position}", joint + 1));
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.hear("18A#0000000000000000");
        self.hear(&format!("28A#0000000000{:02X}", self.sequence));
    }

    /// One cycle in which `between` happens beside the process data; the set-points that leave.
    fn cycle(
        &mut self,
        statusword: [&str; 2],
        request: Request,
        between: impl FnOnce(&mut Self),
    ) -> (Outputs, [String; 2]) {
        self.now = self.now + Duration::from_micros(380);
        self.sync();
        self.report(statusword);
        between(self);
        self.now = self.now + Duration::from_micros(620);
        // Heartbeats keep coming.
        for line in ["701#05", "702#05", "70A#05"] {
            if self.sequence.is_multiple_of(16) {
                self.hear(line);
            }
        }
        let outputs = self.master.on_compute(self.now, request, Timing::default(), &mut self.sent);
        let mut sent = self.take();
        sent.retain(|line| line != "77F#05");
        let [left, right] = <[String; 2]>::try_from(sent).unwrap();
        assert!(left.starts_with("201#") && right.starts_with("202#"), "{left} {right}");
        (outputs, [left, right])
    }

    fn sync(&mut self) {
        self.master.networks_mut().open(&mut self.sent);
        assert_eq!(self.take(), ["080#"], "SYNC alone");
    }

    fn compute(&mut self, request: Request) -> Vec<String> {
        self.now = self.now + Duration::from_millis(1);
        self.master.on_compute(self.now, request, Timing::default(), &mut self.sent);
        self.take()
    }

    /// What the cycle has seen of `fault` in the last cycle.
    fn seen(&self, fault: Fault) -> u16 {
        self.master.cycle().faults().count(fault)
    }

    fn quiet(&mut self, statusword: &str, request: Request) -> [String; 2] {
        self.cycle([statusword; 2], request, |_| {}).1
    }

    /// A rig that runs.
    fn running(mode: CommandMode) -> Self {
        let mut net = Self::new(mode);
        net.boot();
        net.quiet("5002", Request::None);
        net.quiet("3102", Request::Enable);
        net.quiet("3302", Request::None);
        net.quiet("3712", Request::None);
        assert_eq!(net.state(), (State::Running, None));
        net
    }

    fn state(&self) -> (State, Option<Fault>) {
        (self.master.cycle().state(), self.master.cycle().cause().map(|cause| cause.fault))
    }
}

fn failure(net: &Net) -> &BootError {
    match net.master.networks().phase() {
        Phase::Failed(error) => error,
        other => panic!("{other:?}"),
    }
}
