//! Devices for tests.

use yieldwall::canopen::{DataType, DeviceIdentity, Frame, Node, Object, ObjectDictionary, Outbox, Time, node_id};
use yieldwall::rig::DeviceServer;

use super::Participant;

/// Longest value of the domain 2001h:0.
const DOMAIN: usize = 1 << 20;

/// Node `id` with a number 2000h:0, a domain 2001h:0 of up to 1 MiB and the communication profile; it can be stored
/// (1010h).
///
/// # Panics
/// If `id` is no node id.
pub fn device(id: u8) -> Node {
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
        .communication_profile(id, &identity)
        .object(Object::new(0x2000, 0, 0u32))
        .object(Object::bytes(0x2001, 0, DataType::Domain, &[], DOMAIN))
        .build()
        .expect("no object twice");
    Node::new(id, od).expect("a whole communication profile")
}

/// As [`device`], but without a node id: it waits for LSS.
///
/// # Panics
/// Never.
pub fn bare() -> Node {
    let mut node = device(5);
    node.forget_node_id();
    node
}

impl Participant for Node {
    fn switch_on(&mut self, now: Time, mut out: &mut dyn Outbox) {
        self.boot(now, &mut (), &mut out);
    }

    fn on_frame(&mut self, now: Time, frame: &Frame, mut out: &mut dyn Outbox) {
        Node::on_frame(self, now, frame, &mut (), &mut out);
    }

    fn poll(&mut self, now: Time, mut out: &mut dyn Outbox) {
        Node::poll(self, now, &mut (), &mut out);
    }

    fn next_deadline(&self) -> Time {
        Node::next_deadline(self)
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
