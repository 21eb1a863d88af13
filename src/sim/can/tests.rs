use proptest::prelude::*;

use super::*;

const MEGABIT: BitTiming = BitTiming::Arbitrated { bit_rate: 1_000_000 };

fn bus(orders: &[QueueOrder]) -> VirtualBus {
    VirtualBus::new(MEGABIT, orders).unwrap()
}

fn sync() -> Frame {
    Frame::new(0x080, &[])
}

/// Delivered identifiers with their times in microseconds.
fn drain(bus: &mut VirtualBus, until_us: u64) -> Vec<(u64, u16)> {
    std::iter::from_fn(|| bus.advance(Time::from_micros(until_us)))
        .map(|delivery| (delivery.time.0 / 1000, delivery.frame.id()))
        .collect()
}

#[test]
fn one_frame_arrives_after_its_bits_without_the_interframe_space() {
    let mut bus = bus(&[QueueOrder::Fifo, QueueOrder::Priority]);
    assert_eq!(bus.next_event(), Time::NEVER);
    assert!(bus.submit(0, Time::from_micros(10), sync()));
    assert_eq!(bus.next_event(), Time::from_micros(10 + 48));
    assert_eq!(bus.advance(Time(57_999)), None);
    let delivery = bus.advance(Time::from_micros(58)).unwrap();
    assert_eq!(delivery, Delivery { time: Time::from_micros(58), from: 0, frame: sync() });
    assert_eq!(bus.next_event(), Time::NEVER);
    assert_eq!((bus.counters().frames, bus.counters().bits), (1, 51));
}

#[test]
fn the_bit_rate_scales_the_time() {
    for (bit_rate, ns) in [(500_000, 96_000), (800_000, 60_000), (83_333, 576_002)] {
        let mut bus = VirtualBus::new(BitTiming::Arbitrated { bit_rate }, &[QueueOrder::Fifo]).unwrap();
        bus.submit(0, Time(0), sync());
        assert_eq!(bus.next_event(), Time(ns));
    }
    for bit_rate in [0, 1_000_001] {
        let refused = VirtualBus::new(BitTiming::Arbitrated { bit_rate }, &[]).unwrap_err();
        assert_eq!(refused, CanError::BitRate { bit_rate });
    }
}

#[test]
fn of_two_nodes_at_the_same_moment_the_lower_identifier_goes_first() {
    let mut bus = bus(&[QueueOrder::Priority; 2]);
    let (low, high) = (Frame::new(0x181, &[]), Frame::new(0x182, &[]));
    bus.submit(0, Time(0), high);
    bus.submit(1, Time(0), low);
    let first = bus.advance(Time::from_micros(1000)).unwrap();
    let second = bus.advance(Time::from_micros(1000)).unwrap();
    assert_eq!((first.from, first.frame, second.from, second.frame), (1, low, 0, high));
    let gap = second.time - first.time;
    assert_eq!(gap, Duration::from_micros(u64::from(frame_bits(&high))));
}

#[test]
fn a_frame_on_the_wire_is_not_interrupted() {
    let mut bus = bus(&[QueueOrder::Priority; 2]);
    bus.submit(0, Time(0), Frame::new(0x700, &[0; 8]));
    bus.submit(1, Time(1), sync());
    let order: Vec<u16> = drain(&mut bus, 1000).into_iter().map(|(_, id)| id).collect();
    assert_eq!(order, [0x700, 0x080]);
}

#[test]
fn a_fifo_port_keeps_its_order_and_a_priority_port_does_not() {
    for (order, expected) in [(QueueOrder::Fifo, [0x202, 0x201, 0x300]), (QueueOrder::Priority, [0x201, 0x202, 0x300])]
    {
        let mut bus = bus(&[order, QueueOrder::Priority]);
        bus.submit(0, Time(0), Frame::new(0x202, &[]));
        bus.submit(0, Time(0), Frame::new(0x201, &[]));
        bus.submit(1, Time(0), Frame::new(0x300, &[]));
        assert_eq!(drain(&mut bus, 1000).into_iter().map(|(_, id)| id).collect::<Vec<_>>(), expected);
    }
}

#[test]
fn a_low_frame_at_the_head_of_a_fifo_holds_up_the_high_one_behind_it() {
    let mut bus = bus(&[QueueOrder::Fifo, QueueOrder::Priority]);
    bus.submit(0, Time(0), Frame::new(0x601, &[]));
    bus.submit(0, Time(0), sync());
    bus.submit(1, Time(0), Frame::new(0x181, &[]));
    assert_eq!(drain(&mut bus, 1000).into_iter().map(|(_, id)| id).collect::<Vec<_>>(), [0x181, 0x601, 0x080]);
}

#[test]
fn an_answer_at_delivery_takes_part_in_the_next_arbitration() {
    let mut bus = bus(&[QueueOrder::Priority; 2]);
    bus.submit(0, Time(0), sync());
    bus.submit(0, Time(0), Frame::new(0x600, &[]));
    let delivered = bus.advance(Time::from_micros(48)).unwrap();
    bus.submit(1, delivered.time, Frame::new(0x181, &[]));
    assert_eq!(drain(&mut bus, 1000).first().map(|(_, id)| *id), Some(0x181));
}

#[test]
fn without_bit_timing_frames_arrive_at_once_and_by_priority() {
    let mut bus = VirtualBus::new(BitTiming::Ideal, &[QueueOrder::Priority; 3]).unwrap();
    for (port, id) in [(0, 0x300), (1, 0x100), (2, 0x200)] {
        bus.submit(port, Time::from_micros(7), Frame::new(id, &[]));
    }
    assert_eq!(bus.next_event(), Time::from_micros(7));
    assert_eq!(drain(&mut bus, 7), [(7, 0x100), (7, 0x200), (7, 0x300)]);
}

#[test]
fn a_full_queue_loses_and_counts() {
    let mut bus = bus(&[QueueOrder::Fifo]);
    for _ in 0..QUEUE_FRAMES {
        assert!(bus.submit(0, Time(0), sync()));
    }
    assert!(!bus.submit(0, Time(0), sync()));
    assert!(!bus.submit(1, Time(0), sync()));
    assert_eq!((bus.counters().overflowed, bus.counters().queue_high_water), (2, QUEUE_FRAMES));
    bus.clear(0);
    assert_eq!((bus.next_event(), bus.queued(0)), (Time::NEVER, 0));
}

#[test]
fn tampering_changes_one_bit_or_loses_a_frame() {
    let mut bus = bus(&[QueueOrder::Fifo]);
    bus.set_tamper(|_: Time, _: usize, frame: Frame| match frame.id() {
        0x18a => Some(Frame::from_bits(0x18a, frame.bits() ^ 1 << 9, frame.len())),
        0x080 => None,
        _ => Some(frame),
    });
    for frame in [sync(), Frame::new(0x18a, &[1, 2, 3]), Frame::new(0x181, &[4])] {
        bus.submit(0, Time(0), frame);
    }
    let delivered: Vec<Frame> =
        std::iter::from_fn(|| bus.advance(Time::NEVER)).map(|delivery| delivery.frame).collect();
    assert_eq!(delivered, [Frame::new(0x18a, &[1, 0, 3]), Frame::new(0x181, &[4])]);
    assert_eq!((bus.counters().dropped, bus.counters().altered, bus.counters().frames), (1, 1, 3));
}

#[test]
fn two_nodes_with_one_identifier_are_counted() {
    let mut bus = bus(&[QueueOrder::Priority; 2]);
    bus.submit(0, Time(0), Frame::new(0x181, &[1]));
    bus.submit(1, Time(0), Frame::new(0x181, &[2]));
    drain(&mut bus, 1000);
    assert_eq!(bus.counters().identifier_clashes, 1);
}

#[test]
fn load_is_the_share_of_time_that_bits_take() {
    let mut bus = bus(&[QueueOrder::Fifo]);
    let before = *bus.counters();
    for _ in 0..10 {
        bus.submit(0, Time(0), sync());
    }
    drain(&mut bus, 1000);
    let load = bus.counters().load_since(&before, Duration::from_millis(1), 1_000_000);
    assert!((load - 0.510).abs() < 1e-12);
}

proptest! {
    #[test]
    fn every_frame_arrives_once_and_frames_never_overlap(
        sent in prop::collection::vec((0usize..3, 0u64..2000, 0u16..0x800, 0u8..9, any::<u64>()), 0..60)
    ) {
        let mut bus = bus(&[QueueOrder::Fifo, QueueOrder::Priority, QueueOrder::Priority]);
        let mut sent = sent;
        sent.sort_by_key(|(_, at, ..)| *at);
        let mut delivered = Vec::new();
        for &(port, at, id, len, bits) in &sent {
            delivered.extend(std::iter::from_fn(|| bus.advance(Time::from_micros(at))));
            bus.submit(port, Time::from_micros(at), Frame::from_bits(id, bits, len));
        }
        delivered.extend(std::iter::from_fn(|| bus.advance(Time::NEVER)));
        prop_assert_eq!(delivered.len(), sent.len());
        for pair in delivered.windows(2) {
            let bits = frame_bits(&pair[1].frame);
            prop_assert!(pair[1].time - pair[0].time >= Duration::from_micros(u64::from(bits)));
        }
        let key = |port: usize, frame: Frame| (port, frame.id(), frame.len(), frame.bits());
        let mut expected: Vec<_> = sent.iter().map(|s| key(s.0, Frame::from_bits(s.2, s.4, s.3))).collect();
        let mut got: Vec<_> = delivered.iter().map(|d| key(d.from, d.frame)).collect();
        expected.sort_unstable();
        got.sort_unstable();
        prop_assert_eq!(expected, got);
    }
}

proptest! {
    /// Submitting looks at the new frame alone: it has to come to what arbitration among all frames gives.
    #[test]
    fn what_is_sent_next_is_always_what_arbitration_gives(
        actions in proptest::collection::vec((0usize..4, 0u16..6, 0u64..120, 0u8..10), 1..80), ideal: bool,
    ) {
        let timing = if ideal { BitTiming::Ideal } else { MEGABIT };
        let orders = [QueueOrder::Fifo, QueueOrder::Priority, QueueOrder::Priority, QueueOrder::Fifo];
        let mut bus = VirtualBus::new(timing, &orders).unwrap();
        let mut now_us = 0;
        for (port, id, wait_us, action) in actions {
            match action {
                0 => bus.clear(port),
                1..=3 => {
                    now_us += wait_us;
                    while bus.advance(Time::from_micros(now_us)).is_some() {
                        prop_assert_eq!(bus.next, bus.arbitrate());
                    }
                }
                _ => {
                    bus.submit(port, Time::from_micros(now_us), Frame::new(0x100 + id, &[]));
                }
            }
            prop_assert_eq!(bus.next, bus.arbitrate());
        }
    }
}
