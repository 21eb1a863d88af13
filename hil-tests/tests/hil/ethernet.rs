//! Packet sockets on the two ends of a virtual cable.

use std::process::Command;
use std::time::Duration;

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
    ip("link del veth8");
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
    let done = Command::new("setpriv")
        .args(["--bounding-set=-net_raw", "--inh-caps=-net_raw"])
        .arg(own)
        .args([name, "--exact", "--ignored"])
        .env("YIELDWALL_UNPRIVILEGED", "1")
        .output()
        .expect("util-linux is there");
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success() && said.contains("1 passed"), "{said}");
}
