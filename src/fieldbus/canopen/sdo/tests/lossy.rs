//! Block transfers between both ends over a channel that loses frames.

use std::collections::VecDeque;

use super::*;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    ToDevice,
    ToMaster,
}

/// Client and server on a channel in virtual time that keeps frames in order and loses some.
struct Channel<L> {
    client: SdoClient,
    server: Server,
    now: Time,
    is_lost: L,
    delivered: usize,
    lost: usize,
}

impl<L: FnMut(Way, &Frame) -> bool> Channel<L> {
    fn new(capacity: usize, is_lost: L) -> Self {
        let mut client = SdoClient::new(node_id(1).unwrap(), TIMEOUT, capacity.max(4));
        client.set_retries(8);
        client.set_longest_transfer(Duration::from_secs(3600));
        let mut server = Server::with_capacity(capacity.max(1));
        server.0.set_sdo_timeout(Duration::from_millis(250));
        Channel { client, server, now: NOW, is_lost, delivered: 0, lost: 0 }
    }

    fn run(&mut self, first: Vec<Frame>) -> SdoOutcome {
        let mut queue: VecDeque<_> = first.into_iter().map(|frame| (Way::ToDevice, frame)).collect();
        for _ in 0..20_000_000 {
            let (mut to_device, mut to_master) = (Vec::new(), Vec::new());
            let outcome = match queue.pop_front() {
                Some((way, frame)) if (self.is_lost)(way, &frame) => {
                    self.lost += 1;
                    None
                }
                Some((Way::ToDevice, frame)) => {
                    self.delivered += 1;
                    self.server.0.on_frame(self.now, &frame, &mut self.server.1, &mut to_master);
                    None
                }
                Some((Way::ToMaster, frame)) => {
                    self.delivered += 1;
                    self.client.on_frame(self.now, &frame, &mut to_device)
                }
                None => {
                    self.now = self.now.max(self.client.next_deadline().min(self.server.0.next_deadline()));
                    assert_ne!(self.now, Time::NEVER, "both sides wait for ever");
                    self.server.0.poll(self.now, &mut self.server.1, &mut to_master);
                    self.client.poll(self.now, &mut to_device)
                }
            };
            queue.extend(to_device.into_iter().map(|frame| (Way::ToDevice, frame)));
            queue.extend(to_master.into_iter().map(|frame| (Way::ToMaster, frame)));
            if let Some(outcome) = outcome {
                return outcome;
            }
        }
        panic!("the transfer does not end");
    }

    /// Writes `data` and reads it back, both in blocks.
    fn pass(&mut self, data: &[u8]) {
        let at = Address::new(0x2001, 0);
        let mut out = Vec::new();
        self.client.start_block_download(self.now, 0x2001, 0, data, &mut out).unwrap();
        assert_eq!(self.run(out), SdoOutcome::Downloaded { at });
        assert!(self.server.value(0x2001) == data, "the device has other bytes");
        let mut out = Vec::new();
        self.client.start_block_upload(self.now, 0x2001, 0, &mut out).unwrap();
        assert_eq!(self.run(out), SdoOutcome::Uploaded { at, len: data.len(), is_size_indicated: true });
        assert!(self.client.data() == data, "the master has other bytes");
    }
}

/// Loses every seventh frame that carries data in the present direction, the frames around the blocks included.
fn every_seventh() -> impl FnMut(Way, &Frame) -> bool {
    let mut counts = [0u32; 2];
    move |way, frame| {
        // Acknowledgements and confirmations are A0h to BFh; all else on either way carries data or announces it.
        if frame.data()[0] >> 5 == 5 {
            return false;
        }
        let count = &mut counts[usize::from(way == Way::ToMaster)];
        *count += 1;
        count.is_multiple_of(7)
    }
}

/// Loses frames of both ways with a probability of 1 in 20.
fn five_percent(seed: u64) -> impl FnMut(Way, &Frame) -> bool {
    let mut state = seed;
    move |_, _| {
        // SplitMix64.
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut word = state;
        word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (word ^ (word >> 31)).is_multiple_of(20)
    }
}

fn bytes(len: usize, seed: u64) -> Vec<u8> {
    (0..len as u64).map(|place| ((place + seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8).collect()
}

#[test]
fn any_one_frame_may_be_lost() {
    for block_size in [1, 2, 3, 127] {
        for len in [0, 1, 7, 8, 29, 100] {
            let data = bytes(len, 3);
            let frames = |lost: usize| {
                let mut count = 0;
                let mut channel = Channel::new(len, move |_, _| {
                    count += 1;
                    count == lost
                });
                channel.client.set_block(block_size, Duration::from_micros(250));
                channel.server.0.set_sdo_block(block_size, Duration::from_micros(250));
                channel.pass(&data);
                (channel.delivered, channel.lost)
            };
            let all = frames(0).0;
            for lost in 1..=all {
                assert_eq!(frames(lost).1, 1, "{len} bytes in blocks of {block_size}, frame {lost}");
            }
        }
    }
}

#[test]
fn any_two_frames_may_be_lost() {
    let data = bytes(60, 5);
    let frames = |first: usize, second: usize| {
        let mut count = 0;
        let mut channel = Channel::new(60, move |_, _| {
            count += 1;
            count == first || count == second
        });
        channel.client.set_block(4, Duration::ZERO);
        channel.server.0.set_sdo_block(4, Duration::ZERO);
        channel.pass(&data);
        channel.delivered
    };
    let all = frames(0, 0);
    for first in 1..=all {
        for second in first + 1..=all + 4 {
            frames(first, second);
        }
    }
}

#[test]
fn a_mebibyte_of_equal_bytes_passes_a_channel_that_loses_5_percent() {
    let mut channel = Channel::new(1 << 20, five_percent(1));
    channel.pass(&vec![0; 1 << 20]);
    assert!(channel.lost > 10_000);
}

#[test]
fn a_mebibyte_passes_a_channel_that_loses_every_seventh_frame() {
    let mut channel = Channel::new(1 << 20, every_seventh());
    channel.pass(&bytes(1 << 20, 2));
    assert!(channel.lost > 40_000);
}

#[test]
fn without_losses_a_block_costs_one_acknowledgement() {
    let mut channel = Channel::new(127 * 7 * 4, |_, _| false);
    channel.pass(&bytes(127 * 7 * 4, 1));
    // 508 segments in blocks of 127, 126, 127, 126 and 2, each with its acknowledgement. Besides: initiate and end with
    // their answers; of the upload the start, and the last confirmation is not waited for.
    assert_eq!(channel.delivered, (508 + 5 + 4) + (508 + 5 + 4));
}

#[test]
fn a_dead_channel_ends_both_sides_with_an_abort() {
    for after in 1..40 {
        let mut count = 0;
        let mut channel = Channel::new(60, move |_, _| {
            count += 1;
            count > after
        });
        let data = bytes(60, 1);
        let mut out = Vec::new();
        channel.client.start_block_download(NOW, 0x2001, 0, &data, &mut out).unwrap();
        match channel.run(out) {
            SdoOutcome::TimedOut { may_be_written, .. } => {
                let is_written = !channel.server.value(0x2001).is_empty();
                assert!(may_be_written || !is_written, "written without a word after {after} frames");
            }
            outcome => assert!(matches!(outcome, SdoOutcome::Downloaded { .. }) && after > 11, "{outcome:?}"),
        }
        channel.server.0.poll(channel.now + Duration::from_secs(2), &mut channel.server.1, &mut Vec::new());
        assert_eq!(channel.server.0.next_deadline(), Time::NEVER);
    }
}

proptest! {
    #[test]
    fn any_value_passes_a_channel_that_loses_every_seventh_frame(len in 1usize..=10_000, seed: u64) {
        Channel::new(len, every_seventh()).pass(&bytes(len, seed));
    }

    #[test]
    fn any_value_passes_a_channel_that_loses_5_percent(len in 1usize..=10_000, seed: u64, block_size in 1u8..=127) {
        let mut channel = Channel::new(len, five_percent(seed));
        channel.client.set_block(block_size, Duration::from_micros(250));
        channel.server.0.set_sdo_block(block_size, Duration::from_micros(250));
        channel.pass(&bytes(len, seed));
    }

    // Up to three wrong bits are what the checksum finds for certain. The two frames before the blocks are left alone: a
    // single wrong bit there can agree on no checksum.
    #[test]
    fn garbled_frames_never_give_wrong_bytes(len in 1usize..=2000, seed: u64, flips in proptest::collection::vec((3usize..200, 0usize..64), 1..=3)) {
        let data = bytes(len, seed);
        let mut channel = Channel::new(len, |_, _| false);
        let mut out = Vec::new();
        channel.client.start_block_download(NOW, 0x2001, 0, &data, &mut out).unwrap();
        let mut count = 0;
        let mut queue: VecDeque<_> = out.into();
        let mut outcome = None;
        for _ in 0..100_000 {
            let mut next = Vec::new();
            if let Some(frame) = queue.pop_front() {
                count += 1;
                let wrong = flips.iter().filter(|flip| flip.0 == count).fold(0, |bits, flip| bits ^ 1u64 << flip.1);
                let frame = Frame::from_bits(frame.id(), frame.bits() ^ wrong, 8);
                if frame.id() == 0x601 {
                    channel.server.0.on_frame(channel.now, &frame, &mut channel.server.1, &mut next);
                } else {
                    outcome = channel.client.on_frame(channel.now, &frame, &mut next);
                }
            } else {
                channel.now = channel.now.max(channel.client.next_deadline().min(channel.server.0.next_deadline()));
                channel.server.0.poll(channel.now, &mut channel.server.1, &mut next);
                outcome = channel.client.poll(channel.now, &mut next);
            }
            queue.extend(next);
            if outcome.is_some() {
                break;
            }
        }
        prop_assert!(outcome.is_some(), "the transfer does not end");
        if matches!(outcome, Some(SdoOutcome::Downloaded { .. })) {
            prop_assert!(channel.server.value(0x2001) == data);
        }
    }
}
