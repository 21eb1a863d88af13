//! How fast the segments of a block leave: at an interval while process data run, else as fast as there is room for them.

use super::super::super::Outbox;
use super::*;

const INTERVAL: Duration = Duration::from_micros(250);

/// An outbox with room for some frames that can wait.
#[derive(Default)]
struct Narrow {
    frames: Vec<Frame>,
    room: usize,
    refused: usize,
}

impl Outbox for Narrow {
    fn push(&mut self, frame: Frame) {
        self.frames.push(frame);
    }

    fn offer(&mut self, frame: Frame) -> bool {
        if self.room == 0 {
            self.refused += 1;
            return false;
        }
        self.room -= 1;
        self.frames.push(frame);
        true
    }
}

impl Narrow {
    fn with_room(room: usize) -> Self {
        Self { room, ..Self::default() }
    }

    /// The sequence numbers of the segments in it.
    fn sequence(&self) -> Vec<u8> {
        self.frames.iter().map(|frame| frame.data()[0] & 0x7f).collect()
    }
}

/// A client that is to write 70 bytes in one block, and what it sends on the answer that begins it.
fn begun(is_exchanging: bool, mut out: Narrow) -> (SdoClient, Narrow) {
    let mut client = client();
    client.set_exchanging(is_exchanging);
    client.start_block_download(NOW, 0x2001, 0, &[7; 70], &mut Vec::new()).unwrap();
    client.on_frame(NOW, &Frame::new(0x581, &[0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]), &mut out);
    (client, out)
}

#[test]
fn a_client_waits_between_segments_only_while_process_data_run() {
    let (_, out) = begun(false, Narrow::with_room(100));
    assert_eq!(out.sequence(), [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);

    let (mut client, mut out) = begun(true, Narrow::with_room(100));
    assert_eq!((out.sequence(), client.next_deadline()), (vec![1], NOW + INTERVAL));
    // They end while the block is on its way.
    client.set_exchanging(false);
    client.poll(NOW + INTERVAL, &mut out);
    assert_eq!(out.sequence(), [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
}

#[test]
fn several_clients_are_told_at_once_and_those_who_come_later_too() {
    let node = node_id(1).unwrap();
    let mut clients = SdoClients::new();
    clients.set_exchanging(false);
    clients.add_node(node, TIMEOUT);
    for is_exchanging in [false, true] {
        if is_exchanging {
            clients.set_exchanging(true);
        }
        let mut out = Narrow::with_room(100);
        let write = ObjectRequest::Write(Address::new(0x2001, 0), &[7; 70]);
        clients.request(NOW, node, write, &mut out).unwrap();
        clients.on_frame(NOW, &Frame::new(0x581, &[0xa4, 0x01, 0x20, 0, 127, 0, 0, 0]), &mut out);
        assert_eq!(out.frames.len(), if is_exchanging { 2 } else { 11 });
        // The next one begins after an abort of this one.
        clients.on_frame(NOW, &Frame::new(0x581, &[0x80, 0x01, 0x20, 0, 0, 0, 0, 8]), &mut out).unwrap();
    }
}

#[test]
fn a_segment_without_room_is_offered_again_and_none_is_left_out() {
    let (mut client, mut out) = begun(false, Narrow::with_room(4));
    let mut now = NOW;
    for (room, sent) in [(0, 4), (2, 6), (4, 10)] {
        assert_eq!(client.next_deadline(), now + INTERVAL);
        now = now + INTERVAL;
        out.room = room;
        assert_eq!(client.poll(now, &mut out), None);
        assert_eq!(out.sequence(), (1..=sent).collect::<Vec<u8>>());
    }
    assert_eq!(out.refused, 3);
    assert_eq!(client.next_deadline(), now + TIMEOUT);
}

#[test]
fn without_any_room_a_client_ends_in_bounded_time() {
    let (mut client, mut out) = begun(false, Narrow::with_room(3));
    let (outcome, now) = loop {
        let now = client.next_deadline();
        assert!(now <= NOW + TIMEOUT * 4, "it goes on for ever");
        if let Some(outcome) = client.poll(now, &mut out) {
            break (outcome, now);
        }
    };
    assert_eq!(outcome, SdoOutcome::TimedOut { at: Address::new(0x2001, 0), may_be_written: false });
    assert_eq!(now, NOW + INTERVAL + TIMEOUT * 3);
    assert_eq!(out.frames.last().map(|frame| frame.data()[0]), Some(0x80));
}

/// A device that was asked for 70 bytes in one block; what it sends on the start of it.
fn asked_for_a_block(server: &mut Server, now: Time, mut out: Narrow) -> Narrow {
    server.1.set_bytes(Address::new(0x2001, 0), &[7; 70]).unwrap();
    for request in [[0xa4, 0x01, 0x20, 0, 127, 0, 0, 0], [0xa3, 0, 0, 0, 0, 0, 0, 0]] {
        server.0.on_frame(now, &Frame::new(0x601, &request), &mut server.1, &mut out);
    }
    out.frames.remove(0);
    out
}

#[test]
fn a_device_waits_between_segments_while_it_is_operational_and_for_a_second_after_sync() {
    let all = |now: Time, server: &mut Server| asked_for_a_block(server, now, Narrow::with_room(100)).frames.len();
    assert_eq!(all(NOW, &mut Server::new()), 10);

    let mut server = Server::new();
    server.0.on_frame(NOW, &Frame::new(0x000, &[1, 1]), &mut server.1, &mut Vec::new());
    assert_eq!(all(NOW + Duration::from_secs(9), &mut server), 1);

    for (ms, sent) in [(0, 1), (999, 1), (1000, 10)] {
        let mut server = Server::new();
        server.0.on_frame(NOW, &Frame::new(0x080, &[]), &mut server.1, &mut Vec::new());
        assert_eq!(all(NOW + Duration::from_millis(ms), &mut server), sent, "{ms} ms after SYNC");
    }
}

#[test]
fn a_device_offers_again_what_there_was_no_room_for_and_gives_up_in_the_end() {
    let mut server = Server::new();
    server.0.set_sdo_timeout(Duration::from_millis(20));
    let mut out = asked_for_a_block(&mut server, NOW, Narrow::with_room(4));
    assert_eq!((out.sequence(), server.0.next_deadline()), (vec![1, 2, 3, 4], NOW + INTERVAL));
    out.room = 3;
    server.0.poll(NOW + INTERVAL, &mut server.1, &mut out);
    assert_eq!(out.sequence(), [1, 2, 3, 4, 5, 6, 7]);
    let mut now = NOW;
    while server.0.next_deadline() != Time::NEVER {
        now = server.0.next_deadline();
        server.0.poll(now, &mut server.1, &mut out);
    }
    // Four waiting times after the last segment that was taken.
    assert_eq!(now, NOW + INTERVAL + Duration::from_millis(80));
    assert_eq!(out.frames[7..], [Frame::new(0x581, &[0x80, 0x01, 0x20, 0, 0x00, 0x00, 0x04, 0x05])]);
}

/// Writes `data` in blocks and reads it back with so much room for each side in turn; how many frames that took.
fn pass(data: &[u8], block_size: u8, mut rooms: impl Iterator<Item = usize>) -> usize {
    let mut server = Server::with_capacity(data.len());
    server.0.set_sdo_block(block_size, INTERVAL);
    let mut client = SdoClient::new(node_id(1).unwrap(), TIMEOUT, data.len());
    client.set_block(block_size, INTERVAL);
    client.set_exchanging(false);
    let at = Address::new(0x2001, 0);
    let (mut now, mut delivered) = (NOW, 0);
    for is_write in [true, false] {
        let (mut to_device, mut to_master) = (Narrow::default(), Narrow::default());
        let started = if is_write {
            client.start_block_download(now, 0x2001, 0, data, &mut to_device)
        } else {
            client.start_block_upload(now, 0x2001, 0, &mut to_device)
        };
        started.unwrap();
        let mut outcome = None;
        while outcome.is_none() {
            (to_device.room, to_master.room) = (rooms.next().unwrap(), rooms.next().unwrap());
            let requests = std::mem::take(&mut to_device.frames);
            let answers = std::mem::take(&mut to_master.frames);
            delivered += requests.len() + answers.len();
            for frame in &requests {
                server.0.on_frame(now, frame, &mut server.1, &mut to_master);
            }
            for frame in &answers {
                outcome = outcome.or(client.on_frame(now, frame, &mut to_device));
            }
            if requests.is_empty() && answers.is_empty() {
                now = now.max(client.next_deadline().min(server.0.next_deadline()));
                assert_ne!(now, Time::NEVER, "both wait for ever");
                server.0.poll(now, &mut server.1, &mut to_master);
                outcome = outcome.or(client.poll(now, &mut to_device));
            }
        }
        if is_write {
            assert_eq!(outcome, Some(SdoOutcome::Downloaded { at }));
            assert_eq!(server.value(0x2001), data);
        } else {
            assert_eq!(outcome, Some(SdoOutcome::Uploaded { at, len: data.len(), is_size_indicated: true }));
            assert_eq!(client.data(), data);
        }
    }
    delivered
}

proptest! {
    #[test]
    fn little_room_costs_time_and_no_frame(
        len in 30usize..3000, rooms in proptest::collection::vec(0usize..40, 1..20), block_size in 1u8..=127,
    ) {
        let data: Vec<u8> = (0..len).map(|place| (place % 251) as u8).collect();
        // Now and then there is some for each side, so that none is given up.
        let rooms = rooms.into_iter().cycle().enumerate();
        let rooms = rooms.map(|(at, room)| if at % 8 < 2 { room + 1 } else { room });
        prop_assert_eq!(pass(&data, block_size, rooms), pass(&data, block_size, std::iter::repeat(1000)));
    }
}

#[test]
fn a_write_that_stores_has_ten_seconds_and_any_other_its_usual_time() {
    let usual = Duration::from_millis(100);
    let node = crate::canopen::node_id(1).unwrap();
    for (index, time) in [(0x1010, Duration::from_secs(10)), (0x1011, Duration::from_secs(10)), (0x6072, usual)] {
        let (mut client, mut out) = (SdoClient::new(node, usual, 64), Vec::new());
        client.start_download(NOW, index, 1, b"save", &mut out).unwrap();
        assert_eq!(client.next_deadline(), NOW + time);
        client.on_frame(NOW, &Frame::new(0x581, &[0x60, index as u8, (index >> 8) as u8, 1, 0, 0, 0, 0]), &mut out);
        // It is read in its usual time, and written in longer than that where all objects have longer.
        client.start_upload(NOW, index, 1, &mut out).unwrap();
        assert_eq!(client.next_deadline(), NOW + usual);
    }
    let minute = Duration::from_secs(60);
    let mut client = SdoClient::new(node, minute, 64);
    client.start_download(NOW, 0x1010, 1, b"save", &mut Vec::new()).unwrap();
    assert_eq!(client.next_deadline(), NOW + minute);
}
