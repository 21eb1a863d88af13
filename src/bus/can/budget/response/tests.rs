use super::super::bits::worst_bits;
use super::*;

const US: u64 = 1000;

/// Frames of `bytes` each, by priority, every `period_us` at `bit_rate`.
fn streams(bytes: &[u8], period_us: u64, bit_rate: u64) -> Vec<Stream> {
    let each = bytes.iter().zip(0x080..);
    each.map(|(&bytes, cob_id)| stream(cob_id, bytes, period_us, bit_rate)).collect()
}

fn stream(cob_id: u16, bytes: u8, period_us: u64, bit_rate: u64) -> Stream {
    Stream {
        cob_id,
        transmission_ns: u64::from(worst_bits(bytes)) * (1_000_000_000 / bit_rate),
        period_ns: period_us * US,
        jitter_ns: 0,
    }
}

/// Request and answer of an SDO every 5 ms, four heartbeats every 100 ms.
fn background(bit_rate: u64) -> Vec<Stream> {
    let sdo = [stream(0x581, 8, 5000, bit_rate), stream(0x601, 8, 5000, bit_rate)];
    let heartbeats = [0x701, 0x702, 0x70a, 0x77f].map(|id| stream(id, 1, 100_000, bit_rate));
    [&sdo[..], &heartbeats].concat()
}

fn load(streams: &[Stream]) -> f64 {
    100.0 * streams.iter().map(|stream| stream.transmission_ns as f64 / stream.period_ns as f64).sum::<f64>()
}

struct Case {
    name: &'static str,
    bytes: &'static [u8],
    period_us: u64,
    bit_rate: u64,
    cyclic: &'static str,
    with_background: &'static str,
    /// Of the last cyclic frame; `None` if there is no bound.
    response_us: Option<u64>,
}

/// Two drives and a sensor in eight arrangements: SYNC, then set-points, drives' and sensor's data.
const CASES: [Case; 8] = [
    case("A", &[0, 6, 6, 6, 6, 8, 4], 1000, 1_000_000, "74.5", "80.2", Some(880)),
    case("B", &[1, 8, 8, 8, 8, 8, 8], 1000, 1_000_000, "87.5", "93.2", Some(1010)),
    case("C", &[1, 8, 8, 8, 8, 8, 8, 8, 8], 1000, 1_000_000, "114.5", "120.2", None),
    case("D", &[0, 6, 6, 6, 6, 8, 8, 8], 1000, 1_000_000, "92.0", "97.7", Some(1055)),
    case("E", &[0, 8, 6, 6, 8, 4], 1000, 1_000_000, "65.0", "70.7", Some(785)),
    case("F", &[0, 8, 8, 8, 8], 1000, 1_000_000, "59.5", "65.2", Some(730)),
    case("G", &[0, 6, 6, 6, 6, 8, 4], 1000, 500_000, "149", "160", None),
    case("H", &[0, 8, 8, 8, 8, 8, 4], 2000, 1_000_000, "41.2", "46.9", Some(960)),
];

const fn case(
    name: &'static str,
    bytes: &'static [u8],
    period_us: u64,
    bit_rate: u64,
    cyclic: &'static str,
    with_background: &'static str,
    response_us: Option<u64>,
) -> Case {
    Case { name, bytes, period_us, bit_rate, cyclic, with_background, response_us }
}

#[test]
fn known_arrangements_of_two_drives_and_a_sensor() {
    for case in CASES {
        let name = case.name;
        let cyclic = streams(case.bytes, case.period_us, case.bit_rate);
        let all = [&cyclic[..], &background(case.bit_rate)].concat();
        let digits = case.cyclic.split_once('.').map_or(0, |(_, digits)| digits.len());
        assert_eq!(format!("{:.digits$}", load(&cyclic)), case.cyclic, "{name}");
        assert_eq!(format!("{:.digits$}", load(&all)), case.with_background, "{name} with background");
        let last = cyclic.last().unwrap();
        let response = response_among_ns(last, &all, 1_000_000_000 / case.bit_rate);
        assert_eq!(response, case.response_us.map(|response| response * US), "{name}");
    }
}

#[test]
fn sync_waits_for_one_frame_of_eight_bytes() {
    let all = [streams(&[0, 6, 6, 6, 6, 8, 4], 1000, 1_000_000), background(1_000_000)].concat();
    assert_eq!(response_among_ns(&all[0], &all, 1000), Some(190 * US));
}

/// The example that refuted the analysis before: the first frame of C arrives after 3.0 ms, the second of the same busy
/// period after 3.5 ms [DBBL07, table 2].
#[test]
fn a_later_instance_of_a_busy_period_can_be_the_worst() {
    let at = |cob_id, period_ns| Stream { cob_id, transmission_ns: 1_000_000, period_ns, jitter_ns: 0 };
    let streams = [at(1, 2_500_000), at(2, 3_500_000), at(3, 3_500_000)];
    let responses = streams.map(|stream| response_among_ns(&stream, &streams, 8000));
    assert_eq!(responses, [Some(2_000_000), Some(3_000_000), Some(3_500_000)]);
}

#[test]
fn jitter_of_others_can_bring_two_of_their_frames_into_one_window() {
    let late = Stream { cob_id: 1, transmission_ns: 100, period_ns: 1000, jitter_ns: 900 };
    let own = Stream { cob_id: 2, transmission_ns: 200, period_ns: 5000, jitter_ns: 0 };
    assert_eq!(response_ns(&own, 0, &[late], 1), Some(400));
    assert_eq!(response_ns(&own, 0, &[Stream { jitter_ns: 0, ..late }], 1), Some(300));
    // Its own jitter counts from the beginning of the period.
    assert_eq!(response_ns(&Stream { jitter_ns: 50, ..own }, 70, &[late], 1), Some(520));
}

#[test]
fn a_deadline_may_be_longer_than_the_period() {
    let before = Stream { cob_id: 1, transmission_ns: 60, period_ns: 100, jitter_ns: 0 };
    let own = Stream { cob_id: 2, transmission_ns: 39, period_ns: 100, jitter_ns: 0 };
    let response = response_ns(&own, 39, &[before], 1).unwrap();
    assert!(response > own.period_ns, "{response}");
    assert_eq!(response_ns(&Stream { transmission_ns: 41, ..own }, 39, &[before], 1), None);
}
