//! What only an interface of the kernel can show.

use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hil_tests::Scenario;
use hil_tests::network::{Network, PATIENCE, Real, client, device, hear, transfer};
use yieldwall::bus::LinkEvent;
use yieldwall::canopen::{Frame, SdoOutcome};
use yieldwall::link::CandumpWriter;
use yieldwall::link::{
    Attachment, CanLink, CobFilter, ErrorFrame, LinkError, OtherFrame, Received, SendError, SocketCan,
    SocketCanSettings,
};
use yieldwall::objects::Address;
use yieldwall::time::Time;

/// An interface that this test makes, changes and removes.
struct Own(&'static str);

impl Own {
    fn new(name: &'static str) -> Self {
        ip(&["link", "add", "dev", name, "type", "vcan"]);
        ip(&["link", "set", name, "up"]);
        Self(name)
    }

    fn set(&self, state: &str) {
        ip(&["link", "set", self.0, state]);
    }

    fn link(&self) -> SocketCan {
        Real::open(&SocketCanSettings::everything(self.0))
    }

    fn remove(&self) {
        ip(&["link", "delete", self.0]);
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = Command::new("ip").args(["link", "delete", self.0]).output();
    }
}

fn ip(arguments: &[&str]) {
    let done = Command::new("ip").args(arguments).output().expect("iproute2 is installed");
    assert!(done.status.success(), "ip {}: {}", arguments.join(" "), String::from_utf8_lossy(&done.stderr));
}

fn tc(arguments: &[&str]) -> String {
    let done = Command::new("tc").args(arguments).output().expect("iproute2 is installed");
    assert!(done.status.success(), "tc {}: {}", arguments.join(" "), String::from_utf8_lossy(&done.stderr));
    String::from_utf8_lossy(&done.stdout).into_owned()
}

fn refused(interface: &str) -> LinkError {
    SocketCan::open(&SocketCanSettings::everything(interface)).expect_err("refused")
}

/// All that comes until nothing does for 50 ms: the frames, and how many were lost.
fn count(link: &mut impl CanLink) -> (Vec<Frame>, u32) {
    count_with(link, Duration::from_millis(50))
}

/// The same until nothing comes for so long.
fn count_with(link: &mut impl CanLink, silence: Duration) -> (Vec<Frame>, u32) {
    let (mut frames, mut lost) = (Vec::new(), 0);
    while link.wait(link.now() + silence) {
        while let Some(arrival) = link.receive() {
            match arrival.what {
                Received::Frame(frame) => frames.push(frame),
                Received::Overflow { frames } => lost += frames,
                other => panic!("{other:?}"),
            }
        }
    }
    (frames, lost)
}

#[test]
fn without_the_interface_the_next_thing_to_try_is_said() {
    let message = refused("nosuchcan0").to_string();
    let is_known = ["this kernel has no CAN sockets", "there is no interface `nosuchcan0`"];
    assert!(is_known.iter().any(|begin| message.starts_with(begin)), "{message}");
    assert!(message.contains("hil-tests/vcan") || message.contains("ip link set nosuchcan0 up"), "{message}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn each_way_to_be_unusable_has_its_message() {
    assert!(matches!(refused("vcan9"), LinkError::Missing { others, .. } if others.iter().any(|name| name == "vcan0")));
    assert!(matches!(refused("lo"), LinkError::NotCan { .. }));
    let own = Own::new("ywdown");
    own.set("down");
    let down = refused(own.0);
    assert!(matches!(down, LinkError::Down { bit_rate: None, .. }), "{down}");
    assert!(down.to_string().ends_with("`sudo ip link set ywdown up`"), "{down}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_virtual_interface_has_no_bit_rate_and_passes_for_any() {
    let own = Own::new("ywfacts");
    let settings = SocketCanSettings { bit_rate: Some(125_000), ..SocketCanSettings::everything(own.0) };
    let link = Real::open(&settings);
    let facts = link.facts();
    assert!(facts.is_virtual() && facts.is_up && !facts.has_hardware_time, "{facts:?}");
    let advice: Vec<_> = facts.advice().into_iter().filter(|advice| !advice.contains("modprobe")).collect();
    assert_eq!((facts.bit_rate, facts.restart_ms, advice), (None, None, vec![]));
    assert_eq!((&facts.attachment, facts.queueing.as_deref()), (&Attachment::Virtual, Some("noqueue")));
    // Whether it has an echo of its own is an option of the module.
    let echo = std::fs::read_to_string("/sys/module/vcan/parameters/echo").expect("the module of vcan");
    assert_eq!(facts.has_echo, Some(echo.trim() == "Y"));
    // The kernel has the privilege here to give what is asked for.
    assert!(link.receive_buffer() >= settings.receive_buffer, "{}", link.receive_buffer());
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn what_is_advised_of_a_queue_mends_it() {
    let own = Own::new("ywqueue");
    let advice = || {
        let all = own.link().facts().advice();
        all.into_iter().filter(|advice| advice.contains("queue of")).collect::<Vec<_>>()
    };
    assert_eq!(advice(), [""; 0]);
    for (discipline, len) in [("pfifo", "5"), ("pfifo_fast", "1000")] {
        ip(&["link", "set", own.0, "txqueuelen", len]);
        tc(&["qdisc", "replace", "dev", own.0, "root", discipline]);
        let link = own.link();
        assert_eq!(link.facts().queueing.as_deref(), Some(discipline));
        assert_eq!(link.facts().tx_queue_len.map(|len| len.to_string()).as_deref(), Some(len));
        let said = advice();
        assert_eq!(said.len(), if discipline == "pfifo" { 2 } else { 1 }, "{said:#?}");
        for sentence in said {
            let command = sentence.split('`').rfind(|part| part.starts_with("sudo ")).expect("a command");
            let words: Vec<_> = command.split(' ').skip(1).collect();
            let done = Command::new(words[0]).args(&words[1..]).output().expect("iproute2 is installed");
            assert!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
        }
        assert_eq!(advice(), [""; 0]);
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn only_what_a_filter_lets_through_comes_and_process_data_come_first() {
    let own = Own::new("ywfilter");
    let mut filtered = Real::open(&SocketCanSettings {
        process: vec![CobFilter::only(0x080), CobFilter::only(0x181), CobFilter::only(0x201)],
        services: vec![CobFilter::matching(0x580, 0x780), CobFilter::only(0x701)],
        ..SocketCanSettings::everything(own.0)
    });
    let mut other = own.link();
    for id in [0x581, 0x5ff, 0x600, 0x701, 0x702, 0x181, 0x182, 0x080, 0x201, 0x000, 0x7ff] {
        other.send(&Frame::new(id, &[1])).expect("sent");
    }
    other.send(&Frame::remote(0x181, 8)).expect("sent");
    other.send(&Frame::remote(0x582, 8)).expect("sent");
    let (frames, lost) = count(&mut filtered);
    let ids: Vec<_> = frames.iter().map(|frame| (frame.id(), frame.is_remote())).collect();
    let process = [(0x181, false), (0x080, false), (0x201, false)];
    let services = [(0x581, false), (0x5ff, false), (0x701, false), (0x582, true)];
    assert_eq!((ids, lost), ([&process[..], &services].concat(), 0));

    // Own frames come back, process data first; others get both.
    filtered.send(&Frame::new(0x701, &[5])).expect("sent");
    filtered.send(&Frame::new(0x201, &[6])).expect("sent");
    let echo = hear(&mut filtered, |_| true);
    assert_eq!(echo.what, Received::Echo(Frame::new(0x201, &[6])));
    assert_eq!(hear(&mut filtered, |_| true).what, Received::Echo(Frame::new(0x701, &[5])));
    assert!(!filtered.wait(filtered.now() + Duration::from_millis(50)));
    let both = [Frame::new(0x701, &[5]), Frame::new(0x201, &[6])];
    for frame in both {
        assert_eq!(hear(&mut other, |received| matches!(received, Received::Frame(_))).what, Received::Frame(frame));
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn frames_that_are_none_of_canopen_come_where_they_are_asked_for() {
    let own = Own::new("ywother");
    let everything = SocketCanSettings::everything(own.0);
    let mut asked = Real::open(&SocketCanSettings { hears_others: true, ..everything.clone() });
    let mut plain = Real::open(&everything);
    let send = |text: &str| {
        let done = Command::new("cansend").args([own.0, text]).status().expect("can-utils is installed");
        assert!(done.success(), "cansend {text}");
    };
    send("18FF1234#0102030405060708");
    let other = |id, is_extended, is_fd, length| Received::Other(OtherFrame { id, is_extended, is_fd, length });
    assert_eq!(hear(&mut asked, |_| true).what, other(0x18ff_1234, true, false, 8));
    // An interface with frames of CAN FD.
    let wide = Command::new("ip").args(["link", "set", own.0, "mtu", "72"]).status();
    if wide.is_ok_and(|status| status.success()) {
        send("181##1000102030405060708090A0B");
        assert_eq!(hear(&mut asked, |_| true).what, other(0x181, false, true, 12));
    }
    send("182#05");
    for link in [&mut asked, &mut plain] {
        assert_eq!(hear(link, |_| true).what, Received::Frame(Frame::new(0x182, &[5])));
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_frame_has_the_moment_at_which_it_came_and_not_that_at_which_it_was_taken() {
    let own = Own::new("ywstamp");
    let (mut one, mut other) = (own.link(), own.link());
    for number in 0..5u8 {
        one.send(&Frame::new(0x181, &[number])).expect("sent");
        std::thread::sleep(Duration::from_millis(200));
        for link in [&mut one, &mut other] {
            let arrival = link.receive().expect("it came long ago");
            assert!(arrival.time + Duration::from_millis(100) < link.now(), "{arrival:?}");
        }
    }
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn a_client_sees_the_answers_alone() {
    let own = Own::new("ywclient");
    let answers = vec![CobFilter::only(0x585)];
    let mut client = Real::open(&SocketCanSettings::services(own.0, answers));
    let mut other = own.link();
    let (request, answer) = (Frame::new(0x605, &[0x40]), Frame::new(0x585, &[0x43]));
    client.send(&request).expect("sent");
    assert_eq!(hear(&mut other, |_| true).what, Received::Frame(request));
    for frame in [request, answer] {
        other.send(&frame).expect("sent");
    }
    assert_eq!(count(&mut client), (vec![answer], 0));
}

/// A stream of the force sensor: its process data in a second of the shipped rig.
fn sensor_stream() -> Vec<(Time, Frame)> {
    let session = Scenario::torque().run(1000);
    let frames = session.recording().frames.into_iter();
    frames.filter(|seen| [0x18a, 0x28a].contains(&seen.frame.id())).map(|seen| (seen.time, seen.frame)).collect()
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn canplayer_replays_a_recorded_sensor_stream() {
    let own = Own::new("ywplay");
    let mut link = own.link();
    let stream = sensor_stream();
    let path = std::env::temp_dir().join(format!("yieldwall-{}.log", std::process::id()));
    let mut log = CandumpWriter::new(Vec::new(), ["can0"]);
    for (time, frame) in &stream {
        log.record(*time, frame).expect("memory");
    }
    std::fs::write(&path, log.finish().expect("memory")).expect("a folder for temporary files");
    let mut player = Command::new("canplayer");
    let player = player.arg("-I").arg(&path).arg(format!("{}=can0", own.0)).status().expect("can-utils is installed");
    let (frames, lost) = count(&mut link);
    std::fs::remove_file(&path).expect("written above");
    assert!(player.success() && stream.len() >= 2000, "{} frames", stream.len());
    assert!(frames.iter().eq(stream.iter().map(|(_, frame)| frame)), "{} of {} frames", frames.len(), stream.len());
    assert_eq!(lost, 0);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn candump_sees_what_was_sent_and_writes_it_as_this_project_does() {
    let own = Own::new("ywdump");
    let mut link = own.link();
    let frames: Vec<_> = sensor_stream().into_iter().map(|(_, frame)| frame).take(40).collect();
    let frames = [frames, vec![Frame::new(0x080, &[]), Frame::remote(0x701, 1), Frame::remote(0x7ff, 0)]].concat();
    let mut dump = Command::new("candump");
    dump.args(["-L", "-T", "20000", "-n", &frames.len().to_string(), own.0]).stdout(Stdio::piped());
    let dump = dump.spawn().expect("can-utils is installed");
    // It is there when it has bound its socket, which it does not report.
    let until = link.now() + PATIENCE;
    let is_bound = || {
        let list = std::fs::read_to_string("/proc/net/can/rcvlist_all").expect("CAN sockets");
        list.lines().any(|line| line.trim_start().starts_with(own.0))
    };
    while !is_bound() {
        assert!(link.now() < until, "candump does not listen");
        link.wait(link.now() + Duration::from_millis(10));
    }
    for frame in &frames {
        link.send(frame).expect("sent");
    }
    let mut ours = CandumpWriter::new(Vec::new(), [own.0]);
    for frame in &frames {
        ours.record(Time(0), frame).expect("memory");
    }
    let ours = String::from_utf8(ours.finish().expect("memory")).expect("text");
    let theirs = String::from_utf8(dump.wait_with_output().expect("it ends").stdout).expect("text");
    let without_time =
        |text: &str| text.lines().map(|line| line.split_once(") ").expect("a time").1.to_owned()).collect();
    let (ours, theirs): (Vec<String>, Vec<String>) = (without_time(&ours), without_time(&theirs));
    assert_eq!(ours, theirs);
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn frames_that_nobody_took_in_time_are_counted() {
    let own = Own::new("ywflood");
    let mut slow = Real::open(&SocketCanSettings { receive_buffer: 1, ..SocketCanSettings::everything(own.0) });
    let mut fast = own.link();
    for number in 0..1000u16 {
        fast.send(&Frame::new(0x181, &number.to_le_bytes())).expect("sent");
    }
    let (early, lost_early) = count(&mut slow);
    // A loss is told with the first frame that comes after it.
    fast.send(&Frame::new(0x181, &1000u16.to_le_bytes())).expect("sent");
    let (late, lost_late) = count(&mut slow);
    let frames = [early, late].concat();
    let lost = lost_early + lost_late;
    assert_eq!((frames.len() as u32 + lost, frames.last()), (1001, Some(&Frame::new(0x181, &1000u16.to_le_bytes()))));
    assert!(lost > 0, "nothing was lost");
    assert!(frames.is_sorted_by_key(|frame| u16::from_le_bytes([frame.data()[0], frame.data()[1]])));
}

/// Frames that the kernel has dropped before any socket could have them: its own queue was full, which holds 1000 by default. It fills
/// where the kernel is late to empty it.
fn dropped_by_kernel() -> u32 {
    let text = std::fs::read_to_string("/proc/net/softnet_stat").expect("a kernel with networks");
    let dropped = text.lines().filter_map(|line| line.split_whitespace().nth(1));
    dropped.map(|word| u32::from_str_radix(word, 16).expect("a hexadecimal number")).sum()
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn with_the_memory_that_it_asks_for_a_link_loses_none_of_a_burst() {
    let own = Own::new("ywburst");
    let (mut one, mut other) = (own.link(), own.link());
    let before = dropped_by_kernel();
    for number in 0..2000u16 {
        one.send(&Frame::new(0x181, &number.to_le_bytes())).expect("sent");
    }
    // A computer with other work may deliver the rest late.
    let (frames, lost) = count_with(&mut other, Duration::from_secs(1));
    let dropped = dropped_by_kernel() - before;
    assert_eq!((frames.len() as u32 + dropped, lost), (2000, 0), "{dropped} dropped by the kernel");
    let number = |frame: &Frame| u16::from_le_bytes([frame.data()[0], frame.data()[1]]);
    assert!(frames.windows(2).all(|pair| number(&pair[0]) < number(&pair[1])));
}

/// Writes 40 kB in blocks to a device on an interface and reads them back; how many frames that took.
fn pass_blocks(interface: &str) -> usize {
    let mut observer = Real::open(&SocketCanSettings::everything(interface));
    let is_over = Arc::new(AtomicBool::new(false));
    let counter = std::thread::spawn({
        let is_over = is_over.clone();
        move || {
            let mut frames = 0;
            while observer.wait(observer.now() + Duration::from_millis(50)) || !is_over.load(Ordering::Relaxed) {
                while let Some(arrival) = observer.receive() {
                    frames += match arrival.what {
                        Received::Frame(_) => 1,
                        // The observer was late, as on a loaded machine. Frames that its own queue had no room for were on the bus.
                        Received::Overflow { frames } => frames as usize,
                        other => panic!("{other:?}"),
                    };
                }
            }
            frames
        }
    });
    let mut bus = Real::on(interface);
    bus.attach(device(5));
    let (mut link, mut client) = (bus.client(5), client(5));
    let data: Vec<u8> = (0..=250).cycle().take(40_000).collect();
    let at = Address::new(0x2001, 0);
    let written = transfer(&mut link, &mut client, |client, now, out| {
        client.start_block_download(now, 0x2001, 0, &data, out).expect("idle");
    });
    assert_eq!(written, SdoOutcome::Downloaded { at });
    let read = transfer(&mut link, &mut client, |client, now, out| {
        client.start_block_upload(now, 0x2001, 0, out).expect("idle");
    });
    assert_eq!(read, SdoOutcome::Uploaded { at, len: data.len(), is_size_indicated: true });
    assert_eq!(client.data(), data);
    is_over.store(true, Ordering::Relaxed);
    counter.join().expect("counted")
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn blocks_lose_nothing_in_a_short_queue() {
    let own = Own::new("ywshort");
    let frames = pass_blocks(own.0);
    tc(&["qdisc", "add", "dev", own.0, "root", "netem", "delay", "1ms", "limit", "10"]);
    // Whatever is lost is sent again, and makes the number another one.
    assert_eq!(pass_blocks(own.0), frames);
    let told = tc(&["-s", "qdisc", "show", "dev", own.0]);
    assert!(told.contains("dropped") && !told.contains("dropped 0,"), "the queue was never full: {told}");
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn an_interface_that_goes_down_sends_nothing_stale_when_it_comes_back() {
    let own = Own::new("ywstale");
    let (mut one, mut other) = (own.link(), own.link());
    one.send(&Frame::new(0x201, &[1])).expect("sent");
    own.set("down");
    for _ in 0..5 {
        assert_eq!(one.send(&Frame::new(0x201, &[2])), Err(SendError::Down));
    }
    own.set("up");
    one.send(&Frame::new(0x201, &[3])).expect("sent");
    let mut heard = Vec::new();
    while heard.last() != Some(&Received::Frame(Frame::new(0x201, &[3]))) {
        heard.push(hear(&mut other, |_| true).what);
    }
    // It is down for both, and there is no word of the five.
    let frame = |byte| Received::Frame(Frame::new(0x201, &[byte]));
    let down = heard.iter().filter(|what| **what == Received::Down).count();
    heard.retain(|what| *what != Received::Down);
    assert_eq!((heard, down), (vec![frame(1), frame(3)], 1));
    assert_eq!(Received::Down.link_event(), Some(LinkEvent::SendFailed));
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn an_interface_that_is_removed_is_gone() {
    let own = Own::new("ywgone");
    let mut link = own.link();
    own.remove();
    let until = link.now() + PATIENCE;
    let mut heard = Vec::new();
    while heard.last() != Some(&Received::Gone) && link.now() < until {
        link.wait(until);
        heard.extend(std::iter::from_fn(|| link.receive()).map(|arrival| arrival.what));
    }
    assert_eq!(heard.last(), Some(&Received::Gone), "{heard:?}");
    assert_eq!(link.send(&Frame::new(0x080, &[])), Err(SendError::Gone));
}

#[test]
#[ignore = "needs a CAN interface: see hil-tests/vcan"]
fn error_frames_are_decoded() {
    let own = Own::new("ywerror");
    let mut link = own.link();
    let expected = [
        ("20000040#0000000000000000", ErrorFrame { is_bus_off: true, ..Default::default() }, Some(LinkEvent::BusOff)),
        (
            "20000204#0020000000008007",
            ErrorFrame { is_error_passive: true, counters: Some((128, 7)), ..Default::default() },
            Some(LinkEvent::ErrorPassive),
        ),
        (
            "20000020#0000000000000000",
            ErrorFrame { is_unacknowledged: true, ..Default::default() },
            Some(LinkEvent::ErrorPassive),
        ),
        ("20000004#0008000000000000", ErrorFrame { is_warning: true, ..Default::default() }, None),
    ];
    for (text, error, event) in expected {
        let done = Command::new("cansend").args([own.0, text]).status().expect("can-utils is installed");
        assert!(done.success(), "cansend {text}");
        let arrival = hear(&mut link, |_| true);
        assert_eq!((arrival.what, arrival.what.link_event()), (Received::Error(error), event), "{text}");
    }
}
