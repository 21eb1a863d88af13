//! Block transfer against literal bytes.

use super::*;

const ABORTED_BY_US: bool = false;

/// "123456789", whose checksum is the published check value 31C3h.
const DIGITS: &[u8] = b"123456789";
const START: [u8; 8] = [0xa3, 0, 0, 0, 0, 0, 0, 0];
const CONFIRMED: [u8; 8] = [0xa1, 0, 0, 0, 0, 0, 0, 0];

fn ack(acknowledged: u8, block_size: u8) -> [u8; 8] {
    [0xa2, acknowledged, block_size, 0, 0, 0, 0, 0]
}

/// All frames that a client sends on an answer, with its outcome.
fn answers(client: &mut SdoClient, bytes: [u8; 8]) -> (Option<SdoOutcome>, Vec<[u8; 8]>) {
    let mut out = Vec::new();
    let outcome = client.on_frame(NOW, &Frame::new(0x581, &bytes), &mut out);
    (outcome, out.iter().map(|frame| *frame.bytes()).collect())
}

fn writing(data: &[u8]) -> SdoClient {
    let mut client = client();
    client.set_block(127, Duration::ZERO);
    let mut out = Vec::new();
    client.start_block_download(NOW, 0x2001, 0, data, &mut out).unwrap();
    assert_eq!(out, [Frame::new(0x601, &[0xc6, 0x01, 0x20, 0, data.len() as u8, 0, 0, 0])]);
    client
}

fn reading_in_blocks(block_size: u8) -> SdoClient {
    let mut client = client();
    client.set_block(block_size, Duration::ZERO);
    let mut out = Vec::new();
    client.start_block_upload(NOW, 0x2001, 0, &mut out).unwrap();
    assert_eq!(out, [Frame::new(0x601, &[0xa4, 0x01, 0x20, 0, block_size, 28, 0, 0])]);
    client
}

/// A server that sends a block at once, with `data` in 2001h.
fn serving(data: &[u8]) -> Server {
    let mut server = Server::new();
    server.0.set_sdo_block(127, Duration::ZERO);
    server.1.set_bytes(Address::new(0x2001, 0), data).unwrap();
    server
}

/// All frames of a server on a request.
fn asked(server: &mut Server, bytes: [u8; 8]) -> Vec<[u8; 8]> {
    let mut out = Vec::new();
    server.0.on_frame(NOW, &Frame::new(0x601, &bytes), &mut server.1, &mut out);
    assert!(out.iter().all(|frame| frame.id() == 0x581 && frame.len() == 8));
    out.iter().map(|frame| *frame.bytes()).collect()
}

// The client.

#[test]
fn client_writes_in_blocks() {
    let mut client = writing(DIGITS);
    let segments = vec![*b"\x011234567", *b"\x8289\0\0\0\0\0"];
    assert_eq!(answers(&mut client, [0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]), (None, segments));
    assert_eq!(answers(&mut client, ack(2, 127)), (None, vec![[0xd5, 0xc3, 0x31, 0, 0, 0, 0, 0]]));
    let done = SdoOutcome::Downloaded { at: Address::new(0x2001, 0) };
    assert_eq!(answers(&mut client, CONFIRMED), (Some(done), vec![]));
}

#[test]
fn checksum_is_zero_unless_both_sides_have_it() {
    let mut client = writing(DIGITS);
    answers(&mut client, [0xa0, 0x01, 0x20, 0, 127, 0, 0, 0]);
    assert_eq!(answers(&mut client, ack(2, 127)).1, [[0xd5, 0, 0, 0, 0, 0, 0, 0]]);
}

#[test]
fn client_sends_again_from_the_first_segment_that_is_missing() {
    let data: Vec<u8> = (1..=28).collect();
    let mut client = writing(&data);
    let sent = answers(&mut client, [0xa4, 0x01, 0x20, 0, 3, 0, 0, 0]).1;
    assert_eq!(sent.iter().map(|segment| (segment[0], segment[1])).collect::<Vec<_>>(), [(1, 1), (2, 8), (3, 15)]);
    // The second one is lost; the next block is of 2 segments and begins with it.
    let sent = answers(&mut client, ack(1, 2)).1;
    assert_eq!(sent.iter().map(|segment| (segment[0], segment[1])).collect::<Vec<_>>(), [(1, 8), (2, 15)]);
    let sent = answers(&mut client, ack(2, 5)).1;
    assert_eq!(sent, [[0x81, 22, 23, 24, 25, 26, 27, 28]]);
    assert_eq!(answers(&mut client, ack(1, 5)).1[0][0], 0xc1);
}

#[test]
fn client_streams_at_its_interval() {
    let mut client = writing(&[7; 20]);
    client.set_block(127, Duration::from_micros(250));
    assert_eq!(answers(&mut client, [0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]).1.len(), 1);
    assert_eq!(client.next_deadline(), Time(NOW.0 + 250_000));
    for (us, sent) in [(249, 0), (250, 1), (499, 0), (500, 1), (1000, 0)] {
        let mut out = Vec::new();
        assert_eq!(client.poll(Time(NOW.0 + 1000 * us), &mut out), None);
        assert_eq!(out.len(), sent, "{us} us");
    }
    assert_eq!(client.next_deadline(), Time(NOW.0 + 500_000) + TIMEOUT);
}

#[test]
fn client_refuses_impossible_acknowledgements() {
    for (bytes, code) in [(ack(3, 127), 0x0504_0003), (ack(2, 0), 0x0504_0002), (ack(2, 128), 0x0504_0002)] {
        let mut client = writing(DIGITS);
        answers(&mut client, [0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]);
        let [a, b, c, d] = u32::to_le_bytes(code);
        let abort = vec![[0x80, 0x01, 0x20, 0, a, b, c, d]];
        assert_eq!(answers(&mut client, bytes), (aborted(0x2001, 0, code, ABORTED_BY_US), abort));
    }
    let mut client = writing(DIGITS);
    assert_eq!(
        answers(&mut client, [0xa4, 0x01, 0x20, 0, 0, 0, 0, 0]).0,
        aborted(0x2001, 0, 0x0504_0002, ABORTED_BY_US)
    );
}

#[test]
fn client_reads_in_blocks() {
    let mut client = reading_in_blocks(127);
    assert_eq!(answers(&mut client, [0xc6, 0x01, 0x20, 0, 9, 0, 0, 0]), (None, vec![START]));
    assert_eq!(answers(&mut client, *b"\x011234567"), (None, vec![]));
    // The block size of the next block is never that of this one.
    assert_eq!(answers(&mut client, *b"\x8289\0\0\0\0\0"), (None, vec![ack(2, 126)]));
    assert_eq!(answers(&mut client, [0xd5, 0xc3, 0x31, 0, 0, 0, 0, 0]), (uploaded(0x2001, 0, 9), vec![CONFIRMED]));
    assert_eq!(client.data(), DIGITS);
}

#[test]
fn client_acknowledges_what_came_in_order() {
    let mut client = reading_in_blocks(4);
    answers(&mut client, [0xc4, 0x01, 0x20, 0, 0, 0, 0, 0]);
    let segment = |sequence: u8, first: u8| [sequence, first, 0, 0, 0, 0, 0, 0];
    assert_eq!(answers(&mut client, segment(1, 1)).1, [[0; 8]; 0]);
    assert_eq!(answers(&mut client, segment(3, 3)).1, [[0; 8]; 0]);
    assert_eq!(answers(&mut client, segment(4, 4)).1, [ack(1, 2)]);
    // Repeated, garbled and impossible sequence numbers do not count.
    for (sequence, first) in [(0x7f, 9), (1, 2), (1, 9)] {
        assert_eq!(answers(&mut client, segment(sequence, first)).1, [[0; 8]; 0]);
    }
    assert_eq!(answers(&mut client, segment(2, 3)).1, [ack(2, 4)]);
    assert_eq!(answers(&mut client, segment(0x81, 4)).1, [ack(1, 3)]);
    let crc = crc(&[1, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 4]);
    assert_eq!(answers(&mut client, [0xd9, crc[0], crc[1], 0, 0, 0, 0, 0]).0, uploaded(0x2001, 0, 22));
}

fn crc(data: &[u8]) -> [u8; 2] {
    wire::crc(data).to_le_bytes()
}

#[test]
fn a_wrong_checksum_starts_the_read_anew_and_then_ends_it() {
    let mut client = reading_in_blocks(127);
    let abort = [0x80, 0x01, 0x20, 0, 0x04, 0x00, 0x04, 0x05];
    for attempt in 0..3 {
        answers(&mut client, [0xc6, 0x01, 0x20, 0, 9, 0, 0, 0]);
        answers(&mut client, *b"\x011234567");
        answers(&mut client, *b"\x8289\0\0\0\0\0");
        let (outcome, sent) = answers(&mut client, [0xd5, 0xc4, 0x31, 0, 0, 0, 0, 0]);
        let request = [0xa4, 0x01, 0x20, 0, 127, 28, 0, 0];
        if attempt < 2 {
            assert_eq!((outcome, sent), (None, vec![abort, request]));
        } else {
            assert_eq!((outcome, sent), (aborted(0x2001, 0, 0x0504_0004, ABORTED_BY_US), vec![abort]));
        }
    }
}

#[test]
fn more_or_less_than_declared_aborts_a_read_in_blocks() {
    let mut client = reading_in_blocks(127);
    answers(&mut client, [0xc6, 0x01, 0x20, 0, 6, 0, 0, 0]);
    assert_eq!(answers(&mut client, *b"\x011234567").0, aborted(0x2001, 0, 0x0607_0012, ABORTED_BY_US));
    let mut client = reading_in_blocks(127);
    answers(&mut client, [0xc6, 0x01, 0x20, 0, 12, 0, 0, 0]);
    answers(&mut client, *b"\x011234567");
    answers(&mut client, *b"\x8289\0\0\0\0\0");
    let end = [0xd5, 0xc3, 0x31, 0, 0, 0, 0, 0];
    assert_eq!(answers(&mut client, end).0, aborted(0x2001, 0, 0x0607_0013, ABORTED_BY_US));
    // Far too much, declared and undeclared.
    let mut client = reading_in_blocks(127);
    let huge = [0xc6, 0x01, 0x20, 0, 0xff, 0xff, 0xff, 0xff];
    assert_eq!(answers(&mut client, huge).0, aborted(0x2001, 0, 0x0504_0005, ABORTED_BY_US));
    let mut client = SdoClient::new(node_id(1).unwrap(), TIMEOUT, 10);
    client.start_block_upload(NOW, 0x2001, 0, &mut Vec::new()).unwrap();
    answers(&mut client, [0xc4, 0x01, 0x20, 0, 0, 0, 0, 0]);
    answers(&mut client, *b"\x011234567");
    assert_eq!(answers(&mut client, *b"\x021234567").0, aborted(0x2001, 0, 0x0504_0005, ABORTED_BY_US));
}

#[test]
fn a_server_that_never_gets_anywhere_is_given_up() {
    let mut client = reading_in_blocks(1);
    answers(&mut client, [0xc4, 0x01, 0x20, 0, 0, 0, 0, 0]);
    let ended = (0..100).find_map(|_| answers(&mut client, [0x85, 0, 0, 0, 0, 0, 0, 0]).0);
    assert_eq!(ended, aborted(0x2001, 0, 0x0504_0003, ABORTED_BY_US));
}

#[test]
fn sequence_number_0_with_the_last_bit_is_an_abort() {
    let mut client = reading_in_blocks(127);
    answers(&mut client, [0xc4, 0x01, 0x20, 0, 0, 0, 0, 0]);
    assert_eq!(answers(&mut client, [0x80, 0x17, 0x10, 0, 0, 0, 0, 8]), (None, vec![]));
    assert_eq!(
        answers(&mut client, [0x80, 0x01, 0x20, 0, 0, 0, 0, 8]),
        (aborted(0x2001, 0, 0x0800_0000, true), vec![])
    );
}

#[test]
fn a_device_may_switch_to_segments_or_not_know_blocks() {
    let mut client = reading_in_blocks(127);
    assert_eq!(answers(&mut client, [0x41, 0x01, 0x20, 0, 9, 0, 0, 0]).1, [[0x60, 0, 0, 0, 0, 0, 0, 0]]);
    answers(&mut client, *b"\x001234567");
    assert_eq!(answers(&mut client, *b"\x1b89\0\0\0\0\0").0, uploaded(0x2001, 0, 9));

    let unknown = [0x80, 0x01, 0x20, 0, 0x01, 0x00, 0x04, 0x05];
    let mut client = reading_in_blocks(127);
    assert_eq!(answers(&mut client, unknown).1, [[0x40, 0x01, 0x20, 0, 0, 0, 0, 0]]);
    let mut client = writing(DIGITS);
    assert_eq!(answers(&mut client, unknown).1, [[0x21, 0x01, 0x20, 0, 9, 0, 0, 0]]);
}

// The server.

#[test]
fn server_sends_blocks() {
    let mut server = serving(DIGITS);
    assert_eq!(asked(&mut server, [0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]), [[0xc6, 0x01, 0x20, 0, 9, 0, 0, 0]]);
    assert_eq!(asked(&mut server, START), [*b"\x011234567", *b"\x8289\0\0\0\0\0"]);
    assert_eq!(asked(&mut server, ack(2, 127)), [[0xd5, 0xc3, 0x31, 0, 0, 0, 0, 0]]);
    assert_eq!(asked(&mut server, CONFIRMED), [[0; 8]; 0]);
    assert_eq!(server.0.next_deadline(), Time::NEVER);
    // Without a checksum on the client's side, and what is short without blocks.
    asked(&mut server, [0xa0, 0x01, 0x20, 0, 127, 0, 0, 0]);
    asked(&mut server, START);
    assert_eq!(asked(&mut server, ack(2, 127)), [[0xd5, 0, 0, 0, 0, 0, 0, 0]]);
    assert_eq!(asked(&mut server, [0xa4, 0x01, 0x20, 0, 127, 9, 0, 0]), [[0x41, 0x01, 0x20, 0, 9, 0, 0, 0]]);
    assert_eq!(asked(&mut server, [0xa4, 0x40, 0x60, 0, 127, 9, 0, 0]), [[0x4b, 0x40, 0x60, 0, 0, 0, 0, 0]]);
}

#[test]
fn server_takes_blocks_and_confirms_a_repeated_end_without_writing_twice() {
    let mut server = serving(&[]);
    assert_eq!(asked(&mut server, [0xc6, 0x01, 0x20, 0, 9, 0, 0, 0]), [[0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]]);
    // The answer is lost: the same again, although it could be segment 70.
    assert_eq!(asked(&mut server, [0xc6, 0x01, 0x20, 0, 9, 0, 0, 0]), [[0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]]);
    assert_eq!(asked(&mut server, *b"\x011234567"), [[0; 8]; 0]);
    assert_eq!(asked(&mut server, *b"\x8289\0\0\0\0\0"), [ack(2, 126)]);
    assert_eq!(server.value(0x2001), [0; 0]);
    let end = [0xd5, 0xc3, 0x31, 0, 0, 0, 0, 0];
    assert_eq!(asked(&mut server, end), [CONFIRMED]);
    assert_eq!(server.value(0x2001), DIGITS);
    server.1.set_bytes(Address::new(0x2001, 0), b"own").unwrap();
    assert_eq!((asked(&mut server, end), server.value(0x2001)), (vec![CONFIRMED], &b"own"[..]));
    asked(&mut server, [0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(asked(&mut server, end)[0][0], 0x80);
}

#[test]
fn server_aborts_what_is_wrong_and_writes_nothing() {
    let abort = |code: u32| {
        let [a, b, c, d] = code.to_le_bytes();
        vec![[0x80, 0x01, 0x20, 0, a, b, c, d]]
    };
    for (end, code) in [
        ([0xd5, 0xc4, 0x31, 0, 0, 0, 0, 0], 0x0504_0004),
        ([0xd9, 0xc3, 0x31, 0, 0, 0, 0, 0], 0x0607_0013),
        ([0xd1, 0xc3, 0x31, 0, 0, 0, 0, 0], 0x0607_0012),
        ([0xdd, 0xc3, 0x31, 0, 0, 0, 0, 0], 0x0607_0010),
    ] {
        let mut server = serving(&[]);
        asked(&mut server, [0xc6, 0x01, 0x20, 0, 9, 0, 0, 0]);
        asked(&mut server, *b"\x011234567");
        asked(&mut server, *b"\x8289\0\0\0\0\0");
        assert_eq!(asked(&mut server, end), abort(code));
        assert_eq!((server.value(0x2001), server.0.next_deadline()), (&[][..], Time::NEVER));
    }
    let mut server = serving(&[1; 40]);
    assert_eq!(asked(&mut server, [0xa4, 0x01, 0x20, 0, 0, 0, 0, 0]), abort(0x0504_0002));
    assert_eq!(asked(&mut server, [0xa4, 0x01, 0x20, 0, 128, 0, 0, 0]), abort(0x0504_0002));
    asked(&mut server, [0xa4, 0x01, 0x20, 0, 3, 0, 0, 0]);
    assert_eq!(asked(&mut server, START).len(), 3);
    assert_eq!(asked(&mut server, ack(4, 3)), abort(0x0504_0003));
    // 2001 bytes do not fit, told at once or found on the way.
    assert_eq!(asked(&mut server, [0xc6, 0x01, 0x20, 0, 0xd1, 0x07, 0, 0]), abort(0x0607_0012));
    asked(&mut server, [0xc6, 0x01, 0x20, 0, 5, 0, 0, 0]);
    assert_eq!(asked(&mut server, *b"\x011234567"), abort(0x0607_0012));
    // An acknowledgement, a start and an end without a transfer.
    for stray in [ack(1, 127), START, CONFIRMED] {
        assert_eq!(asked(&mut server, stray), abort(0x0504_0001));
    }
}

#[test]
fn a_client_that_is_only_slow_may_finish_its_block() {
    let data: Vec<u8> = (0..70).collect();
    let mut server = serving(&[]);
    server.0.set_sdo_block(10, Duration::ZERO);
    let segment = |place: u8, sequence: u8| wire::block_segment(&data, place.into(), sequence);
    asked(&mut server, [0xc6, 0x01, 0x20, 0, 70, 0, 0, 0]);
    for sequence in 1..=3 {
        asked(&mut server, segment(sequence - 1, sequence));
    }
    let mut out = Vec::new();
    server.0.poll(NOW + Duration::from_millis(500), &mut server.1, &mut out);
    assert_eq!(out, [Frame::new(0x581, &ack(3, 5))]);
    // The rest of the old block: number 5 would end the new one, number 10 carries the last segment.
    for sequence in 4..=10 {
        assert_eq!(asked(&mut server, segment(sequence - 1, sequence)), [[0; 8]; 0]);
    }
    // Only then it reads the acknowledgement.
    for (place, answer) in [(3, None), (4, None), (5, None), (6, None), (7, Some(ack(5, 10)))] {
        assert_eq!(asked(&mut server, segment(place, place - 2)), answer.into_iter().collect::<Vec<_>>());
    }
    asked(&mut server, segment(8, 1));
    assert_eq!(asked(&mut server, segment(9, 2)), [ack(2, 9)]);
    let crc = crc(&data);
    assert_eq!(asked(&mut server, [0xc1, crc[0], crc[1], 0, 0, 0, 0, 0]), [CONFIRMED]);
    assert_eq!(server.value(0x2001), data);
}

#[test]
fn server_repeats_an_acknowledgement_and_gives_up_in_the_end() {
    let mut server = serving(&[]);
    server.0.set_sdo_timeout(Duration::from_millis(20));
    asked(&mut server, [0xc6, 0x01, 0x20, 0, 20, 0, 0, 0]);
    asked(&mut server, *b"\x011234567");
    let mut sent = Vec::new();
    for ms in (0..=80).step_by(10) {
        let mut out = Vec::new();
        server.0.poll(NOW + Duration::from_millis(ms), &mut server.1, &mut out);
        sent.extend(out.iter().map(|frame| *frame.bytes()));
    }
    // It acknowledges what it has once, and then repeats that.
    let mut expected = vec![ack(1, 63); 7];
    expected.push([0x80, 0x01, 0x20, 0, 0x00, 0x00, 0x04, 0x05]);
    assert_eq!(sent, expected);
    assert_eq!(server.0.next_deadline(), Time::NEVER);
}
