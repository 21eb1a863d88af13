//! Set-points of somebody else: no SYNC makes a drive act on them.

use super::*;
use proptest::prelude::*;
use yieldwall_motion::guard::DeviceSet;

/// Enable Operation with half of the rated torque.
const FOREIGN: &str = "201#0F00F401";

impl Net {
    /// Hands the master its own frames back, as its interface does when they have been on the bus.
    fn echo(&mut self, sent: &[String]) {
        sent.iter().for_each(|line| self.master.networks_mut().on_echo(&frame(line)));
    }

    /// The begin of a cycle; whether SYNC leaves, and what else.
    fn begin(&mut self) -> Vec<String> {
        self.now = self.now + Duration::from_micros(380);
        self.master.networks_mut().open(&mut self.sent);
        self.take()
    }
}

#[test]
fn after_a_foreign_set_point_no_sync_leaves_before_a_quick_stop_was_seen() {
    for has_echo in [true, false] {
        let mut net = Net::running(CommandMode::Torque);
        let echo = |net: &mut Net, sent: &[String]| {
            if has_echo {
                net.echo(sent)
            }
        };
        let (_, sent) = net.cycle(["3712"; 2], Request::None, |_| {});
        echo(&mut net, &sent);
        net.hear(FOREIGN);
        assert_eq!(net.begin(), [""; 0], "the drive holds the stranger's set-point");
        assert!(net.master.networks().is_sync_held());
        let sent = net.compute(Request::None);
        assert_eq!(sent[..2], ["201#02000000", "202#02000000"]);
        assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)));
        if has_echo {
            // The quick stop is still on its way when the next cycle begins: that is the rule for all set-points.
            echo(&mut net, &sent[..1]);
            assert_eq!(net.begin(), [""; 0]);
            assert_eq!((net.compute(Request::None), net.seen(Fault::TransmitStalled)), (vec![], 1));
            echo(&mut net, &sent[1..]);
        }
        net.sync();
        assert!(!net.master.networks().is_sync_held());
        assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)));
    }
}

#[test]
fn a_foreign_set_point_that_own_ones_follow_holds_no_sync_back() {
    let mut net = Net::running(CommandMode::Torque);
    let (_, sent) = net.cycle(["3712"; 2], Request::None, |net| net.hear(FOREIGN));
    assert_eq!(sent, ["201#02000000", "202#02000000"]);
    net.echo(&sent);
    net.sync();
    assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)));
}

#[test]
fn a_stranger_that_goes_on_keeps_sync_away_and_stays_the_cause() {
    let mut net = Net::running(CommandMode::Position);
    for cycle in 0..300 {
        net.hear("202#0F0000000000");
        assert_eq!(net.begin(), [""; 0]);
        let sent = net.compute(Request::None);
        assert!(sent[0].starts_with("201#0200") && sent[1].starts_with("202#0200"), "{sent:?}");
        net.echo(&sent);
        // Nodes that nobody asks for process data still say that they are there.
        if cycle % 14 == 0 {
            ["701#05", "702#05", "70A#05"].iter().for_each(|line| net.hear(line));
        }
        assert_eq!(net.state(), (State::Stopped, Some(Fault::Intruder)));
    }
    // Nor can the rig be enabled meanwhile, and the stranger is why.
    for request in [Request::Reset, Request::None, Request::Enable] {
        net.hear("202#0F0000000000");
        assert_eq!(net.begin(), [""; 0]);
        let sent = net.compute(request);
        assert!(sent[..2].iter().all(|line| !line.contains("#0F00") && !line.contains("#0700")), "{sent:?}");
        net.echo(&sent);
    }
    assert_eq!(net.state(), (State::Idle, Some(Fault::Intruder)));
    // When it is quiet the exchange goes on, and a person enables the rig.
    for (word, request) in
        [("5002", Request::None), ("3102", Request::Enable), ("3302", Request::None), ("3712", Request::None)]
    {
        let sent = net.quiet(word, request);
        net.echo(&sent);
    }
    assert_eq!(net.state(), (State::Running, None));
}

#[test]
fn each_rpdo_of_a_drive_is_a_set_point_and_other_frames_of_strangers_hold_no_sync_back() {
    for (line, is_held) in [
        ("201#0F00F401", true),
        ("202#", true),
        ("301#0F00", true),
        ("502#0000000000000000", true),
        ("080#", false),
        ("000#8101", false),
        ("77F#05", false),
        ("203#0F00F401", false),
        ("30A#00", false),
    ] {
        let mut net = Net::running(CommandMode::Torque);
        net.hear(line);
        assert_eq!(net.begin().is_empty(), is_held, "{line}");
        net.compute(Request::None);
        let is_intruder = net.state() == (State::Stopped, Some(Fault::Intruder));
        assert_eq!(is_intruder, is_held || ["080#", "000#8101", "77F#05"].contains(&line), "{line}");
    }
}

#[test]
fn a_master_that_was_silent_or_starts_anew_has_forgotten_no_stranger_and_goes_on() {
    let mut net = Net::running(CommandMode::Torque);
    net.master.networks_mut().on_link(BusId::FIRST, LinkEvent::SendFailed);
    net.begin();
    net.compute(Request::None);
    assert!(net.master.networks().is_silent());
    net.hear(FOREIGN);
    net.begin();
    net.compute(Request::None);
    net.begin();
    // A person resets: Shutdown leaves before SYNC does.
    net.report(["5002"; 2]);
    assert_eq!(net.compute(Request::Reset)[..2], ["201#06000000", "202#06000000"]);
    net.sync();
    // A network that is started anew has drives that were reset.
    let mut net = Net::running(CommandMode::Torque);
    net.hear(FOREIGN);
    net.take();
    net.boot();
    net.sync();
    // What a drill repeats makes no drive act on it either.
    net.hear(FOREIGN);
    net.master.networks_mut().repeat_sync(&mut net.sent);
    assert_eq!(net.take(), [""; 0]);
}

#[test]
fn what_is_heard_on_one_bus_holds_sync_on_all() {
    let mut net = Net::two_buses();
    net.run_both();
    net.hear("202#0F00F401");
    assert_eq!(net.seen_cycle("3712", Request::None, |_| false), ["201#02000000", "202#02000000"]);
    assert_eq!(net.seen_cycle("3712", Request::None, |_| false)[..2], ["080#", "1:080#"]);
    // The same identifier on the sensor's bus is nobody's set-point.
    let mut net = Net::two_buses();
    net.run_both();
    net.hear("1:202#0F00F401");
    assert_eq!(net.seen_cycle("3712", Request::None, |_| false)[..2], ["080#", "1:080#"]);
    assert_eq!(net.master.last_inputs().link.bad_length, DeviceSet::NONE);
}

#[test]
fn an_sdo_download_of_somebody_else_stops_a_rig_that_is_enabled_until_it_is_booted_anew() {
    // 1016h:1 = 0 expedited, 6007h = 0 expedited, and the begins of a download in segments and of one by block.
    for line in ["601#2316100100000000", "602#2B07600000000000", "60A#2100100104000000", "601#C200160104000000"] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!(
            (net.state(), net.master.networks().foreign_downloads()),
            ((State::Stopped, Some(Fault::Intruder)), 1),
            "{line}"
        );
        // The node keeps what was written: a reset is not enough.
        net.quiet("5002", Request::Reset);
        net.quiet("3102", Request::Enable);
        assert_eq!(net.state(), (State::Idle, Some(Fault::Intruder)), "{line}");
        net.boot();
        net.quiet("3102", Request::Enable);
        assert_eq!(net.state(), (State::Enabling, None), "{line}");
        // While nothing is enabled it is only told.
        let mut net = Net::new(CommandMode::Torque);
        net.boot();
        net.hear(line);
        net.quiet("3102", Request::Enable);
        assert_eq!((net.state(), net.master.networks().foreign_downloads()), ((State::Enabling, None), 1), "{line}");
    }
    // Reading, its segments and blocks, an abort, the end of a block, and downloads to a node that is not ours.
    for line in [
        "601#4041600000000000",
        "601#6000000000000000",
        "601#A000160108000000",
        "601#A300000000000000",
        "601#8000000000000000",
        "601#C100000000000000",
        "603#2316100100000000",
        "601#",
        "581#6000100000000000",
    ] {
        let mut net = Net::running(CommandMode::Torque);
        net.cycle(["3712"; 2], Request::None, |net| net.hear(line));
        assert_eq!((net.state(), net.master.networks().foreign_downloads()), ((State::Running, None), 0), "{line}");
    }
}

/// Two drives that keep the last set-point: whether that of each is the stranger's.
#[derive(Default)]
struct Latch([bool; 2]);

impl Latch {
    /// Whether a frame makes a drive act on a set-point of the stranger.
    fn hears(&mut self, line: &str, is_foreign: bool) -> bool {
        for (kept, id) in self.0.iter_mut().zip(["201#", "202#"]) {
            *kept = if line.starts_with(id) { is_foreign } else { *kept };
        }
        line == "080#" && self.0 != [false; 2]
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// At every place of a cycle, once or again, with and without echoes, and whatever a person asks for.
    #[test]
    fn no_order_of_frames_makes_a_drive_act_on_a_strangers_set_point(
        places in proptest::collection::vec((0..4_u8, 0..2_usize), 1..30),
        requests in proptest::collection::vec(0..12_u8, 30),
        has_echo: bool,
    ) {
        let mut net = Net::running(CommandMode::Torque);
        let mut latch = Latch::default();
        for ((place, joint), request) in places.iter().zip(requests) {
            let foreign = ["201#0F00F401", "202#0F00F401"][*joint];
            let request = match request {
                0 => Request::Reset,
                1 => Request::Enable,
                2 => Request::Stop,
                _ => Request::None,
            };
            let strike = |net: &mut Net, latch: &mut Latch, here: u8| {
                if *place == here {
                    net.hear(foreign);
                    latch.hears(foreign, true);
                }
            };
            strike(&mut net, &mut latch, 0);
            for line in net.begin() {
                prop_assert!(!latch.hears(&line, false), "a stranger at place {place}");
            }
            strike(&mut net, &mut latch, 1);
            if !net.master.networks().is_sync_held() {
                net.report(["3712"; 2]);
            }
            let sent = net.compute(request);
            // On the bus before the first own set-point, between them, or behind both.
            for (at, line) in sent.iter().enumerate() {
                if at == 1 {
                    strike(&mut net, &mut latch, 2);
                }
                latch.hears(line, false);
                if has_echo {
                    net.master.networks_mut().on_echo(&frame(line));
                }
            }
            strike(&mut net, &mut latch, 3);
        }
    }
}
