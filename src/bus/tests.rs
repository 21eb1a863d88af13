//! The master against frames written by hand.

use std::collections::BTreeMap;
use std::time::Duration;

use super::*;
use crate::canopen::{Frame, Time};
use crate::cycle::tests::{position_cycle, torque_cycle};
use crate::cycle::{Cycle, Outputs, Timing};
use crate::guard::{Fault, Request, State};
use yieldwall_drives::profiles::{SIMULATED_FORCE_SENSOR, SIMULATED_SERVO};
use yieldwall_drives::scaling::{AxisScaling, Direction};

const COUNTS_PER_REV: f64 = 800_000.0;

/// A frame as candump writes it, such as `201#06000000`.
fn text(frame: &Frame) -> String {
    frame.data().iter().fold(format!("{:03X}#", frame.id()), |line, byte| line + &format!("{byte:02X}"))
}

/// The frame that [`text`] writes.
fn frame(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let bytes: Vec<u8> =
        (0..data.len()).step_by(2).map(|at| u8::from_str_radix(&data[at..at + 2], 16).unwrap()).collect();
    Frame::new(u16::from_str_radix(id, 16).unwrap(), &bytes)
}

fn setup(mode: CommandMode, home: [f64; 2], zero_offset_rad: f64) -> MasterSetup {
    let scaling = AxisScaling::new(COUNTS_PER_REV, Direction::Same, zero_offset_rad, 60.0).unwrap();
    let heartbeat = Duration::from_millis(20);
    let drive = |name: &str, node_id: u8, expected_angle_rad: f64| DriveSetup {
        name: name.into(),
        node_id,
        profile: &SIMULATED_SERVO,
        scaling,
        expected_angle_rad,
        heartbeat,
        torque_limit_per_mille: 1000,
        following_error_counts: 12_732,
    };
    MasterSetup {
        node_id: 127,
        heartbeat,
        period: Duration::from_millis(1),
        mode,
        drives: [drive("left", 1, home[0]), drive("right", 2, home[1])],
        sensor: SensorSetup {
            name: "wrist".into(),
            link: SensorLink::Canopen(SensorNode { node_id: 10, profile: &SIMULATED_FORCE_SENSOR, heartbeat }),
            sample_period: Duration::from_millis(1),
        },
    }
}

/// The objects that the nodes of a healthy network show: node, index, sub-index to value.
fn objects() -> BTreeMap<(u8, u16, u8), u32> {
    let mut objects = BTreeMap::new();
    for node in [1, 2] {
        objects.insert((node, 0x1000, 0), 0x0002_0192);
        objects.insert((node, 0x1018, 2), 0x0402);
        objects.insert((node, 0x6502, 0), 0x0000_0380);
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
        Self::with(cycle, setup(mode, home, 0.0), home)
    }

    fn with(cycle: Cycle, setup: MasterSetup, home: [f64; 2]) -> Self {
        let counts = home.map(|angle| setup.drives[0].scaling.counts(angle).unwrap() as i32);
        Net {
            master: Master::new(&setup, cycle).unwrap(),
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
        self.master.on_frame(self.now, &frame(line), &mut self.sent);
    }

    fn wait(&mut self, by: Duration) {
        self.now = self.now + by;
        self.master.poll(self.now, &mut self.sent);
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
                let node = (request.id() - 0x600) as u8;
                let bytes = *request.bytes();
                if bytes[0] == 0x80 {
                    continue; // an abort has no answer
                }
                let answer = except(node, &bytes).unwrap_or_else(|| Some(self.answer(node, &bytes)));
                if let Some(answer) = answer {
                    self.requests.push((node, text(&request)));
                    self.master.on_frame(self.now, &Frame::new(0x580 + u16::from(node), &answer), &mut self.sent);
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
        [0x60, low, high, sub, 0, 0, 0, 0]
    }

    /// Boot-ups of all nodes after the reset.
    fn reset(&mut self) {
        self.master.start(self.now, &mut self.sent);
        assert_eq!(self.take(), ["000#8100", "77F#7F"], "reset of all nodes, then a heartbeat in Pre-operational");
        for line in ["701#00", "702#00", "70A#00"] {
            assert_eq!(*self.master.phase(), Phase::Resetting);
            self.hear(line);
        }
        assert_eq!(*self.master.phase(), Phase::Configuring);
    }

    /// Up to the exchange of process data.
    fn boot(&mut self) {
        self.reset();
        self.serve(|_, _| None);
        assert_eq!(self.take(), ["000#0100"], "all nodes are started when all are configured");
        for line in ["701#05", "702#05"] {
            self.hear(line);
            assert_eq!(*self.master.phase(), Phase::Starting);
        }
        self.hear("70A#05");
        assert_eq!(*self.master.phase(), Phase::Operational);
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
        self.master.on_sync(&mut self.sent);
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
    match net.master.phase() {
        Phase::Failed(error) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_boot_of_a_torque_drive_is_this_sequence() {
    let mut net = Net::new(CommandMode::Torque);
    net.boot();
    let left: Vec<&str> = net.requests.iter().filter(|(node, _)| *node == 1).map(|(_, line)| line.as_str()).collect();
    let read = |object: &str| format!("601#40{object}00000000");
    let mut expected: Vec<String> = ["001000", "181001", "181002", "026500"].map(read).to_vec();
    let mut write = |command: &str, object: &str, value: &str, is_verified: bool| {
        expected.push(format!("601#{command}{object}{value:0<8}"));
        if is_verified {
            expected.push(read(object));
        }
    };
    write("2B", "171000", "1400", true); // heartbeat every 20 ms
    write("23", "161001", "28007F00", true); // watch node 127 for 40 ms
    write("2B", "076000", "0300", true); // quick stop when it is lost
    write("2F", "291001", "00", true); // and Pre-operational
    write("2B", "5A6000", "0200", true); // quick stop ramp, then Switch On Disabled
    write("2F", "C26001", "01", true); // 1 ...
    write("2F", "C26002", "FD", true); // ... ms
    write("2F", "606000", "0A", false); // cyclic synchronous torque
    write("2B", "726000", "E803", true); // 100 % torque at most
    write("23", "656000", "BC310000", true); // following error window
    write("23", "001401", "01020080", false); // RPDO 1 off
    write("2F", "001600", "00", false);
    write("23", "001601", "10004060", true); // controlword, 16 bits
    write("23", "001602", "10007160", true); // target torque, 16 bits
    write("2F", "001600", "02", true);
    write("2F", "001402", "01", true); // at every SYNC
    write("2B", "001405", "0500", true); // deadline of 5 ms
    write("23", "001401", "01020000", true); // RPDO 1 on
    write("23", "001801", "81010080", false); // TPDO 1 off
    write("2F", "001A00", "00", false);
    write("23", "001A01", "10004160", true); // statusword, 16 bits
    write("23", "001A02", "20006460", true); // position, 32 bits
    write("2F", "001A00", "02", true);
    write("2F", "001802", "01", true);
    write("23", "001801", "81010000", true); // TPDO 1 on
    assert_eq!(left, expected);
}

#[test]
fn nodes_that_start_by_themselves_are_started() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    // Their heartbeats stay the same from here on: there is no further change to wait for.
    for line in ["701#05", "702#05", "70A#05"] {
        net.hear(line);
    }
    net.serve(|_, _| None);
    assert_eq!((net.take(), net.master.phase()), (vec!["000#0100".to_owned()], &Phase::Operational));
}

#[test]
fn a_boot_that_failed_waits_for_nothing_but_its_heartbeat() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|_, _| None);
    net.hear("701#00");
    assert!(matches!(net.master.phase(), Phase::Failed(_)));
    net.wait(Duration::from_secs(1));
    assert_eq!(net.master.next_deadline(), net.now + Duration::from_millis(20));
}

#[test]
fn a_position_drive_gets_its_mode_and_its_target() {
    let mut net = Net::new(CommandMode::Position);
    net.boot();
    let has = |line: &str| net.requests.iter().any(|(_, request)| request == line);
    assert!(has("602#2F60600008000000"), "cyclic synchronous position");
    assert!(has("602#2300160220007A60"), "target position, 32 bits");
    assert!(!has("602#2300160210007160"));
}

#[test]
fn the_walk_to_operation_is_one_controlword_a_cycle_and_only_on_request() {
    let mut net = Net::new(CommandMode::Torque);
    net.boot();
    for _ in 0..3 {
        assert_eq!(net.quiet("5002", Request::None), ["201#06000000", "202#06000000"], "Shutdown");
    }
    for _ in 0..3 {
        assert_eq!(net.quiet("3102", Request::None), ["201#06000000", "202#06000000"], "no further by itself");
    }
    assert_eq!(net.quiet("3102", Request::Enable), ["201#07000000", "202#07000000"], "Switch On");
    assert_eq!(net.quiet("3302", Request::None), ["201#0F000000", "202#0F000000"], "Enable Operation");
    // The right drive takes its time; no torque until both are there.
    let (outputs, sent) = net.cycle(["3712", "3302"], Request::None, |_| {});
    assert_eq!((outputs.directive.state, sent), (State::Enabling, ["201#0F000000".into(), "202#0F000000".into()]));
    assert_eq!(net.quiet("3712", Request::None), ["201#0F000000", "202#0F000000"], "the first torque is zero");
    assert_eq!(net.state(), (State::Running, None));
}

#[test]
fn a_position_target_begins_as_the_measured_position_to_the_count() {
    let mut net = Net::new(CommandMode::Position);
    net.boot();
    net.counts = [310_001, 91_234];
    // 310001 is 04BAF1h, 91234 is 016462h.
    let targets = |word: &str| [format!("201#{word}F1BA0400"), format!("202#{word}62640100")];
    assert_eq!(net.quiet("5002", Request::None), targets("0600"));
    assert_eq!(net.quiet("3102", Request::Enable), targets("0700"));
    assert_eq!(net.quiet("3302", Request::None), targets("0F00"));
    assert_eq!(net.quiet("3712", Request::None), targets("0F00"));
    assert_eq!(net.state(), (State::Running, None));
}

#[test]
fn counts_wrap_at_32_bits_without_a_jump() {
    let (cycle, home) = position_cycle();
    // The drive reads about 2^31 at home.
    let zero = home[0] - std::f64::consts::TAU * 2_147_483_648.0 / COUNTS_PER_REV;
    let mut setup = setup(CommandMode::Position, home, 0.0);
    setup.drives[0].scaling = AxisScaling::new(COUNTS_PER_REV, Direction::Same, zero, 60.0).unwrap();
    let right = (home[1] * COUNTS_PER_REV / std::f64::consts::TAU).round() as i32;
    let mut net = Net::with(cycle, setup, [home[1]; 2]);
    net.boot();
    net.counts = [0x7fff_fff6, right];
    assert!(net.quiet("5002", Request::None)[0].ends_with("F6FFFF7F"));
    let before = net.cycle(["3102"; 2], Request::None, |_| {}).0.signals.measured_angles.0.x;
    net.counts[0] = -0x7fff_fff6;
    let (outputs, sent) = net.cycle(["3102"; 2], Request::None, |_| {});
    assert_eq!(sent[0], "201#06000A000080", "the target wraps with the position");
    let way = outputs.signals.measured_angles.0.x - before;
    let expected = 20.0 / COUNTS_PER_REV * std::f64::consts::TAU;
    assert!((way - expected).abs() < 1e-9, "{way}");
    net.quiet("3102", Request::Enable);
    net.quiet("3302", Request::None);
    net.quiet("3712", Request::None);
    net.counts[0] = 0x7fff_ffff;
    net.quiet("3712", Request::None);
    assert_eq!(net.state(), (State::Running, None), "no jump on the way back");
}

#[test]
fn a_wrong_device_is_named_with_object_and_both_values() {
    for (key, value, step) in [
        ((2, 0x1018, 1), 0x0000_009a, "check the vendor"),
        ((2, 0x1018, 2), 0x0000_0403, "check the product code"),
        ((2, 0x1000, 0), 0x0001_0191, "check the device type"),
        ((2, 0x6502, 0), 0x0000_0180, "check the command mode"),
    ] {
        let mut net = Net::new(CommandMode::Torque);
        net.objects.insert(key, value);
        net.reset();
        net.serve(|_, _| None);
        let error = failure(&net);
        assert_eq!((error.node_id, error.name.as_str(), error.step), (Some(2), "right", step));
        let BootFailure::Identity { index, sub, received, .. } = error.failure else { panic!("{error}") };
        assert_eq!((2, index, sub, received), (key.0, key.1, key.2, value));
        assert!(!net.take().contains(&"000#0100".to_owned()), "nothing is started");
    }
}

#[test]
fn an_abort_a_lie_and_silence_are_named_with_node_step_and_object() {
    // 0609 0030h: value range.
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|node, request| {
        let is_it = node == 1 && request[..4] == [0x2b, 0x72, 0x60, 0x00];
        is_it.then_some(Some([0x80, 0x72, 0x60, 0x00, 0x30, 0x00, 0x09, 0x06]))
    });
    let error = failure(&net);
    assert_eq!((error.node_id, error.step), (Some(1), "set the torque limit"));
    let BootFailure::Refused { index: 0x6072, sub: 0, code } = error.failure else { panic!("{error}") };
    assert_eq!(code.0, 0x0609_0030);

    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|node, request| {
        let is_it = node == 2 && request[..4] == [0x40, 0x07, 0x60, 0x00];
        is_it.then_some(Some([0x4b, 0x07, 0x60, 0x00, 0x01, 0, 0, 0]))
    });
    let expected = BootFailure::ReadBack { index: 0x6007, sub: 0, written: 3, received: 1 };
    assert_eq!((failure(&net).node_id, &failure(&net).failure), (Some(2), &expected));

    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|node, request| (node == 10 && request[1..4] == [0x17, 0x10, 0x00]).then_some(None));
    assert_eq!(*net.master.phase(), Phase::Configuring);
    net.wait(Duration::from_millis(249));
    assert_eq!(*net.master.phase(), Phase::Configuring);
    net.take();
    net.wait(Duration::from_millis(1));
    let error = failure(&net);
    assert_eq!((error.node_id, error.name.as_str(), error.step), (Some(10), "wrist", "set the heartbeat"));
    assert_eq!(error.failure, BootFailure::NoAnswer { index: 0x1017, sub: 0 });
    assert!(net.take().contains(&"60A#8017100000000405".to_owned()), "the device is told that it took too long");
}

#[test]
fn a_missing_node_is_named() {
    let mut net = Net::new(CommandMode::Torque);
    net.master.start(net.now, &mut net.sent);
    net.hear("701#00");
    net.hear("70A#00");
    net.wait(Duration::from_millis(499));
    assert_eq!(*net.master.phase(), Phase::Resetting);
    net.wait(Duration::from_millis(1));
    let error = failure(&net);
    assert_eq!((error.node_id, error.name.as_str()), (Some(2), "right"));
    assert_eq!(error.failure, BootFailure::Missing { waited_ms: 500 });
}

#[test]
fn a_node_that_restarts_while_it_is_configured_is_configured_anew() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    // The left drive restarts in the middle and forgets what was written.
    let mut restarted = false;
    net.serve(|node, request| {
        restarted |= node == 1 && request[..4] == [0x2b, 0x72, 0x60, 0x00];
        (restarted && node == 1).then_some(None)
    });
    net.objects = objects();
    net.requests.clear();
    net.hear("701#00");
    net.serve(|_, _| None);
    let left = net.requests.iter().filter(|(node, line)| *node == 1 && line.contains("#2B17100014"));
    assert_eq!(left.count(), 1, "the heartbeat is written again");
    assert_eq!(net.objects.get(&(1, 0x6007, 0)), Some(&3), "and so is the reaction to a lost master");
    assert_eq!(*net.master.phase(), Phase::Starting);
    // After that a restart is too late.
    net.hear("701#00");
    assert_eq!(failure(&net).failure, BootFailure::Restarted { times: 1 });
}

#[test]
fn a_node_that_keeps_restarting_is_given_up() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    for _ in 0..3 {
        net.hear("702#00");
        assert_eq!(*net.master.phase(), Phase::Configuring);
    }
    net.hear("702#00");
    assert_eq!((failure(&net).node_id, &failure(&net).failure), (Some(2), &BootFailure::Restarted { times: 4 }));
}

#[test]
fn node_ids_are_checked_before_anything_is_sent() {
    for (ids, wanted) in [
        ([1, 1, 10], BootFailure::DuplicateNodeId { node_id: 1 }),
        ([1, 127, 10], BootFailure::DuplicateNodeId { node_id: 127 }),
        ([1, 2, 128], BootFailure::NodeId { node_id: 128 }),
        ([0, 2, 10], BootFailure::NodeId { node_id: 0 }),
    ] {
        let (cycle, home) = torque_cycle();
        let mut setup = setup(CommandMode::Torque, home, 0.0);
        let SensorLink::Canopen(sensor) = &mut setup.sensor.link else { unreachable!() };
        [setup.drives[0].node_id, setup.drives[1].node_id, sensor.node_id] = ids;
        let Err(error) = Master::new(&setup, cycle) else { panic!("{ids:?} were taken") };
        assert_eq!(error.failure, wanted);
    }
}

#[test]
fn what_happens_on_the_bus_stops_both_drives_in_the_same_cycle() {
    let stop = |sent: &[String; 2]| sent[0].starts_with("201#0200") && sent[1].starts_with("202#0200");
    for mode in [CommandMode::Torque, CommandMode::Position] {
        for (line, state, fault) in [
            ("702#00", State::Stopped, Fault::NodeReset),               // boot-up
            ("701#7F", State::Lost, Fault::HeartbeatLost),              // Pre-operational
            ("70A#04", State::Lost, Fault::HeartbeatLost),              // Stopped
            ("082#1186201122334455", State::Stopped, Fault::Emergency), // 8611h: following error
        ] {
            let mut net = Net::running(mode);
            let (_, sent) = net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
            assert_eq!(net.state(), (state, Some(fault)), "{line}");
            assert!(stop(&sent), "{line}: {sent:?}");
        }
        // An emergency that ends is no fault, and strangers do not count.
        for line in ["081#0000000000000000", "083#1186200000000000", "703#00", "183#000000000000"] {
            let mut net = Net::running(mode);
            net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
            assert_eq!(net.state(), (State::Running, None), "{line}");
        }
        // A drive that leaves, one that faults.
        let mut net = Net::running(mode);
        let (_, sent) = net.cycle(["3312", "3712"], Request::None, |_| {});
        assert_eq!(net.state(), (State::Stopped, Some(Fault::DriveLeftOperation)));
        assert!(stop(&sent), "{sent:?}");
        let mut net = Net::running(mode);
        let (_, sent) = net.cycle(["3712", "1802"], Request::None, |_| {});
        assert_eq!(net.state(), (State::Disabled, Some(Fault::DriveFault)));
        // A drive in Fault hears nothing but a reset; the other one stops.
        assert!(sent[0].starts_with("201#0200") && sent[1].starts_with("202#0000"), "{sent:?}");
    }
}

#[test]
fn the_emergency_is_kept_for_reports() {
    let mut net = Net::running(CommandMode::Torque);
    net.cycle(["3712"; 2], Request::None, |net| net.hear("082#1042200000000000"));
    let emergency = net.master.last_emergency().unwrap();
    assert_eq!((emergency.node.raw(), emergency.code.0), (2, 0x4210));
}

#[test]
fn the_first_frame_of_a_cycle_counts_and_a_wrong_length_is_a_miss() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.cycle(["3712"; 2], Request::None, |_| {}).0.signals.measured_angles;
    // A duplicate with a far position and another state.
    let (outputs, _) = net.cycle(["3712"; 2], Request::None, |net| net.hear("181#0800FFFFFF0F"));
    assert_eq!(outputs.signals.measured_angles, before);
    assert_eq!(net.state(), (State::Running, None));
    for (cycle, state) in [(1, State::Running), (2, State::Stopped)] {
        net.now = net.now + Duration::from_micros(380);
        net.master.on_sync(&mut net.sent);
        net.hear("181#37120000");
        net.hear("182#3712000000000000");
        net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        assert_eq!(net.state().0, state, "cycle {cycle}");
    }
    assert_eq!(net.state().1, Some(Fault::PdoLength));
}

#[test]
fn half_a_force_sample_is_none() {
    let mut net = Net::running(CommandMode::Position);
    for (cycle, state) in [(1, State::Running), (2, State::Running), (3, State::Holding)] {
        net.master.on_sync(&mut net.sent);
        for joint in 0..2 {
            let position = net.counts[joint].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
            net.hear(&format!("18{}#3712{position}", joint + 1));
        }
        net.hear("18A#0000000000000000");
        net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        assert_eq!(net.state().0, state, "cycle {cycle}");
    }
}

#[test]
fn a_heartbeat_that_stays_away_stops_the_rig_after_two_periods() {
    let mut net = Net::running(CommandMode::Torque);
    net.hear("701#05");
    net.hear("702#05");
    net.hear("70A#05");
    net.wait(Duration::from_millis(39));
    net.hear("701#05");
    net.hear("70A#05");
    net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(net.state().0, State::Running);
    net.wait(Duration::from_millis(1));
    net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(net.state(), (State::Lost, Some(Fault::HeartbeatLost)));
}

#[test]
fn a_node_that_is_lost_or_has_restarted_keeps_the_rig_from_being_enabled_again() {
    // The left drive still answers with process data, as one that starts by itself would.
    for (line, cured_by, state, fault, is_curable) in [
        ("701#7F", "701#05", State::Lost, Fault::HeartbeatLost, true),
        ("701#00", "701#05", State::Stopped, Fault::NodeReset, false),
        ("70A#04", "70A#05", State::Lost, Fault::HeartbeatLost, true),
    ] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!(net.state(), (state, Some(fault)), "{line}");
        net.quiet("5002", Request::Reset);
        net.quiet("3102", Request::Enable);
        assert_eq!(net.state(), (State::Idle, Some(fault)), "{line}: it is still so");
        net.cycle(["3102"; 2], Request::None, |net| net.hear(cured_by));
        net.quiet("3102", Request::None);
        net.quiet("3102", Request::Enable);
        assert_eq!(net.state().0 == State::Enabling, is_curable, "{line}");
    }
}

#[test]
fn a_node_that_is_lost_before_all_are_started_is_named() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.serve(|_, _| None);
    net.hear("701#05");
    net.hear("702#05");
    // The left drive falls silent, the others go on.
    for _ in 0..60 {
        net.wait(Duration::from_millis(10));
        net.hear("702#05");
        if net.now >= Time(100_000_000) {
            net.hear("70A#05");
        }
    }
    assert_eq!((failure(&net).node_id, failure(&net).step), (Some(1), "start the node"));
}

#[test]
fn own_frames_that_cannot_be_sent_are_the_end() {
    let mut net = Net::running(CommandMode::Torque);
    net.master.on_link(LinkEvent::SendFailed);
    net.master.on_sync(&mut net.sent);
    net.take();
    net.report(["3712"; 2]);
    for cycle in 0..100 {
        net.now = net.now + Duration::from_millis(1);
        net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        net.master.on_sync(&mut net.sent);
        assert_eq!(net.state(), (State::Lost, Some(Fault::LinkDown)));
        assert_eq!(net.take(), [""; 0], "cycle {cycle}: nothing keeps the drives' watchdogs from acting");
    }
    // Asked for by a person, the exchange goes on: the nodes have to be found anew.
    net.report(["5002"; 2]);
    net.master.on_compute(net.now, Request::Reset, Timing::default(), &mut net.sent);
    assert_eq!(net.state().0, State::Idle);
    assert_eq!(net.take()[..2], ["201#06000000", "202#06000000"]);
}

#[test]
fn a_fault_reset_is_one_edge_for_one_request() {
    let mut net = Net::running(CommandMode::Torque);
    for _ in 0..5 {
        let (_, sent) = net.cycle(["1802", "5002"], Request::None, |_| {});
        assert_eq!(sent, ["201#00000000", "202#02000000"], "no reset by itself");
    }
    let mut words = Vec::new();
    for cycle in 0..8 {
        let request = if cycle == 0 { Request::Reset } else { Request::None };
        words.push(net.cycle(["1802", "5002"], request, |_| {}).1[0].clone());
    }
    assert_eq!(words.iter().filter(|line| *line == "201#80000000").count(), 1, "{words:?}");
    let at = words.iter().position(|line| line == "201#80000000").unwrap();
    assert!(words[..at].last().is_some_and(|line| line == "201#00000000"), "bit 7 was low before: {words:?}");
    assert_eq!(net.state().0, State::Idle);
}

#[test]
fn no_bytes_from_the_bus_panic_or_enable() {
    use proptest::prelude::*;
    let frames = proptest::collection::vec((0..0x800u16, proptest::collection::vec(any::<u8>(), 0..9), 0..3u8), 0..200);
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig { cases: 60, ..ProptestConfig::default() });
    let run = runner.run(&frames, |frames| {
        let mut net = Net::new(CommandMode::Torque);
        net.boot();
        for (id, data, kind) in frames {
            // Two thirds to identifiers that mean something.
            let id = [id, 0x181 + id % 2, [0x701, 0x702, 0x70a, 0x081, 0x18a, 0x28a, 0x581][usize::from(id % 7)]];
            net.master.on_frame(net.now, &Frame::new(id[usize::from(kind)], &data), &mut net.sent);
            net.now = net.now + Duration::from_micros(100);
            net.master.poll(net.now, &mut net.sent);
            net.master.on_sync(&mut net.sent);
            net.master.on_compute(net.now, Request::None, Timing::default(), &mut net.sent);
        }
        for line in net.take().iter().filter(|line| line.starts_with("201#") || line.starts_with("202#")) {
            prop_assert!(line.ends_with("#06000000") || line.ends_with("#00000000"), "{line}");
        }
        Ok(())
    });
    run.unwrap();
}

/// The left drive's process data with its position moved by `counts`.
fn left_at(net: &Net, counts: i32) -> String {
    let position = (net.counts[0] + counts).to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
    format!("181#3712{position}")
}

#[test]
fn a_frame_after_the_computation_is_late_and_not_used() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.cycle(["3712"; 2], Request::None, |_| {}).0.signals.measured_angles;
    // The left drive's frame misses its cycle ...
    net.sync();
    let right = net.counts[1].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
    net.hear(&format!("182#3712{right}"));
    net.hear("18A#0000000000000000");
    net.sequence = net.sequence.wrapping_add(1);
    net.hear(&format!("28A#0000000000{:02X}", net.sequence));
    net.compute(Request::None);
    assert_eq!(net.seen(Fault::PdoMissed), 1);
    // ... and comes with another position before the next SYNC.
    net.hear(&left_at(&net, 500));
    let (outputs, _) = net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(outputs.signals.measured_angles, before);
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated), net.seen(Fault::PdoMissed)), (1, 0, 0));
    assert_eq!(net.master.cycle().faults().devices(Fault::PdoLate), crate::guard::DeviceSet::LEFT_DRIVE);
    // Nothing is owed any more: a second frame now is a duplicate.
    net.cycle(["3712"; 2], Request::None, |net| net.hear(&left_at(net, 500)));
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (0, 1));
    assert_eq!(net.state(), (State::Running, None));
}

#[test]
fn of_two_frames_the_second_counts_if_one_was_owed() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.cycle(["3712"; 2], Request::None, |_| {}).0.signals.measured_angles;
    net.sync();
    net.compute(Request::None);
    assert_eq!(net.seen(Fault::PdoMissed), 1, "a cycle without any process data");
    net.sync();
    net.hear(&left_at(&net, 500));
    net.report(["3712"; 2]);
    net.compute(Request::None);
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (1, 0));
    let (outputs, _) = net.cycle(["3712"; 2], Request::None, |_| {});
    assert_eq!(outputs.signals.measured_angles, before, "the late position was not used");
    assert_eq!(net.state().1, None);
}

#[test]
fn of_two_samples_in_a_cycle_the_newer_counts() {
    let mut net = Net::running(CommandMode::Position);
    // Before its time the next sample comes: the first was the late one.
    net.cycle(["3712"; 2], Request::None, |net| {
        net.sequence = net.sequence.wrapping_add(1);
        let line = format!("28A#0000000000{:02X}", net.sequence);
        net.hear(&line);
    });
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (1, 0));
    net.cycle(["3712"; 2], Request::None, |net| {
        let line = format!("28A#0000000000{:02X}", net.sequence);
        net.hear(&line);
    });
    assert_eq!((net.seen(Fault::PdoLate), net.seen(Fault::PdoDuplicated)), (0, 1));
    // The status byte says that the sample is not valid.
    net.sync();
    for joint in 0..2 {
        let position = net.counts[joint].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
        net.hear(&format!("18{}#3712{position}", joint + 1));
    }
    net.hear("18A#0000000000000000");
    net.hear(&format!("28A#0000000002{:02X}", net.sequence.wrapping_add(1)));
    net.compute(Request::None);
    assert_eq!(net.state(), (State::Holding, Some(Fault::SensorInvalid)));
}

#[test]
fn frames_that_only_the_master_sends_are_those_of_an_intruder() {
    for line in ["000#8101", "080#", "201#0F000000", "202#", "77F#05"] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)), "{line}");
        // Own frames are none.
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.master.on_echo(&frame(line)));
        assert_eq!(net.state(), (State::Running, None), "{line}");
    }
    for line in ["601#4041600000000000", "203#06000000", "77E#05", "7E5#0000000000000000"] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!(net.state(), (State::Running, None), "{line}");
    }
}

#[test]
fn two_devices_with_one_node_id_are_found_by_their_heartbeats() {
    // Heartbeats of the left drive, ms after the rig runs; its period is 20 ms.
    let found = |times: &[u64]| {
        let mut net = Net::running(CommandMode::Torque);
        let start = net.now;
        for &ms in times {
            net.now = start + Duration::from_millis(ms);
            net.hear("701#05");
        }
        net.cycle(["3712"; 2], Request::None, |_| {});
        net.seen(Fault::DuplicateNode) > 0
    };
    assert!(!found(&[20, 40, 60, 80, 100]));
    assert!(!found(&[38, 40, 60, 80]), "one that is late by 18 ms");
    assert!(!found(&[37, 41, 60, 80]), "two in a row that are late");
    assert!(!found(&[40, 40, 60, 80, 100]), "a bus that was blocked for a whole period");
    for offset in 1..20 {
        let times: Vec<u64> = (1..6).flat_map(|period| [20 * period, 20 * period + offset]).collect();
        assert!(found(&times), "another one {offset} ms later");
    }
    // A device is switched on with the factory's node id: its boot-up, and the other one goes on.
    let mut net = Net::running(CommandMode::Torque);
    net.cycle(["3712"; 2], Request::None, |net| net.hear("701#00"));
    assert_eq!((net.state(), net.seen(Fault::DuplicateNode)), ((State::Stopped, Some(Fault::NodeReset)), 0));
    net.cycle(["3712"; 2], Request::None, |net| net.hear("701#05"));
    assert_eq!(net.seen(Fault::DuplicateNode), 1);
}

#[test]
fn a_warning_is_counted_and_the_last_eight_emergencies_are_kept() {
    let mut net = Net::running(CommandMode::Torque);
    // 8140h: recovered from bus-off.
    net.cycle(["3712"; 2], Request::None, |net| net.hear("082#4081110000000000"));
    assert_eq!((net.state(), net.seen(Fault::EmergencyWarning)), ((State::Running, None), 1));
    for code in 1..=10u8 {
        net.hear(&format!("081#{code:02X}FF200000000000"));
    }
    let codes: Vec<u16> = net.master.emergencies().map(|(_, emergency)| emergency.code.0).collect();
    assert_eq!(codes, [0xff03, 0xff04, 0xff05, 0xff06, 0xff07, 0xff08, 0xff09, 0xff0a]);
    assert_eq!(net.master.last_emergency().map(|emergency| emergency.code.0), Some(0xff0a));
}

#[test]
fn at_most_one_cycle_is_in_flight() {
    let mut net = Net::running(CommandMode::Torque);
    let echo = |net: &mut Net, sent: &[String]| sent.iter().for_each(|line| net.master.on_echo(&frame(line)));
    for _ in 0..3 {
        net.sync();
        net.report(["3712"; 2]);
        let sent = net.compute(Request::None);
        echo(&mut net, &sent);
    }
    // One set-point does not leave in time: the next cycle sends nothing, and goes on when it has left.
    net.sync();
    net.report(["3712"; 2]);
    let sent = net.compute(Request::None);
    echo(&mut net, &sent[..1]);
    net.master.on_sync(&mut net.sent);
    assert_eq!(net.take(), [""; 0], "no SYNC behind a set-point that is still on its way");
    assert_eq!(net.compute(Request::None), [""; 0], "and no set-points");
    assert_eq!((net.state().0, net.seen(Fault::TransmitStalled)), (State::Running, 1));
    echo(&mut net, &sent[1..]);
    net.sync();
    net.report(["3712"; 2]);
    let sent = net.compute(Request::None);
    assert_eq!((sent.len() >= 2, net.seen(Fault::TransmitStalled)), (true, 0));
    // None leaves any more: silence at the second cycle.
    net.master.on_sync(&mut net.sent);
    net.compute(Request::None);
    assert!(!net.master.is_silent());
    net.master.on_sync(&mut net.sent);
    net.compute(Request::None);
    assert_eq!(net.state(), (State::Lost, Some(Fault::TransmitStalled)));
    assert!(net.master.is_silent());
    for _ in 0..50 {
        net.master.on_sync(&mut net.sent);
        assert_eq!(net.compute(Request::None), [""; 0]);
    }
    // A person resets: what was on its way is gone, and the exchange goes on.
    net.master.on_sync(&mut net.sent);
    net.compute(Request::Reset);
    net.sync();
    net.report(["5002"; 2]);
    assert_eq!(net.compute(Request::None)[..2], ["201#06000000", "202#06000000"]);
}

#[test]
fn a_cycle_that_failed_is_followed_by_quick_stops_for_good() {
    for mode in [CommandMode::Torque, CommandMode::Position] {
        let mut net = Net::running(mode);
        net.sync();
        net.report(["3712"; 2]);
        net.master.quick_stop_now(net.now, &mut net.sent);
        let sent = net.take();
        assert!(sent[0].starts_with("201#0200") && sent[1].starts_with("202#0200"), "{sent:?}");
        assert!(mode == CommandMode::Position || sent[..2] == ["201#02000000", "202#02000000"], "{sent:?}");
        for request in [Request::None, Request::Reset, Request::Enable, Request::None, Request::None] {
            net.sync();
            net.report(["3102"; 2]);
            let sent = net.compute(request);
            assert!(sent.iter().take(2).all(|line| !line.contains("#0F") && !line.contains("#07")), "{sent:?}");
            assert_eq!(net.master.state(), State::Disabled);
            assert_eq!(net.master.cause().map(|cause| cause.fault), Some(Fault::CyclePanicked));
        }
        net.master.start(net.now, &mut net.sent);
        assert_eq!((net.take(), net.master.phase()), (Vec::new(), &Phase::Operational), "a new master is needed");
    }
}

#[test]
fn a_person_starts_the_network_anew_from_any_phase() {
    let restart = |net: &mut Net| {
        net.take();
        net.requests.clear();
        net.objects = objects();
        net.boot();
        assert_eq!(net.master.state(), State::Idle);
        net.quiet("5002", Request::None);
        net.quiet("3102", Request::Enable);
        net.quiet("3302", Request::None);
        net.quiet("3712", Request::None);
        assert_eq!(net.state(), (State::Running, None));
        assert!(net.requests.iter().any(|(node, line)| *node == 1 && line.contains("#2B17100014")), "configured anew");
    };
    // After a node was reset, from where nothing else leads back.
    let mut net = Net::running(CommandMode::Torque);
    net.cycle(["3712"; 2], Request::None, |net| net.hear("701#00"));
    assert_eq!(net.state(), (State::Stopped, Some(Fault::NodeReset)));
    // The arm was moved by hand meanwhile, further than it can move in a cycle.
    net.counts[0] += 20_000;
    restart(&mut net);
    // In the middle of its run, of its configuration, of its start.
    restart(&mut net);
    net.master.start(net.now, &mut net.sent);
    for line in ["701#00", "702#00", "70A#00"] {
        net.hear(line);
    }
    assert_eq!(*net.master.phase(), Phase::Configuring);
    restart(&mut net);
    // After it failed.
    net.master.start(net.now, &mut net.sent);
    net.wait(Duration::from_millis(500));
    assert!(matches!(net.master.phase(), Phase::Failed(_)));
    restart(&mut net);
    // Out of silence.
    net.master.on_link(LinkEvent::BusOff);
    net.sync();
    net.compute(Request::None);
    assert!(net.master.is_silent());
    restart(&mut net);
}

#[test]
fn a_corrupted_position_leaves_no_wrong_turn_behind() {
    let mut net = Net::running(CommandMode::Position);
    let before = net.quiet("3712", Request::None);
    let angle = |net: &Net| net.master.last_inputs().drives[0].angle_rad.unwrap();
    let (home, counts) = (angle(&net), net.counts[0]);
    // Two steps of almost half the range each: taken as motion they make a whole turn of the counter.
    for report in [counts.wrapping_add(0x7000_0000), counts.wrapping_sub(0x2000_0000)] {
        net.counts[0] = report;
        net.quiet("3712", Request::None);
    }
    net.counts[0] = counts;
    net.quiet("3712", Request::None);
    assert_eq!(angle(&net), home);
    assert!(before[0].starts_with("201#0F00"), "{before:?}");
}
