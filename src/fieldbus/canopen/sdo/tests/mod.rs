//! Both ends against literal bytes of CiA 301, and against each other. Server tests go through a [`Node`].

mod block;
mod lossy;
mod pacing;

use std::time::Duration;

use proptest::prelude::*;

use super::super::{CanopenError, CommunicationProfile, Frame, Node, node_id};
use super::wire::{self, Initiate, Request, Response};
use super::{SdoClient, SdoClients, SdoOutcome};
use crate::objects::{AbortCode, Access, Address, DataType, DeviceIdentity, Object, ObjectDictionary, ObjectRequest};
use crate::time::Time;

const TIMEOUT: Duration = Duration::from_millis(100);
const NOW: Time = Time(1_000_000_000);
const CAPACITY: usize = 2000;
const NAME: &str = "a device name of exactly forty bytes ...";

fn client() -> SdoClient {
    SdoClient::new(node_id(1).unwrap(), TIMEOUT, CAPACITY)
}

/// A client that asked for an object, and its request has been checked.
fn reading(index: u16, sub: u8) -> SdoClient {
    let mut client = client();
    let mut out = Vec::new();
    client.start_upload(NOW, index, sub, &mut out).unwrap();
    let [low, high] = index.to_le_bytes();
    assert_eq!(out, [Frame::new(0x601, &[0x40, low, high, sub, 0, 0, 0, 0])]);
    client
}

/// Returns the client's reaction to one answer of node 1: its outcome and the frame it sends.
fn answer(client: &mut SdoClient, bytes: [u8; 8]) -> (Option<SdoOutcome>, Option<[u8; 8]>) {
    let mut out = Vec::new();
    let outcome = client.on_frame(NOW, &Frame::new(0x581, &bytes), &mut out);
    assert!(out.len() <= 1 && out.iter().all(|frame| frame.id() == 0x601 && frame.len() == 8));
    (outcome, out.first().map(|frame| *frame.bytes()))
}

fn uploaded(index: u16, sub: u8, len: usize) -> Option<SdoOutcome> {
    Some(SdoOutcome::Uploaded { at: Address::new(index, sub), len, is_size_indicated: true })
}

fn aborted(index: u16, sub: u8, code: u32, is_by_device: bool) -> Option<SdoOutcome> {
    Some(SdoOutcome::Aborted { at: Address::new(index, sub), code: AbortCode(code), is_by_device })
}

/// A node and the dictionary that it serves.
struct Server(Node, ObjectDictionary);

impl Server {
    fn new() -> Self {
        Self::with_capacity(CAPACITY)
    }

    fn with_capacity(capacity: usize) -> Self {
        let identity = DeviceIdentity { device_type: 0x0002_0192, name: NAME.into(), ..DeviceIdentity::default() };
        let mut od = ObjectDictionary::builder()
            .objects(CommunicationProfile::new(node_id(1).unwrap(), &identity).objects().unwrap())
            .object(Object::new(0x6040, 0, 0u16))
            .object(Object::new(0x607a, 0, 0i32))
            .object(Object::new(0x2000, 0, 0u64))
            .object(Object::bytes(0x2001, 0, DataType::Domain, &[], capacity))
            .object(Object::new(0x2002, 0, 0u8).access(Access::WriteOnly))
            .build()
            .unwrap();
        let mut node = Node::new(node_id(1).unwrap(), &od).unwrap();
        node.boot(NOW, &mut od, &mut Vec::new());
        Server(node, od)
    }

    /// The answer to one request, if any.
    fn ask(&mut self, bytes: [u8; 8]) -> Option<[u8; 8]> {
        self.forward(&Frame::new(0x601, &bytes)).map(|frame| *frame.bytes())
    }

    fn forward(&mut self, frame: &Frame) -> Option<Frame> {
        let mut out = Vec::new();
        self.0.on_frame(NOW, frame, &mut self.1, &mut out);
        assert!(out.len() <= 1 && out.iter().all(|frame| frame.id() == 0x581 && frame.len() == 8));
        out.first().copied()
    }

    fn value(&self, index: u16) -> &[u8] {
        self.1.bytes(Address::new(index, 0)).unwrap()
    }

    /// Runs a client's transfer to its end.
    fn run(&mut self, client: &mut SdoClient, mut out: Vec<Frame>) -> SdoOutcome {
        loop {
            let request = out.pop().expect("a transfer in progress sends a frame");
            let response = self.forward(&request).expect("the server answers");
            if let Some(outcome) = client.on_frame(NOW, &response, &mut out) {
                assert!(!client.is_busy() && client.next_deadline() == Time::NEVER);
                return outcome;
            }
        }
    }
}

// The client against literal bytes.

#[test]
fn expedited_upload_of_one_to_four_bytes() {
    for (command, len) in [(0x4f, 1), (0x4b, 2), (0x47, 3), (0x43, 4)] {
        let mut client = reading(0x6041, 0);
        let reply = [command, 0x41, 0x60, 0, 0x37, 0x02, 0x11, 0x22];
        assert_eq!(answer(&mut client, reply), (uploaded(0x6041, 0, len), None));
        assert_eq!(client.data(), &[0x37, 0x02, 0x11, 0x22][..len]);
        assert_eq!(client.value::<u16>(), (len == 2).then_some(0x0237));
    }
}

#[test]
fn fault_1_an_expedited_reply_without_size_is_legal() {
    let mut client = reading(0x6041, 0);
    let outcome = SdoOutcome::Uploaded { at: Address::new(0x6041, 0), len: 4, is_size_indicated: false };
    assert_eq!(answer(&mut client, [0x42, 0x41, 0x60, 0, 0x37, 0x02, 0, 0]), (Some(outcome), None));
    assert_eq!((client.value::<u16>(), client.value::<i32>()), (Some(0x0237), Some(0x0237)));
    assert_eq!(client.value::<u64>(), None);
}

#[test]
fn fault_2_an_answer_for_another_object_is_not_the_answer() {
    let mut client = reading(0x6041, 0);
    assert_eq!(answer(&mut client, [0x4b, 0x17, 0x10, 0, 0xe8, 0x03, 0, 0]), (None, None));
    assert_eq!(answer(&mut client, [0x4b, 0x41, 0x60, 1, 0xe8, 0x03, 0, 0]), (None, None));
    assert_eq!(answer(&mut client, [0x4b, 0x41, 0x60, 0, 0x37, 0x02, 0, 0]).0, uploaded(0x6041, 0, 2));

    let mut out = Vec::new();
    client.start_download(NOW, 0x6040, 0, &[6, 0], &mut out).unwrap();
    assert_eq!(answer(&mut client, [0x60, 0x17, 0x10, 0, 0, 0, 0, 0]), (None, None));
    let done = SdoOutcome::Downloaded { at: Address::new(0x6040, 0) };
    assert_eq!(answer(&mut client, [0x60, 0x40, 0x60, 0, 0, 0, 0, 0]), (Some(done), None));
}

#[test]
fn fault_3_an_abort_of_another_object_ends_nothing() {
    let mut client = reading(0x6041, 0);
    assert_eq!(answer(&mut client, [0x80, 0x17, 0x10, 0, 0, 0, 0x02, 0x06]), (None, None));
    assert!(client.is_busy());
    let expected = aborted(0x6041, 0, 0x0602_0000, true);
    assert_eq!(answer(&mut client, [0x80, 0x41, 0x60, 0, 0, 0, 0x02, 0x06]), (expected, None));
}

#[test]
fn fault_4_a_segmented_upload_without_size_is_legal() {
    let mut client = reading(0x1008, 0);
    let segment_request = |toggle: u8| Some([0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(answer(&mut client, [0x40, 0x08, 0x10, 0, 0, 0, 0, 0]), (None, segment_request(0)));
    assert_eq!(answer(&mut client, *b"\x00EPOS4 s"), (None, segment_request(0x10)));
    assert_eq!(answer(&mut client, *b"\x1bim\0\0\0\0\0"), (uploaded(0x1008, 0, 9), None));
    assert_eq!(client.data(), b"EPOS4 sim");
}

#[test]
fn fault_5_forty_bytes_pass_both_ways() {
    let (mut server, mut client) = (Server::new(), client());
    let mut out = Vec::new();
    client.start_upload(NOW, 0x1008, 0, &mut out).unwrap();
    assert_eq!(Some(server.run(&mut client, out)), uploaded(0x1008, 0, 40));
    assert_eq!(client.data(), NAME.as_bytes());
    let mut out = Vec::new();
    client.start_download(NOW, 0x2001, 0, NAME.as_bytes(), &mut out).unwrap();
    assert_eq!(server.run(&mut client, out), SdoOutcome::Downloaded { at: Address::new(0x2001, 0) });
    assert_eq!(server.value(0x2001), NAME.as_bytes());
}

#[test]
fn fault_6_fewer_or_more_bytes_than_declared_abort() {
    let mut client = reading(0x1008, 0);
    answer(&mut client, [0x41, 0x08, 0x10, 0, 20, 0, 0, 0]);
    let abort = Some([0x80, 0x08, 0x10, 0, 0x13, 0x00, 0x07, 0x06]);
    assert_eq!(answer(&mut client, [0x09, 1, 2, 3, 0, 0, 0, 0]), (aborted(0x1008, 0, 0x0607_0013, false), abort));

    let mut client = reading(0x1008, 0);
    answer(&mut client, [0x41, 0x08, 0x10, 0, 5, 0, 0, 0]);
    let abort = Some([0x80, 0x08, 0x10, 0, 0x12, 0x00, 0x07, 0x06]);
    assert_eq!(answer(&mut client, [0x01, 1, 2, 3, 4, 5, 6, 7]), (aborted(0x1008, 0, 0x0607_0012, false), abort));
}

#[test]
fn a_value_beyond_the_buffer_is_refused_before_and_during_the_transfer() {
    let mut client = reading(0x1f22, 1);
    let abort = Some([0x80, 0x22, 0x1f, 1, 0x05, 0x00, 0x04, 0x05]);
    let declared = answer(&mut client, [0x41, 0x22, 0x1f, 1, 0xd1, 0x07, 0, 0]);
    assert_eq!(declared, (aborted(0x1f22, 1, 0x0504_0005, false), abort));

    let mut client = SdoClient::new(node_id(1).unwrap(), TIMEOUT, 10);
    client.start_upload(NOW, 0x1f22, 1, &mut Vec::new()).unwrap();
    answer(&mut client, [0x40, 0x22, 0x1f, 1, 0, 0, 0, 0]);
    answer(&mut client, [0x00, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(answer(&mut client, [0x10, 1, 2, 3, 4, 5, 6, 7]), (aborted(0x1f22, 1, 0x0504_0005, false), abort));
}

#[test]
fn a_wrong_toggle_aborts() {
    let mut client = reading(0x1008, 0);
    answer(&mut client, [0x41, 0x08, 0x10, 0, 20, 0, 0, 0]);
    let abort = Some([0x80, 0x08, 0x10, 0, 0x00, 0x00, 0x03, 0x05]);
    assert_eq!(answer(&mut client, [0x10, 1, 2, 3, 4, 5, 6, 7]), (aborted(0x1008, 0, 0x0503_0000, false), abort));
}

#[test]
fn an_empty_segment_cannot_keep_a_transfer_open() {
    let mut client = reading(0x1008, 0);
    answer(&mut client, [0x40, 0x08, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(answer(&mut client, [0x0e, 0, 0, 0, 0, 0, 0, 0]).0, aborted(0x1008, 0, 0x0607_0010, false));
}

#[test]
fn expedited_download_of_one_to_four_bytes() {
    for (command, len) in [(0x2f, 1), (0x2b, 2), (0x27, 3), (0x23, 4)] {
        let mut client = client();
        let mut out = Vec::new();
        client.start_download(NOW, 0x607a, 0, &[0x11, 0x22, 0x33, 0x44][..len], &mut out).unwrap();
        let mut bytes = [command, 0x7a, 0x60, 0, 0x11, 0x22, 0x33, 0x44];
        bytes[4 + len..].fill(0);
        assert_eq!(out, [Frame::new(0x601, &bytes)]);
    }
}

#[test]
fn segmented_download_bytes() {
    let mut client = client();
    let mut out = Vec::new();
    client.start_download(NOW, 0x1008, 0, b"EPOS4 sim", &mut out).unwrap();
    assert_eq!(out, [Frame::new(0x601, &[0x21, 0x08, 0x10, 0, 9, 0, 0, 0])]);
    assert_eq!(answer(&mut client, [0x60, 0x08, 0x10, 0, 0, 0, 0, 0]), (None, Some(*b"\x00EPOS4 s")));
    assert_eq!(answer(&mut client, [0x20, 0, 0, 0, 0, 0, 0, 0]), (None, Some(*b"\x1bim\0\0\0\0\0")));
    let done = SdoOutcome::Downloaded { at: Address::new(0x1008, 0) };
    assert_eq!(answer(&mut client, [0x30, 0, 0, 0, 0, 0, 0, 0]), (Some(done), None));
}

#[test]
fn a_wrong_toggle_in_an_acknowledgement_aborts() {
    let mut client = client();
    client.start_download(NOW, 0x1008, 0, b"EPOS4 sim", &mut Vec::new()).unwrap();
    answer(&mut client, [0x60, 0x08, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(answer(&mut client, [0x30, 0, 0, 0, 0, 0, 0, 0]).0, aborted(0x1008, 0, 0x0503_0000, false));
}

#[test]
fn silence_ends_with_an_abort_frame_and_late_answers_do_nothing() {
    let mut client = client();
    client.set_retries(0);
    let mut out = Vec::new();
    client.start_upload(NOW, 0x6041, 0, &mut out).unwrap();
    out.clear();
    assert_eq!(client.next_deadline(), NOW + TIMEOUT);
    assert_eq!(client.poll(Time(NOW.0 + TIMEOUT.as_nanos() as u64 - 1), &mut out), None);
    assert_eq!(
        client.poll(NOW + TIMEOUT, &mut out),
        Some(SdoOutcome::TimedOut { at: Address::new(0x6041, 0), may_be_written: false })
    );
    assert_eq!(out, [Frame::new(0x601, &[0x80, 0x41, 0x60, 0, 0x00, 0x00, 0x04, 0x05])]);
    assert_eq!(client.poll(NOW + TIMEOUT + TIMEOUT, &mut out), None);
    assert_eq!(answer(&mut client, [0x4b, 0x41, 0x60, 0, 0x37, 0x02, 0, 0]), (None, None));
}

#[test]
fn a_read_is_begun_anew_twice_and_a_write_never() {
    let mut client = reading(0x6041, 0);
    let abort = Frame::new(0x601, &[0x80, 0x41, 0x60, 0, 0x00, 0x00, 0x04, 0x05]);
    let request = Frame::new(0x601, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0]);
    let mut now = NOW;
    for _ in 0..2 {
        now = now + TIMEOUT;
        let mut out = Vec::new();
        assert_eq!((client.poll(now, &mut out), out), (None, vec![abort, request]));
    }
    let mut out = Vec::new();
    let at = Address::new(0x6041, 0);
    let lost = SdoOutcome::TimedOut { at, may_be_written: false };
    assert_eq!((client.poll(now + TIMEOUT, &mut out), &out[..]), (Some(lost), &[abort][..]));

    let at = Address::new(0x6040, 0);
    client.start_download(NOW, 0x6040, 0, &[6, 0], &mut Vec::new()).unwrap();
    let lost = SdoOutcome::TimedOut { at, may_be_written: true };
    assert_eq!(client.poll(NOW + TIMEOUT, &mut Vec::new()), Some(lost));
    // In segments nothing is written before the last one.
    let at = Address::new(0x1008, 0);
    for (answers, may_be_written) in [(0, false), (1, false), (2, true)] {
        client.start_download(NOW, 0x1008, 0, b"EPOS4 sim", &mut Vec::new()).unwrap();
        for reply in [[0x60, 0x08, 0x10, 0, 0, 0, 0, 0], [0x20, 0, 0, 0, 0, 0, 0, 0]].iter().take(answers) {
            answer(&mut client, *reply);
        }
        let lost = SdoOutcome::TimedOut { at, may_be_written };
        assert_eq!(client.poll(NOW + TIMEOUT, &mut Vec::new()), Some(lost));
    }
}

#[test]
fn a_device_that_drips_is_given_up_after_the_longest_transfer() {
    let mut client = client();
    client.set_longest_transfer(Duration::from_millis(150));
    client.start_upload(NOW, 0x1008, 0, &mut Vec::new()).unwrap();
    let drip = NOW + Duration::from_millis(90);
    client.on_frame(drip, &Frame::new(0x581, &[0x40, 0x08, 0x10, 0, 0, 0, 0, 0]), &mut Vec::new());
    assert_eq!(client.next_deadline(), NOW + Duration::from_millis(150));
    let at = Address::new(0x1008, 0);
    let lost = SdoOutcome::TimedOut { at, may_be_written: false };
    assert_eq!(client.poll(NOW + Duration::from_millis(150), &mut Vec::new()), Some(lost));
}

#[test]
fn each_answer_starts_the_time_anew() {
    let mut client = reading(0x1008, 0);
    let later = NOW + Duration::from_millis(90);
    client.on_frame(later, &Frame::new(0x581, &[0x40, 0x08, 0x10, 0, 0, 0, 0, 0]), &mut Vec::new());
    assert_eq!(client.next_deadline(), later + TIMEOUT);
}

#[test]
fn one_transfer_at_a_time_and_cancelling_tells_the_device() {
    let mut client = reading(0x6041, 0);
    let mut out = Vec::new();
    assert_eq!(client.start_upload(NOW, 0x6041, 0, &mut out), Err(CanopenError::SdoBusy(1)));
    client.cancel(&mut out);
    assert_eq!(out, [Frame::new(0x601, &[0x80, 0x41, 0x60, 0, 0x00, 0x00, 0x00, 0x08])]);
    assert!(!client.is_busy());
    let too_long = client.start_download(NOW, 0x6041, 0, &[0; CAPACITY + 1], &mut out);
    assert_eq!(too_long, Err(CanopenError::SdoBuffer { len: CAPACITY + 1, capacity: CAPACITY }));
}

#[test]
fn frames_of_other_nodes_and_short_frames_are_not_answers() {
    let mut client = reading(0x6041, 0);
    let reply = [0x4b, 0x41, 0x60, 0, 0x37, 0x02, 0, 0];
    assert_eq!(client.on_frame(NOW, &Frame::new(0x582, &reply), &mut Vec::new()), None);
    assert_eq!(client.on_frame(NOW, &Frame::new(0x581, &reply[..7]), &mut Vec::new()), None);
    assert!(client.is_busy());
}

// The server against literal bytes.

#[test]
fn server_answers_expedited_requests() {
    let mut server = Server::new();
    let type_reply = Some([0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00]);
    assert_eq!(server.ask([0x40, 0x00, 0x10, 0, 0, 0, 0, 0]), type_reply);
    assert_eq!(server.ask([0x2b, 0x40, 0x60, 0, 0x0f, 0, 0, 0]), Some([0x60, 0x40, 0x60, 0, 0, 0, 0, 0]));
    assert_eq!(server.ask([0x40, 0x40, 0x60, 0, 0, 0, 0, 0]), Some([0x4b, 0x40, 0x60, 0, 0x0f, 0, 0, 0]));
    // Without a size the object's type says how many bytes count.
    assert_eq!(server.ask([0x22, 0x40, 0x60, 0, 0x06, 0, 0, 0]), Some([0x60, 0x40, 0x60, 0, 0, 0, 0, 0]));
    assert_eq!(server.value(0x6040), [6, 0]);
}

#[test]
fn server_sends_and_takes_segments() {
    let mut server = Server::new();
    assert_eq!(server.ask([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]), Some([0x41, 0x08, 0x10, 0, 40, 0, 0, 0]));
    assert_eq!(server.ask([0x60, 0, 0, 0, 0, 0, 0, 0]), Some(*b"\x00a devic"));
    assert_eq!(server.ask([0x70, 0, 0, 0, 0, 0, 0, 0]), Some(*b"\x10e name "));
    assert_eq!(server.ask([0x21, 0x00, 0x20, 0, 8, 0, 0, 0]), Some([0x60, 0x00, 0x20, 0, 0, 0, 0, 0]));
    assert_eq!(server.ask([0x00, 1, 2, 3, 4, 5, 6, 7]), Some([0x20, 0, 0, 0, 0, 0, 0, 0]));
    assert_eq!(server.ask([0x1d, 8, 0, 0, 0, 0, 0, 0]), Some([0x30, 0, 0, 0, 0, 0, 0, 0]));
    assert_eq!(server.value(0x2000), [1, 2, 3, 4, 5, 6, 7, 8]);
}

#[test]
fn fault_7_a_missing_sub_index_has_its_own_code() {
    let mut server = Server::new();
    assert_eq!(server.ask([0x40, 0x18, 0x10, 9, 0, 0, 0, 0]), Some([0x80, 0x18, 0x10, 9, 0x11, 0x00, 0x09, 0x06]));
    assert_eq!(server.ask([0x40, 0x20, 0x10, 0, 0, 0, 0, 0]), Some([0x80, 0x20, 0x10, 0, 0x00, 0x00, 0x02, 0x06]));
}

#[test]
fn fault_8_one_byte_for_four_is_too_short() {
    let mut server = Server::new();
    assert_eq!(server.ask([0x2f, 0x7a, 0x60, 0, 1, 0, 0, 0]), Some([0x80, 0x7a, 0x60, 0, 0x13, 0x00, 0x07, 0x06]));
    assert_eq!(server.ask([0x23, 0x40, 0x60, 0, 1, 0, 0, 0]), Some([0x80, 0x40, 0x60, 0, 0x12, 0x00, 0x07, 0x06]));
    assert_eq!(server.ask([0x21, 0x7a, 0x60, 0, 9, 0, 0, 0]), Some([0x80, 0x7a, 0x60, 0, 0x12, 0x00, 0x07, 0x06]));
    // Declared without a size: found out at the end.
    assert_eq!(server.ask([0x20, 0x7a, 0x60, 0, 0, 0, 0, 0]), Some([0x60, 0x7a, 0x60, 0, 0, 0, 0, 0]));
    assert_eq!(server.ask([0x09, 1, 2, 3, 0, 0, 0, 0]), Some([0x80, 0x7a, 0x60, 0, 0x13, 0x00, 0x07, 0x06]));
    assert_eq!(server.value(0x607a), [0; 4]);
}

#[test]
fn fault_9_a_new_initiate_drops_the_old_transfer() {
    let mut server = Server::new();
    server.ask([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]);
    server.ask([0x60, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(server.ask([0x40, 0x40, 0x60, 0, 0, 0, 0, 0]), Some([0x4b, 0x40, 0x60, 0, 0, 0, 0, 0]));
    let refused = Some([0x80, 0x40, 0x60, 0, 0x01, 0x00, 0x04, 0x05]);
    assert_eq!(server.ask([0x70, 0, 0, 0, 0, 0, 0, 0]), refused);

    server.ask([0x21, 0x01, 0x20, 0, 14, 0, 0, 0]);
    server.ask([0x00, 1, 2, 3, 4, 5, 6, 7]);
    server.ask([0x40, 0x40, 0x60, 0, 0, 0, 0, 0]);
    assert_eq!(server.ask([0x11, 1, 2, 3, 4, 5, 6, 7]), refused);
    assert!(server.value(0x2001).is_empty());
}

#[test]
fn server_checks_the_toggle_and_the_declared_size() {
    let mut server = Server::new();
    server.ask([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(server.ask([0x70, 0, 0, 0, 0, 0, 0, 0]), Some([0x80, 0x08, 0x10, 0, 0x00, 0x00, 0x03, 0x05]));
    server.ask([0x21, 0x01, 0x20, 0, 14, 0, 0, 0]);
    assert_eq!(server.ask([0x10, 1, 2, 3, 4, 5, 6, 7]), Some([0x80, 0x01, 0x20, 0, 0x00, 0x00, 0x03, 0x05]));
    server.ask([0x21, 0x01, 0x20, 0, 14, 0, 0, 0]);
    assert_eq!(server.ask([0x01, 1, 2, 3, 4, 5, 6, 7]), Some([0x80, 0x01, 0x20, 0, 0x13, 0x00, 0x07, 0x06]));
    server.ask([0x21, 0x01, 0x20, 0, 5, 0, 0, 0]);
    assert_eq!(server.ask([0x01, 1, 2, 3, 4, 5, 6, 7]), Some([0x80, 0x01, 0x20, 0, 0x12, 0x00, 0x07, 0x06]));
    assert!(server.value(0x2001).is_empty());
}

#[test]
fn server_refuses_by_access_and_forgets_after_an_abort() {
    let mut server = Server::new();
    assert_eq!(server.ask([0x40, 0x02, 0x20, 0, 0, 0, 0, 0]), Some([0x80, 0x02, 0x20, 0, 0x01, 0x00, 0x01, 0x06]));
    assert_eq!(server.ask([0x23, 0x00, 0x10, 0, 0, 0, 0, 0]), Some([0x80, 0x00, 0x10, 0, 0x02, 0x00, 0x01, 0x06]));
    server.ask([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(server.ask([0x80, 0x08, 0x10, 0, 0, 0, 0x04, 0x05]), None);
    assert_eq!(server.ask([0x60, 0, 0, 0, 0, 0, 0, 0]), Some([0x80, 0x08, 0x10, 0, 0x01, 0x00, 0x04, 0x05]));
}

#[test]
fn server_aborts_a_transfer_that_hangs() {
    let mut server = Server::new();
    server.0.set_sdo_timeout(TIMEOUT);
    server.ask([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]);
    let mut out = Vec::new();
    assert_eq!(server.0.next_deadline(), NOW + TIMEOUT);
    server.0.poll(NOW + TIMEOUT, &mut server.1, &mut out);
    assert_eq!(out, [Frame::new(0x581, &[0x80, 0x08, 0x10, 0, 0x00, 0x00, 0x04, 0x05])]);
    assert_eq!(server.0.next_deadline(), Time::NEVER);
}

proptest! {
    #[test]
    fn any_value_of_0_to_2000_bytes_passes_both_ways(data in proptest::collection::vec(any::<u8>(), 0..=CAPACITY)) {
        let (mut server, mut client) = (Server::new(), client());
        let at = Address::new(0x2001, 0);
        let mut out = Vec::new();
        client.start_download(NOW, 0x2001, 0, &data, &mut out).unwrap();
        prop_assert_eq!(server.run(&mut client, out), SdoOutcome::Downloaded { at });
        prop_assert_eq!(server.value(0x2001), &data);
        let mut out = Vec::new();
        client.start_upload(NOW, 0x2001, 0, &mut out).unwrap();
        let outcome = server.run(&mut client, out);
        prop_assert_eq!(outcome, SdoOutcome::Uploaded { at, len: data.len(), is_size_indicated: true });
        prop_assert_eq!(client.data(), &data);
    }

    #[test]
    fn arbitrary_answers_never_break_the_client(
        frames in proptest::collection::vec((any::<u8>(), any::<bool>(), any::<[u8; 8]>()), 0..60),
        download: bool,
        is_block: bool,
        data in proptest::collection::vec(any::<u8>(), 0..40),
    ) {
        let mut client = SdoClient::new(node_id(1).unwrap(), TIMEOUT, 40);
        let mut out = Vec::new();
        for (command, is_mine, mut bytes) in frames {
            if !client.is_busy() {
                let started = match (download, is_block) {
                    (true, false) => client.start_download(NOW, 0x2001, 0, &data, &mut out),
                    (false, false) => client.start_upload(NOW, 0x2001, 0, &mut out),
                    (true, true) => client.start_block_download(NOW, 0x2001, 0, &data, &mut out),
                    (false, true) => client.start_block_upload(NOW, 0x2001, 0, &mut out),
                };
                prop_assert_eq!(started, Ok(()));
            }
            if is_mine {
                bytes[..4].copy_from_slice(&[command, 0x01, 0x20, 0]);
            }
            client.on_frame(NOW, &Frame::new(0x581, &bytes), &mut out);
            client.poll(NOW, &mut out);
            prop_assert!(client.data().len() <= 46);
            prop_assert_eq!(client.is_busy(), client.next_deadline() != Time::NEVER);
        }
    }

    #[test]
    fn a_request_reads_as_it_was_written(index: u16, sub: u8, code: u32, data in proptest::collection::vec(any::<u8>(), 0..12)) {
        let at = Address::new(index, sub);
        let initiate = if (1..=4).contains(&data.len()) {
            Initiate::Expedited { data: &data, is_size_indicated: true }
        } else {
            Initiate::Segmented { size: Some(data.len() as u32) }
        };
        assert_eq!(wire::decode_request(&wire::download_request(at, &data)), Request::Download { at, initiate });
        let segmented = Response::Upload { at, initiate: Initiate::Segmented { size: Some(data.len() as u32) } };
        assert_eq!(wire::decode_response(&wire::segmented_upload_response(at, data.len())), segmented);
        if (1..=4).contains(&data.len()) {
            assert_eq!(wire::decode_response(&wire::expedited_upload_response(at, &data)), Response::Upload { at, initiate });
        }
        assert_eq!(wire::decode_request(&wire::upload_request(at)), Request::Upload { at });
        assert_eq!(wire::decode_response(&wire::download_response(at)), Response::Download { at });
        let abort = wire::abort(at, AbortCode(code));
        assert_eq!(wire::decode_response(&abort), Response::Abort { at, code: AbortCode(code) });
        let toggle = sub & 1 != 0;
        let (segment, len) = wire::segment(&data, 0, toggle);
        let Request::DownloadSegment(read) = wire::decode_request(&segment) else { panic!("not a segment") };
        assert_eq!((read.data, read.toggle, read.last), (&data[..len], toggle, data.len() <= 7));
        assert_eq!(wire::decode_response(&wire::download_segment_response(toggle)), Response::DownloadSegment { toggle });
        assert_eq!(wire::decode_request(&wire::upload_segment_request(toggle)), Request::UploadSegment { toggle });
    }
}
