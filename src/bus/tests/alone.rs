//! Another master on the bus: who hears it sends nothing more.

use super::*;
use yieldwall_motion::guard::DeviceSet;

/// What only a master sends, as the rig of these tests hears it.
fn of_masters() -> Vec<(Frame, Sign)> {
    let mut all: Vec<(Frame, Sign)> = [
        ("000#0100", Sign::Command),
        ("000#8133", Sign::Command),
        ("080#", Sign::Sync),
        ("080#07", Sign::Sync),
        ("77F#00", Sign::Master { node_id: 127 }),
        ("77F#05", Sign::Master { node_id: 127 }),
        ("201#06000000", Sign::SetPoints { number: 1, node_id: 1 }),
        ("402#00", Sign::SetPoints { number: 3, node_id: 2 }),
        ("601#4000100000000000", Sign::Request { node_id: 1 }),
        ("60A#4000100000000000", Sign::Request { node_id: 10 }),
    ]
    .map(|(line, sign)| (frame(line), sign))
    .into();
    all.push((Frame::remote(0x701, 1), Sign::Guarding { node_id: 1 }));
    all.push((Frame::remote(0x755, 1), Sign::Guarding { node_id: 0x55 }));
    all
}

/// What devices send: those of the rig, and one that the rig does not know.
const OF_DEVICES: [&str; 11] = [
    "701#00",
    "702#05",
    "70A#7F",
    "705#05",
    "705#00",
    "081#1081010000000000",
    "085#3081110000000000",
    "181#370200000000",
    "185#00",
    "285#00",
    "581#4200100092010200",
];

/// What leads to a stage of the boot.
type Reach = fn(&mut Net);

impl Net {
    fn hear_frame(&mut self, frame: &Frame) {
        self.master.networks_mut().on_packet(self.now, Packet::Can(frame), &mut self.sent);
    }

    /// Nothing is sent whatever comes and however long it takes.
    fn assert_silent(&mut self, what: &str) {
        for _ in 0..100 {
            self.wait(Duration::from_millis(20));
            OF_DEVICES.iter().for_each(|line| self.hear(line));
        }
        assert_eq!(self.take(), Vec::<String>::new(), "{what}");
        assert!(self.master.networks().is_silent(), "{what}");
    }
}

fn other_master(net: &Net) -> (HeardFrame, bool) {
    match failure(net).failure {
        BootFailure::OtherMaster { heard, has_sent } => (heard, has_sent),
        ref other => panic!("{other}"),
    }
}

#[test]
fn who_hears_a_master_while_it_listens_sends_nothing() {
    for (frame, sign) in of_masters() {
        let mut net = Net::new(CommandMode::Torque);
        net.master.networks_mut().listen();
        OF_DEVICES.iter().for_each(|line| net.hear(line));
        assert_eq!(*net.master.networks().phase(), Phase::Off, "devices are no master");
        net.hear_frame(&frame);
        assert_eq!(other_master(&net), (HeardFrame { frame, sign }, false));
        net.assert_silent(&text(&frame));
    }
}

#[test]
fn who_hears_a_master_while_it_boots_sends_nothing_more() {
    let stages: [(&str, Reach); 4] = [
        ("announced", |net| net.master.networks_mut().announce(net.now, &mut net.sent)),
        ("resetting", |net| {
            net.master.start(net.now, &mut net.sent);
            net.hear("701#00");
        }),
        ("configuring", Net::reset),
        ("starting", |net| {
            net.reset();
            net.serve(|_, _| None);
            net.hear("701#05");
        }),
    ];
    for (frame, sign) in of_masters() {
        for (stage, reach) in stages {
            let mut net = Net::new(CommandMode::Torque);
            net.master.networks_mut().listen();
            reach(&mut net);
            net.take();
            net.hear_frame(&frame);
            let what = format!("{stage}: {}", text(&frame));
            assert_eq!(other_master(&net), (HeardFrame { frame, sign }, true), "{what}");
            assert!(failure(&net).to_string().contains("began at the same moment; nothing was enabled"), "{what}");
            net.assert_silent(&what);
        }
    }
}

#[test]
fn a_person_may_start_anew_when_the_other_master_has_gone() {
    let mut net = Net::new(CommandMode::Torque);
    net.reset();
    net.hear("080#");
    net.take();
    net.objects = objects();
    net.boot();
    net.quiet("5002", Request::None);
}

#[test]
fn the_first_frame_is_a_heartbeat_and_the_nodes_are_left_one_by_one() {
    let mut net = Net::new(CommandMode::Torque);
    net.master.networks_mut().listen();
    net.wait(Duration::from_secs(2));
    assert_eq!(net.take(), Vec::<String>::new());
    net.master.networks_mut().announce(net.now, &mut net.sent);
    assert_eq!(net.take(), ["77F#7F"]);
    net.boot();
    net.take();
    net.master.networks_mut().leave(&mut net.sent);
    assert_eq!(net.take(), ["000#8001", "000#8002", "000#800A"]);
}

#[test]
fn frames_of_devices_are_theirs_alone() {
    let setup = setup(CommandMode::Torque);
    let signs = |devices| Signs::of_devices(&setup, devices);
    let found = |signs: &Signs, line: &str| signs.find(&frame(line)).map(|heard| heard.sign);
    let left = signs(DeviceSet::drive(0));
    for (line, sign) in [
        ("701#7F", Sign::Heartbeat { node_id: 1 }),
        ("081#00", Sign::Emergency { node_id: 1 }),
        ("481#00", Sign::ProcessData { number: 4, node_id: 1 }),
        ("581#00", Sign::Answer { node_id: 1 }),
    ] {
        assert_eq!(found(&left, line), Some(sign));
        assert_eq!(found(&signs(DeviceSet::drive(1) | DeviceSet::SENSOR), line), None, "{line}");
    }
    // What a master sends does not keep a device away.
    assert!(of_masters().iter().all(|(frame, _)| left.find(frame).is_none()));
    assert_eq!(found(&signs(DeviceSet::SENSOR), "28A#00"), Some(Sign::ProcessData { number: 2, node_id: 10 }));
    assert_eq!(found(&left, "1:701#7F"), None, "another bus");
}

#[test]
fn a_rig_with_slow_heartbeats_listens_for_two_of_them() {
    let mut setup = setup(CommandMode::Torque);
    assert_eq!(setup.listening(), LISTENING);
    setup.drives[1].heartbeat = Duration::from_millis(700);
    assert_eq!(setup.listening(), Duration::from_millis(1400));
    setup.heartbeat = Duration::from_secs(3);
    assert_eq!(setup.listening(), Duration::from_secs(6));
}

#[test]
fn what_was_heard_is_said_with_its_identifier_and_meaning() {
    let said = |frame, sign| HeardFrame { frame, sign }.to_string();
    assert_eq!(said(frame("080#2A"), Sign::Sync), "SYNC (identifier 080h, frame 080#2A)");
    assert_eq!(
        said(Frame::remote(0x701, 1), Sign::Guarding { node_id: 1 }),
        "node guarding of node 1 (identifier 701h, frame 701#R)"
    );
}
