//! Both drives on one bus and the sensor on another, where it has the node id that the left drive has here.

use super::*;
use yieldwall_motion::guard::{Device, DeviceSet};

const SENSOR_HERE: u8 = 128 + 1;

impl Net {
    pub(super) fn two_buses() -> Self {
        let (cycle, home) = torque_cycle();
        let mut setup = setup(CommandMode::Torque);
        let node = SensorNode {
            node_id: 1,
            profile: shipped_profile("simulated-force-sensor"),
            heartbeat: setup.heartbeat,
            start: SensorStart::default(),
        };
        (setup.sensor.bus, setup.sensor.link) = (BusId::new(1), SensorLink::Canopen(node));
        let mut net = Self::with(cycle, &setup, home.map(|angle| (scaling(0.0), angle)));
        for ((node, index, sub), value) in objects() {
            if node == 10 {
                net.objects.insert((SENSOR_HERE, index, sub), value);
            }
        }
        net
    }

    fn reset_both(&mut self) {
        self.master.start(self.now, &mut self.sent);
        assert_eq!(self.take(), ["000#8101", "000#8102", "1:000#8101", "77F#7F", "1:77F#7F"]);
        for line in ["701#00", "702#00", "1:701#00"] {
            assert_eq!(*self.master.networks().phase(), Phase::Resetting);
            self.hear(line);
        }
    }

    fn boot_both(&mut self) {
        self.reset_both();
        self.serve(|_, _| None);
        assert_eq!(self.take(), ["000#0101", "000#0102", "1:000#0101"]);
        for line in ["701#05", "702#05", "1:701#05"] {
            assert_eq!(*self.master.networks().phase(), Phase::Starting);
            self.hear(line);
        }
        assert_eq!(*self.master.networks().phase(), Phase::Operational);
    }

    fn report_both(&mut self, statusword: &str) {
        for joint in 0..2 {
            let position = self.counts[joint].to_le_bytes().map(|byte| format!("{byte:02X}")).concat();
            self.hear(&format!("18{}#{statusword}{position}", joint + 1));
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.hear("1:181#0000000000000000");
        self.hear(&format!("1:281#0000000000{:02X}", self.sequence));
    }

    /// One cycle whose frames are seen on both buses but for those of which `is_lost`; what the master sends in it.
    pub(super) fn seen_cycle(
        &mut self,
        statusword: &str,
        request: Request,
        is_lost: impl Fn(&str) -> bool,
    ) -> Vec<String> {
        self.master.networks_mut().open(&mut self.sent);
        let mut sent = std::mem::take(&mut self.sent);
        self.report_both(statusword);
        self.now = self.now + Duration::from_millis(1);
        self.master.on_compute(self.now, request, Timing::default(), &mut self.sent);
        sent.append(&mut self.sent);
        sent.iter().filter(|frame| !is_lost(&text(frame))).for_each(|frame| self.master.networks_mut().on_echo(frame));
        sent.iter().map(text).filter(|line| !line.contains("77F#")).collect()
    }

    pub(super) fn run_both(&mut self) {
        self.boot_both();
        for (word, request) in
            [("5002", Request::None), ("3102", Request::Enable), ("3302", Request::None), ("3712", Request::None)]
        {
            self.seen_cycle(word, request, |_| false);
        }
        assert_eq!(self.state(), (State::Running, None));
    }
}

#[test]
fn each_bus_has_its_own_nodes_and_sync_and_the_rig_waits_for_all() {
    let mut net = Net::two_buses();
    net.boot_both();
    let nodes: Vec<u8> = net.requests.iter().map(|(node, _)| *node).collect();
    assert!([1, 2, SENSOR_HERE].iter().all(|node| nodes.contains(node)), "each was configured on its bus");
    let sent = net.seen_cycle("5002", Request::None, |_| false);
    assert_eq!(sent[..2], ["080#", "1:080#"], "SYNC on both");
    assert!(sent[2].starts_with("201#") && sent[3].starts_with("202#") && sent.len() == 4, "{sent:?}");
    let inputs = net.master.last_inputs();
    assert!(inputs.drives.iter().all(|drive| drive.angle_rad.is_some()) && inputs.sample.is_some());
}

#[test]
fn an_answer_from_another_bus_is_none() {
    let mut net = Net::two_buses();
    net.reset_both();
    net.sent.clear();
    // The right drive was asked for its device type on the first bus.
    net.hear("1:582#4200100092010200");
    assert_eq!(net.take(), Vec::<String>::new());
    net.hear("582#4200100092010200");
    assert_eq!(net.take(), ["602#4018100100000000"]);
}

#[test]
fn frames_of_one_bus_say_nothing_on_the_other() {
    let mut net = Net::two_buses();
    net.boot_both();
    net.master.networks_mut().open(&mut net.sent);
    // What is process data of the left drive on its bus is of the sensor's first TPDO here: eight bytes.
    net.hear("1:181#370200000000");
    net.hear("182#370200000000");
    net.compute(Request::None);
    let inputs = *net.master.last_inputs();
    assert_eq!((inputs.drives[0].angle_rad, inputs.link.bad_length), (None, DeviceSet::SENSOR));
    // A set-point of the drives is nobody's on the sensor's bus; SYNC is the master's on both.
    for (line, is_intruder) in [("1:201#06000000", false), ("201#06000000", true), ("1:080#", true)] {
        net.hear(line);
        net.compute(Request::None);
        assert_eq!(net.master.last_inputs().link.intruder, is_intruder, "{line}");
    }
}

#[test]
fn nodes_with_the_same_id_are_watched_apart() {
    let mut net = Net::two_buses();
    net.boot_both();
    net.seen_cycle("5002", Request::None, |_| false);
    net.now = net.now + Duration::from_millis(30);
    for line in ["701#05", "702#05"] {
        net.hear(line);
    }
    net.wait(Duration::from_millis(11));
    net.compute(Request::None);
    assert_eq!(net.master.last_inputs().link.heartbeat_lost, DeviceSet::SENSOR);
    // One that restarts is not the other one.
    net.hear("1:701#00");
    net.compute(Request::None);
    assert_eq!(net.master.last_inputs().link.node_reset, DeviceSet::SENSOR);
}

#[test]
fn what_nodes_with_the_same_id_tell_is_told_apart() {
    let mut net = Net::two_buses();
    net.boot_both();
    net.hear("1:081#1042200000000000");
    net.hear("081#1042200000000000");
    let devices: Vec<Device> = net.master.networks().told().iter().map(|told| told.device).collect();
    assert_eq!(devices, [Device::Sensor, Device::LeftDrive]);
}

#[test]
fn what_one_bus_holds_back_holds_all_buses() {
    let mut net = Net::two_buses();
    net.run_both();
    assert!(!net.master.networks().is_in_flight());
    // SYNC on the sensor's bus is not seen: the set-points of this cycle still leave, nothing of the next.
    let is_lost = |line: &str| line.starts_with("1:");
    assert_eq!(net.seen_cycle("3712", Request::None, is_lost).len(), 4);
    assert!(net.master.networks().is_in_flight());
    assert_eq!(net.seen_cycle("3712", Request::None, is_lost), Vec::<String>::new());
    assert!(net.master.networks().is_sync_held() && !net.master.networks().is_silent());
    // The second cycle in a row.
    assert_eq!(net.seen_cycle("3712", Request::None, is_lost), Vec::<String>::new());
    assert!(net.master.networks().is_silent());
    assert_eq!(net.state(), (State::Lost, Some(Fault::TransmitStalled)));
    // A frame of another bus is no echo of what was sent on this one.
    let mut net = Net::two_buses();
    net.run_both();
    net.seen_cycle("3712", Request::None, |line| line.starts_with("20"));
    [0x201, 0x202].iter().for_each(|id| net.master.networks_mut().on_echo(&Frame::new(*id, &[]).on_bus(BusId::new(1))));
    assert!(net.master.networks().is_in_flight());
}

#[test]
fn only_a_bus_where_somebody_hears_it_gets_sync() {
    let (cycle, home) = torque_cycle();
    let ids = yieldwall_fieldbus::plain_can::streaming::Ids { command: 0x35f, data: [0x360, 0x361] };
    let link = yieldwall_fieldbus::plain_can::Link {
        protocol: yieldwall_fieldbus::plain_can::Protocol::Streaming(ids),
        pair_gap: Duration::from_micros(500),
        sample_period: Duration::from_millis(1),
        zero_at_start: false,
    };
    let mut setup = setup(CommandMode::Torque);
    (setup.sensor.bus, setup.sensor.link) = (BusId::new(1), SensorLink::PlainCan(link));
    let mut net = Net::with(cycle, &setup, home.map(|angle| (scaling(0.0), angle)));
    net.master.start(net.now, &mut net.sent);
    assert_eq!(net.take(), ["000#8101", "000#8102", "77F#7F"]);
    ["701#00", "702#00"].iter().for_each(|line| net.hear(line));
    net.serve(|_, _| None);
    let started = net.take();
    assert_eq!(started[..2], ["000#0101", "000#0102"]);
    assert!(started[2..].iter().all(|line| line.starts_with("1:35F#")), "orders go to the sensor's bus: {started:?}");
    net.master.networks_mut().open(&mut net.sent);
    assert_eq!(net.take(), ["080#"]);
}
