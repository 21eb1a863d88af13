//! Cost of a frame through a virtual EtherCAT segment of two drives and a sensor.

mod on_core;

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use hil_tests::segment::Bench;
use on_core::OnCore;

fn frames(criterion: &mut Criterion<OnCore>) {
    let bench = Bench::operational();
    let mut buffer = [0; 1514];
    let sent = bench.input_frame(&mut buffer).to_vec();
    criterion.bench_function("input frame, three devices", |bencher| {
        let (mut segment, mut now, mut frame) = (bench.segment.clone(), bench.now, sent.clone());
        bencher.iter(|| {
            // A nanosecond later each: nothing is due in between.
            now = now + Duration::from_nanos(1);
            frame.copy_from_slice(&sent);
            segment.process(now, black_box(&mut frame))
        });
    });
    criterion.bench_function("whole cycle, three devices", |bencher| {
        let mut bench = bench.clone();
        bencher.iter(|| bench.cycle());
    });
}

criterion_group!(name = benches; config = on_core::criterion(); targets = frames);
criterion_main!(benches);
