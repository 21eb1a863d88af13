//! A frame to the simulated devices and back over a virtual cable, with the program's own socket and with ethercrab's `tx_rx_task`.
//!
//! ```text
//! cargo build --locked --profile dist -p hil-tests-ethercrab --features wire --bin round_trip
//! hil-tests/veth chrt -f 50 target/dist/round_trip [TURNS]
//! ```
//!
//! Both ask three devices for their state (`BRD 0130h`), a thousand times in each turn, and take turns. Each has a cable of its own and the
//! same devices behind it, so that neither wakes the other up. All threads have the scheduling class in which the program was started;
//! without `chrt` that of any program. The last line has the ratio of the medians; above 0.6 the exit code is 1.

use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use ethercrab::std::tx_rx_task;
use ethercrab::{Command as Datagram, MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use yieldwall::config::{builtin, load_rig};
use yieldwall::ethercat::frame::{self, Datagrams, FrameWriter, address};
use yieldwall::link::{EthernetLink, EthernetReceived, PacketSocket, Role};
use yieldwall::rig::simulated_segment;
use yieldwall::run::Pace;
use yieldwall::time::Time;

/// Frames of a turn that count, and those before them that do not.
const COUNTED: usize = 1000;
const BEFORE: usize = 100;
/// How long a reply may take.
const PATIENCE: Duration = Duration::from_secs(1);
const AL_STATUS: u16 = 0x0130;
const DEVICES: u16 = 3;
const BOUND: f64 = 0.6;

static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

/// Has simulated devices answer at an end of a cable, on a thread of their own.
fn serve(interface: &str) {
    let mut link = PacketSocket::open(interface, Role::Segment).unwrap_or_else(|error| panic!("{error}"));
    std::thread::spawn(move || {
        let rig = load_rig(builtin("paper-ethercat.yaml")).expect("a shipped rig");
        let scene = rig.scene().expect("a shipped scene").value;
        let mut segment =
            simulated_segment(&rig.value, &scene, [true; 3], Pace::Lockstep).expect("a rig on EtherCAT").0;
        let (mut now, mut buffer) = (Time(0), [0; frame::LONGEST]);
        loop {
            link.wait(link.now() + PATIENCE);
            while let Some(arrival) = link.receive(&mut buffer) {
                let EthernetReceived::Frame { length } = arrival.what else { continue };
                now = now + Duration::from_micros(1);
                let frame = &mut buffer[..length];
                if segment.process(now, frame).is_some() {
                    link.send(frame).expect("the interface is up");
                }
            }
        }
    });
}

/// One frame there and back with the program's own socket.
fn own(link: &mut PacketSocket, index: u8) -> Duration {
    let mut buffer = [0; frame::LONGEST];
    let begun = Instant::now();
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]).expect("room");
    let at = address(0, AL_STATUS);
    writer.push(frame::Command::Brd, index, at, &[0; 2]).expect("room");
    link.send(writer.finish()).expect("the interface is up");
    let until = link.now() + PATIENCE;
    loop {
        link.wait(until);
        let Some(arrival) = link.receive(&mut buffer) else {
            assert!(link.now() < until, "no reply");
            continue;
        };
        let EthernetReceived::Frame { length } = arrival.what else { continue };
        let reply = Datagrams::of(&buffer[..length]).expect("a frame of EtherCAT").next();
        let reply = reply.expect("a datagram").expect("a whole one");
        if reply.header.index == index {
            assert_eq!(reply.working_counter, DEVICES);
            return begun.elapsed();
        }
    }
}

/// One frame there and back with ethercrab.
async fn foreign(main: &MainDevice<'_>) -> Duration {
    let begun = Instant::now();
    let states: u16 = Datagram::brd(AL_STATUS).with_wkc(DEVICES).receive(main).await.expect("a reply");
    assert_ne!(states, 0);
    begun.elapsed()
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}

fn ip(arguments: &str) {
    let done = Command::new("ip").args(arguments.split(' ')).output().expect("iproute2 is there");
    assert!(done.status.success(), "ip {arguments}: {}", String::from_utf8_lossy(&done.stderr));
}

/// The scheduling class of this program as the kernel numbers it.
fn class() -> &'static str {
    let told = std::fs::read_to_string("/proc/self/stat").expect("procfs");
    // The 41st field; the second one, in parentheses, may have blanks.
    let fields = told.rsplit(") ").next().expect("a name").split(' ');
    match fields.clone().nth(38) {
        Some("0") => "SCHED_OTHER",
        Some("1") => "SCHED_FIFO",
        Some("2") => "SCHED_RR",
        _ => "another class",
    }
}

fn main() -> ExitCode {
    let turns: usize = std::env::args().nth(1).map_or(20, |turns| turns.parse().expect("a number of turns"));
    ip("link add veth2 type veth peer name veth3");
    ip("link set veth2 up");
    ip("link set veth3 up");
    ["veth1", "veth3"].into_iter().for_each(serve);
    let mut link = PacketSocket::open("veth0", Role::Master).unwrap_or_else(|error| panic!("{error}"));
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("nobody has split it before");
    std::thread::spawn(move || {
        let ended = async_io::block_on(tx_rx_task("veth2", tx, rx).expect("the interface is up"));
        panic!("tx_rx_task has ended: {:?}", ended.map(drop));
    });
    let timeouts = Timeouts { pdu: PATIENCE, ..Timeouts::default() };
    let main = MainDevice::new(pdu_loop, timeouts, MainDeviceConfig::default());
    let mut all = [Vec::new(), Vec::new()];
    let mut ratios = Vec::new();
    for _ in 0..turns {
        let turn = [
            (0..BEFORE + COUNTED).map(|number| own(&mut link, number as u8)).skip(BEFORE).collect::<Vec<_>>(),
            async_io::block_on(async {
                let mut times = Vec::new();
                for number in 0..BEFORE + COUNTED {
                    let time = foreign(&main).await;
                    times.extend((number >= BEFORE).then_some(time));
                }
                times
            }),
        ];
        let [own, foreign] = turn.each_ref().map(|times| median(times.clone()).as_secs_f64());
        ratios.push(own / foreign);
        all.iter_mut().zip(turn).for_each(|(all, turn)| all.extend(turn));
    }
    for (name, times) in ["own socket", "ethercrab"].iter().zip(&mut all) {
        times.sort_unstable();
        let us = |per_mille: usize| times[(times.len() - 1) * per_mille / 1000].as_secs_f64() * 1e6;
        println!("{name:10}  p50 {:.1}, p90 {:.1}, p99 {:.1}, p99.9 {:.1} us", us(500), us(900), us(990), us(999));
    }
    ratios.sort_by(f64::total_cmp);
    let [own, foreign] = all.map(|times| median(times).as_secs_f64());
    let ratio = own / foreign;
    println!(
        "{}, {turns} turns of {COUNTED} frames each; ratio of the medians {ratio:.2} (by turn {:.2} to {:.2}), at most {BOUND}",
        class(),
        ratios.first().copied().unwrap_or_default(),
        ratios.last().copied().unwrap_or_default(),
    );
    ExitCode::from(u8::from(ratio > BOUND))
}
