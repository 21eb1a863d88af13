use super::*;
use crate::ethercat::mailbox::MailboxError;
use crate::objects::{AbortCode, Access, Address, DataType, Object, ObjectDictionary, ObjectError};
use crate::time::Time;
use proptest::prelude::*;
use std::time::Duration;

fn sample() -> ObjectDictionary {
    ObjectDictionary::builder()
        .object(Object::new(0x1000, 0, 0x0002_0192u32).access(Access::ReadOnly).named("Device type"))
        .object(Object::text(0x1008, 0, "servo drive"))
        .object(Object::new(0x6041, 0, 0x0250u16).access(Access::ReadOnly).mappable(crate::objects::Mappable::Tpdo))
        .object(Object::new(0x6060, 0, 8i8).limits(-1i8, 10))
        .highest_sub(0x1018, 2)
        .object(Object::new(0x1018, 1, 0x0000_0732u32).access(Access::ReadOnly))
        .object(Object::new(0x1018, 2, 0x2648_3052u32).access(Access::ReadOnly))
        .object(Object::new(0x1c12, 0, 1u8).limits(0u8, 2).named("Outputs"))
        .object(Object::new(0x1c12, 1, 0x1600u16))
        .object(Object::new(0x1c12, 2, 0u16))
        .object(Object::new(0x2000, 0, 5u32).access(Access::WriteOnly))
        .object(Object::bytes(0x2001, 0, DataType::OctetString, &[], 600))
        .build()
        .unwrap()
}

/// The answer of a server with a mailbox for so many bytes of a message.
fn ask(server: &mut CoeServer, od: &mut ObjectDictionary, room: usize, message: &[u8]) -> Vec<u8> {
    let mut answer = vec![0xee; room];
    let len = server.on_message(message, od, &mut answer).unwrap();
    answer[..len].to_vec()
}

#[test]
fn requests_and_answers_byte_by_byte() {
    let abort = |index: u16, sub: u8, code: u32| {
        let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), code.to_le_bytes());
        vec![0x00, 0x20, 0x80, low, high, sub, a, b, c, d]
    };
    let rows: [(&[u8], Vec<u8>); 19] = [
        // Expedited uploads of four, two and one byte.
        (&[0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0], vec![0, 0x30, 0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00]),
        (&[0, 0x20, 0x40, 0x41, 0x60, 0, 0, 0, 0, 0], vec![0, 0x30, 0x4b, 0x41, 0x60, 0, 0x50, 0x02, 0, 0]),
        (&[0, 0x20, 0x40, 0x60, 0x60, 0, 0, 0, 0, 0], vec![0, 0x30, 0x4f, 0x60, 0x60, 0, 0x08, 0, 0, 0]),
        // A normal upload of eleven bytes.
        (
            &[0, 0x20, 0x40, 0x08, 0x10, 0, 0, 0, 0, 0],
            [&[0, 0x30, 0x41, 0x08, 0x10, 0, 11, 0, 0, 0][..], b"servo drive"].concat(),
        ),
        // Complete access from sub-index 0 and from 1.
        (
            &[0, 0x20, 0x50, 0x18, 0x10, 0, 0, 0, 0, 0],
            vec![0, 0x30, 0x51, 0x18, 0x10, 0, 10, 0, 0, 0, 2, 0, 0x32, 0x07, 0, 0, 0x52, 0x30, 0x48, 0x26],
        ),
        (
            &[0, 0x20, 0x50, 0x18, 0x10, 1, 0, 0, 0, 0],
            vec![0, 0x30, 0x51, 0x18, 0x10, 1, 8, 0, 0, 0, 0x32, 0x07, 0, 0, 0x52, 0x30, 0x48, 0x26],
        ),
        // Expedited downloads of one byte, and of what has no size.
        (&[0, 0x20, 0x2f, 0x60, 0x60, 0, 9, 0, 0, 0], vec![0, 0x30, 0x60, 0x60, 0x60, 0, 0, 0, 0, 0]),
        (&[0, 0x20, 0x23, 0x00, 0x20, 0, 1, 2, 3, 4], vec![0, 0x30, 0x60, 0x00, 0x20, 0, 0, 0, 0, 0]),
        // A normal download.
        (&[0, 0x20, 0x21, 0x01, 0x20, 0, 5, 0, 0, 0, 1, 2, 3, 4, 5], vec![0, 0x30, 0x60, 0x01, 0x20, 0, 0, 0, 0, 0]),
        // Complete access writes an assignment: its number 1, then one object; the second is not transferred.
        (&[0, 0x20, 0x33, 0x12, 0x1c, 0, 1, 0, 0x02, 0x16], vec![0, 0x30, 0x70, 0x12, 0x1c, 0, 0, 0, 0, 0]),
        // Refusals.
        (&[0, 0x20, 0x40, 0x42, 0x60, 0, 0, 0, 0, 0], abort(0x6042, 0, 0x0602_0000)),
        (&[0, 0x20, 0x40, 0x41, 0x60, 1, 0, 0, 0, 0], abort(0x6041, 1, 0x0609_0011)),
        (&[0, 0x20, 0x40, 0x00, 0x20, 0, 0, 0, 0, 0], abort(0x2000, 0, 0x0601_0001)),
        (&[0, 0x20, 0x2b, 0x41, 0x60, 0, 0, 0, 0, 0], abort(0x6041, 0, 0x0601_0002)),
        (&[0, 0x20, 0x2f, 0x60, 0x60, 0, 11, 0, 0, 0], abort(0x6060, 0, 0x0609_0031)),
        (&[0, 0x20, 0x2b, 0x60, 0x60, 0, 8, 0, 0, 0], abort(0x6060, 0, 0x0607_0012)),
        (&[0, 0x20, 0x50, 0x41, 0x60, 0, 0, 0, 0, 0], abort(0x6041, 0, 0x0601_0004)),
        (&[0, 0x20, 0x60, 0, 0, 0, 0, 0, 0, 0], abort(0x6041, 0, 0x0504_0001)),
        (&[0, 0x20, 0xe0, 0x41, 0x60, 0, 0, 0, 0, 0], abort(0x6041, 0, 0x0504_0001)),
    ];
    let mut od = sample();
    let mut server = CoeServer::new(&od);
    for (row, (request, answer)) in rows.iter().enumerate() {
        assert_eq!(ask(&mut server, &mut od, 122, request), *answer, "row {row}");
    }
    assert_eq!(od.bytes(Address::new(0x2001, 0)), Some(&[1, 2, 3, 4, 5][..]));
    assert_eq!(od.bytes(Address::new(0x1c12, 1)), Some(&[0x02, 0x16][..]));
}

#[test]
fn segments_go_both_ways_and_their_toggle_alternates() {
    let mut od = sample();
    let mut server = CoeServer::new(&od);
    // A mailbox of 24 bytes: 18 for the message, 8 for data of the first one and 15 for each segment.
    let text = ask(&mut server, &mut od, 18, &[0, 0x20, 0x40, 0x08, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(text, [&[0, 0x30, 0x41, 0x08, 0x10, 0, 11, 0, 0, 0][..], b"servo dr"].concat());
    let last = ask(&mut server, &mut od, 18, &[0, 0x20, 0x60, 0, 0, 0, 0, 0, 0, 0]);
    // Three of seven bytes: four unused, the last one.
    assert_eq!(last, [0, 0x30, 0x09, b'i', b'v', b'e', 0, 0, 0, 0]);
    let write = [&[0, 0x20, 0x21, 0x01, 0x20, 0, 20, 0, 0, 0][..], &[7; 8]].concat();
    assert_eq!(ask(&mut server, &mut od, 18, &write), [0, 0x30, 0x60, 0x01, 0x20, 0, 0, 0, 0, 0]);
    let full = [&[0, 0x20, 0x00][..], &[8; 7]].concat();
    assert_eq!(ask(&mut server, &mut od, 18, &full), [0, 0x30, 0x20, 0, 0, 0, 0, 0, 0, 0]);
    let last = [0, 0x20, 0x15, 9, 9, 9, 9, 9, 0, 0];
    assert_eq!(ask(&mut server, &mut od, 18, &last), [0, 0x30, 0x30, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(od.bytes(Address::new(0x2001, 0)), Some(&[[7; 8].as_slice(), &[8; 7], &[9; 5]].concat()[..]));
    ask(&mut server, &mut od, 18, &write);
    let wrong = [&[0, 0x20, 0x10][..], &[8; 7]].concat();
    assert_eq!(ask(&mut server, &mut od, 18, &wrong), [0, 0x20, 0x80, 0x01, 0x20, 0, 0, 0, 0x03, 0x05]);
}

#[test]
fn information_byte_by_byte() {
    let mut od = sample();
    let mut server = CoeServer::new(&od);
    let list = ask(&mut server, &mut od, 122, &[0, 0x80, 1, 0, 0, 0, 1, 0]);
    let indices = [0, 0x10, 0x08, 0x10, 0x18, 0x10, 0x12, 0x1c, 0, 0x20, 1, 0x20, 0x41, 0x60, 0x60, 0x60];
    assert_eq!(list, [&[0, 0x80, 2, 0, 0, 0, 1, 0][..], &indices].concat());
    let lengths = ask(&mut server, &mut od, 122, &[0, 0x80, 1, 0, 0, 0, 0, 0]);
    assert_eq!(lengths, [0, 0x80, 2, 0, 0, 0, 0, 0, 8, 0, 0, 0, 1, 0, 3, 0, 3, 0]);
    let object = ask(&mut server, &mut od, 122, &[0, 0x80, 3, 0, 0, 0, 0x12, 0x1c]);
    assert_eq!(object, [&[0, 0x80, 4, 0, 0, 0, 0x12, 0x1c, 6, 0, 2, 8][..], b"Outputs"].concat());
    let entry = ask(&mut server, &mut od, 122, &[0, 0x80, 5, 0, 0, 0, 0x41, 0x60, 0, 7]);
    assert_eq!(entry, [0, 0x80, 6, 0, 0, 0, 0x41, 0x60, 0, 0, 6, 0, 16, 0, 0x87, 0]);
    let missing = ask(&mut server, &mut od, 122, &[0, 0x80, 3, 0, 0, 0, 0x42, 0x60]);
    assert_eq!(missing, [0, 0x80, 7, 0, 0, 0, 0, 0, 0x02, 0x06]);
    // Fragments: of 18 bytes a mailbox of 14 bytes of data takes 8 at a time.
    let first = ask(&mut server, &mut od, 14, &[0, 0x80, 1, 0, 0, 0, 1, 0]);
    assert_eq!(first, [0, 0x80, 0x82, 0, 2, 0, 1, 0, 0, 0x10, 0x08, 0x10, 0x18, 0x10]);
    let mut next = [0; 14];
    assert_eq!((server.has_more(), server.poll(&mut next)), (true, 14));
    assert_eq!(next, [0, 0x80, 0x82, 0, 1, 0, 0x12, 0x1c, 0, 0x20, 1, 0x20, 0x41, 0x60]);
    assert_eq!((server.poll(&mut next), server.has_more()), (8, false));
    assert_eq!(next[..8], [0, 0x80, 2, 0, 0, 0, 0x60, 0x60]);
}

#[test]
fn what_is_no_request_is_a_mailbox_error() {
    let mut od = sample();
    let mut server = CoeServer::new(&od);
    let mut refuse = |message: &[u8]| server.on_message(message, &mut od, &mut [0; 64]).unwrap_err();
    assert_eq!(refuse(&[0]), MailboxError::SIZE_TOO_SHORT);
    assert_eq!(refuse(&[0, 0x20, 0x40, 0x18, 0x10]), MailboxError::SIZE_TOO_SHORT);
    assert_eq!(refuse(&[0, 0x80, 5, 0, 0, 0, 0x41]), MailboxError::SIZE_TOO_SHORT);
    assert_eq!(refuse(&[0, 0x50, 0, 0, 0, 0, 0, 0, 0, 0]), MailboxError::SERVICE_NOT_SUPPORTED);
}

#[test]
fn an_emergency_is_ten_bytes() {
    let emergency = CoeEmergency { code: 0x3220, register: 0x04, vendor: [1, 2, 3, 4, 5] };
    let mut message = [0; 16];
    assert_eq!(emergency.encode(&mut message), 10);
    assert_eq!(message[..10], [0x00, 0x10, 0x20, 0x32, 0x04, 1, 2, 3, 4, 5]);
    assert_eq!(CoeEmergency::decode(&message[..10]), Some(emergency));
    assert_eq!((CoeEmergency::decode(&message[..9]), emergency.encode(&mut [0; 9])), (None, 0));
}

/// Client and server through a mailbox of so many bytes, with an emergency before each answer.
fn talk(od: &mut ObjectDictionary, room: usize, request: CoeRequest<'_>) -> CoeAnswer {
    let mut server = CoeServer::new(od);
    let mut client = CoeClient::new(Duration::from_millis(10));
    client.start(Time(0), request).unwrap();
    for _ in 0..1000 {
        let (mut message, mut answer, mut alarm) = (vec![0; room], vec![0; room], [0; 10]);
        CoeEmergency { code: 0x2310, register: 2, vendor: [0; 5] }.encode(&mut alarm);
        assert!(matches!(client.on_message(Time(1), &alarm), CoeEvent::Emergency(CoeEmergency { code: 0x2310, .. })));
        let len = client.message(&mut message);
        if len == 0 && !server.has_more() {
            break;
        }
        let len = match len {
            0 => server.poll(&mut answer),
            len => server.on_message(&message[..len], od, &mut answer).unwrap(),
        };
        assert_eq!(client.on_message(Time(1), &answer[..len]), CoeEvent::Answer);
    }
    client.answer().clone()
}

#[test]
fn a_client_reads_writes_and_lists() {
    let mut od = sample();
    let read = |index, sub| CoeRequest::Read { at: Address::new(index, sub), complete: false };
    assert_eq!(talk(&mut od, 122, read(0x1008, 0)), CoeAnswer::Value(b"servo drive".to_vec()));
    let refused = CoeAnswer::Failed(ObjectError::Aborted(AbortCode::NO_SUB_INDEX));
    assert_eq!(talk(&mut od, 122, read(0x6041, 3)), refused);
    assert_eq!(talk(&mut od, 16, CoeRequest::List(ListKind::Inputs)), CoeAnswer::List(vec![0x6041]));
    let object = ObjectDescription {
        index: 0x1018,
        data_type: 0x23,
        highest_sub: 2,
        code: ObjectCode::Record as u8,
        name: String::new(),
    };
    assert_eq!(talk(&mut od, 64, CoeRequest::Object(0x1018)), CoeAnswer::Object(object));
    let entry = talk(&mut od, 64, CoeRequest::Entry(Address::new(0x1000, 0)));
    assert!(
        matches!(entry, CoeAnswer::Entry(EntryDescription { bits: 32, access: 7, ref name, .. }) if name == "Device type")
    );
}

#[test]
fn what_stays_away_or_is_foreign_does_not_hang() {
    let mut client = CoeClient::new(Duration::from_millis(10));
    let request = CoeRequest::Read { at: Address::new(0x6041, 0), complete: false };
    client.start(Time(0), request).unwrap();
    assert_eq!(client.start(Time(0), request), Err(crate::ethercat::EthercatError::Busy));
    let late = [0, 0x30, 0x4b, 0x64, 0x60, 0, 1, 2, 3, 4];
    assert_eq!(client.on_message(Time(0), &late), CoeEvent::Foreign, "nothing was sent yet");
    client.message(&mut [0; 64]);
    assert_eq!(client.on_message(Time(0), &late), CoeEvent::Foreign, "another object");
    assert_eq!(client.on_message(Time(0), &[0, 0x10]), CoeEvent::Foreign);
    client.poll(Time(9_999_999));
    assert!(client.is_busy());
    client.poll(client.next_deadline());
    assert_eq!(*client.answer(), CoeAnswer::Failed(ObjectError::NoAnswer));
}

/// A device that sends back what it was sent: of a download the request is no answer either, in one part or in segments.
#[test]
fn a_request_that_comes_back_is_no_answer_and_an_abort_is_one() {
    let at = Address::new(0x6040, 0);
    let long = [7; 200];
    let requests = [
        CoeRequest::Read { at, complete: false },
        CoeRequest::Write { at, complete: false, data: &[6, 0] },
        CoeRequest::Write { at, complete: false, data: &long },
        CoeRequest::Object(0x6040),
    ];
    for request in requests {
        let mut client = CoeClient::new(Duration::from_millis(10));
        client.start(Time(0), request).unwrap();
        let mut message = [0; 64];
        let len = client.message(&mut message);
        assert_eq!(client.on_message(Time(0), &message[..len]), CoeEvent::Foreign, "{request:?}");
        client.poll(client.next_deadline());
        assert_eq!(*client.answer(), CoeAnswer::Failed(ObjectError::NoAnswer), "{request:?}");
    }
    let mut client = CoeClient::new(Duration::from_millis(10));
    client.start(Time(0), requests[0]).unwrap();
    client.message(&mut [0; 64]);
    let abort = [0, 0x20, 0x80, 0x40, 0x60, 0, 0, 0, 2, 6];
    assert_eq!(client.on_message(Time(0), &abort), CoeEvent::Answer);
    assert_eq!(*client.answer(), CoeAnswer::Failed(ObjectError::Aborted(AbortCode::NO_OBJECT)));
}

#[test]
fn parts_without_data_that_are_not_the_last_end_the_request() {
    let general = CoeAnswer::Failed(ObjectError::Aborted(AbortCode::GENERAL));
    let mut client = CoeClient::new(Duration::from_millis(10));
    let mut hear = |request: CoeRequest<'_>, parts: [&[u8]; 2]| {
        client.start(Time(0), request).unwrap();
        for part in parts {
            assert!(client.is_busy());
            client.message(&mut [0; 64]);
            assert_eq!(client.on_message(Time(1), part), CoeEvent::Answer);
        }
        client.answer().clone()
    };
    // Eleven bytes are announced, and none comes.
    let announced = [0, 0x30, 0x41, 0x08, 0x10, 0, 11, 0, 0, 0];
    // Seven bytes of seven are unused, and it is not the last one.
    let empty = [0, 0x30, 0x0e, 0, 0, 0, 0, 0, 0, 0];
    let read = CoeRequest::Read { at: Address::new(0x1008, 0), complete: false };
    assert_eq!(hear(read, [&announced, &empty]), general);
    // A list of which two parts are left, and again two.
    let first = [0, 0x80, 0x82, 0, 2, 0, 2, 0, 0, 0x10];
    let more = [0, 0x80, 0x82, 0, 2, 0];
    assert_eq!(hear(CoeRequest::List(ListKind::Outputs), [&first, &more]), general);
}

proptest! {
    #[test]
    fn a_value_of_any_length_goes_both_ways(value in proptest::collection::vec(any::<u8>(), 0..600), room in 16usize..200) {
        let mut od = sample();
        let at = Address::new(0x2001, 0);
        let write = CoeRequest::Write { at, complete: false, data: &value };
        prop_assert_eq!(talk(&mut od, room, write), CoeAnswer::Written);
        prop_assert_eq!(od.bytes(at), Some(&value[..]));
        prop_assert_eq!(talk(&mut od, room, CoeRequest::Read { at, complete: false }), CoeAnswer::Value(value));
    }
}

/// Some devices refuse information as they would refuse an object.
#[test]
fn an_sdo_abort_ends_a_request_for_information() {
    let mut client = CoeClient::new(Duration::from_secs(1));
    client.start(Time(0), CoeRequest::List(ListKind::All)).unwrap();
    assert!(client.message(&mut [0; 64]) > 0);
    // A message that is no abort does not belong to it.
    assert_eq!(client.on_message(Time(1), &[0, 0x30, 0x43, 0x00, 0x10, 0, 1, 0, 0, 0]), CoeEvent::Foreign);
    assert_eq!(client.on_message(Time(2), &[0, 0x20, 0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05]), CoeEvent::Answer);
    assert_eq!(*client.answer(), CoeAnswer::Failed(ObjectError::Aborted(AbortCode(0x0504_0001))));
}

#[test]
fn a_write_that_stores_has_ten_seconds_and_any_other_its_usual_time() {
    let usual = Duration::from_millis(100);
    for (index, time) in [(0x1010, Duration::from_secs(10)), (0x1011, Duration::from_secs(10)), (0x6072, usual)] {
        let at = Address::new(index, 1);
        let mut client = CoeClient::new(usual);
        client.start(Time(0), CoeRequest::Write { at, complete: false, data: b"save" }).unwrap();
        let before = Time(0) + (time - Duration::from_millis(1));
        client.poll(before);
        assert!(client.is_busy(), "{index:04X}h");
        client.poll(Time(0) + time);
        assert_eq!(client.answer(), &CoeAnswer::Failed(ObjectError::NoAnswer));
    }
}
