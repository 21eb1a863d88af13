//! The budget of a segment: against published lengths, and against the frames that a network sends.

use super::*;
use crate::ethercat::{Budget, advise};
use proptest::prelude::*;

/// A device with so many bytes of inputs and of outputs.
fn device(name: &str, device: Device, position: u16, inputs: usize, outputs: usize) -> StationSetup {
    let identity = Identity { device_type: Some(0), vendor_id: 1, product_codes: vec![1], revisions: Revisions::Any };
    let mapped = |sub| Mapped { at: Address::new(0x2000, sub), bits: 8, quantity: None, value: 0 };
    let pdo = |index, bytes: usize| {
        vec![ProcessData { device, index, is_fixed: true, entries: (1..).take(bytes).map(mapped).collect() }]
    };
    StationSetup::other(name, device, position, identity, waits(), [pdo(0x1600, outputs), pdo(0x1a00, inputs)])
}

/// Two drives and perhaps a sensor, with so many bytes of inputs and outputs each.
fn segment(drive: (usize, usize), sensor: Option<(usize, usize)>) -> SegmentSetup {
    let mut stations: Vec<StationSetup> = [("left", Device::LeftDrive), ("right", Device::RightDrive)]
        .into_iter()
        .zip(0..)
        .map(|((name, which), at)| device(name, which, at, drive.0, drive.1))
        .collect();
    stations.extend(sensor.map(|(inputs, outputs)| device("wrist", Device::Sensor, 2, inputs, outputs)));
    stations[0].acts = Acts::AtSync0;
    SegmentSetup { stations, ..setup() }
}

/// Setups of which the lengths were counted by hand: a short mapping, a long one with an ATI sensor, one with a Bota sensor, one whose
/// sensor is on CAN.
#[test]
fn lengths_are_those_counted_by_hand() {
    let setups = [
        (segment((7, 7), Some((24, 0))), [(164, 188, 15_040), (54, 84, 6_720)]),
        (segment((15, 13), Some((32, 8))), [(188, 212, 16_960), (86, 110, 8_800)]),
        (segment((15, 13), Some((77, 5))), [(233, 257, 20_560), (83, 107, 8_560)]),
        (segment((15, 13), None), [(126, 150, 12_000), (66, 90, 7_200)]),
    ];
    for (setup, expected) in setups {
        let [inputs, outputs, service, _] = Budget::new(&setup).frames.map(|each| each.frame);
        let found = [&inputs, &outputs].map(|frame| (frame.len(), frame.wire_bytes(), frame.wire_ns()));
        assert_eq!(found, expected);
        assert_eq!((service.len(), service.wire_bytes(), service.wire_ns()), (156, 180, 14_400));
    }
}

#[test]
fn the_moments_of_a_cycle_are_those_of_its_bytes() {
    // Setup B: 1 ms, computed at 500 us, SYNC0 100 us before the next input frame.
    let budget = Budget::new(&segment((15, 13), Some((32, 8))));
    let moments = budget.frames.each_ref().map(|each| (each.sent_ns, each.done_ns, each.deadline_ns));
    assert_eq!(moments[0], (0, 200 * 80 + 3_000, 500_000));
    assert_eq!(moments[1], (540_000, 540_000 + 98 * 80 + 1_500, 900_000));
    assert_eq!(moments[2], (548_800, 548_800 + 168 * 80 + 3_000, 1_000_000));
    // The drive that acts at SYNC0 is sent its 13 bytes once more: 60 on the wire up to the last device, and a hundredth of a period to spare.
    let (delay_ns, spare_ns) = (72 * 80 + 1_500, 10_000);
    assert_eq!(moments[3], (900_000 - spare_ns - delay_ns, 900_000 - spare_ns, 900_000));
    assert_eq!(budget.exposed_ns, spare_ns + delay_ns);
    assert!(budget.is_schedulable());
    assert!((budget.load() - 0.04688).abs() < 1e-12);
    // Without SYNC0 outputs have until the next cycle.
    let mut free = segment((15, 13), Some((32, 8)));
    free.stations[0].acts = Acts::OnArrival;
    assert_eq!(Budget::new(&free).frames[1].deadline_ns, 1_000_000);
    assert!(Budget::new(&free).frames[3].frame.is_empty());
    assert_eq!(Budget::new(&free).exposed_ns, 460_000);
    // Outputs that leave shortly before SYNC0 are not repeated.
    let mut late = segment((15, 13), Some((32, 8)));
    late.compute_at = Duration::from_micros(825);
    let late = Budget::new(&late);
    assert!(late.is_schedulable() && late.frames[3].frame.is_empty());
    assert_eq!(late.exposed_ns, 35_000);
    // From SYNC0 to effect: a period, or up to the last device.
    assert_eq!(budget.delay(), Duration::from_millis(1));
    assert_eq!(Budget::new(&free).delay(), Duration::from_nanos(100_000 + 540_000 + 98 * 80 + 1_500));
}

#[test]
fn a_network_sends_the_frames_of_its_budget() {
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.cycles(4, &REST);
    bench.keeps = true;
    bench.cycles(200, &REST);
    let [inputs, outputs, service, repeat] = Budget::new(&setup()).frames.map(|each| each.frame);
    let mut counts = [0; 4];
    for frame in &bench.sent {
        match Command::from_byte(frame[frame::HEADER]) {
            Some(Command::Frmw) => {
                counts[0] += 1;
                let expected = inputs.datagrams.iter().map(|it| (it.command as u8, it.len as u16));
                let sent = Datagrams::of(frame).unwrap().map(|it| it.unwrap().header);
                assert!(expected.eq(sent.map(|header| (header.command, header.len))));
                assert_eq!(frame.len(), inputs.len());
            }
            Some(Command::Lwr) if frame.len() == outputs.len() => counts[1] += 1,
            Some(Command::Lwr) => {
                counts[3] += 1;
                assert_eq!(frame.len(), repeat.len());
            }
            _ => {
                counts[2] += 1;
                assert!(frame.len() <= service.len(), "{} bytes", frame.len());
            }
        }
    }
    // That of the last cycle comes with the next one.
    assert_eq!((counts[0], counts[1], counts[3]), (200, 200, 200));
    assert!(counts[2] > 100, "{counts:?}");
}

#[test]
fn a_segment_gives_frames_back_when_the_budget_says() {
    let budget = Budget::new(&setup());
    let mut bench = Bench::usual();
    bench.start().unwrap();
    bench.keeps = true;
    bench.cycles(1, &REST);
    let mut inputs = bench.sent.iter().find(|frame| frame[frame::HEADER] == Command::Frmw as u8).unwrap().clone();
    let now = bench.now;
    let back = bench.segment.process(now, &mut inputs).unwrap();
    assert_eq!(back.since(now).as_nanos() as u64, budget.frames[0].done_ns);
}

proptest! {
    /// What is advised fits, from the earliest moment to the latest, and nothing beside it does.
    #[test]
    fn what_is_advised_fits(
        drive in (0usize..250, 0usize..250),
        sensor in (0usize..250, 0usize..250),
        period_us in 20u64..2000,
        at in 0.0f64..1.0,
        is_at_sync0: bool,
    ) {
        let period = Duration::from_micros(period_us);
        let mut setup = SegmentSetup { period, sync0_phase: period / 10, ..segment(drive, Some(sensor)) };
        if !is_at_sync0 {
            setup.stations[0].acts = Acts::OnArrival;
        }
        setup.compute_at = period.mul_f64(at);
        let advice = advise(&setup).unwrap();
        let with = |compute_at_us: u64| {
            let compute_at = Duration::from_micros(compute_at_us);
            let sync0_phase = advice.period / 10;
            Budget::new(&SegmentSetup { period: advice.period, compute_at, sync0_phase, ..setup.clone() }).is_schedulable()
        };
        let [earliest, latest] = advice.compute_at_us;
        prop_assert!(with(earliest) && with(latest) && !with(latest + 1));
        prop_assert!(earliest == 1 || !with(earliest - 1));
        let fits = Budget::new(&setup).is_schedulable();
        prop_assert!(!fits || advice.period == period);
    }
}
