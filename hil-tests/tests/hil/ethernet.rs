//! Packet sockets on the two ends of a virtual cable, and the programs on them.

mod desk;
mod drills;
mod forged;
mod processes;
mod refused;
mod rigs;
mod second_opinion;
mod served;
mod two_masters;

use std::process::Command;
use std::time::Duration;

use hil_tests::processes::output;
use yieldwall::link::{EthernetError, EthernetLink, EthernetReceived, PacketSocket, Role, SendError};

/// Longest wait for what has to come.
const LONG: Duration = Duration::from_secs(5);
/// Wait for what must not come.
const SHORT: Duration = Duration::from_millis(200);

/// A frame from a station to all, with a type and a first byte.
fn frame(kind: [u8; 2], first: u8) -> [u8; 60] {
    let mut frame = [0; 60];
    frame[..6].fill(0xff);
    frame[6..12].fill(0x10);
    frame[12..14].copy_from_slice(&kind);
    frame[14] = first;
    frame
}

const ETHERCAT: [u8; 2] = [0x88, 0xa4];

fn open(interface: &str, role: Role) -> PacketSocket {
    PacketSocket::open(interface, role).unwrap_or_else(|error| panic!("{error}"))
}

/// What comes within a time.
fn next(link: &mut PacketSocket, within: Duration) -> Option<(EthernetReceived, Vec<u8>)> {
    let until = link.now() + within;
    let mut buffer = [0; 1514];
    loop {
        if let Some(arrival) = link.receive(&mut buffer) {
            let length = if let EthernetReceived::Frame { length } = arrival.what { length } else { 0 };
            return Some((arrival.what, buffer[..length].to_vec()));
        }
        if link.now() >= until {
            return None;
        }
        link.wait(until);
    }
}

fn ip(arguments: &str) {
    let done = Command::new("ip").args(arguments.split(' ')).output().expect("iproute2 is there");
    assert!(done.status.success(), "ip {arguments}: {}", String::from_utf8_lossy(&done.stderr));
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn frames_of_ethercat_pass_and_nothing_else() {
    let (mut master, mut segment) = (open("veth0", Role::Master), open("veth1", Role::Segment));
    assert!(master.has_carrier() && segment.has_carrier());
    master.send(&frame([0x08, 0x00], 1)).unwrap();
    // To another station, and longer than is usual on this wire.
    let mut other = frame(ETHERCAT, 2);
    other[..6].copy_from_slice(&[0x02, 1, 2, 3, 4, 5]);
    master.send(&other).unwrap();
    let long = [&frame(ETHERCAT, 3)[..], &[7; 1454]].concat();
    assert_eq!(long.len(), 1514);
    master.send(&long).unwrap();
    for expected in [&other[..], &long] {
        let length = expected.len();
        assert_eq!(next(&mut segment, LONG), Some((EthernetReceived::Frame { length }, expected.to_vec())));
    }
    // What one has sent itself does not come back, nor what another process sends from the same end.
    assert_eq!(next(&mut master, SHORT), None);
    let mut beside = open("veth0", Role::Node(1));
    beside.send(&frame(ETHERCAT, 4)).unwrap();
    assert_eq!(next(&mut master, SHORT), None);
    assert!(next(&mut segment, LONG).is_some());
    // A frame is not cut: it is gone.
    master.send(&long).unwrap();
    let until = segment.now() + LONG;
    while !segment.wait(until) && segment.now() < until {}
    let arrival = segment.receive(&mut [0; 60]).unwrap();
    assert_eq!(arrival.what, EthernetReceived::TooLong { length: 1514 });
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn an_interface_that_cannot_be_used_says_why() {
    let refused = |interface: &str| PacketSocket::open(interface, Role::Segment).unwrap_err().to_string();
    let missing = refused("veth7");
    assert!(missing.contains("there is no interface `veth7`; Ethernet interfaces here: veth0, veth1"), "{missing}");
    let lo = refused("lo");
    assert!(lo.starts_with("`lo` is the loopback interface, and EtherCAT runs on Ethernet"), "{lo}");
    ip("link add veth8 type veth peer name veth9");
    assert_eq!(refused("veth8"), "`veth8` is down. Take it up with `sudo ip link set veth8 up`");
    ip("link set veth8 up");
    let mut link = open("veth8", Role::Segment);
    assert!(!link.has_carrier(), "the other end is down");
    let taken = PacketSocket::open("veth8", Role::Segment).unwrap_err();
    let EthernetError::Held { holder: Some(holder), .. } = &taken else { panic!("{taken:?}") };
    assert_eq!(u32::try_from(holder.pid), Ok(std::process::id()));
    assert_eq!(next(&mut link, SHORT), None);
    ip("link set veth8 down");
    assert_eq!(next(&mut link, LONG).map(|(what, _)| what), Some(EthernetReceived::Down));
    assert_eq!(link.send(&frame(ETHERCAT, 1)), Err(SendError::Down));
    assert_eq!(next(&mut link, SHORT), None);
    ip("link del veth8");
    assert_eq!(next(&mut link, LONG).map(|(what, _)| what), Some(EthernetReceived::Gone));
    assert_eq!(link.send(&frame(ETHERCAT, 1)), Err(SendError::Gone));
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn who_lacks_the_privilege_is_told_how_to_get_it() {
    // The same test program, without the privilege.
    if std::env::var_os("YIELDWALL_UNPRIVILEGED").is_some() {
        let error = PacketSocket::open("veth1", Role::Node(2)).unwrap_err();
        assert!(matches!(error, EthernetError::NotPermitted { .. }), "{error:?}");
        return;
    }
    let own = std::env::current_exe().expect("this program has a path");
    let name = "ethernet::who_lacks_the_privilege_is_told_how_to_get_it";
    let mut unprivileged = Command::new("setpriv");
    unprivileged.args(["--bounding-set=-net_raw", "--inh-caps=-net_raw"]).arg(own);
    let done = output(unprivileged.args([name, "--exact", "--ignored"]).env("YIELDWALL_UNPRIVILEGED", "1"));
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success() && said.contains("1 passed"), "{said}");
}

/// Exit code of `yieldwall` with these arguments, and what it says on standard error without line breaks; without the privilege on request.
fn sim(is_privileged: bool, arguments: &[&str]) -> (Option<i32>, String) {
    let program = hil_tests::program();
    let mut command = match is_privileged {
        true => Command::new(&program),
        false => {
            let mut command = Command::new("setpriv");
            command.args(["--bounding-set=-net_raw", "--inh-caps=-net_raw"]).arg(&program);
            command
        }
    };
    let done = output(command.args(["sim", "builtin:paper-ethercat.yaml"]).args(arguments));
    let said = String::from_utf8(done.stderr).expect("text");
    (done.status.code(), said.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" "))
}

#[test]
#[ignore = "needs a pair of Ethernet interfaces: see hil-tests/veth"]
fn a_segment_that_cannot_be_served_ends_with_one_message_and_its_exit_code() {
    let (unavailable, usage) = (Some(4), Some(2));
    ip("link add veth6 type veth peer name veth5");
    for (is_privileged, arguments, code, message) in [
        (true, &["--bus", "main=veth7"][..], unavailable, "there is no interface `veth7`; Ethernet interfaces here: "),
        (true, &["--bus", "main=lo"], unavailable, "`lo` is the loopback interface, and EtherCAT runs on Ethernet"),
        (true, &["--bus", "veth6"], unavailable, "`veth6` is down. Take it up with `sudo ip link set veth6 up`"),
        (false, &["--bus", "main=veth1"], unavailable, "`sudo setcap cap_net_raw+ep "),
        (true, &["--bus", "other=veth1"], usage, "names the bus `other`, which the rig does not have"),
        (true, &["--bus", "veth1", "--nodes", "3"], usage, "--nodes names 3, which the rig does not have"),
        (true, &["--bus", "veth1", "--fault", "sync-lost@1"], usage, "sync-lost does not exist on EtherCAT"),
        (
            true,
            &["--bus", "veth1", "--nodes", "0,1", "--fault", "sensor-invalid@1"],
            usage,
            "sensor is not on this segment",
        ),
        (true, &["--bus", "veth1", "--plant", "socket"], usage, "--plant is for devices on CAN"),
    ] {
        let (ended, said) = sim(is_privileged, arguments);
        assert_eq!(ended, code, "{arguments:?}: {said}");
        assert!(said.contains(message), "{arguments:?}: {said}");
    }
    ip("link del veth6");
}
