//! Serves the segment on an Ethernet interface until it is ended:
//!
//! ```text
//! hil-tests/veth target/debug/serve veth1
//! ```

use yieldwall::link::{EthernetLink, EthernetReceived, PacketSocket, Role};

use hil_tests_ethercrab::devices::Devices;

fn main() {
    let interface = std::env::args().nth(1).expect("the name of an interface");
    let mut link = PacketSocket::open(&interface, Role::Segment).unwrap_or_else(|error| panic!("{error}"));
    let mut devices = Devices::new(link.now());
    eprintln!("serving on {interface}");
    let mut buffer = [0; 1514];
    loop {
        while let Some(arrival) = link.receive(&mut buffer) {
            match arrival.what {
                EthernetReceived::Frame { length } => {
                    let frame = &mut buffer[..length];
                    if devices.process(arrival.time, frame).is_some() {
                        // A frame that cannot be sent is a frame that is lost.
                        let _ = link.send(frame);
                    }
                }
                EthernetReceived::Gone => return,
                _ => {}
            }
        }
        devices.poll(link.now());
        link.wait(devices.next_deadline());
    }
}
