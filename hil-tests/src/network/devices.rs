//! Devices for tests.

use yieldwall::canopen::{CommunicationProfile, Frame, Node, Outbox, node_id};
use yieldwall::objects::{DataType, DeviceIdentity, Object, ObjectDictionary};
use yieldwall::rig::DeviceServer;
use yieldwall::time::Time;

use super::Participant;

/// Longest value of the domain 2001h:0.
const DOMAIN: usize = 1 << 20;

/// A node and the dictionary that it serves.
#[derive(Debug)]
pub struct Peer {
    /// What speaks for it.
    pub node: Node,
    od: ObjectDictionary,
}

/// Node `id` with a number 2000h:0, a domain 2001h:0 of up to 1 MiB and the communication profile; it can be stored
/// (1010h).
///
/// # Panics
/// If `id` is no node id.
pub fn device(id: u8) -> Peer {
    let id = node_id(id).expect("1 to 127");
    let identity = DeviceIdentity {
        device_type: 0x0002_0192,
        name: "a peer for other stacks".into(),
        vendor_id: 0x0102_0304,
        product_code: 0x8000_0001,
        revision: 1,
        serial: 0xffff_fffe,
    };
    let od = ObjectDictionary::builder()
        .objects(CommunicationProfile::new(id, &identity).objects().expect("no PDOs"))
        .object(Object::new(0x2000, 0, 0u32))
        .object(Object::bytes(0x2001, 0, DataType::Domain, &[], DOMAIN))
        .build()
        .expect("no object twice");
    Peer { node: Node::new(id, &od).expect("a whole communication profile"), od }
}

/// As [`device`], but without a node id: it waits for LSS.
///
/// # Panics
/// Never.
pub fn bare() -> Peer {
    let mut peer = device(5);
    peer.node.forget_node_id();
    peer
}

impl Participant for Peer {
    fn switch_on(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.node.boot(now, &mut self.od, &mut out);
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, mut out: &mut dyn Outbox) {
        self.node.on_frame(now, frame, &mut self.od, &mut out);
    }

    fn poll(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.node.poll(now, &mut self.od, &mut out);
    }

    fn next_deadline(&self) -> Time {
        self.node.next_deadline()
    }
}

/// The devices of a rig with arm and hand.
#[derive(Debug)]
pub struct Served(pub DeviceServer);

impl Participant for Served {
    fn switch_on(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.0.switch_on(now, &mut out);
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, mut out: &mut dyn Outbox) {
        self.0.on_frame(now, frame, &mut out).expect("the arm goes on");
    }

    fn poll(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.0.poll(now, &mut out).expect("the arm goes on");
    }

    fn next_deadline(&self) -> Time {
        self.0.next_deadline()
    }
}
