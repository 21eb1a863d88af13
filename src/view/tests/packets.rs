use tokio::sync::broadcast::error::TryRecvError;
use yieldwall_motion::guard::{Cause, DeviceSet, Fault, State};
use yieldwall_record::recording::{Backpressure, Feed, Recorded, Sink, encode, layout};
use yieldwall_record::{CycleRecord, DeviceRecord};

use super::{hello, push, record};
use crate::packet::Packet;
use crate::stream::{RECORDS, WAITING};
use crate::{RING, faults, stream};

#[test]
fn a_packet_has_these_bytes() {
    let mut packet = Packet::new(2, layout::<DeviceRecord>().stride);
    let mut sample = DeviceRecord::blank();
    (sample.index, sample.sample_ns, sample.scene_time_s) = (0x0102_0304, 7, 1.5);
    (sample.signed_distance_m, sample.is_on_surface, sample.hold_counter) = (-2.0, true, 5);
    packet.push(&sample);
    packet.push(&DeviceRecord::blank());
    let bytes = packet.take(0x1122).unwrap();
    assert_eq!(bytes[..16], [1, 0, 0, 0, 2, 0, 0, 0, 0x22, 0x11, 0, 0, 0, 0, 0, 0]);
    let first = &bytes[16..];
    assert_eq!(first[..8], [4, 3, 2, 1, 0, 0, 0, 0]);
    assert_eq!(first[8..16], [7, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(first[16..24], [0, 0, 0, 0, 0, 0, 0xf8, 0x3f]);
    // After twelve numbers: the distance, the flag and, aligned, the counter.
    assert_eq!(first[96..104], [0, 0, 0, 0, 0, 0, 0, 0xc0]);
    assert_eq!(first[104..112], [1, 0, 0, 0, 5, 0, 0, 0]);
    assert_eq!(bytes.len(), 16 + 2 * layout::<DeviceRecord>().stride);
    assert!(packet.take(0).is_none());
}

#[test]
fn the_layout_of_a_cycle_begins_like_this() {
    let layout = layout::<CycleRecord>();
    let fields: Vec<_> = layout.fields.iter().map(|field| (field.name, field.type_name, field.offset)).collect();
    let begin = [
        ("index", "uint64", 0),
        ("sync_ns", "uint64", 8),
        ("compute_ns", "uint64", 16),
        ("scene_time_s", "float64", 24),
        ("sync_woke_ns", "uint32", 32),
        ("woke_ns", "uint32", 36),
        ("stepped_ns", "uint32", 40),
        ("sent_ns", "uint32", 44),
        ("left_has_angle", "bool", 48),
        ("left_angle_rad", "float64", 56),
        ("left_state", "uint8", 64),
    ];
    assert_eq!(fields[..begin.len()], begin);
    assert!(layout.fields.iter().all(|field| field.offset % field.size == 0));
    assert_eq!(layout.stride % 8, 0);
    // The data of a recording's message, and what pads them.
    let (mut bytes, mut packet) = (Vec::new(), Packet::new(1, layout.stride));
    let record = record(3);
    encode(&record, &mut bytes);
    let packed = packet.push(&record);
    assert_eq!(packed.len(), layout.stride);
    assert!(packed.starts_with(&bytes[4..]) && packed.len() < bytes.len() - 4 + 8);
}

#[test]
fn packets_leave_when_they_are_full_or_the_ring_has_rested() {
    let (stream, mut sink) = stream::<CycleRecord>();
    let mut packets = stream.packets().subscribe();
    push(&mut sink, 0..u64::from(RECORDS) + 2);
    let mut next = || packets.try_recv().map(|packet| (packet.before, packet.count, packet.bytes[8]));
    assert_eq!(next(), Ok((0, 16, 0)));
    // Nine rests are about 18 ms.
    (0..9).for_each(|_| sink.rest(5));
    assert_eq!(next(), Err(TryRecvError::Empty));
    sink.rest(5);
    assert_eq!(next(), Ok((16, 2, 5)));
    (0..30).for_each(|_| sink.rest(6));
    assert_eq!(next(), Err(TryRecvError::Empty));
    push(&mut sink, 18..19);
    sink.finish().unwrap();
    assert_eq!(next(), Ok((18, 1, 6)));
    assert_eq!((sink.stored(), stream.figures().records, stream.figures().lost), (19, 19, 6));
}

#[test]
fn a_feed_counts_the_records_that_the_view_did_not_take() {
    let (stream, sink) = stream::<CycleRecord>();
    let mut packets = stream.packets().subscribe();
    let (mut producer, feed) = Feed::start("view", RING, Backpressure::Drop, sink).unwrap();
    // Faster than the thread takes them.
    (0..20 * RING as u64).for_each(|index| producer.push(&record(index)));
    let finished = feed.finish().unwrap();
    assert_eq!((finished.counts.refused, finished.counts.kept), (0, stream.figures().records));
    assert_eq!(finished.counts.kept + finished.counts.dropped, 20 * RING as u64);
    assert_eq!(stream.figures().lost, finished.counts.dropped);
    // The number of waiting packets has a bound.
    assert!(stream.packets().len() <= WAITING);
    let last = std::iter::from_fn(|| match packets.try_recv() {
        Err(TryRecvError::Lagged(_)) => Some(None),
        packet => packet.ok().map(Some),
    });
    let last = last.flatten().last().unwrap();
    assert_eq!(last.before + u64::from(last.count), finished.counts.kept);
}

#[test]
fn the_figures_are_those_of_the_last_record() {
    let (stream, mut sink) = stream::<CycleRecord>();
    let mut record = record(0);
    record.inputs.timing.compute_late_ns = 300;
    record.directive.state = State::Holding;
    record.cause = Some(Cause { fault: Fault::SensorStale, devices: DeviceSet::SENSOR });
    sink.take(&record).unwrap();
    record.inputs.timing.compute_late_ns = 200;
    record.cause = None;
    sink.take(&record).unwrap();
    sink.finish().unwrap();
    let figures = stream.figures();
    assert_eq!((figures.late_ns, figures.most_late_ns, figures.fault), (Some(200), Some(300), None));
    assert_eq!(figures.state, Some(State::Holding as u64));
}

#[test]
fn the_first_message_is_as_the_page_expects_it() {
    let message = hello().first_message(&layout::<CycleRecord>(), None).unwrap();
    let message: serde_json::Value = serde_json::from_str(&message).unwrap();
    assert_eq!(
        (&message["kind"], &message["protocol"], &message["command"]),
        (&"hello".into(), &1.into(), &"run".into())
    );
    assert_eq!((&message["is_live"], &message["recordings"]), (&true.into(), &serde_json::json!([])));
    assert_eq!(message["fixture"]["rows"], serde_json::json!([["R", "20 N"]]));
    let fields = message["record"]["fields"].as_array().unwrap();
    let field = |name: &str| fields.iter().find(|field| field["name"] == name).unwrap();
    assert_eq!(
        *field("compute_late_ns"),
        serde_json::json!({
            "name": "compute_late_ns",
            "unit": "ns",
            "meaning": "frames were taken and the computation began, after its planned begin",
            "type": "uint32",
            "offset": layout::<CycleRecord>().field("compute_late_ns").unwrap().offset,
        })
    );
    assert_eq!(field("state")["codes"]["holding"], 3);
    // Every fault that a record can name has its words.
    for name in field("cause")["codes"].as_object().unwrap().keys() {
        assert!(message["faults"][name]["meaning"].is_string(), "{name}");
    }
    let stale = &faults()["sensor-invalid"];
    assert_eq!(
        stale.reaction,
        "at once: R1 freeze within 1 sample, ends in Holding; 3 samples in a row: R2 stop ramp within 3 samples, ends in Stopped"
    );
}
